"""Writes the driver board's KiCad files and its bill of materials: `python firmware/board/make.py OUT`.

Then `python3 firmware/board/fabricate.py OUT`, with the Python that has KiCad's pcbnew, checks the board and plots it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from design import HOLES, NARROW, SIZE, WIDE, Part, nets, parts
from kicad import pcb, schematic
from route import Copper, route

NAME = "gof_board_driver"
# What is ordered beside the circuit board's own parts.
BESIDE = (
    ("LED, 5 mm, white (infrared: 850 nm, same resistors)", "", 16),
    ("COB LED strip, 5 V or 12 V, 6.4 marker sides long (infrared: 850 nm strip)", "", 5),
    ("battery: USB power bank of 5 V, 2 A, and a cable with open ends (5 V strips)", "", 1),
    ("M3 screws and spacers", "", 8),
    ("printed front, and rails twice (holder.py)", "", 1),
)


def bill(found: list[Part]) -> str:
    """CSV: what to order, which parts it is, how many."""
    rows: dict[str, list[str]] = {}
    for part in found:
        rows.setdefault(part.order, []).append(part.ref)
    lines = ['"what","parts","count"']
    lines += [f'"{order}","{" ".join(refs)}",{len(refs)}' for order, refs in rows.items()]
    lines += [f'"{what}","{refs}",{count}' for what, refs, count in BESIDE]
    return "\n".join([*lines, ""])


def copper(found: list[Part]) -> list[Copper]:
    """The pads as the router sees them: discs around them, on both sides where they are drilled."""
    pads = []
    for part in found:
        for pad in part.pads:
            round_ = pad.drill and pad is not part.pads[0]  # first pads are square
            half = (max(pad.size) if round_ else float(np.hypot(*pad.size))) / 2
            net = pad.net or f"free {part.ref} {pad.number}"
            pads.append(Copper(net, pad.xy, pad.xy, half, (0, 1) if pad.drill else (0,)))
    return pads


def main() -> None:
    """Route the board and write everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    found = parts()
    tracks, vias = route(SIZE, [(x, y, 1.6) for x, y in HOLES], copper(found), WIDE, NARROW)
    (out / f"{NAME}.kicad_pcb").write_text(pcb(found, nets(), tracks, vias), encoding="utf-8")
    (out / f"{NAME}.kicad_sch").write_text(schematic(found), encoding="utf-8")
    (out / "bom.csv").write_text(bill(found), encoding="utf-8")
    print(f"{len(found)} parts, {len(nets())} nets, {len(tracks)} tracks, {len(vias)} vias -> {out}")


if __name__ == "__main__":
    main()
