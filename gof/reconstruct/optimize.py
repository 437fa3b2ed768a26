"""Optimising transient flame Gaussians against the training pictures, in their surroundings, with Dr.Jit.

Loss (paper): 0.8 L1 + 0.2 (1 - SSIM) + 0.1 mean(A_dyn (1 - M)), one random training picture a step; ours adds the mean
squared difference (`Method.square_loss`), and takes as many pictures at once as share no Gaussian (`batches`). Every
picture is drawn at its own camera's time, and line by line when that camera has a rolling shutter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import drjit as dr
import numpy as np

from gof.core.colour import srgb_to_linear
from gof.core.errors import NonFiniteError
from gof.core.gaussians import TransientGaussians
from gof.reconstruct.batches import Batch, TrainingPictures, count_together, sort_by_picture
from gof.reconstruct.checkpoint import Spent, load_checkpoint, save_checkpoint
from gof.reconstruct.density import DensityControl
from gof.reconstruct.memory import give_back
from gof.reconstruct.methods import LAST_SHARE, LONGEST_HELD, Rates, cameras_extent
from gof.reconstruct.needles import blunt, is_one_sided
from gof.reconstruct.observation import Observation
from gof.reconstruct.palette import find_palette
from gof.reconstruct.parameters import Raw, alight, from_raw, per_gaussian, recolor, splats, to_raw
from gof.reconstruct.surroundings import DrawnView, Surroundings
from gof.reconstruct.unseen import UnseenView, UnseenViews
from gof.reconstruct.windows import Windows
from gof.render import l1_ssim, render_splats
from gof.render.adam import Adam
from gof.render.backend import Float, UInt, floats, opaque, whole_numbers
from gof.render.light import sum_light, to_display, to_light
from gof.render.rasterizer import Frame
from gof.render.scene import Stack

SSIM_WEIGHT = 0.2
STEEPEST = 0.25  # slope of a colour by its logit, at middle grey
PLAIN_PLATES = 0.05, 0.35  # display values of the plates behind unseen views
CHECK_EVERY = 50  # steps, of a picture each, between looks at the loss (a synchronisation) and at NaN
CHECKPOINT_EVERY = 500
UNSEEN_EVERY = 2  # batches; as good as in each, for a fifth less time
BLUNT_EVERY = 250  # steps
RECOLOR_EVERY, PULL = 25, 0.3  # steps; share of a colour's way to the palette
FREE = 1 / 8  # of the steps, the last ones, without, unless `Palette.held`: own pictures gain half of what it costs
LEAST_STEP = 1e-12  # of thickness, between two levels
EVALUATE_AT = (250, 500, 1000, 2000, 4000, 7000, 15_000, 30_000)  # and at the last step; the paper's are 1k, 7k, 30k


@dataclass(frozen=True)
class Schedule:
    """Step counts, learning rates and loss weights. A step is one picture's; a batch's count one each.

    Attributes:
        square_loss: of the mean squared difference of pictures.
        alpha_loss: of flame where no flame may be.
        unseen: of views from where no camera stood (`gof.reconstruct.unseen`), in every `UNSEEN_EVERY`-th batch.
        plate_loss: of a plate's change. L1 moves a channel of its pixel by 0.8 of what of it shows through the flame,
            so the pixel may leave the plate that was made by 0.4 of that: far where it is seen, hardly where opaque
            flame always covers it and nothing but noise would move it.
    """

    iterations: int
    rates: Rates
    gas_apart: bool  # see `gof.reconstruct.methods.Method`, as the next two
    density_control: bool = False
    color_of_light: bool = True
    square_loss: float = 0.0
    alpha_loss: float = 0.1
    unseen: float = 0.0
    plate_loss: float = 1.0
    seed: int = 0  # of the order of the pictures

    def raw_rates(self, units: Units, step: int = 0) -> dict[str, float]:
        """Learning rate of each raw parameter (see `parameters`) at a step, in m and s.

        The position's falls exponentially from the first to the last step, the others' as `Rates.held` says.
        """
        rates, falls = self.rates, 1.0
        color = ("color_logit", rates.color / STEEPEST) if self.color_of_light else ("color", rates.color)
        first, last = rates.position
        if rates.held is not None:
            held = min(rates.held * self.iterations, LONGEST_HELD)
            falls = LAST_SHARE ** max((step - held) / max(self.iterations - held, 1), 0)
        return {
            "x0": first * units.voxel_size * (last / first) ** (step / max(self.iterations, 1)),
            "velocity": falls * rates.velocity * units.voxel_size / units.frame_time_s,
            "t_mu": falls * rates.t_mu * units.frame_time_s,
            "log_t_sigma": falls * rates.log_t_sigma,
            "scale": falls * rates.scale,
            "rotation": falls * rates.rotation,
            "opacity": falls * rates.opacity,
            color[0]: falls * color[1],
        }


@dataclass(frozen=True)
class Units:
    """Units of the schedule's lengths and times. voxel_size: m, bounds the scale too. frame_time_s: s."""

    voxel_size: float
    frame_time_s: float


