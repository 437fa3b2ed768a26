"""The node group of a cloud: where every Gaussian is at the scene's time, how opaque, in which colour and shape.

    t = (frame - start frame) / frame rate * time scale,   x(t) = x0 + (t - t_mu) v,
    alpha(t) = opacity exp(-0.5 ((t - t_mu) / t_sigma)^2), seen while begin <= t < end where a cloud has these

Nothing is stored per frame. The drawn geometry carries the attributes gs_alpha, gs_color and velocity (m/s on the
scene's clock; Cycles takes motion blur from it, also for Gaussians that appear or vanish while the shutter is open).
"""

from __future__ import annotations

import bpy

from ..core.harmonics import C0
from . import compat, display, gaussian_material
from .gaussian_material import EXTENT
from .nodes import Nodes, pick

NAME = "Transient Gaussians"
# Raise both when the group changes: clouds of an older add-on, or of a Blender without splats, keep their own.
LAYOUT = 6 if compat.HAS_SPLATS else 5
MODES = ("points", "ellipsoids", "arrows", "streaks", "splats")[: 5 if compat.HAS_SPLATS else 4]
QUICK = "points" if compat.EEVEE_DRAWS_POINTS else "ellipsoids"  # the quickest that every view draws
COLORS = ("image", "speed", "age", "lifetime", "error", "uncertainty")
VECTORS = ("velocity", "true velocity", "error")
ICOSAHEDRON_RADIUS = EXTENT / 0.7947  # its faces touch the ball of EXTENT; the material does the rounding
CUT_OFF = 1 / 255  # opacity below which a Gaussian is not visible in an 8-bit picture

# Attributes that nothing drawn needs.
SPENT = ("gs_t_mu", "gs_inverse_t_sigma", "gs_opacity", "gs_light", "gs_emissive", "gs_display")
# Attributes that no material asks for once a line has its shape and color.
SHAPES = ("gs_scale", "gs_euler", "gs_velocity", "gs_gas_velocity", "gs_true_velocity", "gs_velocity_sd")

FLOAT, WHOLE = "NodeSocketFloat", "NodeSocketInt"
INPUTS = (  # name, kind, default, least, largest, description
    ("Mode", WHOLE, 0, 0, len(MODES) - 1, ", ".join(f"{number} {mode}" for number, mode in enumerate(MODES))),
    ("Start Frame", FLOAT, 1.0, -1e6, 1e6, "Scene frame that is time 0 of the reconstruction"),
    ("Time Scale", FLOAT, 1.0, -1e3, 1e3, "1 plays as fast as it was filmed, 0.1 ten times slower"),
    ("Opacity Cut", FLOAT, CUT_OFF, 0.0, 1.0, "Gaussians fainter than this are not drawn"),
    ("Share", FLOAT, 1.0, 0.0, 1.0, "Share of the Gaussians that is drawn; fewer arrows are easier to read"),
    ("Color By", WHOLE, 0, 0, 5, "0 image color, 1 speed, 2 age, 3 lifetime, 4 velocity error, 5 velocity uncertainty"),
    ("Color Min", FLOAT, 0.0, -1e6, 1e6, "Value at the dark end of the color map (m/s or s)"),
    ("Color Max", FLOAT, 1.0, -1e6, 1e6, "Value at the bright end of the color map (m/s or s)"),
    ("Emission", FLOAT, 1.0, 0.0, 1e6, "Brightness of the flame; 1 looks as in the footage"),
    (
        "Light on Scene",
        FLOAT,
        1.0,
        0.0,
        1e6,
        "Factor on the light of the flame's lamps on everything else; a color map throws none",
    ),
    ("Line Time", FLOAT, 0.02, 0.0, 1e3, "Length of arrows and streaks: the way of this many seconds"),
    ("Arrows Show", WHOLE, 0, 0, 2, "0 velocity, 1 true velocity, 2 velocity error; the last two once scored"),
    ("Frame Rate", FLOAT, 24.0, 0.001, 1e6, "Follows the scene"),
)
VIRIDIS = (
    (0.267, 0.005, 0.329),
    (0.254, 0.265, 0.530),
    (0.164, 0.471, 0.558),
    (0.134, 0.659, 0.518),
    (0.478, 0.821, 0.318),
    (0.993, 0.906, 0.144),
)  # display sRGB


