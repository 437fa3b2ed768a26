"""Poses from known points (a marker, measured points), refined with image matches: where SfM alone goes wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from gof.dataset.poses import PointCheck
from gof.footage.lens import STRAIGHT, Lens
from gof.ingest.bundle import Anchor, BundleParameters, Sightings, adjust, misfit
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.sfm import Features, Model, PoseError, epipolar_distance

GATES_PX = (25.0, 8.0, 4.0, 2.5, 2.5)  # epipolar gates, each followed by a bundle adjustment
SHAPES_PX = 5.0  # gate from which on all boards are held to
MOST_STARTS = 4
MAX_TRACKS = 1000
KNOWN_WEIGHT = 1.0  # a corner is found as well as a feature
SIMILARITY = 7  # numbers that no picture shows: place, direction and size of the whole
AGREEMENT_PX = 10.0  # a match this far from its epipolar line counts 1/e

Track = dict[int, np.ndarray]  # camera -> (2,) px


@dataclass(frozen=True)
class ZoomedModel:
    """world_to_camera (C, 4, 4), the lenses that were found with it, the misfit per sighting, in the square of px, and
    how many more numbers were seen than found."""

    world_to_camera: np.ndarray
    lenses: list[Lens]
    misfit: float
    freedom: int


def triangulate(matrices: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return (3,) point from (V, 3, 4) projection matrices and (V, 2) pixels, linear; NaN for parallel rays."""
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

    A plane seen by one camera has two poses that fit almost equally. The combinations that most feature matches agree
    with, of every board, are adjusted; the one that they agree with best afterwards is kept.

    Args:
        points: xyz in metres; those of rough points start the poses, but the adjustment does not hold to them.
    Raises:
        PoseError: a camera sees fewer than four points of one board with xyz, or no pose fits them.
    """
    starts = _starts(points, lenses, names)
    starts = sorted(starts, key=lambda start: _agreement(features, lenses, start[1]), reverse=True)[:MOST_STARTS]
    models = [_refined(board, poses, points, features, lenses) for board, poses in starts]
    return max(models, key=lambda model: _agreement(features, lenses, model.world_to_camera))


def _refined(board: int, poses: np.ndarray, points: list[MarkedPoint], features: Features, lenses: list[Lens]) -> Model:
    """Poses in a board's axes, adjusted to what lies within narrower and narrower gates."""
    # Far from the truth another clip's board would be triangulated to nowhere: each joins when the poses are near.
    own = [p if p.board == board else p.without_xyz() for p in points]
    for gate in GATES_PX:
        model = bundle(poses, lenses, own if gate > SHAPES_PX else points, tracks(features, lenses, poses, gate))
        poses = model.world_to_camera
    return model


def _starts(points: list[MarkedPoint], lenses: list[Lens], names: list[str]) -> list[tuple[int, np.ndarray]]:
    """Return each board's number, and the combinations (C, 4, 4) of poses in its axes that fit its points."""
    starts, problem = [], None
    for board in sorted({p.board for p in points}):
        own = [p for p in points if p.board == board]
        try:
            options = [_pnp(c, own, lens, name) for c, (lens, name) in enumerate(zip(lenses, names, strict=True))]
        except PoseError as e:
            problem = problem or e
            continue
        starts += [(board, np.stack(combination)) for combination in product(*options)]
    if not starts:
        raise problem or PoseError("no points with known coordinates")
    return starts


def _pnp(camera: int, points: list[MarkedPoint], lens: Lens, name: str) -> list[np.ndarray]:
    """Return the (4, 4) poses of one camera that fit its points with xyz: two when they lie in a plane."""
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
    _, rotations, shifts, _ = cv2.solvePnPGeneric(xyz, pixels, lens.K, STRAIGHT, flags=kind)
    poses = []
    for r, t in zip(rotations, shifts, strict=True):
        r, t = cv2.solvePnPRefineLM(xyz, pixels, lens.K, STRAIGHT, r, t)
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
    """Return the fit of raw matches: mean of exp(-error / AGREEMENT_PX), 0 without matches."""
    fits = [
        np.exp(-epipolar_distance(lenses, poses, i, j, *features.pair(i, j)) / AGREEMENT_PX)
        for (i, j), m in features.matches.items()
        if len(m)
    ]
    return float(np.concatenate(fits).mean()) if fits else 0.0