class Monitor(Protocol):
    """Listeners to the optimisation while it runs."""

    def progress(self, done: int, total: int, note: str) -> None:
        """Take the count of steps done, and the loss in words."""

    def evaluate(self, step: int, gaussians: TransientGaussians, plates: list[np.ndarray]) -> str | None:
        """Return what to show of the held-out pictures, at EVALUATE_AT and the last step, or None.

        Args: see `Surroundings.result`.
        """

    def spent(self) -> Spent:
        """Cost of the steps done, in all runs; kept in the checkpoint."""


def optimize(
    seeds: TransientGaussians,
    observation: Observation,
    windows: Windows,
    surroundings: Surroundings,
    schedule: Schedule,
    units: Units,
    checkpoint: Path,
    monitor: Monitor,
    unseen: UnseenViews | None = None,
) -> tuple[TransientGaussians, list[np.ndarray]]:
    """Optimise all parameters of `seeds`, and what may move of their surroundings.

    Args:
        observation: training pictures (those that were delivered are used), their times and masks.
        windows: the part of each camera's that is drawn and learned from; `surroundings` are those of these parts.
        checkpoint: file to resume from and to write every 500 steps (removed by the caller when done); a disk too full
            for it is reported and does not end the run.
        unseen: what holds the Gaussians where no camera sees; None: nothing does.
    Returns:
        the optimised Gaussians in their surroundings, see `Surroundings.result`; without density control the same
        number, in the same order.
    Raises:
        NonFiniteError: the loss or a parameter became NaN or Inf; names the parameter and the step.
    """
    pixels = windows.width * windows.height
    together = 1 if schedule.density_control else count_together(seeds.t_sigma, observation.time_s, pixels)
    flame = Flame(seeds, observation, windows, surroundings, schedule, units, together)
    pictures = TrainingPictures(observation, windows, unseen, together)
    give_back()
    done = load_checkpoint(checkpoint, flame.optimizer, resized=schedule.density_control)
    total, mean_loss, held_out = schedule.iterations, None, None
    monitor.progress(done, total, note="")  # the time left is counted from here
    while done < total:
        before, (loss, taken) = done, take_step(done, flame, pictures, schedule, units)
        done += taken
        last = done == total
        if last or any(before < step <= done for step in EVALUATE_AT):
            _require_finite(float(loss.array[0]), flame.optimizer, before)
            held_out = monitor.evaluate(done, *flame.state())
        if last or is_due(CHECK_EVERY, before, done):
            value = float(loss.array[0])
            _require_finite(value, flame.optimizer, before)
            mean_loss = value if mean_loss is None else 0.8 * mean_loss + 0.2 * value
            monitor.progress(done, total, note=_note(mean_loss, held_out))
        if is_due(CHECKPOINT_EVERY, before, done):
            save_checkpoint(checkpoint, flame.optimizer, done, monitor.spent())
    return flame.state()


def is_due(every: int, before: int, done: int) -> bool:
    """Whether steps from `before` to `done` reach or pass a multiple of `every`."""
    return done // every > before // every


