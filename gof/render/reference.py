"""Plain numpy float64 twins of the renderer: what the kernels must compute, written for reading, not for speed.

Every pixel loops over all Gaussians in depth order; nothing is binned, so these twins also check that binning loses
nothing.
"""

from __future__ import annotations

import numpy as np

from gof.core.cameras import Camera

MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE = 0.99, 1 / 255, 1e-4


def transient_state(position, velocity, t_mu, t_sigma, opacity, time_s, dynamic=None):
    """(N, 3) position and (N,) opacity at `time_s`; see `gof.render.transient_state`."""
    dt = time_s - np.asarray(t_mu, np.float64)
    if dynamic is not None:
        dt = np.where(dynamic, dt, 0.0)
    z = dt / np.maximum(t_sigma, 1e-6)
    return position + dt[:, None] * velocity, opacity * np.exp(-0.5 * z * z)


def rotation_matrix(q: np.ndarray) -> np.ndarray:
    """(N, 4) quaternions wxyz to (N, 3, 3); a zero quaternion is the identity."""
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    w, x, y, z = np.moveaxis(np.where(norm > 1e-12, q / np.maximum(norm, 1e-300), 0.0), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def project(
    position, rotation, scale, opacity, camera: Camera, near=0.01, antialias=False, dilation=0.3, covariance=None
):
    """mean2d (N, 2) px, dilated 2D covariance (N, 2, 2) px^2, depth (N,) m, opacity (N,), visible (N,) bool.

    Args:
        covariance: (N, 3, 3) in the world, m^2, instead of rotation and scale.
    """
    K, W = camera.K, camera.world_to_camera
    p = np.asarray(position, np.float64) @ W[:3, :3].T + W[:3, 3]
    depth = p[:, 2]
    visible = depth > near
    z = np.where(visible, depth, 1.0)
    slope = p[:, :2] / z[:, None]
    mean2d = slope @ K[:2, :2].T + K[:2, 2]
    size = np.array([camera.width, camera.height])
    focal = np.diag(K)[:2]
    s = np.clip(slope, (-0.15 * size - K[:2, 2]) / focal, (1.15 * size - K[:2, 2]) / focal)
    J = np.zeros((len(p), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1 / z
    J[:, :, 2] = -s / z[:, None]
    if covariance is None:
        axes = rotation_matrix(np.asarray(rotation, np.float64)) * np.asarray(scale, np.float64)[:, None, :]
        covariance = axes @ axes.transpose(0, 2, 1)
    P = K[:2, :2] @ J @ W[:3, :3]
    before = P @ covariance @ P.transpose(0, 2, 1)
    cov = before + dilation * np.eye(2)
    opacity = np.asarray(opacity, np.float64)
    if antialias:
        opacity = opacity * np.sqrt(np.maximum(np.linalg.det(before) / np.linalg.det(cov), 1e-12))
    return mean2d, cov, depth, opacity, visible


def render(
    position,
    rotation,
    scale,
    opacity,
    color,
    camera: Camera,
    background=None,
    near=0.01,
    antialias=False,
    min_alpha=MIN_ALPHA,
    max_alpha=MAX_ALPHA,
    covariance=None,
    shift=0.0,
):
    """Draw N Gaussians.

    Args:
        color: (N, D).  background: (D,) or (H, W, D).
        min_alpha: the skip threshold; 0 draws the smooth image that central differences can differentiate.
        max_alpha: the clamp.  covariance: see `project`.  shift: (N, 2) px that the projected means are moved by.
    Returns:
        color (H, W, D), alpha (H, W), depth (H, W) = sum w z.
    """
    shape = rotation, scale, opacity, camera, near, antialias
    mean, cov, depth, opacity, visible = project(position, *shape, covariance=covariance)
    mean = mean + shift
    H, W, D = camera.height, camera.width, np.shape(color)[1]
    x, y = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    T, alive = np.ones((H, W)), np.ones((H, W), bool)
    out, z_sum = np.zeros((H, W, D)), np.zeros((H, W))
    color = np.asarray(color, np.float64)
    for i in np.argsort(depth, kind="stable"):
        if not visible[i]:
            continue
        conic = np.linalg.inv(cov[i])
        dx, dy = x - mean[i, 0], y - mean[i, 1]
        q = conic[0, 0] * dx * dx + 2 * conic[0, 1] * dx * dy + conic[1, 1] * dy * dy
        alpha = opacity[i] * np.exp(-0.5 * q)
        drawn = alive & (alpha >= min_alpha)
        alpha = np.minimum(alpha, max_alpha)
        rest = T * (1 - alpha)
        stops = drawn & (rest < MIN_TRANSMITTANCE)
        alive &= ~stops
        w = np.where(drawn & ~stops, T * alpha, 0.0)
        T = np.where(drawn & ~stops, rest, T)
        out += w[..., None] * color[i]
        z_sum += w * depth[i]
    if background is not None:
        out = out + T[..., None] * np.asarray(background, np.float64)
    return out, 1 - T, z_sum


def harmonics_color(coefficients, position, eye, degree):
    """(N, D) colours of coefficients (N, K, D) seen from `eye`; twin of `gof.render.harmonics.harmonics_color`."""
    from math import factorial

    from scipy.special import lpmv

    d = np.asarray(position, np.float64) - eye
    d = d / np.maximum(np.linalg.norm(d, axis=-1, keepdims=True), 1e-300)
    azimuth = np.arctan2(d[:, 1], d[:, 0])
    basis = []
    for l in range(degree + 1):
        for m in range(-l, l + 1):
            k = abs(m)
            # lpmv keeps the Condon-Shortley phase, which gives the signs 3D Gaussian Splatting uses.
            both_signs = 1 if m == 0 else np.sqrt(2)
            size = both_signs * np.sqrt((2 * l + 1) / (4 * np.pi) * factorial(l - k) / factorial(l + k))
            basis.append(size * lpmv(k, l, d[:, 2]) * (np.sin(k * azimuth) if m < 0 else np.cos(k * azimuth)))
    values = np.einsum("kn,nkd->nd", np.array(basis), np.asarray(coefficients, np.float64)[:, : len(basis)])
    return np.maximum(0.5 + values, 0.0)


def shutter_delay(position, velocity, camera: Camera, exact=True, near=0.01, min_relative_speed=0.1):
    """(N,) s; twin of `gof.render.shutter_delay`."""
    p = camera.to_camera(position)
    seen = p[:, 2] > near
    safe = np.where(seen[:, None], p, [0.0, 0.0, 1.0])
    pixels = safe[:, :2] / safe[:, 2:] @ camera.K[:2, :2].T + camera.K[:2, 2]
    v = np.asarray(velocity, np.float64) @ camera.world_to_camera[:3, :3].T
    speed = (v[:, :2] - safe[:, :2] / safe[:, 2:] * v[:, 2:]) / safe[:, 2:] @ camera.K[:2, :2].T
    axis, sign = {"right": (0, 1), "left": (0, -1), "down": (1, 1), "up": (1, -1)}[camera.readout]
    size = (camera.width, camera.height)[axis]
    line = pixels[:, axis] - 0.5 if sign > 0 else size - 0.5 - pixels[:, axis]
    delay = camera.row_time_s * np.clip(line, -size, 2 * size)
    if exact:
        delay = delay / np.maximum(1 - camera.row_time_s * sign * speed[:, axis], min_relative_speed)
    return np.where(seen, delay, 0.0)


def gaussian_window(size=11, sigma=1.5) -> np.ndarray:
    """(size,) normalised window of 3D Gaussian Splatting's SSIM. `gof.render.ssim` has its own, to be compared."""
    w = np.exp(-0.5 * ((np.arange(size) - size // 2) / sigma) ** 2)
    return w / w.sum()


def blur(image: np.ndarray) -> np.ndarray:
    """Separable 11x11 Gaussian window over the first two axes, zero outside the image."""
    w, r = gaussian_window(), 5
    out = np.asarray(image, np.float64)
    for axis in (0, 1):
        pad = [(0, 0)] * out.ndim
        pad[axis] = (r, r)
        padded, n = np.pad(out, pad), out.shape[axis]
        out = sum(w[k] * np.take(padded, np.arange(k, k + n), axis) for k in range(11))
    return out


def l1_ssim(image, target, ssim_weight=0.2, mask=None, square_weight=0.0) -> float:
    """(1 - w) mean |x - y| + w (1 - mean SSIM) + s mean (x - y)^2; twin of `gof.render.l1_ssim`, (H, W, D) arrays."""
    x, y = np.asarray(image, np.float64), np.asarray(target, np.float64)
    weight = np.ones(x.shape[:2]) if mask is None else np.asarray(mask, np.float64)
    weight = (weight / max(weight.sum() * x.shape[2], 1e-12))[..., None]
    mu_x, mu_y = blur(x), blur(y)
    var_x, var_y, cov = blur(x * x) - mu_x**2, blur(y * y) - mu_y**2, blur(x * y) - mu_x * mu_y
    c1, c2 = 0.01**2, 0.03**2
    ssim = (2 * mu_x * mu_y + c1) * (2 * cov + c2) / ((mu_x**2 + mu_y**2 + c1) * (var_x + var_y + c2))
    apart = (1 - ssim_weight) * np.abs(x - y) + square_weight * (x - y) ** 2
    return float((weight * (apart + ssim_weight * (1 - ssim))).sum())
