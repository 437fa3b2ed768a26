"""costs.json: what the stages of a dataset cost. `gof.core.costs` is the library's own form of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from .io.records import read_record, write_record


@dataclass(frozen=True)
class StageCost:
    """What a stage cost, in all runs that did work for it.

    Attributes:
        name: of the stage.
        seconds: of its processes, s; those that work at the same time count each.
        peak_mb: peak resident memory of a process, MB.
        settings: what explains the cost, and `wall_s`, seconds by the clock from its first work to its last.
    """

    name: str
    seconds: float
    peak_mb: float
    settings: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Costs:
    """costs.json.

    Attributes:
        stages: in the order in which they first ran.
        wall_s: seconds by the clock of the whole command, added up over all its runs in this folder. A run that is cut
            off counts up to the last stage it recorded.
    """

    SCHEMA: ClassVar[str] = "gof-costs"
    VERSION: ClassVar[int] = 1

    stages: tuple[StageCost, ...] = ()
    wall_s: float = 0.0

    @classmethod
    def read(cls, path: Path) -> Costs:
        """Read a costs.json; nothing has been paid yet where there is none. Raises FileFormatError: not such a file."""
        return read_record(cls, path) if path.is_file() else cls()

    def write(self, path: Path) -> None:
        """Write a costs.json, atomically."""
        write_record(path, self)

    def adding(self, run: StageCost, clock_s: float) -> Costs:
        """With one more run of a stage by one process; a stage that was resumed adds up.

        Args:
            clock_s: seconds by the clock since the command began, or since what it recorded last.
        """
        before = next((cost for cost in self.stages if cost.name == run.name), None)
        stage_wall_s = run.seconds + (before.settings.get("wall_s", 0.0) if before else 0.0)
        after = StageCost(
            run.name,
            round(run.seconds + (before.seconds if before else 0.0), 3),
            round(max(run.peak_mb, before.peak_mb if before else 0.0), 1),
            run.settings | {"wall_s": round(stage_wall_s, 3)},
        )
        stages = tuple(after if cost is before else cost for cost in self.stages)
        return Costs(stages if before else (*stages, after), round(self.wall_s + clock_s, 3))
