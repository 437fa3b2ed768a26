"""Poses from known points (a marker, measured points), refined with image matches: where SfM alone goes wrong."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from gof.dataset.poses import PointCheck
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.sfm import Features, Model, PoseError, epipolar_distance
from gof.lens import Lens

GATES_PX = (25.0, 8.0, 4.0, 2.5)  # epipolar gates, each followed by a bundle adjustment
MAX_TRACKS = 300
KNOWN_WEIGHT = 3.0  # points with known coordinates against one feature
AGREEMENT_PX = 10.0  # a match this far from its epipolar line counts 1/e

Track = dict[int, np.ndarray]  # camera -> (2,) px


def triangulate(matrices: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(3,) point from (V, 3, 4) projection matrices and (V, 2) pixels, linear; NaN for parallel rays."""
    rows = np.concatenate(
        [pixels[:, :1] * matrices[:, 2] - matrices[:, 0], pixels[:, 1:] * matrices[:, 2] - matrices[:, 1]]
    )
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    _, singular, V = np.linalg.svd(rows)
    if singular[2] < 1e-9 * singular[0] or abs(V[-1, 3]) < 1e-12:
        return np.full(3, np.nan)
    return V[-1, :3] / V[-1, 3]


# ---- a start: perspective-n-point in every camera --------------------------------------------------------------------


def from_known_points(points: list[MarkedPoint], features: Features, lenses: list[Lens], names: list[str]) -> Model:
    """Perspective-n-point in every camera, then feature tracks near the epipolar lines join a robust bundle adjustment.

    A plane seen by one camera has two poses that fit almost equally; all combinations are tried and the one that most
    feature matches agree with starts.

    Args:
        points: xyz in metres; those of rough points start the poses, but the adjustment does not hold to them.
    Raises:
        PoseError: a camera sees fewer than four points with xyz, or no pose fits them.
    """
    options = [_pnp(c, points, lens, name) for c, (lens, name) in enumerate(zip(lenses, names, strict=True))]
    poses = max(
        (np.stack(combination) for combination in product(*options)),
        key=lambda candidate: _agreement(features, lenses, candidate),
    )
    for gate in GATES_PX:
        model = bundle(poses, lenses, points, tracks(features, lenses, poses, gate))
        poses = model.world_to_camera
    return model


