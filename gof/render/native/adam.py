"""Adam's step in one pass over memory, of all rows or of some."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np

from gof.render.backend import Float
from gof.render.native.compiled import kernel, part
from gof.render.native.threads import run


@part
def moved(value, m, v, g, rate, beta_1, beta_2, epsilon):
    """Value and moments after a step by gradient g. Where the gradient always was 0, so is the step: epsilon > 0."""
    one = np.float32(1)
    m, v = m * beta_1 + g * (one - beta_1), v * beta_2 + g * g * (one - beta_2)
    return value - rate * m / (np.sqrt(v) + epsilon), m, v


@kernel
def _step(value, m, v, gradient, new_value, new_m, new_v, masked, rate, beta_1, beta_2, epsilon):
    for i in range(len(value)):
        g = gradient[i]
        stays = masked and g == np.float32(0)
        new = moved(value[i], m[i], v[i], g, rate, beta_1, beta_2, epsilon)
        new_value[i], new_m[i], new_v[i] = (value[i], m[i], v[i]) if stays else new


@kernel
def _step_rows(value, m, v, gradient, rows, runs, again, rate, beta_1, beta_2, epsilon):
    """In place, what has gradient 0 stays; rows[runs[r]:runs[r + 1]] are neighbours, `again` those that follow them."""
    added = gradient[: len(rows)].copy()  # columns may share a gradient, and it may be the caller's
    for k in range(len(again)):
        added[again[k]] += gradient[len(rows) + k]
    for r in range(len(runs) - 1):
        k = runs[r]
        i = np.int64(rows[k])
        for j in range(runs[r + 1] - k):
            g = added[k + j]
            old = value[i + j], m[i + j], v[i + j]
            new = moved(*old, g, rate, beta_1, beta_2, epsilon)
            value[i + j], m[i + j], v[i + j] = old if g == np.float32(0) else new


@kernel
def _take(column, rows, runs, out):
    for r in range(len(runs) - 1):
        k = runs[r]
        i = np.int64(rows[k])
        for j in range(runs[r + 1] - k):
            out[k + j] = column[i + j]


def adam(old, gradients, rate: float, beta_1: float, beta_2: float, epsilon: float, masked: bool):
    """One step of a parameter of K columns (N,).

    Args:
        old: its value and two moments, K columns each.   gradients: K columns.
        rate: with the correction of the moments' bias.   masked: leave what has gradient 0.
    Returns:
        value and moments, as `old`.
    """
    new = [[dr.empty(Float, len(column)) for column in columns] for columns in old]
    # Views first: an array that something else refers to by then is copied before numpy may write to it.
    tasks = list(zip(*([c.numpy() for c in columns] for columns in (*old, gradients, *new)), strict=True))
    constants = [np.float32(x) for x in (rate, beta_1, beta_2, epsilon)]
    run(lambda k: _step(*tasks[k], masked, *constants), [(k,) for k in range(len(tasks))])
    return new


@dataclass(frozen=True)
class RowRuns:
    """Rows (K,) uint32 of some columns, ascending, each once; runs (R + 1,): where neighbours begin, and the end."""

    index: np.ndarray
    runs: np.ndarray

    @classmethod
    def of(cls, index: np.ndarray) -> RowRuns:
        return cls(index, np.concatenate([[0], np.flatnonzero(np.diff(index) != 1) + 1, [len(index)]]))


def take(columns: list[np.ndarray], rows: RowRuns, again: np.ndarray) -> list[Float]:
    """Return these rows of K columns (N,), and behind them those at the places `again` among them."""
    count = len(rows.index)
    out = [dr.empty(Float, count + len(again)) for _ in columns]
    tasks = list(zip(columns, [column.numpy() for column in out], strict=True))

    def copy(k: int) -> None:
        column, taken = tasks[k]
        _take(column, rows.index, rows.runs, taken)
        taken[count:] = taken[again]

    run(copy, [(k,) for k in range(len(tasks))])
    return out


def adam_rows(parameters, rows: RowRuns, again: np.ndarray) -> None:
    """One step of some rows of parameters, in place; rows with gradient 0 stay.

    Args:
        parameters: of each, its value and two moments, K columns (N,) each; the gradients of the rows, and behind them
            of those `again`, K columns; and rate, both betas and epsilon as `adam`.
        again: see `take`.
    """
    tasks = []
    for old, gradients, constants in parameters:
        numbers = [np.float32(x) for x in constants]
        columns = zip(*old, [g.numpy() for g in gradients], strict=True)
        tasks += [(*column, rows.index, rows.runs, again, *numbers) for column in columns]
    run(lambda k: _step_rows(*tasks[k]), [(k,) for k in range(len(tasks))])
