"""A reconstruction as one animated object: mesh points with attributes, moved, faded and drawn by `gaussian_nodes`.

The light of a Gaussian comes from `display.emission`. All settings are inputs of the object's modifier.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from ..core.datum import Datum
from ..pure.io.cloud import GaussianCloud
from . import compat, display, gaussian_nodes, lamps, see_through

DISPLAY = "gs_display"  # attribute: display values as in the file, which nothing draws and exports write
LONGEST = np.finfo(np.float32).max
DATUM = "gof_datum"  # custom property: x, y, z (m) and t (s) that places and times count from, where these are not 0
EMISSIVE = "gs_emissive"  # attribute, 1 where they are light (see `TransientGaussians`); missing where none is


class CloudError(RuntimeError):
    """A cloud that was edited lacks something that is needed; the message says what to do."""


class CloudInputs:
    """The settings of a cloud by the names in `gaussian_nodes.INPUTS`, read and written at its modifier."""

    def __init__(self, object_: bpy.types.Object, modifier: bpy.types.Modifier):
        self.object_, self.modifier = object_, modifier
        self._sockets = compat.input_sockets(modifier.node_group)

    def __getitem__(self, name: str) -> float | int:
        owner, path = self.place(name)
        return owner.path_resolve(path)

    def __setitem__(self, name: str, value: float) -> None:
        # A whole number stays one: Blender refuses to read the other kind.
        owner, path = self.place(name)
        value = type(self[name])(value)
        if path.startswith("["):
            owner[self._sockets[name].identifier] = value
        else:
            setattr(owner, path, value)
        self.object_.update_tag()

    def place(self, name: str) -> tuple[bpy.types.bpy_struct, str]:
        """Owner and property, for layouts."""
        return compat.modifier_value(self.modifier, self._sockets[name].identifier)

    def largest(self, name: str) -> float:
        """Return the greatest value that the node group knows."""
        return self._sockets[name].max_value

    def path(self, name: str) -> str:
        """Return path from the object, for drivers and keyframes."""
        return compat.modifier_path(self.modifier, self._sockets[name].identifier)


def inputs(object_: bpy.types.Object | None) -> CloudInputs | None:
    """Return the settings of an object that is a cloud; None for any other."""
    for modifier in object_.modifiers if object_ else ():
        if modifier.type == "NODES" and modifier.node_group and "gof_layout" in modifier.node_group:
            return CloudInputs(object_, modifier)
    return None


def add_point_cloud(
    cloud: GaussianCloud, start_frame: float, mode: str = "ellipsoids", name: str = "Flame Gaussians"
) -> bpy.types.Object:
    """Add the reconstruction to the current scene, where it was filmed and as large as it was.

    Args:
        cloud: the Gaussians in the dataset's world frame.
        start_frame: scene frame that is time 0 of the dataset clock.
        mode: one of `gaussian_nodes.MODES`. "ellipsoids" shows the true shapes; "points" shows balls of the same volume
            and renders faster.
    Returns:
        The object; `inputs(object)` are its settings.
    Raises:
        ValueError: unknown mode.
    """
    if mode not in gaussian_nodes.MODES:
        raise ValueError(f"mode {mode!r}: choose one of {', '.join(gaussian_nodes.MODES)}")
    object_ = add_view(_mesh(cloud, name), name)
    object_.scale = (1 / bpy.context.scene.unit_settings.scale_length,) * 3  # its own coordinates are metres
    settings = inputs(object_)
    settings["Mode"], settings["Start Frame"] = gaussian_nodes.MODES.index(mode), start_frame
    settings["Line Time"] = _line_time(cloud)
    lamps.add(object_, settings.path, cloud, column(object_.data, "gs_light", 3))
    object_.visible_diffuse = False  # rough surfaces get their light from the lamps
    if cloud.datum:
        object_[DATUM] = cloud.datum.numbers().tolist()
    see_through.allow(bpy.context.scene)
    if cloud.emissive:
        see_through.pass_flame(bpy.context.scene)
    return object_


def add_view(mesh: bpy.types.Mesh, name: str) -> bpy.types.Object:
    """Return a cloud of a mesh that `add_point_cloud` has made, with settings of its own; points are shared, not
    copied."""
    scene = bpy.context.scene
    object_ = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(object_)
    object_.visible_shadow = False  # fire casts no shadow
    add_modifier(object_, gaussian_nodes.NAME, gaussian_nodes.node_group())
    return object_


def show_as(object_: bpy.types.Object, mode: str) -> None:
    """Show a cloud as one of `gaussian_nodes.MODES`. One of a Blender without splats gets today's node group for
    these."""
    settings, number = inputs(object_), gaussian_nodes.MODES.index(mode)
    if number > settings.largest("Mode"):
        settings.modifier.node_group = gaussian_nodes.node_group()
        settings = inputs(object_)
    settings["Mode"] = number


def add_modifier(object_: bpy.types.Object, name: str, group: bpy.types.NodeTree) -> CloudInputs:
    """Give an object a node group of the scene's clock; returns its settings, whose Frame Rate follows the scene."""
    scene = bpy.context.scene
    modifier = object_.modifiers.new(name, "NODES")
    modifier.node_group = group
    settings = CloudInputs(object_, modifier)
    driver = object_.driver_add(settings.path("Frame Rate")).driver
    compat.scene_variable(driver, "fps", "render.fps", scene)
    compat.scene_variable(driver, "base", "render.fps_base", scene)
    driver.expression = "fps / base"  # a simple expression: runs even where Python in files is not allowed
    return settings


