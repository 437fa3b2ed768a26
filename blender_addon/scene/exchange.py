"""Objects to Alembic and USD files and back, by Blender's own exporters and importers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..core.errors import DataFormatError
from ..core.files import atomic_path
from . import compat, gaussian_nodes, point_cloud
from .nodes import Nodes

ALEMBIC, USD = (".abc",), (".usd", ".usdc", ".usda")


def write(objects: list[bpy.types.Object], path: Path, first: int, last: int) -> None:
    """Write objects and nothing else, atomically; of a single frame it must be the scene's current one.

    Every frame is evaluated, and so is what else is in the scene: a fire burns up to there.

    Args:
        first, last: frames; of USD several are the scene's range.
    Raises:
        DataFormatError: this Blender was built without the format, as Debian's is.
    """
    _require(path)
    with _only_selected(objects), atomic_path(path) as draft:
        if path.suffix.lower() in ALEMBIC:
            bpy.ops.wm.alembic_export(
                filepath=str(draft),
                start=first,
                end=last,
                selected=True,
                evaluation_mode="VIEWPORT",
                as_background_job=False,
                check_existing=False,
            )
        else:
            sky = {"convert_world_material": False}  # 4.2 and later would write the scene's, too
            known = bpy.ops.wm.usd_export.get_rna_type().properties
            bpy.ops.wm.usd_export(
                filepath=str(draft),
                selected_objects_only=True,
                export_animation=last > first,
                check_existing=False,
                **{name: value for name, value in sky.items() if name in known},
            )


@contextmanager
def read(path: Path) -> Iterator[list[bpy.types.Object]]:
    """Provide the objects of a file, in the scene until the block ends.

    Raises DataFormatError: no such file, it cannot be read, or this Blender was built without the format.
    """
    _require(path)
    if not path.is_file():
        raise DataFormatError(f"{path}: no such file")
    before = set(bpy.data.objects)
    try:
        if path.suffix.lower() in ALEMBIC:
            bpy.ops.wm.alembic_import(filepath=str(path), set_frame_range=False, as_background_job=False)
        else:
            bpy.ops.wm.usd_import(filepath=str(path), set_frame_range=False)
        bpy.context.view_layer.update()
        yield sorted(set(bpy.data.objects) - before, key=lambda object_: object_.name)
    except RuntimeError as error:
        raise DataFormatError(f"{path}: {error}") from None
    finally:
        for object_ in set(bpy.data.objects) - before:
            bpy.data.objects.remove(object_)


def _require(path: Path) -> None:
    name, built = ("Alembic", "alembic") if path.suffix.lower() in ALEMBIC else ("USD", "usd")
    if not getattr(bpy.app.build_options, built, False):
        raise DataFormatError(f"this Blender was built without {name}: use the one of blender.org")


@contextmanager
def _only_selected(objects: list[bpy.types.Object]) -> Iterator[None]:
    """Select some objects and no others; afterwards the selection is as before."""
    layer = bpy.context.view_layer
    before, active = [object_ for object_ in layer.objects if object_.select_get()], layer.objects.active
    try:
        for object_ in layer.objects:
            object_.select_set(object_ in objects)
        yield
    finally:
        for object_ in layer.objects:
            object_.select_set(object_ in before)
        layer.objects.active = active


# ----------------------------------------------------------------
# A point cloud as Alembic points.


def write_points(path: Path, object_: bpy.types.Object, first: int, last: int) -> None:
    """Write what is seen of a cloud from a frame to another, all of it whatever its Share is.

    Raises DataFormatError: this Blender was built without Alembic.
    """
    with _as_points(object_), _vertices_of(object_) as copy:
        write([copy], path, first, last)


@contextmanager
def _as_points(object_: bpy.types.Object) -> Iterator[None]:
    settings = point_cloud.inputs(object_)
    before = {name: settings[name] for name in ("Mode", "Share")}
    try:
        settings["Mode"], settings["Share"] = gaussian_nodes.MODES.index("points"), 1.0
        yield
    finally:
        for name, value in before.items():
            settings[name] = value


@contextmanager
def _vertices_of(object_: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """Provide a mesh object with a vertex where the cloud shows a point."""
    tree = bpy.data.node_groups.new("Points of a cloud", "GeometryNodeTree")
    compat.add_socket(tree, "Geometry", "NodeSocketGeometry")
    compat.add_socket(tree, "Geometry", "NodeSocketGeometry", output=True)
    nodes = Nodes(tree)
    points = nodes.add("GeometryNodeObjectInfo", {"Object": object_}).outputs["Geometry"]
    vertices = nodes.add("GeometryNodePointsToVertices", {"Points": points}).outputs[0]
    nodes.add("NodeGroupOutput", {"Geometry": vertices})
    mesh = bpy.data.meshes.new("points")
    copy = bpy.data.objects.new("reconstruction", mesh)
    try:
        bpy.context.scene.collection.objects.link(copy)
        copy.matrix_world = object_.matrix_world
        copy.modifiers.new("points", "NODES").node_group = tree
        yield copy
    finally:
        bpy.data.objects.remove(copy)
        bpy.data.meshes.remove(mesh)
        bpy.data.node_groups.remove(tree)
