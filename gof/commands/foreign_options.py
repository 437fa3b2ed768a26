"""What every command that reads another method's result may be told about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gof.io.importers import ImportOptions
from gof.io.importers.source import WorldBy


@dataclass
class ForeignOptions:
    """What another method's files do not say about themselves; see docs/importers.md."""

    time_unit: float | None = None
    """Seconds per unit of the method's time (FreeTimeGS: the whole clip; PLY sequence: from one number to the next)."""
    time_zero: float = 0.0
    """Dataset time in seconds at the method's time 0."""
    world: Path | None = None
    """COLMAP model (folder), or JSON with "training_to_world": the method's normalisation of that world is undone."""
    world_by: WorldBy | None = None
    """Whose normalisation that was: FreeTimeGsVanilla's own, or gsplat's; default: found out from the result."""
    code_date: str | None = None
    """Date, as 2024-09-15, of the code that trained it, where the meaning of its files has changed (4DGS of Yang)."""

    def options(self, frame_time_s: float | None = None) -> ImportOptions:
        return ImportOptions(self.time_unit, self.time_zero, frame_time_s, self.world, self.world_by, self.code_date)
