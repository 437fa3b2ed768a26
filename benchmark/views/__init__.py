"""Datasets in the layouts that other people's code reads, one module each with ``write(source)``.

Pictures are referred to where they are, or hard-linked where a layout insists on its own names. Poses are converted to
each layout's convention; pictures are upright, so a camera's 90-degree roll needs no mention.
"""

from __future__ import annotations

import importlib
from pathlib import Path

from .source import ViewSource


def write(name: str, root: Path) -> None:
    """Write one view of the finished dataset in `root`, over an older one.

    Args:
        name: "nerfstudio", "dnerf", "points", "colmap", "dynerf", "n3v", "multipleview", "hypernerf",
            "nerfds", "freetimegs" or "firebundle".
    Raises:
        DataFormatError: no finished dataset there, or one that the layout cannot express.
    """
    importlib.import_module(f".{name}", __name__).write(ViewSource.open(root))
