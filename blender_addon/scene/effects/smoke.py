"""Smoke: soot from the solver, and a shader that absorbs and scatters with its density."""

from __future__ import annotations

from ...pure.effects.smoke import Settings
from ...pure.spec import SceneSpec
from ..fire_objects import FireObjects


def apply(fire: FireObjects, settings: Settings, spec: SceneSpec) -> None:
    fire.domain_settings.flame_smoke = settings.amount * spec.fuel.soot
    nodes, links = fire.material.node_tree.nodes, fire.material.node_tree.links
    density = nodes.new("ShaderNodeAttribute")
    density.attribute_name = "density"
    extinction = nodes.new("ShaderNodeMath")
    extinction.operation = "MULTIPLY"
    extinction.inputs[1].default_value = settings.density
    smoke = nodes.new("ShaderNodeVolumePrincipled")
    smoke.inputs["Color"].default_value = (settings.albedo,) * 3 + (1.0,)
    smoke.inputs["Density Attribute"].default_value = ""
    both = nodes.new("ShaderNodeAddShader")
    output = nodes["Material Output"]
    flame_shader = output.inputs["Volume"].links[0].from_socket
    links.new(density.outputs["Fac"], extinction.inputs[0])
    links.new(extinction.outputs[0], smoke.inputs["Density"])
    links.new(flame_shader, both.inputs[0])
    links.new(smoke.outputs[0], both.inputs[1])
    links.new(both.outputs[0], output.inputs["Volume"])
