"""Libraries that an extra of this package brings: imported when needed, and when absent named by their extra."""

from __future__ import annotations

import importlib
import importlib.metadata
import re
from types import ModuleType

from gof.errors import MissingDependencyError


def load(module: str, extra: str, purpose: str) -> ModuleType:
    """Import a module.

    Raises:
        MissingDependencyError: it is not installed; says which extra brings it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as e:
        missing = (e.name or module).partition(".")[0]
        raise MissingDependencyError(f"{purpose} needs {missing}: pip install 'gaussians-on-fire[{extra}]'") from e


def missing() -> dict[str, list[str]]:
    """Extra -> what of it is not installed, as the installed package's own metadata name it."""
    found: dict[str, list[str]] = {}
    for requirement in importlib.metadata.requires("gaussians-on-fire") or []:
        extra = re.search(r"""extra == ['"]([\w-]+)['"]""", requirement)
        name = re.match(r"[\w.-]+", requirement)[0]
        if extra and "python_version" not in requirement:
            lacks = found.setdefault(extra[1], [])
            try:
                importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                lacks.append(name)
    return found
