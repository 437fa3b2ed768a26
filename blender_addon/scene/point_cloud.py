"""A reconstruction as one animated object: mesh points with attributes, moved and faded by Geometry Nodes.

Nothing is stored per frame. The modifier evaluates, from the scene's frame and frame rate,
    t = (frame - start frame) / fps * time scale,   x(t) = x0 + (t - t_mu) v,
    alpha(t) = opacity exp(-0.5 ((t - t_mu) / t_sigma)^2),
drops points below a cut-off opacity, and shows the rest as ellipsoids or points.

The material makes each Gaussian look as in splatting. On the surface of the ellipsoid at EXTENT standard deviations, a
ray that passes the centre at b standard deviations gets the opacity alpha(t) exp(-b^2 / 2). What a Gaussian emits comes
from `display.emission`.
"""

from __future__ import annotations

from typing import Literal

import bpy
import numpy as np

from ..io.gaussians_file import GaussianCloud
from . import display

Mode = Literal["ellipsoids", "points"]
EXTENT = 2.5  # radius of the shown ellipsoid in standard deviations; the splat has faded to 4 % there
CUT_OFF = 1 / 255  # opacity below which a Gaussian is not visible in an 8-bit picture
TRANSPARENT_LAYERS = 1024  # surfaces a ray may pass, two per Gaussian; where it must stop the picture turns black


def add_point_cloud(cloud: GaussianCloud, start_frame: float, mode: Mode = "ellipsoids",
                    name: str = "Flame Gaussians") -> bpy.types.Object:
    """Add the reconstruction to the current scene.

    Args:
        cloud: the Gaussians in the dataset's world frame.
        start_frame: scene frame that is time 0 of the dataset clock.
        mode: "ellipsoids" shows the true shapes; "points" shows balls of the same volume and renders faster.
    Returns:
        The object; its modifier has the inputs Start Frame, Time Scale, Cut-off and Frame Rate (follows the scene).
    Raises:
        ValueError: unknown mode.
    """
    if mode not in ("ellipsoids", "points"):
        raise ValueError(f"mode {mode!r}: choose 'ellipsoids' or 'points'")
    scene = bpy.context.scene
    thing = bpy.data.objects.new(name, _mesh(cloud, name))
    scene.collection.objects.link(thing)
    material = splat_material(f"{name} Material", mode)
    thing.data.materials.append(material)
    thing.visible_shadow = False  # fire casts no shadow
    modifier = thing.modifiers.new("Transient Gaussians", "NODES")
    modifier.node_group = _node_group(mode, material)
    sockets = {item.name: item.identifier for item in modifier.node_group.interface.items_tree
               if item.item_type == "SOCKET" and item.in_out == "INPUT"}
    modifier[sockets["Start Frame"]] = float(start_frame)
    _follow_frame_rate(thing, f'modifiers["{modifier.name}"]["{sockets["Frame Rate"]}"]', scene)
    scene.cycles.transparent_max_bounces = max(scene.cycles.transparent_max_bounces, TRANSPARENT_LAYERS)
    return thing


def _mesh(cloud: GaussianCloud, name: str) -> bpy.types.Mesh:
    """Vertices at x0 with the Gaussians' values as point attributes."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(cloud))
    mesh.vertices.foreach_set("co", cloud.position.ravel())
    # 1 / t_sigma is 0 for "always on", so no infinity enters the node graph; static Gaussians are always on and rest.
    alive = cloud.dynamic.astype(np.float32)
    light = display.emission(cloud, display.ToneCurve.measure(bpy.context.scene))
    columns = {
        "gs_velocity": ("FLOAT_VECTOR", "vector", cloud.velocity * alive[:, None]),
        "gs_t_mu": ("FLOAT", "value", cloud.t_mu),
        "gs_inverse_t_sigma": ("FLOAT", "value", np.minimum(alive / cloud.t_sigma, np.finfo(np.float32).max)),
        "gs_scale": ("FLOAT_VECTOR", "vector", cloud.scale),
        "gs_rotation": ("QUATERNION", "value", cloud.rotation),
        "gs_opacity": ("FLOAT", "value", cloud.opacity),
        "gs_color": ("FLOAT_COLOR", "color", np.column_stack([light, np.ones(len(cloud))])),
    }
    # Rows of diag(1 / scale) R^T, which maps an offset to standard deviations along the Gaussian's own axes.
    for k, (name_of_axis, axis) in enumerate(zip("xyz", _axes(cloud.rotation), strict=True)):
        columns[f"gs_whiten_{name_of_axis}"] = ("FLOAT_VECTOR", "vector", axis / np.maximum(cloud.scale[:, k : k + 1], 1e-9))
    for attribute, (kind, field, values) in columns.items():
        mesh.attributes.new(attribute, kind, "POINT").data.foreach_set(field, np.ravel(values).astype(np.float32))
    mesh.update()
    return mesh


def _axes(rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The Gaussians' own x, y and z axes, (N, 3) each, in the frame of unit quaternions wxyz (N, 4)."""
    w, x, y, z = rotation.T.astype(np.float64)
    return (np.column_stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]),
            np.column_stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]),
            np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]))


