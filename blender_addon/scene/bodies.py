"""The surfaces of a scene's objects as renders show them, where they may reach into a fire's domain."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..pure import bodies
from ..pure.spec import SceneSpec
from . import point_cloud
from .backgrounds import blend_file

SOLID = {"MESH", "CURVE", "SURFACE", "FONT", "META"}


def notes(spec: SceneSpec, graph: bpy.types.Depsgraph, objects: set[bpy.types.Object], to_ours: Matrix) -> list[str]:
    """Return notes for the maker of a scene on its objects in the domain (`pure.bodies`).

    Args:
        graph: evaluated, of the scene that has the objects; also has the objects that instance them.
        objects: that become surroundings.
        to_ours: the scene's world to the spec's.
    """
    found = defaultdict(list)
    for owner, shown, pose in _near(spec, graph, objects, to_ours):
        found[owner].append(_triangles(shown, pose))
    return bodies.notes(
        spec,
        [
            bodies.Body(owner.name, np.concatenate(parts), blend_file.is_obstacle(owner))
            for owner, parts in sorted(found.items(), key=lambda item: item[0].name)
        ],
    )


def signature(spec: SceneSpec, graph: bpy.types.Depsgraph, objects: set[bpy.types.Object], to_ours: Matrix) -> tuple:
    """Return the state that `notes` depend on, without shapes inside the boxes around objects: quick, for panels."""
    near = [
        (owner.name, blend_file.is_obstacle(owner), *map(tuple, shown.bound_box), *map(tuple, pose))
        for owner, shown, pose in _near(spec, graph, objects, to_ours)
    ]
    return (spec.domain, spec.fire, *near)


def _near(
    spec: SceneSpec, graph: bpy.types.Depsgraph, objects: set[bpy.types.Object], to_ours: Matrix
) -> Iterator[tuple[bpy.types.Object, bpy.types.Object, Matrix]]:
    """Solid things whose box meets the domain: what lists call it, what is shown, and its pose in our world."""
    if spec.domain is None:
        return
    low, high = bodies.air(spec)
    for instance in graph.object_instances:
        shown, owner = instance.object, (instance.parent or instance.object).original
        hidden = shown.original.hide_render or not instance.show_self
        reconstruction = point_cloud.inputs(owner) is not None
        if owner not in objects or shown.type not in SOLID or hidden or reconstruction:
            continue
        pose = to_ours @ instance.matrix_world
        corners = np.array([pose @ Vector(corner) for corner in shown.bound_box])
        if (corners.max(0) >= low).all() and (corners.min(0) <= high).all():
            yield owner, shown, pose


def _triangles(object_: bpy.types.Object, pose: Matrix) -> np.ndarray:
    """Return (T, 3, 3) of an evaluated object."""
    mesh = object_.to_mesh()
    mesh.calc_loop_triangles()
    places = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", places.ravel())
    corners = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("vertices", corners.ravel())
    object_.to_mesh_clear()
    matrix = np.array(pose)
    return (places @ matrix[:3, :3].T + matrix[:3, 3])[corners]