def stand_on(object_: bpy.types.Object, cloud: GaussianCloud, spot: Vector) -> None:
    """Move a cloud so that the foot of its flame is at a place of the scene."""
    object_.location = spot - Vector([side * length for side, length in zip(object_.scale, foot(cloud), strict=True)])


def foot(cloud: GaussianCloud) -> np.ndarray:
    """Return (3,) m, amid the lowest tenth of what moves, and as low as that begins; of everything where nothing
    moves."""
    places = cloud.position[cloud.dynamic if cloud.dynamic.any() else slice(None)].astype(np.float64)
    low, high = np.percentile(places[:, 2], [1, 99])  # without the runaways
    lowest = places[places[:, 2] <= low + 0.1 * (high - low)]
    return np.array([*np.median(lowest[:, :2], axis=0), low])


def cloud_of(object_: bpy.types.Object) -> GaussianCloud | None:
    """Return the Gaussians that an object shows, from its mesh; None for one of an older add-on, which kept no colors.

    A Gaussian that rests and is always on counts as static.

    Raises:
        CloudError: some are light and some are not, as where objects were joined: a cloud is one or the other.
    """
    mesh = object_.data
    if DISPLAY not in mesh.attributes:
        return None
    shining = column(mesh, EMISSIVE, 1)[:, 0] if EMISSIVE in mesh.attributes else np.zeros(len(mesh.vertices))
    if shining.any() and not shining.all():
        raise CloudError(
            f"{object_.name}: {np.count_nonzero(shining):,} of its {len(shining):,} Gaussians are a flame's light and "
            "the others cover what is behind them; separate what was joined, and write each"
        )
    position = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", position)
    velocity, gas = column(mesh, "gs_velocity", 3), column(mesh, "gs_gas_velocity", 3)
    inverse = column(mesh, "gs_inverse_t_sigma", 1)[:, 0]
    with np.errstate(divide="ignore"):
        t_sigma = 1 / inverse
    given = {
        field: column(mesh, name, 1)[:, 0]
        for field, name in (("velocity_sd", "gs_velocity_sd"), ("begin", "gs_begin"), ("end", "gs_end"))
        if name in mesh.attributes
    }
    return GaussianCloud(
        position=position.reshape(-1, 3),
        velocity=velocity,
        t_mu=column(mesh, "gs_t_mu", 1)[:, 0],
        t_sigma=t_sigma,
        scale=column(mesh, "gs_scale", 3),
        rotation=quaternions(column(mesh, "gs_euler", 3)),
        opacity=column(mesh, "gs_opacity", 1)[:, 0],
        color=column(mesh, DISPLAY, 3),
        dynamic=(inverse > 0) | (velocity != 0).any(1) | (gas != 0).any(1) | ("begin" in given),
        gas_velocity=gas,
        datum=datum_of(object_),
        emissive=bool(shining.any()),
        **given,
    )


