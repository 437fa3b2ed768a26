"""How a training went: one line per `loss.backward()`, thinned, as CSV."""

from __future__ import annotations

import time
from pathlib import Path

EVERY = 10  # steps; a line is their mean


class Curve:
    """Attributes: count, the Gaussians of the last picture drawn."""

    def __init__(self, path: Path):
        self.count = 0
        self._path, self._began = path, time.perf_counter()
        self._losses: list[float] = []
        self._step = 0
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("step,seconds,processor_seconds,loss,gaussians\n")

    def add(self, loss: float) -> None:
        """Count one step."""
        self._step += 1
        self._losses.append(loss)
        if len(self._losses) < EVERY:
            return
        mean = sum(self._losses) / EVERY
        now = time.perf_counter() - self._began
        with self._path.open("a") as file:
            file.write(f"{self._step},{now:.2f},{time.process_time():.2f},{mean:.6g},{self.count}\n")
        self._losses.clear()
