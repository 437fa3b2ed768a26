"""Clues in clips to where their cameras stand, before anything is solved; and whether one was touched in between."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gof.capture.locate import MARKER_CORNERS, BoardNotFound, Summary, find_marker, locate
from gof.capture.template import BoardTemplate
from gof.core.datum import Datum
from gof.core.description import METRES
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.footage.lens import Lens
from gof.ingest import sfm
from gof.ingest.accelerometer import Tilt
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.over_time import largest_change
from gof.ingest.rig_sketch import RigSketch
from gof.ingest.up import UpChoice

STILL_RANGE = 60  # of 255: pixels that change more over the clip show fire or LEDs and get no features
MIN_JUDGED = 30  # matches from which on that share says something: some ten of any two pictures' are chance
MAX_SHIFT_PX = 1.5  # median move of a camera's still picture between two clips above which the camera was touched
MAX_SHIFT_SMALL_PX = 0.75  # the same in px of the other clip's pictures, where they are stored smaller
SAME_LENS = 0.01  # relative difference of two lenses that are taken for one

Solver = Literal["auto", "features", "points"]


OPTIONS = {
    "solver": "--poses",
    "by_hand": "--points",
    "marker_m": "--marker-mm",
    "baseline_m": "--baseline-m",
    "rig": "--rig",
    "sketch": "--rig",
    "up": "--up",
}
CHOICES = ("solver", "baseline_m", "up")  # by which poses are found, measured and turned upright


@dataclass(frozen=True)
class PoseOptions:
    """Facts of the scene that are known beside its pictures.

    Attributes:
        solver: "features": structure from motion; "points": the board or points by hand; "auto": the first that holds.
        by_hand: marked points.
        board: to look for; None does not look.
        marker_m: side of the board's marker in m; gives the scale.
        baseline_m: distance between the first and the last camera in m; gives the scale.
        flame_height_m: of a single camera's flame, from its foot to the highest tip of the clip; gives the scale.
        rig: another clip's poses, to be taken over if nothing speaks against them.
        sketch: where the cameras stand roughly, to be refined by the flame; in place of all that stands still.
        up: how the vertical is found, see `find_up`.
        tilts: the cameras' accelerometers on it; empty where not asked for.

    Raises:
        GofError: a length is not positive.
    """

    solver: Solver = "auto"
    by_hand: tuple[MarkedPoint, ...] = ()
    board: BoardTemplate | None = None
    marker_m: float | None = None
    baseline_m: float | None = None
    flame_height_m: float | None = None
    rig: KnownRig | None = None
    sketch: RigSketch | None = None
    up: UpChoice = "auto"
    tilts: tuple[Tilt, ...] = ()

    def __post_init__(self):
        lengths = {
            "--marker-mm": self.marker_m,
            "--baseline-m": self.baseline_m,
            "--flame-height-m": self.flame_height_m,
        }
        for name, value in lengths.items():
            if value is not None and not (np.isfinite(value) and value > 0):
                raise GofError(f"{name} {value}: must be a positive length in metres")

    def require_no_choice(self, poses: str, idle: Collection[str]) -> None:
        """Raise GofError: an option would choose what known poses already say.

        Args:
            poses: whose they are, in words.   idle: attributes, keys of OPTIONS, that would change nothing.
        """
        usual = PoseOptions()
        given = sorted({OPTIONS[name] for name in idle if getattr(self, name) != getattr(usual, name)})
        if given:
            what = f"poses are taken over, {poses}, with their axes and their scale"
            raise GofError(f"{', '.join(given)}: {what}; leave out {' and '.join(given)}")

    @property
    def has_length(self) -> bool:
        """Whether the coordinates of the marked points are true metres."""
        return self.marker_m is not None or any(p.xyz is not None for p in self.by_hand)

    @property
    def marker_side(self) -> float:
        """Side of the marker in metres, or in a unit of its own."""
        return self.marker_m or 1.0


@dataclass(frozen=True)
class KnownRig:
    """Cameras whose poses are known from another clip of the same rig.

    Attributes:
        folder: of that clip's dataset.
        world_to_camera: (C, 4, 4).   scale: how the unit of length is known.
        plates: (H, W, 3) uint8 RGB per camera, of any size.
    """

    folder: Path
    world_to_camera: np.ndarray
    scale: str
    plates: list[np.ndarray]

    @classmethod
    def read(cls, folder: Path, lenses: list[Lens]) -> KnownRig:
        """Read that of a dataset that `gof ingest` made, for cameras with these lenses.

        Raises:
            DataFormatError: no dataset, another number of cameras, or another lens.
        """
        dataset = Dataset.open(folder)
        if len(dataset.cameras) != len(lenses):
            raise DataFormatError(f"{folder}: has {len(dataset.cameras)} cameras, the footage {len(lenses)}")
        for camera, lens in zip(dataset.cameras, lenses, strict=True):
            expected = camera.scaled(lens.width, lens.height).K
            if not np.allclose(expected, lens.K, rtol=SAME_LENS, atol=SAME_LENS * lens.width):
                raise DataFormatError(
                    f"{folder}: its camera '{camera.name}' has a focal length of {expected[0, 0]:.0f} px at this size, "
                    f"the footage {lens.K[0, 0]:.0f} px; give both clips the same --fov or --cameras"
                )
        plates = [np.rint(255 * dataset.static(c)).astype(np.uint8) for c in range(len(lenses))]
        world = dataset.description.cameras_from(Datum(), "train")  # as the file has it: a new dataset's is the same
        poses = np.array([camera.world_to_camera for camera in world])
        return cls(folder, poses, str(dataset.description.provenance.get("scale", METRES)), plates)


@dataclass(frozen=True)
class PoseClues:
    """Clues in one clip to where its cameras stand; the frames themselves are no longer needed.

    Attributes:
        name: of the clip, for messages.
        plates: (H, W, 3) uint8 minimum plates per camera.
        masks: (H, W) bool, where features may be.
        board: points of the sync board.   notes: on cameras that do not show it.
    """

    name: str
    plates: list[np.ndarray]
    masks: list[np.ndarray]
    board: list[MarkedPoint]
    notes: list[str]

    @classmethod
    def of(
        cls, name: str, clips: Sequence[Collection[np.ndarray]], lowest: list[np.ndarray], options: PoseOptions
    ) -> PoseClues:
        """From (H, W, 3) uint8 RGB pictures and their minimum plate, per camera."""
        board, notes = board_points(clips, options.board, options.marker_side) if options.board else ([], [])
        return cls(name, lowest, _feature_masks(clips, board, options), board, notes)


def require_still(
    names: list[str],
    clip: PoseClues,
    other: str,
    plates: list[np.ndarray],
    masks: list[np.ndarray] | None = None,
) -> dict[str, float]:
    """Return each camera's shift of the still picture between two clips: median in px of the clip's pictures.

    Args:
        other: name of the other clip.   plates: its pictures.   masks: where features may be in them.
    Raises:
        PoseError: a camera moved, or the two pictures have too little in common to tell.
    """
    shifts = {}
    for c, name in enumerate(names):
        shift, count = sfm.shift_between(clip.plates[c], clip.masks[c], plates[c], None if masks is None else masks[c])
        if count < MIN_JUDGED:
            raise sfm.PoseError(
                f"{name}: only {count} features of '{clip.name}' are found again in '{other}'; is it of the same rig, "
                "filmed from the same place?"
            )
        # A smaller picture tells places to a fraction of its own pixels.
        if shift > max(MAX_SHIFT_PX, MAX_SHIFT_SMALL_PX * clip.plates[c].shape[1] / plates[c].shape[1]):
            raise sfm.PoseError(
                f"{name}: its picture moved by {shift:.1f} px between '{clip.name}' and '{other}'; poses hold "
                "only for clips between which no camera was touched"
            )
        shifts[name] = round(shift, 2)
    return shifts


def _feature_masks(
    clips: Sequence[Collection[np.ndarray]], board: list[MarkedPoint], options: PoseOptions
) -> list[np.ndarray]:
    """Return (H, W) bool per camera: where features may be, on what stands still and is not the board."""
    masks = [_still(clip) for clip in clips]
    if options.board:
        for c, mask in enumerate(masks):
            mask &= ~board_region(board, c, options.board, options.marker_side, mask.shape[:2])
    return masks


def _still(clip: Collection[np.ndarray]) -> np.ndarray:
    """Return (H, W) bool: pixels that hardly change, shrunk by two pixels."""
    import cv2

    return cv2.erode((largest_change(clip) <= STILL_RANGE).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


# ----------------------------------------------------------------
# The sync board as a set of points every camera knows: marker corners (a square of known side) and LEDs.

GROWN = 0.2  # of a marker side: what around the board's outline still belongs to it


def board_points(
    clips: Sequence[Collection[np.ndarray]], template: BoardTemplate, marker_m: float
) -> tuple[list[MarkedPoint], list[str]]:
    """Return the board's points that some camera sees, xyz on the board (z = 0) in metres.

    LEDs are rough: the template's places for them are good to a few pixels only, but each is one spot in every picture.

    Args:
        clips: per camera its (H, W, 3) uint8 RGB pictures.
        marker_m: side of the marker; any number when the scale is unknown.
    Returns:
        the points, and one note per camera that does not show the marker.
    """
    corners = [MarkedPoint({}, np.append(marker_m * xy, 0.0)) for xy in MARKER_CORNERS]
    leds = [MarkedPoint({}, np.append(marker_m * xy, 0.0), rough=True) for xy in template.led_xy]
    notes = []
    for camera, clip in enumerate(clips):
        summary = Summary()
        for frame in clip:
            summary.add(frame)
        try:
            corner_pixels = find_marker(summary, template)
        except BoardNotFound as e:
            notes.append(f"camera {camera}: {e}")
            continue
        for point, xy in zip(corners, corner_pixels, strict=True):
            point.pixels[camera] = xy
        for led, xy in _seen_leds(summary, template).items():
            leds[led].pixels[camera] = xy
    return [p for p in corners + leds if p.pixels], notes


def _seen_leds(summary: Summary, template: BoardTemplate) -> dict[int, np.ndarray]:
    """Pixel of every LED that is seen, by its number; none where the strips cannot be read: the corners are enough."""
    try:
        board = locate(summary, template)
    except BoardNotFound:
        return {}
    return {k: xy for k, (xy, seen) in enumerate(zip(board.led, board.led_visible, strict=True)) if seen}


def board_region(
    points: list[MarkedPoint], camera: int, template: BoardTemplate, marker_m: float, shape: tuple[int, ...]
) -> np.ndarray:
    """Return (H, W) bool: the board's outline in a camera, grown a little; all False where it is not seen."""
    import cv2

    region = np.zeros(shape, np.uint8)
    corners = [p for p in points if camera in p.pixels and not p.rough]
    if len(corners) < len(MARKER_CORNERS):
        return region > 0
    pixels = np.array([p.pixels[camera] for p in corners])
    H, _ = cv2.findHomography(np.array([p.xyz[:2] / marker_m for p in corners if p.xyz is not None]), pixels)
    if H is None:
        return region > 0
    outline = cv2.perspectiveTransform(template.outline.reshape(1, -1, 2), H)[0]
    cv2.fillPoly(region, [np.rint(outline).astype(np.int32)], (1,))
    side = max(3, int(GROWN * np.linalg.norm(pixels[1] - pixels[0])))
    return cv2.dilate(region, np.ones((side, side), np.uint8)) > 0
