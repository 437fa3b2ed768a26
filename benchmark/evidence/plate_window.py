"""Does a plate of more frames than the clip show what stands behind the fire? Prints a table.

    python -m gof_benchmark.evidence.plate_window DATASET [--start 12] [--frames 12] [--windows 12 18 24 36]

DATASET is generated, so that its true fire-free pictures are known. A clip of FRAMES frames is taken from it, and its
plates are made as `gof ingest --plates steady:N` makes them, of windows of growing length, without held-out frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.files import write_json
from gof.dataset import Dataset, held_out
from gof.evaluate.image import psnr
from gof.ingest import plates
from gof.ingest.fire_free import around
from gof.ingest.over_time import darkest


@dataclass(frozen=True)
class PlateWindow:
    """Plates of windows of frames around a clip, against the true fire-free pictures. Prints a table."""

    dataset: tyro.conf.Positional[Path]
    """A generated dataset."""
    start: int = 12
    """The clip's first frame."""
    frames: int = 12
    """The clip's length."""
    windows: tuple[int, ...] = (12, 18, 24, 36)
    """Frames that plates are made of; the clip's length: of the clip alone."""
    json: Path | None = None
    """Also write the figures to this file."""


def measure(dataset: Dataset, camera: int, config: PlateWindow, window: int) -> dict[str, float]:
    """Return share of fire left in a camera's plate, and its PSNR (dB) where fire was in the clip and everywhere."""
    used = np.arange(config.start, config.start + config.frames)

    def pictures(numbers: np.ndarray) -> np.ndarray:
        return np.uint8([np.rint(255 * dataset.image(camera, int(k))) for k in numbers])

    clip = pictures(used[list(held_out(config.frames).train)])
    low = darkest(clip)
    reached = plates.fire_reached(clip, low)
    beyond = around(used, window, len(dataset.times_s))
    dark = plates.uncovered(low, reached, [darkest(pictures(beyond))] if len(beyond) else [])
    plate = plates.steady(clip, dark, reached)
    truth = dataset.static(camera)
    return {
        "fire_left": plates.fire_left(plate, reached),
        "psnr_fire": psnr(plate / 255, truth, reached),
        "psnr": psnr(plate / 255, truth),
    }


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(PlateWindow, prog="python -m gof_benchmark.evidence.plate_window", args=argv)
    dataset = Dataset.open(config.dataset)
    names = [camera.name for camera in dataset.cameras]
    print(f"| window (frames) | fire left, % ({', '.join(names)}) | PSNR where fire was | PSNR |\n|---|---|---|---|")
    rows = []
    for window in config.windows:
        each = [measure(dataset, c, config, window) for c in range(len(names))]
        rows.append({"window": window, **{key: [row[key] for row in each] for key in each[0]}})
        left = ", ".join(f"{100 * row['fire_left']:.2f}" for row in each)
        scores = " | ".join(", ".join(f"{row[key]:.1f}" for row in each) for key in ("psnr_fire", "psnr"))
        print(f"| {window} | {left} | {scores} |", flush=True)
    if config.json:
        write_json(config.json, rows)


if __name__ == "__main__":
    main()