def tracks(features: Features, lenses: list[Lens], poses: np.ndarray, gate: float) -> list[Track]:
    """Return matches within `gate` px of their epipolar lines, joined over views; at most MAX_TRACKS, by views."""
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
    matrices = _projection_matrices(lenses, poses)
    chains = [t for t in chains if len(t) >= 2 and _misses(matrices, t) < gate]
    # Poses of a few cameras are settled by some hundred points; those in most views say most.
    order = np.random.default_rng(0).permutation(len(chains))
    return sorted((chains[k] for k in order), key=len, reverse=True)[:MAX_TRACKS]


# ---- bundle adjustment -----------------------------------------------------------------------------------------------


def bundle(
    poses: np.ndarray,
    lenses: list[Lens],
    points: list[MarkedPoint],
    chains: list[Track],
    anchor: Anchor | None = None,
) -> Model:
    """Robust bundle adjustment of tracks and marked points: `gof.ingest.bundle.adjust` with this room's things.

    Points with known xyz move as their boards do, each board as one body; the first stays where it is. A board that
    does not yet have a place gets it from the poses.

    Args:
        poses: (C, 4, 4) world to camera to start from, metres where a point is known.
        anchor: where the cameras stand roughly, if that is known.
    Returns:
        the refined poses, and the triangulated points (N, 3) that lay in front of their cameras.
    Raises:
        PoseError: nothing to adjust to.
    """
    boards, start, seen = _sightings(poses, lenses, points, chains)
    found = adjust(start, seen, np.stack([lens.K for lens in lenses]), anchor=anchor)
    first = found.bodies[0] if len(boards) else np.eye(4)  # the world stays that of the first board
    return Model(found.cameras @ first, (found.points - first[:3, 3]) @ first[:3, :3])


def _sightings(
    poses: np.ndarray, lenses: list[Lens], points: list[MarkedPoint], chains: list[Track]
) -> tuple[list[int], BundleParameters, Sightings]:
    """Return the numbers of the boards that are held to, the state to start from, and the pixels to adjust to."""
    boards, bodies = _bodies(poses, lenses, points)
    held = [p for p in points if p.is_known and p.board in boards]
    loose = [p for p in points if not (p.is_known and p.board in boards)]
    free, start = _triangulated(poses, lenses, chains + [p.pixels for p in loose if len(p.pixels) >= 2])
    nowhere = np.zeros(3)
    rows = [(c, px, KNOWN_WEIGHT, -1, boards.index(p.board), p.xyz) for p in held for c, px in p.pixels.items()]
    rows += [(c, px, 1.0, k, 0, nowhere) for k, track in enumerate(free) for c, px in track.items()]
    if not rows:
        raise PoseError("no feature and no marked point is in two pictures, and no marked point has believed xyz")
    return (
        boards,
        BundleParameters(poses, bodies, start),
        Sightings(*(np.array(column) for column in zip(*rows, strict=True))),
    )


def zoomed(poses: np.ndarray, lenses: list[Lens], chains: list[Track], zoom: np.ndarray) -> ZoomedModel:
    """Return poses and focal lengths that fit tracks best.

    Args:
        poses: (C, 4, 4) world to camera to start from.   lenses: to start from.
        zoom: (C,) numbers 0 to Z - 1: cameras of one number share a factor on their focal lengths; -1: known.
    Raises:
        PoseError: no track is in two pictures.
    """
    _, start, seen = _sightings(poses, lenses, [], chains)
    K = np.stack([lens.K for lens in lenses])
    found = adjust(replace(start, zooms=np.zeros(zoom.max() + 1)), seen, K, zoom)
    factor = np.where(zoom >= 0, np.exp(np.append(found.zooms, 0.0)[zoom]), 1.0)
    lenses = [lens.magnified(float(f)) for lens, f in zip(lenses, factor, strict=True)]
    freedom = 2 * len(seen.camera) - found.points.size - 6 * len(lenses) + SIMILARITY - len(found.zooms)
    return ZoomedModel(found.cameras, lenses, misfit(found, seen, K, zoom), freedom)


def _bodies(poses: np.ndarray, lenses: list[Lens], points: list[MarkedPoint]) -> tuple[list[int], np.ndarray]:
    """Return numbers of the boards that can be held to, and where they are: (B, 4, 4) board to world.

    One board alone is the world itself; of several each must be triangulated from three of its known points.
    """
    boards = sorted({p.board for p in points if p.is_known and p.pixels})
    if len(boards) == 1:
        return boards, np.eye(4)[None]
    matrices = _projection_matrices(lenses, poses)
    found, places = [], []
    for board in boards:
        known = [p for p in points if p.is_known and p.board == board and len(p.pixels) >= 2]
        seen = np.array([_meeting(matrices, p.pixels) for p in known]).reshape(-1, 3)
        if len(known) >= 3 and np.isfinite(seen).all():
            found.append(board)
            places.append(_rigid(np.array([p.xyz for p in known]), seen))
    return found, np.array(places).reshape(-1, 4, 4)


