"""A camera without the board: its clock estimated from the flame that it filmed together with cameras that have one.

Fire-coloured light (red minus blue, of which white LEDs have little) is summed along the lines of the picture: how much
stands at each height at each moment. That is nearly the same from every side, but for the place and size of the
picture, so lag, shift and scale at which two cameras' light agrees best are searched together. A flame that rises looks
alike when it is seen earlier or lower; its fastest flicker, of a few frames, does so least, and is all that is compared
(notebook/capture.md, "A camera without a board").
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from gof.capture.times import VideoTimes
from gof.core.errors import GofError
from gof.footage.videos import stated_fps, stored_frames

FAINT = 32  # grey levels of red minus blue that are no fire: compressed white LEDs have 16 and more, and blink fast
BIN_PX = 4  # lines that are summed
SCALES = np.geomspace(0.8, 1.25, 13)  # of one camera's picture against the other's
MOST_SHIFT = 0.35  # of the picture's height
MIN_OVERLAP = 0.5  # of the light's changes, in time and height
FLICKER_FRAMES = 1.5  # std-dev of the Gaussian whose slower changes are taken off; of 1 to 6, best with 1 to 1.5
MOST_RIVAL = 0.65  # of the agreement: pairs of one take have up to 0.52, of flames of other takes from 0.75 on
# Standard deviation of a lag, frames: by noise, as its agreement tells, and what none tells; notebook/capture.md
BY_NOISE, UNTOLD = 0.2, 0.25
MIN_FRAMES = 24
MOST_CORRELATION = 1 - 1e-6  # of itself; the measure of more is without end


class NoFlameClock(GofError):
    """The light of the two cameras does not tell how their clocks lie."""


@dataclass(frozen=True)
class FlameLight:
    """The fire's light as one camera saw it.

    Attributes:
        along: for either axis of the picture (x, y): (T, N) fire light of each frame in N bins of BIN_PX along it.
        middle: (2,) x, y of the middle of what changes, px from the picture's centre.
        size: (width, height).
    """

    along: tuple[np.ndarray, np.ndarray]
    middle: np.ndarray
    size: tuple[int, int]


@dataclass(frozen=True)
class Offset:
    """Frame k of one camera shows the flame that the other showed at its frame k + lag.

    Attributes:
        agreement: correlation of the flicker there.
        rival: agreement at the best lag of another hill, as a ratio of Fisher's z.
    """

    lag: float
    agreement: float
    rival: float

    @property
    def error_frames(self) -> float:
        """Standard deviation of the lag: noise moves a peak by its ratio to the signal."""
        agreement = min(max(self.agreement, 1e-3), 1.0)
        return float(np.hypot(UNTOLD, BY_NOISE * np.sqrt(1 - agreement**2) / agreement))


def read_light(video: Path) -> FlameLight:
    """Read a video once. Raises DataFormatError as `stored_frames`."""
    return light_of(stored_frames(video))


def light_of(frames: Iterable[np.ndarray]) -> FlameLight:
    """Return the light of pictures (H, W, 3) uint8 RGB, of which there is at least one."""
    import cv2

    columns, rows, size = [], [], (0, 0)
    for frame in frames:
        fire = np.maximum(cv2.subtract(frame[..., 0], frame[..., 2]), FAINT) - FAINT
        size = (frame.shape[1], frame.shape[0])
        columns.append(_binned(fire.sum(0, dtype=np.float32)))
        rows.append(_binned(fire.sum(1, dtype=np.float32)))
    along = np.stack(columns), np.stack(rows)
    middles = [
        (light.std(0) * BIN_PX * (np.arange(light.shape[1]) + 0.5)).sum() / max(light.std(0).sum(), 1e-9)
        for light in along
    ]
    return FlameLight(along, np.array(middles) - np.array(size) / 2, size)


def _binned(line: np.ndarray) -> np.ndarray:
    return line[: len(line) // BIN_PX * BIN_PX].reshape(-1, BIN_PX).sum(1)


def find_offset(known: FlameLight, other: FlameLight) -> Offset:
    """Return the lag at which the light of two cameras of one frame rate agrees best, along the axis where it agrees
    better.

    Raises NoFlameClock: fewer than 24 frames, no fire, or another lag at which they agree nearly as well.
    """
    if min(len(known.along[0]), len(other.along[0])) < MIN_FRAMES:
        raise NoFlameClock(f"fewer than {MIN_FRAMES} frames are too few to compare flames")
    best = max((_best_lag(a, b) for a, b in zip(known.along, other.along, strict=True)), key=lambda o: o.agreement)
    if not best.rival <= MOST_RIVAL:
        raise NoFlameClock(
            f"the flames' light does not agree at one lag more than at others (correlation {best.agreement:.2f}, "
            f"elsewhere {best.rival:.0%} of it); is the same fire in both pictures?"
        )
    return best


def _best_lag(known: np.ndarray, other: np.ndarray) -> Offset:
    if not (known.std(0).any() and other.std(0).any()):
        return Offset(0.0, 0.0, 1.0)
    a, b = _flicker(known), _flicker(other)
    by_scale = [_agreement(_stretched(a, scale), b) for scale in SCALES]
    lags, agreement = by_scale[0][0], np.max([found for _, found in by_scale], 0)
    # Where few frames overlap, some agree by chance.
    overlap = np.minimum(len(a), len(b) + lags) - np.maximum(lags, 0)
    weighed = agreement * np.sqrt(np.clip(overlap / min(len(a), len(b)), 0, 1))
    k = int(weighed.argmax())
    low = high = k  # the peak's own hill
    while low > 0 and weighed[low - 1] < weighed[low]:
        low -= 1
    while high < len(weighed) - 1 and weighed[high + 1] < weighed[high]:
        high += 1
    rival = max(weighed[:low].max(initial=0.0), weighed[high + 1 :].max(initial=0.0))
    # By Fisher's z, in which correlations differ by what they are worth also near 1.
    z, z_rival = np.arctanh(np.clip([weighed[k], rival], 0, MOST_CORRELATION))
    share = float(z_rival / z) if z > 0 else 1.0
    return Offset(lags[k] + _peak(agreement, k), float(agreement[k]), share)


def _flicker(light: np.ndarray) -> np.ndarray:
    """Return (T, N) the light's fast changes: slow ones are taken off."""
    reach = 4 * int(np.ceil(FLICKER_FRAMES))
    # Turned about their ends, so that a flame that grows there has no flicker of it.
    padded = np.pad(light, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    fast = light - gaussian_filter1d(padded, FLICKER_FRAMES, axis=0)[reach:-reach]
    return fast - fast.mean(0)


def _stretched(light: np.ndarray, scale: float) -> np.ndarray:
    place = np.arange(int(light.shape[1] / scale)) * scale
    left = np.clip(place.astype(int), 0, light.shape[1] - 2)
    part = np.float32(place - left)
    return light[:, left] * (1 - part) + light[:, left + 1] * part


def _agreement(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lags, and the correlation at each, at the shift along the picture where it is greatest.

    By FFT, with the energy of what overlaps.
    """
    shape = tuple(fft.next_fast_len(int(n), real=True) for n in np.add(a.shape, b.shape))

    def correlate(p, q):
        return fft.irfft2(fft.rfft2(p, shape) * np.conj(fft.rfft2(q, shape)), shape)

    energy_a, energy_b = correlate(a * a, np.ones_like(b)), correlate(np.ones_like(a), b * b)
    whole_a, whole_b = (a * a).sum(), (b * b).sum()
    share = np.clip(energy_a / whole_a, 0, 1) * np.clip(energy_b / whole_b, 0, 1)
    enough = share > MIN_OVERLAP**2
    found = np.where(enough, correlate(a, b) / np.sqrt(np.where(enough, energy_a * energy_b, 1.0)), -1.0)
    shift = np.fft.fftfreq(shape[1], 1 / shape[1])
    found = found[:, np.abs(shift) <= MOST_SHIFT * b.shape[1]].max(1)
    lags = np.fft.fftfreq(shape[0], 1 / shape[0])
    order = np.argsort(lags)
    return lags[order], found[order]


def _peak(values: np.ndarray, k: int) -> float:
    """Return the place of the peak of the parabola through three values, from the middle one."""
    if not 0 < k < len(values) - 1:
        return 0.0
    a, b, c = values[k - 1 : k + 2]
    bend = a - 2 * b + c
    return float(0.5 * (a - c) / bend) if bend < 0 and min(a, c) > -1 else 0.0


def estimate_times(video: Path, light: FlameLight, known: dict[str, tuple[Path, VideoTimes, FlameLight]]) -> VideoTimes:
    """Return times of a camera without the board, from all cameras that have it.

    Every camera votes, weighted by agreement; their spread, and at least what their agreement says of one, is the
    uncertainty. The camera is taken to have the others' frame interval, row time and readout, and no gaps: nothing
    shows them.

    Raises:
        NoFlameClock: no camera's flame agrees, or the video states another frame rate than they do.
        DataFormatError: it cannot be read.
    """
    usable = {}
    for name, (path, times, its_light) in known.items():
        try:
            _require_same_rate(video, path)
            usable[name] = times, find_offset(_on_clock(its_light, times), light), its_light
        except NoFlameClock as e:
            reason = e
    if not usable:
        raise reason
    interval = float(np.median([times.frame_interval_us for times, _, _ in usable.values()]))
    starts, weights, errors = [], [], []
    for times, offset, its_light in usable.values():
        # The flame is seen where it stands: its lines are read earlier or later than the picture's middle.
        delay = _delay(times, its_light.middle) - _delay(times, light.middle)
        starts.append(1e6 * times.frames[0].time_s + offset.lag * times.frame_interval_us + delay)
        weights.append(offset.agreement**2)
        errors.append(offset.error_frames**2)
    start = float(np.average(starts, weights=weights))
    spread = float(np.sqrt(np.average((np.array(starts) - start) ** 2, weights=weights)))
    sigma = float(np.hypot(np.sqrt(np.average(errors, weights=weights)) * interval, spread))
    like, _, _ = max(usable.values(), key=lambda u: u[1].agreement)
    seen = " and ".join(f"{name} (correlation {offset.agreement:.2f})" for name, (_, offset, _) in usable.items())
    text = (
        f"its times are ESTIMATED from the flame's light against {seen}: +-{sigma / 1000:.1f} ms, about "
        f"{sigma / interval:.1f} frames; frame rate and row time are taken from the others, gaps are not seen"
    )
    seconds = 1e-6 * (start + interval * np.arange(len(light.along[0])))
    times = VideoTimes.estimated(light.size, seconds.tolist(), interval, sigma, "flame", stated_fps(video), text)
    return replace(times, row_time_us=like.row_time_us, readout=like.readout)


def _on_clock(light: FlameLight, times: VideoTimes) -> FlameLight:
    """Return the light at equal steps of the camera's clock: gaps are filled, repeats left out."""
    at = np.array([frame.time_s for frame in times.frames]) * 1e6
    index = (at - at[0]) / times.frame_interval_us
    steps = np.arange(round(index[-1]) + 1)

    def filled(values):
        right = np.clip(np.searchsorted(index, steps - 1e-6), 1, len(index) - 1)
        span = np.maximum(index[right] - index[right - 1], 1e-9)
        part = np.clip((steps - index[right - 1]) / span, 0, 1)[:, None]
        return values[right - 1] * (1 - part) + values[right] * part

    return FlameLight(tuple(filled(values) for values in light.along), light.middle, light.size)


def _require_same_rate(video: Path, other: Path) -> None:
    mine, its = stated_fps(video), stated_fps(other)
    if mine and its and abs(mine / its - 1) > 0.01:
        raise NoFlameClock(
            f"its file states {mine:g} frames per second, {other.name} {its:g}: clocks cannot be compared"
        )


def _delay(times: VideoTimes, middle: np.ndarray) -> float:
    """us by which a place is read later than the picture's middle."""
    along = middle[0] if times.readout in ("left", "right") else middle[1]
    return float(times.row_time_us * along * (1 if times.readout in ("right", "down") else -1))
