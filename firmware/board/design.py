"""The LED board's driver as data: parts, where they stand (mm, y down), and which pads are one net.

The pins are those of firmware/esp-idf (ESP32-S3); nothing in the firmware changes with this board.
"""

from __future__ import annotations

from dataclasses import dataclass, field

SIZE = (99.06, 81.28)
HOLES = ((4.445, 76.835), (94.615, 76.835), (94.615, 4.445), (4.445, 36.195))  # M3
STRIP_PINS = (1, 2, 4, 5, 6)
GRAY_PINS = (7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 21, 38, 39)
D_PIN = 40
# Which GPIO stands at which pin of an ESP32-S3-DevKitC-1's two headers, from the antenna's end to the USB sockets.
LEFT = ("3V3", "3V3", "RST", 4, 5, 6, 7, 15, 16, 17, 18, 8, 3, 46, 9, 10, 11, 12, 13, 14, "5V", "GND")
RIGHT = ("GND", "TX", "RX", 1, 2, 42, 41, 40, 39, 38, 37, 36, 35, 0, 45, 48, 47, 21, 20, 19, "GND", "GND")
ROWS_APART = 22.86  # between the headers
# GPIOs of the two drivers' channels 1 to 8, in the order in which they stand above them.
CHANNELS = ((8, 9, 10, 11, 21, 12, 13, 14), (7, 40, 15, 39, 16, 38, 17, 18))
WIDE = {"GND": 0.8, "+5V": 0.8, "VSTRIP": 1.0, **{f"DRAIN{k}": 1.0 for k in range(5)}}  # track widths, mm
NARROW = 0.3


@dataclass(frozen=True)
class Pad:
    """A pad of a part: place on the board, size (w, h), drill (0 = on the front only), net."""

    number: str
    xy: tuple[float, float]
    size: tuple[float, float]
    drill: float
    net: str


@dataclass(frozen=True)
class Part:
    """A part: reference, value, its order text for the bill of materials, pads, outline (x0, y0, x1, y1)."""

    ref: str
    value: str
    order: str
    pads: tuple[Pad, ...]
    outline: tuple[float, float, float, float]
    labels: tuple[tuple[str, float, float], ...] = field(default=())


def output_name(gpio: int) -> str:
    """What an output drives: "S0" a strip, "G0" a Gray bit, "D" the disambiguation LED."""
    if gpio == D_PIN:
        return "D"
    return f"S{STRIP_PINS.index(gpio)}" if gpio in STRIP_PINS else f"G{GRAY_PINS.index(gpio)}"


def through(number: object, x: float, y: float, net: str, size: float = 1.6, drill: float = 1.0) -> Pad:
    return Pad(str(number), (round(x, 4), round(y, 4)), (size, size), drill, net)


def parts() -> list[Part]:
    """All parts of the board."""
    return [module(), *drivers(), *strips(), *power()]


def pin_net(at: str | int) -> str:
    """The net of a header's pin; "" of one that is left free."""
    if at == "GND":
        return "GND"
    if at == "5V":
        return "MODULE_5V"
    used = at in (*STRIP_PINS, *GRAY_PINS, D_PIN)
    return f"OUT_{output_name(at)}" if used else ""


def module() -> Part:
    """Sockets for the ESP32-S3-DevKitC-1, USB sockets to the left."""
    pads = []
    for side, y, names in (("L", 7.62, LEFT), ("R", 7.62 + ROWS_APART, RIGHT)):
        for k, at in enumerate(names):
            pads.append(through(f"{side}{k + 1}", 5.08 + (21 - k) * 2.54, y, pin_net(at)))
    return Part(
        "U1",
        "ESP32-S3-DevKitC-1",
        "ESP32-S3-DevKitC-1 on two 1x22 sockets, 2.54 mm",
        tuple(pads),
        (1.0, 6.0, 68.0, 32.1),
        (("< USB", 8.0, 20.0), ("antenna >", 58.0, 20.0)),
    )


def drivers() -> list[Part]:
    """Two ULN2803A, a resistor per LED beneath each channel, and a header for eight LEDs beneath those."""
    found = []
    for u, (x0, channels) in enumerate(zip((10.16, 40.64), CHANNELS, strict=True)):
        names = [output_name(gpio) for gpio in channels]
        pads = []
        for k in range(9):  # pin 1 to the right: channel k + 1 stands at the same place as its output, pin 18 - k
            x = x0 + (8 - k) * 2.54
            pads.append(through(k + 1, x, 40.64, f"OUT_{names[k]}" if k < 8 else "GND", 1.6, 0.8))
            pads.append(through(18 - k, x, 48.26, f"SINK_{names[k]}" if k < 8 else "", 1.6, 0.8))
        outline = (x0 - 1.3, 41.9, x0 + 21.6, 47.0)
        found.append(Part(f"U{u + 2}", "ULN2803A", "ULN2803A, DIP-18, and socket", tuple(pads), outline))
        header, labels = [], []
        for k, name in enumerate(names):
            x = x0 + (8 - k) * 2.54
            rungs = (through(1, x, 53.34, f"SINK_{name}", 1.6, 0.8), through(2, x, 63.5, f"LED_{name}", 1.6, 0.8))
            order = "150 ohm, 1/4 W, axial"
            found.append(Part(f"R{8 * u + k + 1}", "150", order, rungs, (x - 1.0, 55.2, x + 1.0, 61.6)))
            header.append(through(k + 1, x, 69.85, f"LED_{name}"))
            labels.append((name, x, 72.6))
        header.append(through(9, x0, 69.85, "+5V"))
        labels.append(("+", x0, 72.6))
        outline = (x0 - 1.3, 68.5, x0 + 21.7, 71.2)
        order = "1x9 pin header, 2.54 mm: LED cathodes, + is all anodes"
        found.append(Part(f"J{u + 1}", "LEDs", order, tuple(header), outline, tuple(labels)))
    return found


