"""Cameras without any board: their clocks by the sound of the films, else by the flames' light against each other.

The first film's clock is the common one. A frame's time in its own film is the file's time stamp, which is true time
where a camera films at the rate at which it plays; for slow motion the rate has to be given, and its sound is useless.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from subprocess import PIPE

import numpy as np

from gof.capture.flame_clock import FlameLight, NoFlameClock, find_offset, read_light
from gof.capture.sound_clock import NoSoundClock, SoundLag, find_lag
from gof.capture.sync import nearest_frames
from gof.capture.times import Clock, FrameTimesFile, SyncedVideo, VideoTimes
from gof.core.errors import GofError
from gof.footage.chapters import chapters_from
from gof.footage.recording import begins_s
from gof.footage.videos import VideoInfo, distinct_names, fingerprint, read_info, require_different
from gof.host.processes import run

# ----------------------------------------------------------------
# The sound of a film, decoded by the program ffmpeg: OpenCV reads pictures only.

RATE = 16_000  # samples per second that are read: a clap and a fire's crackle lie below 8 kHz


class NoSound(GofError):
    """A film has no sound that can be read."""


def read_sound(info: VideoInfo) -> np.ndarray:
    """Return (N,) float32: all channels' mean at RATE, from the film's first frame on; that of the chapters in which it
    goes on, each from that chapter's first frame on.

    Args:
        info: of a film that was read to its end.
    Raises:
        NoSound: no ffmpeg on this machine, or no sound that it can decode.
    """
    parts = [_sound_of(file, own_s) for file, (_, own_s) in zip(chapters_from(info.path), info.begins_s, strict=True)]
    starts = [round((begin_s - info.begins_s[0][0]) * RATE) for begin_s, _ in info.begins_s]
    sound = np.zeros(max(start + len(part) for start, part in zip(starts, parts, strict=True)), np.float32)
    for start, part in zip(starts, parts, strict=True):
        sound[start : start + len(part)] += part  # one's end lies in the silence before the next one's first packet
    if not sound.any():
        raise NoSound(f"{info.path.name}: has no sound, or a silent one")
    return sound


def _sound_of(path: Path, begin_s: float) -> np.ndarray:
    """Return that of one file, from a time of its own clock on. Raises NoSound: it has none that can be decoded."""
    if (program := shutil.which("ffmpeg")) is None:
        raise NoSound("the program ffmpeg, which decodes sound, is not on this machine's PATH")
    command = [program, "-v", "error", "-nostdin", "-copyts", "-i", str(path.absolute()), "-vn", "-ac", "1"]
    from_there = f"atrim=start={begin_s:.6f},asetpts=PTS-{begin_s:.6f}/TB"
    command += ["-af", f"{from_there},aresample=async=1:first_pts=0", "-ar", str(RATE), "-f", "f32le", "-"]
    done = run(command, stdout=PIPE, stderr=PIPE)
    if done.returncode:
        raise NoSound(f"{path.name}: has no sound, or a silent one")
    return np.frombuffer(done.stdout[: len(done.stdout) // 4 * 4], "<f4")


NO_BOARD = "none"  # what times.json calls a board that is not there
SOUND_S = 0.003  # sound of 1 m more of way; the cameras' own delays between sound and picture are not seen at all


@dataclass(frozen=True)
class ClockFit:
    """A film's clock on the first one's: time = own time * (1 + drift) + offset_s, and how well that is known."""

    offset_s: float
    drift: float
    sigma_s: float
    note: str


def synchronise_without_board(videos: list[Path], rates: Sequence[float | None]) -> tuple[FrameTimesFile, list[str]]:
    """Return the times of every frame on the first film's clock, and what was tried, in words.

    Args:
        rates: each film's true rate; None: its time stamps are true time.
    Raises:
        GofError: neither sound nor light gives the offsets of the clocks; the message has both reasons.
    """
    require_different(videos)
    if len(videos) < 2:
        raise GofError("one film alone has no other to be compared with")
    names, infos = distinct_names(videos), [read_info(video) for video in videos]
    own = [_own_times(info, rate) for info, rate in zip(infos, rates, strict=True)]
    notes: list[str] = []
    fits: list[ClockFit] | None = None
    clock: Clock = "sound"
    if any(rate is not None for rate in rates):
        notes.append("sound: not used, as --fps says that the films do not play at the rate at which they were filmed")
    else:
        try:
            sounds = [read_sound(info) for info in infos]
            fits = by_sound(names, sounds, [_begin_sigma_s(info) for info in infos])
        except (NoSound, NoSoundClock) as e:
            notes.append(f"sound: {e}")
    try:
        by_flame = by_light(names, own, [read_light(video) for video in videos])
        if fits is None:
            fits, clock = by_flame, "flame"
        else:
            notes += _compared(names, own, fits, by_flame)
    except NoFlameClock as e:
        notes.append(f"flame: {e}")
    if fits is None:
        raise GofError(f"the films' clocks cannot be compared: {'; '.join(notes)}")
    cameras = [
        SyncedVideo(name, str(video), _described(info, times, fit, clock), None, fingerprint(video))
        for name, video, info, times, fit in zip(names, videos, infos, own, fits, strict=True)
    ]
    warnings = tuple(f"{name}: {fit.note}" for name, fit in zip(names, fits, strict=True) if fit.note)
    return FrameTimesFile(NO_BOARD, 0.0, tuple(cameras), nearest_frames(cameras), warnings), notes


def _own_times(info: VideoInfo, rate: float | None) -> np.ndarray:
    """Return (N,) s of the film's frames from its first one on, as its sound is read."""
    if rate is not None and info.frames is not None:
        return np.arange(info.frames) / rate
    if info.stamps_s is None:
        raise GofError(f"{info.path}: pictures have neither sound nor time stamps; say their rate with --fps")
    if len(info.stamps_s) < 2 or not np.diff(info.stamps_s).min() > 0:
        raise GofError(f"{info.path}: its time stamps do not grow with every frame; say its true rate with --fps")
    return info.stamps_s - info.stamps_s[0]


