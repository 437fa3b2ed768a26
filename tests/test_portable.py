"""Windows and macOS, as far as Linux can tell: names, locks, text, processes, and imports without Unix' own modules."""

import ast
import multiprocessing
import subprocess
import sys
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gof.core import files
from gof.core.fields import VelocityField
from gof.evaluate import dve
from tests.conftest import random_gaussians

ROOT = Path(__file__).parents[1]
UNIX_ONLY = ("fcntl", "resource", "pwd", "grp", "termios", "pty", "posix")
# Python for a child in which there is no Unix: a lock of one byte stands for Windows' own.
WITHOUT_UNIX = f"""
import sys, types, fcntl, os
import subprocess, multiprocessing.util, tempfile, asyncio, psutil  # these ask Python what system this is
def locking(number, mode, size, lock=fcntl.lockf, flags=fcntl.LOCK_EX | fcntl.LOCK_NB):
    lock(number, flags, size, os.lseek(number, 0, os.SEEK_CUR))
sys.modules["msvcrt"] = types.SimpleNamespace(locking=locking, LK_NBLCK=2)
for name in {UNIX_ONLY}:
    sys.modules[name] = None
"""


def child(code, *arguments):
    command = [sys.executable, "-c", WITHOUT_UNIX + code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


# ---------------------------------------------------------------- names


@given(
    name=st.text(max_size=12) | st.sampled_from(["cam_0", "Übung 3", "a.b.png", "C:x", "C:", "..", "a\\b", "con.txt"])
)
def test_a_name_is_one_part_of_a_path_on_every_system(name):
    for kind, root in (
        (PurePosixPath, "/data"),
        (PureWindowsPath, "D:\\data"),
        (PureWindowsPath, "\\\\server\\share\\x"),
    ):
        path = kind(root) / name
        if files.is_name(name):
            assert path.parent == kind(root) and path.name == name, (kind, name)
            assert not kind(name).anchor and str(kind(name)) == name


@pytest.mark.parametrize(
    "name", ["C:evil", "\\\\server\\share", "\\evil", "a\\..\\..\\evil", "//server/share", "NUL", "aux.h"]
)
def test_what_leads_out_on_windows_is_no_name(name):
    """Each would leave the folder there, or open a device; here they would all be harmless."""
    out = PureWindowsPath("D:\\data") / name
    assert out.parent != PureWindowsPath("D:\\data") or name.split(".")[0].upper() in ("NUL", "AUX")
    assert not files.is_name(name)


# ---------------------------------------------------------------- locks


def test_a_folder_is_held_without_unix_locks_too(tmp_path):
    """Two processes: the second is refused, and says who works there; when the first ends it may."""
    code = "import os\nfrom pathlib import Path\nfrom gof.core.files import only_run_in\n"
    hold = code + "with only_run_in(Path(sys.argv[1])):\n    print(os.getpid(), flush=True)\n    sys.stdin.read()\n"
    first = subprocess.Popen(
        [sys.executable, "-c", WITHOUT_UNIX + hold, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    number = first.stdout.readline().strip()
    second = child(code + "with only_run_in(Path(sys.argv[1])): pass\n", tmp_path)
    assert second.returncode == 1 and f"another run is at work there (process {number})" in second.stderr
    first.communicate("", timeout=60)
    assert child(code + "with only_run_in(Path(sys.argv[1])): pass\n", tmp_path).returncode == 0


# ---------------------------------------------------------------- imports and memory


@pytest.mark.long
def test_every_module_is_imported_without_unix():
    code = (
        "import importlib, pkgutil, gof\n"
        "from gof.core.errors import MissingDependencyError\n"
        "names = [m.name for m in pkgutil.walk_packages(gof.__path__, 'gof.') if not m.name.endswith('__main__')]\n"
        "for name in names:\n"
        "    try:\n"
        "        importlib.import_module(name)\n"
        "    except ModuleNotFoundError as missing:\n"
        "        if missing.name not in ('torch', 'numba', 'llvmlite'):\n"  # of extras, which may be absent
        "            raise\n"
        "    except MissingDependencyError:\n"
        "        pass\n"
        "print(len(names))\n"
    )
    done = child(code)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) > 100


def test_without_unix_an_import_of_it_fails():
    """The test above can fail."""
    assert "import of fcntl halted" in child("import fcntl").stderr


def test_peak_memory_is_that_of_this_process():
    """A child takes a known 64 MB more than another."""
    code = "from gof.core.costs import peak_memory_mb; x = bytearray(b'x') * {}; print(peak_memory_mb())"
    runs = [subprocess.check_output([sys.executable, "-c", code.format(n)]) for n in (1, 64 << 20)]
    assert 60 < float(runs[1]) - float(runs[0]) < 80


# ---------------------------------------------------------------- processes


def score(_) -> float:
    field = VelocityField.from_array(np.ones((8, 8, 8, 3)), (-2, -2, -1), 0.5)
    return dve(random_gaussians(20), field, 0.4).l2


@pytest.mark.long
def test_a_spawned_process_scores_the_same():
    """Windows and macOS start processes anew instead of forking; nothing of this one's memory is there."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(score, [None]) == [score(None)]


@pytest.mark.checkout
def test_nobody_forks():
    wrong = []
    for path in [
        *(ROOT / "gof").rglob("*.py"),
        *(ROOT / "benchmark").rglob("*.py"),
        *(ROOT / "blender_addon").rglob("*.py"),
    ]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            spawns = called == "multiprocessing.get_context" and ast.unparse(node.args[0]) == "'spawn'"
            if called in ("os.fork", "ProcessPoolExecutor") or (called.startswith("multiprocessing.") and not spawns):
                wrong.append(f"{path}:{node.lineno} {called}")
    assert not wrong
