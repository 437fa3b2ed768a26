"""Pictures from all around: how a flame looks from where it was not filmed, by the angle from the nearest given camera.

A method's own views say little of the flame's shape: what one Gaussian does wrong along a ray, another behind it
repairs. Cameras of role "around" stand where no camera stood; each score is over the camera's own fire-free picture,
which the method has not seen either.

    gradient ratio   mean |d luminance / dx| of the result over that of the truth, in the flame: below 1 is smeared
    false colour     share of the flame's pixels whose hue is none of the fire's: outside the hues of 99 % of the true
                     flame's pixels by more than HUE_MARGIN_DEG; pixels too grey or too dark to have a hue do not count
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import NonFiniteError
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.evaluate.image import psnr, ssim
from gof.evaluate.scores import AroundScore
from gof.host.threads import map_beside

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of red, green and blue (ITU-R BT.709)
HUE_MARGIN_DEG = 10.0
COLOURED = 0.15  # difference between a pixel's largest and smallest channel from which on it has a hue
FIRE_SHARE = 0.99  # of the true flame's pixels, whose hues are the fire's own


@dataclass(frozen=True)
class ViewAround:
    """A camera around the flame.

    Attributes:
        number: of the camera among `dataset.cameras`.   angle_deg: from the nearest given camera, seen from the flame.
        background: (H, W, 3) or a colour, what the result is drawn over.
    """

    number: int
    angle_deg: float
    background: np.ndarray | tuple[float, float, float]


def score_around(
    gaussians: MovingGaussians,
    around: Dataset,
    views: list[ViewAround],
    known: np.ndarray,
    progress: Callable[..., None],
) -> tuple[AroundScore, ...]:
    """Score the pictures of every camera around the flame, in the order of `views`.

    Args:
        around: the dataset seen by these cameras (`Dataset.around_view`).
        known: (T,) bool, the frames that the result says something about.
    Returns:
        Scores of those cameras that see the flame in a known frame; means over pictures.
    """
    from gof.render import render  # here: it loads the compiler

    def pictures() -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
        for done, view in enumerate(views):
            camera, times_s = around.cameras[view.number], around.camera_times_s(view.number)
            for frame in around.frames(view.number):
                truth, mask = around.image(view.number, frame), around.mask(view.number, frame)
                if not known[frame] or mask is None or not mask.any():
                    continue
                time_s = float(times_s[frame])
                drawn = render(gaussians.state_at(time_s), camera, time_s, background=view.background)["color"]
                yield done, drawn, truth, mask
            progress(done + 1, len(views), stage="around")

    def score(picture: tuple[int, np.ndarray, np.ndarray, np.ndarray]) -> tuple[int, dict[str, float | None]]:
        number, drawn, truth, mask = picture
        return number, picture_figures(np.clip(drawn, 0, 1), truth, mask)

    found = list(map_beside(score, pictures()))
    scores = []
    for number, view in enumerate(views):
        if rows := [row for of, row in found if of == number]:
            means = {name: _mean([row[name] for row in rows]) for name in rows[0]}
            name = around.cameras[view.number].name
            scores.append(AroundScore(camera=name, angle_deg=view.angle_deg, pictures=len(rows), **means))
    return tuple(scores)


def angles_deg(around: list[Camera], given: list[Camera]) -> list[float]:
    """Return the angle of each camera around from the nearest given one, degrees, seen from where all of them look.

    0 for a camera at that very place.
    """
    middle = meeting_point([*given, *around])
    toward = _directions(given, middle)
    cosines = _directions(around, middle) @ toward.T
    return np.degrees(np.arccos(np.clip(cosines.max(1), -1, 1))).round(2).tolist()


def meeting_point(cameras: list[Camera]) -> np.ndarray:
    """Return the point (3,), m, that is nearest to the cameras' optical axes, least squares.

    For a single camera, or parallel ones, it is the nearest of these points to their mean place.
    """
    places = np.stack([camera.position for camera in cameras])
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    shift = np.linalg.lstsq(across.sum(0), (across @ (places - places.mean(0))[..., None]).sum(0)[:, 0], rcond=1e-8)[0]
    return places.mean(0) + shift


def _directions(cameras: list[Camera], middle: np.ndarray) -> np.ndarray:
    """Return unit vectors (C, 3) from the middle to the cameras; against the axis of one that stands there."""
    away = np.stack([camera.position for camera in cameras]) - middle
    length = np.linalg.norm(away, axis=1, keepdims=True)
    back = -np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    return np.where(length > 1e-9, away / np.maximum(length, 1e-9), back)


def picture_figures(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> dict[str, float | None]:
    """Compare a drawn picture with the true one where the flame is.

    Args:
        image, truth: (H, W, 3) display values in [0, 1].   mask: (H, W) bool, not all False.
    Returns:
        psnr_flame (dB), ssim_flame, gradient_ratio and false_colour; the last two None where the true flame has no
        gradient, or no pixel a hue.
    Raises:
        NonFiniteError: NaN or Inf in a picture.
    """
    return {
        "psnr_flame": psnr(image, truth, mask),
        "ssim_flame": ssim(image, truth, mask),
        "gradient_ratio": gradient_ratio(image, truth, mask),
        "false_colour": false_colour(image, truth, mask),
    }


def gradient_ratio(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float | None:
    """Return the horizontal sharpness of a picture over the true one's; None where that is 0. Args: see the module."""
    both = mask[:, 1:].astype(bool) & mask[:, :-1].astype(bool)
    own, true = (np.abs(np.diff(picture @ LUMINANCE, axis=1))[both].sum() for picture in (image, truth))
    return float(own / true) if true > 0 else None


def false_colour(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float | None:
    """Return the share of the flame's coloured pixels whose hue no part of the true flame has; None without any."""
    flame = mask.astype(bool)
    own, true = hue_deg(image[flame]), hue_deg(truth[flame])
    if not np.isfinite(true).any():
        return None
    low, high = np.nanquantile(true, [(1 - FIRE_SHARE) / 2, (1 + FIRE_SHARE) / 2])
    coloured = own[np.isfinite(own)]
    if not len(coloured):
        return 0.0
    return float(((coloured < low - HUE_MARGIN_DEG) | (coloured > high + HUE_MARGIN_DEG)).mean())


def hue_deg(colours: np.ndarray) -> np.ndarray:
    """Return the hue of colours (N, 3) in [-180, 180): red 0, yellow 60, green 120, blue -120; NaN where there is none.

    Raises:
        NonFiniteError: NaN or Inf in the colours.
    """
    if not np.isfinite(colours).all():
        raise NonFiniteError("a picture holds NaN or Inf")
    red, green, blue = colours.T.astype(np.float64)
    hue = np.degrees(np.arctan2(np.sqrt(3) * (green - blue), 2 * red - green - blue))
    return np.where(np.ptp(colours, axis=1) >= COLOURED, hue, np.nan)


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
