"""Libraries that an extra of this package brings: imported when needed, and when absent named by their extra."""

from __future__ import annotations

import importlib
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
