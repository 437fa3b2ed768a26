"""Metres and axes of the world: how long the poses' unit is, which way is up, where the origin lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.core.description import METRES
from gof.core.errors import DataFormatError
from gof.dataset.poses import PointCheck, UpReport
from gof.footage.lens import Lens
from gof.ingest import adjust, sfm
from gof.ingest.accelerometer import up_from_tilts
from gof.ingest.adjust import meetings
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.pose_clues import PoseClues, PoseOptions
from gof.ingest.sfm import PoseError
from gof.ingest.up import MOST_SPREAD_DEG, RESAMPLED, Edges, angle_deg, cameras_up, up_from_board, up_from_edges

MOST_APART = 0.08  # relative; of two lengths of one world that differ by more one is wrong


def metric_scale(poses: np.ndarray, check: PointCheck | None, options: PoseOptions) -> tuple[float, str]:
    """Factor from the poses' unit to metres, and words on where it is from."""
    centers = np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])
    baseline = float(np.linalg.norm(centers[-1] - centers[0]))
    if baseline < 1e-12:
        raise sfm.PoseError(
            "the first and the last camera stand at the same place; depth cannot be seen from one place"
        )
    if options.baseline_m is not None:
        require_one_scale(check, options.baseline_m / baseline, options, "--baseline-m")
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


def require_one_scale(check: PointCheck | None, metres_per_unit: float, options: PoseOptions, whose: str) -> None:
    """Raise PoseError: the scale of the poses, known by `whose` words, contradicts marked points of known size."""
    if not options.has_length or check is None or not check.metres_per_unit:
        return
    larger = check.metres_per_unit / metres_per_unit
    if abs(larger - 1) > MOST_APART:
        raise sfm.PoseError(
            f"marked points of known size (--marker-mm, or xyz of --points) and {whose} contradict each other: by the "
            f"points the world is {larger:.3g} times as large; leave out the one that is wrong"
        )


def find_up(
    poses: np.ndarray, clip: PoseClues, points: list[MarkedPoint], lenses: list[Lens], options: PoseOptions
) -> tuple[np.ndarray, UpReport, tuple[str, ...]]:
    """Return the vertical (3,) in the poses' world by `options.up`, and what a user should know of ways that led
    nowhere.

    "auto": what the user's points say, else the cameras' accelerometers, if two have one and they agree, else edges, if
    they agree, else the cameras.

    Raises:
        PoseError: the way chosen does not lead anywhere in this clip; points by hand contradict themselves.
    """
    level, choice, warnings = cameras_up(poses), options.up, []
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
            warnings = [f"up: {found}"] if any(tilt.up is not None or tilt.why for tilt in options.tilts) else []
        elif choice == "accelerometer" or found[1].spread_deg is not None:
            return *found, ()
        if choice == "accelerometer":
            raise sfm.PoseError(f"--up accelerometer: {found}")
    if choice in ("auto", "edges"):
        vertical = up_from_edges(Edges.find(clip.plates, clip.masks, lenses, poses), level)
        if vertical is not None:
            return *vertical, tuple(warnings)
        if choice == "edges":
            raise sfm.PoseError(
                "--up edges: too few straight edges agree on a vertical; use --up points, --up board or --up cameras"
            )
    return level, UpReport("cameras"), tuple(warnings)