def datum_of(object_: bpy.types.Object) -> Datum:
    """Return the datum that an object's places and times count from; zeros where it names none."""
    return Datum.from_numbers(object_.get(DATUM, (0.0,) * 4), object_.name)


def why_not_color(mesh: bpy.types.Mesh, color: str) -> str | None:
    """Why a cloud has no values for one of `gaussian_nodes.COLORS`, if it has none."""
    if color == "error" and "gs_true_velocity" not in mesh.attributes:
        return "score first: choose a Dataset in the panel Score and press Show Errors"
    if color == "uncertainty" and "gs_velocity_sd" not in mesh.attributes:
        return "this file does not say how sure its velocities are"
    return None


def color_by(object_: bpy.types.Object, color: str) -> None:
    """Colour a cloud by one of `gaussian_nodes.COLORS`, over the range of its values.

    Raises CloudError where it has none.
    """
    if problem := why_not_color(object_.data, color):
        raise CloudError(f"{object_.name}: {problem}")
    settings, span = inputs(object_), None if color == "image" else value_range(object_.data, color)
    settings["Color By"] = gaussian_nodes.COLORS.index(color)
    if span:
        settings["Color Min"], settings["Color Max"] = span


def value_range(mesh: bpy.types.Mesh, color: str) -> tuple[float, float]:
    """Return values at the ends of the colour map: m/s from 0 on for speed, error, uncertainty, s for age and lifetime.

    The largest 2 % are left out: a few runaways would make all others look the same.
    """
    inverse = column(mesh, "gs_inverse_t_sigma", 1)[:, 0]
    fading = inverse > 0
    if color in ("age", "lifetime"):
        lifetime = 1 / inverse[fading].astype(np.float64) if fading.any() else np.ones(1)
        if color == "age":  # what is seen of a Gaussian is the time around its brightest moment
            return float(-2 * np.median(lifetime)), float(2 * np.median(lifetime))
        return float(np.percentile(lifetime, 2)), float(np.percentile(lifetime, 98))
    if color == "uncertainty":
        return 0.0, float(np.percentile(column(mesh, "gs_velocity_sd", 1), 98))
    velocity = column(mesh, "gs_gas_velocity", 3)
    if color == "error":
        velocity = velocity - column(mesh, "gs_true_velocity", 3)
    return 0.0, float(np.percentile(np.linalg.norm(velocity, axis=1), 98))


def column(mesh: bpy.types.Mesh, name: str, width: int) -> np.ndarray:
    """Return a point attribute, (N, width) float32. Raises CloudError: it is not there, or not to be read in this
    mode."""
    attribute = mesh.attributes.get(name)
    if mesh.is_editmode:
        raise CloudError(f"{mesh.name}: is being edited; leave Edit Mode first")
    if attribute is None or not len(mesh.vertices) or len(attribute.data) != len(mesh.vertices):
        raise CloudError(f"{mesh.name}: its points have no {name} any more; import the reconstruction again")
    values = np.empty(len(mesh.vertices) * width, np.float32)
    attribute.data.foreach_get("value" if width == 1 else "vector", values)
    return values.reshape(-1, width)


