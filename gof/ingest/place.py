"""Where the cameras stand: solvers, their checks against each other, the metric scale and the world's axes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gof.capture.template import BoardTemplate
from gof.dataset.description import METRES
from gof.dataset.poses import FeatureFigures, PointCheck, PoseReport
from gof.errors import DataFormatError, GofError
from gof.ingest import adjust, sfm
from gof.ingest.board import board_points, board_region
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.over_time import largest_change
from gof.lens import Lens

STILL_RANGE = 60  # of 255: pixels that change more over the clip show fire or LEDs and get no features
MIN_CONSISTENT = 0.6  # share of a pair's raw matches that must obey the poses
MAX_POINT_PX = 1.5  # mean reprojection error of board or hand-marked points above which poses are not believed
MAX_SIDE_SPREAD = 0.08  # relative spread of the marker's distances; a wrong pose makes a square a trapezium

Solver = Literal["auto", "features", "points"]
Method = Literal["features", "points"]


@dataclass(frozen=True)
class PoseOptions:
    """What is known of the scene beside its pictures.

    Attributes:
        solver: "features": structure from motion; "points": the board or points by hand; "auto": the first that holds.
        by_hand: marked points.
        board: to look for; None does not look.
        marker_m: side of the board's marker in m; gives the scale.
        baseline_m: distance between the first and the last camera in m; gives the scale.

    Raises:
        GofError: a length is not positive.
    """

    solver: Solver = "auto"
    by_hand: tuple[MarkedPoint, ...] = ()
    board: BoardTemplate | None = None
    marker_m: float | None = None
    baseline_m: float | None = None

    def __post_init__(self):
        for value, name in ((self.marker_m, "--marker-m"), (self.baseline_m, "--baseline-m")):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise GofError(f"{name} {value}: must be a positive length in metres")

    @property
    def has_length(self) -> bool:
        """Whether the coordinates of the marked points are true metres."""
        return self.marker_m is not None or any(p.xyz is not None for p in self.by_hand)

    @property
    def marker_side(self) -> float:
        """Side of the marker in metres, or in a unit of its own."""
        return self.marker_m or 1.0


@dataclass(frozen=True)
class Placed:
    """world_to_camera (C, 4, 4) in metres (or the unit the report names), sparse points (N, 3), what was measured."""

    world_to_camera: np.ndarray
    points: np.ndarray
    report: PoseReport


def place_cameras(
    clips: list[Collection[np.ndarray]],
    lowest: list[np.ndarray],
    lenses: list[Lens],
    names: list[str],
    given: np.ndarray | None,
    options: PoseOptions,
) -> Placed:
    """Poses of all cameras in metric world axes (Z up).

    Args:
        clips: per camera its (H, W, 3) uint8 RGB pictures.
        lowest: (H, W, 3) uint8 minimum plates.
        lenses: of the upright pictures.
        given: (C, 4, 4) poses that are known already and only checked, or None.
    Raises:
        PoseError: no solver's poses hold; says what each found, per camera, and what to do.
    """
    # ---- what is marked ----------------------------------------------------------------------------------------------
    board, notes = board_points(clips, options.board, options.marker_side) if options.board else ([], [])
    points = _all_points(board, options)
    if given is not None:
        check = adjust.check_points(points, lenses, given)
        report = PoseReport("--cameras", f"{METRES}, from --cameras", tuple(notes), check=check)
        return Placed(given, np.zeros((0, 3)), report)

    # ---- solvers, and what the checks say of each --------------------------------------------------------------------
    solved = sfm.solve(lowest, _feature_masks(clips, board, options), lenses, names)
    attempts = [_from_features(solved, points, lenses, names, options)]
    if options.solver == "points" or (options.solver == "auto" and attempts[0].refused):
        attempts.append(_from_points(solved.features, points, lenses, names))
    chosen = attempts[-1]
    if chosen.refused:
        raise sfm.PoseError(_advice(attempts, solved.figures, notes))

    # ---- metres, and the world's axes --------------------------------------------------------------------------------
    factor, scale = _scale(chosen.model.world_to_camera, chosen.check, options)
    metric = chosen.model.world_to_camera.copy()
    metric[:, :3, 3] *= factor
    world_to_camera, transform = upright_world(metric)
    cloud = chosen.model.points * factor @ transform[:3, :3].T + transform[:3, 3]
    report = PoseReport(chosen.method, scale, tuple(notes), solved.figures, chosen.consistent, chosen.check)
    return Placed(world_to_camera, cloud, report)


def _all_points(board: list[MarkedPoint], options: PoseOptions) -> list[MarkedPoint]:
    """Points by hand, then the board's. Two sets of coordinates have no common origin: those given by hand decide."""
    if any(p.xyz is not None for p in options.by_hand):
        board = [p.without_xyz() for p in board]
    return [*options.by_hand, *board]


