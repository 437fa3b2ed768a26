"""Poses of a few fixed, calibrated cameras from their plates, by pycolmap (Schoenberger & Frahm 2016)."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from gof.core.errors import GofError
from gof.dataset.poses import FeatureFigures
from gof.footage.lens import Lens
from gof.host import extras

DATABASE = "features.db"
GATE_PX = 3.0  # a match within this of its epipolar lines obeys the poses
PEAK_THRESHOLD = 0.003  # half COLMAP's contrast threshold: plates of compressed footage are soft
MAX_FEATURES = 16000
MIN_MATCHES = 8
MUCH_BETTER = 0.85  # of the error: a right lens that may change takes 2 to 5 % off it, one of a fifth too short 25 %


class PoseError(GofError):
    """Cameras could not be placed; the message says which, why, and what to do."""


@dataclass(frozen=True)
class Features:
    """SIFT keypoints (N, 2) per camera, pixel centres at integer + 0.5, and raw matches {(i, j): (M, 2) indices}."""

    keypoints: list[np.ndarray]
    matches: dict[tuple[int, int], np.ndarray]

    def pair(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Return matched positions (M, 2), (M, 2) of cameras i and j."""
        m = self.matches[i, j]
        return self.keypoints[i][m[:, 0]], self.keypoints[j][m[:, 1]]


@dataclass(frozen=True)
class Model:
    """world_to_camera (C, 4, 4) of all cameras and points (N, 3), in one frame and scale of the model's own."""

    world_to_camera: np.ndarray
    points: np.ndarray


@dataclass(frozen=True)
class Solution:
    """The result of structure from motion: a model if all cameras registered, the features for other solvers, figures.

    Attributes:
        warnings: why the lenses may be wrong, in words; empty where nothing speaks against them.
    """

    model: Model | None
    features: Features
    figures: FeatureFigures
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class MatchedClips:
    """Features of all clips of a rig and their matches: what structure from motion goes on from, through any lenses.

    Attributes:
        work: folder of COLMAP's database, while it lasts.   files: names of the pictures there.
    """

    pycolmap: ModuleType
    work: Path
    files: list[str]
    features: Features

    def solve(self, lenses: list[Lens], names: list[str], mapped: bool = True, judged: bool = True) -> Solution:
        """Return the result of incremental mapping of all clips' features together.

        Args:
            mapped: False gives features only.   judged: whether to look for signs that the lenses are wrong.
        """
        self.pycolmap.logging.minloglevel = 2  # its bundle adjustment sets it back
        database = self.work / DATABASE
        best = None
        if mapped:
            _look_through(self.pycolmap, database, self.files, lenses, self.features)
            best = _largest_model(self.pycolmap, self.work, database)
        features, poses = self.features, _registered_poses(best)
        figures = FeatureFigures(
            keypoints={n: len(k) for n, k in zip(names, features.keypoints, strict=True)},
            matches={f"{names[i]}-{names[j]}": len(m) for (i, j), m in features.matches.items()},
            registered=tuple(n for n, file in zip(names, self.files, strict=True) if file in poses),
            points=None if best is None else best.num_points3D(),
            reprojection_px=None if best is None else round(float(best.compute_mean_reprojection_error()), 3),
        )
        if best is None or len(poses) < len(self.files):
            return Solution(None, features, figures)
        points = np.array([p.xyz for p in best.points3D.values()]).reshape(-1, 3)
        model = Model(np.array([poses[file] for file in self.files]), points)
        return Solution(model, features, figures, _warnings(self.pycolmap, best, lenses[0]) if judged else ())


