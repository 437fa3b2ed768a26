"""From partial stereo to whole depth maps, by an aligned monocular estimate or an edge-aware fill; a point cloud."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gof.core import ply
from gof.core.cameras import Camera
from gof.core.errors import DataFormatError, GofError, MissingDependencyError
from gof.core.files import atomic_path, only_run_in, path_in
from gof.dataset import Dataset
from gof.dataset.leaks import refuse_leaks
from gof.dataset.poses import Poses
from gof.host import extras
from gof.ingest.stereo import stereo_depth


def monocular(picture: np.ndarray, weights: Path) -> np.ndarray:
    """Relative disparity (H, W) float32, larger = nearer, of an (H, W, 3) uint8 RGB picture by Depth-Anything-V2.

    Args:
        weights: folder of a Hugging Face checkpoint (config.json, model.safetensors, preprocessor_config.json); nothing
            is downloaded.
    Raises:
        DataFormatError: no checkpoint in the folder.   MissingDependencyError: transformers or torch is not installed.
    """
    if not (Path(weights) / "config.json").is_file():
        raise DataFormatError(
            f"{weights}: no config.json; give the folder of a Depth-Anything-V2 checkpoint in Hugging Face form, or "
            "leave it away: the stereo depth is then completed along the picture's edges"
        )
    processor, model = _network(Path(weights))
    torch = extras.load("torch", "torch", "monocular depth")
    with torch.no_grad():
        out = model(**processor(images=picture, return_tensors="pt")).predicted_depth
    size = picture.shape[:2]
    return torch.nn.functional.interpolate(out[None], size, mode="bicubic", align_corners=False)[0, 0].numpy()


@cache
def _network(weights: Path) -> tuple[Any, Any]:
    """What prepares pictures for the network, and the network."""
    extras.load("torch", "torch", "monocular depth")  # transformers would name it in words of its own
    try:
        from transformers import AutoImageProcessor, AutoModelForDepthEstimation
    except ImportError as e:
        raise MissingDependencyError("monocular depth needs transformers, too: pip install transformers") from e
    processor = AutoImageProcessor.from_pretrained(weights, local_files_only=True)
    return processor, AutoModelForDepthEstimation.from_pretrained(weights, local_files_only=True).eval()


def align(disparity: np.ndarray, depth: np.ndarray, iterations: int = 20) -> tuple[float, float]:
    """a, b of 1 / depth = a * disparity + b where both are known, by iteratively reweighted (Huber) least squares.

    In disparity, not depth: the monocular network is trained on disparity up to scale and shift, so only there is the
    relation linear; stereo errors have one size there as well, while in depth far pixels would outweigh all others.

    Args:
        disparity: (H, W) relative.   depth: (H, W) m, NaN where unknown.
    Raises:
        GofError: fewer than 16 pixels have both, the disparity is constant there, or it falls with nearness.
    """
    use = np.isfinite(depth) & (depth > 0) & np.isfinite(disparity)
    if use.sum() < 16:
        raise GofError(f"only {int(use.sum())} pixels have stereo depth; the monocular depth cannot be aligned to them")
    x, y = disparity[use].astype(np.float64), 1 / depth[use].astype(np.float64)
    center, spread = x.mean(), x.std()
    if spread < 1e-9 * max(abs(center), 1e-300):
        raise GofError("the monocular depth is constant where stereo depth is known; it cannot be aligned")
    A = np.column_stack([(x - center) / spread, np.ones_like(x)])
    weight = np.ones_like(y)
    for _ in range(iterations):
        root = np.sqrt(weight)[:, None]
        solution = np.linalg.lstsq(A * root, y * root[:, 0], rcond=None)[0]
        error = np.abs(A @ solution - y)
        scale = 1.4826 * np.median(error)
        if scale < 1e-9 * np.abs(y).max():
            break
        weight = np.minimum(1, 1.345 * scale / np.maximum(error, 1e-300))
    a = solution[0] / spread
    if a <= 0:
        raise GofError("the monocular estimate falls where stereo says nearer; it does not fit this picture")
    return float(a), float(solution[1] - a * center)


def complete(depth: np.ndarray, picture: np.ndarray, smoothness: float = 100.0, edge: float = 12.0) -> np.ndarray:
    """Depth everywhere: known inverse depths spread over the picture, stopping at its edges; known pixels stay.

    Normalised fast global smoothing (Min et al. 2014), repeated wider until every pixel is reached.

    Args:
        depth: (H, W) m, NaN where unknown.   picture: (H, W, 3) uint8, the guide.
        edge: grey levels at which the picture stops the spreading.
    Raises:
        GofError: nothing is known.
    """
    import cv2

    known = np.isfinite(depth) & (depth > 0)
    if not known.any():
        raise GofError("no pixel has stereo depth: do the cameras see the same still things, and are the poses right?")
    unit = float(np.median(depth[known]))
    filled = np.where(known, unit / np.where(known, depth, unit), 0).astype(np.float32)
    weight = known.astype(np.float32)
    for _ in range(8):
        smoother = cv2.ximgproc.createFastGlobalSmootherFilter(np.ascontiguousarray(picture), smoothness, edge)
        total, mass = smoother.filter(filled * weight), smoother.filter(weight)
        reached = mass > 1e-4
        result = np.where(reached, total / np.maximum(mass, 1e-4), 0)
        if reached.all():
            break
        smoothness, edge = smoothness * 8, edge * 1.5
    result = np.where(reached, result, float(np.median(filled[known])))
    low, high = filled[known].min(), filled[known].max()
    return np.where(known, depth, unit / np.clip(result, low, high)).astype(np.float32)


def whole_depth(stereo: np.ndarray, picture: np.ndarray, weights: Path | None) -> np.ndarray:
    """Depth everywhere, (H, W) m: stereo's where it is known, elsewhere aligned monocular depth or `complete`.

    Args:
        stereo: (H, W) m, NaN where unknown.   picture: (H, W, 3) uint8.
        weights: folder of the monocular network's checkpoint; None for `complete`.
    """
    if weights is None:
        return complete(stereo, picture)
    relative = monocular(picture, weights)
    a, b = align(relative, stereo)
    whole = from_relative(relative, a, b, farthest=2 * float(np.nanmax(stereo)))
    return np.where(np.isfinite(stereo), stereo, whole)


def from_relative(relative: np.ndarray, a: float, b: float, farthest: float) -> np.ndarray:
    """Depth (H, W) float32 m of relative disparity (H, W) that `align` found a, b for; at most `farthest`."""
    return (1 / np.maximum(a * relative + b, 1 / farthest)).astype(np.float32)


def back_project(depth: np.ndarray, picture: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """World points (N, 3) m and colours (N, 3), as in the picture, of the pixels with known depth (H, W) m."""
    rows, columns = np.nonzero(np.isfinite(depth))
    points = camera.unproject(np.column_stack([columns, rows]) + 0.5, depth[rows, columns])
    return points, picture[rows, columns]


def write_points(path: Path, points: np.ndarray, colors: np.ndarray) -> None:
    """Binary PLY of points (N, 3) m and colours (N, 3) uint8."""
    columns = dict(zip(("x", "y", "z"), points.T, strict=True)) | dict(
        zip(("red", "green", "blue"), colors.T, strict=True)
    )
    with atomic_path(path) as temporary:
        ply.write(temporary, columns, comments=[])


# ----------------------------------------------------------------
# Depth of the whole still scene: stereo between a dataset's plates, completed, as a map per camera and one cloud.

POINTS = "points.ply"


def depth_name(camera: str) -> str:
    """Name in the dataset of the depth map of a camera's plate."""
    return f"depth/{camera}.npy"


