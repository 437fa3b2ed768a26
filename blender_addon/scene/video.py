"""Display pictures through a video codec and back, with the encoder that Blender ships."""

from __future__ import annotations

import os

import bpy
import numpy as np

from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from . import images
from .effects.video_compression import Settings


def through_codec(spec: SceneSpec, layout: Layout, camera: str, settings: Settings) -> None:
    """Encode a camera's uncompressed pictures as ``video.mp4`` and write the decoded ones as its display pictures.

    What exists already is kept. Raises RuntimeError if Blender writes no video.
    """
    frames = range(spec.clip.frames)
    finished = [layout.frame(camera, frame).rgb for frame in frames]
    if layout.video(camera).is_file() and all(map(images.opens, finished)):
        return
    for path in (layout.video(camera), *finished):
        path.parent.mkdir(parents=True, exist_ok=True)
    # The encoder wants even sizes: pictures are padded by repeating a line, which is cut off again.
    sources = [layout.uncompressed(camera, frame).with_name(f"padded-{frame:06d}.png") for frame in frames]
    for frame, path in zip(frames, sources, strict=True):
        picture = images.read_png(layout.uncompressed(camera, frame))
        height, width = picture.shape[:2]
        images.write_png(path, np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), "edge"))
    draft = images.temporary(layout.video(camera))
    scene = _sequence(width + width % 2, height + height % 2, spec)
    strip = scene.sequence_editor.strips.new_image("Pictures", str(sources[0]), 1, 1, fit_method="ORIGINAL")
    for path in sources[1:]:
        strip.elements.append(path.name)
    strip.frame_final_duration = len(sources)
    _write_video(scene, draft, settings)
    if not draft.is_file() or not draft.stat().st_size:
        raise RuntimeError(f"Blender wrote no video {draft}; was it built with FFmpeg?")
    os.replace(draft, layout.video(camera))

    scene = _sequence(width + width % 2, height + height % 2, spec)
    scene.sequence_editor.strips.new_movie("Video", str(layout.video(camera)), 1, 1, fit_method="ORIGINAL")
    images.set_format(scene.render.image_settings, "PNG")
    scene.render.image_settings.color_mode = "RGB"
    for frame, path in zip(frames, finished, strict=True):
        scene.frame_set(frame + 1)
        draft = path.with_name(f".tmp-decoded-{path.name}")
        scene.render.filepath = str(draft)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        images.write_png(path, images.read_png(draft)[:height, :width])
        draft.unlink()
    for path in sources:
        path.unlink()


def _sequence(width: int, height: int, spec: SceneSpec) -> bpy.types.Scene:
    """A scene that shows its strips pixel by pixel, colours untouched."""
    scene = bpy.data.scenes.new("Video")
    bpy.context.window.scene = scene
    scene.sequence_editor_create()
    scene.view_settings.view_transform = "Standard"
    scene.sequencer_colorspace_settings.name = "sRGB"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.fps, scene.render.fps_base = 25, 1.0
    scene.render.dither_intensity = 0.0
    scene.frame_start, scene.frame_end = 1, spec.clip.frames
    return scene


def _write_video(scene: bpy.types.Scene, path, settings: Settings) -> None:
    images.set_format(scene.render.image_settings, "FFMPEG")
    codec = scene.render.ffmpeg
    codec.format, codec.codec = "MPEG4", "H264"
    codec.constant_rate_factor = settings.quality.upper()
    codec.gopsize = settings.key_frame_every
    codec.audio_codec = "NONE"
    scene.render.filepath = str(path)
    scene.render.use_file_extension = False
    bpy.ops.render.render(animation=True, scene=scene.name)
