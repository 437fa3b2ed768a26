"""The looks that the installed Blender's colour management knows, read without starting Blender."""

from __future__ import annotations

import importlib.util
import os
import re
from pathlib import Path

from gof_blender.core.checked_json import SpecError
from gof_blender.pure.spec import Display

LOOK = re.compile(r"^\s*-\s*!<Look>\s*\n?\s*\{?\s*name:\s*\"?([^\"\n,}]+)", re.MULTILINE)


def known_looks(view_transform: str) -> list[str] | None:
    """Names that Blender takes with a view transform; None where there is no Blender of Python's to ask."""
    configuration = os.environ.get("OCIO") or _of_blender()
    if configuration is None or not Path(configuration).is_file():
        return None
    names = LOOK.findall(Path(configuration).read_text(encoding="utf-8", errors="replace"))
    own = [name for name in names if name.startswith(f"{view_transform} - ")]
    return ["None", *(own or [name for name in names if " - " not in name])]


def require_look(display: Display) -> None:
    """Raise SpecError if Blender would not know the look."""
    known = known_looks(display.view_transform)
    if known is not None and display.look not in known:
        raise SpecError(f"display.look must be one of {', '.join(known)}, got {display.look!r}")


def _of_blender() -> Path | None:
    found = importlib.util.find_spec("bpy")
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent
    return next(iter(folder.glob("*/datafiles/colormanagement/config.ocio")), None)
