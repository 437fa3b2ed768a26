"""Cycles frames of the rig: all cameras at one instant before the next instant, resumable frame by frame.

Light adds up. Where nothing absorbs light in front of the surroundings (no smoke), a frame is the fire-free plate plus
what the fire alone adds: its own light and its light on the surroundings. The plate is rendered once, with many
samples; a frame then renders only the fire's part, with the scene's lamps off, which needs far fewer samples for the
same noise.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..layout import FrameFiles, Layout
from ..spec import SceneSpec
from . import effects, images, rig
from .fire import find_domain

FLAME_VISIBLE = 0.02
"""Linear radiance from which a flame counts as visible: just above black on a display."""

Progress = Callable[[int, int], None]


def configure(spec: SceneSpec) -> None:
    """Set up Cycles, its passes and the display transform on the current scene."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.use_persistent_data = True
    scene.render.dither_intensity = 0.0
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.seed = spec.seed
    cycles.samples = spec.render.samples
    cycles.use_adaptive_sampling = False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = (
        spec.render.max_bounces
    )
    cycles.volume_bounces = 0
    cycles.volume_step_rate = spec.render.volume_step_rate
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 10.0
    cycles.use_denoising = spec.render.denoise
    cycles.denoiser = "OPENIMAGEDENOISE"
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    # At these image sizes the accurate prefilter costs more than the paths themselves.
    cycles.denoising_prefilter = "FAST"
    cycles.denoising_quality = "FAST"
    layer = scene.view_layers[0]
    layer.use_pass_z = True
    layer.use_pass_emit = True
    display = spec.display
    view = scene.view_settings
    view.view_transform, view.look = display.view_transform, display.look
    view.exposure, view.gamma = display.exposure, display.gamma


def plates(spec: SceneSpec, layout: Layout) -> None:
    """Render each camera's view without the fire where it is missing: linear (.exr) and for display (.png)."""
    scene, domain = bpy.context.scene, find_domain()
    domain.hide_render = True
    # With persistent data Cycles would keep the plate's number of samples for the frames that follow.
    scene.render.use_persistent_data = False
    scene.cycles.samples = spec.render.plate_samples
    for camera in rig.find(spec):
        png = layout.static(camera.name)
        exr = layout.static_exr(camera.name)
        if images.opens(png) and images.opens(exr):
            continue
        passes = _render(camera, exr)
        images.write_exr(exr, _beauty(passes), passes["Depth.Z"], _flame(passes))
        _write_png(png, _beauty(passes))
    domain.hide_render = False
    scene.cycles.samples = spec.render.samples
    scene.render.use_persistent_data = True


def frames(spec: SceneSpec, layout: Layout, progress: Progress) -> None:
    """Render every frame that is missing or does not open; calls progress(done, total) after each. Needs the plates."""
    cameras = rig.find(spec)
    total = spec.clip.frames * len(cameras)
    plate = {}
    if not any(effects.absorbs_light(settings) for settings in spec.effects):
        plate = {camera.name: images.read_exr(layout.static_exr(camera.name)) for camera in cameras}
        _switch_lamps_off()
    for frame in range(spec.clip.frames):
        for index, camera in enumerate(cameras):
            files = layout.frame(camera.name, frame)
            if not all(map(images.opens, (files.rgb, files.mask, files.exr))):
                _frame(spec, camera, frame, files, plate.get(camera.name))
            progress(frame * len(cameras) + index + 1, total)


def _frame(spec: SceneSpec, camera: bpy.types.Object, frame: int, files: FrameFiles, plate: dict | None) -> None:
    scene = bpy.context.scene
    blender_frame = spec.clip.first_frame + frame
    if scene.frame_current != blender_frame:
        scene.frame_set(blender_frame)
    passes = _render(camera, files.exr)
    beauty, flame = _beauty(passes), _flame(passes)
    if plate is not None:
        beauty[..., :3] += np.stack([plate[channel] for channel in "RGB"], axis=-1)
    _write_png(files.rgb, beauty)
    images.write_mask_png(files.mask, flame.max(axis=-1) > FLAME_VISIBLE)
    images.write_exr(files.exr, beauty, passes["Depth.Z"], flame)


def _switch_lamps_off() -> None:
    """Leave the fire as the only light, for this process; scene.blend is not saved again."""
    scene = bpy.context.scene
    scene.world = None
    for thing in scene.objects:
        if thing.type == "LIGHT":
            thing.hide_render = True


def _render(camera: bpy.types.Object, beside: Path) -> dict[str, np.ndarray]:
    """Render one camera; returns its passes. Blender hands passes out only through a file, kept beside the result."""
    scene = bpy.context.scene
    draft = images.temporary(beside.with_suffix(".passes.exr"))
    settings = scene.render.image_settings
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"
    scene.camera = camera
    scene.render.filepath = str(draft)
    bpy.ops.render.render(write_still=True)
    passes = images.read_exr(draft)
    draft.unlink()
    return {name.split(".", 1)[1]: channel for name, channel in passes.items()}  # without the view layer's name


def _beauty(passes: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([passes[f"Combined.{channel}"] for channel in "RGBA"], axis=-1)


def _flame(passes: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([passes[f"Emit.{channel}"] for channel in "RGB"], axis=-1)


def _write_png(path: Path, beauty: np.ndarray) -> None:
    """Write linear (H, W, 4) light as display sRGB through the scene's view transform, atomically."""
    scene = bpy.context.scene
    settings = scene.render.image_settings
    settings.file_format = "PNG"
    settings.color_mode = "RGB"
    settings.color_depth = "8"
    settings.compression = 15
    height, width = beauty.shape[:2]
    image = bpy.data.images.new("Frame", width, height, alpha=False, float_buffer=True)
    image.pixels.foreach_set(np.ascontiguousarray(beauty[::-1], dtype=np.float32).ravel())
    draft = images.temporary(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save_render(str(draft), scene=scene)
    bpy.data.images.remove(image)
    os.replace(draft, path)
