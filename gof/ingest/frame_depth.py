"""Depth maps of single frames, fire and all: what scores of depth compare a result's depth with (`gof depth`).

By a monocular network, as the paper has it, or without its weights by stereo between the cameras. Of held-out frames
too: these maps are for scores, nothing may learn from them, and made_from.json says of each which frame it was made of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from gof.core.errors import GofError
from gof.core.files import atomic_path, only_run_in, path_in, stamp
from gof.core.records import claim
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom
from gof.dataset.poses import FILE as POSES
from gof.dataset.poses import Poses
from gof.ingest.depth import align, complete, from_relative, monocular
from gof.ingest.stereo import stereo_depth

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
        poses = Poses.read(dataset.path)
        points = np.zeros((0, 3)) if poses is None else poses.points_array()
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
    """Depth of every camera's picture of a frame, which are taken to be of one moment.

    Args:
        points: (N, 3) sparse world points, for the range of depths that stereo searches.   weights: see above.
    Raises:
        GofError: see `complete`, `align`.
    """
    pictures = [np.uint8(np.rint(255 * dataset.image(c, frame))) for c in range(len(dataset.cameras))]
    return [
        _by_stereo(stereo, picture) if weights is None else _by_network(stereo, picture, weights)
        for stereo, picture in zip(stereo_depth(pictures, dataset.cameras, points), pictures, strict=True)
    ]


def _by_stereo(stereo: np.ndarray, picture: np.ndarray) -> FrameDepth:
    depth = complete(stereo, picture)
    return FrameDepth(depth, 1 / depth, float(np.isfinite(stereo).mean()))


def _by_network(stereo: np.ndarray, picture: np.ndarray, weights: Path) -> FrameDepth:
    """The network's own map; stereo only says how its unit and its zero lie in metres."""
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