@contextmanager
def matched(clips: list[tuple[list[np.ndarray], list[np.ndarray]]], lenses: list[Lens]) -> Iterator[MatchedClips]:
    """Provide SIFT features and exhaustive matches within every clip, which do not depend on the lenses.

    Args:
        clips: of one rig, each with its plates (H, W, 3) uint8 RGB and its masks (H, W) bool, True where features may
            be, per camera.
        lenses: to begin with.
    Raises:
        MissingDependencyError: no pycolmap.
    """
    pycolmap = extras.load("pycolmap", "views", "finding the cameras (known ones can be given with --cameras)")
    pycolmap.logging.minloglevel = 2
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (plates, masks) in enumerate(clips):
            work = Path(folder) / str(number)
            work.mkdir()
            files = _write_pictures(work, plates, masks)
            database = _match_features(pycolmap, work, files, lenses)
            found.append(_read_features(pycolmap, database, files))
        features = pooled(found)
        if len(clips) > 1:
            _write_features(pycolmap, database, files, features)
        yield MatchedClips(pycolmap, work, files, features)


def solve(
    clips: list[tuple[list[np.ndarray], list[np.ndarray]]], lenses: list[Lens], names: list[str], mapped: bool = True
) -> Solution:
    """Match the clips (see `matched`) and map them through these lenses."""
    with matched(clips, lenses) as found:
        return found.solve(lenses, names, mapped)


def pooled(clips: list[Features]) -> Features:
    """Return the features of several clips as if each camera had seen all in one picture: the cameras did not move."""
    counts = np.array([[len(k) for k in clip.keypoints] for clip in clips])
    before = np.cumsum(counts, 0) - counts  # numbers of a clip's keypoints begin here, (clips, C)
    keypoints = [np.concatenate([clip.keypoints[c] for clip in clips]) for c in range(counts.shape[1])]
    matches = {
        pair: np.concatenate(
            [clip.matches[pair] + first[list(pair)] for clip, first in zip(clips, before, strict=True)]
        )
        for pair in clips[0].matches
    }
    return Features(keypoints, matches)


