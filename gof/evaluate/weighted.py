"""Quantiles of weighted values."""

from __future__ import annotations

import numpy as np


def weighted_quantile(values: np.ndarray, weight: np.ndarray, q: float) -> float:
    """The smallest of values (N,) up to which at least the share q of weight (N,) >= 0 lies; 0 <= q <= 1, N >= 1."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    reached = np.searchsorted(total, q * total[-1])
    return float(values[order][min(reached, len(values) - 1)])