def take_step(done: int, flame: Flame, pictures: TrainingPictures, schedule: Schedule, units: Units) -> tuple[Any, int]:
    """Draw the next batch after so many pictures, and move what it shows against the loss.

    Returns:
        the loss, a Dr.Jit tensor of one number, and the count of pictures.
    """
    batch = pictures.choose(schedule.seed, done, schedule.iterations - done)
    flame.optimizer.set_learning_rate(schedule.raw_rates(units, done))
    rng = np.random.default_rng((schedule.seed, done, 1))
    also = pictures.unseen is not None and schedule.unseen > 0 and batch.number % UNSEEN_EVERY == 0
    unseen = pictures.unseen.choose(batch.frames, rng) if pictures.unseen and also else None
    shown = flame.shown(batch, unseen)
    drawn = flame.drawn(shown, batch)
    loss = _loss(drawn, pictures, batch, schedule, clipped=flame.surroundings.emissive)
    if unseen is not None:
        loss += schedule.unseen * flame.loss_unseen(shown, unseen, rng.uniform(*PLAIN_PLATES, 3))
    loss += schedule.plate_loss * flame.surroundings.moved(batch.c, flame.optimizer)
    dr.backward(loss)
    flame.watch(done, drawn.frame, batch.c)
    flame.optimizer.step(len(batch.frames))
    flame.change(done, done + len(batch.frames))
    dr.eval(list(flame.optimizer.values()))
    return loss, len(batch.frames)


class BatchGaussians(NamedTuple):
    """The Gaussians that a batch draws: raw parameters, and the picture of each; None where it is one."""

    raw: Raw
    stack: Stack | None


