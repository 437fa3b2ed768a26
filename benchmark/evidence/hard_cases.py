"""What is left of the motion when the footage is bad? Prints a table.

    python -m gof_benchmark.evidence.hard_cases DATASET

DATASET (of `gof generate`, so that its true velocity is known) is spoiled in one way after the other, in memory. Scored
is the fused field before any optimisation, as it is seen and after the flow prior: L2, CosSim and speed of DVE, the
pace that the prior assumes over the true one, and the share of the light whose velocity is within one standard
deviation. Cases that only a simulation can make (two flames, 8 degrees between cameras, 400 Hz, wind, a flame that
flares up) are fires of the benchmark of their own: `python -m gof_benchmark.training.flow_prior`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.colour import linear_to_srgb, srgb_to_linear
from gof.dataset import Dataset
from gof.dataset.description import DatasetDescription
from gof.fields import VelocityField
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.observation import observe
from gof.reconstruct.shrink import shrink
from gof_benchmark.field_score import score, within
from gof_benchmark.preview_field import open_small, preview_field


@dataclass(frozen=True)
class HardCases:
    """Spoil a dataset in a dozen ways and score the motion that is still found."""

    dataset: tyro.conf.Positional[Path]
    """With true velocity, as `gof generate` writes it; ideally at 100 Hz or more."""


Picture = Callable[[np.ndarray, int], np.ndarray]
"""(H, W, 3) display sRGB from the same, and the number of its camera."""


@dataclass(frozen=True)
class Spoiled(Dataset):
    """A dataset whose pictures are changed when they are read.

    Attributes:
        full: the dataset as it is.   step: frame i is frame i * step of it.
        picture, plate: what becomes of pictures with and without fire.
        true: its velocity.
    """

    full: Dataset
    step: int
    picture: Picture
    plate: Picture
    true: Callable[[float], VelocityField]

    def image(self, camera: int, frame: int) -> np.ndarray:
        return self.picture(self.full.image(camera, frame * self.step), camera)

    def static(self, camera: int) -> np.ndarray:
        return self.plate(self.full.static(camera), camera)

    @property
    def velocity(self) -> Spoiled:
        return self

    def at(self, time_s: float) -> VelocityField:
        return self.true(time_s)


def spoiled(
    dataset: Dataset,
    picture: Picture = lambda image, _: image,
    plate: Picture | None = None,
    turned: np.ndarray | None = None,
    step: int = 1,
) -> Spoiled:
    """The dataset with other pictures, in a world that is turned (3, 3), with every `step`-th frame only."""
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) if turned is None else turned

    def true(time_s: float) -> VelocityField:
        field = dataset.velocity.at(time_s)
        return VelocityField(field.velocity @ pose[:3, :3].T, pose @ field.index_to_world, field.time_s)

    cameras = [replace(c, world_to_camera=c.world_to_camera @ np.linalg.inv(pose)) for c in dataset.cameras]
    description = _every(dataset, step)
    times = np.asarray(description.time_s)
    return Spoiled(dataset.path, description, cameras, times, dataset, step, picture, plate or picture, true)


def _every(dataset: Dataset, step: int) -> DatasetDescription:
    """The description with every `step`-th frame, of which every 8th is held out."""
    said = dataset.description
    times = tuple(dataset.times_s[::step].tolist())
    test = tuple(range(4, len(times), 8))
    train = tuple(sorted(set(range(len(times))) - set(test)))
    cameras = tuple(replace(c, time_s=None if c.time_s is None else c.time_s[::step]) for c in said.cameras)
    return replace(said, time_s=times, cameras=cameras, splits=replace(said.splits, train=train, test=test))


def about_x(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def dim(share: float) -> Picture:
    """Camera 0 gets so much of its light."""
    return lambda image, camera: linear_to_srgb(share * srgb_to_linear(image)) if camera == 0 else image


def noisy(levels: float) -> Picture:
    """Gaussian noise of so many of 255 levels, in every picture anew."""
    rng = np.random.default_rng(0)
    return lambda image, _: np.clip(image + rng.normal(0, levels / 255, image.shape), 0, 1).astype(np.float32)


def behind_a_beam(dataset: Dataset) -> Picture:
    """A dull grey beam, a tenth of the picture thick, lies across the middle of the flame in camera 0."""
    light = np.mean([dataset.image(0, f) - dataset.static(0) for f in dataset.train_frames[::4]], axis=0).sum(-1)
    upright = abs(dataset.cameras[0].world_to_camera[1, 2]) > 0.7  # else the camera lies on its side
    profile = light.clip(0).sum(1 if upright else 0)
    middle = round(float(profile @ np.arange(len(profile)) / profile.sum()))
    half = max(1, round(0.05 * len(profile)))
    rows = slice(max(middle - half, 0), middle + half)
    beam = (rows, slice(None)) if upright else (slice(None), rows)

    def hidden(image: np.ndarray, camera: int) -> np.ndarray:
        if camera == 0:
            image = image.copy()
            image[beam] = 0.3
        return image

    return hidden


def plate_with_fire(dataset: Dataset) -> Picture:
    """As from a clip without a view before the fire: the darkest tenth that every pixel had."""

    def darkest(plate: np.ndarray, camera: int) -> np.ndarray:
        return np.quantile([dataset.image(camera, f) for f in dataset.train_frames], 0.1, axis=0).astype(np.float32)

    return darkest


def cases(dataset: Dataset) -> dict[str, tuple[Dataset, bool]]:
    """What is done to it -> the dataset, and whether its lengths are taken for metres."""
    beam = behind_a_beam(dataset)
    rate = 1 / dataset.frame_time_s
    return {
        "nothing": (spoiled(dataset), True),
        "metres unknown": (spoiled(dataset), False),
        "up is wrong by 15 degrees": (spoiled(dataset, turned=about_x(15)), True),
        "the world lies on its side": (spoiled(dataset, turned=about_x(90)), True),
        f"{rate / 2:.0f} Hz": (spoiled(dataset, step=2), True),
        f"{rate / 4:.0f} Hz": (spoiled(dataset, step=4), True),
        "90x160": (shrink(dataset, 160), True),
        "one camera has a quarter of its light": (spoiled(dataset, dim(0.25)), True),
        "noise of 4 levels of 255": (spoiled(dataset, noisy(4)), True),
        "fire left in the plates": (spoiled(dataset, plate=plate_with_fire(dataset)), True),
        "a beam in front of one camera": (spoiled(dataset, beam), True),
    }


def fields_of(dataset: Dataset, metres: bool) -> tuple[FlowField, FlowField]:
    """As it is seen, and with the flow prior."""
    seen = preview_field(observe(dataset))
    return seen, FlowPrior.load().correct(seen, metres=metres)


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(HardCases, prog="python -m gof_benchmark.evidence.hard_cases", args=argv)
    dataset = open_small(config.dataset)
    print("| what is wrong | as seen: L2, CosSim, speed | with the prior | within |")
    print("|---|---|---|---|")
    for name, (bad, metres) in cases(dataset).items():
        seen, gas = fields_of(bad, metres)
        cells = [f"{s.l2:.3f}, {s.cos_sim:.3f}, {s.speed_ratio:.2f}" for s in (score(seen, bad), score(gas, bad))]
        print(f"| {name} | {cells[0]} | {cells[1]} | {within(gas, bad):.2f} |", flush=True)


if __name__ == "__main__":
    main()
