"""The spec of a scene: what the Fire panel says, and where the user has put the fire's parts since.

The places are read back from the objects: the empty, the burner, the domain's box, the cameras' poses and focal length.
Other edits, such as the flame's material, stay in the user's scene.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.checked_json import SpecError
from ..pure.effects import changes_bake
from ..pure.fires import GridFire
from ..pure.rig import Pose, Rig
from ..pure.spec import Display, Domain, Fire, Render, SceneSpec
from ..pure.timing import Clip
from ..scene import place, rig
from . import effect_groups
from .effect_groups import exact

SAME_M, SAME_TURN = 1e-5, 1e-5  # differences below which an object stands where the panel's settings put it


def of_settings(scene: bpy.types.Scene) -> SceneSpec:
    """Return the spec that the Fire panel describes. Raises SpecError that names what is out of range."""
    fire, cameras = scene.gof.fire, scene.gof.fire.cameras
    width, depth, height = map(exact, fire.domain_size)
    burner = Fire(
        fire.fuel,
        fire.shape,
        (0.0, 0.0, 0.0),
        exact(fire.radius),
        light=fire.light,
        speeds=fire.speeds,
        intensity=exact(fire.intensity),
        logs=fire.logs if fire.shape == "logs" else Fire.logs,
    )
    return SceneSpec(
        "fire",
        seed=fire.seed,
        clip=Clip(fps=exact(cameras.fps)),
        domain=Domain((exact(-width / 2), exact(-depth / 2), 0.0), (width, depth, height), fire.resolution),
        fire=replace(burner, position=(0.0, 0.0, exact(fire.clearance + burner.half_size[2]))),
        cameras=Rig(
            count=cameras.count,
            eval_count=cameras.eval_count,
            around_frames=cameras.around_frames,
            arc_deg=exact(cameras.arc_deg),
            azimuth_deg=exact(cameras.azimuth_deg),
            radius=exact(cameras.radius),
            height=exact(cameras.height),
            look_at=(0.0, 0.0, exact(cameras.look_at_height)),
            focal_mm=exact(cameras.focal_mm),
            sensor_px=tuple(cameras.sensor_px),
            roll_deg=int(cameras.roll_deg),
        ),
        render=Render(percentage=100),
        effects=effect_groups.chosen(fire.effects),
    )


def of_scene(scene: bpy.types.Scene) -> SceneSpec:
    """Return the Fire panel's spec with the current places of the objects.

    Raises SpecError if a setting is out of range, or an object stands as no spec can say.
    """
    spec = of_settings(scene)
    marker = place.find(scene, place.PLACE)
    if marker is None:
        return spec
    to_ours = place.to_our_world(marker.matrix_world, scene.unit_settings.scale_length)
    fire = replace(spec.fire, position=spec.fire.position)
    domain = spec.domain
    if body := place.find(scene, place.DOMAIN):
        domain = _domain(spec.domain, body, to_ours @ body.matrix_world)
    if (burner := place.find(scene, place.EMITTER)) and "moving_emitter" not in spec.effect_names:
        fire = _fire(spec.fire, to_ours @ burner.matrix_world)
    cameras = place.cameras(scene)
    rig_ = (
        _rig(spec.cameras, cameras, [to_ours @ camera.matrix_world for camera in cameras]) if cameras else spec.cameras
    )
    return replace(spec, domain=domain, fire=fire, cameras=rig_)


def with_grids(spec: SceneSpec, grids: Path, start_s: float, radiance: float, lift: float) -> SceneSpec:
    """Return the same cameras and pictures of a fire that another solver has made, `lift` above its place (m).

    Effects that ask something of our own solver are left out. Raises SpecError if a number is out of range.
    """
    fire = GridFire(grids.as_posix(), exact(start_s), (0.0, 0.0, exact(lift)), exact(radiance))
    effects = tuple(effect for effect in spec.effects if not changes_bake(effect))
    return replace(spec, fire=fire, domain=None, effects=effects)


def display_of(scene: bpy.types.Scene) -> Display:
    """Return the scene's own colour management, where the spec knows it; Filmic otherwise."""
    view = scene.view_settings
    if view.view_transform not in ("Standard", "Filmic", "AgX"):
        return Display()
    return Display(view.view_transform, view.look, exact(view.exposure), exact(view.gamma))


def _domain(planned: Domain, body: bpy.types.Object, pose: Matrix) -> Domain:
    """Return the domain's box. ``pose`` takes the object to the spec's world."""
    turn = np.array(pose.to_3x3().normalized())
    if np.abs(turn - np.eye(3)).max() > 1e-3:
        raise SpecError(
            f"{body.name} is turned against its empty: turn the empty about Z instead, and reset {body.name}'s rotation"
        )
    corners = np.array([pose @ Vector(corner) for corner in body.bound_box])
    low, size = corners.min(0), np.ptp(corners, axis=0)
    if np.abs(np.r_[low - planned.min, size - planned.size]).max() < SAME_M:
        return planned
    return replace(planned, min=_rounded(low), size=_rounded(size))


def _fire(planned: Fire, pose: Matrix) -> Fire:
    position, scale = np.array(pose.to_translation()), pose.to_scale()
    moved = np.abs(position - planned.position).max() > SAME_M
    radius = planned.radius if abs(scale.x - 1) < SAME_M else exact(planned.radius * scale.x)
    return replace(planned, position=_rounded(position) if moved else planned.position, radius=radius)


def _rig(planned: Rig, cameras: list[bpy.types.Object], poses: list[Matrix]) -> Rig:
    """Return the rig as its cameras stand: on the planned arc, or each where it is."""
    names = [place.part_of(camera) for camera in cameras]
    if names != planned.names:
        raise SpecError(
            f"the scene has the cameras {', '.join(names)}, the Fire panel plans {', '.join(planned.names)}: "
            "press Replace Cameras, or set the panel's numbers of cameras back"
        )
    lenses = {exact(camera.data.lens) for camera in cameras}
    if len(lenses) > 1:
        raise SpecError(
            f"the cameras have different focal lengths ({sorted(lenses)} mm): a rig has one; set all cameras to it"
        )
    planned = replace(planned, focal_mm=lenses.pop())
    difference = [
        (own.to_translation() - planned_pose.to_translation()).length / SAME_M
        + own.to_quaternion().rotation_difference(planned_pose.to_quaternion()).angle / (100 * SAME_TURN)
        for own, planned_pose in zip(poses, rig.poses(planned), strict=True)
    ]
    if max(difference) < 1:
        return planned
    return replace(
        planned, placed=tuple(Pose(_rounded(pose.to_translation()), _rounded(pose.to_quaternion())) for pose in poses)
    )


def _rounded(values) -> tuple[float, ...]:
    return tuple(round(float(value), 6) + 0.0 for value in values)
