"""Stand-ins for `diff_gaussian_rasterization`: the interface of 3D Gaussian Splatting's rasteriser, three variants.

| variant | returns | whose |
|---|---|---|
| plain | picture (3, H, W), radii (N,) int32 | 3D Gaussian Splatting and what descends from it |
| depth | the same, depth (1, H, W) = sum w z | the variant with depth that 4DGS (Wu) and Deformable-3DGS use |
| spacetime | the same, alpha (1, H, W), flow (2, H, W) = sum w flow_2d, covariances (N, 6) | 4DGS (Yang) |

As there: alpha at most 0.99, at least 1/255; depth above 0.2; 0.3 px^2 added; quaternions taken as they are, not
normalised; the gradient that `means2D` gets is per half picture (NDC), which thresholds of densification count in.
Different: a clamped alpha passes no gradient (there it does); a radius is of the wider axis at 3 standard deviations.
"""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

import torch

from gof.errors import DataFormatError
from gof.render import rasterize

NEAR = 0.2
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
        """(N,) bool: in front of the near plane."""
        with torch.no_grad():
            view = self.raster_settings.viewmatrix
            return positions @ view[:3, 2] + view[3, 2] > NEAR


class PlainRasterizer(_Rasterizer):
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
    ):
        covariance = _covariance(self.raster_settings, scales, rotations, cov3D_precomp)
        color, radii, _, _ = draw(
            self.raster_settings, means3D, means2D, opacities, shs, colors_precomp, covariance, depth=False
        )
        return color, radii


class DepthRasterizer(_Rasterizer):
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
    ):
        covariance = _covariance(self.raster_settings, scales, rotations, cov3D_precomp)
        color, radii, depth, _ = draw(
            self.raster_settings, means3D, means2D, opacities, shs, colors_precomp, covariance
        )
        return color, radii, depth


class SpacetimeRasterizer(_Rasterizer):
    """Covariances and colours at the time must come from the method's own Python, as two options of it say."""

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
        spacetime = settings.gaussian_dim == 4
        if spacetime and (cov3D_precomp is None or (shs is not None and not settings.force_sh_3d)):
            raise DataFormatError(
                "diff_gaussian_rasterization: what of 4DGS (Yang) is compiled into its rasteriser does not run here; "
                "set compute_cov3D_python and convert_SHs_python to True in the configuration, its own options "
                "for the same in Python"
            )
        if prefilter_var > 0:
            raise DataFormatError("diff_gaussian_rasterization: 'prefilter_var' is compiled in; leave it at -1")
        covariance = _covariance(settings, scales, rotations, cov3D_precomp)
        color, radii, depth, alpha = draw(settings, means3D, means2D, opacities, shs, colors_precomp, covariance)
        if flow_2d is None or not bool(flow_2d.any()):
            flow = torch.zeros(2, settings.image_height, settings.image_width)
        else:
            flow = draw(settings._replace(bg=torch.zeros(2)), means3D, None, opacities, None, flow_2d, covariance)[0]
        return color, radii, depth, alpha, flow, covariance[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]


def draw(settings, means3D, means2D, opacities, shs, colors_precomp, covariance, depth=True):
    """One picture.

    Args:
        means3D: (N, 3).  means2D: (N, 2 or more) that gets the gradient per half picture, or None.
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
    if len(means3D) == 0:
        empty = [torch.zeros(1, height, width)] * 2
        return background.reshape(-1, 1, 1).expand(-1, height, width), torch.zeros(0, dtype=torch.int32), *empty
    probe = None
    if means2D is not None:
        probe = (means2D[:, :2] * torch.tensor([0.5 * width, 0.5 * height]))[None]
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
    told = torch.tensor([fx, fy], dtype=torch.float32)
    if not torch.allclose(seen, told, rtol=SAME):
        raise DataFormatError(
            f"diff_gaussian_rasterization: 'projmatrix' has focal lengths {seen.tolist()} px, 'tanfovx' and 'tanfovy' "
            f"{told.tolist()} px"
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
    """(N, 3, 3) of the six numbers given, or of scales and quaternions."""
    if (cov3D_precomp is None) == (scales is None or rotations is None):
        raise DataFormatError("diff_gaussian_rasterization: give either 'scales' and 'rotations', or 'cov3D_precomp'")
    if cov3D_precomp is not None:
        return cov3D_precomp[:, UPPER].reshape(-1, 3, 3)
    return covariance(scales * settings.scale_modifier, rotations)


def covariance(scales, quaternions):
    """(N, 3, 3) R S S^T R^T of scales (N, 3) and quaternions wxyz (N, 4), which are not normalised, as in CUDA."""
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
    found = ModuleType("diff_gaussian_rasterization")
    found.GaussianRasterizationSettings, found.GaussianRasterizer = settings, rasterizer
    return found
