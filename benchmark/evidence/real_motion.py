"""Does the flow prior leave the direction of a real flame as its footage shows it?

    python -m gof_benchmark.evidence.real_motion DATASET...

Takes about 15 s a dataset.

No truth is needed: DATASET may come from `gof ingest`. Per camera, the mean motion in its picture, weighted by light:
of the footage's own optical flow; of the velocities fused from all cameras; of those after the flow prior. Directions
are in degrees to the right of the picture's "up"; speeds are over the footage's.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.cameras import Camera
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.observation import Observation, observe
from gof_benchmark.training.field_score import open_small, preview_field

NEAR_DEG = 5


@dataclass(frozen=True)
class RealMotion:
    """Directions and speeds in every camera's picture, before and after the flow prior."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Datasets, of real footage too."""


def of_footage(observation: Observation, camera: int) -> np.ndarray:
    """Return (2,) px/s, mean of a camera's optical flow over all frames, weighted by the light above the plate."""
    flow, light = observation.flow[:, camera].astype(np.float64), observation.intensity[:, camera].astype(np.float64)
    known = np.isfinite(flow).all(-1) & observation.mask[:, camera]
    return (light[known][:, None] * flow[known]).sum(0) / light[known].sum()


def of_field(field: FlowField, camera: Camera) -> np.ndarray:
    """Return (2,) px/s, mean projected velocity over all voxels and frames, weighted by emission."""
    momentum = (field.emission[..., None] * field.velocity).sum(0)
    projected = np.einsum("vij,vj->i", camera.projection_jacobian(field.voxels.center), momentum)
    return projected / field.emission.sum()


def degrees(motion: np.ndarray) -> float:
    """To the right of the picture's "up" (its rows count downwards)."""
    return float(np.degrees(np.arctan2(motion[0], -motion[1])))


def turn(after: np.ndarray, before: np.ndarray) -> float:
    """Degrees from one direction to the other, -180 to 180."""
    return (degrees(after) - degrees(before) + 180) % 360 - 180


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(RealMotion, prog="python -m gof_benchmark.evidence.real_motion", args=argv)
    print("| dataset | camera | footage, degrees | fused: turned by, speed | with the prior: turned by, speed |")
    print("|---|---|---|---|---|")
    turned, faster = [], []
    for path in config.datasets:
        dataset = open_small(path)
        observation = observe(dataset)
        seen = preview_field(observation)
        gas = FlowPrior.load().correct(seen, metres=dataset.description.in_metres)
        for c, camera in enumerate(observation.cameras):
            footage = of_footage(observation, c)
            motions = [of_field(field, camera) for field in (seen, gas)]
            turns = [turn(m, footage) for m in motions]
            speeds = [float(np.linalg.norm(m) / np.linalg.norm(footage)) for m in motions]
            cells = [f"{angle:+.0f}, {speed:.2f}" for angle, speed in zip(turns, speeds, strict=True)]
            print(f"| {path.name} | {camera.name} | {degrees(footage):+.0f} | {cells[0]} | {cells[1]} |", flush=True)
            turned.append(abs(turns[1]))
            faster.append(speeds[1])
    print(f"\n| with the prior, {len(turned)} views | |\n|---|---|")
    print(f"| within {NEAR_DEG} degrees of the optical flow | {sum(t <= NEAR_DEG for t in turned)} of {len(turned)} |")
    print(f"| farthest from it, degrees | {max(turned):.0f} |")
    print(f"| gas over light | {min(faster):.1f} to {max(faster):.1f} |")


if __name__ == "__main__":
    main()
