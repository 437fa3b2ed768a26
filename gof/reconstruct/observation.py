"""What the cameras saw: pictures, flame masks, light above the plates, and dense optical flow on the dataset clock.

Held-out frames are never read here, and no flow uses one (paper, "Results": every 8th frame is held out).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from gof.cameras import Camera
from gof.colour import srgb_to_linear
from gof.dataset import Dataset
from gof.errors import DataFormatError
from gof.flame_mask import flame_mask
from gof.reconstruct.lit_plate import lit_plate
from gof.reconstruct.optical_flow import Flow, dis


@dataclass(frozen=True)
class Observation:
    """What C cameras saw in the F training frames, pictures of H x W pixels.

    Attributes:
        cameras: C.
        frames: (F,) dataset frame numbers, all from the training split.
        time_s: (F,) of the frames on the dataset clock, s.
        camera_time_s: (C, F) when each camera took them (began to read their first line), s.
        image: (F, C, H, W, 3) float32 display sRGB; the plate where a sync board is.
        static: (C, H, W, 3) float32 display sRGB, the views without fire, in the dark.
        plate: (C, H, W, 3) float32 display sRGB, the views without flame, but in its light.
        intensity: (F, C, H, W) float32 linear light above `plate`, >= 0.
        mask: (F, C, H, W) bool, where flame may be.
        flow: (F, C, H, W, 2) float32 pixels per second; NaN where no trustworthy flow exists.
        delivered: (F, C) bool, False where a camera gave no picture (a black frame in its place).
    """

    cameras: list[Camera]
    frames: np.ndarray
    time_s: np.ndarray
    camera_time_s: np.ndarray
    image: np.ndarray
    static: np.ndarray
    plate: np.ndarray
    intensity: np.ndarray
    mask: np.ndarray
    flow: np.ndarray
    delivered: np.ndarray


def light_above(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """Linear light above the fire-free plate, (H, W, 3) >= 0. image and static (H, W, 3) display sRGB.

    Fire adds light, so the difference in linear light is the fire without the background behind it.
    """
    return np.maximum(srgb_to_linear(image) - srgb_to_linear(static), 0)


def was_delivered(images: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(F,) bool: which of images (F, H, W, 3) a camera really took; static (H, W, 3), display sRGB.

    Fire only adds light, so a picture with less than half of its plate's light was not taken of this scene.
    """
    return np.minimum(images, static).mean((1, 2, 3)) >= 0.5 * static.mean()


def flow_picture(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(H, W) uint8 for optical flow: log of the green light above the plate.

    Taking the plate away keeps the still background behind a thin flame from pulling the flow to zero; green is not
    clipped where red is; the log gives dim and bright parts the same contrast.
    """
    dark, bright = np.log(0.01), np.log(0.8)
    green = np.log(light_above(image, static)[..., 1] + 0.01)
    return (np.clip((green - dark) / (bright - dark), 0, 1) * 255).astype(np.uint8)


def consistency(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """(H, W) px: how far a pixel lands from itself after going forward and back; inf where it leaves the image."""
    h, w = forward.shape[:2]
    x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    x, y = x + forward[..., 0], y + forward[..., 1]
    inside = (x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1)
    returned = cv2.remap(backward, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.where(inside, np.linalg.norm(forward + returned, axis=-1), np.inf)


def _frame_velocity(
    pictures: dict[int, np.ndarray], times: np.ndarray, k: int, max_error_px: float, flow: Flow
) -> np.ndarray:
    """(H, W, 2) px/s at frame k: central where both neighbours are training frames, one-sided where one is."""
    estimates = []
    for neighbour in (k - 1, k + 1):
        if neighbour not in pictures:
            continue
        there = flow(pictures[k], pictures[neighbour])
        back = flow(pictures[neighbour], pictures[k])
        bad = consistency(there, back) > max_error_px + 0.1 * np.linalg.norm(there, axis=-1)
        velocity = there / (times[neighbour] - times[k])
        velocity[bad] = np.nan
        estimates.append(velocity)
    if not estimates:
        return np.full((*pictures[k].shape, 2), np.nan, np.float32)
    stack = np.stack(estimates)
    valid = np.isfinite(stack)
    count = valid.sum(0)
    total = np.where(valid, stack, 0).sum(0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _without_board(dataset: Dataset, camera: int, images: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(F, H, W, 3) pictures, on the sync board like the plate: its LEDs are no fire and hide the flame behind them."""
    weight = dataset.board_weight(camera)
    return images if weight is None else static + weight[..., None] * (images - static)


def observe(
    dataset: Dataset,
    lit_plates: bool = True,
    max_error_px: float = 1.0,
    picture: Callable[[np.ndarray, np.ndarray], np.ndarray] = flow_picture,
    flow: Flow = dis,
    progress: Callable[..., None] | None = None,
) -> Observation:
    """Read the training frames; find masks, intensity and flow of every camera in each.

    Args:
        dataset: opened dataset; its test frames are not read.
        lit_plates: put the fire's light into the plates; else `plate` is `static`.
        max_error_px: forward-backward error above which a flow vector is dropped (plus a tenth of its length).
        picture: (image, static) -> (H, W) uint8, what the optical flow looks at.
        flow: (first, second) -> (H, W, 2) px, see `optical_flow`.
        progress: called with (done, total) after every frame.

    Raises:
        DataFormatError: no training frame, or no flame in any picture.
    """
    frames = np.array(sorted(dataset.train_frames))
    if not len(frames):
        raise DataFormatError(f"{dataset.path}: splits.train is empty; nothing to reconstruct from")
    cameras = range(len(dataset.cameras))

    # What is there without flame, and where the flame is.
    static = [dataset.static(c) for c in cameras]
    images = [_without_board(dataset, c, np.stack([dataset.image(c, k) for k in frames]), static[c]) for c in cameras]
    masks = [np.stack([flame_mask(image, static[c]) for image in images[c]]) for c in cameras]
    if not any(mask.any() for mask in masks):
        raise DataFormatError(
            f"{dataset.path}: no flame found in any training frame (nothing rises above the static plates)"
        )
    delivered = [was_delivered(images[c], static[c]) for c in cameras]
    plates = static
    if lit_plates:
        plates = [lit_plate(static[c], images[c], masks[c] | ~delivered[c][:, None, None]) for c in cameras]

    # How its light moves in each picture.
    intensity = [np.stack([light_above(image, plates[c]).mean(-1) for image in images[c]]) for c in cameras]
    pictures = [
        {int(k): picture(image, plates[c]) for k, image in zip(frames, images[c], strict=True)} for c in cameras
    ]
    times = [dataset.camera_times_s(c) for c in cameras]
    velocity = []
    for i, k in enumerate(frames):
        velocity.append([_frame_velocity(pictures[c], times[c], int(k), max_error_px, flow) for c in cameras])
        if progress:
            progress(i + 1, len(frames))

    return Observation(
        cameras=list(dataset.cameras),
        frames=frames,
        time_s=dataset.times_s[frames],
        camera_time_s=np.stack([times[c][frames] for c in cameras]),
        image=np.stack(images, axis=1),
        static=np.stack(static),
        plate=np.stack(plates),
        intensity=np.stack(intensity, axis=1),
        mask=np.stack(masks, axis=1),
        flow=np.stack([np.stack(v) for v in velocity]),
        delivered=np.stack(delivered, axis=1),
    )
