"""A cloud as Blender's own Gaussian splats, which 5.3 brings, in motion: a point cloud with certain attributes.

A small node group moves and fades it by the formulas of `gaussian_nodes`. All of it is in the .blend, which plays
without this add-on. The running Blender says how a point cloud becomes splats (`compat.splat_type`).
"""

from __future__ import annotations

import bpy
import numpy as np

from ..core.harmonics import C0
from ..pure.io.cloud import GaussianCloud
from . import compat, gaussian_nodes, point_cloud
from .nodes import Nodes

NAME = "Splats in Motion"
LAYOUT = 1  # raise it when the inputs change
SETTINGS = ("Start Frame", "Time Scale", "Opacity Cut", "Frame Rate")  # of `gaussian_nodes.INPUTS`


def add(cloud: GaussianCloud, name: str, settings: point_cloud.CloudInputs) -> bpy.types.Object:
    """Return an object with the Gaussians as splats, in the current scene, timed as another cloud is.

    Raises RuntimeError: this Blender has no splats.
    """
    kind = compat.splat_type()
    if kind is None:
        raise RuntimeError("this Blender has no Gaussian splats of its own: they come with 5.3")
    data = bpy.data.pointclouds.new(name)
    data.resize(len(cloud))
    setattr(data, *kind)
    write(data, cloud)
    thing = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(thing)
    mine = point_cloud.add_modifier(thing, NAME, node_group())
    for setting in SETTINGS[:-1]:
        mine[setting] = settings[setting]
    return thing


def write(data: bpy.types.ID, cloud: GaussianCloud) -> None:
    """Write a cloud to a data-block that has as many points; attributes are made where they are not there."""
    alive = cloud.dynamic.astype(np.float32)
    columns = [  # name, type, field, values
        ("position", "FLOAT_VECTOR", "vector", cloud.position),
        ("scale", "FLOAT_VECTOR", "vector", cloud.scale),
        ("rotation", "QUATERNION", "value", cloud.rotation),
        ("gs_radiance", "FLOAT_VECTOR", "vector", (cloud.color - 0.5) / C0),
        ("gs_velocity", "FLOAT_VECTOR", "vector", cloud.velocity * alive[:, None]),
        ("gs_t_mu", "FLOAT", "value", cloud.t_mu),
        # 1 / t_sigma is 0 for "always on", so no infinity enters the node graph.
        ("gs_inverse_t_sigma", "FLOAT", "value", np.minimum(alive / cloud.t_sigma, point_cloud.LONGEST)),
        ("gs_opacity", "FLOAT", "value", cloud.opacity),
    ]
    if cloud.begin is not None:
        columns += [("gs_begin", "FLOAT", "value", cloud.begin), ("gs_end", "FLOAT", "value", cloud.end)]
    for name, kind, field, values in columns:
        attribute = data.attributes.get(name) or data.attributes.new(name, kind, "POINT")
        attribute.data.foreach_set(field, np.ascontiguousarray(values, np.float32).ravel())
    data.update_tag()


def node_group() -> bpy.types.NodeTree:
    """Return the file's node group of this layout; made when there is none."""
    for tree in bpy.data.node_groups:
        if tree.get("gof_splats") == LAYOUT and set(SETTINGS) <= set(compat.input_sockets(tree)):
            return tree
    tree = gaussian_nodes.new_group(NAME, SETTINGS)
    tree["gof_splats"] = LAYOUT
    nodes = Nodes(tree)
    given = nodes.add("NodeGroupInput").outputs
    time, age = gaussian_nodes.clock(nodes, given)
    alpha = gaussian_nodes.opacity(nodes, time, age)
    faint = nodes.math("LESS_THAN", alpha, given["Opacity Cut"])
    splats = nodes.add(
        "GeometryNodeDeleteGeometry", {"Geometry": given["Geometry"], "Selection": faint}, domain="POINT"
    ).outputs[0]
    sides = nodes.add("ShaderNodeSeparateXYZ", {"Vector": nodes.named("gs_radiance", "FLOAT_VECTOR")}).outputs
    radiance = nodes.add(
        "FunctionNodeCombineColor", {"Red": sides[0], "Green": sides[1], "Blue": sides[2], "Alpha": alpha}
    ).outputs[0]
    velocity = nodes.named("gs_velocity", "FLOAT_VECTOR")
    splats = nodes.store(splats, "radiance:base", "FLOAT_COLOR", radiance)  # nodes know no FLOAT4; Cycles takes this
    splats = nodes.store(splats, "velocity", "FLOAT_VECTOR", nodes.vector("SCALE", velocity, Scale=given["Time Scale"]))
    moved = nodes.vector("SCALE", velocity, Scale=age)
    splats = nodes.add("GeometryNodeSetPosition", {"Geometry": splats, "Offset": moved}).outputs[0]
    nodes.add("NodeGroupOutput", {"Geometry": splats})
    return tree
