"""The motion that is left when the footage is bad.

    python -m gof_benchmark.evidence.hard_cases DATASET --optimise [--out out/hard_cases]

Takes about 15 min.

DATASET (of `gof generate`, so that its true velocity is known) is spoiled in one way after the other, in memory. Scored
is the fused field before any optimisation, as it is seen and after the flow prior: L2, CosSim and speed of DVE, and the
share of the light whose velocity is within one standard deviation. With --optimise each is also reconstructed, as small
as other evidence is; scored are the Gaussians' gas velocity and the held-out pictures of what was filmed. Cases
that only a simulation can make (two flames, 8 degrees between cameras, 400 Hz, wind, a flame that flares up) are fires
of the benchmark of their own: `python -m gof_benchmark.training.flow_prior`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.description import DatasetDescription
from gof.core.fields import VelocityField
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import dve
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.observation import observe
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.settings import ReconstructionSettings
from gof.reconstruct.shrink import shrink
from gof_benchmark.evidence.choices import SMALL
from gof_benchmark.training.field_score import open_small, preview_field, score, within


@dataclass(frozen=True)
class HardCases:
    """Spoil a dataset in a dozen ways and score the motion that is still found."""

    dataset: tyro.conf.Positional[Path]
    """With true velocity, as `gof generate` writes it; ideally at 100 Hz or more."""
    optimise: bool = False
    """Also reconstruct each, and score the Gaussians."""
    out: Path = Path("out/hard_cases")
    """Folder for the reconstructions; finished ones are kept."""
    only: tuple[str, ...] = ()
    """Names of rows; all of them without."""


Picture = Callable[[np.ndarray, int, float], np.ndarray]
"""(H, W, 3) display sRGB from the same, the number of its camera, and its time in s."""


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
        return self.picture(self.full.image(camera, frame * self.step), camera, float(self.times_s[frame]))

    def static(self, camera: int) -> np.ndarray:
        return self.plate(self.full.static(camera), camera, float(self.times_s[0]))

    @property
    def velocity(self) -> Spoiled:
        return self

    def at(self, time_s: float) -> VelocityField:
        return self.true(time_s)


def spoiled(
    dataset: Dataset,
    picture: Picture = lambda image, *_: image,
    plate: Picture | None = None,
    turned: np.ndarray | None = None,
    step: int = 1,
    metres: bool = True,
) -> Spoiled:
    """Return the dataset with other pictures, in a world that is turned (3, 3), with every `step`-th frame only.

    Args:
        plate: what becomes of plates; without it what becomes of pictures.
        metres: whether the dataset says that its lengths are metres.
    """
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) if turned is None else turned

    def true(time_s: float) -> VelocityField:
        field = dataset.velocity.at(time_s)
        return VelocityField(field.velocity @ pose[:3, :3].T, pose @ field.index_to_world, field.time_s)

    cameras = [replace(c, world_to_camera=c.world_to_camera @ np.linalg.inv(pose)) for c in dataset.cameras]
    description = _every(dataset, step)
    if not metres:
        description = replace(description, provenance=dict(description.provenance) | {"scale": "unknown"})
    times = np.asarray(description.time_s)
    return Spoiled(dataset.path, description, cameras, times, dataset, step, picture, plate or picture, true)


def _every(dataset: Dataset, step: int) -> DatasetDescription:
    """Return the description with every `step`-th frame, of which every 8th is held out."""
    description = dataset.description
    times = tuple(dataset.times_s[::step].tolist())
    test = tuple(range(4, len(times), 8))
    train = tuple(sorted(set(range(len(times))) - set(test)))
    whole = (c for c in description.cameras if c.role != "around")  # those around have frames of their own
    cameras = tuple(replace(c, time_s=None if c.time_s is None else c.time_s[::step]) for c in whole)
    return replace(
        description, time_s=times, cameras=cameras, splits=replace(description.splits, train=train, test=test)
    )


def about_x(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def dim(share: float) -> Picture:
    """Give camera 0 so much of its light."""
    return lambda image, camera, _: linear_to_srgb(share * srgb_to_linear(image)) if camera == 0 else image


def noisy(levels: float) -> Picture:
    """Gaussian noise of so many of 255 levels, in every picture anew."""
    rng = np.random.default_rng(0)
    return lambda image, *_: np.clip(image + rng.normal(0, levels / 255, image.shape), 0, 1).astype(np.float32)


def behind_a_beam(dataset: Dataset) -> Picture:
    """Lay a dull grey beam, a tenth of the picture thick, across the middle of the flame in camera 0."""
    light = np.mean([dataset.image(0, f) - dataset.static(0) for f in dataset.train_frames[::4]], axis=0).sum(-1)
    upright = abs(dataset.cameras[0].world_to_camera[1, 2]) > 0.7  # else the camera lies on its side
    profile = light.clip(0).sum(1 if upright else 0)
    middle = round(float(profile @ np.arange(len(profile)) / profile.sum()))
    half = max(1, round(0.05 * len(profile)))
    rows = slice(max(middle - half, 0), middle + half)
    beam = (rows, slice(None)) if upright else (slice(None), rows)

    def hidden(image: np.ndarray, camera: int, _: float) -> np.ndarray:
        if camera == 0:
            image = image.copy()
            image[beam] = 0.3
        return image

    return hidden


def smoke(densest: float = 0.6, grey: float = 0.2) -> Picture:
    """Let wisps of grey smoke drift in front of every camera, half of the picture's width a second, each its own.

    Args:
        densest: share of the light that the thickest takes.   grey: display sRGB of what it adds instead.
    """

    def veiled(image: np.ndarray, camera: int, time_s: float) -> np.ndarray:
        height, width = image.shape[:2]
        rng = np.random.default_rng(camera)
        y, x = np.mgrid[:height, :width] / width
        wisps = np.zeros((height, width))
        for k in range(1, 6):
            towards, phase, bent = rng.uniform(0, 2 * np.pi, 3)
            across = np.cos(towards) * (x - 0.5 * time_s) + np.sin(towards) * (y + 0.2 * np.sin(3 * x + bent))
            wisps += np.sin(2 * np.pi * k * across + phase) / k
        veil = densest * np.clip(0.5 + wisps / 2, 0, 1)[..., None]
        return ((1 - veil) * image + veil * grey).astype(np.float32)

    return veiled


def plate_with_fire(dataset: Dataset) -> Picture:
    """As from a clip without a view before the fire: the darkest tenth that every pixel had."""

    def darkest(plate: np.ndarray, camera: int, _: float) -> np.ndarray:
        return np.quantile([dataset.image(camera, f) for f in dataset.train_frames], 0.1, axis=0).astype(np.float32)

    return darkest


def cases(dataset: Dataset) -> dict[str, Dataset]:
    """Return the dataset of each fault."""
    beam = behind_a_beam(dataset)
    rate = 1 / dataset.frame_time_s
    return {
        "nothing": spoiled(dataset),
        "metres unknown": spoiled(dataset, metres=False),
        "up is wrong by 15 degrees": spoiled(dataset, turned=about_x(15)),
        "the world lies on its side": spoiled(dataset, turned=about_x(90)),
        f"{rate / 2:.0f} Hz": spoiled(dataset, step=2),
        f"{rate / 4:.0f} Hz": spoiled(dataset, step=4),
        "90x160": shrink(dataset, 160),
        "one camera has a quarter of its light": spoiled(dataset, dim(0.25)),
        "noise of 4 levels of 255": spoiled(dataset, noisy(4)),
        "fire left in the plates": spoiled(dataset, plate=plate_with_fire(dataset)),
        "a beam in front of one camera": spoiled(dataset, beam),
        "smoke in front of every camera": spoiled(dataset, smoke(), plate=lambda plate, *_: plate),
    }


def fields_of(dataset: Dataset) -> tuple[FlowField, FlowField]:
    """As it is seen, and with the flow prior."""
    seen = preview_field(observe(dataset))
    return seen, FlowPrior.load().correct(seen, metres=dataset.description.in_metres)


def optimised(dataset: Dataset, out: Path) -> str:
    """L2 and CosSim of the Gaussians' gas, mean over the training frames; PSNR of the held-out flame, dB."""
    result = reconstruct(dataset, ReconstructionSettings.of(dataset, SMALL), out, anyway=True)
    gaussians = TransientGaussians.load(result.path)
    times = dataset.times_s[list(dataset.train_frames)].tolist()
    scores = [dve(gaussians, dataset.velocity.at(time_s), time_s) for time_s in times]
    l2, cosine = (np.mean([getattr(score, name) for score in scores]) for name in ("l2", "cos_sim"))
    return f"{l2:.3f}, {cosine:.3f}, {result.held_out.scores.psnr_flame:.1f} |"


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(HardCases, prog="python -m gof_benchmark.evidence.hard_cases", args=argv)
    dataset = open_small(config.dataset)
    more = ("optimised: L2, CosSim, flame dB |", "---|") if config.optimise else ("", "")
    print(f"| what is wrong | as seen: L2, CosSim, speed | with the prior | within | {more[0]}")
    print(f"|---|---|---|---|{more[1]}")
    for name, bad in cases(dataset).items():
        if config.only and name not in config.only:
            continue
        seen, gas = fields_of(bad)
        cells = [f"{s.l2:.3f}, {s.cos_sim:.3f}, {s.speed_ratio:.2f}" for s in (score(seen, bad), score(gas, bad))]
        last = optimised(bad, config.out / name.replace(" ", "_")) if config.optimise else ""
        print(f"| {name} | {cells[0]} | {cells[1]} | {within(gas, bad):.2f} | {last}", flush=True)


if __name__ == "__main__":
    main()
