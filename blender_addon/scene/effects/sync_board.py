"""LED sync board: where cameras see it, and how it is drawn over their pictures."""

from __future__ import annotations

from functools import cache

import bpy
import numpy as np

from ...pure import led_board
from ...pure.effects.sync_board import Settings, lit_shares
from ...pure.spec import SceneSpec
from .. import rig


def overlay(light: np.ndarray, settings: Settings, spec: SceneSpec, camera: int, frame: int) -> np.ndarray:
    picture = spec.timeline.picture(camera, frame)
    off = np.zeros((led_board.OUTPUTS, picture.lines))
    on_plate = frame < 0
    shares = off if on_plate else lit_shares(settings, picture, spec.timeline.timing(camera, frame))
    paint = settings.paper / 20
    shine = np.vstack([off[:1], off[:1] + paint, off[:1] + settings.paper, paint + settings.brightness * shares])
    line = rig.as_picture(np.arange(picture.lines), spec)[..., 0]
    return _footprint(settings, spec, camera).over(light, shine, np.broadcast_to(line, light.shape[:2]))


def board_mask(settings: Settings, spec: SceneSpec, camera: int) -> np.ndarray:
    return _footprint(settings, spec, camera).mask


@cache
def _footprint(settings: Settings, spec: SceneSpec, camera: int) -> led_board.Footprint:
    scene, seen_by = bpy.context.scene, rig.find(spec)[camera]
    pose = rig.world_to_camera(seen_by)
    to_camera = pose[:3, :3] @ settings.plane() + np.outer(pose[:3, 3], (0, 0, 1))
    to_image = rig.intrinsics(seen_by, scene) @ to_camera
    return led_board.footprint(to_image, scene.render.resolution_x, scene.render.resolution_y)
