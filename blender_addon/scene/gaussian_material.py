"""Materials of a cloud: each Gaussian looks as in splatting; arrows and streaks just glow.

On the surface of the ellipsoid at EXTENT standard deviations, a ray that passes the centre at b standard deviations
gets the opacity alpha(t) exp(-b^2 / 2).
"""

from __future__ import annotations

import bpy

from . import compat
from .nodes import Nodes, pick

EXTENT = 2.5  # radius of the shown ellipsoid in standard deviations; the splat has faded to 4 % there


def points(name: str) -> bpy.types.Material:
    """Balls: the normal is the place on the unit ball."""
    material, nodes = _new(name)
    hit = nodes.add("ShaderNodeNewGeometry").outputs
    _splat(nodes, hit, hit["Incoming"], nodes.vector("SCALE", hit["Normal"], Scale=EXTENT))
    return material


def ellipsoids(name: str) -> bpy.types.Material:
    """Ellipsoids: in the Gaussian's own whitened space it is a ball, and lengths count standard deviations."""
    material, nodes = _new(name)
    hit = nodes.add("ShaderNodeNewGeometry").outputs
    ray = _whitened(nodes, _in_object(nodes, hit["Incoming"], "VECTOR"))
    _splat(nodes, hit, ray, _attribute(nodes, "gs_local")["Vector"])
    return material


def ellipsoids_in_points(name: str) -> bpy.types.Material:
    """Ellipsoids drawn on balls around them. Not for motion blur, in which a ball moves and its attributes stay."""
    material, nodes = _new(name)
    hit = nodes.add("ShaderNodeNewGeometry").outputs
    ray = _whitened(nodes, _in_object(nodes, hit["Incoming"], "VECTOR"))
    place = nodes.vector(
        "SUBTRACT", _in_object(nodes, hit["Position"], "POINT"), _attribute(nodes, "gs_center")["Vector"]
    )
    _splat(nodes, hit, ray, _whitened(nodes, place))
    return material


def _whitened(nodes: Nodes, vector) -> bpy.types.NodeSocket:
    """Return a vector of the object's space, along the Gaussian's axes and in its standard deviations."""
    turned = nodes.add(
        "ShaderNodeVectorRotate",
        {"Vector": vector, "Rotation": _attribute(nodes, "gs_euler")["Vector"]},
        rotation_type="EULER_XYZ",
        invert=True,
    ).outputs[0]
    return nodes.vector("DIVIDE", turned, _attribute(nodes, "gs_scale")["Vector"])


def _in_object(nodes: Nodes, vector, kind: str) -> bpy.types.NodeSocket:
    """Return a vector of the world in the object's space."""
    return nodes.add(
        "ShaderNodeVectorTransform",
        {"Vector": vector},
        vector_type=kind,
        convert_from="WORLD",
        convert_to="OBJECT",
    ).outputs[0]


def lines(name: str, attributes_of: str = "GEOMETRY") -> bpy.types.Material:
    """Arrows and streaks, as one mesh or as instances ("INSTANCER"), which have their colors themselves."""
    material, nodes = _new(name)
    nodes.add("ShaderNodeOutputMaterial", {"Surface": _glow(nodes, attributes_of)})
    return material


def _new(name: str) -> tuple[bpy.types.Material, Nodes]:
    material = bpy.data.materials.new(name)
    tree = compat.add_nodes(material)
    tree.nodes.clear()
    compat.see_through(material)
    if hasattr(material, "cycles"):
        # A path towards each of thousands of small lights is slow and noisy; other surfaces still see the flame's glow.
        material.cycles.emission_sampling = "NONE"
    return material, Nodes(tree)


def _attribute(nodes: Nodes, name: str, of: str = "GEOMETRY") -> bpy.types.bpy_prop_collection:
    return nodes.add("ShaderNodeAttribute", attribute_name=name, attribute_type=of).outputs


def _glow(nodes: Nodes, attributes_of: str = "GEOMETRY") -> bpy.types.NodeSocket:
    """Return emission of gs_color as the camera sees it; its fourth value scales the light that falls on everything
    else."""
    color = _attribute(nodes, "gs_color", attributes_of)
    camera = nodes.add("ShaderNodeLightPath").outputs["Is Camera Ray"]
    others = nodes.math("MULTIPLY", nodes.math("SUBTRACT", 1.0, camera), color["Alpha"])
    return nodes.add(
        "ShaderNodeEmission", {"Color": color["Color"], "Strength": nodes.math("ADD", camera, others)}
    ).outputs[0]


def _splat(nodes: Nodes, hit, ray, place) -> None:
    """Set the opacity by the distance of a ray from the centre: exact wherever on a faceted ball it has hit.

    Args:
        ray: its direction, of any length, and `place`: where it hit, both with lengths in standard deviations.
    """
    along = nodes.vector("DOT_PRODUCT", nodes.vector("NORMALIZE", ray), place, output="Value")
    length = nodes.vector("LENGTH", place, output="Value")
    squared = nodes.math("SUBTRACT", nodes.math("MULTIPLY", length, length), nodes.math("MULTIPLY", along, along))
    falloff = nodes.math("EXPONENT", nodes.math("MULTIPLY", squared, -0.5))
    alpha = pick(_attribute(nodes, "gs_alpha"), "Fac")
    front = nodes.math("SUBTRACT", 1.0, hit["Backfacing"])
    inside = nodes.math("LESS_THAN", squared, EXTENT**2)  # what is around an ellipsoid may be much larger
    opacity = nodes.math("MULTIPLY", nodes.math("MULTIPLY", alpha, falloff), nodes.math("MULTIPLY", front, inside))
    clear = nodes.add("ShaderNodeBsdfTransparent").outputs[0]
    mixed = nodes.add("ShaderNodeMixShader", {0: opacity, 1: clear, 2: _glow(nodes)}).outputs[0]
    nodes.add("ShaderNodeOutputMaterial", {"Surface": mixed})
