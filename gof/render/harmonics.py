"""Real spherical harmonics to degree 3 as view-dependent colour (the basis and signs 3D Gaussian Splatting stores)."""

from __future__ import annotations

import drjit as dr

from gof.errors import DataFormatError
from gof.render.backend import Array3f, Float

C0 = 0.28209479177387814  # sqrt(1 / (4 pi))
C1 = 0.4886025119029199  # sqrt(3 / (4 pi))
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


def basis(degree: int, d) -> list:
    """The (degree + 1)^2 basis values in unit direction d = (x, y, z); works on Dr.Jit and numpy arrays."""
    x, y, z = d
    out = [C0 + 0 * x]
    if degree > 0:
        out += [-C1 * y, C1 * z, -C1 * x]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        out += [C2[0] * x * y, -C2[0] * y * z, C2[1] * (2 * zz - xx - yy), -C2[0] * x * z, C2[2] * (xx - yy)]
    if degree > 2:
        out += [
            -C3[0] * y * (3 * xx - yy),
            C3[1] * x * y * z,
            -C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -C3[2] * x * (4 * zz - xx - yy),
            C3[4] * z * (xx - yy),
            -C3[0] * x * (xx - 3 * yy),
        ]
    return out


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
            f"sh_degree {degree} needs {(max(degree, 0) + 1) ** 2} coefficients and at most degree 3; got {len(coefficients)}"
        )
    d = position - eye
    norm2 = dr.squared_norm(d)
    away = norm2 > 1e-24  # a centre on the camera has no direction: it is not drawn, its direction is (0, 0, 0)
    d = d * dr.select(away, 1 / dr.sqrt(dr.select(away, norm2, 1.0)), 0.0)
    b = basis(degree, d)
    channels = len(coefficients[0])
    return [dr.maximum(0.5 + sum(b[k] * coefficients[k][ch] for k in range(len(b))), 0.0) for ch in range(channels)]