def shift_between(
    first: np.ndarray, first_mask: np.ndarray, second: np.ndarray, second_mask: np.ndarray | None
) -> tuple[float, int]:
    """Return the distance between still things in two pictures by one camera: median in px of the first, and of how
    many.

    Args:
        first, second: (H, W, 3) uint8 RGB, sizes may differ.   first_mask, second_mask: (H, W) bool, where to look.
    """
    import cv2

    sift = cv2.SIFT.create(MAX_FEATURES // 4, contrastThreshold=0.01)
    width, height = first.shape[1::-1]
    scale = np.array([width / second.shape[1], height / second.shape[0]])
    sides = []
    for picture, mask in ((first, first_mask), (second, second_mask)):
        where = np.ones(picture.shape[:2], bool) if mask is None else mask
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        points, kinds = sift.detectAndCompute(grey, where.astype(np.uint8) * 255)
        sides.append((np.array([p.pt for p in points]).reshape(-1, 2) + 0.5, kinds))
    (ours, these), (theirs, those) = sides
    if len(ours) < 2 or len(theirs) < 2:
        return float("nan"), 0
    nearest = cv2.BFMatcher().knnMatch(these, those, k=2)
    pairs = np.array([(a.queryIdx, a.trainIdx) for a, b in nearest if a.distance < 0.75 * b.distance]).reshape(-1, 2)
    if not len(pairs):
        return float("nan"), 0
    apart = np.linalg.norm(theirs[pairs[:, 1]] * scale - ours[pairs[:, 0]], axis=1)
    return float(np.median(apart)), len(pairs)


def _write_pictures(work: Path, plates: list[np.ndarray], masks: list[np.ndarray]) -> list[str]:
    """work/images and work/masks as COLMAP wants them; returns the pictures' names."""
    import cv2

    for folder in ("images", "masks"):
        (work / folder).mkdir()
    files = [f"{camera}.png" for camera in range(len(plates))]
    for file, plate, mask in zip(files, plates, masks, strict=True):
        cv2.imwrite(str(work / "images" / file), plate[..., ::-1])
        cv2.imwrite(str(work / "masks" / f"{file}.png"), mask.astype(np.uint8) * 255)
    return files


def _match_features(pycolmap: ModuleType, work: Path, files: list[str], lenses: list[Lens]) -> Path:
    """SIFT in every picture and matches between all pairs; returns COLMAP's database of them."""
    database = work / DATABASE
    options = pycolmap.FeatureExtractionOptions()
    options.sift.peak_threshold = PEAK_THRESHOLD
    options.sift.max_num_features = MAX_FEATURES
    cpu = pycolmap.Device.cpu
    for file, lens in zip(files, lenses, strict=True):
        reader = pycolmap.ImageReaderOptions()
        reader.mask_path = str(work / "masks")
        reader.camera_model = "PINHOLE"
        reader.camera_params = ",".join(map(str, _pinhole(lens)))
        pycolmap.extract_features(
            database, work / "images", [file], pycolmap.CameraMode.PER_IMAGE, reader, options, cpu
        )
    pycolmap.match_exhaustive(database, verification_options=_verification(pycolmap), device=cpu)
    return database


def _pinhole(lens: Lens) -> list[float]:
    return [float(lens.K[0, 0]), float(lens.K[1, 1]), float(lens.K[0, 2]), float(lens.K[1, 2])]


def _look_through(
    pycolmap: ModuleType, database: Path, files: list[str], lenses: list[Lens], features: Features
) -> None:
    """Give the database these lenses, and verify its matches by them, unless it has them."""
    db = pycolmap.Database.open(database)
    try:
        cameras = [db.read_camera(db.read_image_with_name(file).camera_id) for file in files]
        wanted = [_pinhole(lens) for lens in lenses]
        if all(np.allclose(c.params, params, rtol=1e-9) for c, params in zip(cameras, wanted, strict=True)):
            return
        for camera, params in zip(cameras, wanted, strict=True):
            camera.params = params
            db.update_camera(camera)
        db.clear_two_view_geometries()
    finally:
        db.close()
    _verify(pycolmap, database, files, features)


def _verify(pycolmap: ModuleType, database: Path, files: list[str], features: Features) -> None:
    pairs = database.with_name("pairs.txt")
    pairs.write_text("\n".join(f"{files[i]} {files[j]}" for i, j in features.matches))
    pycolmap.verify_matches(database, pairs, _verification(pycolmap))


def _read_features(pycolmap: ModuleType, database: Path, files: list[str]) -> Features:
    db = pycolmap.Database.open(database)
    try:
        ids = [db.read_image_with_name(f).image_id for f in files]
        keypoints = [np.asarray(db.read_keypoints(i), np.float64).reshape(-1, 6)[:, :2] for i in ids]
        matches = {}
        for i, j in combinations(range(len(ids)), 2):
            raw = np.asarray(db.read_matches(ids[i], ids[j])).reshape(-1, 2)
            matches[i, j] = raw.astype(np.int64)
        return Features(keypoints, matches)
    finally:
        db.close()


def _write_features(pycolmap: ModuleType, database: Path, files: list[str], features: Features) -> None:
    """Put these features in the place of the database's, and verify their matches."""
    db = pycolmap.Database.open(database)
    try:
        ids = [db.read_image_with_name(f).image_id for f in files]
        for clear in (db.clear_two_view_geometries, db.clear_matches, db.clear_keypoints):
            clear()
        for number, keypoints in zip(ids, features.keypoints, strict=True):
            db.write_keypoints(number, keypoints.astype(np.float32))
        for (i, j), m in features.matches.items():
            db.write_matches(ids[i], ids[j], m.astype(np.uint32))
    finally:
        db.close()
    _verify(pycolmap, database, files, features)


def _verification(pycolmap: ModuleType) -> Any:
    """Return three views 15 degrees apart share few features; COLMAP's defaults are made for hundreds of views."""
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = MIN_MATCHES
    return options


def _largest_model(pycolmap: ModuleType, work: Path, database: Path) -> Any | None:
    """Incremental mapping; the pycolmap.Reconstruction with most cameras, then most points; None when there is none."""
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.random_seed = 0
    mapping.min_num_matches = MIN_MATCHES
    mapping.min_model_size = 2
    mapping.multiple_models = False
    mapping.ba_refine_focal_length = False
    mapping.ba_refine_principal_point = False
    mapping.ba_refine_extra_params = False
    # As for the matches: limits are lower than COLMAP's defaults.
    mapping.mapper.init_min_num_inliers = 20
    mapping.mapper.init_min_tri_angle = 1.5
    mapping.mapper.abs_pose_min_num_inliers = 10
    mapping.mapper.abs_pose_min_inlier_ratio = 0.1
    mapping.mapper.filter_min_tri_angle = 0.5
    mapping.triangulation.min_angle = 0.5
    mapping.triangulation.ignore_two_view_tracks = False
    with tempfile.TemporaryDirectory(dir=work) as folder:
        models = pycolmap.incremental_mapping(database, work / "images", folder, mapping)
    return max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)