def _follow_frame_rate(thing: bpy.types.Object, path: str, scene: bpy.types.Scene) -> None:
    driver = thing.driver_add(path).driver
    for name, source in (("fps", "render.fps"), ("base", "render.fps_base")):
        variable = driver.variables.new()
        variable.name = name
        variable.targets[0].id_type = "SCENE"
        variable.targets[0].id = scene
        variable.targets[0].data_path = source
    driver.expression = "fps / base"  # a simple expression: runs even where Python in files is not allowed


class _Nodes:
    """Short way to write node graphs: every method adds a node and returns its output."""

    def __init__(self, tree: bpy.types.NodeTree):
        self.tree = tree

    def add(self, kind: str, inputs: dict | None = None, **properties) -> bpy.types.Node:
        node = self.tree.nodes.new(kind)
        for key, value in properties.items():
            setattr(node, key, value)
        for key, value in (inputs or {}).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[key])
            else:
                node.inputs[key].default_value = value
        return node

    def math(self, operation: str, *values) -> bpy.types.NodeSocket:
        return self.add("ShaderNodeMath", dict(enumerate(values)), operation=operation).outputs[0]

    def vector(self, operation: str, *values, output: str = "Vector", **named) -> bpy.types.NodeSocket:
        node = self.add("ShaderNodeVectorMath", dict(enumerate(values)) | named, operation=operation)
        return node.outputs[output]


