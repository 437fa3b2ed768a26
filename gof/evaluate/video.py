"""CGVQM: perceived quality of a whole video (Jindal et al. 2025, "CGVQM+D", doi 10.1111/cgf.70221), by local weights.

Features of a 3D ResNet-18 for both videos, unit-normalised per pixel, squared differences weighted per channel; the
weights were fitted to people's ratings. It sees flicker and wrong motion, which scores of single frames do not. Nothing
is downloaded, and no pickle is executed: the two tensors in a head file are read with an allow-list.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.errors import DataFormatError, GofError, MissingDependencyError, require_finite
from gof.evaluate.perceptual import load_weights
from gof.host import extras

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
    extras.load("torch", "torch", "CGVQM")
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


class VideoQuality:
    """CGVQM of one video, frame by frame; a clip is held at a time.

    100 is no difference, downwards; about 75 is "perceptible, not annoying", 50 "slightly annoying". Clips are padded
    with their last frame and patches with their last row and column; the errors of all patches are averaged.

    Args:
        names: of HEADS; the network runs once for all of them.
        clip: frames per clip, see `clip_length`.
        weights: folder with the files of `available`.
    Raises:
        DataFormatError: a weight file holds something else.
    """

    def __init__(self, names: Sequence[str], clip: int, weights: Path):
        self._clip = clip
        self._network = _trunk(weights / TRUNK)
        self._heads = {name: _head(weights / HEADS[name][0], HEADS[name][1]) for name in names}
        self._errors: dict[str, list[float]] = {name: [] for name in names}
        self._images: list[np.ndarray] = []
        self._truths: list[np.ndarray] = []
        self._frames = 0

    def add(self, image: np.ndarray, truth: np.ndarray) -> None:
        """The next frame: picture and truth, (H, W, 3) display values in [0, 1].

        Raises:
            DataFormatError: the pictures are smaller than 4 x 4.
            GofError: shapes disagree.   NonFiniteError: NaN or Inf in a picture.
        """
        image, truth = (np.asarray(picture, np.float32) for picture in (image, truth))
        if image.shape != truth.shape or image.ndim != 3 or image.shape[2] != 3:
            raise GofError(
                f"pictures of frame {self._frames} have shapes {image.shape} and {truth.shape}, expected the same "
                "(H, W, 3)"
            )
        require_finite("image", image)
        require_finite("truth", truth)
        self._images.append(image)
        self._truths.append(truth)
        self._frames += 1
        if len(self._images) == self._clip:
            self._rate_clip()

    def scores(self) -> dict[str, float]:
        """Quality by name, of all frames so far; at least one."""
        if self._images:
            self._rate_clip()
        return {name: 100 - float(np.mean(errors)) for name, errors in self._errors.items()}

    def _rate_clip(self) -> None:
        import torch

        with torch.no_grad():
            for patch in _patches(self._images, self._truths, self._clip):
                for name, error in _differences(self._network, patch, self._heads).items():
                    self._errors[name].append(error)
        self._images.clear()
        self._truths.clear()


def _patches(images: list[np.ndarray], truths: list[np.ndarray], clip: int) -> Iterator[Any]:
    """PATCHES x PATCHES tensors (2, 3, T, h, w) of picture and truth, normalised as the network wants them."""
    import torch
    from torch.nn import functional as F

    both = torch.from_numpy(np.stack([images, truths])).permute(0, 4, 1, 2, 3)  # (2, 3, T, H, W)
    both = (both - torch.tensor(MEAN).view(3, 1, 1, 1)) / torch.tensor(STD).view(3, 1, 1, 1)
    size = [n // PATCHES for n in both.shape[3:]]
    if min(size) < 1:
        raise DataFormatError(f"CGVQM needs pictures of at least {PATCHES} x {PATCHES} px, got {tuple(both.shape[3:])}")
    missing = [-n % p for n, p in zip(both.shape[3:], size, strict=True)]
    both = F.pad(both, (0, missing[1], 0, missing[0], 0, clip - both.shape[2]), mode="replicate")
    for row in both.split(size[0], 3):
        yield from row.split(size[1], 4)


def _differences(network: dict, both, heads: dict[str, tuple[list, float]]) -> dict[str, float]:
    """By head, the gain times the sum over levels and channels of the weighted mean squared feature difference.

    both: (2, 3, T, H, W). Level 0 is the picture itself; a head that uses fewer levels takes those of the deeper one.
    """
    squares = [(both[0] - both[1]).square().mean((1, 2, 3))]  # per level: (channels,)
    x = both
    for level in range(max(len(weights) for weights, _ in heads.values()) - 1):
        x = _stage(network, x, level)
        unit = x / (x.norm(dim=1, keepdim=True) + 1e-10)
        squares.append((unit[0] - unit[1]).square().mean((1, 2, 3)))
    return {
        name: float(gain * sum((w * square).sum() for w, square in zip(weights, squares, strict=False)))
        for name, (weights, gain) in heads.items()
    }


def _stage(network: dict, x, level: int):
    """R3D-18 (Tran et al. 2018): level 0 is the stem, 1 to 4 are stages of two residual blocks; 2 to 4 halve."""
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
