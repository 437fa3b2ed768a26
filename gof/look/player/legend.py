"""The player's controls, and what the colours and lines of velocity stand for: names, ranges and words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gof.core.gaussians import TransientGaussians
from gof.evaluate.intervals import weighted_quantile

DESCRIPTION = "A flame in 3D: drag to turn it, stop it, slow it down to 1/100."  # where a link to the page is shown
HINT = "Drag to turn: this is not a film"

# Controls, in the order in which the page shows them
PRESETS = {"flame": "Flame", "motion": "Motion", "uncertainty": "Uncertainty"}  # player.js says what each shows
CAMERA = "Camera"
COMPARED = "Compare"
COLOURED = "Show"
COLOURS = (
    "Colour",
    "Speed",
    "Uncertainty",
)  # of the light; of the gas, m/s; standard deviation of its components, m/s
LINES = "Velocity lines"
SIZE = "Splat size"
SIZE_PERCENT = (5, 150, 5)  # least, most, step; 100 = as they are
RESET = "Reset view"
TIME = "Time"
PLAY = "Play"
SPEED = "Speed"
LOOP = "Loop"
SPEEDS = {"1\u00d7": 1, "1/2": 2, "1/5": 5, "1/10": 10, "1/20": 20, "1/50": 50, "1/100": 100}  # times slower
FIRST_SPEED = "1/10"

# Colours and lines
TOP = 0.98  # the last colour is this quantile, by opacity
MOST_LINES = 9000  # Gaussians of a result that have a velocity line; a quarter of them or fewer live at a time
LINE_SHARE = 0.03  # of the clip, that a velocity line lasts
SPEED_NOTE = "Speed."
LINE_NOTE = "A line is the way of {} ms."
UNCERTAINTY_NOTE = "How unsure the velocity is, as the result says: standard deviation of a component. Grey: not known."


def speed_scale(results: Sequence[TransientGaussians], others: Sequence[np.ndarray | None] = ()) -> float:
    """m/s of the last colour over all results; 0 = nothing moves.

    Args:
        others: (N, 3) m/s, further velocities at the results' Gaussians, one a result: the true ones.
    """
    fields = [(g, g.moving_gas) for g in results]
    fields += [(g, v) for g, v in zip(results, others, strict=False) if v is not None]
    return _scale([(np.linalg.norm(v, axis=-1)[g.dynamic], g.opacity[g.dynamic]) for g, v in fields])


def uncertainty_scale(results: Sequence[TransientGaussians]) -> float:
    """m/s of the last colour over all results; 0 = no result says."""
    known = [g[g.dynamic & np.isfinite(g.velocity_sd)] for g in results]
    return _scale([(g.velocity_sd, g.opacity) for g in known])


def line_s(length_s: float) -> float:
    """Return seconds that a line lasts in a clip of this length: a round number."""
    return float(f"{LINE_SHARE * length_s:.1g}")


def ticks(largest: float) -> list[str]:
    """Return the words below the colours, from the first to the last."""
    return ["0", *(_short(share * largest) for share in (0.25, 0.5, 0.75)), f"{_short(largest)}+ m/s"]


def line_note(seconds: float) -> str:
    return LINE_NOTE.format(_short(1e3 * seconds))


def _short(value: float) -> str:
    """Return two digits, never as a power of ten."""
    return np.format_float_positional(float(f"{value:.2g}"), trim="-")


def _scale(parts: list[tuple[np.ndarray, np.ndarray]]) -> float:
    largest = [weighted_quantile(value, weight, TOP) for value, weight in parts if len(value) and weight.any()]
    return _round_up(max(largest, default=0.0), 2)


def _round_up(value: float, digits: int) -> float:
    """To so many digits, so that legends are read easily."""
    if value <= 0:
        return 0.0
    unit = 10.0 ** (np.floor(np.log10(value)) - digits + 1)
    return float(f"{np.ceil(value / unit - 1e-4) * unit:.6g}")