def _feature_masks(
    clips: list[Collection[np.ndarray]], board: list[MarkedPoint], options: PoseOptions
) -> list[np.ndarray]:
    """(H, W) bool per camera: where features may be, on what stands still and is not the board."""
    masks = [_still(clip) for clip in clips]
    if options.board:
        for c, mask in enumerate(masks):
            mask &= ~board_region(board, c, options.board, options.marker_side, mask.shape)
    return masks


def _still(clip: Collection[np.ndarray]) -> np.ndarray:
    """(H, W) bool: pixels that hardly change, shrunk by two pixels."""
    import cv2

    return cv2.erode((largest_change(clip) <= STILL_RANGE).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


# ---- solvers and checks ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Attempt:
    """One solver's poses and what the checks say of them; `refused` is why they are not believed."""

    method: Method
    model: sfm.Model | None = None
    consistent: dict[str, float] | None = None
    check: PointCheck | None = None
    refused: str | None = None


def _from_features(
    solved: sfm.Solution, points: list[MarkedPoint], lenses: list[Lens], names: list[str], options: PoseOptions
) -> _Attempt:
    """Structure from motion; points by hand join its matches in one more adjustment, without their coordinates."""
    model = solved.model
    if model is None:
        missing = [n for n in names if n not in solved.figures.registered]
        why = f"not registered: {', '.join(missing)} (matches {solved.figures.matches})"
        return _Attempt("features", refused=why)
    if options.by_hand and options.solver != "points":
        chains = adjust.tracks(solved.features, lenses, model.world_to_camera, adjust.GATES_PX[-1])
        model = adjust.bundle(model.world_to_camera, lenses, [p.without_xyz() for p in points], chains)
    return _judged("features", model, solved.features, points, lenses, names)


def _from_points(features: sfm.Features, points: list[MarkedPoint], lenses: list[Lens], names: list[str]) -> _Attempt:
    """Poses from points of known coordinates."""
    try:
        model = adjust.from_known_points(points, features, lenses, names)
    except sfm.PoseError as e:
        return _Attempt("points", refused=str(e))
    return _judged("points", model, features, points, lenses, names)


def _judged(
    method: Method,
    model: sfm.Model,
    features: sfm.Features,
    points: list[MarkedPoint],
    lenses: list[Lens],
    names: list[str],
) -> _Attempt:
    """Two checks that need no truth: most raw matches obey the poses, and marked points are where the poses say."""
    share = sfm.consistent_share(features, lenses, model.world_to_camera)
    consistent = {f"{names[i]}-{names[j]}": round(v, 3) for (i, j), v in share.items() if np.isfinite(v)}
    check = adjust.check_points(points, lenses, model.world_to_camera)
    return _Attempt(method, model, consistent, check, _objection(consistent, check))


def _objection(consistent: dict[str, float], check: PointCheck | None) -> str | None:
    """Why these figures do not let the poses be believed, or None."""
    weak = [pair for pair, share in consistent.items() if share < MIN_CONSISTENT]
    if weak:
        return f"fewer than {MIN_CONSISTENT:.0%} of the matches of {', '.join(weak)} fit the poses"
    if check is None:
        return None
    if check.reprojection_px is None:
        return "the rays to a marked point are parallel"
    if check.reprojection_px > MAX_POINT_PX:
        return f"marked points miss by {check.reprojection_px:.1f} px on average"
    if check.spread is not None and check.spread > MAX_SIDE_SPREAD:
        return f"the marker's sides differ by {check.spread:.0%} under these poses"
    return None


def _advice(attempts: list[_Attempt], figures: FeatureFigures, notes: list[str]) -> str:
    """What failed, and what to do about it."""
    source = {"features": "image features", "points": "known points"}
    lines = ["camera poses could not be solved:"]
    lines += [f"  from {source[a.method]}: {a.refused}" for a in attempts if a.refused]
    lines += [f"  {name}: {count} features" for name, count in figures.keypoints.items()]
    lines += [f"  {note}" for note in notes]
    lines.append(
        "what helps: texture that stands still in all views (bricks, gravel, printed paper); the sync board whole in "
        "every view; cameras closer together (about 10 degrees); the right --fov; plates without people; or 6 or more "
        "points by hand with --points (docs/ingest.md), four of them with xyz"
    )
    return "\n".join(lines)


# ---- scale and axes --------------------------------------------------------------------------------------------------


def _scale(poses: np.ndarray, check: PointCheck | None, options: PoseOptions) -> tuple[float, str]:
    """Factor from the poses' unit to metres, and words on where it is from."""
    centers = np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])
    baseline = float(np.linalg.norm(centers[-1] - centers[0]))
    if baseline < 1e-12:
        raise sfm.PoseError(
            "the first and the last camera stand at the same place; depth cannot be seen from one place"
        )
    if options.baseline_m is not None:
        words = f"{METRES}, from the distance of {options.baseline_m:g} m between first and last camera"
        return options.baseline_m / baseline, words
    if not options.has_length:
        words = "unknown: the unit is the distance between first and last camera (give --marker-m or --baseline-m)"
        return 1 / baseline, words
    if check is None or not check.metres_per_unit:
        raise DataFormatError(
            "the scale is to come from marked points, but fewer than two with xyz are in two views; use --baseline-m"
        )
    return check.metres_per_unit, f"{METRES}, from points of known size (spread {check.spread:.1%})"


