"""Adam's step in one pass over memory."""

from __future__ import annotations

import drjit as dr
import numpy as np

from gof.render.backend import Float
from gof.render.native.compiled import kernel
from gof.render.native.threads import run


@kernel
def _step(value, m, v, gradient, new_value, new_m, new_v, rate, beta_1, beta_2, epsilon, masked):
    one, none = np.float32(1), np.float32(0)
    for i in range(len(value)):
        g = gradient[i]
        stays = masked and g == none
        first, second = m[i] * beta_1 + g * (one - beta_1), v[i] * beta_2 + g * g * (one - beta_2)
        # Where the gradient always was 0, so is the step: epsilon > 0.
        moved = value[i] - rate * first / (np.sqrt(second) + epsilon)
        new_value[i], new_m[i], new_v[i] = (value[i], m[i], v[i]) if stays else (moved, first, second)


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
    constants = *(np.float32(x) for x in (rate, beta_1, beta_2, epsilon)), masked
    run(lambda k: _step(*tasks[k], *constants), [(k,) for k in range(len(tasks))])
    return new
