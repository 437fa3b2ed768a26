"""Stand-in for `hashencoder.backend`, the compiled part of Grid4D: a hash grid of several resolutions.

The encoding is that of Instant-NGP (Mueller et al. 2022), with the choices that Grid4D's kernels make: level l has
ceil(scale) + 1 vertices along an axis where scale = base 2^(l s) - 1, axes may differ, a point x in [0, 1] lies at
x scale, its weights are smoothsteps, and a level whose vertices fit its part of the table is not hashed. Points outside
have no features and no gradient. Only the order of sums differs from CUDA, and the last bit of its exp2.

Compiled where that runs (`gof.on_cpu.compiled_hash_grid`); else by PyTorch, at a third of the speed.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from itertools import pairwise
from types import ModuleType

import numpy as np
import torch

from gof.core.errors import MissingDependencyError
from gof.on_cpu.small_modules import stand_in
from gof.render.backend import kernels

PRIMES = (1, 2654435761, 805459861)  # of the hash, by axis
WORD = 2**32 - 1  # the hash is of 32 bits


def backend() -> ModuleType:
    """`hashencoder.backend`: `_backend` with its three functions, which write into the tensors that they are given."""
    functions = (hash_encode_forward, hash_encode_backward, hash_encode_second_backward)
    compiled = stand_in("_hash_encoder", **{function.__name__: function for function in functions})
    return stand_in("hashencoder.backend", _backend=compiled)


def hash_encode_forward(
    inputs, embeddings, offsets, outputs, B, D, C, L, per_level_scale, base_resolution, calc_grad_inputs, dy_dx
):
    """Write features (L, B, C) of points (B, D). `dy_dx` stays as it is: the backward pass here makes its own.

    Args:
        embeddings: (T, C), the table of all levels.   offsets: (L + 1,) int, where each level's part begins.
        per_level_scale: (D,) log2 of the factor from level to level.   base_resolution: (D,) vertices of level 0.
    """
    scales, vertices = _sizes(inputs, offsets, per_level_scale, base_resolution)
    if D == 3 and kernels().name == "native":
        from gof.on_cpu.compiled_hash_grid import encode

        encode(*_arrays(inputs, embeddings, offsets, scales), np.array(vertices), outputs.numpy())
        return
    for level, (rows, sides, _) in enumerate(_levels(inputs, offsets, scales, vertices)):
        weight = _over_corners(sides, operator.mul)
        outputs[level] = (weight[..., None] * embeddings[rows]).sum(0)


def hash_encode_backward(
    grad,
    inputs,
    embeddings,
    offsets,
    grad_embeddings,
    B,
    D,
    C,
    L,
    per_level_scale,
    base_resolution,
    calc_grad_inputs,
    dy_dx,
    grad_inputs,
):
    """Add the gradients of the table (T, C) and, if asked for, of the points (B, D), from that of the features."""
    scales, vertices = _sizes(inputs, offsets, per_level_scale, base_resolution)
    if D == 3 and kernels().name == "native":
        from gof.on_cpu.compiled_hash_grid import encode_backward

        given = _arrays(grad, inputs, embeddings, offsets, scales)
        encode_backward(*given, np.array(vertices), *_arrays(grad_embeddings, grad_inputs), bool(calc_grad_inputs))
        return
    for level, (rows, sides, slopes) in enumerate(_levels(inputs, offsets, scales, vertices)):
        weight = _over_corners(sides, operator.mul)
        grad_embeddings.index_add_(0, rows.reshape(-1), (weight[..., None] * grad[level]).reshape(-1, C))
        if not calc_grad_inputs:
            continue
        pull = (embeddings[rows] * grad[level]).sum(-1)
        for axis, slope in enumerate(slopes):
            steep = _over_corners([*sides[:axis], slope, *sides[axis + 1 :]], operator.mul)
            grad_inputs[:, axis] += (steep * pull).sum(0)


def hash_encode_second_backward(*arguments):
    """Refuse: Grid4D's training asks for no derivative of a derivative."""
    raise MissingDependencyError("hash_encode_second_backward has no stand-in: second derivatives of the hash grid")


def _arrays(*tensors) -> list[np.ndarray]:
    """Return tensors on the CPU as arrays of the same memory."""
    return [tensor.detach().numpy() for tensor in tensors]


def _sizes(inputs, offsets, log2_factor, base) -> tuple[torch.Tensor, list[list[int]]]:
    """Return by level and axis the scale (L, D) of places among the vertices, of the inputs' type, and their count."""
    level = torch.arange(len(offsets) - 1, dtype=log2_factor.dtype)[:, None]
    scales = (torch.exp2(level * log2_factor) * base - 1).to(inputs.dtype)
    return scales, (torch.ceil(scales).long() + 1).tolist()


def _levels(inputs, offsets, scales, vertices) -> Iterator[tuple]:
    """Yield, by level: rows of the table (2^D, B), and by axis weights (2, B) and their derivatives (2, B)."""
    inside = ((inputs >= 0) & (inputs <= 1)).all(1)
    points = torch.where(inside[:, None], inputs, torch.zeros_like(inputs))
    parts = pairwise(offsets.tolist())
    for (start, end), scale, counts in zip(parts, scales, vertices, strict=True):
        place = points * scale
        cell = place.floor()
        part = place - cell
        rise = torch.where(inside[:, None], part * part * (3 - 2 * part), torch.zeros_like(part))
        fall = torch.where(inside[:, None], 1 - rise, torch.zeros_like(part))
        steep = torch.where(inside[:, None], 6 * part * (1 - part) * scale, torch.zeros_like(part))
        sides = list(torch.stack([fall, rise]).unbind(-1))
        slopes = list(torch.stack([-steep, steep]).unbind(-1))
        corners = torch.stack([cell, cell + 1]).long().unbind(-1)
        yield start + _rows(corners, counts, end - start), sides, slopes


def _rows(vertices, resolution: list[int], size: int):
    """Return (2^D, B) rows in a level's part of the table: numbered in order where all vertices fit, else hashed."""
    strides = [1]
    for count in resolution:
        strides.append(strides[-1] * count)
    if strides[-1] <= size:
        terms = [vertex * stride for vertex, stride in zip(vertices, strides[:-1], strict=True)]
        return _over_corners(terms, operator.add) % size
    terms = [(vertex * prime) & WORD for vertex, prime in zip(vertices, PRIMES[: len(vertices)], strict=True)]
    return _over_corners(terms, operator.xor) % size


def _over_corners(values, join: Callable):
    """Return (2^D, B): one value of (2, B) of each axis for every corner of a cell, joined."""
    joined = values[0]
    for value in values[1:]:
        joined = join(joined[:, None], value[None]).flatten(0, 1)
    return joined
