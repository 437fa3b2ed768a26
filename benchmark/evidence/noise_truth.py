"""How far fine noise moves the drawn light from the gas that the truth tells of, and how fast it does so.

    python -m gof_benchmark.evidence.looks_sheet --work WORK --out SHEET --fires demo --frames 36 --rate-hz 100 \\
        --percentage 12 --samples 2 --lights soot soot_noise
    python -m gof_benchmark.evidence.noise_truth WORK/demo_soot WORK/demo_soot_noise

Takes about 3 min, with the bakes.

The same fire baked without and with the effect `fine_noise`. Mantaflow's noise is a curl noise (Kim et al. 2008): the
curl of a wavelet noise, as strong as the flow's small eddies, moves flame and soot on a finer grid, and never the gas.

Distance: from the edge of the drawn flame, where it is half of its highest value, to the edge of the flame without
noise. Speed: what changes between two frames in the difference of the two flames, after the true velocity has carried
it along, over the flame's gradient. The reaction is in both flames, and leaves the difference for the most part; errors
of the carrying do not, so this is more than the noise's own speed across the edge, not less.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import tyro

from gof_benchmark.evidence import child

FINER = 4  # voxels a cell of the flow, along a side, that flames are compared on
HALF = 0.5


@dataclass(frozen=True)
class NoiseTruth:
    """Compare the flame of a bake with fine noise to that of the same bake without."""

    without: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="WITHOUT")]]
    """Folder of a dataset whose fire is baked."""
    noisy: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="WITH")]]
    """The same with the effect."""
    frames: int = 6
    """For the clip that are compared, evenly over it; each with the one after it."""


@dataclass(frozen=True)
class Step:
    """Flame (X, Y, Z) on the drawn grid, velocity (X, Y, Z, 3) in m/s on the flow's, edge of a cell of the flow, m."""

    flame: np.ndarray
    velocity: np.ndarray
    cell_m: float


def main(argv: list[str] | None = None) -> None:
    """Print the means over the frames."""
    config = tyro.cli(NoiseTruth, prog="python -m gof_benchmark.evidence.noise_truth", args=argv)
    with TemporaryDirectory() as folder:
        places = [Path(folder) / name for name in ("without", "with")]
        for dataset, place in zip((config.without, config.noisy), places, strict=True):
            step_s, frames = child.call(read, str(dataset.resolve()), str(place), config.frames)
        found = np.mean([compare(*places, frame, step_s) for frame in frames], axis=0)
    moved, cell, far, farthest, speed, gas = found
    print(f"velocity of the gas, with noise from without: {moved:.2g} of it (relative L2)")
    print(f"edge of the drawn flame from that of the gas: mean {1000 * far:.1f} mm, {far / cell:.2f} cells of the flow")
    print(f"  95 % of it within {1000 * farthest:.1f} mm, {farthest / cell:.2f} cells")
    print(f"speed of that edge that is not in the truth: rms at most {speed:.2f} m/s, where the gas has {gas:.2f} m/s")


def compare(without: Path, noisy: Path, frame: int, step_s: float) -> tuple[float, ...]:
    """Compare one frame: relative L2 of velocities, cell (m), distance (m), its 95th percentile, speed and gas
    (m/s)."""
    (plain, noise), (plain_next, noise_next) = (
        [load(place, k) for place in (without, noisy)] for k in (frame, frame + 1)
    )
    moved = np.linalg.norm(noise.velocity - plain.velocity) / np.linalg.norm(plain.velocity)
    shape = tuple(FINER * n for n in plain.velocity.shape[:3])
    voxel_m = plain.cell_m / FINER
    distance = voxel_m * edge_distance(resampled(noise.flame, shape), resampled(plain.flame, shape))
    speed, gas = own_speed(plain, noise, plain_next, noise_next, step_s)
    return moved, plain.cell_m, float(distance.mean()), float(np.percentile(distance, 95)), speed, gas