def node_group() -> bpy.types.NodeTree:
    """Return the file's node group of this layout; made when there is none."""
    names = {name for name, *_ in INPUTS}
    for tree in bpy.data.node_groups:
        whole = names <= set(compat.input_sockets(tree))  # inputs may have been removed by hand
        if tree.get("gof_layout") == LAYOUT and tree.library is None and whole:
            return tree
    tree = new_group(NAME, tuple(names))
    tree["gof_layout"] = LAYOUT
    _write(Nodes(tree))
    return tree


def new_group(name: str, settings: tuple[str, ...]) -> bpy.types.NodeTree:
    """Return a group for a modifier, without nodes, that has these of INPUTS."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    if hasattr(tree, "is_modifier"):
        tree.is_modifier = True
    compat.add_socket(tree, "Geometry", "NodeSocketGeometry")
    for setting, kind, default, least, largest, description in INPUTS:
        if setting in settings:
            socket = compat.add_socket(tree, setting, kind)
            socket.min_value, socket.max_value = least, largest
            socket.default_value, socket.description = default, description
    compat.add_socket(tree, "Geometry", "NodeSocketGeometry", output=True)
    return tree


def clock(nodes: Nodes, given) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Return the recording's time at the scene's frame, and a Gaussian's since its t_mu, in seconds."""
    frame = nodes.add("GeometryNodeInputSceneTime").outputs["Frame"]
    seconds = nodes.math("DIVIDE", nodes.math("SUBTRACT", frame, given["Start Frame"]), given["Frame Rate"])
    time = nodes.math("MULTIPLY", seconds, given["Time Scale"])
    return time, nodes.math("SUBTRACT", time, nodes.named("gs_t_mu", "FLOAT"))


def _write(nodes: Nodes) -> None:
    given = nodes.add("NodeGroupInput").outputs
    time, age = clock(nodes, given)
    alpha = opacity(nodes, time, age)
    radius = nodes.math("MULTIPLY", _mean_scale(nodes), EXTENT)
    visible = nodes.math("GREATER_THAN", given["Share"], _number_of_its_own(nodes))
    opaque = nodes.math("SUBTRACT", 1.0, nodes.math("LESS_THAN", alpha, given["Opacity Cut"]))
    points = nodes.add(
        "GeometryNodeMeshToPoints",
        {"Mesh": given["Geometry"], "Radius": radius, "Selection": nodes.math("MULTIPLY", visible, opaque)},
    ).outputs[0]
    velocity, gas = nodes.named("gs_velocity", "FLOAT_VECTOR"), nodes.named("gs_gas_velocity", "FLOAT_VECTOR")
    # Fields are evaluated on the geometry that reaches a node: nothing below is computed for what is not drawn.
    light = nodes.math("MULTIPLY", nodes.named("gs_emissive", "FLOAT"), display.HIDING - 1)
    drawn = nodes.math("MULTIPLY", alpha, nodes.math("ADD", light, 1.0))
    points = nodes.store(points, "gs_alpha", "FLOAT", drawn)
    points = nodes.store(points, "gs_color", "FLOAT_COLOR", _color(nodes, given, gas, age))
    points = nodes.store(points, "velocity", "FLOAT_VECTOR", nodes.vector("SCALE", velocity, Scale=given["Time Scale"]))
    points = nodes.add(
        "GeometryNodeSetPosition", {"Geometry": points, "Offset": nodes.vector("SCALE", velocity, Scale=age)}
    ).outputs[0]
    points = _without(nodes, points, *SPENT)
    lines = gaussian_material.lines(f"{NAME} Lines"), gaussian_material.lines(f"{NAME} Line Instances", "INSTANCER")
    nodes.add(
        "NodeGroupOutput",
        {
            "Geometry": nodes.choose(
                "GEOMETRY",
                given["Mode"],
                _dressed(
                    nodes,
                    _without(nodes, points, "gs_scale", "gs_euler", "gs_velocity", "gs_gas_velocity"),
                    gaussian_material.points(f"{NAME} Points"),
                ),
                _ellipsoids(nodes, points),
                _lines(nodes, _arrows(nodes, points, given), *lines),
                _lines(nodes, _streaks(nodes, points, given, velocity), *lines),
                *([_splats(nodes, points)] if compat.HAS_SPLATS else []),
            )
        },
    )


