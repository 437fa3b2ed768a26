"""Poses of a few fixed, calibrated cameras from their plates, by pycolmap (Schoenberger & Frahm 2016)."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError, GofError, MissingDependencyError
from gof.lens import Lens

MIN_CONSISTENT = (
    0.6  # share of a pair's raw matches within GATE_PX of their epipolar lines, below which poses are not believed
)
GATE_PX = 3.0


class PoseError(GofError):
    """Cameras could not be placed; the message says which, why, and what to do."""


@dataclass
class Features:
    """SIFT keypoints (N, 2) per camera, pixel centres at integer + 0.5, and raw matches {(i, j): (M, 2) indices}."""

    keypoints: list[np.ndarray]
    matches: dict[tuple[int, int], np.ndarray]

    def pair(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Matched positions (M, 2), (M, 2) of cameras i and j."""
        m = self.matches[i, j]
        return self.keypoints[i][m[:, 0]], self.keypoints[j][m[:, 1]]


@dataclass
class Poses:
    """world_to_camera (C, 4, 4); points (N, 3), in the same arbitrary frame and scale; what was measured about them."""

    world_to_camera: np.ndarray
    points: np.ndarray
    report: dict = field(default_factory=dict)


def solve(
    plates: list[np.ndarray], masks: list[np.ndarray], lenses: list[Lens], names: list[str]
) -> tuple[Poses | None, Features, dict]:
    """SIFT, exhaustive matching, incremental mapping with fixed intrinsics.

    Args:
        plates: (H, W, 3) uint8 RGB per camera.   masks: (H, W) bool, True where features may be.
    Returns:
        poses of all cameras or None, the features for other solvers, and a report: keypoints per camera, matches per
        pair, registered cameras, mean reprojection error in px.
    Raises:
        MissingDependencyError: no pycolmap.
    """
    try:
        import pycolmap
    except ImportError as e:
        raise MissingDependencyError(
            "camera poses need pycolmap: pip install 'gaussians-on-fire[views]'; or give known poses with --cameras"
        ) from e
    import cv2

    pycolmap.logging.minloglevel = 2
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        files = [f"{c}.png" for c in range(len(plates))]
        for c, file in enumerate(files):
            (work / "images").mkdir(exist_ok=True)
            (work / "masks").mkdir(exist_ok=True)
            cv2.imwrite(str(work / "images" / file), plates[c][..., ::-1])
            cv2.imwrite(str(work / "masks" / f"{file}.png"), masks[c].astype(np.uint8) * 255)
        database = work / "features.db"
        options = pycolmap.FeatureExtractionOptions()
        # Plates of compressed footage are soft: half COLMAP's contrast threshold.
        options.sift.peak_threshold, options.sift.max_num_features = 0.003, 16000
        cpu = pycolmap.Device.cpu
        for c, file in enumerate(files):
            reader = pycolmap.ImageReaderOptions()
            reader.mask_path = str(work / "masks")
            K = lenses[c].K
            reader.camera_model = "PINHOLE"
            reader.camera_params = f"{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}"
            pycolmap.extract_features(
                database, work / "images", [file], pycolmap.CameraMode.PER_IMAGE, reader, options, cpu
            )
        # Three views 15 degrees apart share few features; COLMAP's defaults are made for hundreds of views.
        verification = pycolmap.TwoViewGeometryOptions()
        verification.min_num_inliers = 8
        pycolmap.match_exhaustive(database, verification_options=verification, device=cpu)
        features = _read_features(pycolmap, database, files)
        mapping = pycolmap.IncrementalPipelineOptions()
        mapping.min_num_matches, mapping.random_seed = 8, 0
        mapping.min_model_size, mapping.multiple_models = 2, False
        mapping.ba_refine_focal_length = mapping.ba_refine_principal_point = mapping.ba_refine_extra_params = False
        mapping.mapper.init_min_num_inliers, mapping.mapper.init_min_tri_angle = 20, 1.5
        mapping.mapper.abs_pose_min_num_inliers, mapping.mapper.abs_pose_min_inlier_ratio = 10, 0.1
        mapping.mapper.filter_min_tri_angle = mapping.triangulation.min_angle = 0.5
        mapping.triangulation.ignore_two_view_tracks = False
        (work / "out").mkdir()
        models = pycolmap.incremental_mapping(database, work / "images", work / "out", mapping)
        best = max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)
        report = {
            "keypoints": {n: len(k) for n, k in zip(names, features.keypoints, strict=True)},
            "matches": {f"{names[i]}-{names[j]}": len(m) for (i, j), m in features.matches.items()},
            "registered": [],
        }
        if best is None:
            return None, features, report
        found = {i.name: i for i in best.images.values() if i.has_pose}
        report["registered"] = [n for n, f in zip(names, files, strict=True) if f in found]
        report["points"] = best.num_points3D()
        report["reprojection_px"] = round(float(best.compute_mean_reprojection_error()), 3)
        if len(found) < len(files):
            return None, features, report
        matrices = []
        for file in files:
            pose = found[file].cam_from_world
            matrices.append(np.vstack([(pose() if callable(pose) else pose).matrix(), [0, 0, 0, 1]]))
        points = np.array([p.xyz for p in best.points3D.values()]).reshape(-1, 3)
        return Poses(np.array(matrices), points), features, report


