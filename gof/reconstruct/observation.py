"""Observations: pictures, flame masks, light above the plates, and dense optical flow on the dataset clock.

Held-out frames are never read here, and no flow uses one (paper, "Results": every 8th frame is held out).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.colour import srgb_to_linear
from gof.core.errors import DataFormatError
from gof.dataset import Dataset
from gof.footage.flame_mask import flame_mask
from gof.host.threads import map_on_cores
from gof.reconstruct.lit_plate import faint_flame, lit_plate
from gof.reconstruct.methods import OURS, Method
from gof.reconstruct.occluders import blocked_views
from gof.reconstruct.optical_flow import FlowMethod, dis

MAX_ERROR_PX = 1.0  # there and back, plus a tenth of its length: above, a flow vector is dropped
MOVING_PX = 0.5
TOGETHER = 8  # frames of a camera whose flow one core finds, one after the other, as neighbours share it
GROWN_BY = np.ones((5, 5), np.uint8)


@dataclass(frozen=True)
class Observation:
    """The observation of C cameras in the F training frames, pictures of H x W pixels, the largest camera's.

    Smaller pictures stand in the upper left corner of theirs (`own_part`); what is beyond them is black and `blocked`.

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
        allowed: (F, C, H, W) bool, where flame Gaussians may shine: `mask`, or somewhat more.
        flow: (F, C, H, W, 2) float32 pixels per second; NaN where no trustworthy flow exists.
        delivered: (F, C) bool, False where a camera gave no picture (a black frame in its place).
        blocked: (C, H, W) bool, where something still stands before the flame, or no picture is.
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
    allowed: np.ndarray
    flow: np.ndarray
    delivered: np.ndarray
    blocked: np.ndarray

    def without_motion(self) -> Observation:
        """Return it with pictures of no pixels as `intensity` and `flow`: what no seed, nor step, needs any more."""
        return replace(self, intensity=self.intensity[..., :0, :0].copy(), flow=self.flow[..., :0, :0, :].copy())


def own_part(picture: np.ndarray, camera: Camera) -> np.ndarray:
    """Return what a camera of the dataset really took of a picture (H, W, ...) of an `Observation`; a view."""
    return picture[: camera.height, : camera.width]