# ---- sound -----------------------------------------------------------------------------------------------------------


def _begin_sigma_s(info: VideoInfo) -> float:
    """Return how far off a film's first frame may be on the clock of its sound, s: 0 where the file states it exactly;
    others state it in whole frames."""
    if begins_s(chapters_from(info.path)[0]) is not None or not info.stated_fps:
        return 0.0
    return 1 / info.stated_fps / np.sqrt(12)


def by_sound(
    names: list[str], sounds: list[np.ndarray], begin_sigma_s: Sequence[float] | None = None
) -> list[ClockFit]:
    """Return each film's clock on the first one's; all pairs are compared, and must close.

    Args:
        begin_sigma_s: how far off each film's first frame may be on its sound's clock; None: not at all.
    Raises:
        NoSoundClock: two tracks do not agree, or the pairs contradict each other.
    """
    lags: dict[tuple[int, int], SoundLag] = {}
    for one, other in combinations(range(len(sounds)), 2):
        try:
            lags[one, other] = find_lag(sounds[one], sounds[other], RATE)
        except NoSoundClock as e:
            raise NoSoundClock(f"{names[one]} and {names[other]}: {e}") from e
    begins = begin_sigma_s or [0.0] * len(sounds)
    fits = [ClockFit(0.0, 0.0, float(np.hypot(SOUND_S, begins[0])), "")]
    for other in range(1, len(sounds)):
        lag = lags[0, other]
        open_s = [abs(lags[0, k].lag_s + lags[k, other].lag_s - lag.lag_s) for k in range(1, other)]
        if open_s and max(open_s) > 2 * SOUND_S:
            raise NoSoundClock(f"the films' sounds contradict each other by {1000 * max(open_s):.1f} ms")
        sigma = float(np.linalg.norm([SOUND_S, max([lag.sigma_s, *open_s]), begins[0], begins[other]]))
        drift = f", clocks drift by {1e6 * lag.drift:+.0f} us per s" if lag.drift else ""
        note = (
            f"its times are by SOUND against {names[0]}: {lag.heard} of {lag.stretches} stretches agree, to "
            f"{1000 * lag.sigma_s:.2f} ms{drift}; +-{1000 * sigma:.1f} ms, as sound needs 2.9 ms per metre; a "
            "camera's own delay between sound and picture is not seen"
        )
        fits.append(ClockFit(lag.lag_s, lag.drift, sigma, note))
    return fits


