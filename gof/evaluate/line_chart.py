"""A small line chart as SVG text: logarithmic axes, one line per series."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path

from gof.files import atomic_path

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 560, 340, 70, 20, 34, 52
COLOURS = ("#c2410c", "#1d4ed8", "#15803d", "#7e22ce", "#0e7490", "#a16207", "#be185d", "#475569")
COLOURS += ("#84cc16", "#38bdf8", "#f472b6", "#854d0e", "#a78bfa")


Series = dict[str, list[tuple[float, float, str]]]


def write(path: Path, title: str, x_label: str, y_label: str, series: Series) -> None:
    """Write a chart to a file; as `draw`."""
    with atomic_path(path) as temporary:
        temporary.write_text(draw(title, x_label, y_label, series))


def draw(title: str, x_label: str, y_label: str, series: Series) -> str:
    """A chart; a point is (x, y, label), x and y > 0 (others are left out). The legend stands below."""
    series = {name: [p for p in points if p[0] > 0 and p[1] > 0] for name, points in series.items()}
    everything = [point for points in series.values() for point in points]
    x_low, x_high = _range([p[0] for p in everything])
    y_low, y_high = _range([p[1] for p in everything])

    def place(x: float, y: float) -> tuple[float, float]:
        across = (math.log10(x) - x_low) / (x_high - x_low)
        up = (math.log10(y) - y_low) / (y_high - y_low)
        return LEFT + across * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM)

    page = HEIGHT + 16 * len(series) + 4
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {page}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH}" height="{page}" fill="white"/>',
        f'<text x="{LEFT}" y="20" font-size="14" font-weight="bold">{escape(title)}</text>',
        f'<text x="{(LEFT + WIDTH) / 2}" y="{HEIGHT - 10}" text-anchor="middle">{escape(x_label)}</text>',
        f'<text transform="translate(16 {HEIGHT / 2}) rotate(-90)" text-anchor="middle">{escape(y_label)}</text>',
    ]
    for value in _ticks(x_low, x_high):
        x, _ = place(value, 10**y_low)
        parts.append(
            f'<path d="M{x:.1f} {TOP}V{HEIGHT - BOTTOM}" stroke="#ddd"/>'
            f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{value:.6g}</text>'
        )
    for value in _ticks(y_low, y_high):
        _, y = place(10**x_low, value)
        parts.append(
            f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" stroke="#ddd"/>'
            f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:.6g}</text>'
        )
    for index, (name, points) in enumerate(series.items()):
        colour, at = COLOURS[index % len(COLOURS)], [place(p[0], p[1]) for p in points]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in at)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
        for (x, y), point in zip(at, points, strict=True):
            side, anchor = (6, "start") if x < 0.8 * WIDTH else (-6, "end")
            parts.append(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>'
                f'<text x="{x + side:.1f}" y="{y - 6:.1f}" text-anchor="{anchor}" fill="{colour}">'
                f"{escape(point[2])}</text>"
            )
        parts.append(f'<text x="{LEFT}" y="{HEIGHT + 6 + 16 * index}" fill="{colour}">{escape(name)}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _range(values: list[float]) -> tuple[float, float]:
    """Limits of a logarithmic axis (powers of ten as real numbers), with some room."""
    low, high = math.log10(min(values, default=1.0)), math.log10(max(values, default=10.0))
    room = max(0.06 * (high - low), 0.02)
    return low - room, high + room


def _ticks(low: float, high: float) -> list[float]:
    """1, 2, 5 of every decade; with many decades only some powers of ten; within one decade even steps."""
    decades = range(math.floor(low), math.ceil(high) + 1)
    steps = (1, 2, 5) if high - low < 2.5 else (1,)
    if high - low > 8:
        decades = [e for e in decades if e % 4 == 0]
    ticks = [m * 10.0**e for e in decades for m in steps if low <= math.log10(m) + e <= high]
    if len(ticks) > 2:
        return ticks
    span = 10**high - 10**low
    unit = 10.0 ** math.floor(math.log10(span / 2))
    step = next(m * unit for m in (1, 2, 5, 10) if span / (m * unit) <= 6)
    return [k * step for k in range(math.ceil(10**low / step), math.floor(10**high / step) + 1) if k > 0]