def upright_world(world_to_camera: np.ndarray, up: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return world axes for poses in any frame.

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
    if np.linalg.norm(x) < 1e-9 * max(float(np.linalg.norm(baseline)), 1e-300):
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
    """Return (3,) nearest to the lines through centers (C, 3) along unit rays (C, 3); None when they are parallel."""
    across = [np.eye(3) - np.outer(ray, ray) for ray in rays]  # takes away what lies along the ray
    A = sum(across)
    if np.linalg.cond(A) >= 1e6:
        return None
    return np.linalg.solve(A, sum(P @ c for P, c in zip(across, centers, strict=True)))


# ----------------------------------------------------------------
# Which way is up, from marked points of which it is known that they stand above each other or lie level.

CLICK_PX = 1.0  # how well a hand marks a pixel: standard deviation in x and in y
MOST_OFF_DEG = 5.0  # a line or a surface that is further off than this is not what its name says

Kind = str  # "upright" or "level": the field of a point that holds its group's name
Group = tuple[Kind, str]


def says_up(points: list[MarkedPoint]) -> bool:
    """Return whether a point is named as standing on something upright, or lying on something level."""
    return any(p.upright or p.level for p in points)


def up_from_points(
    poses: np.ndarray, lenses: list[Lens], points: list[MarkedPoint], near: np.ndarray
) -> tuple[np.ndarray, UpReport]:
    """Return the vertical (3,), and by how much it turns where the marks are `CLICK_PX` off.

    Args:
        poses: (C, 4, 4) world to camera.   near: (3,) the cameras' mean up; of two opposite verticals, the one nearer.
    Raises:
        PoseError: no group of two points in two pictures; the points hold the vertical too loosely; a group does not
            fit the others; the cameras look straight up or down, so that nothing tells up from down.
    """
    named = [p for p in points if p.upright or p.level]
    seen = [p for p in named if len(p.pixels) >= 2]
    groups = _groups(seen)
    for kind, name in _groups(named):
        if len(groups.get((kind, name), ())) < 2:
            raise PoseError(f"--up points: of '{name}' ({kind}) fewer than two points are marked in two pictures")
    if not groups:
        raise PoseError('--up points: no point of --points says "upright" or "level" (docs/ingest.md)')
    found = meetings(poses, lenses, seen)
    if not np.isfinite(found).all():
        raise PoseError("--up points: the rays to a marked point are parallel; mark it in cameras further apart")
    up = _vertical(found, groups, near)
    if abs(up @ near) < np.sin(np.deg2rad(MOST_OFF_DEG)):
        raise PoseError("--up points: the vertical lies across the cameras' own, so nothing tells up from down")

    # ---- how sure is it, and does every group agree? -----------------------------------------------------------------
    rng = np.random.default_rng(0)
    turned = []
    for _ in range(RESAMPLED):
        moved = meetings(poses, lenses, [_moved(p, rng) for p in seen])
        turned.append(angle_deg(_vertical(moved, groups, up), up) if np.isfinite(moved).all() else 90.0)
    spread = float(np.sqrt(np.mean(np.square(turned))))
    if spread > MOST_SPREAD_DEG:
        raise PoseError(
            f"--up points: marks that are {CLICK_PX:g} px off turn this vertical by {spread:.0f} degrees; name points "
            "further apart: a taller post, or three corners of a wider floor"
        )
    for (kind, name), members in groups.items():
        off = _off_deg(found[members], up, kind)
        if off > max(MOST_OFF_DEG, 3 * spread):
            raise PoseError(f"--up points: '{name}' is {off:.0f} degrees from {kind}, by what all points say together")
    return up, UpReport("points", round(angle_deg(up, near), 2), round(spread, 2))


def _groups(points: list[MarkedPoint]) -> dict[Group, list[int]]:
    """Return numbers of the points of each thing that is upright or level."""
    groups: dict[Group, list[int]] = {}
    for k, point in enumerate(points):
        for kind in ("upright", "level"):
            if name := getattr(point, kind):
                groups.setdefault((kind, name), []).append(k)
    return groups


def _vertical(found: np.ndarray, groups: dict[Group, list[int]], near: np.ndarray) -> np.ndarray:
    """Return (3,) for which upright things reach least across it, and level ones least along it (least squares, in
    metres).

    Both are quadratic in the direction, so it is an eigenvector.
    """
    S = np.zeros((3, 3))
    for (kind, _), members in groups.items():
        offset = found[members] - found[members].mean(0)
        S += (1 if kind == "level" else -1) * offset.T @ offset
    up = np.linalg.eigh(S)[1][:, 0]
    return up * np.where(up @ near < 0, -1.0, 1.0)


def _off_deg(found: np.ndarray, up: np.ndarray, kind: Kind) -> float:
    """By how much points (N, 3) lean from the upright, or their surface from the level."""
    offset = found - found.mean(0)
    along = np.linalg.norm(offset @ up)
    across = np.linalg.norm(offset - np.outer(offset @ up, up))
    wrong, right = (along, across) if kind == "level" else (across, along)
    return float(np.rad2deg(np.arctan2(wrong, right)))


def _moved(point: MarkedPoint, rng: np.random.Generator) -> MarkedPoint:
    """Return the point, marked by another hand."""
    return replace(point, pixels={c: px + rng.normal(0, CLICK_PX, 2) for c, px in point.pixels.items()})
