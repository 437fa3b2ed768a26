"""poses.json of a dataset made from videos: the sparse points its poses rest on, and what was measured about both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from gof.core.records import read_record, write_record

FILE = "poses.json"


@dataclass(frozen=True)
class FeatureFigures:
    """The figures of structure from motion.

    Attributes:
        keypoints: per camera name.   matches: raw ones per pair, "cam_0-cam_1".
        registered: names of the cameras that got a pose.
        points, reprojection_px: of the model; None when there is no model.
    """

    keypoints: dict[str, int]
    matches: dict[str, int]
    registered: tuple[str, ...] = ()
    points: int | None = None
    reprojection_px: float | None = None


@dataclass(frozen=True)
class PointCheck:
    """Fit of marked points to poses that need not have used them, from points in two or more views.

    Attributes:
        reprojection_px: mean over the points; None where the rays to a point are parallel and never meet.
        metres_per_unit: median over pairs of points of known distance; None without such a pair.
        spread: relative median deviation of `metres_per_unit`.
    """

    reprojection_px: float | None
    metres_per_unit: float | None
    spread: float | None


@dataclass(frozen=True)
class SketchFit:
    """How well poses from a sketch and the flame hold.

    Attributes:
        near: per pair, "cam_0-cam_1", the matches on the flame that lie near their epipolar lines.
        by_chance: how many would if features were matched at random.
        halves_px: how far on the flame, root mean square, poses by the even and the odd moments are apart, px of
            pictures with a longer side of 854; None where one half leads nowhere.
        off_sketch: largest difference from the sketch, in its standard deviations.
    """

    near: dict[str, int]
    by_chance: dict[str, float]
    halves_px: float | None
    off_sketch: float


@dataclass(frozen=True)
class UpReport:
    """Source of the world's Z axis.

    Attributes:
        source: marked "points", the cameras' "accelerometer", "edges" of upright things, the "board" standing upright,
            or the "cameras" held level on average.
        lean_deg: between this Z and the cameras' mean up.
        spread_deg: standard deviation: from drawing the edges again, from marks a pixel off, or of the accelerometers
            about their mean; None where there is no telling.
        edges: how many.
    """

    source: Literal["points", "accelerometer", "edges", "board", "cameras"]
    lean_deg: float = 0.0
    spread_deg: float | None = None
    edges: int = 0


@dataclass(frozen=True)
class PoseReport:
    """Source of the poses, and the figures by which they were judged.

    Attributes:
        method: "features": structure from motion; "points": the board or points by hand; "rig": those of another clip;
            "sketch": one of the rig, refined by the flame; "--cameras": given; "published": they came with the footage;
            "one camera": the flame's extent.
        scale: how the unit of length is known.
        notes: what could not be used, for people.
        sfm: None when no features were looked for.
        consistent: share of a pair's raw matches near their epipolar lines, per pair that has matches.
        check: None when no marked point is in two views.
        moved: per other clip of the rig, how far each camera's still picture lies from where it was, px; None without.
        up: how Z is known; None where it came with the poses.
        sketch: how well a sketch and the flame fit; None where there is no sketch.
    """

    method: Literal["--cameras", "features", "points", "published", "rig", "sketch", "one camera"]
    scale: str
    notes: tuple[str, ...] = ()
    sfm: FeatureFigures | None = None
    consistent: dict[str, float] | None = None
    check: PointCheck | None = None
    moved: dict[str, dict[str, float]] | None = None
    up: UpReport | None = None
    sketch: SketchFit | None = None


@dataclass(frozen=True)
class Poses:
    """poses.json. The poses themselves are in dataset.json.

    Attributes:
        points: (N, 3) sparse points on what stands still, world metres (or the unit that `report.scale` names).
    """

    SCHEMA: ClassVar[str] = "gof-poses"
    VERSION: ClassVar[int] = 1

    report: PoseReport
    points: tuple[tuple[float, float, float], ...] = ()

    @classmethod
    def of(cls, report: PoseReport, points: np.ndarray) -> Poses:
        """From points (N, 3), to the micrometre."""
        return cls(report, tuple(map(tuple, np.round(points, 6).tolist())))

    @classmethod
    def read(cls, folder: Path) -> Poses | None:
        """Read `folder/poses.json`; None where there is none, as in a generated dataset.

        Raises:
            DataFormatError: another schema or version, a wrong field (named).
        """
        return read_record(cls, folder / FILE) if (folder / FILE).is_file() else None

    def write(self, folder: Path) -> None:
        """Write `folder/poses.json`."""
        write_record(folder / FILE, self)

    def points_array(self) -> np.ndarray:
        """Return (N, 3) float64."""
        return np.array(self.points, np.float64).reshape(-1, 3)
