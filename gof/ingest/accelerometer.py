"""Which way is up, by the accelerometers of the cameras themselves: of a camera that stands still, they feel gravity.

Read are GoPro's: `GRAV`, where the camera has worked gravity out (MAX, HERO9 and later; HERO8 writes zeros), else
`ACCL`. A GoPro's own axes are X to the left, Y to the back and Z to the top, seen from behind it; at rest the
acceleration is 9.81 m/s2 to the top. `GRAV` points down, in the picture's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.dataset.poses import UpReport
from gof.footage.lens import CAMERA_AXES, Turn
from gof.ingest.gpmf import Stream, streams
from gof.ingest.up import angle_deg

BODY_TO_PICTURE = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])  # rows: right, down, forward
HERO5_ORDER = "ZXY"  # how a HERO5 stores them, and later ones that do not say
GRAVITY = 9.81
MOST_OFF = 0.15  # relative: HERO7 and earlier are not calibrated, one read 10.7 m/s2
MOST_SHAKE = 1.0  # m/s2, standard deviation along the vertical or across: hands and drones shake more, tripods less
MOST_ROLL_DEG = 45.0
MOST_APART_DEG = 5.0


@dataclass(frozen=True)
class Tilt:
    """What a camera's accelerometer says.

    Attributes:
        up: (3,) the vertical in the axes of the upright picture (x right, y down, z forward); None: it does not say.
        why: why not, in words; None where there is no accelerometer.
    """

    up: np.ndarray | None = None
    why: str | None = None


def read_tilt(video: Path, turn: Turn) -> Tilt:
    """Of a video whose stored pictures are turned upright so. A track that cannot be believed is named, not raised."""
    try:
        up = _stored_up(list(streams(video)))
    except DataFormatError as e:
        return Tilt(why=f"{video.name}: {e}")
    if up is None or isinstance(up, str):
        return Tilt(why=up and f"{video.name}: its accelerometer {up}")
    up = CAMERA_AXES[turn] @ up
    roll = abs(np.rad2deg(np.arctan2(up[0], -up[1])))
    if np.hypot(up[0], up[1]) > 0.5 and roll > MOST_ROLL_DEG:
        return Tilt(
            why=f"{video.name}: by its accelerometer the picture is {roll:.0f} degrees from upright; give --turn"
        )
    return Tilt(up)


def _stored_up(found: list[Stream]) -> np.ndarray | str | None:
    """(3,) unit vertical in the stored picture's axes, or why there is none."""
    gravity = [_scaled(s, "GRAV") for s in found if isinstance(s.get("GRAV"), np.ndarray)]
    if gravity and np.linalg.norm(down := np.concatenate(gravity).mean(0)) > 0.5:
        return -down / np.linalg.norm(down)
    felt = [s for s in found if isinstance(s.get("ACCL"), np.ndarray)]
    if not felt:
        return None
    order = felt[0].get("ORIN", HERO5_ORDER)
    if sorted(str(order).upper()) != ["X", "Y", "Z"]:
        return f"has axes '{order}', which are not known"
    acceleration = np.concatenate([_scaled(s, "ACCL") for s in felt])
    if len(acceleration) == 0:
        return "has no samples"
    body = np.zeros_like(acceleration)
    for column, axis in enumerate(order):
        body[:, "XYZ".index(axis.upper())] = acceleration[:, column] * (1 if axis.isupper() else -1)
    mean, shake = body.mean(0), body.std(0).max()
    size = float(np.linalg.norm(mean))
    if shake > MOST_SHAKE:
        return f"shakes by {shake:.1f} m/s2: the camera was moved"
    if abs(size / GRAVITY - 1) > MOST_OFF:
        return f"measures {size:.1f} m/s2 where gravity is {GRAVITY}"
    return BODY_TO_PICTURE @ mean / size


def _scaled(stream: Stream, name: str) -> np.ndarray:
    """(N, 3) in the sensor's unit. Raises DataFormatError: of another shape, not finite, or scaled by zero."""
    scale = stream.get("SCAL")
    divisor = scale.reshape(-1) if isinstance(scale, np.ndarray) else np.ones(1)
    if not np.isfinite(divisor).all() or (divisor == 0).any() or divisor.size not in (1, stream[name].shape[1]):
        raise DataFormatError(f"its sensor '{name}' has the scale {divisor.tolist()}")
    if stream[name].shape[1] != 3 or not np.isfinite(stream[name]).all():
        raise DataFormatError(f"its sensor '{name}' has samples that are not three finite numbers")
    return stream[name] / divisor


def up_from_tilts(poses: np.ndarray, tilts: tuple[Tilt, ...], near: np.ndarray) -> tuple[np.ndarray, UpReport] | str:
    """The vertical (3,) that the cameras' accelerometers agree on, or why there is none.

    Args:
        poses: (C, 4, 4) world to camera.   near: (3,) the cameras' mean up.
    """
    known = {c: poses[c, :3, :3].T @ tilt.up for c, tilt in enumerate(tilts) if tilt.up is not None}
    if not known:
        return "; ".join(tilt.why for tilt in tilts if tilt.why) or "no video has a track of a GoPro's accelerometer"
    mean = np.sum(list(known.values()), 0)
    if np.linalg.norm(mean) < 1e-6:
        return "the cameras' accelerometers contradict each other"
    mean /= np.linalg.norm(mean)
    apart = {c: angle_deg(up, mean) for c, up in known.items()}
    if max(apart.values()) > MOST_APART_DEG:
        each = ", ".join(f"cam_{c} {angle:.1f}" for c, angle in apart.items())
        return f"the cameras' accelerometers contradict each other (degrees from their mean: {each})"
    spread = None
    if len(known) > 1:
        spread = round(float(np.sqrt(np.sum(np.square(list(apart.values()))) / (len(known) - 1))), 2)
    return mean, UpReport("accelerometer", round(angle_deg(mean, near), 2), spread)
