"""Which plate is nearest to the picture without fire: minimum, percentiles, means of the darkest, median, `steady`.

    python -m gof_benchmark.evidence.plate_kinds DATASET [--noise 2] [--camera 0] [--json FILE]

DATASET is generated, so that its true fire-free pictures are known. Prints PSNR (dB) in all pixels, where fire never
is, where it is at times, and in the core, which burns in more than 70 % of the frames, by the true masks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.evaluate.image import psnr
from gof.ingest import plates
from gof.ingest.over_time import LUMA, darkest, median

CORE = 0.7  # of the frames


@dataclass(frozen=True)
class PlateKinds:
    """Compare kinds of plates with the true fire-free picture. Prints a table."""

    dataset: tyro.conf.Positional[Path]
    """A generated dataset with masks."""
    camera: int = 0
    """Number of the camera."""
    noise: float = 2.0
    """Standard deviation of the noise that is added to the clip, grey levels of 255."""
    seed: int = 0
    json: Path | None = None
    """Also write the figures to this file."""


def by_luminance(clip: np.ndarray, first: float, last: float) -> np.ndarray:
    """Return (H, W, 3) uint8: mean of each pixel's frames between two shares (0..1) of their order by luminance.

    Args:
        clip: (T, H, W, 3) uint8.
    """
    order = np.argsort(clip.astype(np.float32) @ LUMA, axis=0, kind="stable")
    begin = min(int(first * len(clip)), len(clip) - 1)
    chosen = order[begin : max(int(np.ceil(last * len(clip))), begin + 1)]
    return np.uint8(np.rint(np.take_along_axis(clip, chosen[..., None], 0).mean(0)))


def steady(clip: np.ndarray) -> np.ndarray:
    """Return the default of `gof ingest`."""
    low = darkest(clip)
    return plates.steady(clip, low, plates.fire_reached(clip, low))


def _ranked(share: float) -> Callable[[np.ndarray], np.ndarray]:
    return partial(by_luminance, first=share, last=share)


def _darkest_part(share: float) -> Callable[[np.ndarray], np.ndarray]:
    return partial(by_luminance, first=0.0, last=share)


KINDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "minimum (by luminance)": darkest,
    "5th percentile": _ranked(0.05),
    "10th percentile": _ranked(0.1),
    "25th percentile": _ranked(0.25),
    "mean of the darkest 10 %": _darkest_part(0.1),
    "mean of the darkest 20 %": _darkest_part(0.2),
    "median": median,
    "steady (default)": steady,
}


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(PlateKinds, prog="python -m gof_benchmark.evidence.plate_kinds", args=argv)
    dataset = Dataset.open(config.dataset)
    frames = range(len(dataset.times_s))
    masks = [dataset.mask(config.camera, k) for k in frames]
    if any(mask is None for mask in masks):
        raise GofError(f"{config.dataset}: has no masks of the flame; generate it")
    rng = np.random.default_rng(config.seed)
    clip = np.stack([255 * dataset.image(config.camera, k) for k in frames])
    clip = np.uint8(np.rint(np.clip(clip + rng.normal(0, config.noise, clip.shape), 0, 255)))
    burns = np.mean(np.stack(masks) > 0.5, axis=0)
    places = {"all": None, "never": burns == 0, "at times": burns > 0, "core": burns > CORE}
    print("| plate | all | where fire never is | where fire is at times | core |\n|---|---|---|---|---|")
    rows = []
    for name, kind in KINDS.items():
        plate = kind(clip) / 255
        figures = {at: psnr(plate, dataset.static(config.camera), where) for at, where in places.items()}
        rows.append({"plate": name, **figures})
        cells = ["-" if value is None else f"{value:.2f}" for value in figures.values()]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    if config.json:
        write_json(config.json, rows)


if __name__ == "__main__":
    main()