def _meeting(matrices: np.ndarray, pixels: dict[int, np.ndarray]) -> np.ndarray:
    """Return (3,) where the rays through a point's pixels meet; NaN where they do not."""
    return triangulate(matrices[list(pixels)], np.array(list(pixels.values())))


def _rigid(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return (4, 4) rotation and shift that bring points (N, 3) nearest to others (Kabsch)."""
    from scipy.spatial.transform import Rotation  # here: it takes long to load

    middle, to = source.mean(0), target.mean(0)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.align_vectors(target - to, source - middle)[0].as_matrix()
    motion[:3, 3] = to - motion[:3, :3] @ middle
    return motion


def _triangulated(poses: np.ndarray, lenses: list[Lens], free: list[Track]) -> tuple[list[Track], np.ndarray]:
    """Return the tracks whose point lies in front of all its cameras, and the points (N, 3)."""
    matrices = _projection_matrices(lenses, poses)
    kept, points = [], []
    for track in free:
        views = list(track)
        x = _meeting(matrices, track)
        if np.isfinite(x).all() and all((poses[v, 2, :3] @ x + poses[v, 2, 3]) > 0 for v in views):
            kept.append(track)
            points.append(x)
    return kept, np.array(points).reshape(-1, 3)


def triangulated(poses: np.ndarray, lenses: list[Lens], chains: list[Track]) -> np.ndarray:
    """Return (N, 3) points of tracks, those that lie in front of their cameras."""
    return _triangulated(poses, lenses, chains)[1]


def meetings(poses: np.ndarray, lenses: list[Lens], points: list[MarkedPoint]) -> np.ndarray:
    """Return (N, 3) where marked points, each seen twice, are; NaN where their rays do not meet."""
    matrices = _projection_matrices(lenses, poses)
    return np.array([_meeting(matrices, p.pixels) for p in points]).reshape(-1, 3)


def _projection_matrices(lenses: list[Lens], poses: np.ndarray) -> np.ndarray:
    """Return (C, 3, 4) world to homogeneous pixels."""
    return np.stack([lens.K @ pose[:3] for lens, pose in zip(lenses, poses, strict=True)])


# ---- what marked points say of poses ---------------------------------------------------------------------------------


def check_points(points: list[MarkedPoint], lenses: list[Lens], poses: np.ndarray) -> PointCheck | None:
    """Triangulate the points that two or more cameras see; None when there is none.

    Args:
        poses: (C, 4, 4) world to camera.
    """
    matrices = _projection_matrices(lenses, poses)
    errors, ratios = [], []
    for board in sorted({p.board for p in points}):
        known, found = [], []
        for p in points:
            if p.board != board or len(p.pixels) < 2:
                continue
            errors.append(_misses(matrices, p.pixels, np.mean))
            if p.is_known and np.isfinite(errors[-1]):
                known.append(p.xyz)
                found.append(_meeting(matrices, p.pixels))
        ratios.append(_ratios(np.array(known), np.array(found)))
    if not errors:
        return None
    error = float(np.mean(errors))
    return PointCheck(round(error, 6) if np.isfinite(error) else None, *_unit(np.concatenate(ratios)))


def _misses(matrices: np.ndarray, pixels: dict[int, np.ndarray], summary: Callable = np.max) -> float:
    """Return largest (or mean) distance in px of a point's pixels from where its rays meet; inf where they do not."""
    x = _meeting(matrices, pixels)
    if not np.isfinite(x).all():
        return np.inf
    projected = matrices[list(pixels)] @ np.append(x, 1)
    if (projected[:, 2] <= 0).any():
        return np.inf
    return float(summary(np.linalg.norm(projected[:, :2] / projected[:, 2:] - np.array(list(pixels.values())), axis=1)))


def _ratios(known: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return True distances over found ones, of all pairs of points (N, 3) that are apart."""
    if len(known) < 2:
        return np.zeros(0)
    pairs = np.triu_indices(len(known), 1)
    truth = np.linalg.norm(known[:, None] - known, axis=-1)[pairs]
    solved = np.linalg.norm(found[:, None] - found, axis=-1)[pairs]
    apart = (truth > 0) & (solved > 0)
    return truth[apart] / solved[apart]


def _unit(ratios: np.ndarray) -> tuple[float | None, float | None]:
    """Return metres per unit of the poses, and its relative spread; None when no distance is known."""
    if not len(ratios):
        return None, None
    ratio = float(np.median(ratios))
    return round(ratio, 6), round(float(np.median(np.abs(ratios - ratio)) / ratio), 6)
