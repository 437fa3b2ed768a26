"""`costs.json` of a folder: what each stage of the work cost, and the clock time of all runs of the command."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from gof.io.records import read_record, write_record


@dataclass(frozen=True)
class StageCost:
    """What a stage cost: wall seconds, peak resident memory in MB, and the settings that explain them."""

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
    """Clock seconds of the whole command, added up over all its runs in this folder, the failed ones too."""


class StageLog:
    """Keeps the `costs.json` of a folder: one entry per stage; a stage run again replaces its entry.

    A resumed stage adds up: its seconds are the sum over the runs that did work.
    """

    def __init__(self, path: Path):
        self.path = path

    def costs(self) -> Costs:
        """All of it; empty before the first stage. Raises DataFormatError if the file is not a `gof-costs` record."""
        return read_record(Costs, self.path) if self.path.exists() else Costs()

    def stages(self) -> tuple[StageCost, ...]:
        return self.costs().stages

    def record(
        self, name: str, seconds: float, peak_mb: float, settings: dict[str, Any] | None = None, resumed: bool = False
    ) -> StageCost:
        """Write a stage's cost; with `resumed`, add to the seconds already there."""
        costs = self.costs()
        before = next((s for s in costs.stages if s.name == name), None)
        if before and resumed:
            seconds += before.seconds
            peak_mb = max(peak_mb, before.peak_mb)
        cost = StageCost(name, round(seconds, 3), round(peak_mb, 1), settings or {})
        if before:
            stages = tuple(cost if s.name == name else s for s in costs.stages)
        else:
            stages = (*costs.stages, cost)
        write_record(self.path, replace(costs, stages=stages))
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

    @contextmanager
    def clock(self) -> Iterator[None]:
        """Add the clock seconds of the block, a run of the command, to `wall_s`; also when it fails after some work."""
        start = time.perf_counter()
        try:
            yield
        finally:
            if self.path.exists():
                costs = self.costs()
                wall_s = costs.wall_s + time.perf_counter() - start
                write_record(self.path, replace(costs, wall_s=round(wall_s, 3)))
