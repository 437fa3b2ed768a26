"""Perceptual image scores that need something extra: FLIP (a package), LPIPS (packages and one file of weights)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.errors import DataFormatError, MissingDependencyError
from gof.evaluate.image import _mean, _pair
from gof.host import extras

TRUNK = "alexnet-owt-7be5be79.pth"  # torchvision's AlexNet, ImageNet-trained, under the name that it is published by


def flip(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """Mean LDR-FLIP error (Andersson et al. 2020) at 67 pixels per degree, 0 (identical) to 1; reference: the truth.

    Arguments, other errors and None as in `gof.evaluate.image.psnr`.

    Raises:
        MissingDependencyError: flip-evaluator is not installed.
    """
    image, truth = _pair(image, truth)
    flip_evaluator = extras.load("flip_evaluator", "scores", "FLIP")
    picture, reference = (np.ascontiguousarray(np.clip(p, 0, 1), np.float32) for p in (image, truth))
    error, _, _ = flip_evaluator.evaluate(reference, picture, "LDR", applyMagma=False, computeMeanError=False)
    return _mean(np.asarray(error, np.float64)[..., 0], mask)


def lpips(image: np.ndarray, truth: np.ndarray, weights: Path) -> float:
    """LPIPS 0.1 with AlexNet (Zhang et al. 2018), by torchmetrics: distance of features of five layers; 0 is identical.

    Args:
        image, truth: (H, W, 3) display values in [0, 1], at least 32 px on each side.
        weights: folder with `alexnet-owt-7be5be79.pth`; nothing is downloaded. The heads are torchmetrics' own.
    Raises:
        MissingDependencyError: PyTorch, torchvision, torchmetrics or the file is absent (names it).
        DataFormatError: the file holds something else, or the pictures are too small.
    """
    image, truth = _pair(image, truth)
    if min(image.shape[:2]) < 32:
        raise DataFormatError(f"LPIPS needs pictures of at least 32 px on each side, got {image.shape[:2]}")
    torch = extras.load("torch", "torch", "LPIPS")
    network = _network(Path(weights))
    pictures = torch.tensor(np.stack([image, truth]).transpose(0, 3, 1, 2), dtype=torch.float32)
    with torch.no_grad():
        return float(network(pictures[:1], pictures[1:], normalize=True))


@lru_cache(maxsize=1)
def _network(folder: Path) -> Any:
    """torchmetrics' network of LPIPS with AlexNet's weights from a folder."""
    import torch

    path = folder / TRUNK
    if not path.is_file():
        raise MissingDependencyError(
            f"LPIPS: {path} is absent (torchvision's AlexNet); put it there, gof downloads nothing"
        )
    try:
        extras.load("torchvision", "lpips", "LPIPS")
    except RuntimeError as e:  # its operators are of another build of PyTorch
        raise MissingDependencyError(f"LPIPS needs a build of torchvision that fits this PyTorch ({e})") from e
    network = extras.load("torchmetrics.functional.image.lpips", "lpips", "LPIPS")._LPIPS(pnet_rand=True)
    # "net.slice2.3.weight" is torchvision's "features.3.weight"
    trunk = {name: "features." + name.split(".", 2)[2] for name in network.state_dict() if name.startswith("net.")}
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        network.load_state_dict({ours: state[theirs] for ours, theirs in trunk.items()}, strict=False)
    except Exception as e:  # damaged files raise anything
        raise DataFormatError(
            f"{path}: not the weights of torchvision's AlexNet ({type(e).__name__}: {str(e)[:100]})"
        ) from e
    return network
