"""Camera poses from known points (a marker, measured points), refined with image matches: for scenes where SfM alone goes wrong."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from gof.ingest.sfm import Features, PoseError, Poses, epipolar_distance
from gof.lens import Lens

GATES_PX = (25.0, 8.0, 4.0, 2.5)  # epipolar gates, each followed by a bundle adjustment
MAX_TRACKS = 300
KNOWN_WEIGHT = 3.0  # points with known coordinates against one feature


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


def from_known_points(points: list[dict], features: Features, lenses: list[Lens], names: list[str]) -> Poses:
    """Perspective-n-point in every camera, then feature tracks near the epipolar lines join a robust bundle adjustment.

    A plane seen by one camera has two poses that fit almost equally; all combinations are tried and the one that most
    feature matches agree with starts.

    Args:
        points: as `read_points`; xyz in metres. "rough" points (True) start the pose but their xyz are not believed.
    Raises:
        PoseError: a camera sees fewer than four points with xyz, or no pose fits them.
    """
    options = [_pnp(c, points, lens, name) for c, (lens, name) in enumerate(zip(lenses, names, strict=True))]
    start = max(
        (np.stack(combination) for combination in product(*options)),
        key=lambda poses: _agreement(features, lenses, poses),
    )
    poses = start
    for gate in GATES_PX:
        poses, cloud, error = bundle(poses, lenses, points, tracks(features, lenses, poses, gate))
    return Poses(poses, cloud, {"points": len(cloud), "reprojection_px": round(error, 3)})


def _pnp(c: int, points: list[dict], lens: Lens, name: str) -> list[np.ndarray]:
    import cv2

    seen = [p for p in points if c in p["pixels"] and p["xyz"] is not None]
    if len(seen) < 4:
        raise PoseError(
            f"camera '{name}' sees {len(seen)} points with known coordinates, 4 are needed. Mark more with --points, or move "
            "the board to where every camera sees all of its marker"
        )
    xyz, pixels = np.array([p["xyz"] for p in seen]), np.array([p["pixels"][c] for p in seen])
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
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(r)[0], t.ravel()
        if np.isfinite(pose).all() and ((xyz @ pose[:3, :3].T + pose[:3, 3])[:, 2] > 0).all():
            poses.append(pose)
    if not poses:
        raise PoseError(
            f"camera '{name}': no pose puts its known points in front of it; are their pixels and xyz in the same order?"
        )
    return poses


def _believed(point: dict) -> bool:
    return point["xyz"] is not None and not point.get("rough")


def _agreement(features: Features, lenses, poses) -> float:
    """How well raw matches fit: mean of exp(-error / 10 px), 0 without matches."""
    fits = [
        np.exp(-epipolar_distance(lenses, poses, i, j, *features.pair(i, j)) / 10)
        for (i, j), m in features.matches.items()
        if len(m)
    ]
    return float(np.concatenate(fits).mean()) if fits else 0.0


def tracks(features: Features, lenses, poses, gate: float) -> list[dict[int, np.ndarray]]:
    """Matches within `gate` px of their epipolar lines, joined over views: {camera: pixel} per track."""
    track_of, chains = {}, []
    for (i, j), m in features.matches.items():
        near = epipolar_distance(lenses, poses, i, j, *features.pair(i, j)) < gate
        for a, b in m[near]:
            ka, kb = (i, int(a)), (j, int(b))
            t = track_of.get(ka, track_of.get(kb))
            if t is None:
                t = len(chains)
                chains.append({})
            for key in (ka, kb):
                if track_of.get(key, t) == t and key[0] not in chains[t]:
                    track_of[key] = t
                    chains[t][key[0]] = features.keypoints[key[0]][key[1]]
    chains = [t for t in chains if len(t) >= 2]
    # Poses of a few cameras are settled by some hundred points; those in most views say most.
    order = np.random.default_rng(0).permutation(len(chains))
    return sorted((chains[k] for k in order), key=len, reverse=True)[:MAX_TRACKS]


def bundle(
    poses: np.ndarray, lenses: list[Lens], points: list[dict], chains: list[dict[int, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Robust bundle adjustment (soft L1 at 1 px) with fixed intrinsics; points with believed xyz stay where they are.

    Returns:
        poses (C, 4, 4), triangulated points (N, 3) that lie in front of their cameras, median reprojection error in px.
    """
    known = [p for p in points if _believed(p)]
    free = chains + [p["pixels"] for p in points if not _believed(p) and len(p["pixels"]) >= 2]
    matrices = np.stack([lens.K @ pose[:3] for lens, pose in zip(lenses, poses, strict=True)])
    start, kept = [], []
    for track in free:
        views = list(track)
        x = triangulate(matrices[views], np.array([track[v] for v in views]))
        if np.isfinite(x).all() and all((poses[v, 2, :3] @ x + poses[v, 2, 3]) > 0 for v in views):
            start.append(x)
            kept.append(track)
    observations = [(c, -1 - k, pixel, KNOWN_WEIGHT) for k, p in enumerate(known) for c, pixel in p["pixels"].items()]
    observations += [(c, k, pixel, 1.0) for k, track in enumerate(kept) for c, pixel in track.items()]
    camera, point = np.array([o[0] for o in observations]), np.array([o[1] for o in observations])
    pixel, weight = np.array([o[2] for o in observations]), np.array([o[3] for o in observations])
    fixed = np.array([p["xyz"] for p in known]).reshape(-1, 3)
    n = len(poses)
    K = np.stack([lens.K for lens in lenses])

    def unpack(x):
        return (
            Rotation.from_rotvec(x[: 3 * n].reshape(n, 3)).as_matrix(),
            x[3 * n : 6 * n].reshape(n, 3),
            x[6 * n :].reshape(-1, 3),
        )

    def residuals(x):
        R, t, free_points = unpack(x)
        # Known points are numbered -1, -2, ...
        world = np.concatenate([free_points, fixed[::-1]])[point]
        local = np.einsum("oij,oj->oi", R[camera], world) + t[camera]
        uv = local[:, :2] / np.maximum(local[:, 2:], 1e-6 * scale)
        projected = np.einsum("oij,oj->oi", K[camera][:, :2, :2], uv) + K[camera][:, :2, 2]
        return ((projected - pixel) * weight[:, None]).ravel()

    # Lengths in units of the cameras' mean distance to the points, so that steps do not depend on the unit.
    centers = np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])
    everything = np.concatenate([np.array(start).reshape(-1, 3), fixed])
    scale = float(np.median(np.linalg.norm(everything[:, None] - centers, axis=-1)))
    x0 = np.concatenate(
        [
            Rotation.from_matrix(poses[:, :3, :3]).as_rotvec().ravel(),
            poses[:, :3, 3].ravel(),
            np.array(start).ravel(),
        ]
    )
    sparsity = lil_matrix((2 * len(camera), len(x0)), dtype=np.int8)
    rows = np.arange(len(camera))
    for d in range(2):
        for k in range(3):
            sparsity[2 * rows + d, 3 * camera + k] = 1
            sparsity[2 * rows + d, 3 * n + 3 * camera + k] = 1
            mine = point >= 0
            sparsity[2 * rows[mine] + d, 6 * n + 3 * point[mine] + k] = 1
    x_scale = np.concatenate([np.full(3 * n, 0.01), np.full(len(x0) - 3 * n, 0.01 * scale)])
    result = least_squares(residuals, x0, jac_sparsity=sparsity, loss="soft_l1", x_scale=x_scale, max_nfev=30)
    R, t, cloud = unpack(result.x)
    refined = np.tile(np.eye(4), (n, 1, 1))
    refined[:, :3, :3], refined[:, :3, 3] = R, t
    error = np.linalg.norm(residuals(result.x).reshape(-1, 2) / weight[:, None], axis=1)
    return refined, cloud, float(np.median(error))


