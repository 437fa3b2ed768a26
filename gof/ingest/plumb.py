"""Which way is up, from marked points of which it is known that they stand above each other or lie level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.dataset.poses import UpReport
from gof.footage.lens import Lens
from gof.ingest.adjust import meetings
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.sfm import PoseError
from gof.ingest.up import MOST_SPREAD_DEG, RESAMPLED, angle_deg

CLICK_PX = 1.0  # how well a hand marks a pixel: standard deviation in x and in y
MOST_OFF_DEG = 5.0  # a line or a surface that is further off than this is not what its name says

Kind = str  # "upright" or "level": the field of a point that holds its group's name
Group = tuple[Kind, str]


def says_up(points: list[MarkedPoint]) -> bool:
    """Whether a point is named as standing on something upright, or lying on something level."""
    return any(p.upright or p.level for p in points)


def up_from_points(
    poses: np.ndarray, lenses: list[Lens], points: list[MarkedPoint], near: np.ndarray
) -> tuple[np.ndarray, UpReport]:
    """The vertical (3,), and by how much it turns where the marks are `CLICK_PX` off.

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
    """Numbers of the points of each thing that is upright or level."""
    groups: dict[Group, list[int]] = {}
    for k, point in enumerate(points):
        for kind in ("upright", "level"):
            if name := getattr(point, kind):
                groups.setdefault((kind, name), []).append(k)
    return groups


def _vertical(found: np.ndarray, groups: dict[Group, list[int]], near: np.ndarray) -> np.ndarray:
    """(3,) for which upright things reach least across it, and level ones least along it (least squares, in metres).

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
    """The point, marked by another hand."""
    return replace(point, pixels={c: px + rng.normal(0, CLICK_PX, 2) for c, px in point.pixels.items()})