def write_plate_depths(dataset: Dataset, weights: Path | None = None, overwrite: bool = False) -> list[Path]:
    """Write DATASET/depth/CAMERA.npy, (H, W) float32 camera z in m, and DATASET/points.ply, all their pixels.

    They were made from the frames that the plates were made from, which the dataset says.

    Args:
        weights: folder of the checkpoint for `gof.ingest.depth.monocular`; None: see `complete` there.
        overwrite: replace maps that are there.
    Returns:
        the files.
    Raises:
        GofError: a file is there already, or the dataset has a single camera; see `whole_depth`.
        LeakError: the plates were made from a held-out frame.
    """
    if len(dataset.cameras) < 2:
        raise GofError(f"{dataset.path}: one camera has no stereo; two or more have")
    files = [path_in(dataset.path, depth_name(camera.name)) for camera in dataset.cameras]
    cloud = path_in(dataset.path, POINTS)
    for file in (*files, cloud):
        if file.exists() and not overwrite:
            raise GofError(f"{file}: is there already; replace it with --overwrite")
    refuse_leaks(dataset)
    poses = Poses.read(dataset.path)
    sparse = np.zeros((0, 3)) if poses is None else poses.points_array() - dataset.datum.position
    plates = [np.uint8(np.rint(255 * dataset.static(c))) for c in range(len(dataset.cameras))]
    found = stereo_depth(plates, dataset.cameras, sparse)
    maps = [whole_depth(partial, plate, weights) for partial, plate in zip(found, plates, strict=True)]
    clouds = [
        back_project(depth, plate, camera) for depth, plate, camera in zip(maps, plates, dataset.cameras, strict=True)
    ]
    points, colors = (np.concatenate(parts) for parts in zip(*clouds, strict=True))
    with only_run_in(dataset.path):
        for file, depth in zip(files, maps, strict=True):
            file.parent.mkdir(exist_ok=True)
            with atomic_path(file) as temporary:
                np.save(temporary, depth)
        write_points(cloud, points + dataset.datum.position, colors)
    return [*files, cloud]
