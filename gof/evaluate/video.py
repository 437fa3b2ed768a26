"""CGVQM: perceived quality of a whole video (Jindal et al. 2025, "CGVQM+D", doi 10.1111/cgf.70221), from local weights alone.

Features of a 3D ResNet-18 for both videos, unit-normalised per pixel, squared differences weighted per channel; the weights were
fitted to people's ratings. It sees flicker and wrong motion, which scores of single frames do not. Nothing is downloaded, and no
pickle is executed: the two tensors in a head file are read with an allow-list.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError, GofError, MissingDependencyError, require_finite

TRUNK = "r3d_18-b3b3357e.pth"  # torchvision's R3D-18, trained on Kinetics-400
HEADS = {
    "cgvqm_2": ("cgvqm-2.pickle", 3),
    "cgvqm_5": ("cgvqm-5.pickle", 6),
}  # file in the method's weights/, feature levels used
CHANNELS = (3, 64, 64, 128, 256, 512)  # of the picture, the stem and the four stages
MEAN, STD = (0.43216, 0.394666, 0.37645), (0.22803, 0.22145, 0.216989)  # of the network's training pictures
PATCHES = 4  # a frame is cut into 4 x 4
MAX_CLIP = 30  # frames; a clip lasts a second, but no longer than this


def available(weights: Path) -> list[str]:
    """Names in HEADS that `weights` holds both files for.

    Raises:
        MissingDependencyError: none (names the files), or PyTorch is absent.
    """
    try:
        import torch  # noqa: F401
    except ImportError as e:
        raise MissingDependencyError("CGVQM needs PyTorch: pip install 'gaussians-on-fire[torch]'") from e
    found = [name for name, (file, _) in HEADS.items() if (weights / file).is_file()]
    if not found or not (weights / TRUNK).is_file():
        raise MissingDependencyError(
            f"CGVQM: {weights} lacks {TRUNK} (torchvision) or {' or '.join(f for f, _ in HEADS.values())} "
            "(the method's weights folder); put them there, gof downloads nothing"
        )
    return found


def clip_length(frame_time_s: float) -> int:
    """Frames per clip: those of one second, at most MAX_CLIP."""
    return int(np.clip(1 / frame_time_s if frame_time_s > 0 else MAX_CLIP, 1, MAX_CLIP))


def cgvqm(
    frames: int, pair: Callable[[int], tuple[np.ndarray, np.ndarray]], clip: int, weights: Path, name: str = "cgvqm_2"
) -> float:
    """Quality of a video, 100 (no difference) downwards; about 75 is "perceptible, not annoying", 50 "slightly annoying".

    Clips are padded with their last frame and patches with their last row and column; the errors of all patches are averaged.

    Args:
        frames: number of frames, >= 1.
        pair: frame number -> (picture, truth), (H, W, 3) display values in [0, 1]; asked for in order, a clip is held at a time.
        clip: frames per clip, see `clip_length`.
        weights: folder with the files of `available`.
    Raises:
        DataFormatError: a weight file holds something else, or the pictures are smaller than 4 x 4.
        GofError: shapes disagree.   NonFiniteError: NaN or Inf in a picture.
    """
    import torch
    from torch.nn import functional as F

    network, (head, gain) = _trunk(weights / TRUNK), _head(weights / HEADS[name][0], HEADS[name][1])
    errors = []
    for start in range(0, frames, clip):
        videos = [[], []]
        for k in range(start, min(start + clip, frames)):
            image, truth = (np.asarray(p, np.float32) for p in pair(k))
            if image.shape != truth.shape or image.ndim != 3 or image.shape[2] != 3:
                raise GofError(
                    f"pictures of frame {k} have shapes {image.shape} and {truth.shape}, expected the same (H, W, 3)"
                )
            require_finite("image", image)
            require_finite("truth", truth)
            for video, picture in zip(videos, (image, truth), strict=True):
                video.append(picture)
        both = torch.from_numpy(np.stack(videos)).permute(0, 4, 1, 2, 3)  # (2, 3, T, H, W)
        both = (both - torch.tensor(MEAN).view(3, 1, 1, 1)) / torch.tensor(STD).view(3, 1, 1, 1)
        patch = [n // PATCHES for n in both.shape[3:]]
        if min(patch) < 1:
            raise DataFormatError(
                f"CGVQM needs pictures of at least {PATCHES} x {PATCHES} px, got {tuple(both.shape[3:])}"
            )
        missing = [-n % p for n, p in zip(both.shape[3:], patch, strict=True)]
        both = F.pad(both, (0, missing[1], 0, missing[0], 0, clip - both.shape[2]), mode="replicate")
        with torch.no_grad():
            for row in both.split(patch[0], 3):
                errors += [float(gain * _difference(network, part, head)) for part in row.split(patch[1], 4)]
    return 100 - float(np.mean(errors))


def _difference(network: dict, both, head: list):
    """Sum over levels and channels of the weighted mean squared difference of two videos (2, 3, T, H, W)."""
    total = (head[0] * (both[0] - both[1]).square().mean((1, 2, 3))).sum()
    x = both
    for level, weight in enumerate(head[1:]):
        x = _stage(network, x, level)
        unit = x / (x.norm(dim=1, keepdim=True) + 1e-10)
        total = total + (weight * (unit[0] - unit[1]).square().mean((1, 2, 3))).sum()
    return total


def _stage(network: dict, x, level: int):
    """R3D-18 (Tran et al. 2018): level 0 is the stem, 1 to 4 the stages of two residual blocks; halved in all axes from 2 on."""
    from torch.nn import functional as F

    def convolved(x, name: str, stride=1, padding=1):
        x = F.conv3d(x, network[f"{name}.0.weight"], stride=stride, padding=padding)
        mean, variance, gain, shift = (
            network[f"{name}.1.{k}"] for k in ("running_mean", "running_var", "weight", "bias")
        )
        return F.batch_norm(x, mean, variance, gain, shift, eps=1e-5)

    if level == 0:
        return F.relu(convolved(x, "stem", (1, 2, 2), (1, 3, 3)))
    for block in range(2):
        name, stride = f"layer{level}.{block}", 2 if level > 1 and block == 0 else 1
        y = convolved(F.relu(convolved(x, f"{name}.conv1", stride)), f"{name}.conv2")
        x = F.relu(y + (convolved(x, f"{name}.downsample", stride, 0) if stride > 1 else x))
    return x


def trunk_shapes() -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor of the trunk that is used, as torchvision names them."""
    convolutions = {"stem": (64, 3, 3, 7, 7)}
    for level in range(1, 5):
        width, before = CHANNELS[level + 1], CHANNELS[level]
        for block in range(2):
            convolutions[f"layer{level}.{block}.conv1"] = (width, before if block == 0 else width, 3, 3, 3)
            convolutions[f"layer{level}.{block}.conv2"] = (width, width, 3, 3, 3)
        if level > 1:
            convolutions[f"layer{level}.0.downsample"] = (width, before, 1, 1, 1)
    shapes = {f"{name}.0.weight": shape for name, shape in convolutions.items()}
    for name, shape in convolutions.items():
        shapes |= {f"{name}.1.{k}": shape[:1] for k in ("weight", "bias", "running_mean", "running_var")}
    return shapes


