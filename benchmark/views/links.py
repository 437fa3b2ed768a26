"""A second name for a file, where a layout insists on its own names."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from gof.core.files import atomic_path


def link(source: Path, target: Path) -> None:
    """A second name for a file, or a copy where the file system has no hard links."""
    with atomic_path(target) as temporary:
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)
