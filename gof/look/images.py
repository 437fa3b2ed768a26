"""Pictures as all of this room has them: 8 bits, side by side, in a colour map, and as bytes and text inside pages."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from gof.footage.pictures import read_picture

PANEL_WIDTH = 360  # px; small pictures are enlarged to about this by a whole factor
GAP, BETWEEN = 4, 110  # px between panels, and their grey: readable on light and dark pages
VIRIDIS, INFERNO = cv2.COLORMAP_VIRIDIS, cv2.COLORMAP_INFERNO  # of depth and speed; of errors


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Display values (H, W, 3) in [0, 1] to uint8; values outside are clipped."""
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def enlarge(image: np.ndarray, factor: int) -> np.ndarray:
    """(H, W, 3) uint8 enlarged by a whole factor."""
    return np.asarray(Image.fromarray(image).resize((image.shape[1] * factor, image.shape[0] * factor), Image.BICUBIC))


def factor_for(width: int) -> int:
    """Return the whole factor that brings a width in px nearest to a panel's."""
    return max(1, round(PANEL_WIDTH / width))


def side_by_side(panels: list[np.ndarray]) -> np.ndarray:
    """Panels in a row."""
    height = max(p.shape[0] for p in panels)
    width = sum(p.shape[1] for p in panels) + GAP * (len(panels) - 1)
    row, x = np.full((height, width, 3), BETWEEN, np.uint8), 0
    for panel in panels:
        row[: panel.shape[0], x : x + panel.shape[1]] = panel
        x += panel.shape[1] + GAP
    return row


def mapped(levels: np.ndarray, colour_map: int) -> np.ndarray:
    """(H, W) uint8 in the colours of one of OpenCV's colour maps, (H, W, 3) uint8."""
    return np.ascontiguousarray(cv2.applyColorMap(levels, colour_map)[..., ::-1])


def ramp(colour_map: int) -> np.ndarray:
    """(256, 3) uint8: a colour map from its first colour to its last."""
    return mapped(np.arange(256, dtype=np.uint8)[:, None], colour_map)[:, 0]


def encoded(image: np.ndarray, kind: str = "webp", quality: int = 88, side: int | None = None) -> bytes:
    """(H, W, 3 or 4) uint8 as the bytes of a file, of at most `side` px where that is given."""
    picture = Image.fromarray(image)
    if side is not None:
        picture.thumbnail((side, side), Image.LANCZOS)
    buffer = io.BytesIO()
    picture.save(buffer, kind, **({"quality": quality, "method": 4} if kind == "webp" else {"optimize": True}))
    return buffer.getvalue()


def base64_text(data: bytes) -> str:
    """Return bytes as text that a page can hold."""
    return base64.b64encode(data).decode()


def data_uri(image: np.ndarray | Path, kind: str = "webp") -> str:
    """A picture as a data: URI. A path is decoded and encoded again, so only pixels enter the page.

    Raises:
        DataFormatError: the file cannot be decoded.
    """
    pixels = read_picture(image)[..., ::-1] if isinstance(image, Path) else image
    return f"data:image/{kind};base64,{base64_text(encoded(pixels, kind))}"


def file_uri(path: Path) -> str:
    """An animation's own bytes as a data: URI."""
    return f"data:image/{path.suffix[1:]};base64,{base64_text(path.read_bytes())}"