def upright_world(world_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World axes for poses in any frame.

    Z lies along the cameras' mean up, X from the first to the last camera (level), the origin where the optical axes
    come nearest to each other.

    Up is as true as the cameras are level on average. Cameras that look along parallel lines put the origin at their
    mean distance apart in front of them.

    Returns:
        the new world_to_camera (C, 4, 4), and the (4, 4) map from old to new world.
    """
    R = world_to_camera[:, :3, :3]
    centers = -np.einsum("cij,ci->cj", R, world_to_camera[:, :3, 3])
    baseline = centers[-1] - centers[0]
    z = -R[:, 1].mean(0)
    z /= np.linalg.norm(z)
    x = baseline - z * (baseline @ z)
    if np.linalg.norm(x) < 1e-9 * max(np.linalg.norm(baseline), 1e-300):
        x = R[0, 0] - z * (R[0, 0] @ z)  # cameras above each other
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    origin = _meeting_point(centers, R[:, 2])
    if origin is None:
        origin = centers.mean(0) + R[:, 2].mean(0) * np.linalg.norm(baseline)
    transform = np.eye(4)
    transform[:3, :3] = axes
    transform[:3, 3] = -axes @ origin
    return world_to_camera @ np.linalg.inv(transform), transform


def _meeting_point(centers: np.ndarray, rays: np.ndarray) -> np.ndarray | None:
    """(3,) nearest to the lines through centers (C, 3) along unit rays (C, 3); None when they are parallel."""
    across = [np.eye(3) - np.outer(ray, ray) for ray in rays]  # takes away what lies along the ray
    A = sum(across)
    if np.linalg.cond(A) >= 1e6:
        return None
    return np.linalg.solve(A, sum(P @ c for P, c in zip(across, centers, strict=True)))