def strips() -> list[Part]:
    """Five MOSFETs with a resistor to the gate and one to ground, and the strips' terminal."""
    found, terminal, labels = [], [through(1, 92.71, 12.7, "VSTRIP", 2.4, 1.3)], [("V+", 97.3, 12.7)]
    for k in range(5):
        y = 8.89 + 10.16 * k
        gate, out = f"GATE{k}", f"OUT_S{k}"
        found += [
            Part(
                f"R{17 + k}",
                "100",
                "100 ohm, 1/4 W, axial",
                (through(1, 71.12, y, out, 1.6, 0.8), through(2, 81.28, y, gate, 1.6, 0.8)),
                (72.9, y - 1.0, 79.5, y + 1.0),
            ),
            Part(
                f"R{22 + k}",
                "10k",
                "10 kohm, 1/4 W, axial",
                (through(1, 71.12, y + 3.81, "GND", 1.6, 0.8), through(2, 81.28, y + 3.81, gate, 1.6, 0.8)),
                (72.9, y + 2.8, 79.5, y + 4.8),
            ),
            Part(
                f"Q{k + 1}",
                "AO3400A",
                "AO3400A, N-MOSFET, SOT-23 (full on at 2.5 V)",
                tuple(
                    Pad(number, (x, round(y + dy, 4)), (1.2, 0.8), 0.0, net)
                    for number, x, dy, net in (
                        ("1", 84.455, 0.0, gate),
                        ("2", 84.455, 1.905, "GND"),
                        ("3", 86.36, 0.9525, f"DRAIN{k}"),
                    )
                ),
                (85.15, y + 0.3, 85.65, y + 1.6),
            ),
        ]
        terminal.append(through(k + 2, 92.71, 17.78 + 5.08 * k, f"DRAIN{k}", 2.4, 1.3))
        labels.append((f"S{k}", 97.3, 17.78 + 5.08 * k))
    order = "1x6 screw terminal, 5.08 mm: V+ of all strips, then strips 0 to 4"
    return [*found, Part("J3", "strips", order, tuple(terminal), (88.4, 10.0, 95.9, 40.8), tuple(labels))]


def power() -> list[Part]:
    """Supply terminal, capacitors, and the two jumpers."""
    names = ("+5V", "GND", "VSTRIP")
    supply = tuple(through(k + 1, 74.93 + 5.08 * k, 76.2, net, 2.4, 1.3) for k, net in enumerate(names))
    marks = tuple((net, 74.93 + 5.08 * k, 72.0) for k, net in enumerate(("5V", "GND", "VS")))
    return [
        Part("J4", "supply", "1x3 screw terminal, 5.08 mm", supply, (72.0, 72.9, 87.9, 79.9), marks),
        Part(
            "C1",
            "470u",
            "470 uF, 16 V, radial, 5 mm",
            (through(1, 74.93, 64.77, "VSTRIP", 1.8, 0.9), through(2, 80.01, 64.77, "GND", 1.8, 0.9)),
            (72.4, 62.2, 82.6, 67.4),
            (("+", 71.2, 64.8),),
        ),
        Part(
            "C2",
            "100n",
            "100 nF, ceramic, 5 mm",
            (through(1, 87.63, 64.77, "+5V", 1.6, 0.8), through(2, 92.71, 64.77, "GND", 1.6, 0.8)),
            (88.9, 63.6, 91.4, 66.0),
        ),
        Part(
            "JP1",
            "5V to module",
            "1x2 pin header and jumper: closed, the supply also runs the module",
            (through(1, 67.31, 69.85, "+5V"), through(2, 67.31, 67.31, "MODULE_5V")),
            (66.0, 66.0, 68.6, 71.2),
        ),
        Part(
            "JP2",
            "5V strips",
            "1x2 pin header and jumper: closed with strips for 5 V, open with strips for 12 V",
            (through(1, 91.44, 71.12, "+5V"), through(2, 93.98, 71.12, "VSTRIP")),
            (90.1, 69.8, 95.3, 72.4),
        ),
    ]


def nets() -> list[str]:
    """Names of all nets, "" aside, in the order of first use."""
    return list(dict.fromkeys(pad.net for part in parts() for pad in part.pads if pad.net))
