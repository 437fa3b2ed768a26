"""`costs.json` of a folder: what each stage of the work cost, and the clock time of all runs of the command."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from .records import read_record, write_record


@dataclass(frozen=True)
class StageCost:
    """The cost of a stage: wall seconds, peak resident memory in MB, and the settings that explain them."""

    name: str
    seconds: float
    peak_mb: float
    settings: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Costs:
    """`costs.json`: what a command's work in a folder cost.

    `seconds` of a stage adds up its processes, which may work at the same time, so the stages' sum is not `wall_s`.
    """

    SCHEMA: ClassVar[str] = "gof-costs"
    VERSION: ClassVar[int] = 1

    stages: tuple[StageCost, ...] = ()
    wall_s: float = 0.0
    """Clock seconds of the whole command, added up over all its runs in this folder. A run that is cut off counts up to
    the last stage it recorded."""


class StageLog:
    """Keeps the `costs.json` of a folder: one entry per stage; a stage run again replaces its entry.

    A resumed stage adds up: its seconds are the sum over the runs that did work. Made when a run of the command begins:
    `wall_s` grows by the clock seconds from then to the last stage that the run records.
    """

    def __init__(self, path: Path):
        self.path = path
        self._counted = time.perf_counter()  # until when `wall_s` counts this run

    def costs(self) -> Costs:
        """Return the stages in the file; none before the first stage. Raises DataFormatError: not a `gof-costs`
        record."""
        return read_record(Costs, self.path) if self.path.exists() else Costs()

    def stages(self) -> tuple[StageCost, ...]:
        """Return the stages of `costs`, in the order in which they were first recorded."""
        return self.costs().stages

    def record(
        self, name: str, seconds: float, peak_mb: float, settings: dict[str, Any] | None = None, resumed: bool = False
    ) -> StageCost:
        """Write a stage's cost; with `resumed`, add to the seconds already there."""
        costs = self.costs()
        before = next((stage for stage in costs.stages if stage.name == name), None)
        if before and resumed:
            seconds += before.seconds
            peak_mb = max(peak_mb, before.peak_mb)
        cost = StageCost(name, round(seconds, 3), round(peak_mb, 1), settings or {})
        if before:
            stages = tuple(cost if stage.name == name else stage for stage in costs.stages)
        else:
            stages = (*costs.stages, cost)
        now = time.perf_counter()
        write_record(self.path, Costs(stages, round(costs.wall_s + now - self._counted, 3)))
        self._counted = now
        return cost

    @contextmanager
    def measure(self, name: str, before_s: float = 0.0, **settings) -> Iterator[dict[str, Any]]:
        """Time a block of this process and record it if it succeeds; the yielded dict adds settings.

        The peak is that of the whole process so far, so it can only overstate a later stage.

        Args:
            before_s: seconds that earlier runs spent on what this one goes on with.
        """
        start = time.perf_counter() - before_s
        yield settings
        self.record(name, time.perf_counter() - start, peak_memory_mb(), settings)


@contextmanager
def timed(costs: dict[str, float], name: str) -> Iterator[None]:
    """Add the seconds of a block to costs[name]."""
    start = time.perf_counter()
    yield
    costs[name] = costs.get(name, 0.0) + time.perf_counter() - start


def peak_memory_mb() -> float:
    """Return the most memory this process has held so far, in MB; 0 where it is not known (Windows without psutil)."""
    status = Path("/proc/self/status")
    if status.is_file():  # getrusage would count what the process that started this one had in memory
        return int(status.read_text(encoding="utf-8").partition("VmHWM:")[2].split()[0]) / 2**10
    try:
        import resource
    except ModuleNotFoundError:  # Windows
        return _peak_on_windows_mb()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # macOS counts bytes


def _peak_on_windows_mb() -> float:
    try:
        import psutil
    except ModuleNotFoundError:  # inside Blender
        return 0.0
    return psutil.Process().memory_info().peak_wset / 2**20