def opacity(nodes: Nodes, time, age) -> bpy.types.NodeSocket:
    """Return a Gaussian's opacity now, from its attributes."""
    relative = nodes.math("MULTIPLY", age, nodes.named("gs_inverse_t_sigma", "FLOAT"))
    window = nodes.math("EXPONENT", nodes.math("MULTIPLY", nodes.math("MULTIPLY", relative, relative), -0.5))
    begin, end = nodes.named("gs_begin", "FLOAT"), nodes.named("gs_end", "FLOAT")
    # Neighbours share the very number: at no time are two seen, or none. Without the attributes both are 0.
    inside = nodes.math("SUBTRACT", nodes.math("LESS_THAN", time, end), nodes.math("LESS_THAN", time, begin))
    endless = nodes.math("SUBTRACT", 1.0, nodes.math("LESS_THAN", begin, end))
    shown = nodes.math("MAXIMUM", inside, endless)
    return nodes.math("MULTIPLY", nodes.math("MULTIPLY", nodes.named("gs_opacity", "FLOAT"), window), shown)


def _mean_scale(nodes: Nodes) -> bpy.types.NodeSocket:
    """Return standard deviation of the ball of the same volume."""
    sides = nodes.add("ShaderNodeSeparateXYZ", {"Vector": nodes.named("gs_scale", "FLOAT_VECTOR")}).outputs
    return nodes.math("POWER", nodes.math("MULTIPLY", nodes.math("MULTIPLY", sides[0], sides[1]), sides[2]), 1 / 3)


def _number_of_its_own(nodes: Nodes) -> bpy.types.NodeSocket:
    """Return a number in [0, 1) that stays with a Gaussian at all times."""
    return pick(nodes.add("FunctionNodeRandomValue", data_type="FLOAT").outputs, "Value")


def _color(nodes: Nodes, given, velocity, age) -> bpy.types.NodeSocket:
    """Return emitted light, and in the fourth value its factor for all that is not the camera."""
    lifetime = nodes.math("DIVIDE", 1.0, nodes.math("MAXIMUM", nodes.named("gs_inverse_t_sigma", "FLOAT"), 1e-9))
    speed = nodes.vector("LENGTH", velocity, output="Value")
    error = nodes.vector("DISTANCE", velocity, nodes.named("gs_true_velocity", "FLOAT_VECTOR"), output="Value")
    uncertainty = nodes.named("gs_velocity_sd", "FLOAT")
    value = nodes.choose("FLOAT", given["Color By"], 0.0, speed, age, lifetime, error, uncertainty)
    span = nodes.math("MAXIMUM", nodes.math("SUBTRACT", given["Color Max"], given["Color Min"]), 1e-9)
    ramp = nodes.add(
        "ShaderNodeValToRGB", {"Fac": nodes.math("DIVIDE", nodes.math("SUBTRACT", value, given["Color Min"]), span)}
    )
    for k, shade in enumerate(VIRIDIS):
        place = k / (len(VIRIDIS) - 1)
        stop = ramp.color_ramp.elements[k] if k < 2 else ramp.color_ramp.elements.new(place)
        stop.position = place
        stop.color = (*(((c + 0.055) / 1.055) ** 2.4 if c > 0.04045 else c / 12.92 for c in shade), 1.0)
    mapped = nodes.math("MINIMUM", given["Color By"], 1.0)
    shown = nodes.choose("VECTOR", mapped, nodes.named("gs_light", "FLOAT_VECTOR"), ramp.outputs["Color"])
    light = nodes.vector("SCALE", shown, Scale=given["Emission"])
    sides = nodes.add("ShaderNodeSeparateXYZ", {"Vector": light}).outputs
    lit = nodes.math(
        "MULTIPLY", given["Light on Scene"], nodes.math("SUBTRACT", 1.0, mapped)
    )  # a colour map lights nothing
    return nodes.add(
        "FunctionNodeCombineColor", {"Red": sides[0], "Green": sides[1], "Blue": sides[2], "Alpha": lit}
    ).outputs[0]


def _without(nodes: Nodes, geometry, *names: str) -> bpy.types.NodeSocket:
    """Drop attributes that have done their part: less to copy and to keep."""
    for name in names:
        geometry = nodes.add("GeometryNodeRemoveAttribute", {"Geometry": geometry, "Name": name}).outputs[0]
    return geometry


