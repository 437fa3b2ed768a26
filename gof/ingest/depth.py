"""From partial stereo to whole depth maps, by an aligned monocular estimate or an edge-aware fill; a point cloud."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from gof.core import ply
from gof.core.cameras import Camera
from gof.core.errors import DataFormatError, GofError, MissingDependencyError
from gof.core.files import atomic_path, only_run_in, path_in, stamp
from gof.core.records import claim
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom, require_no_leaks
from gof.dataset.poses import FILE as POSES
from gof.host import extras
from gof.ingest.stereo import stereo_depth


def monocular(picture: np.ndarray, weights: Path) -> np.ndarray:
    """Return relative disparity (H, W) float32, larger = nearer, of an (H, W, 3) uint8 RGB picture by
    Depth-Anything-V2.

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
    """Return the network's preparation of pictures, and the network."""
    extras.load("torch", "torch", "monocular depth")  # transformers would name it in words of its own
    try:
        from transformers import AutoImageProcessor, AutoModelForDepthEstimation
    except ImportError as e:
        raise MissingDependencyError("monocular depth needs transformers, too: pip install transformers") from e
    processor = AutoImageProcessor.from_pretrained(weights, local_files_only=True)
    return processor, AutoModelForDepthEstimation.from_pretrained(weights, local_files_only=True).eval()


def align(disparity: np.ndarray, depth: np.ndarray, iterations: int = 20) -> tuple[float, float]:
    """Return a, b of 1 / depth = a * disparity + b where both are known, by reweighted (Huber) least squares.

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
    """Return depth everywhere: known inverse depths spread over the picture, stopping at its edges; known pixels stay.

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
    """Return depth everywhere, (H, W) m: stereo's where it is known, elsewhere aligned monocular depth or `complete`.

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
    """Return depth (H, W) float32 m of relative disparity (H, W) that `align` found a, b for; at most `farthest`."""
    return (1 / np.maximum(a * relative + b, 1 / farthest)).astype(np.float32)


def back_project(depth: np.ndarray, picture: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return world points (N, 3) m and colours (N, 3), as in the picture, of the pixels with known depth (H, W) m."""
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
    require_no_leaks(dataset)
    plates = [np.rint(255 * dataset.static(c)).astype(np.uint8) for c in range(len(dataset.cameras))]
    found = stereo_depth(plates, dataset.cameras, dataset.sparse_points())
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


# ----------------------------------------------------------------
# Depth maps of single frames, fire and all: what scores of depth compare a result's depth with (`gof depth`).
#
# By a monocular network, as the paper has it, or without its weights by stereo between the cameras. Held-out frames too
# have one: these maps are for scores, nothing may learn from them, and made_from.json says of each which frame it was
# made of.

KINDS = ("depth", "disparity")


@dataclass(frozen=True)
class DepthSettings:
    """depth.json: what depth maps are made with.

    Attributes:
        dataset: which one, see `gof.dataset.Dataset.identity`.
        weights: which checkpoint of the network, as `gof.core.files.stamp` of its folder; None: stereo.
    """

    SCHEMA: ClassVar[str] = "gof-depth-settings"
    VERSION: ClassVar[int] = 1

    dataset: str
    weights: str | None

    @classmethod
    def of(cls, dataset: Dataset, weights: Path | None) -> DepthSettings:
        stamped = weights and stamp(weights, ("config.json", "model.safetensors"))
        return cls(dataset.identity(POSES), stamped or None)


@dataclass(frozen=True)
class FrameDepth:
    """A camera's picture as distances, both everywhere and (H, W) float32.

    Attributes:
        depth: camera z, m.
        disparity: inverse depth >= 0: 1/m from stereo, in units of its own from the network.
        stereo_share: of the pixels, how many stereo has found and another view confirmed.
    """

    depth: np.ndarray
    disparity: np.ndarray
    stereo_share: float


def write_frame_depths(
    dataset: Dataset,
    frames: Sequence[int],
    out: Path,
    weights: Path | None = None,
    progress: Callable[..., None] | None = None,
) -> float | None:
    """out/depth/CAMERA/000000.npy and out/disparity/CAMERA/000000.npy for some frames; maps that are there are kept.

    Args:
        frames: numbers of the dataset's frames.
        weights: folder of the checkpoint for `monocular`; None for stereo.
        progress: progress(done, total, note).
    Returns:
        the share of the pixels that stereo found, of the maps that were made now; None where all were there.
    Raises:
        GofError: `out` holds maps of another dataset or other weights, the dataset has a single camera, or no stereo
            was found in a frame; see `monocular` and `align`.
    """
    if len(dataset.cameras) < 2:
        raise GofError(f"{dataset.path}: one camera has no stereo, which also gives the network's depth its scale")
    shares = []
    with only_run_in(out):
        claim(out / "depth.json", DepthSettings.of(dataset, weights), out / "made_from.json")
        points = dataset.sparse_points()
        made = MadeFrom.read(out)
        files = dict(made.files) if made else {}
        for done, frame in enumerate(frames):
            names = [[map_name(kind, camera.name, frame) for kind in KINDS] for camera in dataset.cameras]
            if not all(path_in(out, name).is_file() for pair in names for name in pair):
                found = frame_depths(dataset, frame, points, weights)
                for pair, view in zip(names, found, strict=True):
                    for name, values in zip(pair, (view.depth, view.disparity), strict=True):
                        _write(path_in(out, name), values)
                    shares.append(view.stereo_share)
            files |= {name: (frame,) for pair in names for name in pair}
            if progress:
                progress(done + 1, len(frames), note=f"stereo found {shares[-1]:.0%}" if shares else "")
        MadeFrom(files).write(out)
    return float(np.mean(shares)) if shares else None


def frame_depths(dataset: Dataset, frame: int, points: np.ndarray, weights: Path | None) -> list[FrameDepth]:
    """Return depth of every camera's picture of a frame, which are taken to be of one moment.

    Args:
        points: (N, 3) sparse world points, for the range of depths that stereo searches.   weights: see above.
    Raises:
        GofError: see `complete`, `align`.
    """
    pictures = [np.rint(255 * dataset.image(c, frame)).astype(np.uint8) for c in range(len(dataset.cameras))]
    return [
        _by_stereo(stereo, picture) if weights is None else _by_network(stereo, picture, weights)
        for stereo, picture in zip(stereo_depth(pictures, dataset.cameras, points), pictures, strict=True)
    ]


def _by_stereo(stereo: np.ndarray, picture: np.ndarray) -> FrameDepth:
    depth = complete(stereo, picture)
    return FrameDepth(depth, 1 / depth, float(np.isfinite(stereo).mean()))


def _by_network(stereo: np.ndarray, picture: np.ndarray, weights: Path) -> FrameDepth:
    """Return the network's own map; stereo only says how its unit and its zero lie in metres."""
    relative = np.maximum(monocular(picture, weights), 0)
    depth = from_relative(relative, *align(relative, stereo), farthest=2 * float(np.nanmax(stereo)))
    return FrameDepth(depth, relative, float(np.isfinite(stereo).mean()))


def map_name(kind: str, camera: str, frame: int) -> str:
    """Name of a map in the folder; `kind` is one of KINDS."""
    return f"{kind}/{camera}/{frame:06d}.npy"


def _write(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        np.save(temporary, values.astype(np.float32))
