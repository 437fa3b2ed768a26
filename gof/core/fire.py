"""`fire.json`: what a flame of any solver is, whose grids stand beside it (`gof_benchmark.solvers.grids`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from .errors import DataFormatError
from .files import is_name

FILE = "fire.json"


@dataclass(frozen=True)
class Hearth:
    """One burner, as far as the laws of fires ask for it.

    Args:
        heat_release_kw: of its fuel, burnt completely.
        diameter_m: of the circle of equal area.
        position_m: centre of its opening.
        speed_m_s: of the fuel where it comes out, straight up.
    """

    heat_release_kw: float
    diameter_m: float
    position_m: tuple[float, float, float]
    speed_m_s: float


@dataclass(frozen=True)
class FireDescription:
    """A fire and its origin: the record `fire.json`.

    Args:
        solver: name and version of what solved it.
        time_s: (T,) clock of all grids, from 0.
        emission_law: how light follows from the gas, with its source.
        hearths: its burners; none where they are not known.
        wind_m_s: (x, y) velocity of the air that comes in.
        parameters: the solver's own description, enough to make it again.
        cpu_s: seconds of one core by part of the work.
    """

    SCHEMA: ClassVar[str] = "gof-fire"
    VERSION: ClassVar[int] = 1

    name: str
    solver: str
    time_s: tuple[float, ...]
    emission_law: str
    fuel: str = ""
    hearths: tuple[Hearth, ...] = ()
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    parameters: dict[str, Any] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        times = np.asarray(self.time_s, float)
        if not is_name(self.name):
            raise DataFormatError(f"fire {self.name[:80]!r}: folders are named after it; give it a plain name")
        if len(times) == 0 or not np.isfinite(times).all() or times[0] != 0 or (np.diff(times) <= 0).any():
            raise DataFormatError(f"fire '{self.name}': time_s must start at 0 and increase")
