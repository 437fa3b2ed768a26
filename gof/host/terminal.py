"""Output to a terminal: texts from files are text there, not colours, links or commands to the terminal."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

from gof.core.errors import printable
from gof.core.time_left import TimeLeft, duration

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


class _Left:
    """The time left in a bar, in words of this very moment."""

    def __init__(self, left: TimeLeft, after_s: float):
        self._left, self._after_s = left, after_s
        self._child: tuple[float, float] | None = None  # seconds that a child told, and when

    def update(self, part: str, share: float, child_s: float | None) -> None:
        self._left.reach(part, share)
        self._child = None if child_s is None else (child_s, time.monotonic())

    @property
    def seconds(self) -> float | None:
        own = self._left.seconds if self._child is None else self._child[0] - (time.monotonic() - self._child[1])
        return None if own is None else max(own, 0.0) + self._after_s

    def __str__(self) -> str:
        return "-:--:--" if self.seconds is None else str(timedelta(seconds=round(self.seconds)))


@contextmanager
def progress_bar(
    title: str, ticking: bool = False, left: TimeLeft | None = None, after_s: float = 0.0
) -> Iterator[Callable[..., None]]:
    """Provide a progress line with elapsed time and time left (`gof.core.time_left`); yields update(done, total,
    note="", share=done / total).

    Args:
        left: of work that the bar is a part of, the one named `title`; the bar then shows what all of that needs.
        after_s: seconds of other work after that; they are added.

    It is seen from the first update on, so that input which is refused before is refused without one. `ticking` draws
    it at once, and again between updates, on a thread of its own. That must not be where Dr.Jit works: a garbage
    collection on that thread would free Dr.Jit arrays under Python's lock while the main thread holds Dr.Jit's, a
    deadlock.

    In a child of `run_worker` it prints progress lines instead, and the parent draws the bar.
    """
    if os.environ.get(WORKER_VARIABLE):
        yield _report_to_parent(title, left)
    elif os.environ.get(QUIET_VARIABLE):
        yield lambda *_, **__: None
    else:
        with _draw_bar(title, ticking, _Left(left or TimeLeft(), after_s)) as update:
            yield update


def _report_to_parent(title: str, left: TimeLeft | None) -> Callable[..., None]:
    """Return the update of a bar that the parent process draws."""

    def tell(done: int, total: int, stage: str = title, share: float | None = None, **figures) -> None:
        if left is not None:
            left.reach(stage, done / max(total, 1) if share is None else share)
            figures["left_s"] = left.seconds
        report_progress(stage, done, total, **figures)

    return tell


@contextmanager
def _draw_bar(title: str, ticking: bool, shown: _Left) -> Iterator[Callable[..., None]]:
    """Provide the update of a bar that is drawn on this terminal, or printed as lines where there is none."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

    columns = (
        TextColumn("{task.description:<30}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[note]}"),
    )
    console = Console(stderr=True)
    progress = Progress(*columns, console=console, auto_refresh=ticking, refresh_per_second=4)
    task = progress.add_task(title, total=None, note="", left=shown)
    last = 0.0

    def update(
        done: int,
        total: int,
        note: str = "",
        stage: str = "",
        share: float | None = None,
        left_s: float | None = None,
        **_,
    ):
        nonlocal last
        shown.update(stage or title, done / max(total, 1) if share is None else share, left_s)
        progress.start()
        progress.update(task, completed=done, total=total, note=note, description=stage or title)
        if not ticking:
            progress.refresh()
        if not console.is_terminal and (done == total or time.monotonic() - last > 15):
            last = time.monotonic()
            remaining = f", {duration(shown.seconds)} left" if shown.seconds and done < total else ""
            print(f"{stage or title}: {done}/{total} {note}".rstrip() + remaining, file=sys.stderr, flush=True)

    if ticking:
        progress.start()
    try:
        yield update
    finally:
        if progress.live.is_started:
            progress.stop()
