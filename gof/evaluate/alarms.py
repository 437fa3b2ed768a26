"""Results that no method has from pictures: too far off, or too near the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from gof.evaluate.scores import FIGURES, Agreement, Scores, TrivialScore

TOO_GOOD = 0.05  # L2 of the velocities; no method from pictures has come near
NEAR_MEAN = 1.2  # times the EVE L2 of the clip's true mean field; honest results have 1.4 to 4
UNKNOWING = 0.95  # L2 of EVE's fluctuation from which on a result says next to nothing of what is unsteady
LARGEST = 1e6  # of a figure: squares, sums and ratios of such numbers are numbers


def beyond_sense(scores: Scores) -> str:
    """Return which figure of a result no flame has, as velocities of 1e200 m/s make; "" where there is none."""
    figures = {name: getattr(scores, name) for name in ("dve", "trivial_baselines", "images", "published", *FIGURES)}
    for name, number in _numbers(figures):
        if not abs(number) <= LARGEST:  # NaN too
            return f"{name} is {number:.3g}, beyond {LARGEST:g}: no flame is so far off"
    return ""


def _numbers(part: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield every float in a tree of records, with the name that it has."""
    if isinstance(part, float):
        yield name, part
    elif is_dataclass(part):
        yield from _numbers({line.name: getattr(part, line.name) for line in fields(part)}, name)
    elif isinstance(part, dict):
        for key, value in part.items():
            yield from _numbers(value, f"{name} {key}".strip())
    elif isinstance(part, (tuple, list)):
        for value in part:
            yield from _numbers(value, name)


def too_good(scores: Scores) -> str:
    """Why the velocities of a result look like the truth itself; "" where they do not."""
    if scores.dve is None:
        return ""
    eve = scores.dve.eve
    sides: list[tuple[str, float | None, TrivialScore | Agreement | None]]
    sides = [("DVE L2", scores.dve.l2, scores.trivial_baselines.get("true_centre"))]
    sides += [] if eve is None else [("EVE L2", eve.l2, eve.baselines.get("true_centre"))]
    for name, own, bound in sides:
        if own is not None and own < TOO_GOOD:
            return f"{name} is {own:.4f}: is it the truth itself?"
        if own is not None and bound is not None and bound.l2 is not None and own < bound.l2:
            return f"{name} {own:.4f} is below {bound.l2:.4f}, what the truth at each centre scores: was it used?"
    if eve is not None and "mean_field" in eve.baselines:
        own, mean, unsteady = eve.l2, eve.baselines["mean_field"].l2, eve.fluctuation.l2
        if own and mean and unsteady and own < NEAR_MEAN * mean and unsteady > UNKNOWING:
            return f"EVE L2 {own:.4f} is near {mean:.4f}, the clip's true mean, and nothing unsteady: was it used?"
    return ""
