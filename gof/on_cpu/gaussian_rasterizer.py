"""Stand-ins for `diff_gaussian_rasterization`: the interface of 3D Gaussian Splatting's rasteriser, three variants.

| variant | returns | whose |
|---|---|---|
| plain | picture (3, H, W), radii (N,) int32 | 3D Gaussian Splatting and what descends from it |
| depth | the same, depth (1, H, W) = sum w z | the variant with depth that 4DGS (Wu) and Deformable-3DGS use |
| spacetime | the same, alpha (1, H, W), flow (2, H, W) = sum w flow_2d, covariances (N, 6) | 4DGS (Yang) |

As there: alpha at most 0.99, at least 1/255; depth above 0.2; 0.3 px^2 added; quaternions taken as they are, not
normalised; the gradient that `means2D` gets is per half picture (NDC), which thresholds of densification count in.
`means2D_densify`, of Deformable-3DGS, gets sums over pixels of absolute gradients (AbsGS; its branch is not public).
Different: a clamped alpha passes no gradient (there it does); a radius is of the wider axis at 3 standard deviations.
"""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

import torch

from gof.core.errors import DataFormatError
from gof.on_cpu.small_modules import stand_in
from gof.render import rasterize

NEAR = 0.2
LEAST_WINDOW = 0.05  # Gaussians whose temporal window is below are not drawn
SAME = 1e-3  # relative; two descriptions of one camera agree
UPPER = (0, 1, 2, 1, 3, 4, 2, 4, 5)  # of xx xy xz yy yz zz, row by row


class GaussianRasterizationSettings(NamedTuple):
    """A camera. Matrices are transposed, for row vectors: `viewmatrix` to the camera, `projmatrix` to clip space."""

    image_height: int
    image_width: int
    tanfovx: float
    tanfovy: float
    bg: torch.Tensor
    scale_modifier: float
    viewmatrix: torch.Tensor
    projmatrix: torch.Tensor
    sh_degree: int
    campos: torch.Tensor
    prefiltered: bool
    debug: bool


class SpacetimeSettings(NamedTuple):
    """The same, with the time of 4DGS (Yang)."""

    image_height: int
    image_width: int
    tanfovx: float
    tanfovy: float
    bg: torch.Tensor
    scale_modifier: float
    viewmatrix: torch.Tensor
    projmatrix: torch.Tensor
    sh_degree: int
    sh_degree_t: int
    campos: torch.Tensor
    timestamp: float
    time_duration: float
    rot_4d: bool
    gaussian_dim: int
    force_sh_3d: bool
    prefiltered: bool
    debug: bool


class _Rasterizer(torch.nn.Module):
    def __init__(self, raster_settings):
        super().__init__()
        self.raster_settings = raster_settings

    def markVisible(self, positions):
        """Return (N,) bool: in front of the near plane."""
        with torch.no_grad():
            view = self.raster_settings.viewmatrix
            return positions @ view[:3, 2] + view[3, 2] > NEAR


class PlainRasterizer(_Rasterizer):
    depth = False

    def forward(
        self,
        means3D,
        means2D,
        opacities,
        shs=None,
        colors_precomp=None,
        scales=None,
        rotations=None,
        cov3D_precomp=None,
        means2D_densify=None,
    ):
        covariance = _covariance(self.raster_settings, scales, rotations, cov3D_precomp)
        colors = (shs, colors_precomp)
        color, radii, depth, _ = draw(
            self.raster_settings, means3D, means2D, opacities, *colors, covariance, self.depth, means2D_densify
        )
        return (color, radii, depth) if self.depth else (color, radii)


class DepthRasterizer(PlainRasterizer):
    depth = True


