"""Metres and axes of the world: how long the poses' unit is, which way is up, where the origin lies."""

from __future__ import annotations

import numpy as np

from gof.core.description import METRES
from gof.core.errors import DataFormatError
from gof.dataset.poses import PointCheck, UpReport
from gof.footage.lens import Lens
from gof.ingest import adjust, sfm
from gof.ingest.accelerometer import up_from_tilts
from gof.ingest.evidence import Evidence, PoseOptions
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.plumb import says_up, up_from_points
from gof.ingest.up import Edges, angle_deg, cameras_up, up_from_board, up_from_edges


def metric_scale(poses: np.ndarray, check: PointCheck | None, options: PoseOptions) -> tuple[float, str]:
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
        words = "unknown: the unit is the distance between first and last camera (give --marker-mm or --baseline-m)"
        return 1 / baseline, words
    if check is None or not check.metres_per_unit:
        raise DataFormatError(
            "the scale is to come from marked points, but fewer than two with xyz are in two views; use --baseline-m"
        )
    return check.metres_per_unit, f"{METRES}, from points of known size (spread {check.spread:.1%})"


def find_up(
    poses: np.ndarray, clip: Evidence, points: list[MarkedPoint], lenses: list[Lens], options: PoseOptions
) -> tuple[np.ndarray, UpReport, tuple[str, ...]]:
    """The vertical (3,) in the poses' world by `options.up`, and what a user should know of ways that led nowhere.

    "auto": what the user's points say, else the cameras' accelerometers, if two have one and they agree, else edges, if
    they agree, else the cameras.

    Raises:
        PoseError: the way chosen does not lead anywhere in this clip; points by hand contradict themselves.
    """
    level, choice, doubts = cameras_up(poses), options.up, []
    if choice == "points" or (choice == "auto" and says_up(points)):
        return *up_from_points(poses, lenses, points, level), ()
    if choice == "board":
        board = [p for p in points if p.board == 0 and p.xyz is not None and len(p.pixels) >= 2]
        up = up_from_board(board, adjust.meetings(poses, lenses, board), level)
        if up is None:
            raise sfm.PoseError("--up board: fewer than three of the board's points are in two views")
        return up, UpReport("board", round(angle_deg(up, level), 2)), ()
    if choice in ("auto", "accelerometer"):
        found = up_from_tilts(poses, options.tilts, level)
        if isinstance(found, str):
            doubts = [f"up: {found}"] if any(tilt.up is not None or tilt.why for tilt in options.tilts) else []
        elif choice == "accelerometer" or found[1].spread_deg is not None:
            return *found, ()
        if choice == "accelerometer":
            raise sfm.PoseError(f"--up accelerometer: {found}")
    if choice in ("auto", "edges"):
        found = up_from_edges(Edges.find(clip.plates, clip.masks, lenses, poses), level)
        if found is not None:
            return *found, tuple(doubts)
        if choice == "edges":
            raise sfm.PoseError(
                "--up edges: too few straight edges agree on a vertical; use --up points, --up board or --up cameras"
            )
    return level, UpReport("cameras"), tuple(doubts)


def upright_world(world_to_camera: np.ndarray, up: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """World axes for poses in any frame.

    Z lies along `up` (3,), or the cameras' mean up, X from the first to the last camera (level), the origin where the
    optical axes come nearest to each other.

    Cameras that look along parallel lines put the origin at their
    mean distance apart in front of them.

    Returns:
        the new world_to_camera (C, 4, 4), and the (4, 4) map from old to new world.
    """
    R = world_to_camera[:, :3, :3]
    centers = -np.einsum("cij,ci->cj", R, world_to_camera[:, :3, 3])
    baseline = centers[-1] - centers[0]
    z = cameras_up(world_to_camera) if up is None else up
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
