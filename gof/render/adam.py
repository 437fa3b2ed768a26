"""Adam (Kingma and Ba 2015) for the parameters of a picture: Dr.Jit's, with a faster step where kernels are native."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import drjit as dr
import numpy as np
from drjit import opt

from gof.render.backend import Float, floats, kernels
from gof.render.blend import as_plane


class Adam(opt.Adam):
    """Dr.Jit's optimiser and its state; parameters are arrays or vectors of float32, rates are numbers.

    Where the native kernels run, a step reads and writes every array once, which takes a quarter of the time.
    """

    def step(self) -> None:
        """Move every parameter by its gradient; with `mask_updates` what has gradient 0 stays, with its moments."""
        if kernels().name != "native":
            super().step()
            return
        from gof.render.native.adam import adam

        gradients = {key: _columns(dr.grad(value)) for key, (value, *_) in self.state.items()}
        dr.schedule(gradients)
        constants = self.beta_1, self.beta_2, self.epsilon, self.mask_updates
        for key, (value, promoted, rate, (t, *moments, extra)) in self.state.items():
            t = int(t[0]) + 1
            debiased = (self.lr if rate is None else rate) * (1 - self.beta_2**t) ** 0.5 / (1 - self.beta_1**t)
            old = [_columns(dr.detach(x)) for x in (value, *moments)]
            grads = [as_plane(g, dr.width(value)) for g in gradients[key]]
            new = adam(old, grads, debiased, *constants)
            value, m, v = (type(like)(*columns) for like, columns in zip((value, *moments), new, strict=True))
            dr.enable_grad(value)
            self.state[key] = value, promoted, rate, (dr.uint32_array_t(Float)(t), m, v, extra)

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
