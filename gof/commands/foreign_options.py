"""What every command that reads a foreign result may be told about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gof.io.importers import ImportOptions
from gof.io.importers.source import WorldBy


@dataclass
class ForeignOptions:
    """What a foreign result does not say about itself; see docs/importers.md."""

    time_unit: float | None = None
    """Seconds per unit of the method's time (FreeTimeGS: the whole sequence; a PLY sequence: between two numbers)."""
    time_zero: float = 0.0
    """Dataset time in seconds at the method's time 0."""
    world: Path | None = None
    """COLMAP model (folder) its world was normalised from, or JSON with "training_to_world": undone when given."""
    world_by: WorldBy | None = None
    """Whose normalisation of that model: FreeTimeGsVanilla's own, or gsplat's; without it that is found out."""
    code_date: str | None = None
    """Date (2024-09-15) of the method's code that trained, where its files changed their meaning (4DGS of Yang)."""

    def options(self, frame_time_s: float | None = None) -> ImportOptions:
        return ImportOptions(self.time_unit, self.time_zero, frame_time_s, self.world, self.world_by, self.code_date)
