"""`curve.json`: scores on held-out pictures along the optimisation."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from gof.core.records import read_record, write_record

FILE = "curve.json"


@dataclass(frozen=True)
class HeldOutScores:
    """Means over held-out pictures; None where there is no such picture, or the score is not finite.

    Attributes:
        psnr, ssim: of whole pictures, PSNR in dB.     psnr_flame, ssim_flame: of the flame in them.
        psnr_flame_novel: of the flame seen by the cameras kept for novel views, dB.
        sizes_px: (width, height) that the pictures were scored at: the same result scores lower at a larger size.
    """

    psnr: float | None = None
    ssim: float | None = None
    psnr_flame: float | None = None
    ssim_flame: float | None = None
    psnr_flame_novel: float | None = None
    sizes_px: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class CurvePoint:
    """The scores after `step` steps and `seconds` of optimisation (the scoring's own time left out)."""

    step: int
    seconds: float
    scores: HeldOutScores


@dataclass(frozen=True)
class Curve:
    """The points, in order of steps."""

    SCHEMA: ClassVar[str] = "gof-curve"
    VERSION: ClassVar[int] = 1

    points: tuple[CurvePoint, ...] = ()

    @classmethod
    def read(cls, folder: Path) -> Curve:
        """Read a folder's curve. Raises DataFormatError: it has no curve.json, or one of another version."""
        return read_record(cls, folder / FILE)

    def with_point(self, point: CurvePoint) -> Curve:
        """Return it with `point` last; those at its step and after it, of an interrupted run, are dropped."""
        return Curve((*(p for p in self.points if p.step < point.step), point))


class CurveLog:
    """Keeps a folder's curve.json while the optimisation runs. Its clock stands still while scores are made."""

    def __init__(self, folder: Path, resumed_s: float | None):
        """resumed_s: seconds of optimisation to go on after, with the curve that is there; None begins a new one."""
        self._path = folder / FILE
        self.curve = Curve.read(folder) if resumed_s is not None and self._path.exists() else Curve()
        self._start = time.perf_counter() - (resumed_s or 0.0)

    @property
    def seconds(self) -> float:
        """Return the seconds of optimisation until now, in all runs."""
        return time.perf_counter() - self._start

    def add(self, step: int, score: Callable[[], HeldOutScores]) -> CurvePoint:
        """Call `score`, write what it returns, and return it as a point."""
        begin = time.perf_counter()
        point = CurvePoint(step, round(begin - self._start, 2), score())
        self.curve = self.curve.with_point(point)
        write_record(self._path, self.curve)
        self._start += time.perf_counter() - begin
        return point
