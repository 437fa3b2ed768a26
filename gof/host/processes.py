"""Child processes: how one is started, so that it dies with its parent and runs nothing that lies about."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys

# As "-P" does, for Python 3.10, which lacks it. `sys` is part of the interpreter, so no file of its name is read.
WITHOUT_FOLDER = "import sys; sys.path[:] = [p for p in sys.path if p]\n"
RUN_MODULE = "import runpy; runpy.run_module({0!r}, run_name='__main__', alter_sys=True)"


def python_command(option: str, program: str, *arguments: str) -> list[str]:
    """Return the command of this Python with a module (`-m NAME`) or with code (`-c CODE`).

    Python itself would look for modules in the current folder first, and that is where a user's data are: a file
    `random.py` that came with a data set would be run (CWE-426).
    """
    if sys.version_info >= (3, 11):
        return [sys.executable, "-P", option, program, *arguments]
    code = program if option == "-c" else RUN_MODULE.format(program)
    return [sys.executable, "-c", WITHOUT_FOLDER + code, *arguments]


def start(command: list[str], **options) -> subprocess.Popen:
    """`subprocess.Popen` of a process that is killed when this one ends, however it ends (on Linux)."""
    hook = _die_with(os.getpid()) if sys.platform == "linux" else None
    return subprocess.Popen(command, preexec_fn=hook, **options)


def run(command: list[str], timeout_s: float | None = None, **options) -> subprocess.CompletedProcess:
    """Run a process of `start` to its end, and end it if that takes too long or this one is stopped.

    Raises:
        subprocess.TimeoutExpired: it took too long.
    """
    with start(command, **options) as child:
        try:
            out, err = child.communicate(timeout=timeout_s)
        except BaseException:
            child.kill()
            raise
    return subprocess.CompletedProcess(command, child.returncode, out, err)


def end(child: subprocess.Popen) -> None:
    """Kill the leader of a session (`start_new_session`), and all that it has started."""
    if hasattr(os, "killpg"):
        os.killpg(child.pid, signal.SIGKILL)
    else:  # Windows has no groups
        import psutil

        for process in psutil.Process(child.pid).children(recursive=True):
            process.kill()
        child.kill()
    child.wait()


def _die_with(parent: int):
    """Return the function that a child runs before its program: ask the kernel for its death, unless the parent is dead
    already."""
    library = ctypes.CDLL(None)  # loaded before the fork; after it only calls are safe

    def hook() -> None:
        PR_SET_PDEATHSIG = 1
        library.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)

    return hook
