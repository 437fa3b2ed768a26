"""Whether a flame is well exposed: what share of its pixels a display shows as white or as black."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.checked_json import SpecError, from_dict
from ..core.files import read_json, write_json

WHITE, BLACK = 252, 26
"""8-bit values: clipped from WHITE on in red and green, which go last; black if no colour comes to BLACK."""
MANY = 0.25
"""Share of clipped or black pixels from which a picture counts as badly exposed."""


@dataclass(frozen=True)
class Brightness:
    """The brightness of the flame in a picture.

    Attributes:
        flame: share of the picture that it fills.
        clipped, black: shares of the flame's pixels; 0 where there is none.
    """

    flame: float
    clipped: float
    black: float

    def __str__(self) -> str:
        if not self.flame:
            return (
                "the first picture shows no flame; see whether it burns in view of the cameras, or raise fire.intensity"
            )
        text = f"flame in the first picture: {self.clipped:.0%} of its pixels clipped, {self.black:.0%} black"
        if self.clipped > MANY:
            return f"{text}; lower fire.intensity or display.exposure, or list the effect auto_exposure"
        if self.black > MANY:
            return f"{text}; raise fire.intensity or display.exposure, or list the effect auto_exposure"
        return text

    @classmethod
    def of(cls, picture: np.ndarray, mask: np.ndarray) -> Brightness:
        """Measure a display picture (H, W, 3) uint8 whose flame is where mask (H, W) is true."""
        flame = picture[mask]
        if not len(flame):
            return cls(0.0, 0.0, 0.0)
        clipped = (flame[:, 0] >= WHITE) & (flame[:, 1] >= WHITE)
        return cls(*(round(float(share.mean()), 4) for share in (mask, clipped, flame.max(1) < BLACK)))

    @classmethod
    def read(cls, path: Path) -> Brightness | None:
        """Return the brightness that `write` stored; None where no picture was measured."""
        try:
            return from_dict(cls, read_json(path), "") if path.is_file() else None
        except SpecError as error:
            raise SpecError(f"{path}: {error}") from None

    def write(self, path: Path) -> None:
        write_json(path, vars(self))
