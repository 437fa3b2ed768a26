"""A cloud as an Alembic file, by Blender's own exporter.

It writes meshes and no point clouds, so the points go out as a mesh that has vertices alone. With them go their
velocities; other values of points it does not write.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..pure.io.files import atomic_path
from . import compat, gaussian_nodes, point_cloud
from .nodes import Nodes


def write(path: Path, thing: bpy.types.Object, first: int, last: int) -> None:
    """Write what is seen of a cloud from a frame to another, all of it whatever its Share is. Needs Object Mode."""
    with _as_points(thing), _vertices_of(thing) as copy, only_selected(copy), atomic_path(path) as draft:
        bpy.ops.wm.alembic_export(
            filepath=str(draft),
            start=first,
            end=last,
            selected=True,
            evaluation_mode="VIEWPORT",
            as_background_job=False,
            check_existing=False,
        )


@contextmanager
def only_selected(*things: bpy.types.Object) -> Iterator[None]:
    """Select some objects and no others; afterwards the selection is as before."""
    layer = bpy.context.view_layer
    before, active = [thing for thing in layer.objects if thing.select_get()], layer.objects.active
    try:
        for thing in layer.objects:
            thing.select_set(thing in things)
        yield
    finally:
        for thing in layer.objects:
            thing.select_set(thing in before)
        layer.objects.active = active


@contextmanager
def _as_points(thing: bpy.types.Object) -> Iterator[None]:
    settings = point_cloud.inputs(thing)
    before = {name: settings[name] for name in ("Mode", "Share")}
    try:
        settings["Mode"], settings["Share"] = gaussian_nodes.MODES.index("points"), 1.0
        yield
    finally:
        for name, value in before.items():
            settings[name] = value


@contextmanager
def _vertices_of(thing: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """A mesh object with a vertex where the cloud shows a point."""
    tree = bpy.data.node_groups.new("Points of a cloud", "GeometryNodeTree")
    compat.add_socket(tree, "Geometry", "NodeSocketGeometry")
    compat.add_socket(tree, "Geometry", "NodeSocketGeometry", output=True)
    nodes = Nodes(tree)
    points = nodes.add("GeometryNodeObjectInfo", {"Object": thing}).outputs["Geometry"]
    vertices = nodes.add("GeometryNodePointsToVertices", {"Points": points}).outputs[0]
    nodes.add("NodeGroupOutput", {"Geometry": vertices})
    mesh = bpy.data.meshes.new("points")
    copy = bpy.data.objects.new("reconstruction", mesh)
    try:
        bpy.context.scene.collection.objects.link(copy)
        copy.matrix_world = thing.matrix_world
        copy.modifiers.new("points", "NODES").node_group = tree
        yield copy
    finally:
        bpy.data.objects.remove(copy)
        bpy.data.meshes.remove(mesh)
        bpy.data.node_groups.remove(tree)