def _warnings(pycolmap: ModuleType, model: Any, lens: Lens) -> tuple[str, ...]:
    """Return whether the model fits much better if its focal lengths may change. Needs three cameras: two fit any lens.

    How much they should change is known roughly only: what a wrong lens did not fit has been left out of the model.
    """
    if model.num_reg_images() < 3:
        return ()
    free, before = copy.deepcopy(model), model.compute_mean_reprojection_error()
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length, options.refine_principal_point, options.refine_extra_params = True, False, False
    options.print_summary = False
    pycolmap.bundle_adjustment(free, options)
    free.update_point_3d_errors()
    after = free.compute_mean_reprojection_error()
    if not after < MUCH_BETTER * before:
        return ()
    change = np.median([free.cameras[c].params[0] / model.cameras[c].params[0] for c in model.cameras])
    wrong, asked = ("wide", "less") if change > 1 else ("narrow", "more")
    fov, better = (2 * np.rad2deg(np.arctan(lens.width / 2 / (f * lens.K[0, 0]))) for f in (1, change))
    return (
        f"is --fov (or --cameras) right? The matches fit better with another lens ({before:.2f} px, then {after:.2f}): "
        f"{fov:.0f} degrees across the upright picture look too {wrong}, {better:.0f} or {asked} would fit better; "
        "'gof capture calibrate' measures it",
    )


def _registered_poses(model: Any | None) -> dict[str, np.ndarray]:
    """Return (4, 4) world to camera of every registered picture, by its name."""
    poses = {}
    for image in model.images.values() if model is not None else ():
        if image.has_pose:
            pose = image.cam_from_world  # a method in newer versions
            poses[image.name] = np.vstack([(pose() if callable(pose) else pose).matrix(), [0, 0, 0, 1]])
    return poses


def epipolar_distance(
    lenses: list[Lens], poses: np.ndarray, i: int, j: int, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """Symmetric distance (M,) in px, the larger of both sides, of matched pixels from their epipolar lines.

    Args:
        poses: (C, 4, 4) world to camera.
        first, second: (M, 2) px in cameras i and j.
    Returns:
        inf for cameras at one place: there are no lines.
    """
    relative = poses[j] @ np.linalg.inv(poses[i])
    R, t = relative[:3, :3], relative[:3, 3]
    length = np.linalg.norm(t)
    if length < 1e-12:
        return np.full(len(first), np.inf)
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) / length
    F = np.linalg.inv(lenses[j].K).T @ cross @ R @ np.linalg.inv(lenses[i].K)
    a = np.column_stack([first, np.ones(len(first))])
    b = np.column_stack([second, np.ones(len(second))])
    lines_b, lines_a = a @ F.T, b @ F
    value = np.abs((b * lines_b).sum(1))
    norms = np.minimum(np.linalg.norm(lines_b[:, :2], axis=1), np.linalg.norm(lines_a[:, :2], axis=1))
    return np.where(norms > 1e-12, value / np.where(norms > 1e-12, norms, 1), np.inf)


def consistent_share(features: Features, lenses: list[Lens], poses: np.ndarray) -> dict[tuple[int, int], float]:
    """Per pair, the share of raw matches within GATE_PX of the poses' epipolar lines (nan without matches).

    Poses that only explain a plane in the scene leave most matches off their lines.
    """
    share = {}
    for (i, j), m in features.matches.items():
        error = epipolar_distance(lenses, poses, i, j, *features.pair(i, j))
        share[i, j] = float((error < GATE_PX).mean()) if len(m) else float("nan")
    return share
