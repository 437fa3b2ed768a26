"""Small mesh builders with outward faces and texture coordinates in metres."""

from __future__ import annotations

import math
from collections.abc import Sequence

import bpy
import numpy as np


def add(
    name: str,
    vertices: Sequence,
    faces: Sequence,
    collection: bpy.types.Collection,
    uvs: Sequence | None = None,
    location=(0.0, 0.0, 0.0),
    turn_deg: float = 0.0,
    material: bpy.types.Material | None = None,
    smooth: bool = False,
) -> bpy.types.Object:
    """Add a mesh object; uvs holds one (u, v) per face corner; turn_deg rotates it about Z."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    if uvs is not None:
        mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", np.asarray(uvs, dtype=np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    mesh.update()
    if material is not None:
        mesh.materials.append(material)
    object_ = bpy.data.objects.new(name, mesh)
    object_.location = location
    object_.rotation_euler = (0.0, 0.0, math.radians(turn_deg))
    collection.objects.link(object_)
    return object_


def box(
    name: str, size: Sequence[float], collection: bpy.types.Collection, offset=(0.0, 0.0), grain: int = 0, **place
) -> bpy.types.Object:
    """Return a box centred on its location.

    offset shifts the texture, so that equal boxes look different; grain is the axis (0 x, 1 y, 2 z) the texture runs
    along.
    """
    corners = [(x * size[0] / 2, y * size[1] / 2, z * size[2] / 2) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    axes = [pair if pair[1] != grain else pair[::-1] for pair in ((0, 1), (0, 1), (0, 2), (0, 2), (1, 2), (1, 2))]
    uvs = [
        (corners[corner][u] + offset[0], corners[corner][v] + offset[1])
        for face, (u, v) in zip(faces, axes, strict=True)
        for corner in face
    ]
    return add(name, corners, faces, collection, uvs, **place)


def lathe(
    name: str, profile: Sequence[tuple[float, float]], collection: bpy.types.Collection, segments: int = 32, **place
) -> bpy.types.Object:
    """Return a surface of revolution about local Z; profile lists (radius, z) from bottom to top along the outside."""
    vertices, faces, uvs = [], [], []
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(np.array(profile), axis=0).T))])
    widest = max(radius for radius, _ in profile)
    for radius, z in profile:
        for segment in range(segments):
            angle = 2 * math.pi * segment / segments
            vertices.append((radius * math.cos(angle), radius * math.sin(angle), z))
    for ring in range(len(profile) - 1):
        for segment in range(segments):
            after = (segment + 1) % segments
            low, high = ring * segments, (ring + 1) * segments
            faces.append((low + segment, low + after, high + after, high + segment))
            left, right = (2 * math.pi * widest * s / segments for s in (segment, segment + 1))
            uvs += [
                (left, lengths[ring]),
                (right, lengths[ring]),
                (right, lengths[ring + 1]),
                (left, lengths[ring + 1]),
            ]
    return add(name, vertices, faces, collection, uvs, **place)


def ellipsoid(name: str, half_size: Sequence[float], collection: bpy.types.Collection, **place) -> bpy.types.Object:
    """Return a closed ellipsoid (poles are single vertices, as a fluid emitter needs a watertight mesh)."""
    rings, segments = 12, 24
    vertices = [(0.0, 0.0, -half_size[2])]
    for ring in range(1, rings):
        polar = math.pi * ring / rings
        for segment in range(segments):
            angle = 2 * math.pi * segment / segments
            vertices.append(
                (
                    half_size[0] * math.sin(polar) * math.cos(angle),
                    half_size[1] * math.sin(polar) * math.sin(angle),
                    -half_size[2] * math.cos(polar),
                )
            )
    vertices.append((0.0, 0.0, half_size[2]))
    top, faces = len(vertices) - 1, []
    for segment in range(segments):
        after = (segment + 1) % segments
        faces.append((0, 1 + after, 1 + segment))
        for ring in range(rings - 2):
            low, high = 1 + ring * segments, 1 + (ring + 1) * segments
            faces.append((low + segment, low + after, high + after, high + segment))
        low = 1 + (rings - 2) * segments
        faces.append((low + segment, low + after, top))
    return add(name, vertices, faces, collection, **place)


def crossed_logs(
    name: str, radius: float, collection: bpy.types.Collection, count: int = 3, **place
) -> bpy.types.Object:
    """Round logs leaning on each other like spokes, two of them side by side, inside a circle of the radius about Z."""
    vertices, faces, uvs = [], [], []
    thick, segments = radius / 4.5, 14
    reach, aside = (0.88, 0.9 * thick) if count == 2 else (0.97, 0.0)  # two spokes would be one log
    for index in range(count):
        angle = 2 * math.pi * index / count + 0.3
        along = np.array([math.cos(angle), math.sin(angle), 0.0])
        side = np.array([-along[1], along[0], 0.0])
        start, end = -0.35 * radius * along + [0, 0, thick * 0.9], reach * radius * along - [0, 0, thick * 0.9]
        start, end = start + aside * side, end + aside * side
        up = np.cross((end - start) / np.linalg.norm(end - start), side)
        first = len(vertices)
        for centre in (start, end):
            for segment in range(segments):
                turn = 2 * math.pi * segment / segments
                vertices.append(tuple(centre + thick * (math.cos(turn) * side + math.sin(turn) * up)))
        length = float(np.linalg.norm(end - start))
        for segment in range(segments):
            after = (segment + 1) % segments
            faces.append((first + segment, first + after, first + segments + after, first + segments + segment))
            left, right = (2 * math.pi * thick * s / segments for s in (segment, segment + 1))
            uvs += [(0.0, left), (0.0, right), (length, right), (length, left)]
        faces.append(tuple(first + segment for segment in reversed(range(segments))))
        faces.append(tuple(first + segments + segment for segment in range(segments)))
        ring = [
            (thick * math.cos(2 * math.pi * s / segments), thick * math.sin(2 * math.pi * s / segments))
            for s in range(segments)
        ]
        uvs += ring[::-1] + ring
    return add(name, vertices, faces, collection, uvs, **place)