@lru_cache(maxsize=1)
def _trunk(path: Path) -> dict:
    from gof.evaluate.perceptual import load_weights

    return load_weights(path, trunk_shapes(), "torchvision's r3d_18", "CGVQM")


class _TwoTensors(pickle.Unpickler):
    """Unpickles tensors and nothing else; their storages go through PyTorch's own reader with weights_only."""

    def find_class(self, module: str, name: str):
        import torch

        allowed = {
            ("torch._utils", "_rebuild_tensor_v2"): torch._utils._rebuild_tensor_v2,
            ("torch.storage", "_load_from_bytes"): lambda data: torch.load(
                io.BytesIO(data), map_location="cpu", weights_only=True
            ),
            ("collections", "OrderedDict"): dict,
        }
        if (module, name) not in allowed:
            raise pickle.UnpicklingError(f"it names {module}.{name}, which is no tensor")
        return allowed[module, name]


@lru_cache(maxsize=2)
def _head(path: Path, levels: int) -> tuple[list, float]:
    """Weights per channel of each level, >= 0, and the gain."""
    try:
        with open(path, "rb") as file:
            weight, gain = _TwoTensors(file).load()
        weight, gain = weight.detach().float().abs().flatten(), float(gain)
    except Exception as e:  # damaged pickles raise anything
        raise DataFormatError(
            f"{path}: not the two tensors of a CGVQM head ({type(e).__name__}: {str(e)[:120]})"
        ) from e
    if len(weight) != sum(CHANNELS[:levels]) or not np.isfinite(gain) or not weight.isfinite().all():
        raise DataFormatError(
            f"{path}: {len(weight)} channel weights, expected {sum(CHANNELS[:levels])} finite ones and a gain"
        )
    return list(weight.split(CHANNELS[:levels])), gain
