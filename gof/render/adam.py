"""Adam (Kingma and Ba 2015) for the parameters of a picture: Dr.Jit's, with a faster step where kernels are native."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import drjit as dr
import numpy as np
from drjit import opt

from gof.render.backend import Float, UInt, floats, kernels, whole_numbers
from gof.render.blend import as_plane


@dataclass(frozen=True)
class _Part:
    """Rows that a step moves: `gof.render.native.adam.RowRuns`; places among them of those that are there again, at
    the end; and the values of all, whose gradients count."""

    rows: Any
    again: np.ndarray
    values: dict[str, Any]


@dataclass(frozen=True)
class _Memory:
    """A parameter and its two moments as Dr.Jit has them, and the columns (N,) as numpy reads and writes them."""

    arrays: list[Any]
    columns: list[list[np.ndarray]]


class Adam(opt.Adam):
    """Dr.Jit's optimiser and its state; parameters are arrays or vectors of float32, rates are numbers.

    Where the native kernels run, a step reads and writes every array once, which takes a quarter of the time.
    """

    def __init__(self, *args: Any, **kwargs: Any):
        self._part: _Part | None = None  # of which the next step moves nothing else
        self._memory: dict[str, _Memory] = {}
        super().__init__(*args, **kwargs)

    def only(self, names: Iterable[str], rows: np.ndarray, again: np.ndarray | None = None) -> dict[str, Any]:
        """Return these rows of parameters of N rows each, by name, differentiable; others have gradient 0 in this step.

        Rows that a picture does not show cost nothing then: the next `step` reads and moves these rows only, as
        `mask_updates` (that must be on) does with gradients of 0. Where the native kernels run it writes to the
        parameters' memory; arrays that were read from here change with it. Once a step: of two calls the last counts.

        Args:
            rows: (K,) uint32, ascending, each once, K > 0. Runs of 16 or more are moved at memory's speed.
            again: (A,) uint32 places among `rows` that follow once more at the end, as often as they are named; their
                gradients add up.
        Raises:
            ValueError: `mask_updates` is off.
        """
        if not self.mask_updates:
            raise ValueError("only: rows that are left out must not change, which needs mask_updates")
        again = np.zeros(0, np.uint32) if again is None else again
        if kernels().name != "native":
            index = whole_numbers(np.concatenate([rows, rows[again]]))
            mode = dr.ReduceMode.Auto if len(again) else dr.ReduceMode.NoConflicts
            return {name: _gathered(self[name], index, mode) for name in names}
        from gof.render.native.adam import RowRuns, take

        runs = RowRuns.of(rows)
        columns = {name: self._in_memory(name).columns[0] for name in names}
        taken = iter(take([column for each in columns.values() for column in each], runs, again))
        values = {name: type(self.state[name][0])(*islice(taken, len(each))) for name, each in columns.items()}
        dr.enable_grad(values)
        self._part = _Part(runs, again, values)
        return dict(values)

    def step(self, count: int = 1) -> None:
        """Move every parameter by its gradient; with `mask_updates` what has gradient 0 stays, with its moments.

        count: steps that this one stands for, each of other rows: the moments' bias is corrected as after so many.
        """
        if kernels().name != "native":
            for key in self.state if count > 1 else ():
                self._count(key, count - 1)
            super().step()
            return
        from gof.render.native.adam import adam_rows

        part, self._part = self._part or _Part(None, np.zeros(0, np.uint32), {}), None
        learned = {key: part.values.get(key, value) for key, (value, *_) in self.state.items()}
        gradients = {key: _columns(dr.grad(value)) for key, value in learned.items()}
        dr.schedule(gradients)
        parts = []
        for key, gradient in gradients.items():
            steps = self._count(key, count)
            if self.mask_updates and all(_is_nothing(column) for column in gradient):
                continue
            planes = [as_plane(column, dr.width(learned[key])) for column in gradient]
            if key in part.values:
                parts.append((self._in_memory(key).columns, planes, self._constants(key, steps)))
            else:
                self._move(key, planes, self._constants(key, steps))
        if parts:
            adam_rows(parts, part.rows, part.again)

    def _count(self, key: str, count: int) -> int:
        """Return a parameter's steps with `count` more, and note it."""
        value, promoted, rate, (t, *moments, extra) = self.state[key]
        steps = int(t[0]) + count
        self.state[key] = value, promoted, rate, (dr.uint32_array_t(Float)(steps), *moments, extra)
        return steps

    def _constants(self, key: str, steps: int) -> tuple[float, float, float, float]:
        """Return a parameter's rate, with the correction of the moments' bias, both betas and epsilon."""
        rate = self.lr if self.state[key][2] is None else self.state[key][2]
        corrected = rate * (1 - self.beta_2**steps) ** 0.5 / (1 - self.beta_1**steps)
        return corrected, self.beta_1, self.beta_2, self.epsilon

    def _move(self, key: str, gradient: list[Float], constants: tuple[float, float, float, float]) -> None:
        """Move a whole parameter by its columns' gradients."""
        from gof.render.native.adam import adam

        value, promoted, rate, (t, *moments, extra) = self.state[key]
        old = [_columns(dr.detach(x)) for x in (value, *moments)]
        new = adam(old, gradient, *constants, self.mask_updates)
        value, *moments = (type(like)(*columns) for like, columns in zip((value, *moments), new, strict=True))
        dr.enable_grad(value)
        self.state[key] = value, promoted, rate, (t, *moments, extra)

    def _in_memory(self, name: str) -> _Memory:
        """Return the memory of a parameter, which from now on is its own alone."""
        value, promoted, rate, (t, *moments, extra) = self.state[name]
        kept = self._memory.get(name)
        if kept is None or any(a is not b for a, b in zip(kept.arrays, (value, *moments), strict=True)):
            own = [[floats(c.numpy()) for c in _columns(dr.detach(x))] for x in (value, *moments)]
            views = [[column.numpy() for column in columns] for columns in own]
            value, *moments = (type(like)(*columns) for like, columns in zip((value, *moments), own, strict=True))
            dr.enable_grad(value)
            self.state[name] = value, promoted, rate, (t, *moments, extra)
            kept = self._memory[name] = _Memory([value, *moments], views)
        return kept

    def regroup(self, names: Iterable[str], kept: np.ndarray, born: Mapping[str, Any], order: np.ndarray) -> None:
        """Change which rows some parameters have: who stays keeps the moments, who is new has none.

        Column by column: an array of vectors through numpy would compile two kernels for every new number of rows.

        Args:
            names: of parameters of N rows each.   kept: (K,) which of these stay.
            born: by name, values of B new rows; {} without any.
            order: (K + B,) a permutation of both together, of which the first K are those that stay.
        """
        for name in names:
            value, promoted, rate, (t, *moments, extra) = self.state[name]
            kind, nothing = type(dr.detach(value)), [np.zeros(0, np.float32)] * len(_columns(value))
            new = [c.numpy() for c in _columns(dr.detach(born[name]))] if born else nothing

            def joined(old: Any, more: list[np.ndarray], kind: type = kind) -> Any:
                pairs = zip(_columns(dr.detach(old)), more, strict=True)
                return kind(*(floats(np.concatenate([c.numpy()[kept], m])[order]) for c, m in pairs))

            self[name] = joined(value, new)
            moments = [joined(m, [np.zeros_like(c) for c in new]) for m in moments]
            self.state[name] = self.state[name][0], promoted, rate, (t, *moments, extra)
        dr.flush_malloc_cache()  # memory in the sizes of before, which Dr.Jit keeps for more of these


def _columns(x) -> list[Float]:
    return list(x) if dr.depth_v(x) > 1 else [x]


def _is_nothing(gradient: Float) -> bool:
    """Return whether nothing was differentiated with respect to a column."""
    return gradient.state == dr.VarState.Literal and float(gradient[0]) == 0


def _gathered(value: Any, index: UInt, mode: dr.ReduceMode) -> Any:
    columns = [dr.gather(Float, c, index, mode=mode) for c in _columns(value)]
    return type(value)(*columns)
