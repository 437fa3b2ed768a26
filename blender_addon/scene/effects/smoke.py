"""Smoke: the flame releases soot that absorbs and scatters light."""

from __future__ import annotations

from dataclasses import dataclass

ABSORBS_LIGHT = True


@dataclass(frozen=True)
class Settings:
    amount: float = 0.5
    """Smoke released per unit of burnt wood; other fuels by their soot."""
    density: float = 8.0
    """Extinction per metre of smoke of density 1."""
    albedo: float = 0.2
    """Scattered fraction of the extinction, 0 (black soot) to 1 (white steam)."""


def apply(fire, settings: Settings, spec) -> None:
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
