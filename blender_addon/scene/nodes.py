"""Short way to write node graphs: every call adds a node."""

from __future__ import annotations

import bpy


class Nodes:
    """Writes nodes into a tree. Values are constants, or output sockets to link from."""

    def __init__(self, tree: bpy.types.NodeTree):
        self.tree = tree

    def add(self, kind: str, inputs: dict | None = None, **properties) -> bpy.types.Node:
        """Return a node of type `kind`; `inputs` by name, or by index where names repeat."""
        node = self.tree.nodes.new(kind)
        for key, value in properties.items():
            setattr(node, key, value)
        for key, value in (inputs or {}).items():
            self.plug(node, key, value)
        return node

    def plug(self, node: bpy.types.Node, key: str | int, value) -> None:
        """Set or link one input."""
        socket = node.inputs[key] if isinstance(key, int) else pick(node.inputs, key)
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def math(self, operation: str, *values) -> bpy.types.NodeSocket:
        return self.add("ShaderNodeMath", dict(enumerate(values)), operation=operation).outputs[0]

    def vector(self, operation: str, *values, output: str = "Vector", **named) -> bpy.types.NodeSocket:
        node = self.add("ShaderNodeVectorMath", dict(enumerate(values)) | named, operation=operation)
        return node.outputs[output]

    def named(self, name: str, kind: str) -> bpy.types.NodeSocket:
        """Return a named attribute in geometry nodes; 0 where it does not exist."""
        return pick(self.add("GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind).outputs, "Attribute")

    def store(self, geometry, name: str, kind: str, value, domain: str = "POINT") -> bpy.types.NodeSocket:
        return self.add(
            "GeometryNodeStoreNamedAttribute",
            {"Geometry": geometry, "Name": name, "Value": value},
            data_type=kind,
            domain=domain,
        ).outputs["Geometry"]

    def equal(self, whole, number: int) -> bpy.types.NodeSocket:
        """Return whether an integer is `number`."""
        return self.add("FunctionNodeCompare", {"A": whole, "B": number}, data_type="INT", operation="EQUAL").outputs[
            "Result"
        ]

    def choose(self, kind: str, whole, *choices) -> bpy.types.NodeSocket:
        """choices[whole]; the first for any other integer. Only what is chosen is evaluated."""
        chosen = choices[0]
        for number, choice in enumerate(choices[1:], 1):
            node = self.add("GeometryNodeSwitch", {}, input_type=kind)
            for key, value in (("Switch", self.equal(whole, number)), ("False", chosen), ("True", choice)):
                self.plug(node, key, value)
            chosen = pick(node.outputs, "Output")
        return chosen


def pick(sockets, name: str) -> bpy.types.NodeSocket:
    """Return the socket in use of that name: nodes of several data types have one of each, and all but one disabled.

    Identifiers count too: names get clearer between versions (Fac became Factor in 5.0), identifiers stay.
    """
    return next(socket for socket in sockets if name in (socket.name, socket.identifier) and socket.enabled)
