"""Do a reconstruction's bright structures climb as fast as those of the footage?

    python -m gof_benchmark.evidence.rise_speed DATASET RESULT ...

Takes about 20 s a dataset, once it is reconstructed.

No truth is needed: DATASET may come from `gof ingest`, RESULT is a folder of `gof reconstruct`, at whose picture size
all is measured. Per camera: the slope of bright traces in the picture of height against time
(below), of the footage; and over it, that of the reconstruction drawn at the same times,
and drawn four times as often, where a flame whose Gaussians only fade out and in would stand still between frames.
"gas" is the mean upward motion of the Gaussians themselves, weighted by what they show: texture lags behind the gas, so
this is to be more.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.ndimage import gaussian_filter1d, map_coordinates

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.core.records import read_record
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.footage.flame_mask import flame_mask
from gof.reconstruct.observation import light_above
from gof.reconstruct.settings import FILE, ReconstructionSettings
from gof.reconstruct.shrink import shrink
from gof.render import render

OFTENER = 4
NEAR = 0.15  # of the footage's speed


@dataclass(frozen=True)
class RiseSpeed:
    """The slope of bright traces in height against time, footage and reconstruction."""

    pairs: tyro.conf.Positional[tuple[Path, ...]]
    """Dataset, result, dataset, result, ..."""


def flames_place(dataset: Dataset, camera: int) -> np.ndarray:
    """Return (H, W) bool: where the footage ever has flame, which a board's lights are not."""
    static = dataset.static(camera)
    return np.any([flame_mask(dataset.image(camera, k), static) for k in range(len(dataset.times_s))], axis=0)


def rows_of(picture: np.ndarray, plate: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return (R,) light above the plate in every row that the flame's place has."""
    light = light_above(picture, plate[..., :3])[..., 1] * place
    return light.sum(1)[place.any(1)]


def drawn_rows(
    gaussians: TransientGaussians, camera: Camera, plate: np.ndarray, place: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return (T, R) light of the reconstruction at these times."""
    behind = plate if gaussians.dynamic.all() else None
    pictures = (render(gaussians, camera, float(t), background=behind)["color"] for t in times)
    return np.stack([rows_of(np.clip(picture, 0, 1), plate, place) for picture in pictures])


def gas_climb(gaussians: TransientGaussians, dataset: Dataset, camera: int, time_s: float) -> float:
    """px/s towards the top of the picture, mean over Gaussians, weighted by opacity times area."""
    moving = gaussians[gaussians.dynamic]
    place, alpha = moving.at(time_s)
    jacobian = dataset.cameras[camera].projection_jacobian(place)
    weight = alpha * np.prod(np.sort(moving.scale, 1)[:, 1:], axis=1)
    up = -np.einsum("nj,nj->n", jacobian[:, 1], moving.moving_gas)
    known = np.isfinite(up)
    return float((weight * up)[known].sum() / weight[known].sum())


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(RiseSpeed, prog="python -m gof_benchmark.evidence.rise_speed", args=argv)
    print("| dataset | camera | footage, px/s | drawn at the frames | drawn four times as often | gas |")
    print("|---|---|---|---|---|---|")
    climbs = []
    for folder, result in zip(config.pairs[::2], config.pairs[1::2], strict=True):
        made_with = read_record(ReconstructionSettings, result / FILE)
        dataset = shrink(Dataset.open(folder), made_with.longest_side)
        gaussians = TransientGaussians.load(result / "result.npz")
        frame_s = dataset.frame_time_s
        for c, camera in enumerate(dataset.cameras):
            times = dataset.camera_times_s(c)
            between = np.interp(np.arange(0, len(times) - 1, 1 / OFTENER), np.arange(len(times)), times)
            plate = background(dataset, c, result)
            place = flames_place(dataset, c)
            seen = np.stack([rows_of(dataset.image(c, k), plate, place) for k in range(len(times))])
            footage = climb(seen, frame_s)
            apart = tuple(OFTENER * n for n in (2, 3, 4, 5, 6))
            drawn = climb(drawn_rows(gaussians, camera, plate, place, times), frame_s)
            often = climb(drawn_rows(gaussians, camera, plate, place, between), frame_s / OFTENER, apart)
            middle = float(times[len(times) // 2])
            cells = [drawn, often, gas_climb(gaussians, dataset, c, middle)]
            climbs.append(drawn / footage)
            ratios = " | ".join(f"{cell / footage:.2f}" for cell in cells)
            print(f"| {folder.name} | {camera.name} | {footage:.0f} | {ratios} |", flush=True)
    near = sum(abs(climb - 1) <= NEAR for climb in climbs)
    print(f"\n| drawn at the frames, {len(climbs)} views | |\n|---|---|")
    print(f"| within {NEAR:.0%} of the footage | {near} of {len(climbs)} |")


# ----------------------------------------------------------------
# How fast bright structures climb in a clip, from the slope of their traces in a picture of height against time.
#
# As a person does it with a ruler on such a picture, who needs no optical flow and no truth.

FADE = 0.06  # of the height: structures larger than this are the flame's own shape
SPEEDS = 240  # that are tried between no motion and the fastest
FARTHEST = 0.25  # of the height: no structure is followed farther


def traces(light: np.ndarray) -> np.ndarray:
    """Return (T, H): what of a clip's light per row and frame moves: without its mean over time, and without broad
    shapes.

    Args:
        light: (T, H) light of every row, from the top of the picture, >= 0.
    """
    steady = light - light.mean(0)
    fine = steady - gaussian_filter1d(steady, FADE * light.shape[1], axis=1, mode="nearest")
    spread = fine.std(0)  # faint rows count as bright ones do, but for those with next to no light
    return fine / np.maximum(spread, 0.05 * spread.max(initial=1e-12))


def climb(light: np.ndarray, frame_s: float, frames_apart: tuple[int, ...] = (2, 3, 4, 5, 6)) -> float:
    """Return speed of the traces, px/s, positive towards the top: that at which rows agree best with later ones above
    them.

    Args:
        light: (T, H).   frame_s: between frames.
        frames_apart: pairs of frames that are compared; over many the structures have changed, over one the slope is
            drawn from a pixel or two.
    Returns:
        nan where the clip is too short or nothing changes.
    """
    height = light.shape[1]
    moving = traces(light)
    if len(light) <= 2 * max(frames_apart) or not moving.any():
        return float("nan")
    speeds = np.linspace(0, FARTHEST * height / max(frames_apart), SPEEDS)  # px per frame
    agreement = np.zeros(SPEEDS)
    for apart in frames_apart:
        first, later = moving[:-apart], moving[apart:]
        for k, speed in enumerate(speeds):
            rows = np.arange(np.ceil(speed * apart), height)
            frame = np.repeat(np.arange(len(later))[:, None], len(rows), 1)
            above = map_coordinates(later, [frame, np.broadcast_to(rows - speed * apart, frame.shape)], order=1)
            below = first[:, rows.astype(int)]
            agreement[k] += (below * above).mean() / np.sqrt((below**2).mean() * (above**2).mean() + 1e-30)
    best = int(np.argmax(agreement))
    return float((speeds[best] + _offset(agreement, best) * speeds[1]) / frame_s)


def _offset(values: np.ndarray, best: int) -> float:
    """Return where the parabola through the best value and its neighbours is highest, in steps."""
    if not 0 < best < len(values) - 1:
        return 0.0
    left, middle, right = values[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0


if __name__ == "__main__":
    main()
