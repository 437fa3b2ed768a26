"""How right are a flame's axis and the speed of its core, found from pictures alone? Prints a table.

    python -m gof_benchmark.evidence.core_speed DATASET...

Per dataset (with true velocities): degrees between the axis and the true mean velocity of the light; the mean speed
along the axis, over the true one within half a radius of it: of the fused optical flow there, and of the core; how well
the layers agree; and the core's ratio again when the light of every frame is made to flicker, as exposure does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from scipy.ndimage import gaussian_filter1d

from gof.dataset import Dataset
from gof.reconstruct.core_speed import core_speed
from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.observation import observe
from gof.reconstruct.presets import METHODS
from gof.reconstruct.shrink import shrink

LONGEST_SIDE, VOXELS = 320, 72  # as `gof reconstruct --preset preview`
FLICKER, FLICKER_S = 0.4, 0.012  # standard deviation of the factor on the light, and how fast it changes


@dataclass(frozen=True)
class CoreSpeedEvidence:
    """Axis and core speed against the truth of generated datasets."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Generated datasets (with ground-truth velocity)."""


@dataclass(frozen=True)
class Row:
    """One dataset; ratios are over the true speed near the axis."""

    off_deg: float
    seen: float
    core: float
    agreement: float
    core_in_flicker: float


def measure(dataset: Dataset, field: FlowField) -> Row | None:
    """None where nothing moves."""
    axis = FlameAxis.of(field)
    if axis is None:
        return None
    layers, voxels = axis.layers, field.voxels
    times = np.array([frame.time_s for frame in field.frames])
    truth = [dataset.velocity.at(t).sample(voxels.center) for t in times]
    momentum = sum((f.emission[:, None] * v).sum(0) for f, v in zip(field.frames, truth, strict=True))
    off = np.degrees(np.arccos(np.clip(momentum @ layers.direction / np.linalg.norm(momentum), -1, 1)))

    offset = layers.sideways(voxels.center - axis.sections.middle[layers.nearest])
    near = np.linalg.norm(offset, axis=1) < 0.5 * axis.sections.radius[layers.nearest]
    weight = axis.mean_light[layers.nearest] * near / np.maximum(layers.sums(near * 1.0), 1e-9)[layers.nearest]

    def mean(along: np.ndarray) -> float:
        return float((weight * along).sum() / weight.sum())

    true = mean(np.mean(truth, 0) @ layers.direction)
    seen = mean(field.velocity.mean(0) @ layers.direction)
    core = core_speed(axis, times)
    noise = gaussian_filter1d(np.random.default_rng(0).normal(size=len(times)), FLICKER_S / np.median(np.diff(times)))
    light = axis.light * np.maximum(1 + FLICKER * noise / noise.std(), 0.1)[:, None]
    flickering = core_speed(replace(axis, light=light, mean_light=light.mean(0)), times)
    agreement = float((axis.mean_light * core.agreement).sum() / axis.mean_light.sum())
    ratios = [mean(speed[layers.nearest]) / true for speed in (core.speed, flickering.speed)]
    return Row(float(off), seen / true, ratios[0], agreement, ratios[1])


def main(argv: list[str] | None = None) -> None:
    """Print a row per dataset."""
    config = tyro.cli(CoreSpeedEvidence, prog="python -m gof_benchmark.evidence.core_speed", args=argv)
    print("| fire | axis off, degrees | seen / true | core / true | layers agree | core / true in flicker |")
    print("|---|---|---|---|---|---|")
    for path in config.datasets:
        dataset = shrink(Dataset.open(path), LONGEST_SIDE)
        row = measure(dataset, seen_flow_field(observe(dataset), METHODS["gof"], VOXELS))
        if row is None:
            print(f"| {path.name} | nothing moves | | | | |", flush=True)
            continue
        figures = (
            f"{row.off_deg:.0f} | {row.seen:.2f} | {row.core:.2f} | {row.agreement:.2f} | {row.core_in_flicker:.2f}"
        )
        print(f"| {path.name} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
