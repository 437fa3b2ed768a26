"""A cloud's clip on the scene's timeline: which frames show it, and a timeline that fits it."""

from __future__ import annotations

import bpy

from ..pure import playback
from ..pure.io.cloud import GaussianCloud
from . import point_cloud

CLIP = "gof_clip_s"  # custom property of a cloud: first and last second of its clip
NEW = (1, 250, 24, 1.0)  # first and last frame, rate and its divisor of Blender's own new file


def keep(thing: bpy.types.Object, cloud: GaussianCloud) -> None:
    """Note on the cloud's object when it was filmed; nothing for a still."""
    if clip_s := playback.seconds(cloud):
        thing[CLIP] = clip_s


def is_new(scene: bpy.types.Scene) -> bool:
    """Return whether the scene's frame range and rate are still Blender's own."""
    return (scene.frame_start, scene.frame_end, scene.render.fps, scene.render.fps_base) == NEW


def line(scene: bpy.types.Scene, thing: bpy.types.Object) -> str:
    """Return when a cloud is visible: its length and its frames in this scene; "" for a still."""
    if CLIP not in thing:
        return ""
    frames = span(scene, thing)
    rate = scene.render.fps / scene.render.fps_base
    where = f"frames {frames.first} to {frames.last} at {rate:g} fps" if frames else "none of this scene's frames"
    return f"Clip: {thing[CLIP][1] - thing[CLIP][0]:.3g} s, {where}"


def fit(scene: bpy.types.Scene, thing: bpy.types.Object) -> None:
    """Give the scene the frame range of a cloud's clip, and a rate at which it can be watched; a still changes none.

    A clip that lies before frame 0, or where Blender does not count, is moved to frame 1 by the cloud's Start Frame.
    """
    if CLIP not in thing:
        return
    settings, render = point_cloud.inputs(thing), scene.render
    speed = settings["Time Scale"] or 1.0
    before = render.fps / render.fps_base
    rate = playback.rate(thing[CLIP], before, speed)
    if rate != before:
        render.fps, render.fps_base = round(rate), 1.0
    frames = span(scene, thing)
    if frames is None or frames.first < 0:
        begin_s = thing[CLIP][0] if speed > 0 else thing[CLIP][1]
        settings["Start Frame"] = 1.0 - begin_s * rate / speed
        frames = span(scene, thing)
    if frames:
        scene.frame_start, scene.frame_end = frames.first, frames.last
        scene.frame_set(min(max(scene.frame_current, frames.first), frames.last))


def span(scene: bpy.types.Scene, thing: bpy.types.Object) -> playback.Span | None:
    settings = point_cloud.inputs(thing)
    rate = scene.render.fps / scene.render.fps_base
    return playback.span(thing[CLIP], settings["Start Frame"], rate, settings["Time Scale"])