def _dressed(nodes: Nodes, geometry, material: bpy.types.Material) -> bpy.types.NodeSocket:
    return nodes.add("GeometryNodeSetMaterial", {"Geometry": geometry, "Material": material}).outputs[0]


def _instances(nodes: Nodes, points, mesh, rotation, scale) -> bpy.types.NodeSocket:
    return nodes.add(
        "GeometryNodeInstanceOnPoints", {"Points": points, "Instance": mesh, "Rotation": rotation, "Scale": scale}
    ).outputs[0]


def _one_mesh(nodes: Nodes, instances) -> bpy.types.NodeSocket:
    """For renders: a ray crosses dozens of Gaussians, and Cycles finds overlapping instances far more slowly."""
    return nodes.add("GeometryNodeRealizeInstances", {"Geometry": instances}).outputs[0]


def _ellipsoids(nodes: Nodes, points) -> bpy.types.NodeSocket:
    """In renders meshes, of which a ray crosses few; in the viewport the points around them, a tenth of the work."""
    points = _without(nodes, points, "gs_velocity", "gs_gas_velocity")
    close = _balls(nodes, points, EXTENT, 2)
    quick = _around(nodes, points) if compat.EEVEE_DRAWS_POINTS else _balls(nodes, points, ICOSAHEDRON_RADIUS, 1)
    return nodes.choose("GEOMETRY", nodes.add("GeometryNodeIsViewport").outputs[0], close, quick)


def _balls(nodes: Nodes, points, radius: float, subdivisions: int) -> bpy.types.NodeSocket:
    """Meshes close to the ellipsoids."""
    ball = nodes.add("GeometryNodeMeshIcoSphere", {"Radius": radius, "Subdivisions": subdivisions}).outputs["Mesh"]
    ball = nodes.store(ball, "gs_local", "FLOAT_VECTOR", nodes.add("GeometryNodeInputPosition").outputs[0])
    turn, scale = nodes.named("gs_euler", "FLOAT_VECTOR"), nodes.named("gs_scale", "FLOAT_VECTOR")
    balls = _one_mesh(nodes, _instances(nodes, points, ball, turn, scale))
    return _dressed(nodes, balls, gaussian_material.ellipsoids(f"{NAME} Ellipsoids"))


def _around(nodes: Nodes, points) -> bpy.types.NodeSocket:
    """Return points as large as the ellipsoids are long; the material draws the ellipsoids in them."""
    sides = nodes.add("ShaderNodeSeparateXYZ", {"Vector": nodes.named("gs_scale", "FLOAT_VECTOR")}).outputs
    longest = nodes.math("MAXIMUM", nodes.math("MAXIMUM", sides[0], sides[1]), sides[2])
    radius = nodes.math("MULTIPLY", longest, EXTENT)
    points = nodes.add("GeometryNodeSetPointRadius", {"Points": points, "Radius": radius}).outputs[0]
    points = nodes.store(points, "gs_center", "FLOAT_VECTOR", nodes.add("GeometryNodeInputPosition").outputs[0])
    return _dressed(nodes, points, gaussian_material.ellipsoids_in_points(f"{NAME} Ellipsoids in Points"))


def _splats(nodes: Nodes, points) -> bpy.types.NodeSocket:
    """Return Blender's own Gaussian splats: points with certain attributes.

    Cycles takes a splat's colour for display sRGB, also above 1, and blends its linear light.
    """
    light = nodes.vector("MAXIMUM", nodes.named("gs_color", "FLOAT_COLOR"), (0.0, 0.0, 0.0))
    faint, bright = nodes.vector("MINIMUM", light, (0.0031308,) * 3), nodes.vector("MAXIMUM", light, (0.0031308,) * 3)
    # sRGB is 12.92 light up to there, where both parts are 0.04045, and 1.055 light^(1 / 2.4) - 0.055 from there on.
    power = nodes.vector("SCALE", nodes.vector("POWER", bright, (1 / 2.4,) * 3), Scale=1.055)
    shown = nodes.vector("ADD", nodes.vector("SCALE", faint, Scale=12.92), power)
    radiance = nodes.vector("SCALE", nodes.vector("SUBTRACT", shown, (0.055 + 0.04045 + 0.5,) * 3), Scale=1 / C0)
    sides = nodes.add("ShaderNodeSeparateXYZ", {"Vector": radiance}).outputs
    color = {"Red": sides[0], "Green": sides[1], "Blue": sides[2], "Alpha": nodes.named("gs_alpha", "FLOAT")}
    turn = nodes.add("FunctionNodeEulerToRotation", {"Euler": nodes.named("gs_euler", "FLOAT_VECTOR")}).outputs[0]
    points = nodes.store(points, "scale", "FLOAT_VECTOR", nodes.named("gs_scale", "FLOAT_VECTOR"))
    points = nodes.store(points, "rotation", "QUATERNION", turn)
    # Nodes cannot store its own type, FLOAT4; Cycles takes this one.
    base = nodes.add("FunctionNodeCombineColor", color).outputs[0]
    points = nodes.store(points, "radiance:base", "FLOAT_COLOR", base)
    points = _without(nodes, points, *SHAPES, "gs_color", "gs_alpha")
    return nodes.add("GeometryNodePointsSetType", {"Points": points, "Type": "3D Gaussian Splat"}).outputs[0]


