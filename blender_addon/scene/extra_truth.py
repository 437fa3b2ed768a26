"""Ground truth beside the velocity, each only if the spec lists it: flame, heat and density grids, flow, OpenVDB.

All of it is at the frames' nominal times, at cell centres, on the coarse grid also where fine noise adds detail.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import bpy
import numpy as np

from ..pure.io import projected_flow, vdb_file
from ..pure.io.velocity_store import VelocityWriter, scalar
from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from . import images, rig, velocity
from .fire import find_domain

QUANTITIES = {"flame": "flame_grid", "heat": "heat_grid", "density": "density_grid"}
"""Names of scalar grids and their attributes in Blender. flame is the reaction, 0 to 1; heat and density are in the
solver's units."""


def grids(spec: SceneSpec, layout: Layout) -> None:
    """Write grids/<quantity>.zarr for the quantities that the bake has."""
    domain = find_domain()
    bpy.context.scene.frame_set(spec.timeline.first_frame)
    matrix = velocity.index_to_world(domain)
    side = float(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
    times = np.arange(spec.clip.frames) / spec.clip.fps
    for name, field in _scalars(domain).items():
        store = VelocityWriter(layout.grid(name), field.shape, matrix, times, side, "float16", scalar(name))
        for frame in range(spec.clip.frames):
            if not store.has_frame(frame):
                bpy.context.scene.frame_set(spec.timeline.blender_frame(frame))
                store.write_frame(frame, _scalars(domain)[name].__getitem__)
        store.finish()


def vdb(spec: SceneSpec, layout: Layout) -> None:
    """Write vdb/<frame>.vdb with velocity in m/s and the scalar grids, placed in the world."""
    domain = find_domain()
    for frame in range(spec.clip.frames):
        if not layout.vdb(frame).is_file():
            bpy.context.scene.frame_set(spec.timeline.blender_frame(frame))
            content = {"velocity": _velocity(domain, spec), **_scalars(domain)}
            vdb_file.write(layout.vdb(frame), content, velocity.index_to_world(domain))


def flow(spec: SceneSpec, layout: Layout, progress) -> None:
    """Write cameras/<camera>/flow/<frame>.exr where flame is visible."""
    domain, cameras = find_domain(), rig.find(spec)
    for frame in range(spec.clip.frames):
        missing = [camera for camera in cameras if not images.opens(layout.flow(camera.name, frame))]
        if missing:
            bpy.context.scene.frame_set(spec.timeline.blender_frame(frame))
            moving, emission = _velocity(domain, spec), _scalars(domain)["flame"] ** 1.3  # as the flame's material
            project = partial(
                projected_flow.flow, emission=emission, velocity=moving, index_to_world=velocity.index_to_world(domain)
            )
        for camera in missing:
            mask = images.read_png(layout.frame(camera.name, frame).mask)[..., 0] > 0
            K, pose = rig.intrinsics(camera, bpy.context.scene), rig.world_to_camera(camera)
            per_second, weight = project(K, pose, mask.shape, mask=mask)
            images.write_flow_exr(layout.flow(camera.name, frame), per_second / spec.clip.fps, weight)
        progress(frame + 1, spec.clip.frames)


def _velocity(domain: bpy.types.Object, spec: SceneSpec) -> np.ndarray:
    """(X, Y, Z, 3) float32 m/s at the current frame."""
    to_world = velocity.SOLVER_UNITS_PER_SECOND * spec.clip.time_scale * velocity.index_to_world(domain)[:3, :3]
    return (velocity.cell_centred(velocity.read_staggered(domain)) @ to_world.T).astype(np.float32)


def _scalars(domain: bpy.types.Object) -> dict[str, np.ndarray]:
    """Scalar grids of the current frame on the coarse grid; those that the bake does not have are left out."""
    return dict(_read_scalars(domain))


def _read_scalars(domain: bpy.types.Object) -> Iterator[tuple[str, np.ndarray]]:
    settings = velocity.evaluated(domain)
    coarse = int(np.prod(settings.domain_resolution))
    for name, attribute in QUANTITIES.items():
        values = getattr(settings, attribute)
        if len(values):
            refine = round((len(values) / coarse) ** (1 / 3))
            fine = np.empty(len(values), np.float32)
            values.foreach_get(fine)
            x, y, z = settings.domain_resolution
            # Blender runs x fastest; blocks of fine noise are averaged.
            blocks = fine.reshape(z, refine, y, refine, x, refine).mean(axis=(1, 3, 5))
            yield name, blocks.transpose(2, 1, 0)
