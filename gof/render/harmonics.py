"""View-dependent colour of spherical-harmonics coefficients, differentiable; the basis is `gof.core.harmonics`."""

from __future__ import annotations

import drjit as dr

from gof.core.errors import DataFormatError
from gof.core.harmonics import basis
from gof.render.backend import Array3f, Float


def harmonics_color(coefficients: list[list[Float]], position: Array3f, eye: Array3f, degree: int) -> list[Float]:
    """max(0, 0.5 + sum_k coefficient_k basis_k(direction)) per channel.

    Args:
        coefficients: K lists of D channels (N,), K >= (degree + 1)^2; higher ones are ignored.
        position: (N,) world metres.  eye: camera centre, world metres.
        degree: 0 to 3.
    Raises:
        DataFormatError: degree out of range or too few coefficients.
    """
    if not 0 <= degree <= 3 or len(coefficients) < (degree + 1) ** 2:
        raise DataFormatError(
            f"sh_degree {degree} needs {(max(degree, 0) + 1) ** 2} coefficients and at most degree 3; "
            f"got {len(coefficients)}"
        )
    d = position - eye
    norm2 = dr.squared_norm(d)
    away = norm2 > 1e-24  # a centre on the camera has no direction: it is not drawn, its direction is (0, 0, 0)
    d = d * dr.select(away, 1 / dr.sqrt(dr.select(away, norm2, 1.0)), 0.0)
    b = basis(degree, d)
    channels = len(coefficients[0])
    return [dr.maximum(0.5 + sum(b[k] * coefficients[k][ch] for k in range(len(b))), 0.0) for ch in range(channels)]
