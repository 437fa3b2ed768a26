"""The six picture figures that the authors publish, by the definitions of their released evaluation; and their values.

They differ from ours of similar names: the flame is what *moves* (optical flow above half a pixel a frame), not a flame
mask; masks are hard; LPIPS and the frame are whole, with the board; depth is compared as inverse depth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import MissingDependencyError
from gof.core.gaussians import TransientGaussians
from gof.evaluate.image import lpips, psnr, ssim
from gof.evaluate.scores import PublishedFigures

Flow = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of two pictures (H, W) uint8: (H, W, 2) px

MOVES_PX = 0.5  # a frame
ERODE_PX = 9  # the flame's mask is not exact at its border, and depth jumps there
NAME = "Gaussians on Fire, published"
OTHER_FOOTAGE = "published by its authors for 17 captures at 1280x720: other footage than this table's, not comparable"
THEIRS = PublishedFigures(
    psnr_flame=30.64,
    ssim_flame=0.907,
    rmse_depth_flame=0.086,
    lpips=0.025,
    psnr_no_sync=38.03,
    ssim_no_sync=0.979,
)


@dataclass(frozen=True)
class PublishedFrame:
    """A held-out frame of a camera as these figures see it.

    Attributes:
        image, truth, after: (H, W, 3) display values in [0, 1]: drawn, true, and true in the next frame.
        board: (H, W) bool, the LED board; None where there is none.
        disparity: (H, W) drawn, 1/m, see `drawn_disparity`.
        expected: (H, W) inverse depth in any unit, as a monocular network gives it; None without.
    """

    image: np.ndarray
    truth: np.ndarray
    after: np.ndarray
    board: np.ndarray | None
    disparity: np.ndarray
    expected: np.ndarray | None


def published_figures(frame: PublishedFrame, flow: Flow, weights: Path | None) -> PublishedFigures:
    """Return the six of one picture; None where one is undefined (nothing moves) or its material is not there.

    Args:
        weights: folder of LPIPS' weight file, or None.
    """
    still = np.zeros(frame.truth.shape[:2], bool) if frame.board is None else frame.board
    flame = moving(frame.truth, frame.after, flow) & ~still
    figures = {
        "psnr_flame": psnr(frame.image, frame.truth, flame),
        "ssim_flame": ssim(frame.image, frame.truth, flame),
        "psnr_no_sync": psnr(frame.image, frame.truth, ~still),
        "ssim_no_sync": ssim(frame.image, frame.truth, ~still),
        "lpips": None if weights is None else _lpips(frame.image, frame.truth, weights),
        "rmse_depth_flame": (
            None if frame.expected is None else rmse_disparity(frame.disparity, frame.expected, flame)
        ),
    }
    return PublishedFigures(**figures)


def mean_figures(pictures: Sequence[PublishedFigures]) -> PublishedFigures:
    """Return the mean of every figure over the pictures in which it is defined."""
    means = {}
    for field in fields(PublishedFigures):
        defined = [value for picture in pictures if (value := getattr(picture, field.name)) is not None]
        means[field.name] = float(np.mean(defined)) if defined else None
    return PublishedFigures(**means)


def moving(picture: np.ndarray, after: np.ndarray, flow: Flow) -> np.ndarray:
    """Return (H, W) bool: what moves by more than MOVES_PX from a frame (H, W, 3) to the next, display values in [0,
    1]."""
    grey = [cv2.cvtColor(np.rint(255 * p).astype(np.uint8), cv2.COLOR_RGB2GRAY) for p in (picture, after)]
    return np.linalg.norm(flow(*grey), axis=-1) > MOVES_PX


def rmse_disparity(drawn: np.ndarray, expected: np.ndarray, flame: np.ndarray) -> float | None:
    """Error of inverse depth on the flame, 0..1, after scale and offset are fitted over the *whole* picture.

    Args:
        drawn: (H, W) inverse depth, 0 where nothing is; its range is stretched to 0..1 first.
        expected: (H, W) inverse depth >= 0 in any unit; its maximum becomes 1.
        flame: (H, W) bool; eroded by ERODE_PX.
    Returns:
        None where nothing is left of the flame, or of `expected`.
    """
    counts = inside(flame)
    if not counts.any() or not expected.max() > 0:
        return None
    lit = drawn > 0
    shape = np.zeros(drawn.shape)
    if lit.any():
        low, high = drawn[lit].min(), drawn[lit].max()
        shape[lit] = (drawn[lit] - low) / (high - low if high > low else 1.0)
    target = expected / expected.max()
    system = np.stack([shape.ravel(), np.ones(shape.size)], 1)
    scale, offset = np.linalg.lstsq(system, target.ravel(), rcond=None)[0]
    error = np.clip(scale * shape + offset, 0, 1) - target
    return float(np.sqrt((error[counts] ** 2).mean()))


def inside(flame: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: where depth counts, the flame (H, W) bool eroded by ERODE_PX."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (ERODE_PX, ERODE_PX))
    return cv2.erode(flame.astype(np.uint8), kernel) > 0


def drawn_disparity(state: TransientGaussians, camera: Camera, time_s: float) -> np.ndarray:
    """Return (H, W) sum of w / z over the Gaussians a pixel blends, z their centres' camera depth, 1/m; 0 where nothing
    is."""
    from dataclasses import replace

    from gof.render import render  # here: it loads the compiler

    depth = camera.to_camera(state.at(time_s)[0])[:, 2]
    inverse = 1 / np.maximum(depth, 1e-6)  # those behind the camera are not drawn
    painted = replace(state, color=np.repeat(inverse[:, None], 3, axis=1))
    return render(painted, camera, time_s, background=(0.0, 0.0, 0.0))["color"][..., 0]


def _lpips(image: np.ndarray, truth: np.ndarray, weights: Path) -> float | None:
    """As their port of LPIPS: it takes pictures in [0, 1] for such in [-1, 1]."""
    try:
        return lpips((image + 1) / 2, (truth + 1) / 2, weights)
    except MissingDependencyError:
        return None  # `image_scores` says so