class Flame:
    """The unknowns: raw parameters of the Gaussians, and of their surroundings where they may move, in Adam's hands."""

    def __init__(
        self,
        seeds: TransientGaussians,
        observation: Observation,
        windows: Windows,
        surroundings: Surroundings,
        schedule: Schedule,
        units: Units,
        together: int = 1,
    ):
        """together: pictures of a batch, at most."""
        self.cameras = windows.cameras(observation.cameras)
        self.read_s = observation.camera_time_s + windows.read_later_s(observation.cameras)[:, None]
        self.surroundings = surroundings
        self.voxel_size = units.voxel_size
        # Pictures show light: they know nothing of the gas, and nothing of how sure its velocity is. Nor does anybody
        # of a clone, until the gas is looked up again (`gas`).
        gas_velocity = seeds.gas_velocity if schedule.gas_apart else None
        self._kept: dict[str, Any] = {"datum": seeds.datum}
        if not schedule.density_control:
            self._kept |= {"gas_velocity": gas_velocity, "velocity_sd": seeds.velocity_sd}
        # Light that the side misses of a needle comes back in its views.
        self._blunts = schedule.unseen > 0 and is_one_sided(self.cameras, np.median(seeds.position, axis=0))
        self.start_s = float(self.read_s.min())
        plates = surroundings.unknowns()
        raw = to_raw(seeds, self.voxel_size, self.start_s, schedule.color_of_light) | plates
        rates = schedule.raw_rates(units) | dict.fromkeys(plates, together * schedule.rates.plate)
        # The loss is a mean over pixels, so gradients are tiny: epsilon must not be what sets the step.
        betas = {"beta_1": schedule.rates.beta_1, "beta_2": schedule.rates.beta_2}
        self.optimizer = Adam(lr=1.0, params=raw, epsilon=1e-15, mask_updates=True, **betas)
        self.optimizer.set_learning_rate(rates)
        self._palette = find_palette(observation) if schedule.color_of_light else None
        held = self._palette is not None and self._palette.held
        self._recolored = (1 if held else 1 - FREE) * schedule.iterations
        extent = cameras_extent(self.cameras)
        self._density = (
            DensityControl(len(seeds), extent, self.voxel_size, self.start_s, schedule.iterations, schedule.seed)
            if schedule.density_control
            else None
        )

    def shown(self, batch: Batch, unseen: UnseenView | None) -> BatchGaussians:
        """Return those that a step's views can see; the others stay as they are in this step."""
        if self._density is not None:  # it counts in how many pictures a Gaussian is, alight or not
            return BatchGaussians(self.optimizer, None)
        times_s = self._times_s(batch)
        seen = alight(self.optimizer, self.voxel_size, times_s, self.cameras[batch.c])
        if unseen is not None:
            seen |= alight(self.optimizer, self.voxel_size, unseen.time_s - self.start_s, unseen.camera)
        rows, again, picture = sort_by_picture(seen)
        raw = self.optimizer.only(per_gaussian(self.optimizer), rows, again)
        return BatchGaussians(raw, Stack(len(seen), whole_numbers(picture)) if len(seen) > 1 else None)

    def drawn(self, shown: BatchGaussians, batch: Batch) -> DrawnView:
        """Draw a camera's views of a batch's frames; differentiable."""
        camera = self.cameras[batch.c]
        seen = splats(shown.raw, self.voxel_size, spread_times(self._times_s(batch), shown.stack), camera)
        # Nearer than a voxel is no place for a flame Gaussian; the limit follows the unit of length.
        return self.surroundings.draw(seen, batch.c, self.voxel_size, self.optimizer, shown.stack)

    def loss_unseen(self, shown: BatchGaussians, unseen: UnseenView, plain: np.ndarray) -> Any:
        """Mean distance of a view from where no camera stood to the light that it may have there, in display values
        over an even plate of display values (3,).

        Drawn in pixels half as large, whose light is averaged: most Gaussians are smaller than a pixel, and display
        values, in which they are blended, have a smaller mean than their light has.
        """
        width, height = unseen.camera.width, unseen.camera.height
        finer = unseen.camera.scaled(2 * width, 2 * height)
        flame = splats(shown.raw, self.voxel_size, spread_times(unseen.time_s - self.start_s, shown.stack), finer)
        drawn = render_splats(flame, finer, near=self.voxel_size, antialias=True, stack=shown.stack)
        if self.surroundings.emissive:  # over black, and the plate as light: there and back takes three powers a pixel
            fine = sum_light(drawn.color, drawn.alpha, [opaque(x) for x in srgb_to_linear(plain)])
        else:
            pairs = zip(drawn.color, plain, strict=True)
            fine = [to_light(dr.fma(1 - drawn.alpha, opaque(behind), plane)) for plane, behind in pairs]
        dr.eval(fine)  # in one kernel: what is gathered from is evaluated plane by plane otherwise
        seen = [to_display(halve(plane, width, len(unseen.time_s) * height)) for plane in fine]
        values = look_up(floats(unseen.thickness), unseen.levels, unseen.curves)
        wanted = list(zip(values[:3], values[3:], strict=True))
        least = over_plain([dr.maximum(light - spread, 0) for light, spread in wanted], plain)
        most = over_plain([light + spread for light, spread in wanted], plain)
        return measure_beyond(seen, least, most)

    def _times_s(self, batch: Batch) -> np.ndarray:
        """(K,) when its pictures were taken, after the clip's start."""
        return self.read_s[batch.c, list(batch.frames)] - self.start_s

    def watch(self, step: int, frame: Frame, c: int) -> None:
        """After the backward pass of a step."""
        if self._density is not None:
            self._density.watch(step, frame, self.cameras[c], dr.width(self.optimizer["t_mu"]))

    def change(self, before: int, done: int) -> None:
        """After steps: density control, where the method has it, needles cut, and colours drawn to the palette."""
        if self._density is not None:
            self._density.change(before, self.optimizer)
        if self._blunts and is_due(BLUNT_EVERY, before, done):
            self._blunt()
        if self._palette is not None and is_due(RECOLOR_EVERY, before, done) and before < self._recolored:
            self.optimizer["color_logit"] = recolor(self.optimizer, self._palette, PULL)

    def _blunt(self) -> None:
        """Cut needles along the rays; the moments stay, of shapes that are as they were but for a few."""
        raw = {name: self.optimizer[name] for name in per_gaussian(self.optimizer)}
        eye = np.mean([camera.position for camera in self.cameras], axis=0)
        blunted = blunt(from_raw(raw, self.voxel_size, self.start_s), eye)
        raw = to_raw(blunted, self.voxel_size, self.start_s, color_of_light="color_logit" in raw)
        for name in ("scale", "rotation"):
            self.optimizer[name] = raw[name]

    def state(self) -> tuple[TransientGaussians, list[np.ndarray]]:
        """See `Surroundings.result`."""
        gaussians = from_raw(self.optimizer, self.voxel_size, self.start_s)
        return self.surroundings.result(replace(gaussians, **self._kept), self.optimizer)