def _read_features(pycolmap, database: Path, files: list[str]) -> Features:
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


def epipolar_distance(lenses, poses: np.ndarray, i: int, j: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(M,) px: symmetric distance (larger of both sides) of matched pixels from their epipolar lines; inf for coinciding cameras."""
    relative = poses[j] @ np.linalg.inv(poses[i])
    R, t = relative[:3, :3], relative[:3, 3]
    length = np.linalg.norm(t)
    if length < 1e-12:
        return np.full(len(first), np.inf)
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) / length
    F = np.linalg.inv(lenses[j].K).T @ cross @ R @ np.linalg.inv(lenses[i].K)
    a, b = np.column_stack([first, np.ones(len(first))]), np.column_stack([second, np.ones(len(second))])
    lines_b, lines_a = a @ F.T, b @ F
    value = np.abs((b * lines_b).sum(1))
    norms = np.minimum(np.linalg.norm(lines_b[:, :2], axis=1), np.linalg.norm(lines_a[:, :2], axis=1))
    return np.where(norms > 1e-12, value / np.where(norms > 1e-12, norms, 1), np.inf)


def consistent_share(features: Features, lenses, poses: np.ndarray) -> dict[tuple[int, int], float]:
    """Per pair, the share of raw matches within GATE_PX of the poses' epipolar lines (nan without matches): poses that
    only explain a plane in the scene leave most matches off it."""
    share = {}
    for (i, j), m in features.matches.items():
        error = epipolar_distance(lenses, poses, i, j, *features.pair(i, j))
        share[i, j] = float((error < GATE_PX).mean()) if len(m) else float("nan")
    return share


def read_points(path: Path, names: list[str]) -> list[dict]:
    """Manual or marker correspondences: {"points": [{"pixels": {camera: [x, y], ...}, "xyz": [x, y, z]?}, ...]}.

    Pixels are of the upright, undistorted picture at footage size, centres at integer + 0.5; xyz in metres, any frame.

    Raises:
        DataFormatError: unknown camera, a point in fewer than one picture, values that are not finite.
    """
    from gof.io.files import read_json

    d = read_json(path)
    try:
        points = [
            {
                "pixels": {names.index(n): np.asarray(p, np.float64).reshape(2) for n, p in point["pixels"].items()},
                "xyz": None if point.get("xyz") is None else np.asarray(point["xyz"], np.float64).reshape(3),
            }
            for point in d["points"]
        ]
    except (KeyError, TypeError, ValueError, AttributeError) as e:
        raise DataFormatError(
            f"{path}: points must be a list of {{'pixels': {{camera: [x, y]}}, 'xyz': [x, y, z] or absent}} with cameras "
            f"{', '.join(names)} ({e})"
        ) from e
    numbers = [v for p in points for v in (*p["pixels"].values(), *([p["xyz"]] if p["xyz"] is not None else []))]
    if not numbers or not all(np.isfinite(v).all() for v in numbers):
        raise DataFormatError(f"{path}: needs at least one point, all numbers finite")
    return points
