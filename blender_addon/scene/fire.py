"""The simulated fire: gas domain, emitter and the bake."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..pure.spec import SceneSpec
from . import compat, effects, mantaflow, material, meshes
from .fire_objects import FLAME_NAME, FireObjects


def build(spec: SceneSpec, collection: bpy.types.Collection) -> FireObjects:
    """Add domain and emitter to a collection and apply the effects of the spec; nothing is simulated yet."""
    domain = _domain(spec, collection)
    emitter = _emitter(spec, collection)
    look = _look(spec)
    domain.data.materials.append(look)
    fire = FireObjects(domain, emitter, look)
    for settings in spec.effects:
        effects.apply(fire, settings, spec)
    return fire


def _look(spec: SceneSpec) -> bpy.types.Material:
    if not spec.fire.dims:
        return material.flame(spec.fuel, spec.fire.intensity)
    middle = spec.domain.min[2] + spec.domain.size[2] / 2  # where the domain's own axes begin
    return material.soot_flame(spec.fire.sheet, spec.fire.burner.bottom - middle)


def keep_for_dataset(settings: bpy.types.FluidDomainSettings) -> None:
    """Bake all at once, into the dataset's own cache folder."""
    settings.cache_type = "ALL"
    settings.cache_directory = "//.cache/bake"  # of Layout.bake
    settings.cache_resumable = True  # a later change of it would empty the cache


def bake(domain: bpy.types.Object, needed: range, after: int = 0) -> None:
    """Simulate all frames of the domain's cache range, resumable.

    One bake per process: a second one in the same process is unreliable in Blender.

    Args:
        needed: frames that must be there in the end.
        after: frame whose state is in the cache already, 0: begin with the first.
    Raises:
        RuntimeError: a frame is missing.
    """
    settings = domain.modifiers["Fluid"].domain_settings
    settings.cache_frame_pause_data = after + 1 if after else 0
    with bpy.context.temp_override(object=domain, active_object=domain, scene=bpy.context.scene):
        bpy.ops.fluid.bake_all()
    missing = [frame for frame in needed if not velocity_file(settings, frame).is_file()]
    if missing or not settings.has_cache_baked_data:
        raise RuntimeError(
            f"the fluid bake stopped before frame {missing[0] if missing else '?'}; its messages are in the log"
        )


def velocity_file(settings: bpy.types.FluidDomainSettings, frame: int) -> Path:
    """Cache file that a frame's solver step has written last."""
    return Path(bpy.path.abspath(settings.cache_directory)) / "data" / f"vel_{frame:04d}.uni"


def _domain(spec: SceneSpec, collection: bpy.types.Collection) -> bpy.types.Object:
    centre = [low + side / 2 for low, side in zip(spec.domain.min, spec.domain.size, strict=True)]
    domain = meshes.box(FLAME_NAME, spec.domain.size, collection, location=centre)
    domain.display_type = "WIRE"
    modifier = domain.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "DOMAIN"
    settings = modifier.domain_settings
    settings.domain_type = "GAS"
    settings.resolution_max = spec.domain.resolution
    settings.time_scale = spec.clip.time_scale
    # One solver step per frame: the velocity stored at frame k is then exactly the one that carries k to k + 1.
    settings.use_adaptive_timesteps = False
    settings.use_adaptive_domain = False
    # The VDB cache stores velocity only where there is smoke; UNI stores every cell.
    settings.cache_data_format = "UNI"
    settings.cache_frame_start = 1
    settings.cache_frame_end = spec.timeline.last_frame
    settings.burning_rate = spec.solver.burning_rate
    settings.flame_max_temp = spec.fuel.max_temperature
    settings.beta = spec.fuel.buoyancy
    settings.effector_weights.gravity = spec.solver.gravity
    settings.alpha = 0.0
    # Effects switch these on.
    settings.flame_smoke = 0.0
    settings.vorticity = 0.0
    settings.flame_vorticity = 0.0
    return domain


def _emitter(spec: SceneSpec, collection: bpy.types.Collection) -> bpy.types.Object:
    if spec.fire.shape == "logs":
        emitter = meshes.crossed_logs(
            "Fire Burner", spec.fire.radius, collection, spec.fire.logs, location=spec.fire.position
        )
    else:
        emitter = meshes.ellipsoid("Fire Burner", spec.fire.half_size, collection, location=spec.fire.position)
    emitter.hide_render = True
    modifier = emitter.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "FLOW"
    flow = modifier.flow_settings
    flow.flow_type = "FIRE"
    flow.flow_behavior = "INFLOW"
    flow.fuel_amount = spec.solver.amount
    flow.surface_distance = 1.0
    if spec.fire.jet_speed:
        flow.use_initial_velocity = True
        flow.velocity_coord = (0.0, 0.0, spec.fire.jet_speed)
    # Uneven fuel, drifting upwards: without it a round burner gives a mirror-symmetric flame.
    texture = bpy.data.textures.new("Fuel Noise", "CLOUDS")
    texture.noise_scale = 0.5
    texture.contrast = 1.5
    flow.use_texture = True
    flow.noise_texture = texture
    flow.texture_map_type = "AUTO"
    flow.texture_size = 1.0
    offset = np.random.default_rng(spec.seed).uniform(0.0, 100.0)
    # A key at every step: what Blender makes of two keys depends, in its last bit, on how far apart they are, and so
    # the fire would depend on the clip's length. Specs of version 1 keep theirs.
    last = spec.timeline.last_frame
    for frame in (1, last) if spec.fire.speeds == "solver" else range(1, last + 1):
        flow.texture_offset = offset + 4.0 * spec.solver.drift * spec.timeline.solver_step_s * (frame - 1)
        emitter.keyframe_insert(f'modifiers["{modifier.name}"].flow_settings.texture_offset', frame=frame)
    for curve in compat.curves(emitter):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    mantaflow.wait_for_keys(emitter)
    return emitter
