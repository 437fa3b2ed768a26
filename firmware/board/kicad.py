"""The driver as KiCad 6 files: a board, and a schematic of the same nets. Text is written as KiCad writes it."""

from __future__ import annotations

import uuid

from design import HOLES, SIZE, Pad, Part
from route import VIA, VIA_DRILL, Copper

LAYERS = {0: "F.Cu", 1: "B.Cu"}
TECHNICAL = (
    "32 B.Adhes",
    "33 F.Adhes",
    "34 B.Paste",
    "35 F.Paste",
    "36 B.SilkS",
    "37 F.SilkS",
    "38 B.Mask",
    "39 F.Mask",
)
NAMES = uuid.UUID(
    "6f5e0d0e-6a53-4a2c-9f3a-1d0f0b0a0c0d"
)  # what the files' identifiers are made from: the same each time


def name(*of: object) -> str:
    return str(uuid.uuid5(NAMES, " ".join(map(str, of))))


def pcb(parts: list[Part], nets: list[str], tracks: list[Copper], vias: list[tuple[str, tuple[float, float]]]) -> str:
    """The .kicad_pcb file."""
    number = {net: k for k, net in enumerate(["", *nets])}
    width, height = SIZE
    out = ["(kicad_pcb (version 20211014) (generator gof_board)", "  (general (thickness 1.6))", '  (paper "A4")']
    out.append('  (layers (0 "F.Cu" signal) (31 "B.Cu" signal)')
    out += [f'    ({k} "{layer}" user)' for k, layer in (entry.split() for entry in TECHNICAL)]
    out.append('    (44 "Edge.Cuts" user) (46 "B.CrtYd" user) (47 "F.CrtYd" user) (48 "B.Fab" user) (49 "F.Fab" user))')
    out.append("  (setup (pad_to_mask_clearance 0))")
    out += [f'  (net {k} "{net}")' for net, k in number.items()]
    for part in parts:
        out += footprint(part, number)
    for k, (x, y) in enumerate(HOLES):
        out.append(
            f'  (footprint "gof:M3" (layer "F.Cu") (tstamp {name("hole", k)}) (at {x} {y})\n'
            "    (attr board_only exclude_from_pos_files exclude_from_bom)\n"
            f'    (fp_text reference "H{k + 1}" (at 0 0) (layer "F.Fab") {FONT})\n'
            f'    (pad "" np_thru_hole circle (at 0 0) (size 3.2 3.2) (drill 3.2) (layers *.Cu *.Mask)))'
        )
    out.append(
        f'  (gr_rect (start 0 0) (end {width} {height}) (layer "Edge.Cuts") (width 0.1) (fill none)'
        f" (tstamp {name('edge')}))"
    )
    out.append(text("gof LED board driver - none built yet", 34.0, 78.6, "title"))
    for k, piece in enumerate(tracks):
        ends = f"(start {piece.a[0]} {piece.a[1]}) (end {piece.b[0]} {piece.b[1]})"
        where = f'(layer "{LAYERS[piece.layers[0]]}") (net {number[piece.net]}) (tstamp {name("track", k)})'
        out.append(f"  (segment {ends} (width {2 * piece.half:g}) {where})")
    for k, (net, (x, y)) in enumerate(vias):
        drill = f'(size {VIA}) (drill {VIA_DRILL}) (layers "F.Cu" "B.Cu") (net {number[net]})'
        out.append(f"  (via (at {x} {y}) {drill} (tstamp {name('via', k)}))")
    corners = " ".join(
        f"(xy {x} {y})" for x, y in ((0.6, 0.6), (width - 0.6, 0.6), (width - 0.6, height - 0.6), (0.6, height - 0.6))
    )
    for layer in LAYERS.values():
        out.append(
            f'  (zone (net {number["GND"]}) (net_name "GND") (layer "{layer}") (tstamp {name("zone", layer)})\n'
            "    (hatch edge 0.5)\n"
            "    (connect_pads (clearance 0.3)) (min_thickness 0.25)\n"
            "    (fill yes (thermal_gap 0.3) (thermal_bridge_width 0.5))\n"
            f"    (polygon (pts {corners})))"
        )
    return "\n".join([*out, ")", ""])


def text(words: str, x: float, y: float, key: str) -> str:
    font = "(effects (font (size 1.1 1.1) (thickness 0.16)))"
    return f'  (gr_text "{words}" (at {x} {y}) (layer "F.SilkS") (tstamp {name("text", key)}) {font})'


def footprint(part: Part, number: dict[str, int]) -> list[str]:
    """One part with its own pads; its origin is its first pad."""
    x0, y0 = part.pads[0].xy
    left, top, right, bottom = part.outline

    def label(kind: str, words: str, x: float, y: float, layer: str) -> str:
        font = "(effects (font (size 0.9 0.9) (thickness 0.14)))"
        return f'    (fp_text {kind} "{words}" (at {x - x0:g} {y - y0:g}) (layer "{layer}") {font})'

    attr = "smd" if not part.pads[0].drill else "through_hole"
    out = [
        f'  (footprint "gof:{part.ref}" (layer "F.Cu") (tstamp {name(part.ref)}) (at {x0} {y0})',
        f"    (attr {attr})",
        label(
            "reference", part.ref, (left + right) / 2, (top + bottom) / 2, "F.SilkS" if right - left > 4 else "F.Fab"
        ),
        label("value", part.value, (left + right) / 2, (top + bottom) / 2 + 1.2, "F.Fab"),
    ]
    out += [label("user", *entry, "F.SilkS") for entry in part.labels]
    corners = f"(start {left - x0:g} {top - y0:g}) (end {right - x0:g} {bottom - y0:g})"
    out.append(f'    (fp_rect {corners} (layer "F.Fab") (width 0.1) (fill none))')
    for pad in part.pads:
        out.append("    " + pad_text(pad, x0, y0, number, pad is part.pads[0]))
    return [*out, "  )"]