def spread_times(times_s: np.ndarray, stack: Stack | None) -> float | Float:
    """Return the time at which each Gaussian is seen, of K pictures'."""
    return float(times_s[0]) if stack is None else dr.gather(Float, floats(times_s), stack.picture)


def _loss(drawn: DrawnView, pictures: TrainingPictures, batch: Batch, schedule: Schedule, clipped: bool = False) -> Any:
    """Return the mean loss of a batch's pictures; a Dr.Jit tensor of one number, differentiable.

    Args:
        clipped: light is added to what lies behind, and a camera shows no more than white. Where a flame is white
            before a bright wall, its light beyond that is left to the palette; held to white, it would be what the
            wall lacks, which over another background is green or grey.
    """
    color = drawn.color
    if clipped:
        white = pictures.white(batch)
        color = [dr.select(full & (shown > 1), 1, shown) for full, shown in zip(white, color, strict=True)]
    loss = l1_ssim(color, pictures.target(batch), SSIM_WEIGHT, schedule.square_loss)
    return loss + schedule.alpha_loss * dr.mean(drawn.share * pictures.outside(batch))


def halve(plane: Float, width: int, height: int) -> Float:
    """Return the means (height * width,) of a plane's squares of two by two pixels; differentiable."""
    place = dr.arange(UInt, width * height)
    first = 4 * width * (place // width) + 2 * (place % width)
    corners = (first + k for k in (0, 1, 2 * width, 2 * width + 1))
    return sum(dr.gather(Float, plane, corner, mode=dr.ReduceMode.NoConflicts) for corner in corners) / 4


def look_up(x: Float, levels: np.ndarray, curves: np.ndarray) -> list[Float]:
    """Return the values of K curves (L, K) at x, linear between levels (L,), L > 1, and even beyond: `np.interp`."""
    steps, last = floats(levels), len(levels) - 1
    next_one = dr.binary_search(0, last, lambda k: dr.gather(Float, steps, k) <= x)
    k = dr.maximum(next_one, 1) - 1
    low, high = dr.gather(Float, steps, k), dr.gather(Float, steps, k + 1)
    share = dr.clip((x - low) / dr.maximum(high - low, LEAST_STEP), 0, 1)
    columns = [floats(curve) for curve in curves.T]
    return [dr.lerp(dr.gather(Float, c, k), dr.gather(Float, c, k + 1), share) for c in columns]


def over_plain(light: list[Float], plain: np.ndarray) -> list[Any]:
    """Return a flame's light, three planes, linear, over an even plate (3,) of display values: planes of those."""
    pairs: Any = zip(light, map(opaque, srgb_to_linear(plain)), strict=True)
    return [to_display(dr.minimum(added + behind, 1)) for added, behind in pairs]


def measure_beyond(seen: list[Float], least: list[Float], most: list[Float]) -> Any:
    """Mean over pixels and channels of how far values are below `least` or above `most`; a tensor of one number."""
    planes = zip(seen, least, most, strict=True)
    beyond = sum(dr.maximum(low - a, 0) + dr.maximum(a - high, 0) for a, low, high in planes)
    return dr.mean(beyond) / len(seen)


def _note(loss: float, held_out: str | None) -> str:
    return ", ".join([f"loss {loss:.4f}", *filter(None, [held_out])])


def _require_finite(loss: float, optimizer: Adam, step: int) -> None:
    bad = [name for name, value in optimizer.items() if not dr.all(dr.isfinite(dr.detach(value)), axis=None)]
    if bad or not np.isfinite(loss):
        raise NonFiniteError(
            f"step {step}: loss {loss}, NaN or Inf in {bad or 'no parameter'}; lower that parameter's learning rate, "
            "or report this dataset as a bug"
        )