def add_column(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """Add or replace a point attribute (N,) or (N, 3)."""
    kind, field = ("FLOAT", "value") if values.ndim == 1 else ("FLOAT_VECTOR", "vector")
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name=name, type=kind, domain="POINT")
    attribute.data.foreach_set(field, np.ascontiguousarray(values, np.float32).ravel())
    mesh.update_tag()


def _mesh(cloud: GaussianCloud, name: str) -> bpy.types.Mesh:
    """Return vertices at x0 with the Gaussians' values as point attributes."""
    light = display.emission(cloud, display.ToneCurve.measure(bpy.context.scene))
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(cloud))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(cloud.position).ravel())
    # 1 / t_sigma is 0 for "always on", so no infinity enters the node graph; static Gaussians are always on and rest.
    alive = cloud.dynamic.astype(np.float32)
    add_column(mesh, "gs_velocity", cloud.velocity * alive[:, None])
    add_column(mesh, "gs_gas_velocity", cloud.moving_gas)
    add_column(mesh, "gs_t_mu", cloud.t_mu)
    add_column(mesh, "gs_inverse_t_sigma", np.minimum(alive / cloud.t_sigma, LONGEST))
    add_column(mesh, "gs_scale", cloud.scale)
    add_column(mesh, "gs_euler", euler_angles(cloud.rotation))
    add_column(mesh, "gs_opacity", cloud.opacity)
    add_column(mesh, "gs_light", light)
    add_column(mesh, DISPLAY, cloud.color)
    if cloud.emissive:
        add_column(mesh, EMISSIVE, np.ones(len(cloud)))
    if cloud.says_uncertainty:
        # No infinity enters the node graph: an unknown uncertainty of a velocity becomes its own size.
        speed = np.linalg.norm(cloud.moving_gas, axis=1)
        uncertainty = np.where(np.isfinite(cloud.velocity_sd), cloud.velocity_sd, speed)
        add_column(mesh, "gs_velocity_sd", uncertainty * alive)
    if cloud.begin is not None:
        add_column(mesh, "gs_begin", cloud.begin)
        add_column(mesh, "gs_end", cloud.end)
    return mesh


def euler_angles(rotation: np.ndarray) -> np.ndarray:
    """XYZ Euler angles (N, 3) of quaternions wxyz (N, 4): the form that the nodes of all versions take."""
    w, x, y, z = (rotation / np.linalg.norm(rotation.astype(np.float64), axis=1, keepdims=True)).T
    sine = np.clip(2 * (w * y - x * z), -1, 1)
    locked = 1 - np.abs(sine) < 1e-12  # x and z turn about the same axis: all of it is given to x
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    roll = np.where(locked, np.arctan2(2 * (w * x - y * z), 1 - 2 * (x * x + z * z)), roll)
    return np.column_stack([roll, np.arcsin(sine), np.where(locked, 0.0, yaw)])


def quaternions(euler: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N, 4) float32 of XYZ Euler angles (N, 3)."""
    half = euler.astype(np.float64) / 2
    (cx, cy, cz), (sx, sy, sz) = np.cos(half).T, np.sin(half).T
    w, x = cx * cy * cz + sx * sy * sz, sx * cy * cz - cx * sy * sz
    y, z = cx * sy * cz + sx * cy * sz, cx * cy * sz - sx * sy * cz
    return np.column_stack([w, x, y, z]).astype(np.float32)


def _line_time(cloud: GaussianCloud) -> float:
    """Return seconds in which a fast Gaussian passes a tenth of the cloud: arrows as long as that can be told apart."""
    fast = (
        float(np.percentile(np.linalg.norm(cloud.moving_gas[cloud.dynamic], axis=1), 98))
        if cloud.dynamic.any()
        else 0.0
    )
    size = float(np.ptp(np.percentile(cloud.position, [2, 98], axis=0), axis=0).max())
    return 0.1 * size / fast if fast > 0 and size > 0 else 0.02
