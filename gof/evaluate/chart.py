"""Log-log charts as PNG with Pillow alone: a few series of labelled points per panel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

COLORS = ("#0b6fb8", "#c8501e", "#2d8a4e", "#8a4fa8", "#777777")
SIZE, LEFT, RIGHT, TOP, BOTTOM = (760, 560), 84, 20, 96, 58


@dataclass(frozen=True)
class Series:
    label: str
    x: list[float]  # > 0
    y: list[float]  # > 0
    names: list[str]  # one per point
    line: bool = True


def panels(content: list[tuple[str, list[Series]]], x_label: str, y_label: str, columns: int = 2) -> Image.Image:
    """One panel per (title, series); the panels share the horizontal axis."""
    across = _decades([v for _, s in content for one in s for v in one.x])
    rows = -(-len(content) // columns)
    page = Image.new("RGB", (SIZE[0] * columns, SIZE[1] * rows), "white")
    for i, (title, series) in enumerate(content):
        box = (*across, *_decades([v for one in series for v in one.y]))
        page.paste(_panel(title, series, box, x_label, y_label), (SIZE[0] * (i % columns), SIZE[1] * (i // columns)))
    return page


def _decades(values: list[float]) -> tuple[float, float]:
    low, high = np.floor(np.log10(min(values))), np.ceil(np.log10(max(values)))
    return low, max(high, low + 1)


def _panel(title: str, series: list[Series], box, x_label: str, y_label: str) -> Image.Image:
    image = Image.new("RGB", SIZE, "white")
    draw = ImageDraw.Draw(image)
    big, small, tiny = (ImageFont.load_default(size) for size in (19, 14, 11))
    width, height = SIZE[0] - LEFT - RIGHT, SIZE[1] - TOP - BOTTOM

    def at(x: float, y: float) -> tuple[float, float]:
        return (LEFT + (np.log10(x) - box[0]) / (box[1] - box[0]) * width, TOP + (box[3] - np.log10(y)) / (box[3] - box[2]) * height)

    draw.text((LEFT, 10), title, "black", big)
    for decade in np.arange(box[0], box[1] + 1):
        x, _ = at(10.0**decade, 1)
        draw.line([(x, TOP), (x, TOP + height)], "#e4e4e4")
        draw.text((x, TOP + height + 6), f"1e{decade:.0f}", "#444", small, anchor="ma")
    for decade in np.arange(box[2], box[3] + 1, max(1, round((box[3] - box[2]) / 8))):
        _, y = at(1, 10.0**decade)
        draw.line([(LEFT, y), (LEFT + width, y)], "#e4e4e4")
        draw.text((LEFT - 8, y), f"1e{decade:.0f}", "#444", small, anchor="rm")
    draw.text((LEFT + width / 2, SIZE[1] - 26), x_label, "#222", small, anchor="ma")
    side = Image.new("RGBA", (height, 22), (255, 255, 255, 0))
    ImageDraw.Draw(side).text((height / 2, 2), y_label, "#222", small, anchor="ma")
    image.paste(side.rotate(90, expand=True), (4, TOP), side.rotate(90, expand=True))
    for i, one in enumerate(series):
        color = COLORS[i % len(COLORS)]
        points = [at(x, y) for x, y in zip(one.x, one.y, strict=True)]
        if one.line:
            draw.line(points, color, 2)
        for (x, y), name in zip(points, one.names, strict=True):
            draw.ellipse([x - 4, y - 4, x + 4, y + 4], color)
            draw.text((x + 6, y - 4), name, color, tiny, anchor="ls")
        draw.ellipse([LEFT + 2 + 330 * (i % 2), 42 + 22 * (i // 2), LEFT + 12 + 330 * (i % 2), 52 + 22 * (i // 2)], color)
        draw.text((LEFT + 18 + 330 * (i % 2), 39 + 22 * (i // 2)), one.label, "#222", small)
    return image
