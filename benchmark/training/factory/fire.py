"""A fire from its number: burnt, filmed, and handed over as the product's stages read a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gof.core.cameras import Camera
from gof.core.description import held_out
from gof.core.errors import GofError
from gof.core.fields import GridSequence, VelocityField, VelocitySequence, open_array
from gof_benchmark.generator.blender_process import run_stage
from gof_benchmark.training.factory.draws import Draw
from gof_benchmark.training.factory.light import emission
from gof_benchmark.training.factory.pictures import around, developed, gathered, still_scene
from gof_blender.pure.layout import Layout

FAINT = 0.05  # of the bright cells' light: what is dimmer is not what the cameras are turned to
LEAVING = 0.5  # of the brightest layer's light: a flame with more in the top layer leaves the box


class PoorFireError(GofError):
    """A fire that nobody should learn from: it went out, or left its box."""


@dataclass(frozen=True)
class TrueVelocity:
    """Velocity of the gas at the frames of a clip; stands where a dataset's `velocity` does.

    Attributes:
        times_s: (F,).    grids: (F, X, Y, Z, 3) float16 m/s.    index_to_world: as of `VelocityField`.
    """

    times_s: np.ndarray
    grids: np.ndarray
    index_to_world: np.ndarray

    def at(self, time_s: float) -> VelocityField:
        """Return the field of the nearest frame."""
        frame = int(np.abs(self.times_s - time_s).argmin())
        return VelocityField(self.grids[frame], self.index_to_world, float(self.times_s[frame]))


@dataclass(frozen=True)
class Recording:
    """A fire as `gof.reconstruct.observation.observe` reads a dataset: no files, one clock.

    Attributes:
        path: a name for messages; nothing is there.
        cameras: C.    times_s: (F,).    train_frames: those that a method may look at.
        statics: (C, H, W, 3), images: (C, F, H, W, 3), display sRGB float32.
        velocity: the truth.
    """

    path: Path
    cameras: list[Camera]
    times_s: np.ndarray
    train_frames: list[int]
    statics: list[np.ndarray]
    images: list[np.ndarray]
    velocity: TrueVelocity

    @property
    def frame_time_s(self) -> float:
        return float(np.median(np.diff(self.times_s)))

    def camera_times_s(self, camera: int) -> np.ndarray:
        """Return (F,) s; all cameras keep the common clock."""
        return self.times_s

    def static(self, camera: int) -> np.ndarray:
        """Return (H, W, 3) display sRGB, the view without fire."""
        return self.statics[camera]

    def image(self, camera: int, frame: int) -> np.ndarray:
        """Return (H, W, 3) display sRGB."""
        return self.images[camera][frame]

    def board_weight(self, camera: int) -> None:
        """Return None: no sync board is in sight."""


def make_fire(draw: Draw) -> Recording:
    """Burn and film a fire; the same number gives the same fire.

    Raises:
        PoorFireError: it went out, or left its box.
        GofError: its bake failed.
    """
    light, velocity, matrix = burn(draw)
    lit = _lit(light)
    low, high = np.argwhere(lit).min(0), np.argwhere(lit).max(0) + 1
    rng = np.random.default_rng([2208, draw.number])
    cell, origin = matrix[0, 0], matrix[:3, 3]
    cameras = around(
        origin + cell * low, origin + cell * high, draw.azimuth_deg, draw.height_deg, draw.away, draw.longest_px
    )
    clip = draw.spec.clip
    times = np.arange(clip.frames) / clip.fps
    clear = [gathered(camera, light, matrix) for camera in cameras]
    bright = np.quantile(np.concatenate([c[c > 0.02 * c.max()] for c in clear]), 0.9)
    if draw.thickness:  # a ray through the bright part has that optical depth
        clear = [gathered(camera, light, matrix, draw.thickness / bright) for camera in cameras]
        bright = np.quantile(np.concatenate([c[c > 0.02 * c.max()] for c in clear]), 0.9)
    statics, images = [], []
    for camera, seen in zip(cameras, clear, strict=True):
        seen = seen * (draw.exposure / bright)
        plate = still_scene(camera, draw.plate, rng)
        left = draw.plate_fire * seen[:1]
        statics.append(next(developed(left, draw.colour, plate, 0.0, rng)))
        images.append(np.stack(list(developed(seen, draw.colour, plate, draw.noise, rng))))
    truth = TrueVelocity(times, velocity, matrix)
    train = list(held_out(clip.frames).train)
    return Recording(Path(f"fire_{draw.number:05d}"), cameras, times, train, statics, images, truth)


def burn(draw: Draw) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bake a fire by the generator; keep nothing of it on disk.

    Returns:
        light (F, X, Y, Z) float32, any unit; velocity (F, X, Y, Z, 3) float16 m/s; `index_to_world`.
    """
    with TemporaryDirectory(prefix="gof-fire-") as folder:
        layout = Layout(Path(folder) / draw.spec.name)
        layout.claim(draw.spec)
        for stage in ("bake", "ground-truth"):
            run_stage(stage, layout.root)
        velocity = VelocitySequence.open(layout.velocity)
        flame, heat = (GridSequence(open_array(layout.grid(name)), name) for name in ("flame", "heat"))
        frames = range(draw.spec.clip.frames)
        burning, hot, gas = (np.stack([grid.cells(f) for f in frames]) for grid in (flame, heat, velocity))
        return emission(draw.law, burning, hot), gas.astype(np.float16), velocity.index_to_world


def _lit(light: np.ndarray) -> np.ndarray:
    """Return (X, Y, Z) bool, where the clip shines. Raises as `make_fire`."""
    brightest = light.max(0)
    lit = brightest > FAINT * np.sort(brightest, None)[-20]
    if brightest.max() <= 0 or lit.sum() < 60:
        raise PoorFireError("the flame is but a spark: nothing to learn from")
    layers = light.mean((0, 1, 2))
    if layers[-1] > LEAVING * layers.max():
        raise PoorFireError("the flame leaves its box through the top")
    return lit
