"""Is a Gaussian wider than the flow's structures? Its width in radians of the field's local wavelength.

Three Gauss-Hermite nodes per axis average a wave exp(ikx) well while k sigma stays below 1.5 (docs/scores.md). A
turbulent field has no single k, so the local one is read off its derivatives: over a neighbourhood, with gradient g
and Hessian H of every velocity component,

    T = sum <H H^T> / sum <|g|^2>

is the mean of k k^T over the waves present, weighted by their gradient energy; for one plane wave it is exactly k k^T.
The phase spread of a Gaussian with covariance C is sqrt(trace(T C)), the root-mean-square of k sigma over those waves.
A linear field has no curvature, so no wavelength, and a spread of 0.
"""

from __future__ import annotations

import numpy as np

from gof.core.rotations import rotation_matrices
from gof.evaluate.draws import own_generator
from gof.evaluate.quadrature import VelocityLike

LIMIT_RAD = 1.5
SAMPLE = 128  # Gaussians looked at per frame; the share's standard error is below 4.5 %, pooled over 30 frames 0.8 %
REACH = 2.0  # standard deviations; the neighbourhood has to hold a good part of a wave to tell its crest from a plateau
_POINTS = 32

# R3 of M. Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences" (2018): points spread evenly in the unit
# cube, u_n = 1/2 + n (1/g, 1/g^2, 1/g^3) modulo 1, where g > 1 solves g^4 = g + 1 (the plastic number's equation is
# g^3 = g + 1, for the square; the golden ratio's is g^2 = g + 1, for the interval).
_G = 1.22074408460575947
_UNIT = (0.5 + np.arange(1, _POINTS + 1)[:, None] * _G ** -np.arange(1.0, 4)) % 1
NEIGHBOURHOOD = REACH * (2 * _UNIT - 1)  # (32, 3) standard deviations
_PAIRS = [(a, b) for a in range(3) for b in range(a, 3)]


def phase_spread(field: VelocityLike, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Root-mean-square k sigma of each Gaussian.

    Args:
        field: anything with sample, contains and voxel_size; differences are taken one voxel apart.
        position (M, 3) m, scale (M, 3) m, rotation (M, 4) wxyz.
    Returns:
        (M,) radians >= 0; 0 where the field is linear, constant, or the whole neighbourhood lies outside the domain.
    """
    h = field.voxel_size
    axes = rotation_matrices(rotation) * scale[:, None, :]
    points = position[:, None, :] + np.einsum("nik,pk->npi", axes, NEIGHBOURHOOD)
    flat = points.reshape(-1, 3)
    inside = field.contains(flat - h) & field.contains(flat + h)
    offsets = np.concatenate(
        [np.zeros((1, 3)), np.eye(3), -np.eye(3)]
        + [[(s * np.eye(3)[a] + r * np.eye(3)[b])] for a, b in _PAIRS if a != b for s in (1, -1) for r in (1, -1)]
    )
    values = (
        field.sample((flat[inside, None, :] + h * offsets).reshape(-1, 3))
        .reshape(-1, len(offsets), 3)
        .astype(np.float64)
    )
    gradient = (values[:, 1:4] - values[:, 4:7]) / (2 * h)  # (K, 3 axes, 3 components)
    hessian = np.empty((len(values), 3, 3, 3))
    mixed = 7
    for a, b in _PAIRS:
        if a == b:
            second = (values[:, 1 + a] - 2 * values[:, 0] + values[:, 4 + a]) / h**2
        else:
            pp, pm, mp, mm = (values[:, mixed + i] for i in range(4))
            second, mixed = (pp - pm - mp + mm) / (4 * h**2), mixed + 4
        hessian[:, a, b] = hessian[:, b, a] = second
    owner = np.repeat(np.arange(len(position)), _POINTS)[inside]
    tensor = _sums(owner, np.einsum("kadc,kbdc->kab", hessian, hessian).reshape(-1, 9), len(position)).reshape(-1, 3, 3)
    energy = _sums(owner, np.einsum("kac,kac->k", gradient, gradient)[:, None], len(position))[:, 0]
    # curvature that is only rounding of the samples (float32) is no wave
    size = _sums(owner, np.square(values).max(1).sum(1, keepdims=True), len(position))[:, 0]
    noise = 1e-12 * size / h**4
    trace = np.trace(tensor, axis1=1, axis2=2)
    real = (trace > 100 * noise) & (energy > 0)
    k2 = np.divide(trace, energy, out=np.zeros_like(trace), where=real)
    kh = np.sqrt(k2) * h
    # differences of a wave give tan(kh/2) / (h/2) for k
    undo = np.divide(2 * np.arctan(kh / 2), kh, out=np.ones_like(kh), where=kh > 0) ** 2
    tc = np.einsum("nab,nbc,nac->n", tensor, axes, axes)
    return np.sqrt(np.divide(np.maximum(tc, 0), energy, out=np.zeros_like(tc), where=real) * undo)


def share_of_short_waves(
    field: VelocityLike, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, weight: np.ndarray
) -> float:
    """Return share of `weight` (M,) in Gaussians with a phase spread above LIMIT_RAD, 0..1.

    Of more than SAMPLE Gaussians a stratified random sample by weight is looked at, seeded.
    """
    if len(weight) == 0:
        return 0.0
    if len(weight) > SAMPLE:
        total = np.cumsum(weight)
        level = (
            np.arange(SAMPLE) + own_generator("sample of wide Gaussians").random(SAMPLE)
        ) / SAMPLE  # jittered: the order may be periodic
        pick = np.minimum(np.searchsorted(total, level * total[-1]), len(weight) - 1)
        position, scale, rotation, weight = position[pick], scale[pick], rotation[pick], np.ones(SAMPLE)
    wide = phase_spread(field, position, scale, rotation) > LIMIT_RAD
    return float(weight[wide].sum() / weight.sum())


def _sums(owner: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    return np.stack([np.bincount(owner, column, count) for column in values.T], 1).astype(np.float64)
