"""A fire and its cameras in a scene of the user's: parts of an empty that marks their place.

The empty's axes are those of a spec's world, so the same builders serve the scene and the generator. Every part is
ordinary Blender data; a custom property says which part it is, so that it is found again after renaming, reloading,
appending and linking.
"""

from __future__ import annotations

import math
from dataclasses import replace

import bpy
from mathutils import Matrix, Vector

from ..pure.spec import SceneSpec
from ..pure.timing import Clip
from . import effects, fire, mantaflow, rig
from .fire_objects import FireObjects

PART = "gof_part"
PLACE, DOMAIN, EMITTER = "place", "domain", "emitter"


def part_of(object_: bpy.types.Object) -> str | None:
    """Return which part of a fire an object is: "place", "domain", "emitter", a camera's name ("cam_0"), "effect" or
    None."""
    return object_.get(PART)


def find(scene: bpy.types.Scene, part: str) -> bpy.types.Object | None:
    """Return a part of the scene's fire, or None."""
    return next((object_ for object_ in scene.objects if part_of(object_) == part), None)


def cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return cameras of the rig: cam_0, cam_1, ..., then those for evaluation."""
    found = [object_ for object_ in scene.objects if object_.type == "CAMERA" and part_of(object_)]
    return sorted(
        found, key=lambda object_: (part_of(object_).startswith("eval"), len(part_of(object_)), part_of(object_))
    )


def mark(scene: bpy.types.Scene, location: Vector) -> bpy.types.Object:
    """Return the scene's place for a fire, moved to a location (in the scene's units); made if there is none."""
    place = find(scene, PLACE)
    if place is None:
        place = bpy.data.objects.new("Fire", None)
        place[PART] = PLACE
        place.empty_display_type, place.empty_display_size = "ARROWS", 0.25
        place.scale = (1 / scene.unit_settings.scale_length,) * 3
        scene.collection.objects.link(place)
    place.location = location
    return place


def on_top_of(object_: bpy.types.Object) -> Vector:
    """Centre of the top of an object's bounding box, in the scene's units."""
    corners = [object_.matrix_world @ Vector(corner) for corner in object_.bound_box]
    low, high = (Vector(map(choose, zip(*corners, strict=True))) for choose in (min, max))
    return Vector(((low.x + high.x) / 2, (low.y + high.y) / 2, high.z))


def add_fire(spec: SceneSpec, scene: bpy.types.Scene, place: bpy.types.Object) -> FireObjects:
    """Build the spec's fire at a place, in place of the one before.

    It burns on the scene's own timeline, simulated while the scene is played; effects of the cameras need none of it.
    """
    remove(scene, lambda part: part in (DOMAIN, EMITTER, "effect"))
    frames_per_second = scene.render.fps / scene.render.fps_base
    placed_spec = replace(
        spec,
        clip=Clip(
            frames=max(scene.frame_end, 1), fps=frames_per_second, warm_up_frames=0, time_scale=spec.clip.time_scale
        ),
        effects=tuple(effect for effect in spec.effects if effects.changes_scene(effect)),
    )
    parts = collection(scene, "Fire")
    mantaflow.enable()
    others, active = set(parts.objects), bpy.context.view_layer.objects.active
    objects = fire.build(placed_spec, parts)
    bpy.context.view_layer.objects.active = active
    objects.domain_settings.cache_type = "REPLAY"
    for object_ in set(parts.objects) - others:
        object_[PART] = {objects.domain: DOMAIN, objects.emitter: EMITTER}.get(object_, "effect")
        object_.parent = place
    return objects


def add_cameras(spec: SceneSpec, scene: bpy.types.Scene, place: bpy.types.Object) -> list[bpy.types.Object]:
    """Build the spec's cameras around a place, instead of those before; sets the scene's image size and camera."""
    remove(scene, lambda part: part.startswith(("cam_", "eval_")))
    added = rig.build(spec, collection(scene, "Fire Cameras"))
    for camera, name in zip(added, spec.cameras.names, strict=True):
        camera[PART] = name
        camera.parent = place
        scale = scene.unit_settings.scale_length
        camera.data.display_size = 0.2 / scale
        camera.data.clip_start, camera.data.clip_end = camera.data.clip_start / scale, camera.data.clip_end / scale
    return added


def remove(scene: bpy.types.Scene, which) -> None:
    """Remove the parts of the scene's fire whose name ``which`` accepts."""
    for object_ in [object_ for object_ in scene.objects if part_of(object_) and which(part_of(object_))]:
        bpy.data.objects.remove(object_)


def to_our_world(marker: Matrix, scale: float) -> Matrix:
    """Return a scene's world to that of a spec: the marker to the origin, its heading to +X, the scene's units to
    metres."""
    heading = math.atan2(marker[1][0], marker[0][0])
    return Matrix.Scale(scale, 4) @ Matrix.Rotation(-heading, 4, "Z") @ Matrix.Translation(-marker.to_translation())


def collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection:
    """Return the scene's collection with a name, made if there is none."""
    found = next((item for item in scene.collection.children_recursive if item.name.partition(".")[0] == name), None)
    if found is None:
        found = bpy.data.collections.new(name)
        scene.collection.children.link(found)
    return found
