"""Output to a terminal: texts from files are text there, not colours, links or commands to the terminal."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from gof.core.errors import printable

if TYPE_CHECKING:
    from rich.console import Console


def console() -> Console:
    """Return where commands print their tables: no markup, no emoji, nothing that acts; styles are given as
    arguments."""
    from rich.console import Console

    class PlainConsole(Console):
        """One whose texts are `printable`, in tables too."""

        def render_str(self, text: str, **options):
            return super().render_str(printable(text), **options)

    return PlainConsole(markup=False, emoji=False, highlight=False)


# ----------------------------------------------------------------
# Progress of long work: a bar with time left for people, lines for a parent process.

WORKER_VARIABLE = "GOF_PROGRESS_LINES"  # set by `gof.host.worker.run_worker` in its children
QUIET_VARIABLE = "GOF_QUIET"  # set by --quiet: no progress is shown


def report_progress(stage: str, done: int, total: int, **figures) -> None:
    """Print one progress line for a parent process (or a person's script) to read."""
    print(json.dumps({"progress": {"stage": stage, "done": done, "total": total, **figures}}), flush=True)


@contextmanager
def progress_bar(title: str, ticking: bool = False) -> Iterator[Callable[..., None]]:
    """Provide a progress line with elapsed time and time left; yields update(done, total, note="").

    It is seen from the first update on, so that input which is refused before is refused without one. `ticking` draws
    it at once, and again between updates, on a thread of its own. That must not be where Dr.Jit works: a garbage
    collection on that thread would free Dr.Jit arrays under Python's lock while the main thread holds Dr.Jit's, a
    deadlock.

    In a child of `run_worker` it prints progress lines instead, and the parent draws the bar.
    """
    if os.environ.get(WORKER_VARIABLE):
        yield lambda done, total, stage=title, **figures: report_progress(stage, done, total, **figures)
        return
    if os.environ.get(QUIET_VARIABLE):
        yield lambda *_, **__: None
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
    progress = Progress(*columns, console=console, auto_refresh=ticking, refresh_per_second=4, speed_estimate_period=60)
    task = progress.add_task(title, total=None, note="")
    last = 0.0

    def update(done: int, total: int, note: str = "", stage: str = "", **_):
        nonlocal last
        progress.start()
        progress.update(task, completed=done, total=total, note=note, description=stage or title)
        if not ticking:
            progress.refresh()
        if not console.is_terminal and (done == total or time.monotonic() - last > 15):
            last = time.monotonic()
            print(f"{stage or title}: {done}/{total} {note}".rstrip(), file=sys.stderr, flush=True)

    if ticking:
        progress.start()
    try:
        yield update
    finally:
        if progress.live.is_started:
            progress.stop()