# ---- light -----------------------------------------------------------------------------------------------------------


def by_light(names: list[str], own: list[np.ndarray], lights: list[FlameLight]) -> list[ClockFit]:
    """Return each film's clock on the first one's, of the lags of all pairs that agree, weighted by agreement.

    Args:
        own: (N,) s of every film's frames.
    Raises:
        NoFlameClock: a film agrees with no other, or only with films that do not lead to the first.
    """
    steps = [float(np.median(np.diff(times))) for times in own]
    step = min(steps)
    even = [_evenly(light, times, step) for light, times in zip(lights, own, strict=True)]
    rows, values, weights, errors, reasons = [], [], [], [], []
    for one, other in combinations(range(len(own)), 2):
        try:
            offset = find_offset(even[one], even[other])
        except NoFlameClock as e:
            reasons.append(f"{names[one]} and {names[other]}: {e}")
            continue
        row = np.zeros(len(own))
        row[other], row[one] = 1, -1
        rows.append(row)
        values.append(own[one][0] + offset.lag * step - own[other][0])
        weights.append(offset.agreement**2)
        errors.append(offset.error_frames**2)
    matrix = np.array(rows).reshape(-1, len(own))[:, 1:]
    if len(rows) < len(own) - 1 or np.linalg.matrix_rank(matrix) < len(own) - 1:
        raise NoFlameClock("; ".join(reasons))
    root = np.sqrt(weights)
    solved = np.linalg.lstsq(matrix * root[:, None], np.array(values) * root, rcond=None)[0]
    open_s = float(np.abs(matrix @ solved - values).max())
    sigma = float(np.hypot(np.sqrt(np.average(errors, weights=weights)) * max(steps), open_s))
    note = (
        f"its times are ESTIMATED from the flame's light against the other films' (they close to "
        f"{1000 * open_s:.1f} ms): +-{1000 * sigma:.1f} ms, about {sigma / max(steps):.1f} frames"
    )
    return [ClockFit(0.0, 0.0, sigma, ""), *(ClockFit(float(offset), 0.0, sigma, note) for offset in solved)]


def _evenly(light: FlameLight, times: np.ndarray, step: float) -> FlameLight:
    """Return the light at equal steps of the film's clock, from its first frame on."""
    wanted = times[0] + step * np.arange(int((times[-1] - times[0]) / step + 1e-6) + 1)
    right = np.clip(np.searchsorted(times, wanted - 1e-9), 1, len(times) - 1)
    part = np.clip((wanted - times[right - 1]) / (times[right] - times[right - 1]), 0, 1)[:, None]
    along = tuple(line[right - 1] * (1 - part) + line[right] * part for line in light.along)
    return FlameLight((along[0], along[1]), light.middle, light.size)


def _compared(names: list[str], own: list[np.ndarray], sound: list[ClockFit], light: list[ClockFit]) -> list[str]:
    """Return what the flames' light says of the clocks that sound gave."""
    notes = []
    for name, times, one, other in list(zip(names, own, sound, light, strict=True))[1:]:
        middle = float(times.mean())
        apart = one.offset_s + one.drift * middle - other.offset_s
        spread_s = np.hypot(one.sigma_s, other.sigma_s)
        words = "which agrees" if abs(apart) <= 2 * spread_s else "which CONTRADICTS it: compare a moment in both"
        notes.append(
            f"{name}: the flame's light is {1000 * apart:+.1f} ms from its sound (+-{1000 * spread_s:.1f}), {words}"
        )
    return notes


def _described(info: VideoInfo, own: np.ndarray, fit: ClockFit, clock: Clock) -> VideoTimes:
    time_s, step_us = own * (1 + fit.drift) + fit.offset_s, 1e6 * float(np.median(np.diff(own)))
    size, sigma_us = (info.width, info.height), 1e6 * fit.sigma_s
    return VideoTimes.estimated(size, time_s.tolist(), step_us, sigma_us, clock, info.stated_fps, fit.note)
