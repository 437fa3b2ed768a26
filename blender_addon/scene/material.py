"""Procedural materials: the flame, and surfaces rich in features. No surface emits light, so that the emission pass
holds the flame alone."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..pure.fuels import Fuel
from ..pure.soot import Sheet
from . import compat

Colour = tuple[float, float, float]
FLAME_EXPONENT = 1.3  # dense flame radiates more than in proportion, which leaves the fringe translucent

SHEET_STEP = 0.25
"""Ray-march step through a sheet of soot, over that of the spec: by default half a cell."""


def flame(fuel: Fuel, intensity: float) -> bpy.types.Material:
    """Volume emission of a flame, the same per metre at every size.

    Black-body colour and brightness follow the solver's reaction grid ``flame`` (0..1).
    """
    material, add, link, output = _new("Flame")
    reaction = add("ShaderNodeAttribute")
    reaction.attribute_name = "flame"
    temperature = add("ShaderNodeMapRange")
    temperature.inputs["To Min"].default_value = fuel.colour_low_k
    temperature.inputs["To Max"].default_value = fuel.colour_high_k
    colour = add("ShaderNodeBlackbody")
    tint = add("ShaderNodeVectorMath")
    tint.operation = "MULTIPLY"
    tint.inputs[1].default_value = fuel.tint
    density = add("ShaderNodeMath")
    density.operation = "POWER"
    density.inputs[1].default_value = FLAME_EXPONENT
    strength = add("ShaderNodeMath")
    strength.operation = "MULTIPLY"
    strength.inputs[1].default_value = fuel.radiance * intensity
    emission = add("ShaderNodeEmission")
    link(reaction.outputs["Fac"], temperature.inputs["Value"])
    link(temperature.outputs["Result"], colour.inputs["Temperature"])
    link(reaction.outputs["Fac"], density.inputs[0])
    link(density.outputs[0], strength.inputs[0])
    link(colour.outputs["Color"], tint.inputs[0])
    link(tint.outputs[0], emission.inputs["Color"])
    link(strength.outputs[0], emission.inputs["Strength"])
    link(emission.outputs[0], output.inputs["Volume"])
    return material


def soot_flame(sheet: Sheet, burner_z: float) -> bpy.types.Material:
    """Return a flame that glows, and dims what is behind it, by its soot.

    Args:
        burner_z: z of the burner's lowest place in the coordinates of the object that the material is for.
    """
    material, add, link, output = _new("Flame")
    material.cycles.volume_interpolation = "CUBIC"  # linear shows the grid as a pattern of dots
    material.cycles.volume_step_rate = SHEET_STEP
    reaction = add("ShaderNodeAttribute")
    reaction.attribute_name = "flame"
    place = add("ShaderNodeTexCoord")
    height = add("ShaderNodeSeparateXYZ")
    link(place.outputs["Object"], height.inputs[0])
    sooty = add("ShaderNodeMapRange")
    sooty.interpolation_type = "SMOOTHSTEP"
    sooty.inputs["From Min"].default_value = burner_z
    sooty.inputs["From Max"].default_value = burner_z + (sheet.onset_m or 1e9)
    link(height.outputs["Z"], sooty.inputs["Value"])
    soot, soot_scale = _table(add, link, reaction, sheet.emission, sheet.absorption)
    blue, blue_scale = _table(add, link, reaction, sheet.blue)
    glow, cover, base = add("ShaderNodeEmission"), add("ShaderNodeVolumeAbsorption"), add("ShaderNodeEmission")
    cover.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    link(soot.outputs["Color"], glow.inputs["Color"])
    link(_product(add, link, sooty.outputs["Result"], soot_scale), glow.inputs["Strength"])
    dims = _product(add, link, sooty.outputs["Result"], float(sheet.absorption.max()))
    link(_product(add, link, soot.outputs["Alpha"], dims), cover.inputs["Density"])
    link(blue.outputs["Color"], base.inputs["Color"])
    fresh = add("ShaderNodeMath")
    fresh.operation = "SUBTRACT"
    fresh.inputs[0].default_value = 1.0
    link(sooty.outputs["Result"], fresh.inputs[1])
    link(_product(add, link, fresh.outputs[0], blue_scale), base.inputs["Strength"])
    total = base
    for shader in (cover, glow):
        both = add("ShaderNodeAddShader")
        link(total.outputs[0], both.inputs[0])
        link(shader.outputs[0], both.inputs[1])
        total = both
    link(total.outputs[0], output.inputs["Volume"])
    return material


def _table(add, link, by, colours: np.ndarray, values: np.ndarray | None = None):
    """Return a ramp of (N, 3) colours and (N,) values, each over its largest, by an attribute; and the largest
    colour."""
    ramp = add("ShaderNodeValToRGB")
    elements, count, scale = ramp.color_ramp.elements, len(colours), float(colours.max()) or 1.0
    values = np.ones(count) if values is None else values / (values.max() or 1.0)
    while len(elements) < count:
        elements.new(1.0)
    for index, (colour, value) in enumerate(zip(colours / scale, values, strict=True)):
        elements[index].position = index / (count - 1)
        elements[index].color = (*colour, value)
    link(by.outputs["Fac"], ramp.inputs["Fac"])
    return ramp, scale


def _product(add, link, socket, factor):
    """Return a socket times a number or another socket."""
    node = add("ShaderNodeMath")
    node.operation = "MULTIPLY"
    link(socket, node.inputs[0])
    if isinstance(factor, float):
        node.inputs[1].default_value = factor
    else:
        link(factor, node.inputs[1])
    return node.outputs[0]


def emission_grid(attribute: str, radiance: float) -> bpy.types.Material:
    """Volume emission that a grid of linear RGB states, per metre, times a factor."""
    material, add, link, output = _new("Flame")
    grid = add("ShaderNodeAttribute")
    grid.attribute_name = attribute
    emission = add("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = radiance
    link(grid.outputs["Color"], emission.inputs["Color"])
    link(emission.outputs[0], output.inputs["Volume"])
    return material


def plain(name: str, colour: Colour, roughness: float = 0.6, metallic: float = 0.0) -> bpy.types.Material:
    material, add, link, output = _new(name)
    surface = _principled(add, link, output, roughness, metallic)
    surface.inputs["Base Color"].default_value = (*colour, 1.0)
    return material


def tiles(
    name: str,
    colours: tuple[Colour, Colour],
    joint: Colour,
    size: tuple[float, float],
    gap: float = 0.012,
    shift: float = 0.5,
    stains: float = 0.5,
    roughness: float = 0.8,
) -> bpy.types.Material:
    """Return rows of bricks, planks or tiles of ``size`` (m), each of its own shade, with joints and stains."""
    material, add, link, output = _new(name)
    coordinates = add("ShaderNodeTexCoord")
    bricks = add("ShaderNodeTexBrick")
    bricks.offset = shift
    for socket, value in (
        ("Color1", (*colours[0], 1)),
        ("Color2", (*colours[1], 1)),
        ("Mortar", (*joint, 1)),
        ("Scale", 1.0),
        ("Mortar Size", gap),
        ("Mortar Smooth", 0.1),
        ("Brick Width", size[0]),
        ("Row Height", size[1]),
    ):
        bricks.inputs[socket].default_value = value
    stain = add("ShaderNodeTexNoise")
    stain.inputs["Scale"].default_value = 3.0 / min(size)
    stain.inputs["Detail"].default_value = 4.0
    darken = add("ShaderNodeMapRange")
    for socket, value in (
        ("From Min", 0.35),
        ("From Max", 0.65),
        ("To Min", 1.0 - stains),
        ("To Max", 1.0 + stains / 2),
    ):
        darken.inputs[socket].default_value = value
    product = add("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    surface = _principled(add, link, output, roughness)
    link(coordinates.outputs["UV"], bricks.inputs["Vector"])
    link(coordinates.outputs["UV"], stain.inputs["Vector"])
    link(stain.outputs["Fac"], darken.inputs["Value"])
    link(bricks.outputs["Color"], product.inputs[0])
    link(darken.outputs["Result"], product.inputs[1])
    link(product.outputs[0], surface.inputs["Base Color"])
    return material


def _bands(add, colours: Sequence[Colour], low: float, high: float):
    """Return a colour ramp in steps: the first colour from 0 on, the others evenly between low and high."""
    ramp = add("ShaderNodeValToRGB")
    ramp.color_ramp.interpolation = "CONSTANT"
    elements = ramp.color_ramp.elements
    while len(elements) < len(colours):
        elements.new(0.5)
    for index, colour in enumerate(colours):
        elements[index].position = low + (high - low) * index / len(colours) if index else 0.0
        elements[index].color = (*colour, 1.0)
    return ramp


def blotches(name: str, colours: Sequence[Colour], scale: float) -> bpy.types.Material:
    """Sharp-edged coloured cells of about 1/scale metres, like a print, a terrazzo floor or peeling paint."""
    material, add, link, output = _new(name)
    coordinates = add("ShaderNodeTexCoord")
    cells = add("ShaderNodeTexVoronoi")
    cells.inputs["Scale"].default_value = scale
    pick = add("ShaderNodeSeparateColor")
    ramp = _bands(add, colours, 0.0, 1.0)
    surface = _principled(add, link, output, 0.7)
    link(coordinates.outputs["UV"], cells.inputs["Vector"])
    link(cells.outputs["Color"], pick.inputs["Color"])
    link(pick.outputs["Red"], ramp.inputs["Fac"])
    link(ramp.outputs["Color"], surface.inputs["Base Color"])
    return material


def landscape(name: str, colours: Sequence[Colour], scale: float, roughness: float = 0.8) -> bpy.types.Material:
    """Coloured areas with winding borders of about 1/scale metres, like a map or a faded painting."""
    material, add, link, output = _new(name)
    coordinates = add("ShaderNodeTexCoord")
    ground = add("ShaderNodeTexNoise")
    ground.inputs["Scale"].default_value = scale
    ground.inputs["Detail"].default_value = 5.0
    ground.inputs["Distortion"].default_value = 0.8
    ramp = _bands(add, colours, 0.34, 0.7)  # where most of the noise's values are
    surface = _principled(add, link, output, roughness)
    link(coordinates.outputs["UV"], ground.inputs["Vector"])
    link(ground.outputs["Fac"], ramp.inputs["Fac"])
    link(ramp.outputs["Color"], surface.inputs["Base Color"])
    return material


def print_work(name: str, paint: Colour, paper: Colour, ink: Colour, size: tuple[float, float]) -> bpy.types.Material:
    """Paint with bands of printed labels of about ``size`` (m), whose lines look like words."""
    material, add, link, output = _new(name)
    coordinates = add("ShaderNodeTexCoord")
    words = add("ShaderNodeTexBrick")
    words.offset, words.squash, words.squash_frequency = 0.37, 0.6, 3
    for socket, value in (
        ("Color1", (*ink, 1)),
        ("Color2", (*paper, 1)),
        ("Mortar", (*paper, 1)),
        ("Scale", 1.0),
        ("Bias", -0.1),
        ("Mortar Size", 0.0055),
        ("Mortar Smooth", 0.0),
        ("Brick Width", 0.05),
        ("Row Height", 0.022),
    ):
        words.inputs[socket].default_value = value
    bands = add("ShaderNodeTexBrick")
    bands.offset = 0.5
    for socket, value in (
        ("Color2", (*paint, 1)),
        ("Mortar", (*(0.35 * shade for shade in paint), 1)),
        ("Scale", 1.0),
        ("Bias", 0.4),
        ("Mortar Size", 0.008),
        ("Mortar Smooth", 0.0),
        ("Brick Width", size[0]),
        ("Row Height", size[1]),
    ):
        bands.inputs[socket].default_value = value
    surface = _principled(add, link, output, 0.5)
    link(coordinates.outputs["UV"], words.inputs["Vector"])
    link(coordinates.outputs["UV"], bands.inputs["Vector"])
    link(words.outputs["Color"], bands.inputs["Color1"])
    link(bands.outputs["Color"], surface.inputs["Base Color"])
    return material


def _new(name: str):
    material = bpy.data.materials.new(name)
    tree = compat.add_nodes(material)
    nodes, links = tree.nodes, tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.name = "Material Output"
    return material, nodes.new, links.new, output


def _principled(add, link, output, roughness: float, metallic: float = 0.0):
    surface = add("ShaderNodeBsdfPrincipled")
    surface.inputs["Roughness"].default_value = roughness
    surface.inputs["Metallic"].default_value = metallic
    link(surface.outputs[0], output.inputs["Surface"])
    return surface
