"""A cloud's clip on the scene's timeline: which frames show it, and a timeline that fits it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np

from ..pure.io.cloud import GaussianCloud
from . import point_cloud

CLIP = "gof_clip_s"  # custom property of a cloud: first and last second of its clip
NEW = (1, 250, 24, 1.0)  # first and last frame, rate and its divisor of Blender's own new file
RATES = (24, 25, 30, 50, 60, 100, 120, 200, 240, 400, 500, 1000)
WATCHABLE = 30  # frames; a clip of fewer is a flicker
LAST_FRAME = 1_048_574  # Blender counts no further
EDGE = 1.0  # percent of the Gaussians before the clip, and behind it: runaways


@dataclass(frozen=True)
class Span:
    """Frames of a scene, the first and the last of a clip."""

    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first + 1


def keep(object_: bpy.types.Object, cloud: GaussianCloud) -> None:
    """Note on the cloud's object when it was filmed; nothing for a still."""
    if clip_s := _seconds(cloud):
        object_[CLIP] = clip_s


def is_new(scene: bpy.types.Scene) -> bool:
    """Return whether the scene's frame range and rate are still Blender's own."""
    return (scene.frame_start, scene.frame_end, scene.render.fps, scene.render.fps_base) == NEW


def line(scene: bpy.types.Scene, object_: bpy.types.Object) -> str:
    """Return when a cloud is visible: its length and its frames in this scene; "" for a still."""
    if CLIP not in object_:
        return ""
    frames = span(scene, object_)
    rate = scene.render.fps / scene.render.fps_base
    where = f"frames {frames.first} to {frames.last} at {rate:g} fps" if frames else "none of this scene's frames"
    return f"Clip: {object_[CLIP][1] - object_[CLIP][0]:.3g} s, {where}"


def fit(scene: bpy.types.Scene, object_: bpy.types.Object) -> None:
    """Give the scene the frame range of a cloud's clip, and a rate at which it can be watched; a still changes none.

    A clip that lies before frame 0, or where Blender does not count, is moved to frame 1 by the cloud's Start Frame.
    """
    if CLIP not in object_:
        return
    settings, render = point_cloud.inputs(object_), scene.render
    speed = settings["Time Scale"] or 1.0
    before = render.fps / render.fps_base
    rate = _watchable_rate(object_[CLIP], before, speed)
    if rate != before:
        render.fps, render.fps_base = round(rate), 1.0
    frames = span(scene, object_)
    if frames is None or frames.first < 0:
        begin_s = object_[CLIP][0] if speed > 0 else object_[CLIP][1]
        settings["Start Frame"] = 1.0 - begin_s * rate / speed
        frames = span(scene, object_)
    if frames:
        scene.frame_start, scene.frame_end = frames.first, frames.last
        scene.frame_set(min(max(scene.frame_current, frames.first), frames.last))


def span(scene: bpy.types.Scene, object_: bpy.types.Object) -> Span | None:
    settings = point_cloud.inputs(object_)
    rate = scene.render.fps / scene.render.fps_base
    return _frames(object_[CLIP], settings["Start Frame"], rate, settings["Time Scale"])


def _seconds(cloud: GaussianCloud) -> tuple[float, float] | None:
    """Return first and last second of what was filmed, on the recording's clock; None for a still.

    A file does not say it: it is when the Gaussians are brightest, or of a sequence of files when they are shown.
    """
    if cloud.begin is not None:
        return float(cloud.begin.min()), float(cloud.end.max())
    fading = cloud.dynamic & np.isfinite(cloud.t_sigma)
    if not fading.any():
        return None
    first, last = np.percentile(cloud.t_mu[fading].astype(np.float64), [EDGE, 100 - EDGE])
    return (float(first), float(last)) if last > first else None


def _frames(clip_s: tuple[float, float], start_frame: float, fps: float, time_scale: float) -> Span | None:
    """Return the scene's frames of a clip; None where time stands still, or Blender does not count so far."""
    if time_scale == 0:
        return None
    ends = [start_frame + second * fps / time_scale for second in clip_s]
    if not all(math.isfinite(end) and abs(end) < LAST_FRAME for end in ends):
        return None
    return Span(round(min(ends)), round(max(ends)))


def _watchable_rate(clip_s: tuple[float, float], fps: float, time_scale: float) -> float:
    """Return frames per second at which a clip can be watched: the scene's own, or the lowest usual one of enough
    frames."""
    length_s = (clip_s[1] - clip_s[0]) / abs(time_scale)
    if length_s * fps >= WATCHABLE:
        return fps
    return next((usual for usual in RATES if usual > fps and length_s * usual >= WATCHABLE), max(fps, RATES[-1]))
