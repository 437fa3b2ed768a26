"""Display pictures through a video codec and back, with the encoder that Blender ships."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..core.drafts import draft_of
from ..core.files import atomic_path
from ..pure.effects.video_compression import Settings
from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from . import images


def through_codec(spec: SceneSpec, layout: Layout, camera: str, settings: Settings) -> None:
    """Encode a camera's uncompressed pictures as ``video.mp4`` and write the decoded ones as its display pictures.

    Existing files are kept. Raises RuntimeError if Blender writes no video.
    """
    frames = range(spec.clip.frames)
    finished = [layout.frame(camera, frame).rgb for frame in frames]
    if layout.video(camera).is_file() and all(map(images.opens, finished)):
        return
    for path in finished:
        path.parent.mkdir(parents=True, exist_ok=True)
    uncompressed = [layout.uncompressed(camera, frame) for frame in frames]
    height, width = images.read_png(uncompressed[0]).shape[:2]
    padded = [_padded(path) for path in uncompressed]
    # Blender writes and reads the video as a film strip of even size.
    _encode(padded, _sequence(width + width % 2, height + height % 2, spec), layout.video(camera), settings)
    _decode(layout.video(camera), _sequence(width + width % 2, height + height % 2, spec), finished, (height, width))
    for path in padded:
        path.unlink()


def _padded(source: Path) -> Path:
    """Return a copy of a picture with even sides, as the encoder wants them: the last line is repeated, and later cut
    off."""
    picture = images.read_png(source)
    height, width = picture.shape[:2]
    path = source.with_name(f"padded-{source.name}")
    images.write_png(path, np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), "edge"))
    return path


def _encode(pictures: list[Path], scene: bpy.types.Scene, video: Path, settings: Settings) -> None:
    strip = scene.sequence_editor.strips.new_image("Pictures", str(pictures[0]), 1, 1, fit_method="ORIGINAL")
    for path in pictures[1:]:
        strip.elements.append(path.name)
    strip.frame_final_duration = len(pictures)
    with atomic_path(video) as draft:
        _write_video(scene, draft, settings)
        if not draft.is_file() or not draft.stat().st_size:
            raise RuntimeError(f"Blender wrote no video {draft}; was it built with FFmpeg?")


def _decode(video: Path, scene: bpy.types.Scene, pictures: list[Path], size: tuple[int, int]) -> None:
    """Write the frames of a video as pictures of size (height, width)."""
    scene.sequence_editor.strips.new_movie("Video", str(video), 1, 1, fit_method="ORIGINAL")
    images.set_format(scene.render.image_settings, "PNG")
    scene.render.image_settings.color_mode = "RGB"
    for number, path in enumerate(pictures, 1):
        scene.frame_set(number)
        decoded = draft_of(path.with_name(f"decoded-{path.name}"))
        scene.render.filepath = str(decoded)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        images.write_png(path, images.read_png(decoded)[: size[0], : size[1]])
        decoded.unlink()


def _sequence(width: int, height: int, spec: SceneSpec) -> bpy.types.Scene:
    """Return a scene that shows its strips pixel by pixel, colours untouched."""
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


def _write_video(scene: bpy.types.Scene, path: Path, settings: Settings) -> None:
    images.set_format(scene.render.image_settings, "FFMPEG")
    codec = scene.render.ffmpeg
    codec.format, codec.codec = "MPEG4", "H264"
    codec.constant_rate_factor = settings.quality.upper()
    codec.gopsize = settings.key_frame_every
    codec.audio_codec = "NONE"
    scene.render.filepath = str(path)
    scene.render.use_file_extension = False
    bpy.ops.render.render(animation=True, scene=scene.name)
