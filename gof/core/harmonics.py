"""Real spherical harmonics to degree 3: the basis and signs in which 3D Gaussian Splatting stores colours.

A display colour is 0.5 + sum_k coefficient_k basis_k(direction), clipped at 0.
"""

from __future__ import annotations

import numpy as np

C0 = 0.28209479177387814  # sqrt(1 / (4 pi)): the constant harmonic
C1 = 0.4886025119029199  # sqrt(3 / (4 pi))
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


def basis(degree: int, d) -> list:
    """Return the (degree + 1)^2 basis values in unit direction d = (x, y, z); works on Dr.Jit and numpy arrays."""
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


def plain_color(color: np.ndarray) -> np.ndarray:
    """Return (N, 3) display colours without dependence on direction, of display colours (N, 3) or coefficients (N, K,
    3)."""
    return color if color.ndim == 2 else 0.5 + C0 * color[:, 0]


def turned(color: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Return colours (N, K, 3) seen from a world turned by R (3, 3); display colours (N, 3) stay as they are.

    A function of degree <= 3 stays in its space under rotation, so a least-squares fit over directions is exact.
    """
    if color.ndim == 2 or color.shape[1] == 1:
        return color
    degree = int(np.sqrt(color.shape[1])) - 1
    i = np.arange(200) + 0.5  # a Fibonacci spiral: evenly over the sphere
    z, angle = 1 - 2 * i / 200, np.pi * (1 + np.sqrt(5)) * i
    d = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], 1)
    before, after = np.stack(basis(degree, d.T), 1), np.stack(basis(degree, (d @ R.T).T), 1)
    return np.einsum("kl,nlc->nkc", np.linalg.pinv(after) @ before, color)