def pad_text(pad: Pad, x0: float, y0: float, number: dict[str, int], first: bool) -> str:
    shape = "rect" if first or not pad.drill else "circle"
    kind, drill, layers = (
        ("thru_hole", f" (drill {pad.drill})", "*.Cu *.Mask") if pad.drill else ("smd", "", "F.Cu F.Paste F.Mask")
    )
    net = f' (net {number[pad.net]} "{pad.net}")' if pad.net else ""
    at = f"(at {pad.xy[0] - x0:g} {pad.xy[1] - y0:g}) (size {pad.size[0]} {pad.size[1]})"
    return f'(pad "{pad.number}" {kind} {shape} {at}{drill} (layers {layers}){net})'


# ---- schematic -------------------------------------------------------------------------------------------------------

PITCH = 2.54
FONT = "(effects (font (size 1.27 1.27)))"


def schematic(parts: list[Part]) -> str:
    """The .kicad_sch file: every part a box with its pins, every net a label of the same name at each of its pins."""
    root = name("sheet")
    out = [f'(kicad_sch (version 20211123) (generator gof_board) (uuid {root}) (paper "A2")', "  (lib_symbols"]
    for part in parts:
        out += symbol(part)
    out.append("  )")
    column, row, instances = 40.64, 30.48, []
    for part in parts:
        tall = PITCH * (len(part.pads) + 3)
        if row + tall > 390:
            column, row = column + 76.2, 30.48
        out += placed(part, column, row, root)
        instances.append(
            f'    (path "/{name("symbol", part.ref)}" (reference "{part.ref}") (unit 1) (value "{part.value}")'
            f' (footprint "gof:{part.ref}"))'
        )
        row += tall
    out += ['  (sheet_instances (path "/" (page "1")))', "  (symbol_instances", *instances, "  )", ")", ""]
    return "\n".join(out)


def symbol(part: Part) -> list[str]:
    bottom = -PITCH * len(part.pads)
    out = [f'    (symbol "gof:{part.ref}" (in_bom yes) (on_board yes)']
    for k, (key, value) in enumerate(
        (("Reference", part.ref[0]), ("Value", part.value), ("Footprint", ""), ("Datasheet", ""))
    ):
        out.append(f'      (property "{key}" "{value}" (id {k}) (at 0 0 0) {FONT})')
    out.append(f'      (symbol "{part.ref}_0_1"')
    out.append(
        f"        (rectangle (start 0 {PITCH / 2}) (end 15.24 {bottom + PITCH / 2}) (stroke (width 0.2) (type default)"
        " (color 0 0 0 0)) (fill (type background)))\n      )"
    )
    out.append(f'      (symbol "{part.ref}_1_1"')
    for k, pad in enumerate(part.pads):
        ends = f'(name "{pad.net or "free"}" {FONT}) (number "{pad.number}" {FONT})'
        out.append(f"        (pin passive line (at -5.08 {-PITCH * k} 0) (length 5.08) {ends})")
    return [*out, "      )", "    )"]


def placed(part: Part, x: float, y: float, root: str) -> list[str]:
    out = [
        f'  (symbol (lib_id "gof:{part.ref}") (at {x} {y} 0) (unit 1) (in_bom yes) (on_board yes)',
        f"    (uuid {name('symbol', part.ref)})",
        f'    (property "Reference" "{part.ref}" (id 0) (at {x + 7.62} {y - 3.81:g} 0) {FONT})',
        f'    (property "Value" "{part.value}" (id 1) (at {x + 7.62} {y - 2.0:g} 0) {FONT})',
        f'    (property "Footprint" "gof:{part.ref}" (id 2) (at {x} {y} 0) (effects (font (size 1.27 1.27)) hide))',
        f'    (property "Datasheet" "" (id 3) (at {x} {y} 0) (effects (font (size 1.27 1.27)) hide))',
    ]
    out += [f'    (pin "{pad.number}" (uuid {name("pin", part.ref, pad.number)}))' for pad in part.pads]
    out.append("  )")
    for k, pad in enumerate(part.pads):
        at = f"{x - 5.08:g} {y + PITCH * k:g}"
        if pad.net:
            out.append(
                f'  (global_label "{pad.net}" (shape passive) (at {at} 180) (fields_autoplaced)'
                f" (effects (font (size 1.27 1.27)) (justify right)) (uuid {name('label', part.ref, pad.number)}))"
            )
        else:
            out.append(f"  (no_connect (at {at}) (uuid {name('free', part.ref, pad.number)}))")
    return out