def _pnp(camera: int, points: list[MarkedPoint], lens: Lens, name: str) -> list[np.ndarray]:
    """The (4, 4) poses of one camera that fit its points with xyz: two when they lie in a plane."""
    import cv2

    seen = [p for p in points if camera in p.pixels and p.xyz is not None]
    if len(seen) < 4:
        raise PoseError(
            f"camera '{name}' sees {len(seen)} points with known coordinates, 4 are needed. Mark more with --points, "
            "or move the board to where every camera sees all of its marker"
        )
    xyz = np.array([p.xyz for p in seen])
    pixels = np.array([p.pixels[camera] for p in seen])
    spread = np.linalg.svd(xyz - xyz.mean(0), compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        raise PoseError(f"camera '{name}': its known points lie on one line; add one beside it")
    flat = spread[2] < 1e-6 * spread[0]
    kind = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_SQPNP
    _, rotations, shifts, _ = cv2.solvePnPGeneric(xyz, pixels, lens.K, None, flags=kind)
    poses = []
    for r, t in zip(rotations, shifts, strict=True):
        r, t = cv2.solvePnPRefineLM(xyz, pixels, lens.K, None, r, t)
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(r)[0]
        pose[:3, 3] = t.ravel()
        if np.isfinite(pose).all() and ((xyz @ pose[:3, :3].T + pose[:3, 3])[:, 2] > 0).all():
            poses.append(pose)
    if not poses:
        raise PoseError(
            f"camera '{name}': no pose puts its known points in front of it; "
            "are their pixels and xyz in the same order?"
        )
    return poses


def _agreement(features: Features, lenses: list[Lens], poses: np.ndarray) -> float:
    """How well raw matches fit: mean of exp(-error / AGREEMENT_PX), 0 without matches."""
    fits = [
        np.exp(-epipolar_distance(lenses, poses, i, j, *features.pair(i, j)) / AGREEMENT_PX)
        for (i, j), m in features.matches.items()
        if len(m)
    ]
    return float(np.concatenate(fits).mean()) if fits else 0.0


def tracks(features: Features, lenses: list[Lens], poses: np.ndarray, gate: float) -> list[Track]:
    """Matches within `gate` px of their epipolar lines, joined over views; at most MAX_TRACKS, those in most views."""
    track_of: dict[tuple[int, int], int] = {}  # (camera, keypoint) -> number of its track
    chains: list[Track] = []
    for (i, j), m in features.matches.items():
        near = epipolar_distance(lenses, poses, i, j, *features.pair(i, j)) < gate
        for a, b in m[near]:
            ends = (i, int(a)), (j, int(b))
            track = track_of.get(ends[0], track_of.get(ends[1]))
            if track is None:
                track = len(chains)
                chains.append({})
            for end in ends:
                camera, keypoint = end
                if track_of.get(end, track) == track and camera not in chains[track]:
                    track_of[end] = track
                    chains[track][camera] = features.keypoints[camera][keypoint]
    chains = [t for t in chains if len(t) >= 2]
    # Poses of a few cameras are settled by some hundred points; those in most views say most.
    order = np.random.default_rng(0).permutation(len(chains))
    return sorted((chains[k] for k in order), key=len, reverse=True)[:MAX_TRACKS]


# ---- bundle adjustment -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Observations:
    """Who sees what, O of them.

    Attributes:
        camera, point: (O,) numbers; points that move count from 0, known ones are -1, -2, ...
        pixel: (O, 2).   weight: (O,).
    """

    camera: np.ndarray
    point: np.ndarray
    pixel: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, known: list[MarkedPoint], free: list[Track]) -> _Observations:
        rows = [(c, -1 - k, pixel, KNOWN_WEIGHT) for k, p in enumerate(known) for c, pixel in p.pixels.items()]
        rows += [(c, k, pixel, 1.0) for k, track in enumerate(free) for c, pixel in track.items()]
        if not rows:
            raise PoseError("no feature and no marked point is in two pictures, and no marked point has believed xyz")
        camera, point, pixel, weight = zip(*rows, strict=True)
        return cls(np.array(camera), np.array(point), np.array(pixel), np.array(weight))


