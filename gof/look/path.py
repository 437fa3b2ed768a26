"""Place of a film's camera, and the instant that it shows, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.evaluate.around import angles_deg

Way = Literal["orbit", "cameras", "camera"]
Clock = Literal["play", "freeze", "bullet"]
Journey = Callable[[float], Camera]  # from 0 to 1 along a closed way: 0 and 1 are the same place
GUESSED_DEG = 20.0  # from the nearest camera on, a flame's shape is a guess
NO_STEP = 1e-6  # m: cameras nearer than this are one knot's width apart all the same


@dataclass(frozen=True)
class Shot:
    """One picture of a film: a camera, the time in seconds on the dataset clock, and words written below it."""

    camera: Camera
    time_s: float
    note: str = ""


def shots(journey: Journey, times_s: np.ndarray, along: np.ndarray) -> list[Shot]:
    """Return a film: at each of its (T,) times the camera that is so far (T,) along its way."""
    return [Shot(journey(float(share)), float(time)) for time, share in zip(times_s, along, strict=True)]


def say_what_is_a_guess(film: Sequence[Shot], filmed: list[Camera]) -> list[Shot]:
    """Return the shots, with a note at those from where no camera filmed the flame.

    Args:
        filmed: the cameras that did.
    """
    away = angles_deg([shot.camera for shot in film], filmed)
    notes = [f"{angle:.0f}\N{DEGREE SIGN} from the nearest camera: a guess" for angle in away]
    noted = zip(film, away, notes, strict=True)
    return [replace(shot, note=words) if angle > GUESSED_DEG else shot for shot, angle, words in noted]


def clock(
    kind: Clock, span_s: tuple[float, float], slow: float, seconds: float, fps: float, stop_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the instant that each frame shows, and how far along its way the camera is.

    Args:
        kind: "play": the clip once, while the camera goes its way once. "freeze": time stands at `stop_s` for
            `seconds`, while the camera goes its way. "bullet": the clip plays, stops at `stop_s` while the camera goes
            its way, and plays on.
        span_s: first and last second of the clip.   slow: seconds of film for one second of the clip.
        fps: frames of film a second.
    Returns:
        times (T,) s, in the span; shares of the way (T,) in [0, 1).
    """
    first, last = span_s
    played = first + np.arange(max(1, round((last - first) * slow * fps))) / (fps * slow)
    stopped = max(1, round(seconds * fps))
    if kind == "play":
        return np.minimum(played, last), np.arange(len(played)) / len(played)
    still, round_trip = np.full(stopped, stop_s), np.arange(stopped) / stopped
    if kind == "freeze":
        return still, round_trip
    before, after = played[played < stop_s], played[played >= stop_s]
    times = np.concatenate([before, still, after])
    return np.minimum(times, last), np.concatenate([np.zeros(len(before)), round_trip, np.zeros(len(after))])


def stay(camera: Camera) -> Journey:
    """Return the camera itself, shutter and all."""
    return lambda share: camera


def orbit(camera: Camera, middle: np.ndarray, degrees: float) -> Journey:
    """Return a camera turned about the upright line through `middle` (3,): what stands on that line stays where it is.

    Args:
        degrees: 360 = once around; less = so far in all, to both sides and back.
    """

    def at(share: float) -> Camera:
        angle = 2 * np.pi * share if degrees >= 360 else np.deg2rad(degrees) / 2 * np.sin(2 * np.pi * share)
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.eye(4)
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
        turn[:3, 3] = middle - turn[:3, :3] @ middle
        return replace(camera, world_to_camera=camera.world_to_camera @ np.linalg.inv(turn), row_time_s=0.0)

    return at


def through(cameras: Sequence[Camera]) -> Journey:
    """From the first camera through all others to the last and back, on splines through their places, turns and lenses.

    Raises:
        GofError: fewer than two cameras.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    if len(cameras) < 2:
        raise GofError("--camera-path cameras: the dataset has one camera; --camera-path orbit turns around the flame")
    size = cameras[0].width, cameras[0].height
    places = np.stack([camera.position for camera in cameras])
    knots = np.r_[0, np.cumsum(np.maximum(np.linalg.norm(np.diff(places, axis=0), axis=1), NO_STEP))]
    turns = RotationSpline(knots, Rotation.from_matrix([camera.world_to_camera[:3, :3] for camera in cameras]))
    position = CubicSpline(knots, places, bc_type="natural")
    lens = CubicSpline(knots, [_lens(camera, size) for camera in cameras], bc_type="natural")

    def at(share: float) -> Camera:
        knot = knots[-1] * (1 - np.cos(2 * np.pi * share)) / 2  # slows down where it turns back
        pose = np.eye(4)
        pose[:3, :3] = turns(knot).as_matrix()
        pose[:3, 3] = -pose[:3, :3] @ position(knot)
        return Camera("film", *size, lens(knot), pose)

    return at


def _lens(camera: Camera, size: tuple[int, int]) -> np.ndarray:
    """K for a picture of another size with the same height of view, its middle in the middle."""
    factor = size[1] / camera.height
    K = camera.K.copy()
    K[:2] *= factor
    K[0, 2] += (size[0] - factor * camera.width) / 2
    return K
