"""Cycles frames of the rig: all cameras at one instant before the next instant, resumable frame by frame."""
from __future__ import annotations

import os
from collections.abc import Callable

import bpy
import numpy as np

from ..layout import Layout
from ..spec import SceneSpec
from . import images, rig
from .fire import find_domain

PLATE_SAMPLES = 4  # times the samples of a frame
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
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = spec.render.max_bounces
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


def plates(spec: SceneSpec, layout: Layout, progress: Progress) -> None:
    """Render each camera's view without the fire, where it is missing."""
    scene, domain = bpy.context.scene, find_domain()
    missing = [camera for camera in rig.find(spec) if not images.opens(layout.static(camera.name))]
    domain.hide_render = True
    scene.cycles.samples = PLATE_SAMPLES * spec.render.samples
    for camera in missing:
        path = layout.static(camera.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        scene.camera = camera
        bpy.ops.render.render()
        _save_png(path)
    domain.hide_render = False
    scene.cycles.samples = spec.render.samples


def frames(spec: SceneSpec, layout: Layout, progress: Progress) -> None:
    """Render every frame that is missing or does not open; calls progress(done, total) after each."""
    cameras = rig.find(spec)
    total = spec.clip.frames * len(cameras)
    for frame in range(spec.clip.frames):
        for index, camera in enumerate(cameras):
            files = layout.frame(camera.name, frame)
            if not all(map(images.opens, (files.rgb, files.mask, files.exr))):
                _frame(spec, camera, frame, files)
            progress(frame * len(cameras) + index + 1, total)


def _frame(spec: SceneSpec, camera: bpy.types.Object, frame: int, files) -> None:
    scene = bpy.context.scene
    blender_frame = spec.clip.first_frame + frame
    if scene.frame_current != blender_frame:
        scene.frame_set(blender_frame)
    scene.camera = camera
    for path in (files.rgb, files.mask, files.exr):
        path.parent.mkdir(parents=True, exist_ok=True)
    passes_file = images.temporary(files.exr.with_suffix(".passes.exr"))
    settings = scene.render.image_settings
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"
    scene.render.filepath = str(passes_file)
    bpy.ops.render.render(write_still=True)
    _save_png(files.rgb)
    passes = images.read_passes(passes_file)
    passes_file.unlink()
    flame = np.stack([passes[f"Emit.{channel}"] for channel in "RGB"], axis=-1)
    beauty = np.stack([passes[f"Combined.{channel}"] for channel in "RGBA"], axis=-1)
    images.write_mask_png(files.mask, flame.max(axis=-1) > FLAME_VISIBLE)
    images.write_frame_exr(files.exr, beauty, passes["Depth.Z"], flame)


def _save_png(path) -> None:
    """Save the last render as display sRGB through the scene's view transform, atomically."""
    scene = bpy.context.scene
    settings = scene.render.image_settings
    settings.file_format = "PNG"
    settings.color_mode = "RGB"
    settings.color_depth = "8"
    settings.compression = 15
    draft = images.temporary(path)
    bpy.data.images["Render Result"].save_render(str(draft), scene=scene)
    os.replace(draft, path)
