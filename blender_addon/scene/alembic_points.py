"""A cloud as an Alembic file, by Blender's own exporter.

It writes meshes and no point clouds, so the points go out as a mesh that has vertices alone. With them go their
velocities; other values of points it does not write.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from . import compat, exchange, gaussian_nodes, point_cloud
from .nodes import Nodes


def write(path: Path, thing: bpy.types.Object, first: int, last: int) -> None:
    """Write what is seen of a cloud from a frame to another, all of it whatever its Share is.

    Raises DataFormatError: this Blender was built without Alembic.
    """
    with _as_points(thing), _vertices_of(thing) as copy:
        exchange.write([copy], path, first, last)


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
    """Provide a mesh object with a vertex where the cloud shows a point."""
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
