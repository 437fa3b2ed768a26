"""Cycles frames of the rig: all cameras at one instant before the next instant, resumable frame by frame.

Light adds up. Without smoke a frame is the fire-free plate, as far as it is seen through the flame, plus what the fire
alone adds: its own light and its light on the surroundings. The plate is rendered once, with many samples; a frame then
renders only the fire's part, with the scene's lamps off, which needs far fewer samples for the same noise, and how much
of the plate a flame of soot covers. (That the flame dims the lamps, too, on their way to the surroundings, is left
out.) With smoke, which scatters the lamps' light, frames are rendered whole. Where a picture sees more than one solver
step (motion blur, rolling shutter, camera clocks), each step is rendered for the lines that see it, and the picture is
their weighted sum in linear light.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import bpy
import numpy as np

from ..core.checked_json import SpecError
from ..core.drafts import draft_of
from ..core.files import atomic_path, read_json, write_json
from ..pure.brightness import Brightness
from ..pure.effects import absorbs_light, encodes, expose, gain, meters, shows_board
from ..pure.layout import Layout
from ..pure.rig import AROUND
from ..pure.spec import SceneSpec
from . import effects, images, rig, view
from .fire_objects import find_flame

FLAME_VISIBLE = 0.02
"""Linear radiance from which a flame counts as visible: just above black on a display."""

AROUND_SHARE = 4
"""One sample of that many: on the demo 42 dB instead of 46, by 256 samples, for a quarter of the price."""

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
    if hasattr(cycles, "volume_biased"):  # Blender 5.0 on: march in steps, as before
        cycles.volume_biased = True
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 10.0
    cycles.use_denoising = spec.render.denoise
    if spec.render.denoise:
        _set_up_denoiser(cycles)
    layer = scene.view_layers[0]
    layer.use_pass_z = True
    layer.use_pass_emit = True
    view.apply(spec.display, scene)


def can_denoise() -> bool:
    """Return whether this Blender was built with Open Image Denoise; those of some Linux distributions are not."""
    import _cycles

    return _cycles.with_openimagedenoise


def _set_up_denoiser(cycles) -> None:
    if not can_denoise():
        raise SpecError("render.denoise must be false: this Blender was built without Open Image Denoise")
    cycles.denoiser = "OPENIMAGEDENOISE"
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    # At these image sizes the accurate prefilter costs more than the paths themselves.
    cycles.denoising_prefilter = "FAST"
    if hasattr(cycles, "denoising_quality"):  # since Blender 4.2
        cycles.denoising_quality = "FAST"


def plates(spec: SceneSpec, layout: Layout, progress: Progress = lambda done, total: None) -> None:
    """Render each camera's view without the fire where it is missing: linear (.exr) and for display (.png). Write the
    masks of a sync board, if the spec has one. Calls progress(done, total) after each camera."""
    if any(map(shows_board, spec.effects)):
        _write_board_masks(spec, layout)
    scene, flame = bpy.context.scene, find_flame()
    missing = [
        (index, camera)
        for index, camera in enumerate(rig.find(spec))
        if not (images.opens(layout.static(camera.name)) and images.opens(layout.static_exr(camera.name)))
    ]
    if not missing:
        return
    factor = metered(spec, layout)
    flame.hide_render = True
    # With persistent data Cycles would keep the plate's number of samples for the frames that follow.
    scene.render.use_persistent_data = False
    for index, camera in missing:
        scene.cycles.samples = plate_samples(spec, camera.name)
        passes = _render(camera, layout.static_exr(camera.name))
        beauty = _beauty(passes)
        _write_png(layout.static(camera.name), seen(beauty[..., :3], spec, index, -1, factor))
        # The fire is alone in the flame pass: lamps and screens of a user's scene are not part of it.
        images.write_exr(layout.static_exr(camera.name), beauty, passes["Depth.Z"], np.zeros_like(beauty[..., :3]))
        progress(len(spec.cameras.names) - len(missing) + missing.index((index, camera)) + 1, len(spec.cameras.names))
    flame.hide_render = False
    scene.cycles.samples = spec.render.samples
    scene.render.use_persistent_data = True


def plate_samples(spec: SceneSpec, camera: str) -> int:
    """Return the samples of a camera's plate.

    Those around have a plate each for one or two pictures, which would cost more than all of their flames; truth and
    result are compared over the same plate, so that its noise is in no score.
    """
    return -(-spec.render.plate_samples // AROUND_SHARE) if camera in AROUND else spec.render.plate_samples


def _write_board_masks(spec: SceneSpec, layout: Layout) -> None:
    for index, path in enumerate(map(layout.board_mask, spec.cameras.names)):
        if not images.opens(path):
            images.write_png(path, np.rint(255 * effects.board_mask(spec, index)).astype(np.uint8)[..., None])


class FrameRenderer:
    """Renders frames of the open scene; afterwards the scene is no longer fit for anything else.

    Needs the plates, which carry the depth: fire has none.
    """

    def __init__(self, spec: SceneSpec, layout: Layout):
        configure(spec)  # the spec's word counts, whatever scene.blend was saved with
        self._spec, self._layout, self._cameras = spec, layout, rig.find(spec)
        self._plate = {camera.name: images.read_exr(layout.static_exr(camera.name)) for camera in self._cameras}
        self._adds_light = not any(map(absorbs_light, spec.effects))
        if self._adds_light:
            _leave_only_the_fire()
        self._covers = self._adds_light and spec.fire.dims
        if self._covers:
            _add_cover_layer()
        self._gain = metered(spec, layout)
        # A picture of many instants needs fewer paths for each.
        _, weights = spec.timeline.weights(0, 0)
        bpy.context.scene.cycles.samples = max(1, round(spec.render.samples * float(weights.max())))

    def is_finished(self, frame: int, camera: int) -> bool:
        files = self._layout.frame(self._cameras[camera].name, frame)
        return all(map(images.opens, (self._display_picture(frame, camera), files.mask, files.exr)))

    def __call__(self, frame: int, camera: int) -> None:
        """Render one picture of a dataset frame, unless it is there and can be decoded."""
        if self.is_finished(frame, camera):
            return
        name = self._cameras[camera].name
        files, plate = self._layout.frame(name, frame), self._plate[name]
        beauty, flame, cover = self._light(frame, camera)
        if self._adds_light:
            beauty[..., :3] += (1 - cover) * np.stack([plate[channel] for channel in "RGB"], axis=-1)
        shown = seen(beauty[..., :3], self._spec, camera, frame, self._gain)
        _write_png(self._display_picture(frame, camera), shown)
        mask = flame.max(axis=-1) > FLAME_VISIBLE
        images.write_mask_png(files.mask, mask)
        if not self._layout.brightness.is_file():
            Brightness.of(images.read_png(self._display_picture(frame, camera)), mask).write(self._layout.brightness)
        images.write_exr(files.exr, beauty, plate["Z"], flame)

    def _display_picture(self, frame: int, camera: int) -> Path:
        name = self._cameras[camera].name
        encoded = any(map(encodes, self._spec.effects)) and name not in AROUND  # a few single pictures are no video
        return self._layout.uncompressed(name, frame) if encoded else self._layout.frame(name, frame).rgb

    def _light(self, frame: int, camera: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Beauty (H, W, 4), flame (H, W, 3) and its cover (H, W, 1): each line the weighted sum of the solver steps
        that it sees."""
        first, weights = self._spec.timeline.weights(camera, frame)
        beside = self._layout.frame(self._cameras[camera].name, frame).exr
        total_beauty = total_flame = total_cover = 0.0
        for step, weight in enumerate(weights):
            _go_to(self._spec.timeline.blender_frame(frame) + first + step)
            if len(weights) == 1:
                return self._seen_now(camera, beside)
            _render_only(np.nonzero(weight)[0], len(weight), self._spec)
            beauty, flame, cover = self._seen_now(camera, beside)
            share = rig.as_picture(weight, self._spec).astype(np.float32)
            total_beauty = total_beauty + share * beauty
            total_flame = total_flame + share * flame
            total_cover = total_cover + share * cover
        return total_beauty, total_flame, total_cover

    def _seen_now(self, camera: int, beside: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Beauty, flame and cover of the current step."""
        passes = _render(self._cameras[camera], beside)
        cover = passes[COVER_ALPHA] if self._covers else np.zeros_like(passes["Depth.Z"])
        beauty = _beauty(passes)
        beauty[..., 3] = 1.0  # the cover's layer makes what is nowhere transparent, in all layers
        return beauty, _flame(passes), cover[..., None]


def frames(spec: SceneSpec, layout: Layout, progress: Progress) -> None:
    """Render every frame that is missing or does not open; calls progress(done, total) after each. Needs the plates."""
    render = FrameRenderer(spec, layout)
    for done, (frame, camera) in enumerate(spec.pictures, 1):
        render(frame, camera)
        progress(done, len(spec.pictures))


def seen(light: np.ndarray, spec: SceneSpec, camera: int, frame: int, factor: float) -> np.ndarray:
    """Turn rendered light into what the sensor reports: what is drawn over it first, then the exposure, then the
    sensor."""
    light = effects.overlay(light, spec, camera, frame)
    light = light if factor == 1.0 else factor * light
    return expose(light, spec.effects, spec.timeline.picture(camera, frame))


def metered(spec: SceneSpec, layout: Layout) -> float:
    """Return the factor on the light of all pictures that an effect takes from the first one's flame; 1 without one."""
    if not any(map(meters, spec.effects)):
        return 1.0
    if not layout.gain.is_file():
        _go_to(spec.timeline.first_frame)
        flame = _flame(_render(rig.find(spec)[0], layout.gain))
        write_json(layout.gain, {"gain": gain(spec.effects, flame[flame.max(axis=-1) > 0.01 * FLAME_VISIBLE])})
    return read_json(layout.gain)["gain"]


def _go_to(blender_frame: int) -> None:
    scene = bpy.context.scene
    if scene.frame_current != blender_frame:
        scene.frame_set(blender_frame)


MARGIN = 8  # pixels that the denoiser needs beside the lines that are wanted


def _render_only(lines: np.ndarray, count: int, spec: SceneSpec) -> None:
    """Restrict rendering to the lines with these numbers, of `count` in reading order."""
    settings = bpy.context.scene.render
    low, high = max(int(lines[0]) - MARGIN, 0) / count, min(int(lines[-1]) + 1 + MARGIN, count) / count
    direction = rig.READOUT[spec.cameras.roll_deg]
    if direction in ("left", "down"):  # against Blender's axes, which run right and up
        low, high = 1 - high, 1 - low
    settings.use_border, settings.use_crop_to_border = True, False
    settings.border_min_x, settings.border_max_x, settings.border_min_y, settings.border_max_y = (
        (low, high, 0.0, 1.0) if direction in ("left", "right") else (0.0, 1.0, low, high)
    )


def _leave_only_the_fire() -> None:
    """Leave the fire as the only light, for this process; scene.blend is not saved again."""
    scene = bpy.context.scene
    scene.world = None
    for object_ in scene.objects:
        if object_.type == "LIGHT":
            object_.hide_render = True
    fire = find_flame().active_material
    for item in bpy.data.materials:
        if item != fire and item.node_tree:
            _switch_emission_off(item.node_tree)
    for group in bpy.data.node_groups:
        _switch_emission_off(group)


COVER = "Cover"
COVER_ALPHA = f"{COVER}.Combined.A"


def _add_cover_layer() -> None:
    """Add a view layer whose alpha is the share of what is behind the flame that the flame covers.

    All but the flame is held out in it. Light that is only absorbed is the same along all of a pixel's paths, so one
    path is enough and nothing has to be denoised. A second picture with other settings would not do: with persistent
    data Cycles sometimes keeps the number of samples of the one before.
    """
    scene, flame = bpy.context.scene, find_flame()
    alone = bpy.data.collections.new(COVER)
    scene.collection.children.link(alone)
    for collection in flame.users_collection:
        collection.objects.unlink(flame)
    alone.objects.link(flame)
    layer = scene.view_layers.new(COVER)
    layer.samples = 1
    layer.use_pass_z = False
    layer.cycles.use_denoising = False
    _hold_out([child for child in layer.layer_collection.children if child.collection != alone])
    scene.render.film_transparent = True


def _hold_out(collections: Iterable[bpy.types.LayerCollection]) -> None:
    for collection in collections:
        collection.holdout = True
        _hold_out(collection.children)


def _switch_emission_off(tree: bpy.types.NodeTree) -> None:
    for node in tree.nodes:
        name = {"EMISSION": "Strength", "BSDF_PRINCIPLED": "Emission Strength"}.get(node.type)
        if name:
            for link in list(node.inputs[name].links):
                tree.links.remove(link)
            node.inputs[name].default_value = 0.0


def _render(camera: bpy.types.Object, beside: Path) -> dict[str, np.ndarray]:
    """Render one camera; returns its passes, those of the cover's layer with `COVER` before their names.

    Blender hands passes out only through a file, kept beside the result.
    """
    scene = bpy.context.scene
    draft = draft_of(beside.with_suffix(".passes.exr"))
    settings = scene.render.image_settings
    images.set_format(settings, "OPEN_EXR_MULTILAYER")
    settings.color_depth = "32"
    settings.exr_codec = "NONE"
    scene.camera = camera
    scene.render.filepath = str(draft)
    bpy.ops.render.render(write_still=True)
    passes = images.read_exr(draft)
    draft.unlink()
    first = f"{scene.view_layers[0].name}."
    return {name.removeprefix(first): channel for name, channel in passes.items()}


def _beauty(passes: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([passes[f"Combined.{channel}"] for channel in "RGBA"], axis=-1)


def _flame(passes: dict[str, np.ndarray]) -> np.ndarray:
    name = "Emit" if "Emit.R" in passes else "Emission"  # from Blender 5.0 on
    return np.stack([passes[f"{name}.{channel}"] for channel in "RGB"], axis=-1)


def _write_png(path: Path, light: np.ndarray) -> None:
    """Write linear (H, W, 3) light as display sRGB through the scene's view transform, atomically."""
    scene = bpy.context.scene
    settings = scene.render.image_settings
    images.set_format(settings, "PNG")
    settings.color_mode = "RGB"
    settings.color_depth = "8"
    settings.compression = 15
    height, width = light.shape[:2]
    opaque = np.dstack([light, np.ones((height, width))])
    image = bpy.data.images.new("Frame", width, height, alpha=False, float_buffer=True)
    image.pixels.foreach_set(np.ascontiguousarray(opaque[::-1], dtype=np.float32).ravel())
    with atomic_path(path) as draft:
        image.save_render(str(draft), scene=scene)
    bpy.data.images.remove(image)
