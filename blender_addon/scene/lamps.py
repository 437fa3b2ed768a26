"""Lamps that throw a cloud's light on the scene: a few along the flame, each as bright as the Gaussians around it.

Cycles finds the light of thousands of faint Gaussians by chance only, which is noise, and in EEVEE surfaces light
nothing. A lamp's light over time is the curve of a driver, whose input is the recording's clock: it follows the
cloud's Start Frame and Time Scale. Its Emission, Light on Scene, Color By and size count, too.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from ..pure.io.cloud import GaussianCloud
from . import compat, display

LAMPS = 4
BINS = 64  # of height, in which light is summed
INTENSITY = "gof_intensity"  # custom property of a lamp: W/sr at the recording's time
FAR = 1000.0  # Blender units
POWER = 4 * np.pi  # of a lamp that sends 1 W/sr


def add(
    object_: bpy.types.Object, path: Callable[[str], str], cloud: GaussianCloud, light: np.ndarray
) -> list[bpy.types.Object]:
    """Add lamps below a cloud's object, in its scene; none where it is dark.

    Args:
        path: from the object to one of its settings, by name.
        light: (N, 3) of `display.emission`.
    """
    fades = bool(cloud.dynamic.all())
    return [_lamp(object_, path, number, *found, fades) for number, found in enumerate(groups(cloud, light), 1)]


def groups(cloud: GaussianCloud, light: np.ndarray) -> list[tuple[np.ndarray, float, np.ndarray, np.ndarray]]:
    """Return for each lamp its place (3,) m, radius m, and (T,) s, (T, 3) W/sr: intensity by colour over time."""
    low, high = np.percentile(cloud.position[:, 2], [0, 100])
    span = max(float(high - low), 1e-9)
    times: dict[float, np.ndarray] = {}  # time -> light of each bin (BINS, 3)
    moments = np.zeros((BINS, 5))  # light, light by place, light by distance^2 from the axis of the bin
    for picture in display.pictures(cloud):
        shine = picture.intensity(light, display.HIDING if cloud.emissive else 1.0) / display.DIRECTIONS
        bins = np.clip(((picture.place[:, 2] - low) / span * BINS).astype(int), 0, BINS - 1)
        sums = [np.bincount(bins, shine[:, channel], BINS) for channel in range(3)]
        times[picture.time_s] = times.get(picture.time_s, 0.0) + np.column_stack(sums)
        weight = shine.mean(1)
        moments[:, 0] += np.bincount(bins, weight, BINS)
        for axis in range(3):
            moments[:, 1 + axis] += np.bincount(bins, weight * picture.place[:, axis], BINS)
        moments[:, 4] += np.bincount(bins, weight * (picture.place[:, :2] ** 2).sum(1), BINS)
    total = moments[:, 0].sum()
    if not total > 0:
        return []
    share = np.cumsum(moments[:, 0]) / total
    group = np.minimum((LAMPS * (share - moments[:, 0] / total / 2)).astype(int), LAMPS - 1)
    when = np.array(sorted(times))
    found = []
    for number in np.unique(group[moments[:, 0] > 0]):
        inside = group == number
        weight, *place, square = moments[inside].sum(0)
        place = np.array(place) / weight
        radius = np.sqrt(max(square / weight - (place[:2] ** 2).sum(), 0.0))
        found.append((place, float(radius), when, np.array([times[t][inside].sum(0) for t in when])))
    return found


def _lamp(
    object_: bpy.types.Object,
    path: Callable[[str], str],
    number: int,
    place: np.ndarray,
    radius: float,
    times_s: np.ndarray,
    light: np.ndarray,
    fades: bool,
) -> bpy.types.Object:
    """Return a lamp; `fades`: it is dark a step before and after its times."""
    data = bpy.data.lights.new(f"{object_.name} Lamp {number}", "POINT")
    lamp = bpy.data.objects.new(data.name, data)
    lamp.parent, lamp.location = object_, place
    data.shadow_soft_size = radius
    data.use_custom_distance, data.cutoff_distance = True, FAR  # else EEVEE lets a small flame light half a metre
    color = light.sum(0) / light.sum(0).max()
    data.color = color
    compat.hide_lamp(lamp)  # what is seen of the flame are its Gaussians
    bpy.context.scene.collection.objects.link(lamp)
    _follow_clock(lamp, path, times_s, light.sum(1) / color.sum(), fades)
    driver = data.driver_add("energy").driver
    _variable(driver, "intensity", lamp, f'["{INTENSITY}"]')
    for name, setting in (("emission", "Emission"), ("factor", "Light on Scene"), ("map", "Color By")):
        _variable(driver, name, object_, path(setting))
    _variable(driver, "size", object_, "scale.x")
    _variable(driver, "hidden", object_, "hide_render")
    driver.expression = f"{POWER} * intensity * size * size * emission * factor * (1 - min(map, 1)) * (1 - hidden)"
    return lamp


def _follow_clock(
    lamp: bpy.types.Object, path: Callable[[str], str], times_s: np.ndarray, intensity: np.ndarray, fades: bool
) -> None:
    """Drive a lamp's `INTENSITY` by the recording's time."""
    lamp[INTENSITY] = 0.0
    curve = lamp.driver_add(f'["{INTENSITY}"]')
    for name, setting in (("start", "Start Frame"), ("rate", "Frame Rate"), ("scale", "Time Scale")):
        _variable(curve.driver, name, lamp.parent, path(setting))
    curve.driver.expression = "(frame - start) / rate * scale"
    if len(times_s) == 1:  # a still
        times_s, intensity = np.array([0.0, 1.0]), np.repeat(intensity, 2)
    elif fades:
        step = float(np.min(np.diff(times_s)))
        times_s = np.concatenate([[times_s[0] - step], times_s, [times_s[-1] + step]])
        intensity = np.concatenate([[0.0], intensity, [0.0]])
    for modifier in list(curve.modifiers):
        curve.modifiers.remove(modifier)
    curve.keyframe_points.add(len(times_s) - len(curve.keyframe_points))  # new curves have two since Blender 5
    curve.keyframe_points.foreach_set("co", np.column_stack([times_s, intensity]).ravel())
    for point in curve.keyframe_points:
        point.interpolation = "LINEAR"
    curve.update()


def _variable(driver: bpy.types.Driver, name: str, owner: bpy.types.Object, path: str) -> None:
    variable = driver.variables.new()
    variable.name = name
    variable.targets[0].id, variable.targets[0].data_path = owner, path
