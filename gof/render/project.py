"""EWA projection of 3D Gaussians to 2D Gaussians in the image (Zwicker et al. 2001; Kerbl et al. 2023, section 4).

Written with Dr.Jit's AD arrays, so its derivative comes from Dr.Jit. Every root and quotient is guarded before it is
taken, never masked afterwards: a masked infinity still becomes NaN in a derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError
from gof.render.backend import Array3f, Array4f, Bool, Float, UInt, opaque

LOG2_E = 1.4426950408889634
MAX_SIGMA_PX = 1e6  # wider Gaussians are drawn this wide (flat over any image) so that determinants stay in float32
MAX_MEAN_PX = 1e7  # centres further out than this are not drawn: float32 no longer resolves a pixel there
MIN_OPACITY = 1e-20  # below: log2 is replaced by a constant, gradient 0


@dataclass(frozen=True)
class ProjectionOptions:
    """Settings of the projection of Gaussians into a picture.

    Args:
        near, far: m, near > 0; centres at or outside these depths are not drawn and get gradient 0.
        dilation: px^2, > 0, added to the 2D covariance: with 0.3 no Gaussian is thinner than about half a pixel.
        antialias: scale opacity by sqrt(det before / det after dilation), so that small Gaussians keep their energy.
        min_radius: px; Gaussians whose 3 standard deviations are shorter are not drawn.

    Raises:
        DataFormatError: near or dilation is not positive.
    """

    near: float = 0.01
    far: float = 1e10
    dilation: float = 0.3
    antialias: bool = False
    min_radius: float = 0.0

    def __post_init__(self):
        for name in ("near", "dilation"):
            if not getattr(self, name) > 0:
                raise DataFormatError(f"'{name}' is {getattr(self, name)}; it must be > 0")


@dataclass
class Projected:
    """2D Gaussians in pixels; N entries each.

    alpha at pixel offset (dx, dy) from the mean is 2^(log2_opacity - a dx^2 - b dx dy - c dy^2).
    """

    mean_x: Float
    mean_y: Float
    a: Float
    b: Float
    c: Float
    log2_opacity: Float
    depth: Float
    visible: Bool  # in front of `near` and numerically drawable
    cov_xx: Float  # px^2, dilated
    cov_xy: Float
    cov_yy: Float
    det: Float
    top: UInt | None = None  # first block row of its picture, where several stand one below the other

    @property
    def radius(self) -> Float:
        """3 standard deviations along the longer axis, px; 0 = not drawable."""
        mid = 0.5 * (self.cov_xx + self.cov_yy)
        longest = mid + dr.sqrt(dr.maximum(mid * mid - self.det, 0.0))
        return dr.select(self.visible, 3.0 * dr.sqrt(longest), 0.0)


def rotation_columns(q: Array4f) -> tuple[Array3f, Array3f, Array3f]:
    """Columns of the rotation matrix of quaternion wxyz; normalised here, a zero quaternion is the identity."""
    norm2 = dr.squared_norm(q)
    usable = norm2 > 1e-24
    q = q * dr.select(usable, 1.0 / dr.sqrt(dr.select(usable, norm2, 1.0)), 0.0)
    w, x, y, z = q
    return (
        Array3f(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        Array3f(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        Array3f(2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def camera_axes(camera: Camera, pose: list[Float] | None = None) -> tuple[list[Array3f], list[Float]]:
    """Return rows of the world-to-camera rotation, and its translation; `pose` (row-major 3x4) replaces its own."""
    w = [opaque(v) for v in camera.world_to_camera[:3].reshape(-1)] if pose is None else pose
    return [Array3f(*w[4 * i : 4 * i + 3]) for i in range(3)], [w[3], w[7], w[11]]


def project(
    position: Array3f,
    rotation: Array4f | None,
    scale: Array3f | None,
    opacity: Float,
    camera: Camera,
    options: ProjectionOptions,
    pose: list[Float] | None = None,
    covariance: list[Float] | None = None,
) -> Projected:
    """Project N Gaussians.

    Args:
        position, rotation, scale, opacity, covariance: see `Splats`.
        camera: pinhole camera; skew allowed.
        pose: differentiable world-to-camera values instead of the camera's own.
    """
    fx, skew, cx, fy, cy = (opaque(camera.K[i]) for i in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2)))
    axes, offset = camera_axes(camera, pose)
    x, y, z = (dr.dot(axes[i], position) + offset[i] for i in range(3))

    visible = (z > opaque(options.near)) & (z < opaque(options.far))
    inv_z = 1.0 / dr.select(visible, z, 1.0)
    u, v = x * inv_z, y * inv_z
    mean_x, mean_y = fx * u + skew * v + cx, fy * v + cy
    visible &= (dr.abs(mean_x) < MAX_MEAN_PX) & (dr.abs(mean_y) < MAX_MEAN_PX)

    # The linearisation is taken no further out than 0.3 field widths beyond the image (as gsplat does): the affine
    # approximation would otherwise smear a grazing Gaussian over the whole picture.
    (u_lo, u_hi), (v_lo, v_hi) = _slope_limits(camera)
    u, v = dr.clip(u, opaque(u_lo), opaque(u_hi)), dr.clip(v, opaque(v_lo), opaque(v_hi))
    along_v = axes[1] - v * axes[2]
    row_x = fx * (axes[0] - u * axes[2]) + skew * along_v
    row_y = fy * along_v

    limit = MAX_SIGMA_PX / opaque(max(camera.K[0, 0], camera.K[1, 1]))
    if covariance is None:
        xx, yy, xy, det_before = _project_axes(row_x, row_y, rotation, [dr.minimum(s * inv_z, limit) for s in scale])
    else:
        xx, yy, xy, det_before = _project_covariance(row_x, row_y, covariance, inv_z * inv_z, limit * limit)
    dilation = opaque(options.dilation)
    det = det_before + dilation * (xx + yy) + dilation * dilation
    xx, yy = xx + dilation, yy + dilation
    inv_det = 1.0 / det
    if options.antialias:
        opacity = opacity * dr.sqrt(dr.maximum(det_before * inv_det, 1e-12))
    out = Projected(
        mean_x=mean_x,
        mean_y=mean_y,
        a=(0.5 * LOG2_E) * yy * inv_det,
        b=-LOG2_E * xy * inv_det,
        c=(0.5 * LOG2_E) * xx * inv_det,
        log2_opacity=dr.log2(dr.maximum(opacity, MIN_OPACITY)),
        depth=z,
        visible=visible,
        cov_xx=xx,
        cov_xy=xy,
        cov_yy=yy,
        det=det,
    )
    if options.min_radius > 0:
        out.visible = visible & (dr.detach(out).radius >= opaque(options.min_radius))
    return out


def _project_axes(row_x: Array3f, row_y: Array3f, rotation: Array4f, size: list[Float]) -> tuple[Float, ...]:
    """xx, yy, xy and determinant of a 2D covariance whose axes have these sizes over their depth."""
    columns = rotation_columns(rotation)
    mx = Array3f(*(size[k] * dr.dot(row_x, columns[k]) for k in range(3)))
    my = Array3f(*(size[k] * dr.dot(row_y, columns[k]) for k in range(3)))
    # det(M M^T) = |m_x x m_y|^2 (Lagrange): no cancellation for long thin Gaussians, unlike xx yy - xy^2.
    return dr.squared_norm(mx), dr.squared_norm(my), dr.dot(mx, my), dr.squared_norm(dr.cross(mx, my))


def _project_covariance(
    row_x: Array3f, row_y: Array3f, covariance: list[Float], inv_z2: Float, limit2: Float
) -> tuple[Float, ...]:
    """Return the same of a covariance in the world, whose trace over depth^2 is held at `limit2`."""
    trace = dr.maximum(covariance[0] + covariance[3] + covariance[5], 1e-30)
    xx, xy, xz, yy, yz, zz = (v * dr.minimum(inv_z2, limit2 / trace) for v in covariance)
    along_x, along_y = (
        Array3f(*(dr.dot(Array3f(*c), row) for c in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))))
        for row in (row_x, row_y)
    )
    # det(P C P^T) = n . adj(C) n with n = row_x x row_y (Cauchy and Binet), for the same reason as above.
    n = dr.cross(row_x, row_y)
    adjugate = (
        (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy),
        (xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz),
        (xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy),
    )
    det = sum(n[i] * dr.dot(Array3f(*adjugate[i]), n) for i in range(3))
    return dr.dot(row_x, along_x), dr.dot(row_y, along_y), dr.dot(row_y, along_x), dr.maximum(det, 0.0)


def _slope_limits(camera: Camera) -> tuple[tuple[float, float], tuple[float, float]]:
    """Bounds of x/z and y/z for the linearisation: the image, widened by 0.15 of its width or height on each side."""
    out = []
    for axis, pixels in ((0, camera.width), (1, camera.height)):
        f, c = camera.K[axis, axis], camera.K[axis, 2]
        margin = 0.15 * pixels
        out.append(((-margin - c) / f, (pixels + margin - c) / f))
    return out[0], out[1]