class SpacetimeRasterizer(_Rasterizer):
    """Gaussians of 4DGS (Yang): as its Python made them at a time, or in four dimensions, conditioned on it here."""

    def forward(
        self,
        means3D,
        means2D,
        opacities,
        shs=None,
        colors_precomp=None,
        flow_2d=None,
        ts=None,
        scales=None,
        scales_t=None,
        rotations=None,
        rotations_r=None,
        cov3D_precomp=None,
        prefilter_var=-1.0,
    ):
        settings = self.raster_settings
        count, lives = len(means3D), None
        if settings.gaussian_dim == 4 and cov3D_precomp is None:
            if not settings.rot_4d or None in (ts, scales, scales_t, rotations, rotations_r):
                raise DataFormatError(
                    "diff_gaussian_rasterization: of Gaussians in four dimensions only those of rot_4d=True are drawn, "
                    "with 'ts', 'scales', 'scales_t', 'rotations' and 'rotations_r'"
                )
            offset, sigma, window = conditioned(settings, ts, scales, scales_t, rotations, rotations_r, prefilter_var)
            lives = window.detach() > LEAST_WINDOW
            rows = (means3D + offset, means2D, opacities.reshape(-1) * window, shs, colors_precomp, flow_2d, ts, sigma)
            rows = [None if row is None else row[lives] for row in rows]
            means3D, means2D, opacities, shs, colors_precomp, flow_2d, ts, sigma = rows
        else:
            sigma = _covariance(settings, scales, rotations, cov3D_precomp)
        if shs is not None and settings.gaussian_dim == 4 and not settings.force_sh_3d:
            shs = harmonics_at(settings, shs, ts)
        color, radii, depth, alpha = draw(settings, means3D, means2D, opacities, shs, colors_precomp, sigma)
        if flow_2d is None or not bool(flow_2d.any()):
            flow = torch.zeros(2, settings.image_height, settings.image_width)
        else:
            flow = draw(settings._replace(bg=torch.zeros(2)), means3D, None, opacities, None, flow_2d, sigma)[0]
        six = sigma[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
        if lives is not None:
            radii = torch.zeros(count, dtype=torch.int32).masked_scatter(lives, radii)
            six = torch.zeros(count, 6).index_put((lives.nonzero()[:, 0],), six)
        return color, radii, depth, alpha, flow, six


def conditioned(settings, ts, scales, scales_t, rotations, rotations_r, prefilter_var):
    """Return gaussians in space and time, at the time of the settings.

    The 4D rotation x -> l x r in the component order t, z, y, x, as `gof.io.importers.yang` has it.

    Args:
        ts, scales_t: (N, 1).   scales: (N, 3).   rotations, rotations_r: (N, 4), l and r, taken as they are.
    Returns:
        what is added to the means (N, 3), spatial covariances (N, 3, 3), factors of the opacities (N,).
    """
    a, b, c, d = rotations.unbind(-1)
    p, q, r, s = rotations_r.unbind(-1)
    left = torch.stack([a, -b, -c, -d, b, a, -d, c, c, d, a, -b, d, -c, b, a], -1).reshape(-1, 4, 4)
    right = torch.stack([p, q, r, s, -q, p, -s, r, -r, s, p, -q, -s, -r, q, p], -1).reshape(-1, 4, 4)
    axes = (left @ right).flip(1, 2) * (torch.cat([scales, scales_t], 1) * settings.scale_modifier)[:, None, :]
    sigma = axes @ axes.transpose(1, 2)
    cross, variance = sigma[:, :3, 3], sigma[:, 3, 3]
    delay = settings.timestamp - ts.reshape(-1)
    velocity = cross / variance[:, None]
    window = torch.exp(-0.5 * delay**2 / (variance + max(float(prefilter_var), 0.0)))
    return velocity * delay[:, None], sigma[:, :3, :3] - velocity[:, :, None] * cross[:, None, :], window


def harmonics_at(settings, shs, ts):
    """Return (N, 16, 3) of coefficients (N, K, 3) that swing as cos(2 pi k dt / duration) in blocks k = 0, 1, 2 of
    16."""
    bands = int(settings.sh_degree_t)
    if bands == 0:
        return shs[:, :16]
    if settings.sh_degree != 3 or ts is None or shs.shape[1] < 16 * (bands + 1):
        raise DataFormatError(
            f"diff_gaussian_rasterization: colours that swing need sh_degree 3, 'ts' and {16 * (bands + 1)} "
            f"coefficients; there are sh_degree {settings.sh_degree} and {shs.shape[1]}"
        )
    phase = 2 * torch.pi * (ts.reshape(-1, 1, 1) - settings.timestamp) / settings.time_duration
    return sum(torch.cos(k * phase) * shs[:, 16 * k : 16 * (k + 1)] for k in range(bands + 1))


class _Probe(torch.autograd.Function):
    """Pass the 2D means their gradient: its sum for one tensor, sums of absolute ones for another.

    The rasteriser's backward pass comes before this one's and has left the latter at the probe that this returns.
    """

    @staticmethod
    def forward(ctx, means2D, means2D_densify, half, made):
        ctx.half, ctx.made, ctx.widths = half, made, (means2D.shape[1], means2D_densify.shape[1])
        return torch.zeros(1, len(means2D), 2)

    @staticmethod
    def backward(ctx, grad):
        (probe,) = ctx.made
        gradients = (grad[0] * ctx.half, probe.absgrad[0] * ctx.half)
        padded = (
            torch.nn.functional.pad(rows, (0, wide - 2)) for rows, wide in zip(gradients, ctx.widths, strict=True)
        )
        return *padded, None, None


def draw(settings, means3D, means2D, opacities, shs, colors_precomp, covariance, depth=True, means2D_densify=None):
    """Return one picture.

    Args:
        means3D: (N, 3).  means2D: (N, 2 or more) that gets the gradient per half picture, or None.
        means2D_densify: (N, 2 or more) that gets sums of absolute gradients, or None.
        opacities: (N,) or (N, 1).  shs: (N, K, 3), or colors_precomp: (N, D).  covariance: (N, 3, 3).
    Returns:
        color (D, H, W), radii (N,) int32, depth (1, H, W) or None, alpha (1, H, W).
    Raises:
        DataFormatError: both or neither kind of colours, or a camera that contradicts itself.
    """
    if (shs is None) == (colors_precomp is None):
        raise DataFormatError("diff_gaussian_rasterization: give either 'shs' or 'colors_precomp'")
    width, height = int(settings.image_width), int(settings.image_height)
    view, K = _camera(settings, width, height)
    background = settings.bg.reshape(1, -1)
    half = torch.tensor([0.5 * width, 0.5 * height])
    probe = None
    if means2D_densify is not None:
        made: list[torch.Tensor] = []
        probe = _Probe.apply(means2D, means2D_densify, half, made)
        made.append(probe)
    elif means2D is not None:
        probe = (means2D[:, :2] * half)[None]
    image, alpha, info = rasterize(
        means3D,
        None,
        None,
        opacities.reshape(-1),
        colors_precomp if shs is None else shs,
        view[None],
        K[None],
        width,
        height,
        near_plane=NEAR,
        sh_degree=None if shs is None else int(settings.sh_degree),
        backgrounds=background,
        render_mode="RGB+D" if depth else "RGB",
        covars=covariance,
        means2d=probe,
        absgrad=means2D_densify is not None,
    )
    channels = background.shape[1]
    planes = image[0].permute(2, 0, 1)
    return planes[:channels], info["radii"][0], planes[channels:] if depth else None, alpha[0].permute(2, 0, 1)


def _camera(settings, width: int, height: int):
    """world_to_camera (4, 4), and K (3, 3) with the principal point that the projection has."""
    view = settings.viewmatrix.detach().T.float()
    projection = (settings.projmatrix.detach().double().T @ torch.linalg.inv(view.double())).float()
    w = projection[3, 2]
    fx, fy = width / (2 * settings.tanfovx), height / (2 * settings.tanfovy)
    seen = torch.stack([projection[0, 0], projection[1, 1]]) / w * torch.tensor([width / 2, height / 2])
    if width != height and abs(fx / fy / (width / height) ** 2 - 1) < SAME:
        raise DataFormatError(
            f"diff_gaussian_rasterization: the fields of view across and down are exchanged ({width}x{height} px with "
            f"focal lengths {fx:.6g} and {fy:.6g} px), as some D-NeRF readers do; train on the 'nerfds' view"
        )
    given = torch.tensor([fx, fy], dtype=torch.float32)
    if not torch.allclose(seen, given, rtol=SAME):
        raise DataFormatError(
            f"diff_gaussian_rasterization: 'projmatrix' has focal lengths {seen.tolist()} px, 'tanfovx' and 'tanfovy' "
            f"{given.tolist()} px"
        )
    eye = -view[:3, :3].T @ view[:3, 3]
    if not torch.allclose(eye, settings.campos.detach().float().reshape(3), rtol=SAME, atol=SAME):
        raise DataFormatError(
            f"diff_gaussian_rasterization: 'campos' is {settings.campos.tolist()}, but 'viewmatrix' stands at "
            f"{eye.tolist()}"
        )
    K = torch.eye(3)
    K[0, 0], K[1, 1] = fx, fy
    K[0, 2], K[1, 2] = (projection[0, 2] / w + 1) * width / 2, (projection[1, 2] / w + 1) * height / 2
    return view, K


def _covariance(settings, scales, rotations, cov3D_precomp):
    """Return (N, 3, 3) of the six numbers given, or of scales and quaternions."""
    if (cov3D_precomp is None) == (scales is None or rotations is None):
        raise DataFormatError("diff_gaussian_rasterization: give either 'scales' and 'rotations', or 'cov3D_precomp'")
    if cov3D_precomp is not None:
        return cov3D_precomp[:, UPPER].reshape(-1, 3, 3)
    return covariance(scales * settings.scale_modifier, rotations)


def covariance(scales, quaternions):
    """Return (N, 3, 3) R S S^T R^T of scales (N, 3) and quaternions wxyz (N, 4), which are not normalised, as in
    CUDA."""
    w, x, y, z = quaternions.unbind(-1)
    R = torch.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        -1,
    ).reshape(-1, 3, 3)
    axes = R * scales[:, None, :]
    return axes @ axes.transpose(1, 2)


def module(variant: str) -> ModuleType:
    """`diff_gaussian_rasterization` in a variant of the table above."""
    settings = SpacetimeSettings if variant == "spacetime" else GaussianRasterizationSettings
    rasterizer = {"plain": PlainRasterizer, "depth": DepthRasterizer, "spacetime": SpacetimeRasterizer}[variant]
    return stand_in(
        "diff_gaussian_rasterization", GaussianRasterizationSettings=settings, GaussianRasterizer=rasterizer
    )
