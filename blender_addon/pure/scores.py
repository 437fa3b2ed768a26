"""Scores as the panel Score shows them: those that `gof evaluate --json` writes, or those of our own `dve`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from ..core.errors import DataFormatError, GofError
from ..core.records import read_record


@dataclass(frozen=True)
class TrivialScore:
    """The score of velocities that anybody could guess."""

    l2: float | None


@dataclass(frozen=True)
class TrivialBaselines:
    """zero: no motion at all; constant: one vector for everything, the mean true velocity."""

    zero: TrivialScore | None = None
    constant: TrivialScore | None = None


@dataclass(frozen=True)
class VelocityScore:
    """DVE of a sequence.

    Attributes:
        l2: relative L2 error of the velocities; None where it is undefined.
        cos_sim: cosine similarity, likewise.
        frames_scored: number of frames where it is defined.
        weight_outside: share of the Gaussians' mass outside the velocity's domain, 0..1.
    """

    l2: float | None
    cos_sim: float | None
    frames_scored: int
    weight_outside: float


@dataclass(frozen=True)
class Scores:
    """dve: None where nothing could be scored; `warnings` say why, or what to mind."""

    SCHEMA: ClassVar[str] = "gof-scores"
    VERSION: ClassVar[int] = 1
    FORMER: ClassVar[dict[str, str]] = {"controls": "trivial_baselines"}  # of 0.2; goes with the next version

    dve: VelocityScore | None = None
    trivial_baselines: TrivialBaselines = field(default_factory=TrivialBaselines)
    warnings: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path) -> Scores:
        """Read a scores.json. Raises DataFormatError: absent, or not what this version reads (names the field)."""
        try:
            return read_record(cls, path)
        except GofError as error:
            raise DataFormatError(f"{error}; was it written by gof of another version?") from None

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values for people."""
        if self.dve is None:
            return [("DVE", "; ".join(self.warnings) or "undefined")]
        rows = [
            ("DVE L2", _number(self.dve.l2)),
            ("DVE CosSim", _number(self.dve.cos_sim)),
            ("Frames", str(self.dve.frames_scored)),
        ]
        if self.trivial_baselines.zero:
            rows.append(("L2 of no motion", _number(self.trivial_baselines.zero.l2)))
        if self.trivial_baselines.constant:
            rows.append(("L2 of one vector", _number(self.trivial_baselines.constant.l2)))
        return [*rows, ("Weight outside", f"{100 * self.dve.weight_outside:.0f} %")]


def _number(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"