def light_above(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """Linear light above the fire-free plate, (H, W, 3) >= 0. image and static (H, W, 3) display sRGB.

    Fire adds light, so the difference in linear light is the fire without the background behind it.
    """
    return np.maximum(srgb_to_linear(image) - srgb_to_linear(static), 0)


def _mean_light_above(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(H, W) `light_above`, mean of the channels."""
    return light_above(image, static).mean(-1)


def was_delivered(images: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(F,) bool: which of images (F, H, W, 3) a camera really took; static (H, W, 3), display sRGB.

    Fire only adds light, so a picture with less than half of its plate's light was not taken of this scene.
    """
    light = [np.minimum(image, static).mean() for image in images]  # one by one: a clip takes gigabytes
    return np.array(light) >= 0.5 * static.mean()


def flow_picture(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(H, W) uint8 for optical flow: log of the green light above the plate.

    Taking the plate away keeps the still background behind a thin flame from pulling the flow to zero; green is not
    clipped where red is; the log gives dim and bright parts the same contrast.
    """
    dark, bright = np.log(0.01), np.log(0.8)
    green = np.log(light_above(image, static)[..., 1] + 0.01)
    return (np.clip((green - dark) / (bright - dark), 0, 1) * 255).astype(np.uint8)


def colour_picture(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 for optical flow: the picture itself (paper). image: (H, W, 3) display sRGB."""
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def consistency(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """(H, W) px: how far a pixel lands from itself after going forward and back; inf where it leaves the image."""
    h, w = forward.shape[:2]
    x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    x, y = x + forward[..., 0], y + forward[..., 1]
    inside = (x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1)
    returned = cv2.remap(backward, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.where(inside, np.linalg.norm(forward + returned, axis=-1), np.inf)


FrameVelocity = Callable[[dict[int, np.ndarray], np.ndarray, int], np.ndarray]
"""Pictures by frame, times of all frames and a frame -> (H, W, 2) px/s, NaN where it is not known."""


class _Pairs:
    """Optical flow between two pictures, there and back. Both of them ask for it, so that of the last pair is kept.

    Not for several threads at once.
    """

    def __init__(self, flow: FlowMethod):
        self._flow = flow
        self._pair: tuple[np.ndarray, np.ndarray] = np.empty(0), np.empty(0)
        self._flows: tuple[np.ndarray, np.ndarray] = self._pair

    def __call__(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 2) px from the first picture to the second, and from the second to the first."""
        if first is self._pair[1] and second is self._pair[0]:
            return self._flows[::-1]
        self._pair, self._flows = (first, second), (self._flow(first, second), self._flow(second, first))
        return self._flows


def checked_velocity(flow: FlowMethod) -> FrameVelocity:
    """Central where both neighbours are training frames, one-sided where one is; without what does not come back."""
    pairs = _Pairs(flow)

    def velocity_at(pictures: dict[int, np.ndarray], times: np.ndarray, k: int) -> np.ndarray:
        estimates = []
        for neighbour in (k - 1, k + 1):
            if neighbour not in pictures:
                continue
            moved, back = pairs(pictures[k], pictures[neighbour])
            bad = consistency(moved, back) > MAX_ERROR_PX + 0.1 * np.linalg.norm(moved, axis=-1)
            velocity = moved / (times[neighbour] - times[k])
            velocity[bad] = np.nan
            estimates.append(velocity)
        if not estimates:
            return _unknown(pictures[k])
        stack = np.stack(estimates)
        valid = np.isfinite(stack)
        count = valid.sum(0)
        total = np.where(valid, stack, 0).sum(0)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)

    return velocity_at


def velocity_ahead(flow: FlowMethod) -> FrameVelocity:
    """To the next frame (paper); from the one before, turned round, where the next is held out."""

    def velocity_at(pictures: dict[int, np.ndarray], times: np.ndarray, k: int) -> np.ndarray:
        for neighbour in (k + 1, k - 1):
            if neighbour in pictures:
                moved = flow(pictures[k], pictures[neighbour], pictures.get(2 * k - neighbour))
                return (moved / (times[neighbour] - times[k])).astype(np.float32)
        return _unknown(pictures[k])

    return velocity_at


def _unknown(picture: np.ndarray) -> np.ndarray:
    return np.full((*picture.shape[:2], 2), np.nan, np.float32)


def flow_masks(flow: np.ndarray, frame_time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where something moves by more than `MOVING_PX` a frame, (...) bool, and that area grown (paper's authors).

    Their pictures are 1280 px long; at another size or frame rate half a pixel is another speed.

    Args:
        flow: (F, C, H, W, 2) px/s, NaN where unknown.
    """
    with np.errstate(invalid="ignore"):
        moving = np.linalg.norm(flow, axis=-1) * frame_time_s > MOVING_PX
    grown = [[cv2.dilate(m.astype(np.uint8), GROWN_BY, iterations=2) > 0 for m in frame] for frame in moving]
    return moving, np.array(grown)


class _CameraObservation(NamedTuple):
    """The observation of one camera; shapes as in `Observation`, without C."""

    times_s: np.ndarray  # (T,) of all frames of the dataset
    image: np.ndarray
    static: np.ndarray
    plate: np.ndarray
    mask: np.ndarray
    delivered: np.ndarray


def _view(dataset: Dataset, camera: int, frames: np.ndarray, method: Method, image: np.ndarray) -> _CameraObservation:
    """Return what a camera saw; image: (F, H, W, 3) float32, which is filled with its pictures."""
    static = dataset.static(camera)
    counts = dataset.board_weight(camera)
    for i, k in enumerate(frames):
        picture = dataset.image(camera, k)
        if counts is not None:  # on the sync board like the plate: its LEDs are no fire and hide the flame behind them
            picture = static + counts[..., None] * (picture - static)
        image[i] = picture
    mask = np.stack([flame_mask(picture, static) for picture in image])
    delivered = was_delivered(image, static)
    unseen = ~delivered[:, None, None]
    if method.faint_flame:
        mask, plate = faint_flame(static, image, mask, unseen)
    else:
        plate = lit_plate(static, image, mask | unseen) if method.lit_plates else static
    return _CameraObservation(dataset.camera_times_s(camera), image, static, plate, mask, delivered)


def observe(
    dataset: Dataset,
    method: Method = OURS,
    flow: FlowMethod = dis,
    progress: Callable[..., None] | None = None,
) -> Observation:
    """Read the training frames; find masks, intensity and flow of every camera in each.

    Args:
        dataset: opened dataset; its test frames are not read.
        method: how plates, flow and masks are made.
        flow: see `optical_flow`.
        progress: called with (done, total) after every picture.

    Raises:
        DataFormatError: no training frame, or no flame in any picture.
    """
    frames = np.array(sorted(dataset.train_frames))
    if not len(frames):
        raise DataFormatError(f"{dataset.path}: splits.train is empty; nothing to reconstruct from")
    own, height, width = list(dataset.cameras), *_largest(dataset.cameras)
    # A clip's pictures take gigabytes: they are read to their place, and held once.
    image = np.zeros((len(frames), len(own), height, width, 3), np.float32)

    def view_of(c: int) -> _CameraObservation:
        return _view(dataset, c, frames, method, image[:, c, : own[c].height, : own[c].width])

    views = map_on_cores(view_of, range(len(own)))
    if not any(view.mask.any() for view in views):
        raise DataFormatError(
            f"{dataset.path}: no flame found in any training frame (nothing rises above the static plates)"
        )
    picture, make_velocity = (
        (flow_picture, checked_velocity) if method.flow_of_light else (colour_picture, velocity_ahead)
    )
    velocity = np.full((*image.shape[:-1], 2), np.nan, np.float32)
    _find_flow(velocity, views, frames, picture, partial(make_velocity, flow), progress)
    mask, intensity = np.zeros(image.shape[:-1], bool), np.zeros(image.shape[:-1], np.float32)
    static, plate, beyond = np.zeros(image.shape[1:], np.float32), np.zeros(image.shape[1:], np.float32), []
    for c, view in enumerate(views):
        h, w = view.static.shape[:2]
        static[c, :h, :w], plate[c, :h, :w], mask[:, c, :h, :w] = view.static, view.plate, view.mask
        intensity[:, c, :h, :w] = map_on_cores(partial(_mean_light_above, static=view.plate), view.image)
        beyond.append((np.arange(height)[:, None] >= h) | (np.arange(width) >= w))
    allowed = mask
    if method.flow_masks:
        mask, allowed = flow_masks(velocity, dataset.frame_time_s)
        if not mask.any():
            raise DataFormatError(f"{dataset.path}: nothing moves by more than {MOVING_PX} px a frame")
    cameras = [camera.cropped(0, 0, width, height) for camera in own]
    hidden = blocked_views(cameras, mask, intensity) if method.vetoes else np.zeros(mask.shape[1:], bool)
    return Observation(
        cameras=cameras,
        frames=frames,
        time_s=dataset.times_s[frames],
        camera_time_s=np.stack(
            [v.times_s[frames] - _lines_added(c, height, width) * c.row_time_s for v, c in zip(views, own, strict=True)]
        ),
        image=image,
        static=static,
        plate=plate,
        intensity=intensity,
        mask=mask,
        allowed=allowed,
        flow=velocity,
        delivered=np.stack([view.delivered for view in views], axis=1),
        blocked=hidden | np.stack(beyond),
    )


def _largest(cameras: Sequence[Camera]) -> tuple[int, int]:
    return max(camera.height for camera in cameras), max(camera.width for camera in cameras)


def _lines_added(camera: Camera, height: int, width: int) -> int:
    """How many lines a rolling shutter would read of a picture of that size, before those that the camera has."""
    return {"up": height - camera.height, "left": width - camera.width}.get(camera.readout, 0)


def _find_flow(
    velocity: np.ndarray,
    views: list[_CameraObservation],
    frames: np.ndarray,
    picture: Callable[[np.ndarray, np.ndarray], np.ndarray],
    make_velocity: Callable[[], FrameVelocity],
    progress: Callable[..., None] | None,
) -> None:
    """Fill velocity (F, C, H, W, 2) with px/s; other args as `observe`."""
    parts = np.array_split(np.arange(len(frames)), -(-len(frames) // TOGETHER))
    runs = [(c, part) for c in range(len(views)) for part in parts]

    def find(run: tuple[int, np.ndarray]) -> None:
        c, part = run
        view, (h, w) = views[c], views[c].static.shape[:2]
        near = range(max(part[0] - 1, 0), min(part[-1] + 2, len(frames)))
        pictures = {int(frames[i]): picture(view.image[i], view.plate) for i in near}
        velocity_at = make_velocity()
        for i in part:
            velocity[i, c, :h, :w] = velocity_at(pictures, view.times_s, int(frames[i]))

    done = np.cumsum([len(part) for _, part in runs])
    map_on_cores(find, runs, progress and (lambda run, _: progress(int(done[run - 1]), int(done[-1]))))
