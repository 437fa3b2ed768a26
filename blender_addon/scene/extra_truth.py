"""Ground truth beside the velocity, each only if the spec lists it: scalar grids, flow, OpenVDB.

All of it is at the frames' nominal times, at cell centres.
"""

from __future__ import annotations

from functools import partial

import bpy
import numpy as np

from ..core.grid_writer import GridWriter
from ..pure.effects import wind
from ..pure.io import projected_flow, vdb_file
from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from . import images, rig
from .flame_source import FlameSource


def grids(spec: SceneSpec, layout: Layout, source: FlameSource) -> None:
    """Write grids/<quantity>.zarr for the quantities that the flame's source knows."""
    matrix = source.index_to_world
    side = float(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
    times = np.arange(spec.clip.frames) / spec.clip.fps
    for name, field in source.scalars(spec.timeline.first_frame).items():
        content = source.contents[name]
        store = GridWriter(layout.grid(name), field.shape, matrix, times, side, source.dtype, content)
        for frame in range(spec.clip.frames):
            if not store.has_frame(frame):
                store.write_frame(frame, source.scalars(spec.timeline.blender_frame(frame))[name].__getitem__)
        store.finish()


def vdb(spec: SceneSpec, layout: Layout, source: FlameSource) -> None:
    """Write vdb/<frame>.vdb with velocity in m/s and the scalar grids, placed in the world."""
    for frame in range(spec.clip.frames):
        if not layout.vdb(frame).is_file():
            step = spec.timeline.blender_frame(frame)
            matrix = source.index_to_world
            vdb_file.write(layout.vdb(frame), {"velocity": source.velocity(step), **source.scalars(step)}, matrix)


def flow(spec: SceneSpec, layout: Layout, source: FlameSource, progress) -> None:
    """Write cameras/<camera>/flow/<frame>.exr where flame is visible."""
    cameras = rig.find(spec)
    for frame in range(spec.clip.frames):
        seen_by = [cameras[c] for k, c in spec.pictures if k == frame]
        missing = [camera for camera in seen_by if not images.opens(layout.flow(camera.name, frame))]
        if missing:
            step = spec.timeline.blender_frame(frame)
            project = partial(
                projected_flow.flow,
                index_to_world=source.index_to_world,
                emission=source.light(step),
                velocity=source.velocity(step),
            )
        for camera in missing:
            mask = images.read_png(layout.frame(camera.name, frame).mask)[..., 0] > 0
            K, pose = rig.intrinsics(camera, bpy.context.scene), rig.world_to_camera(camera)
            per_second, weight = project(K, pose, mask.shape, mask=mask)
            images.write_flow_exr(layout.flow(camera.name, frame), per_second / spec.clip.fps, weight)
        progress(frame + 1, spec.clip.frames)


# ----------------------------------------------------------------
# Whether the domain cuts the flame off, and whether the gas is as fast as gas can be, measured once it is simulated.

LOOKED_AT = 4  # frames of the clip
GRAVITY = 9.81  # m/s2
HOTTEST = 7.0  # air's density over that of flame gas, at some 2050 K
SIDES = {"top": (2, -1), "-x side": (0, 0), "+x side": (0, -1), "-y side": (1, 0), "+y side": (1, -1)}
"""Axis and end. Not the bottom: burners stand there."""


def cut_off(spec: SceneSpec, source: FlameSource) -> dict[str, float]:
    """Light in the outermost layer of cells over that of the flame's widest section along the axis, per side; the
    largest of some frames. 0 without a flame."""
    frames = sorted({round(k) for k in np.linspace(0, spec.clip.frames - 1, LOOKED_AT)})
    shares = {side: 0.0 for side in SIDES}
    for frame in frames:
        light = source.light(spec.timeline.blender_frame(frame)).astype(np.float64)
        for side, (axis, end) in SIDES.items():
            sections = light.sum(axis=tuple(other for other in range(3) if other != axis))
            if sections.max() > 0:
                shares[side] = max(shares[side], float(sections[end] / sections.max()))
    return {side: round(share, 4) for side, share in shares.items()}


def speeds(spec: SceneSpec, source: FlameSource) -> dict[str, float | None]:
    """Return how fast the gas is, and the most that heat, jet and wind can make of it, m/s; a solver that runs away
    grows, so the clip's last frame is looked at, and the speed that a thousandth of its cells exceeds.

    Gas that is HOTTEST times lighter than air and rises through the whole domain has sqrt(2 g (HOTTEST - 1) height).
    The most is None where nothing is known: constants of a solver that are no physics, wind in units of a field.
    """
    velocity = source.velocity(spec.timeline.blender_frame(spec.clip.frames - 1))
    fastest = float(np.quantile(np.linalg.norm(velocity, axis=-1), 0.999))
    height = velocity.shape[2] * float(np.linalg.norm(source.index_to_world[:3, 2]))
    most = np.sqrt(2 * GRAVITY * (HOTTEST - 1) * height) + getattr(spec.fire, "jet_speed", 0.0)
    for effect in spec.effects:
        most += effect.strength if isinstance(effect, wind.Settings) else 0.0
    unknown = getattr(spec.fire, "speeds", "") == "solver" or any(
        isinstance(effect, wind.Settings) and effect.unit == "field" for effect in spec.effects
    )
    return {"fastest_m_s": round(fastest, 2), "most_m_s": None if unknown else round(float(most), 2)}