def edge_distance(drawn: np.ndarray, gas: np.ndarray) -> np.ndarray:
    """From every voxel at the edge of the one flame to the nearest at the edge of the other, voxels."""
    from scipy.ndimage import distance_transform_edt

    edges = [edge(flame > HALF * flame.max()) for flame in (drawn, gas)]
    return distance_transform_edt(~edges[1])[edges[0]]


def edge(inside: np.ndarray) -> np.ndarray:
    """Voxels of a body that touch the outside with a face."""
    from scipy.ndimage import binary_erosion

    return inside & ~binary_erosion(inside)


def own_speed(plain: Step, noise: Step, plain_next: Step, noise_next: Step, step_s: float) -> tuple[float, float]:
    """Return (rms speed of the drawn edge against the gas, rms speed of the gas there), m/s, weighted by the edge's
    slope."""
    shape, cell = noise.flame.shape, noise.cell_m * noise.velocity.shape[0] / noise.flame.shape[0]
    velocity = np.stack([resampled(noise.velocity[..., axis], shape) for axis in range(3)], -1)
    before, after = (a.flame - resampled(b.flame, shape) for a, b in ((noise, plain), (noise_next, plain_next)))
    change = (after - carried(before, velocity * step_s / cell)) / step_s
    slope = sum(part**2 for part in np.gradient(noise.flame, cell))
    speed = np.sqrt((change**2).sum() / slope.sum())
    return float(speed), float(np.sqrt((slope * (velocity**2).sum(-1)).sum() / slope.sum()))


def carried(values: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return (X, Y, Z) values after they have moved by (X, Y, Z, 3) cells."""
    from scipy.ndimage import map_coordinates

    return map_coordinates(values, np.indices(values.shape) - np.moveaxis(cells, -1, 0), order=3, mode="nearest")


def resampled(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Cell-centred values on a grid of the same box with other cells."""
    from scipy.ndimage import zoom

    factors = [wanted / given for wanted, given in zip(shape, values.shape, strict=True)]
    return zoom(values.astype(np.float32), factors, order=1, mode="nearest", grid_mode=True)


def load(place: Path, frame: int) -> Step:
    with np.load(place / f"{frame}.npz") as data:
        return Step(data["flame"], data["velocity"], float(data["cell_m"]))


def read(dataset: str, out: str, count: int) -> tuple[float, list[int]]:
    """Write frames of a baked dataset as .npz; seconds from one to the next, and which were chosen. Needs bpy."""
    import bpy

    from gof_blender.pure import spec as scene_spec
    from gof_blender.pure.layout import Layout
    from gof_blender.scene import mantaflow
    from gof_blender.scene.fire_objects import find_flame
    from gof_blender.scene.mantaflow_source import MantaflowSource
    from gof_blender.scene.velocity import evaluated

    layout, folder = Layout(Path(dataset)), Path(out)
    spec = scene_spec.load(layout.spec)
    folder.mkdir()
    os.chdir(folder)  # Mantaflow leaves files where it runs
    mantaflow.enable()
    bpy.ops.wm.open_mainfile(filepath=str(layout.blend), use_scripts=False)
    source = MantaflowSource(spec)
    frames = np.unique(np.linspace(0, spec.clip.frames - 2, count).astype(int)).tolist()
    for frame in sorted({k + more for k in frames for more in (0, 1)}):
        step = spec.timeline.blender_frame(frame)
        velocity = source.velocity(step)
        domain = evaluated(find_flame())
        fine = np.empty(len(domain.flame_grid), np.float32)
        domain.flame_grid.foreach_get(fine)
        finer = round((fine.size / np.prod(velocity.shape[:3])) ** (1 / 3))
        flame = fine.reshape([finer * n for n in velocity.shape[2::-1]]).transpose(2, 1, 0)  # x runs fastest
        cell_m = source.index_to_world[0, 0]
        np.savez(folder / f"{frame}.npz", flame=flame, velocity=velocity, cell_m=cell_m)
    return 1 / spec.clip.fps, frames


if __name__ == "__main__":
    main()
