"""The layout of NeRF-DS in ``NeRF/nerfds/``, which Grid4D and Deformable-3DGS read with held-out frames kept out.

The files of `hypernerf`, at the pictures' own size. Both readers go by the names of folders: one by "nerf" somewhere in
the path, unless "vrig" or "interp" is there too, the other by a folder above it that begins with "NeRF".
"""

from __future__ import annotations

from gof.core.errors import DataFormatError

from .hypernerf import write_nerfies
from .source import ViewSource

FOLDER = "NeRF/nerfds"
MISREAD = ("vrig", "interp")  # in a path, to one of its readers: pictures are half the size, or frames are chosen anew


def write(source: ViewSource) -> None:
    """Write the view. Raises DataFormatError: as `write_nerfies`, or a path that a reader takes for another layout."""
    path = str(source.dataset.path.resolve())
    for word in MISREAD:
        if word in path:
            raise DataFormatError(f"{path}: readers of 'nerfds' take a path with '{word}' for another; rename it")
    write_nerfies(source, FOLDER, 1, "points3d.ply")
