"""Child processes that report their progress."""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

from gof.core.costs import StageCost
from gof.core.errors import GofError
from gof.host.processes import end, start
from gof.host.terminal import WORKER_VARIABLE, progress_bar


def run_worker(argv: list[str], title: str, log: Path | None = None, after_s: float = 0.0) -> StageCost:
    """Run a child process that prints progress lines; show them as a progress bar.

    Args:
        argv: the command.
        title: what the bar says.
        log: file to append the child's other output to; its last lines are shown when it fails.
        after_s: seconds of other work after it, which the time left counts too.
    Returns:
        the child's wall seconds and peak memory (with its own children's); settings hold the figures of its last
        progress line.
    Raises:
        GofError: the child failed; the message holds its exit status and last lines.
        KeyboardInterrupt: Ctrl-C; the child has been stopped.
    """
    began = time.perf_counter()
    tail: list[str] = []
    figures: dict[str, Any] = {}
    log_file = open(log, "a", encoding="utf-8") if log else None
    child = start(
        argv,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,
        env=os.environ | {WORKER_VARIABLE: "1"},
    )
    peak = _PeakMemory(child.pid)
    try:
        with progress_bar(title, ticking=True, after_s=after_s) as update:
            for line in child.stdout or ():
                if message := _progress_of(line):
                    figures = message
                    update(**message)
                    continue
                tail = [*tail[-30:], line]
                if log_file:
                    log_file.write(line)
        status = child.wait()
    except BaseException:
        end(child)
        raise
    finally:
        peak.stop()
        if log_file:
            log_file.close()
    if status:
        where = f" (full log: {log})" if log else ""
        raise GofError(f"{title} failed with status {status}{where}:\n{''.join(tail)}")
    return StageCost(title, time.perf_counter() - began, peak.mb, figures)


def _progress_of(line: str) -> dict[str, Any] | None:
    """Return the progress that a line states; None for any other line."""
    if not line.startswith('{"progress"'):
        return None
    try:
        return json.loads(line)["progress"]
    except (ValueError, KeyError):
        return None


class _PeakMemory:
    """Peak resident memory of a process tree, read from the kernel's own high-water marks twice a second."""

    def __init__(self, pid: int):
        self.mb = 0.0
        self._pid = pid
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        import psutil

        while not self._stop.wait(0.5):
            try:
                root = psutil.Process(self._pid)
                rss = sum(p.memory_info().rss for p in [root, *root.children(recursive=True)])
                self.mb = max(self.mb, rss / 2**20)
            except psutil.Error:
                return

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(timeout=2)
