"""What a format to damage is: a small good sample, and the public reader of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.errors import GofError
from tests.reliability.damage import Injury


@dataclasses.dataclass(frozen=True)
class Format:
    """A format to damage.

    Attributes:
        write: puts a good sample into an empty folder.
        read: reads that folder as its users would; returns all that it gives.
        damage: the files that get damaged, as a pattern.
        refusals: what the reader may raise.
        named: whether every refusal must name the file; not where two sources are compared, or there is no file.
        share: relative number of inputs; the fast ones get more.
        injury: the only kind of damage to do; None: any.
        believed: whether a damaged sample may be accepted; not where every injury makes it impossible.
    """

    write: Callable[[Path], Any]
    read: Callable[[Path], Any]
    damage: str = "*"
    refusals: tuple[type[Exception], ...] = (GofError,)
    named: bool = True
    share: float = 1.0
    injury: Injury | None = None
    believed: bool = True

    def files(self, folder: Path) -> list[Path]:
        """Those of a fresh sample that get damaged; nothing that a link leads to."""
        found = [path for path in folder.glob(self.damage) if path.is_file() and not path.is_symlink()]
        return sorted(p for p in found if p.resolve() == folder.resolve() / p.relative_to(folder))


def finite(value: Any, name: str = "") -> bool:
    """Whether there is no NaN or Inf anywhere inside; an infinite t_sigma means always on, velocity_sd unknown."""
    if dataclasses.is_dataclass(value):
        return all(finite(getattr(value, f.name), f.name) for f in dataclasses.fields(value))
    if isinstance(value, dict):
        return all(finite(v, str(k)) for k, v in value.items())
    if isinstance(value, (list, tuple)):
        return all(map(finite, value))
    if isinstance(value, (float, np.ndarray, np.number)) and np.asarray(value).dtype.kind in "fc":
        return bool((np.isfinite(value) | (np.isposinf(value) if name in ("t_sigma", "velocity_sd") else False)).all())
    return True
