"""Libraries that an extra of this package brings: imported when needed, and when absent named by their extra."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import re
from types import ModuleType

from gof.core.errors import MissingDependencyError

WITH = {"blender": " with Python 3.11 or 3.13"}  # which bpy 4.5 and 5.3 are made for


def command(extra: str) -> str:
    """Return the command that installs an extra; in the quotes that Windows' command line knows too."""
    return f'pip install "gaussians-on-fire[{extra}]"' + WITH.get(extra, "")


def load(module: str, extra: str, purpose: str) -> ModuleType:
    """Import a module.

    Raises:
        MissingDependencyError: it is not installed, or does not load; says which extra brings it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as e:
        missing = (e.name or module).partition(".")[0]
        raise MissingDependencyError(f"{purpose} needs {missing}: {command(extra)}") from e
    except ImportError as e:  # a library of the system is missing, say
        message = (
            f"{purpose} needs {module}, which is installed but does not load ({e}); reinstall it: {command(extra)}"
        )
        raise MissingDependencyError(message) from e


def require(module: str, extra: str, purpose: str) -> None:
    """`load`, for what another process will import. Raises MissingDependencyError: it is not installed."""
    if importlib.util.find_spec(module) is None:
        raise MissingDependencyError(f"{purpose} needs {module}: {command(extra)}")


def missing() -> dict[str, list[str]]:
    """Extra -> what of it is not installed, as the installed package's own metadata name it."""
    found: dict[str, list[str]] = {}
    for requirement in importlib.metadata.requires("gaussians-on-fire") or []:
        extra = re.search(r"""extra == ['"]([\w-]+)['"]""", requirement)
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        if extra and "python_version" not in requirement:
            lacks = found.setdefault(extra[1], [])
            try:
                importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                lacks.append(name)
    return found
