"""Where a single camera stands: before a flame that burns over the world's origin, as far away as its height says.

One view tells directions and no depth. So the flame's own extent in the pictures gives the camera its place: the foot
is the origin, the tip lies straight above it.
"""

from __future__ import annotations

from collections.abc import Collection

import cv2
import numpy as np

from gof.core.description import METRES
from gof.core.errors import GofError
from gof.dataset.poses import PoseReport
from gof.footage.flame_mask import flame_mask
from gof.footage.lens import Lens
from gof.ingest.axes import find_up
from gof.ingest.evidence import Evidence, PoseOptions
from gof.ingest.place import Placed

GUESS = "one camera: depth is a guess; the flame is taken to stand upright over the world's origin"
GROWN_PX = 2  # so far apart, parts of a flame are one
STEEPEST_DEG = 60.0  # a camera that looks up or down more than this hardly sees how high a flame is


def place_alone(
    clip: Collection[np.ndarray], plate: np.ndarray, lens: Lens, evidence: Evidence, options: PoseOptions
) -> Placed:
    """Return the pose of the only camera; the world's y axis is its view, made level, and z is up.

    Args:
        clip: (H, W, 3) uint8 RGB upright pictures.   plate: the same without fire.   lens: of these.
        options: `flame_height_m` gives the scale; else the flame is one unit high.
    Raises:
        GofError: what only several cameras can tell is asked for; no picture shows flame; the camera looks too steeply
            up or down.
    """
    _require_no_more(options)
    up, how, warnings = find_up(np.eye(4)[None], evidence, [], [lens], options)
    tip, foot = flame_ends(clip, plate)
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    if abs(up[2]) > np.sin(np.deg2rad(STEEPEST_DEG)):
        raise GofError("the only camera looks too steeply up or down to determine the distance of its flame")
    forward /= np.linalg.norm(forward)
    ray_of_foot, ray_of_tip = (np.linalg.solve(lens.K, [*end, 1.0]) for end in (foot, tip))
    height = options.flame_height_m or 1.0
    # The foot at `far` along its ray, and `height` above it what is seen in the tip's row.
    rows = ray_of_foot[1] - ray_of_tip[1] * ray_of_foot[2], up[1] - ray_of_tip[1] * up[2]
    far = -height * rows[1] / rows[0] if rows[0] > 0 else -1.0
    if far <= 0:
        raise GofError("the flame's foot is not below its tip, as the camera says where up is; give --up cameras")
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(forward, up), forward, up], axis=1)
    pose[:3, 3] = far * ray_of_foot
    scale = (
        f"{METRES}, from the flame's height of {height:g} m"
        if options.flame_height_m
        else "unknown: the unit is the flame's height (give --flame-height-m)"
    )
    return Placed(pose[None], np.zeros((0, 3)), PoseReport("one camera", scale, (GUESS, *warnings), up=how))


def flame_ends(clip: Collection[np.ndarray], plate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tip and foot (2,) px of the largest flame of a clip, all its frames together.

    Raises:
        GofError: no picture shows flame.
    """
    fire_free, ever = np.float32(plate / 255), np.zeros(plate.shape[:2], bool)
    for picture in clip:
        ever |= flame_mask(np.float32(picture / 255), fire_free, grow_px=GROWN_PX)
    _, label, stats, _ = cv2.connectedComponentsWithStats(ever.astype(np.uint8))
    if len(stats) < 2:
        raise GofError("the only camera shows no flame: nothing in its pictures rises above the plate as fire does")
    largest = np.uint8(label == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * GROWN_PX + 1,) * 2)
    rows, columns = np.nonzero(cv2.erode(largest, disc, borderValue=0))
    low = columns[rows > rows.max() - max(np.ptp(rows) / 10, 1)].mean() + 0.5
    return np.array([low, rows.min()]), np.array([low, rows.max() + 1.0])


def _require_no_more(options: PoseOptions) -> None:
    several = {
        "--points": options.by_hand,
        "--marker-mm": options.marker_m,
        "--baseline-m": options.baseline_m,
        "--rig": options.rig,
        "--poses": options.solver != "auto",
    }
    asked = [name for name, value in several.items() if value]
    if asked:
        raise GofError(f"{', '.join(asked)}: for two cameras or more; the scale of one is --flame-height-m")