def check_points(points: list[dict], lenses: list[Lens], poses: np.ndarray) -> dict | None:
    """How well marked points fit poses that need not have used them, from points in two or more views.

    Returns:
        reprojection_px (mean), metres_per_unit (median over pairs of believed points with xyz; None for fewer than two) and
        its spread (relative median deviation); None when no point is in two views.
    """
    matrices = np.stack([lens.K @ pose[:3] for lens, pose in zip(lenses, poses, strict=True)])
    found, truth, errors = [], [], []
    for p in points:
        views = list(p["pixels"])
        if len(views) < 2:
            continue
        pixels = np.array([p["pixels"][v] for v in views])
        x = triangulate(matrices[views], pixels)
        if not np.isfinite(x).all():
            errors.append(np.inf)
            continue
        projected = matrices[views] @ np.append(x, 1)
        errors.append(float(np.linalg.norm(projected[:, :2] / projected[:, 2:] - pixels, axis=1).mean()))
        if _believed(p):
            found.append(x)
            truth.append(p["xyz"])
    if not errors:
        return None
    ratio, spread = None, None
    if len(found) >= 2:
        a, b = (
            np.linalg.norm(np.array(v)[:, None] - np.array(v), axis=-1)[np.triu_indices(len(v), 1)]
            for v in (truth, found)
        )
        good = (a > 0) & (b > 0)
        if good.any():
            ratios = a[good] / b[good]
            ratio = float(np.median(ratios))
            spread = float(np.median(np.abs(ratios - ratio)) / ratio)
    return {"reprojection_px": float(np.mean(errors)), "metres_per_unit": ratio, "spread": spread}
