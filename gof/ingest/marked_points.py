"""Points that are known in several pictures: marked by hand, or found on the sync board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import read_json


@dataclass(frozen=True)
class MarkedPoint:
    """One spot of the still scene.

    Attributes:
        pixels: by camera number, (2,) px in the upright, undistorted picture at footage size, centres at integer + 0.5.
        xyz: (3,) metres in a frame that all points of one `board` share, or None.
        rough: xyz is good enough to start from, not to hold a solution to.
        board: number of the rigid thing that it is on; each clip's sync board is one.
        upright: name of something that stands upright (a post); its points lie above each other.
        level: name of something level (a floor); its points lie at one height.
    """

    pixels: dict[int, np.ndarray]
    xyz: np.ndarray | None = None
    rough: bool = False
    board: int = 0
    upright: str | None = None
    level: str | None = None

    @property
    def is_known(self) -> bool:
        """Whether its xyz is believed."""
        return self.xyz is not None and not self.rough

    def without_xyz(self) -> MarkedPoint:
        return replace(self, xyz=None)


def read_points(path: Path, names: list[str]) -> list[MarkedPoint]:
    """Return points by hand: {"points": [{"pixels": {camera: [x, y], ...}, "xyz": [x, y, z]?, "upright": name?,
    "level": name?}, ...]}.

    Args:
        names: of the cameras, in order.
    Raises:
        DataFormatError: unknown camera, no point, values that are not finite numbers.
    """
    description = read_json(path)
    try:
        points = [_point(entry, names) for entry in description["points"]]
    except (KeyError, TypeError, ValueError, AttributeError) as e:
        raise DataFormatError(
            f"{path}: points must be a list of {{'pixels': {{camera: [x, y]}}}}, each with or without "
            f"'xyz': [x, y, z], 'upright': 'its post', 'level': 'its floor', with cameras {', '.join(names)} ({e})"
        ) from e
    if not any(p.pixels or p.xyz is not None for p in points) or not all(_is_finite(p) for p in points):
        raise DataFormatError(f"{path}: needs at least one point, all numbers finite")
    return points


def _point(entry: dict[str, Any], names: list[str]) -> MarkedPoint:
    pixels = {names.index(n): np.asarray(p, np.float64).reshape(2) for n, p in entry["pixels"].items()}
    xyz = entry.get("xyz")
    place = None if xyz is None else np.asarray(xyz, np.float64).reshape(3)
    return MarkedPoint(pixels, place, upright=_name(entry, "upright"), level=_name(entry, "level"))


def _name(entry: dict[str, Any], field: str) -> str | None:
    name = entry.get(field)
    if name is not None and not (isinstance(name, str) and name):
        raise ValueError(f"'{field}' is {name!r}, not the name of the thing")
    return name


def _is_finite(point: MarkedPoint) -> bool:
    return all(np.isfinite(pixel).all() for pixel in point.pixels.values()) and (
        point.xyz is None or bool(np.isfinite(point.xyz).all())
    )
