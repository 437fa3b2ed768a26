"""Fire-free plates of a fixed camera: fire adds light, so its absence is the dark end of every pixel's history."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.numbered import is_hidden
from gof.footage.lens import Lens
from gof.footage.pictures import read_picture, read_rotation
from gof.footage.videos import read_info
from gof.ingest.footage import PreparedClip
from gof.ingest.over_time import LUMA, median

WARM = 12  # display steps of 255 by which red outgrows blue where fire or its light passed
GROW_PX = 3  # margin around these places
MOST_RISE = 20  # levels of 255 by which the median may outshine the minimum: more is light that is on most of the time
FIRE_RED, FIRE_WARM = 150, 70  # colour of flame in a picture: red of 255, and how far above blue
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")  # of plates that somebody brings
FILMS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mts", ".m2ts", ".ts", ".mpg", ".lrv", ".360")
WANTED = (
    "--plates wants of each camera a picture or a film without fire, as its footage is stored, with the cameras' "
    "names: cam_0.png or cam_0.mp4 for the first one, cam_1 ... for the next"
)
MOST_LOOKED_AT = 60  # frames of such a film
MOST_FIRE_LEFT = 0.01  # share of the picture above which plates filmed without fire are needed


def fire_reached(clip: Collection[np.ndarray], low: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: pixels that fire, or much of its light, reached: red rose above the plate `low` more than
    blue did.

    So do those that such pixels surround: in the heart of a flame that never moves away, `low` is flame itself.

    Args:
        clip: (H, W, 3) uint8 RGB pictures.   low: (H, W, 3) uint8 minimum plate.
    """
    import cv2
    from scipy.ndimage import binary_fill_holes  # here: it takes long to load

    warmest = np.full(low.shape[:2], -255, np.int16)
    base = low[..., 0].astype(np.int16) - low[..., 2]
    for frame in clip:
        np.maximum(warmest, frame[..., 0].astype(np.int16) - frame[..., 2] - base, out=warmest)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * GROW_PX + 1,) * 2)
    spots = cv2.morphologyEx((warmest > WARM).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return binary_fill_holes(cv2.dilate(spots, disc) > 0)


def steady(clip: Collection[np.ndarray], low: np.ndarray, fire: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) uint8: the minimum `low` where `fire` (H, W) passed, the temporal median elsewhere, blended
    between.

    A minimum over noise lies below the scene by two to three standard deviations; where there is no fire nothing is
    gained by it. Where red is at its limit in every frame, as in the heart of a flame, colour does not show that fire
    passed; a median far above the minimum does.
    """
    import cv2

    usual = median(clip)
    lit = (usual.astype(np.float32) - low) @ LUMA > MOST_RISE
    reached = (fire | lit).astype(np.float32)
    weight = np.maximum(cv2.GaussianBlur(reached, (0, 0), GROW_PX), reached)[..., None]
    return np.rint(weight * low + (1 - weight) * usual).astype(np.uint8)


def fire_left(plate: np.ndarray, reached: np.ndarray) -> float:
    """Return share of the picture that has the colour of flame in a plate (H, W, 3) uint8, where fire `reached` (H,
    W)."""
    red, green, blue = np.moveaxis(plate.astype(np.int16), -1, 0)
    return float((reached & (red > FIRE_RED) & (red - blue > FIRE_WARM) & (red >= green)).mean())


def uncovered(low: np.ndarray, reached: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    """Return the minimum plate, with what other clips by the same camera show darker where fire `reached` (H, W) this
    one.

    Fire that stands in one place in one clip stands elsewhere in another. Light and exposure may have changed between
    them: each is brought to this one's level, channel by channel, by the median ratio outside the fire.

    Args:
        low, others: (H, W, 3) uint8 minimum plates.
    """
    best = low.copy()
    still = ~reached & (low.min(-1) > 8)
    for other in others:
        seen = still & (other.min(-1) > 8)
        if not seen.any():
            continue
        gain = np.median(low[seen].astype(np.float32) / other[seen], axis=0)
        level = np.clip(np.rint(other * gain), 0, 255).astype(np.uint8)
        darker = reached & (level @ LUMA < best @ LUMA)
        best[darker] = level[darker]
    return best


def find_plates(folder: Path, names: Iterable[str]) -> list[Path]:
    """Return each camera's plate filmed without fire: folder/NAME with an ending of `SUFFIXES` or `FILMS`.

    Raises:
        DataFormatError: no such folder, none or several for a camera; says what there is instead.
    """
    if not folder.is_dir():
        raise DataFormatError(f"{folder}: no such folder; {WANTED}")
    files = sorted(path for path in folder.iterdir() if not is_hidden(path))
    found = []
    for name in names:
        # the benchmark's scenes have an EXR beside it
        mine = [p for p in files if p.stem.lower() == name and p.suffix.lower() in (*SUFFIXES, *FILMS)]
        if len(mine) > 1:
            raise DataFormatError(f"{mine[0]}: and {mine[1].name} are both plates of {name}; keep one")
        if not mine:
            listed = ", ".join(p.name for p in files[:4]) + (", ..." if len(files) > 4 else "") or "nothing"
            raise DataFormatError(f"{folder}: no picture {name}.png there, but {listed}; {WANTED}")
        found += mine
    return found


def read_plate(path: Path, lens: Lens, rotation_deg: int = 0) -> np.ndarray:
    """Return (H, W, 3) uint8 RGB: a plate as stored; of a film, the median of its frames.

    Args:
        rotation_deg: by which players turn the footage, by its tag.
    Raises:
        DataFormatError: it cannot be read, has another size than the footage, or its tag turns it otherwise.
    """
    import cv2

    size = (lens.width, lens.height)
    if path.suffix.lower() in SUFFIXES:
        picture, tag = cv2.cvtColor(read_picture(path, size=size), cv2.COLOR_BGR2RGB), read_rotation(path)
    else:
        info = read_info(path)
        numbers = np.unique(np.linspace(0, (info.frames or 1) - 1, MOST_LOOKED_AT).astype(int))
        picture, tag = median(PreparedClip(path, size, tuple(numbers.tolist()), np.asarray)), info.rotation_deg
    if tag not in (0, rotation_deg):
        raise DataFormatError(
            f"{path}: by its orientation tag it is turned by {tag} degrees, its camera's footage by {rotation_deg}; "
            "save it as the footage is stored, without the tag"
        )
    return picture
