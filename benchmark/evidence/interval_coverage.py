"""How often do the benchmark's intervals hold the true mean? On series whose mean and correlation are known.

    python -m gof_benchmark.evidence.interval_coverage --repeats 2000

Takes about a minute.

First-order autoregressions of 24, 36 and 100 frames with eddy times of 0 to 6 frames. "blocks alone": the block
bootstrap with blocks of one eddy time and the normal distribution, as it is usually done.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro
from scipy.stats import norm

from gof.evaluate.eddy_time import integral_time
from gof.evaluate.intervals import CONFIDENCE, block_length, block_variance, over_frames

COUNTS, EDDIES = (24, 36, 100), (0, 1, 2, 4, 6)


@dataclass
class CoverageConfig:
    """Print the share of intervals that hold the true mean."""

    repeats: int = 4000
    """Series per line."""
    seed: int = 0
    """For the series."""


def series(count: int, eddy_frames: float, repeats: int, rng: np.random.Generator) -> np.ndarray:
    """Return (repeats, count) of mean 0 and variance 1 with correlation exp(-lag / eddy_frames)."""
    memory = np.exp(-1 / eddy_frames) if eddy_frames else 0.0
    drawn = rng.standard_normal((repeats, count))
    for k in range(1, count):
        drawn[:, k] = memory * drawn[:, k - 1] + np.sqrt(1 - memory**2) * drawn[:, k]
    return drawn


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(CoverageConfig, prog="python -m gof_benchmark.evidence.interval_coverage", args=argv)
    rng = np.random.default_rng(config.seed)
    print("| frames | eddy time, frames | found from the clip | blocks alone | here |")
    print("|---|---|---|---|---|")
    for count in COUNTS:
        for eddy in EDDIES:
            drawn = series(count, eddy, config.repeats, rng)
            block = block_length(count, eddy)
            width = norm.ppf(0.5 + CONFIDENCE / 2)
            alone = np.mean([abs(one.mean()) <= width * np.sqrt(block_variance(one, block)) for one in drawn])
            ours = np.mean([abs(found.mean) <= found.half_width for found in (over_frames(one, eddy) for one in drawn)])
            print(f"| {count} | {eddy} | {integral_time(drawn.T):.2f} | {alone:.1%} | {ours:.1%} |", flush=True)


if __name__ == "__main__":
    main()
