"""Pictures as all of this room has them: 8 bits, side by side, in a colour map, and as bytes and text inside pages."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from gof.dataset import Dataset
from gof.footage.pictures import read_picture
from gof.host.threads import map_on_cores

PANEL_WIDTH = 360  # px; small pictures are enlarged to about this by a whole factor
GAP, BETWEEN = 4, 110  # px between panels, and their grey: readable on light and dark pages
VIRIDIS, INFERNO = cv2.COLORMAP_VIRIDIS, cv2.COLORMAP_INFERNO  # of depth and speed; of errors


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Display values (H, W, 3) in [0, 1] to uint8; values outside are clipped."""
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def enlarge(image: np.ndarray, factor: int) -> np.ndarray:
    """Return (H, W, 3) uint8 enlarged by a whole factor."""
    return np.asarray(
        Image.fromarray(image).resize((image.shape[1] * factor, image.shape[0] * factor), Image.Resampling.BICUBIC)
    )


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
    """Return (H, W) uint8 in the colours of one of OpenCV's colour maps, (H, W, 3) uint8."""
    return np.ascontiguousarray(cv2.applyColorMap(levels, colour_map)[..., ::-1])


def ramp(colour_map: int) -> np.ndarray:
    """Return (256, 3) uint8: a colour map from its first colour to its last."""
    return mapped(np.arange(256, dtype=np.uint8)[:, None], colour_map)[:, 0]


def encoded(image: np.ndarray, kind: str = "webp", quality: int = 88, side: int | None = None) -> bytes:
    """Return (H, W, 3 or 4) uint8 as the bytes of a file, of at most `side` px where that is given."""
    picture = Image.fromarray(image)
    if side is not None:
        picture.thumbnail((side, side), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    picture.save(buffer, kind, **({"quality": quality, "method": 4} if kind == "webp" else {"optimize": True}))
    return buffer.getvalue()


def base64_text(data: bytes) -> str:
    """Return bytes as text that a page can hold."""
    return base64.b64encode(data).decode()


def data_uri(image: np.ndarray | Path, kind: str = "webp") -> str:
    """Return a picture as a data: URI. A path is decoded and encoded again, so only pixels enter the page.

    Raises:
        DataFormatError: the file cannot be decoded.
    """
    pixels = read_picture(image)[..., ::-1] if isinstance(image, Path) else image
    return f"data:image/{kind};base64,{base64_text(encoded(pixels, kind))}"


def file_uri(path: Path) -> str:
    """Return an animation's own bytes as a data: URI."""
    return f"data:image/{path.suffix[1:]};base64,{base64_text(path.read_bytes())}"


# ----------------------------------------------------------------
# A dataset's pictures, small enough to travel inside a page.

PLATE_SIDE, PLATE_QUALITY = 960, 86
# Longest side in px, quality of WebP, every n-th frame: the first that fits the budget is taken.
LADDER = [
    (960, 82, 1),
    (640, 80, 1),
    (480, 74, 1),
    (360, 70, 1),
    (320, 60, 1),
    (240, 55, 1),
    (240, 50, 2),
    (200, 40, 4),
]
SAMPLED = 3  # frames of each camera that tell how large all will be


def webp(picture: np.ndarray, side: int, quality: int) -> bytes:
    """Return (H, W, 3) display values in [0, 1] as WebP of at most `side` px."""
    return encoded(to_bytes(picture), "webp", quality, side)


def frames_within(
    views: list[tuple[Dataset, int]], budget_bytes: int, progress: Callable[[int, int], None] | None = None
) -> tuple[list[list[str | None] | None], str]:
    """Return every camera's recorded frames as base64 WebP, None for one left out; and in words what was done to them.

    Args:
        views: (dataset, number of a camera in it).
        budget_bytes: for all of them together, as base64; 0 = none.
    """
    frames = len(views[0][0].times_s) if views else 0
    chosen = _rung(views, frames, budget_bytes)
    if chosen is None:
        return [None] * len(views), "no recorded pictures"
    side, quality, every = chosen
    packed: list[list[str | None] | None] = []
    total = 0
    for number, (dataset, camera) in enumerate(views):

        def text(k: int, dataset: Dataset = dataset, camera: int = camera) -> str:
            return base64_text(webp(dataset.image(camera, k), side, quality))

        kept = map_on_cores(text, range(0, frames, every))
        taken = [kept[k // every] if k % every == 0 else None for k in range(frames)]
        packed.append(taken)
        total += sum(len(text) for text in taken if text)
        if progress:
            progress(number + 1, len(views))
    width, height = views[0][0].cameras[views[0][1]].width, views[0][0].cameras[views[0][1]].height
    share = min(1.0, side / max(width, height))
    thinned = "" if every == 1 else f", every {every}. frame"
    return packed, (
        f"{len(views)} cameras, {round(width * share)} x {round(height * share)} px{thinned}, {total / 1e6:.1f} MB"
    )


def _rung(views: list[tuple[Dataset, int]], frames: int, budget: int) -> tuple[int, int, int] | None:
    """Return the first of LADDER whose frames, judged by a few, stay within the budget; None when none does."""
    few = sorted({int(k) for k in np.linspace(0, frames - 1, SAMPLED)}) if frames else []
    samples = [dataset.image(camera, k) for dataset, camera in views for k in few]
    for side, quality, every in LADDER if samples and budget else []:
        mean = np.mean([len(webp(picture, side, quality)) for picture in samples])
        if mean * 4 / 3 * len(views) * -(-frames // every) < budget:
            return side, quality, every
    return None