def _arrows(nodes: Nodes, points, given) -> bpy.types.NodeSocket:
    """From the centre, as long as the way of the gas in Line Time seconds."""
    velocity, true = nodes.named("gs_gas_velocity", "FLOAT_VECTOR"), nodes.named("gs_true_velocity", "FLOAT_VECTOR")
    shown = nodes.choose("VECTOR", given["Arrows Show"], velocity, true, nodes.vector("SUBTRACT", velocity, true))
    shaft = _cone(nodes, bottom=0.03, top=0.03, depth=0.7)
    head = nodes.add(
        "GeometryNodeTransform", {"Geometry": _cone(nodes, bottom=0.09, top=0.0, depth=0.3), "Translation": (0, 0, 0.7)}
    ).outputs[0]
    mesh = nodes.add("GeometryNodeJoinGeometry")
    for part in (shaft, head):
        nodes.plug(mesh, "Geometry", part)
    length = nodes.math("MULTIPLY", nodes.vector("LENGTH", shown, output="Value"), given["Line Time"])
    scale = nodes.add("ShaderNodeCombineXYZ", {"X": length, "Y": length, "Z": length}).outputs[0]
    arrows = _instances(nodes, points, mesh.outputs[0], _towards(nodes, shown), scale)
    return _without(nodes, arrows, "velocity")  # an arrow is a sign, and no sign is blurred


def _streaks(nodes: Nodes, points, given, velocity) -> bpy.types.NodeSocket:
    """Return the way of the centre in the last Line Time seconds; thinner than the Gaussian."""
    mesh = nodes.add(
        "GeometryNodeTransform", {"Geometry": _cone(nodes, bottom=0.0, top=0.3, depth=1.0), "Translation": (0, 0, -1.0)}
    ).outputs[0]
    thick = _mean_scale(nodes)
    length = nodes.math("MULTIPLY", nodes.vector("LENGTH", velocity, output="Value"), given["Line Time"])
    scale = nodes.add("ShaderNodeCombineXYZ", {"X": thick, "Y": thick, "Z": length}).outputs[0]
    return _instances(nodes, points, mesh, _towards(nodes, velocity), scale)


def _lines(nodes: Nodes, instances, material, of_instances) -> bpy.types.NodeSocket:
    """In renders one mesh; in the viewport instances, which take a quarter of the memory and are drawn as quickly."""
    instances = _without(nodes, instances, *SHAPES)
    mesh = _dressed(nodes, _one_mesh(nodes, instances), material)
    if not compat.EEVEE_DRAWS_POINTS:  # not tried with the EEVEE of before
        return mesh
    quick = _dressed(nodes, instances, of_instances)
    return nodes.choose("GEOMETRY", nodes.add("GeometryNodeIsViewport").outputs[0], mesh, quick)


def _cone(nodes: Nodes, bottom: float, top: float, depth: float) -> bpy.types.NodeSocket:
    """Build a cone of three sides: it glows alike on all of them, and every corner is there a hundred thousand
    times."""
    return nodes.add(
        "GeometryNodeMeshCone", {"Vertices": 3, "Radius Bottom": bottom, "Radius Top": top, "Depth": depth}
    ).outputs["Mesh"]


def _towards(nodes: Nodes, direction) -> bpy.types.NodeSocket:
    node = compat.align_node(nodes.tree)
    nodes.plug(node, "Vector", direction)
    return node.outputs["Rotation"]
