"""The course of a training: its loss over steps and CPU seconds, and whether it had stopped falling."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np

from gof.core.errors import DataFormatError

FILE = "curve.csv"  # beside a run's result; `gof baseline --curve` writes it
LARGEST = 1e30  # and its inverse the smallest: sums and ratios of such numbers are numbers
PART = 0.2  # of the steps: what the last of them are compared with the ones before by


@dataclass(frozen=True)
class TrainingCurve:
    """Point by point; `loss` is the mean of the steps since the point before, > 0."""

    FORMER: ClassVar[dict[str, str]] = {"processor_seconds": "cpu_seconds"}  # of 0.2; goes with the next version

    step: tuple[int, ...]
    cpu_seconds: tuple[float, ...]
    loss: tuple[float, ...]

    @property
    def last_fall(self) -> float:
        """By what share the mean loss fell from the last fifth but one of the steps to the last: near 0, it had
        stopped falling. NaN with fewer than ten points, which say nothing."""
        if len(self.step) < 10:
            return float("nan")
        steps, loss = np.array(self.step), np.array(self.loss)
        last = steps > (1 - PART) * steps[-1]
        before = ~last & (steps > (1 - 2 * PART) * steps[-1])
        return float(1 - loss[last].mean() / loss[before].mean())

    def thinned(self, count: int) -> TrainingCurve:
        """Means of `count` stretches of points, each at its last step; itself where there are not that many."""
        if len(self.step) <= count:
            return self
        ends = np.linspace(0, len(self.step), count + 1).round().astype(int)
        loss = [float(np.mean(self.loss[a:b])) for a, b in pairwise(ends)]
        at = ends[1:] - 1
        return TrainingCurve(tuple(self.step[k] for k in at), tuple(self.cpu_seconds[k] for k in at), tuple(loss))

    @classmethod
    def read(cls, path: Path) -> TrainingCurve:
        """Read a CSV with columns `step`, `cpu_seconds` and `loss`; others are left aside.

        Raises:
            DataFormatError: not such a file, no point in it, steps or seconds that do not rise, a number that is not
                above zero or that no training has (below 1e-30, above 1e30).
        """
        try:
            with path.open(newline="", encoding="utf-8-sig") as file:
                table = [{cls.FORMER.get(key, key): text for key, text in r.items()} for r in csv.DictReader(file)]
            rows = [(int(r["step"]), float(r["cpu_seconds"]), float(r["loss"])) for r in table]
        except (OSError, UnicodeDecodeError, csv.Error, KeyError, TypeError, ValueError) as e:
            raise DataFormatError(f"{path}: no training curve with columns step, cpu_seconds, loss ({e})") from e
        if not rows:
            raise DataFormatError(f"{path}: holds no point; was the training stopped at once?")
        if not all(1 / LARGEST <= number <= LARGEST for row in rows for number in row):
            raise DataFormatError(f"{path}: all numbers must be above zero, from 1e-30 to 1e30")
        numbers = np.array(rows, np.float64)
        rising = (np.diff(numbers[:, 0]) > 0).all() and (np.diff(numbers[:, 1]) >= 0).all()
        if not rising:
            raise DataFormatError(f"{path}: steps and seconds must rise")
        return cls(*zip(*rows, strict=True))
