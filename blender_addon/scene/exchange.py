"""Objects to Alembic and USD files and back, by Blender's own exporters and importers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..core.errors import DataFormatError
from ..core.files import atomic_path

ALEMBIC, USD = (".abc",), (".usd", ".usdc", ".usda")


def write(things: list[bpy.types.Object], path: Path, first: int, last: int) -> None:
    """Write objects and nothing else, atomically; of a single frame it must be the scene's current one.

    Every frame is evaluated, and so is what else is in the scene: a fire burns up to there.

    Args:
        first, last: frames; of USD several are the scene's range.
    Raises:
        DataFormatError: this Blender was built without the format, as Debian's is.
    """
    _require(path)
    with _only_selected(things), atomic_path(path) as draft:
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
        yield sorted(set(bpy.data.objects) - before, key=lambda thing: thing.name)
    except RuntimeError as error:
        raise DataFormatError(f"{path}: {error}") from None
    finally:
        for thing in set(bpy.data.objects) - before:
            bpy.data.objects.remove(thing)


def _require(path: Path) -> None:
    name, built = ("Alembic", "alembic") if path.suffix.lower() in ALEMBIC else ("USD", "usd")
    if not getattr(bpy.app.build_options, built, False):
        raise DataFormatError(f"this Blender was built without {name}: use the one of blender.org")


@contextmanager
def _only_selected(things: list[bpy.types.Object]) -> Iterator[None]:
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
