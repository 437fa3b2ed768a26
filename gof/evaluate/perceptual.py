"""Perceptual image scores that need something extra: FLIP (a package), LPIPS (PyTorch and local weights)."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError, MissingDependencyError
from gof.evaluate.image import _mean, _pair
from gof.host import extras

TRUNK = "alexnet-owt-7be5be79.pth"  # torchvision's AlexNet, ImageNet-trained
HEADS = "lpips_alex_v0.1.pth"  # of the lpips package, where it is called weights/v0.1/alex.pth
LAYERS = (
    (0, 3, 64, 11, 4, 2),
    (3, 64, 192, 5, 1, 2),
    (6, 192, 384, 3, 1, 1),
    (8, 384, 256, 3, 1, 1),
    (10, 256, 256, 3, 1, 1),
)
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of inputs in [-1, 1]


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
    """LPIPS 0.1 with AlexNet (Zhang et al. 2018): distance of unit-normalised features of five layers; 0 is identical.

    Args:
        image, truth: (H, W, 3) display values in [0, 1], at least 32 px on each side.
        weights: folder with `alexnet-owt-7be5be79.pth` and `lpips_alex_v0.1.pth` (the latter may come with the lpips
            package).
    Raises:
        MissingDependencyError: PyTorch or a weight file is absent (names it).
        DataFormatError: a weight file holds something else, or the pictures are too small.
    """
    image, truth = _pair(image, truth)
    if min(image.shape[:2]) < 32:
        raise DataFormatError(f"LPIPS needs pictures of at least 32 px on each side, got {image.shape[:2]}")
    torch = extras.load("torch", "torch", "LPIPS")
    F = torch.nn.functional
    trunk, heads = _weights(Path(weights))
    with torch.no_grad():
        x = torch.tensor(np.stack([image, truth]).transpose(0, 3, 1, 2) * 2 - 1, dtype=torch.float32)
        x = (x - torch.tensor(SHIFT)[:, None, None]) / torch.tensor(SCALE)[:, None, None]
        total = 0.0
        for i, (number, _, _, _, stride, padding) in enumerate(LAYERS):
            if i in (1, 2):
                x = F.max_pool2d(x, 3, 2)
            x = F.relu(
                F.conv2d(x, trunk[f"features.{number}.weight"], trunk[f"features.{number}.bias"], stride, padding)
            )
            unit = x / (x.norm(dim=1, keepdim=True) + 1e-10)
            total += float(F.conv2d((unit[:1] - unit[1:]) ** 2, heads[f"lin{i}.model.1.weight"]).mean())
    return total


@lru_cache(maxsize=2)
def _weights(folder: Path) -> tuple[dict, dict]:
    heads = folder / HEADS
    package = find_spec("lpips")
    if not heads.is_file() and package and package.origin:
        heads = Path(package.origin).parent / "weights" / "v0.1" / "alex.pth"
    return (
        load_weights(
            folder / TRUNK,
            {f"features.{n}.weight": (o, c, k, k) for n, c, o, k, _, _ in LAYERS}
            | {f"features.{n}.bias": (o,) for n, _, o, _, _, _ in LAYERS},
            "torchvision's AlexNet",
            "LPIPS",
        ),
        load_weights(
            heads,
            {f"lin{i}.model.1.weight": (1, o, 1, 1) for i, (_, _, o, _, _, _) in enumerate(LAYERS)},
            "weights/v0.1/alex.pth of the lpips package, under this name",
            "LPIPS",
        ),
    )


def load_weights(path: Path, shapes: dict[str, tuple], what: str, score: str) -> dict:
    """Tensors of a PyTorch state file by name, float32, with exactly these shapes; others in the file are ignored.

    Raises:
        MissingDependencyError: the file is absent.   DataFormatError: it holds something else.
    """
    import torch

    if not path.is_file():
        raise MissingDependencyError(f"{score}: {path} is absent ({what}); put it there, gof downloads nothing")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        found = {name: tuple(state[name].shape) for name in shapes}
    except Exception as e:
        raise DataFormatError(f"{path}: not the weights of {what} ({type(e).__name__}: {str(e)[:100]})") from e
    if found != shapes:
        raise DataFormatError(f"{path}: layers have other shapes than {what}")
    return {name: state[name].float() for name in shapes}
