"""Differences between Blender's versions, decided by what the running one has. No other module checks versions."""

from __future__ import annotations

import bpy

HAS_DROP = hasattr(bpy.types, "FileHandler")  # files dropped on a window: 4.1 and later
EEVEE_DRAWS_POINTS = "surface_render_method" in bpy.types.Material.bl_rna.properties
"""EEVEE of 4.2 and later; that of 3.4 draws none, and those between were not tried."""
HAS_SPLATS = hasattr(bpy.types, "GeometryNodePointsSetType")  # Gaussian splats of Blender's own: 5.3 and later
BLEND_PATH = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5) else set()
"""Options of a path that may begin with //; since 4.5 one without them warns."""
LINEAR_COLOR_SPACES = ("Linear Rec.709", "Linear")  # the second up to 3.6


def has_function(kind: str, name: str) -> bool:
    """Return whether things of a type, such as "PointCloud", have a function. Their class itself never shows Blender's
    own."""
    rna = getattr(getattr(bpy.types, kind, None), "bl_rna", None)
    return rna is not None and name in rna.functions


def curves(object_: bpy.types.Object) -> list[bpy.types.FCurve]:
    """Return the curves of what is keyed or driven on an object itself, strips of the NLA among it; none where nothing
    is."""
    data = object_.animation_data
    if data is None:
        return []
    strips = [strip.action for track in data.nla_tracks if not track.mute for strip in track.strips if not strip.mute]
    return [*data.drivers, *(curve for action in (data.action, *strips) if action for curve in _curves_of(action))]


def _curves_of(action: bpy.types.Action) -> list[bpy.types.FCurve]:
    if hasattr(action, "fcurves"):  # until Blender 4.5
        return list(action.fcurves)
    return [
        curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves
    ]


def add_nodes(block: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    """Return the node tree of a material or a world that was just made."""
    if block.node_tree is None:  # from Blender 5 on each is made with one, and `use_nodes` is to go
        block.use_nodes = True
    return block.node_tree


def add_socket(tree: bpy.types.NodeTree, name: str, kind: str, output: bool = False) -> bpy.types.bpy_struct:
    """Return a new input (or output) of a node group; `kind` such as "NodeSocketFloat"."""
    if hasattr(tree, "interface"):
        return tree.interface.new_socket(name, in_out="OUTPUT" if output else "INPUT", socket_type=kind)
    return (tree.outputs if output else tree.inputs).new(kind, name)


def input_sockets(tree: bpy.types.NodeTree) -> dict[str, bpy.types.bpy_struct]:
    """Return inputs of a node group by name; for their values in a modifier see `modifier_value`."""
    if hasattr(tree, "interface"):
        return {
            item.name: item
            for item in tree.interface.items_tree
            if item.item_type == "SOCKET" and item.in_out == "INPUT"
        }
    return {item.name: item for item in tree.inputs}


def modifier_value(modifier: bpy.types.Modifier, identifier: str) -> tuple[bpy.types.bpy_struct, str]:
    """Return where a modifier of nodes keeps the value of an input: the owner, and the property's name as layouts take
    it."""
    if hasattr(modifier, "properties"):  # 5.2 and later
        return getattr(modifier.properties.inputs, identifier), "value"
    return modifier, f'["{identifier}"]'


def modifier_path(modifier: bpy.types.Modifier, identifier: str) -> str:
    """Return path from the object to that value, for drivers and keyframes."""
    path = f'modifiers["{modifier.name}"]'
    if hasattr(modifier, "properties"):
        return f"{path}.properties.inputs.{identifier}.value"
    return f'{path}["{identifier}"]'


def scene_variable(driver: bpy.types.Driver, name: str, path: str, scene: bpy.types.Scene) -> None:
    """Add a driver variable that reads `path` of the scene.

    The scene in use where Blender has that, so that the object can be appended elsewhere without pulling its first
    scene along; else this very scene.
    """
    variable = driver.variables.new()
    variable.name = name
    if "CONTEXT_PROP" in variable.bl_rna.properties["type"].enum_items:
        variable.type = "CONTEXT_PROP"
        variable.targets[0].context_property = "ACTIVE_SCENE"
    else:
        variable.targets[0].id_type = "SCENE"
        variable.targets[0].id = scene
    variable.targets[0].data_path = path


def set_linear(image: bpy.types.Image) -> None:
    """Declare the image's pixels scene-linear light."""
    known = image.colorspace_settings.bl_rna.properties["name"].enum_items
    image.colorspace_settings.name = next(name for name in LINEAR_COLOR_SPACES if name in known)


def see_through(material: bpy.types.Material) -> None:
    """EEVEE shows the material's transparency, by chance per sample, in any order of surfaces."""
    if hasattr(material, "surface_render_method"):
        material.surface_render_method = "DITHERED"
    else:
        material.blend_method = "HASHED"
        material.shadow_method = "NONE"  # later versions ask the object, as Cycles does


def hide_lamp(lamp: bpy.types.Object) -> None:
    """Let a lamp light the scene and be seen nowhere, not in mirrors either."""
    lamp.visible_camera = lamp.visible_glossy = lamp.visible_transmission = False


def align_node(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """Return the node with inputs Factor and Vector that turns the z axis towards a vector, output Rotation."""
    kind = "FunctionNodeAlignRotationToVector"
    node = tree.nodes.new(kind if hasattr(bpy.types, kind) else "FunctionNodeAlignEulerToVector")
    node.axis = "Z"
    return node