def _node_group(mode: Mode, material: bpy.types.Material) -> bpy.types.NodeTree:
    tree = bpy.data.node_groups.new(f"Transient Gaussians ({mode})", "GeometryNodeTree")
    tree.is_modifier = True
    for name, kind, default in (("Geometry", "NodeSocketGeometry", None), ("Start Frame", "NodeSocketFloat", 1.0),
                                ("Time Scale", "NodeSocketFloat", 1.0), ("Cut-off", "NodeSocketFloat", CUT_OFF),
                                ("Frame Rate", "NodeSocketFloat", 24.0)):
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type=kind)
        if default is not None:
            socket.default_value = default
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes = _Nodes(tree)
    given = nodes.add("NodeGroupInput").outputs

    def attribute(name: str, kind: str) -> bpy.types.NodeSocket:
        return nodes.add("GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind).outputs["Attribute"]

    frame = nodes.add("GeometryNodeInputSceneTime").outputs["Frame"]
    seconds = nodes.math("DIVIDE", nodes.math("SUBTRACT", frame, given["Start Frame"]), given["Frame Rate"])
    age = nodes.math("SUBTRACT", nodes.math("MULTIPLY", seconds, given["Time Scale"]), attribute("gs_t_mu", "FLOAT"))
    relative = nodes.math("MULTIPLY", age, attribute("gs_inverse_t_sigma", "FLOAT"))
    window = nodes.math("EXPONENT", nodes.math("MULTIPLY", nodes.math("MULTIPLY", relative, relative), -0.5))
    alpha = nodes.math("MULTIPLY", attribute("gs_opacity", "FLOAT"), window)
    # The opacity is kept before anything is deleted; fields are evaluated on the geometry that reaches a node.
    stored = nodes.add("GeometryNodeStoreNamedAttribute", {"Geometry": given["Geometry"], "Name": "gs_alpha", "Value": alpha},
                       data_type="FLOAT", domain="POINT").outputs["Geometry"]
    hidden = nodes.add("FunctionNodeCompare", {"A": attribute("gs_alpha", "FLOAT"), "B": given["Cut-off"]},
                       data_type="FLOAT", operation="LESS_THAN").outputs["Result"]
    visible = nodes.add("GeometryNodeDeleteGeometry", {"Geometry": stored, "Selection": hidden}, domain="POINT").outputs[0]
    offset = nodes.vector("SCALE", attribute("gs_velocity", "FLOAT_VECTOR"), Scale=age)
    moved = nodes.add("GeometryNodeSetPosition", {"Geometry": visible, "Offset": offset}).outputs[0]
    show = _as_ellipsoids if mode == "ellipsoids" else _as_points
    shown = show(nodes, moved, attribute)
    dressed = nodes.add("GeometryNodeSetMaterial", {"Geometry": shown, "Material": material}).outputs[0]
    nodes.add("NodeGroupOutput", {"Geometry": dressed})
    return tree


def _as_ellipsoids(nodes: _Nodes, geometry, attribute) -> bpy.types.NodeSocket:
    ball = nodes.add("GeometryNodeMeshIcoSphere", {"Radius": EXTENT, "Subdivisions": 2}).outputs["Mesh"]
    place = nodes.add("GeometryNodeInputPosition").outputs[0]
    ball = nodes.add("GeometryNodeStoreNamedAttribute", {"Geometry": ball, "Name": "gs_local", "Value": place},
                     data_type="FLOAT_VECTOR", domain="POINT").outputs["Geometry"]
    instances = nodes.add("GeometryNodeInstanceOnPoints", {
        "Points": geometry, "Instance": ball, "Rotation": attribute("gs_rotation", "QUATERNION"),
        "Scale": attribute("gs_scale", "FLOAT_VECTOR")}).outputs["Instances"]
    # One mesh: a ray crosses dozens of Gaussians, and Cycles finds overlapping instances far more slowly.
    return nodes.add("GeometryNodeRealizeInstances", {"Geometry": instances}).outputs[0]


def _as_points(nodes: _Nodes, geometry, attribute) -> bpy.types.NodeSocket:
    sides = nodes.add("ShaderNodeSeparateXYZ", {"Vector": attribute("gs_scale", "FLOAT_VECTOR")}).outputs
    volume = nodes.math("MULTIPLY", nodes.math("MULTIPLY", sides[0], sides[1]), sides[2])
    radius = nodes.math("MULTIPLY", nodes.math("POWER", volume, 1 / 3), EXTENT)
    return nodes.add("GeometryNodeMeshToPoints", {"Mesh": geometry, "Radius": radius}).outputs["Points"]


def splat_material(name: str, mode: Mode) -> bpy.types.Material:
    """Emission of gs_color, opaque by gs_alpha exp(-b^2 / 2), b = distance of the ray from the centre in std-devs."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    # A path towards each of thousands of small lights is slow and noisy; other surfaces still see the flame's glow.
    material.cycles.emission_sampling = "NONE"
    nodes = _Nodes(material.node_tree)

    def attribute(name: str) -> bpy.types.bpy_prop_collection:
        return nodes.add("ShaderNodeAttribute", attribute_name=name, attribute_type="GEOMETRY").outputs

    color, alpha = attribute("gs_color")["Color"], attribute("gs_alpha")["Fac"]
    hit = nodes.add("ShaderNodeNewGeometry").outputs
    if mode == "ellipsoids":
        # In the Gaussian's own whitened space the ellipsoid is a ball and lengths count standard deviations.
        ray = nodes.add("ShaderNodeVectorTransform", {"Vector": hit["Incoming"]}, vector_type="VECTOR",
                        convert_from="WORLD", convert_to="OBJECT").outputs[0]
        rows = [nodes.vector("DOT_PRODUCT", attribute(f"gs_whiten_{axis}")["Vector"], ray, output="Value") for axis in "xyz"]
        ray = nodes.add("ShaderNodeCombineXYZ", dict(zip("XYZ", rows, strict=True))).outputs[0]
        hit_point = attribute("gs_local")["Vector"]
    else:
        ray, hit_point = hit["Incoming"], nodes.vector("SCALE", hit["Normal"], Scale=EXTENT)
    # Distance of the ray from the centre: exact wherever on the faceted ball it has hit.
    along = nodes.vector("DOT_PRODUCT", nodes.vector("NORMALIZE", ray), hit_point, output="Value")
    length = nodes.vector("LENGTH", hit_point, output="Value")
    squared = nodes.math("SUBTRACT", nodes.math("MULTIPLY", length, length), nodes.math("MULTIPLY", along, along))
    falloff = nodes.math("EXPONENT", nodes.math("MULTIPLY", squared, -0.5))
    front = nodes.math("SUBTRACT", 1.0, hit["Backfacing"])
    opacity = nodes.math("MULTIPLY", nodes.math("MULTIPLY", alpha, falloff), front)
    # Each sample either sees this Gaussian or passes, by chance: the same picture on average, but a ray ends after a few
    # layers instead of crossing all of them, and dense parts have no noise because every sample ends in the flame.
    chance = nodes.add("ShaderNodeTexWhiteNoise", {"Vector": hit["Position"], "W": alpha}, noise_dimensions="4D").outputs["Value"]
    seen = nodes.math("LESS_THAN", chance, opacity)
    clear = nodes.add("ShaderNodeBsdfTransparent").outputs[0]
    glow = nodes.add("ShaderNodeEmission", {"Color": color, "Strength": 1.0}).outputs[0]
    mixed = nodes.add("ShaderNodeMixShader", {0: seen, 1: clear, 2: glow}).outputs[0]
    nodes.add("ShaderNodeOutputMaterial", {"Surface": mixed})
    return material
