"""Image scores on display values in [0, 1], in float64: PSNR and SSIM, for the whole picture or inside a flame mask."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gof.core.errors import DataFormatError, GofError, MissingDependencyError, require_finite
from gof.host import extras
from gof.render.ssim import C1, C2, REACH, SIGMA_PX

MOST_DB = 100.0  # infinity would leave a perfect picture out of every mean, and would be the mean of one


def psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """Return peak signal-to-noise ratio in dB, -10 log10 of the mean squared error over pixels and channels.

    Args:
        image, truth: (H, W, C) display values, nominally in [0, 1].
        mask: (H, W) weights >= 0, e.g. 1 on flame; None = every pixel counts.
    Returns:
        dB, at most `MOST_DB`, which identical pictures have; None when the mask is empty.
    Raises:
        GofError: shapes disagree.   NonFiniteError: NaN or Inf in a picture.
    """
    return psnr_by_mask(image, truth, [mask])[0]


def psnr_by_mask(image: np.ndarray, truth: np.ndarray, masks: Sequence[np.ndarray | None]) -> list[float | None]:
    """Return `psnr` with each of the masks."""
    image, truth = _pair(image, truth)
    squared = _over_channels((image - truth) ** 2)
    errors = [_mean(squared, mask) for mask in masks]
    return [None if error is None else float(-10 * np.log10(max(error, 10 ** (-MOST_DB / 10)))) for error in errors]


def ssim(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """Structural similarity, the mean of `ssim_map` over pixels (weighted by `mask`) and channels; 1 is identical.

    Arguments, errors and None as in `psnr`.
    """
    return ssim_by_mask(image, truth, [mask])[0]


def ssim_by_mask(image: np.ndarray, truth: np.ndarray, masks: Sequence[np.ndarray | None]) -> list[float | None]:
    """Return `ssim` with each of the masks."""
    similarity = _over_channels(ssim_map(image, truth))
    return [_mean(similarity, mask) for mask in masks]


def ssim_map(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Local structural similarity (H, W, C) with an 11x11 Gaussian window, sigma 1.5, zero outside the picture.

    The map has the size of the picture, as in the 3DGS literature; 5 pixels off the border it equals implementations
    that only use complete windows.
    """
    x, y = _pair(image, truth)
    mean_x, mean_y = _blur(x), _blur(y)
    var_x, var_y = _blur(x * x) - mean_x**2, _blur(y * y) - mean_y**2
    covariance = _blur(x * y) - mean_x * mean_y
    return ((2 * mean_x * mean_y + C1) * (2 * covariance + C2)) / ((mean_x**2 + mean_y**2 + C1) * (var_x + var_y + C2))


def _blur(x: np.ndarray) -> np.ndarray:
    kernel = cv2.getGaussianKernel(2 * REACH + 1, SIGMA_PX, cv2.CV_64F)
    return cv2.sepFilter2D(x, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_CONSTANT).reshape(x.shape)


def _over_channels(values: np.ndarray) -> np.ndarray:
    """Return the mean over the last axis; numpy's own takes six times as long along one of three."""
    return sum(np.moveaxis(values, -1, 0)) / values.shape[-1]


def _mean(per_pixel: np.ndarray, mask: np.ndarray | None) -> float | None:
    if mask is None:
        return float(per_pixel.mean())
    if mask.shape != per_pixel.shape:
        raise GofError(f"mask has shape {mask.shape}, the picture {per_pixel.shape}")
    weight = np.asarray(mask, np.float64)
    total = weight.sum()
    return float((per_pixel * weight).sum() / total) if total > 0 else None


def _pair(image: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    image, truth = np.asarray(image, np.float64), np.asarray(truth, np.float64)
    if image.shape != truth.shape or image.ndim != 3:
        raise GofError(f"pictures have shapes {image.shape} and {truth.shape}, expected the same (H, W, C)")
    require_finite("image", image)
    require_finite("truth", truth)
    return image, truth


def temporal_l2(
    images: tuple[np.ndarray, np.ndarray], truths: tuple[np.ndarray, np.ndarray], mask: np.ndarray | None = None
) -> float | None:
    """Return relative error of the change between neighbouring frames: |dI - dT| / |dT| over pixels (weighted) and
    channels.

    A score of motion and flicker that needs no network and no optical flow: 0 means every pixel brightens and darkens
    as in the truth; a frozen picture scores exactly 1, however good it looks; flicker scores above 1. PSNR and SSIM
    of single frames see neither.

    Args:
        images, truths: two neighbouring frames each, (H, W, C) display values.
        mask: (H, W) weights, e.g. 1 where flame is visible in either frame.
    Returns:
        >= 0; None when the truth does not change inside the mask.
    """
    (a, ta), (b, tb) = _pair(images[0], truths[0]), _pair(images[1], truths[1])
    error = _mean(_over_channels(((b - a) - (tb - ta)) ** 2), mask)
    power = _mean(_over_channels((tb - ta) ** 2), mask)
    return float(np.sqrt(error / power)) if error is not None and power else None


# ----------------------------------------------------------------
# Perceptual image scores that need something extra: FLIP (a package), LPIPS (packages and one file of weights).

TRUNK = "alexnet-owt-7be5be79.pth"  # torchvision's AlexNet, ImageNet-trained, under the name that it is published by


def flip(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """Return mean LDR-FLIP error (Andersson et al. 2020) at 67 pixels per degree, 0 (identical) to 1; reference: the
    truth.

    Arguments, other errors and None as in `gof.evaluate.image.psnr`.

    Raises:
        MissingDependencyError: flip-evaluator is not installed.
    """
    return flip_by_mask(image, truth, [mask])[0]


def flip_by_mask(image: np.ndarray, truth: np.ndarray, masks: Sequence[np.ndarray | None]) -> list[float | None]:
    """Return `flip` with each of the masks."""
    image, truth = _pair(image, truth)
    flip_evaluator = extras.load("flip_evaluator", "scores", "FLIP")
    picture, reference = (np.ascontiguousarray(np.clip(p, 0, 1), np.float32) for p in (image, truth))
    error, _, _ = flip_evaluator.evaluate(reference, picture, "LDR", applyMagma=False, computeMeanError=False)
    return [_mean(np.asarray(error, np.float64)[..., 0], mask) for mask in masks]


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
