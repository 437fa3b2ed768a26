"""Stages of long work: what each cost, progress with time left, and child processes that report theirs."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from gof.errors import GofError
from gof.io.files import read_json, write_json

WORKER_VARIABLE = "GOF_PROGRESS_LINES"


@dataclass
class StageCost:
    """What a stage cost: wall seconds, peak resident memory in MB, and the settings that explain them."""

    name: str
    seconds: float
    peak_mb: float
    settings: dict[str, Any] = field(default_factory=dict)


class StageLog:
    """`costs.json` of a folder: one entry per stage; a stage run again replaces its entry.

    A resumed stage adds up: its seconds are the sum over the runs that did work.
    """

    def __init__(self, path: Path):
        self.path = path

    def stages(self) -> list[StageCost]:
        return [StageCost(**s) for s in read_json(self.path)["stages"]] if self.path.exists() else []

    def record(
        self, name: str, seconds: float, peak_mb: float, settings: dict[str, Any] | None = None, resumed: bool = False
    ) -> StageCost:
        """Write a stage's cost; with `resumed`, add to the seconds already there."""
        stages = self.stages()
        before = next((s for s in stages if s.name == name), None)
        cost = StageCost(name, round(seconds, 3), round(peak_mb, 1), settings or {})
        if before and resumed:
            cost.seconds, cost.peak_mb = round(before.seconds + seconds, 3), max(before.peak_mb, cost.peak_mb)
        kept = [cost if s.name == name else s for s in stages] if before else [*stages, cost]
        write_json(self.path, {"schema": "gof-costs", "version": 1, "stages": [asdict(s) for s in kept]})
        return cost

    @contextmanager
    def measure(self, name: str, **settings) -> Iterator[dict[str, Any]]:
        """Time a block of this process and record it if it succeeds; the yielded dict adds settings.

        The peak is that of the whole process so far, so it can only overstate a later stage.
        """
        start = time.perf_counter()
        yield settings
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        self.record(name, time.perf_counter() - start, peak_mb, settings)


def report_progress(stage: str, done: int, total: int, **figures) -> None:
    """Print one progress line for a parent process (or a person's script) to read."""
    print(json.dumps({"progress": {"stage": stage, "done": done, "total": total, **figures}}), flush=True)


@contextmanager
def progress_bar(title: str, ticking: bool = False) -> Iterator[Callable[..., None]]:
    """A progress line with elapsed time and time left; yields update(done, total, note="").

    `ticking` redraws between updates, on a thread of its own. That must not be where Dr.Jit works: a garbage collection
    on that thread would free Dr.Jit arrays under Python's lock while the main thread holds Dr.Jit's, a deadlock.

    In a child of `run_worker` it prints progress lines instead, and the parent draws the bar.
    """
    if os.environ.get(WORKER_VARIABLE):
        yield lambda done, total, stage=title, **figures: report_progress(stage, done, total, **figures)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:<30}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
        TextColumn("{task.fields[note]}"),
    )
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, auto_refresh=ticking, refresh_per_second=4, speed_estimate_period=60
    ) as progress:
        task = progress.add_task(title, total=None, note="")
        last = 0.0

        def update(done: int, total: int, note: str = "", stage: str = "", **_):
            nonlocal last
            progress.update(task, completed=done, total=total, note=note, description=stage or title)
            if not ticking:
                progress.refresh()
            if not console.is_terminal and (done == total or time.monotonic() - last > 15):
                last = time.monotonic()
                print(f"{stage or title}: {done}/{total} {note}".rstrip(), file=sys.stderr, flush=True)

        yield update


def run_worker(argv: list[str], title: str, log: Path | None = None) -> StageCost:
    """Run a child process that prints progress lines; show them as a progress bar.

    Args:
        argv: the command.
        title: what the bar says.
        log: file to append the child's other output to; its last lines are shown when it fails.
    Returns:
        the child's wall seconds and peak memory (with its own children's); settings hold the figures of its last progress line.
    Raises:
        GofError: the child failed; the message holds its exit status and last lines.
        KeyboardInterrupt: Ctrl-C; the child has been stopped.
    """
    start, tail, figures = time.perf_counter(), [], {}
    log_file = open(log, "a") if log else None
    child = subprocess.Popen(
        argv,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
        env=os.environ | {WORKER_VARIABLE: "1"},
        preexec_fn=die_with_parent if sys.platform == "linux" else None,
    )
    peak = _PeakMemory(child.pid)
    try:
        with progress_bar(title, ticking=True) as update:
            for line in child.stdout:
                try:
                    message = json.loads(line)["progress"] if line.startswith('{"progress"') else None
                except (ValueError, KeyError):
                    message = None
                if message:
                    figures = message
                    update(**message)
                    continue
                tail = [*tail[-30:], line]
                if log_file:
                    log_file.write(line)
        status = child.wait()
    except BaseException:
        # The whole group: a worker may have started helpers of its own.
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        raise
    finally:
        peak.stop()
        if log_file:
            log_file.close()
    if status:
        where = f" (full log: {log})" if log else ""
        raise GofError(f"{title} failed with status {status}{where}:\n{''.join(tail)}")
    return StageCost(title, time.perf_counter() - start, peak.mb, figures)


def die_with_parent() -> None:
    """In a child: be killed when the parent is, so that a killed run leaves nobody writing into its folder."""
    PR_SET_PDEATHSIG = 1
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class _PeakMemory:
    """Peak resident memory of a process tree, read from the kernel's own high-water marks twice a second."""

    def __init__(self, pid: int):
        self.mb, self._pid, self._stop = 0.0, pid, threading.Event()
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
