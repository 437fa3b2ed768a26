"""A cloud at one instant as Blender's own Gaussian splats, which 5.3 brings: a point cloud with certain attributes.

The running Blender says how a point cloud becomes splats (`compat.splat_type`).
"""

from __future__ import annotations

import bpy
import numpy as np

from ..pure.points import Points
from . import compat

ATTRIBUTES = (  # name, of `Points`, type, field
    ("position", "position", "FLOAT_VECTOR", "vector"),
    ("scale", "scale", "FLOAT_VECTOR", "vector"),
    ("rotation", "rotation", "QUATERNION", "value"),
    ("radiance:base", "radiance", "FLOAT4", "vector"),
)


def add(points: Points, name: str) -> bpy.types.Object:
    """Return an object with the points as splats, in the current scene.

    Raises RuntimeError: this Blender has no splats.
    """
    kind = compat.splat_type()
    if kind is None:
        raise RuntimeError("this Blender has no Gaussian splats of its own: they come with 5.3")
    cloud = bpy.data.pointclouds.new(name)
    cloud.resize(len(points))
    setattr(cloud, *kind)
    write(cloud, points, ATTRIBUTES)
    thing = bpy.data.objects.new(name, cloud)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def write(data: bpy.types.ID, points: Points, attributes: tuple[tuple[str, str, str, str], ...]) -> None:
    """Write attributes of points to a data-block that has as many, made where they are not there."""
    for name, values, kind, field in attributes:
        attribute = data.attributes.get(name) or data.attributes.new(name, kind, "POINT")
        attribute.data.foreach_set(field, np.ascontiguousarray(getattr(points, values), np.float32).ravel())
    data.update_tag()