def bundle(poses: np.ndarray, lenses: list[Lens], points: list[MarkedPoint], chains: list[Track]) -> Model:
    """Robust bundle adjustment (soft L1 at 1 px) with fixed intrinsics; points whose xyz are known stay where they are.

    Args:
        poses: (C, 4, 4) world to camera to start from.
    Returns:
        the refined poses, and the triangulated points (N, 3) that lay in front of their cameras.
    Raises:
        PoseError: nothing to adjust to.
    """
    known = [p for p in points if p.is_known]
    free = chains + [p.pixels for p in points if not p.is_known and len(p.pixels) >= 2]
    free, start = _triangulated(poses, lenses, free)
    seen = _Observations.of(known, free)
    fixed = np.array([p.xyz for p in known]).reshape(-1, 3)
    K = np.stack([lens.K for lens in lenses])
    count = len(poses)
    unit = _typical_distance(poses, np.concatenate([start, fixed]))

    def unpack(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rotations (C, 3, 3), shifts (C, 3) and free points (N, 3) of the parameters."""
        R = Rotation.from_rotvec(x[: 3 * count].reshape(count, 3)).as_matrix()
        return R, x[3 * count : 6 * count].reshape(count, 3), x[6 * count :].reshape(-1, 3)

    def residuals(x: np.ndarray) -> np.ndarray:
        R, t, moving = unpack(x)
        world = np.concatenate([moving, fixed[::-1]])[seen.point]  # -1 is the last: the first known point
        local = np.einsum("oij,oj->oi", R[seen.camera], world) + t[seen.camera]
        uv = local[:, :2] / np.maximum(local[:, 2:], 1e-6 * unit)
        projected = np.einsum("oij,oj->oi", K[seen.camera][:, :2, :2], uv) + K[seen.camera][:, :2, 2]
        return ((projected - seen.pixel) * seen.weight[:, None]).ravel()

    rotations = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    x0 = np.concatenate([rotations.ravel(), poses[:, :3, 3].ravel(), start.ravel()])
    # Steps of a hundredth of a radian, and of the typical distance, so that they do not depend on the unit.
    x_scale = np.concatenate([np.full(3 * count, 0.01), np.full(len(x0) - 3 * count, 0.01 * unit)])
    sparsity = _sparsity(seen, count, len(x0))
    found = least_squares(residuals, x0, jac_sparsity=sparsity, loss="soft_l1", x_scale=x_scale, max_nfev=30)
    R, t, cloud = unpack(found.x)
    refined = np.tile(np.eye(4), (count, 1, 1))
    refined[:, :3, :3] = R
    refined[:, :3, 3] = t
    return Model(refined, cloud)


def _triangulated(poses: np.ndarray, lenses: list[Lens], free: list[Track]) -> tuple[list[Track], np.ndarray]:
    """The tracks whose point lies in front of all its cameras, and the points (N, 3)."""
    matrices = _projection_matrices(lenses, poses)
    kept, points = [], []
    for track in free:
        views = list(track)
        x = triangulate(matrices[views], np.array([track[v] for v in views]))
        if np.isfinite(x).all() and all((poses[v, 2, :3] @ x + poses[v, 2, 3]) > 0 for v in views):
            kept.append(track)
            points.append(x)
    return kept, np.array(points).reshape(-1, 3)


def _projection_matrices(lenses: list[Lens], poses: np.ndarray) -> np.ndarray:
    """(C, 3, 4) world to homogeneous pixels."""
    return np.stack([lens.K @ pose[:3] for lens, pose in zip(lenses, poses, strict=True)])


def _typical_distance(poses: np.ndarray, points: np.ndarray) -> float:
    """Median distance of points (N, 3) from the cameras."""
    centers = np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])
    return float(np.median(np.linalg.norm(points[:, None] - centers, axis=-1)))


def _sparsity(seen: _Observations, cameras: int, parameters: int) -> lil_matrix:
    """Which parameters (rotations, shifts, free points) each residual depends on, (2 O, parameters)."""
    sparsity = lil_matrix((2 * len(seen.camera), parameters), dtype=np.int8)
    rows = np.arange(len(seen.camera))
    moving = seen.point >= 0
    for d in range(2):
        for k in range(3):
            sparsity[2 * rows + d, 3 * seen.camera + k] = 1
            sparsity[2 * rows + d, 3 * cameras + 3 * seen.camera + k] = 1
            sparsity[2 * rows[moving] + d, 6 * cameras + 3 * seen.point[moving] + k] = 1
    return sparsity


# ---- what marked points say of poses ---------------------------------------------------------------------------------


def check_points(points: list[MarkedPoint], lenses: list[Lens], poses: np.ndarray) -> PointCheck | None:
    """Triangulate the points that two or more cameras see; None when there is none.

    Args:
        poses: (C, 4, 4) world to camera.
    """
    matrices = _projection_matrices(lenses, poses)
    errors, known, found = [], [], []
    for p in points:
        views = list(p.pixels)
        if len(views) < 2:
            continue
        pixels = np.array([p.pixels[v] for v in views])
        x = triangulate(matrices[views], pixels)
        if not np.isfinite(x).all():
            errors.append(np.inf)
            continue
        projected = matrices[views] @ np.append(x, 1)
        errors.append(float(np.linalg.norm(projected[:, :2] / projected[:, 2:] - pixels, axis=1).mean()))
        if p.is_known:
            known.append(p.xyz)
            found.append(x)
    if not errors:
        return None
    error = float(np.mean(errors))
    return PointCheck(round(error, 6) if np.isfinite(error) else None, *_unit(np.array(known), np.array(found)))


def _unit(known: np.ndarray, found: np.ndarray) -> tuple[float | None, float | None]:
    """Metres per unit of the found points (N, 3), and its relative spread, from the distances between all pairs."""
    if len(known) < 2:
        return None, None
    pairs = np.triu_indices(len(known), 1)
    truth = np.linalg.norm(known[:, None] - known, axis=-1)[pairs]
    solved = np.linalg.norm(found[:, None] - found, axis=-1)[pairs]
    apart = (truth > 0) & (solved > 0)
    if not apart.any():
        return None, None
    ratios = truth[apart] / solved[apart]
    ratio = float(np.median(ratios))
    return round(ratio, 6), round(float(np.median(np.abs(ratios - ratio)) / ratio), 6)
