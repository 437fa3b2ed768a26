"""Which way is up: from edges of things that stand upright (posts, walls), or from the sync board standing upright.

A vertical edge and a camera's centre span a plane that holds the vertical; edges of all cameras, whose poses are known,
vote for one direction (Fischler & Bolles 1981; segments by von Gioi et al. 2010, in OpenCV).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gof.dataset.poses import UpReport
from gof.footage.lens import Lens
from gof.ingest.marked_points import MarkedPoint

UpChoice = Literal["auto", "points", "accelerometer", "edges", "board", "cameras"]

LEAST_LENGTH = 0.025  # of the picture's height: a shorter edge's direction is a guess
CONE_DEG = 25.0  # cameras are held level to within this
OFF_DEG = 1.0  # an edge that misses the vertical by less is one that stands upright
TRIES = 1000
LEAST_EDGES = 6  # in one camera: one leaning stick has two edges, and all cameras see it
LEAST_CAMERAS = 2
LEAST_SHARE = 0.4  # of the length of all edges in the cone; chance gives a twentieth, the best of many tries an eighth
MOST_SPREAD_DEG = 3.0
RESAMPLED = 100


@dataclass(frozen=True)
class Edges:
    """Straight edges in the world's axes.

    Attributes:
        normal: (N, 3) unit normals of the planes through the camera and the edge.
        ray: (N, 3) unit rays to the edges' middles.
        length: (N,) px.   camera: (N,) numbers.
    """

    normal: np.ndarray
    ray: np.ndarray
    length: np.ndarray
    camera: np.ndarray

    @classmethod
    def find(cls, pictures: list[np.ndarray], masks: list[np.ndarray], lenses: list[Lens], poses: np.ndarray) -> Edges:
        """In pictures (H, W, 3) uint8 RGB, where masks (H, W) bool hold in the edge's middle.

        Args:
            poses: (C, 4, 4) world to camera.
        """
        import cv2

        parts = []
        for c, (picture, mask, lens) in enumerate(zip(pictures, masks, lenses, strict=True)):
            found = cv2.createLineSegmentDetector().detect(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))[0]
            ends = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2) + 0.5
            length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            x, y = np.clip(ends.mean(1).astype(int), 0, [mask.shape[1] - 1, mask.shape[0] - 1]).T
            kept = (length > LEAST_LENGTH * mask.shape[0]) & mask[y, x]
            ends, length = ends[kept], length[kept]
            rays = np.concatenate([ends, np.ones_like(ends[..., :1])], -1) @ np.linalg.inv(lens.K).T @ poses[c, :3, :3]
            parts.append((_unit(np.cross(rays[:, 0], rays[:, 1])), _unit(rays.sum(1)), length, np.full(len(length), c)))
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def among(self, chosen: np.ndarray) -> Edges:
        return Edges(self.normal[chosen], self.ray[chosen], self.length[chosen], self.camera[chosen])

    def off_deg(self, up: np.ndarray) -> np.ndarray:
        """Return (N,) degrees between each edge and the picture of the direction `up` (3,) at its middle."""
        upright = _unit(np.cross(self.ray, up))  # normal of the plane of an upright edge there
        return np.rad2deg(np.arccos(np.clip(np.abs((upright * self.normal).sum(1)), 0, 1)))

    def direction(self, near: np.ndarray) -> np.ndarray:
        """Return (3,) that lies in the edges' planes best (least squares, weighted by length), on the side of
        `near`."""
        up = np.linalg.eigh((self.normal * self.length[:, None] ** 2).T @ self.normal)[1][:, 0]
        return up * np.where(up @ near < 0, -1.0, 1.0)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def cameras_up(poses: np.ndarray) -> np.ndarray:
    """Return (3,) mean up of cameras (C, 4, 4): as true as they are level on average. Cameras that lie on their backs
    and their faces in turn have none; then that of the first."""
    mean = -poses[:, 1, :3].mean(0)
    size = np.linalg.norm(mean)
    return mean / size if size > 1e-6 else -poses[0, 1, :3]


def up_from_edges(edges: Edges, level: np.ndarray) -> tuple[np.ndarray, UpReport] | None:
    """Return the vertical (3,) and how well it is known; None where too few edges agree on one.

    Args:
        level: (3,) the cameras' mean up, from which it is less than CONE_DEG away.
    """
    near = edges.among(edges.off_deg(level) < CONE_DEG)
    if len(near.length) < LEAST_EDGES:
        return None
    rng = np.random.default_rng(0)
    share = near.length / near.length.sum()
    best, votes = None, 0.0
    for _ in range(TRIES):
        a, b = rng.choice(len(share), 2, replace=False, p=share)
        up = np.cross(near.normal[a], near.normal[b])
        size = np.linalg.norm(up)
        if size < 1e-3:
            continue  # one edge, seen twice
        up *= np.where(up @ level < 0, -1, 1) / size
        if up @ level > np.cos(np.deg2rad(CONE_DEG)):
            found = share[near.off_deg(up) < OFF_DEG].sum()
            best, votes = (up, found) if found > votes else (best, votes)
    if best is None:
        return None
    for _ in range(5):
        upright = near.among(near.off_deg(best) < OFF_DEG)
        if len(upright.length) < LEAST_EDGES:
            return None
        best = upright.direction(best)
    count = len(upright.length)
    # Edges drawn again and again say how far the answer hangs on which there are. All cameras see the same things, so
    # each draw is of as many as one camera sees.
    drawn = max(LEAST_CAMERAS, count // len(np.unique(upright.camera)))
    samples = [upright.among(rng.integers(0, count, drawn)).direction(best) for _ in range(RESAMPLED)]
    spread = float(np.sqrt(np.mean([angle_deg(s, best) ** 2 for s in samples])))
    votes = upright.length.sum() / near.length.sum()
    if np.bincount(upright.camera).max() < LEAST_EDGES:
        return None
    if votes < LEAST_SHARE or spread > MOST_SPREAD_DEG or len(np.unique(upright.camera)) < LEAST_CAMERAS:
        return None
    return best, UpReport("edges", round(angle_deg(best, level), 2), round(spread, 2), count)


def up_from_board(points: list[MarkedPoint], found: np.ndarray, level: np.ndarray) -> np.ndarray | None:
    """Return (3,) up of a board that stands upright, on whichever side: the direction of its sides that is nearest to
    `level`.

    None from fewer than three points.

    Args:
        points: of one board, with xyz.   found: (N, 3) where they are in the world; NaN where unknown.
    """
    known = np.isfinite(found).all(1)
    if known.sum() < 3:
        return None
    flat = np.array([p.xyz for p in points])[known]
    moved, centred = found[known] - found[known].mean(0), flat - flat.mean(0)
    U, _, V = np.linalg.svd(moved.T @ centred)
    turn = U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V
    sides = np.stack([turn[:, 0], -turn[:, 0], turn[:, 1], -turn[:, 1]])
    return sides[np.argmax(sides @ level)]


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Between two unit vectors (3,), exact for small ones too."""
    return float(np.rad2deg(2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b))))
