"""gsplat's own call, `gsplat.rendering.rasterization` (gsplat 1.6), by our renderer.

Different from gsplat: "radii" has the wider axis at 3 standard deviations in both columns (there: each axis, cut
where alpha falls below 1/255); of "info" only what strategies read is there, and asking for another entry is an error;
no leading batch dimensions.
"""

from __future__ import annotations

from typing import Any

import torch

from gof.core.errors import DataFormatError
from gof.render.torch_api import rasterize

MAX_ALPHA = 0.999
ONLY = {  # by argument the one value that is drawn here
    "distributed": False,
    "camera_model": "pinhole",
    "with_ut": False,
    "with_eval3d": False,
    "return_normals": False,
    "global_z_order": True,
    "rays": None,
    "radial_coeffs": None,
    "tangential_coeffs": None,
    "thin_prism_coeffs": None,
    "ftheta_coeffs": None,
    "lidar_coeffs": None,
    "external_distortion_coeffs": None,
    "rolling_shutter": None,
    "viewmats_rs": None,
    "extra_signals": None,
    "extra_signals_sh_degree": None,
    "renderer_config": None,
}


def rasterization(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmats,
    Ks,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int | None = None,
    backgrounds=None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: str = "pinhole",
    segmented: bool = False,
    covars=None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    return_normals: bool = False,
    global_z_order: bool = True,
    rays=None,
    radial_coeffs=None,
    tangential_coeffs=None,
    thin_prism_coeffs=None,
    ftheta_coeffs=None,
    lidar_coeffs=None,
    external_distortion_coeffs=None,
    rolling_shutter=None,
    viewmats_rs=None,
    ut_params=None,
    extra_signals=None,
    extra_signals_sh_degree: int | None = None,
    renderer_config=None,
):
    """gsplat's call, with its names, their order, shapes and defaults; `gof.render.rasterize` says what each means.

    Args:
        tile_size, channel_chunk, segmented, ut_params: taken and without effect, as they choose how gsplat works.
        distributed to renderer_config: only with the value that they have by default, "rolling_shutter" also as
            gsplat's `RollingShutterType.GLOBAL`.
    Returns:
        colors (C, H, W, D), alphas (C, H, W, 1), and an info with "means2d" and "radii" of (C, N, 2), or packed of
        (those drawn, 2) beside their "camera_ids" and "gaussian_ids".
    Raises:
        DataFormatError: an argument needs something that is not drawn here.
    """
    _require_defaults(locals())
    if covars is not None:
        quats = scales = None
    cut = {"near_plane": near_plane, "far_plane": far_plane, "radius_clip": radius_clip, "max_alpha": MAX_ALPHA}
    modes = {"sh_degree": sh_degree, "render_mode": render_mode, "rasterize_mode": rasterize_mode, "eps2d": eps2d}
    gradients = {"sparse_grad": sparse_grad, "absgrad": absgrad}
    gaussians = means, quats, scales, opacities, colors
    image, alpha, drawn = rasterize(
        *gaussians, viewmats, Ks, width, height, backgrounds=backgrounds, covars=covars, **cut, **modes, **gradients
    )
    drawn |= {"radii": drawn["radii"][..., None].expand(-1, -1, 2), "gaussian_ids": None, "n_batches": 1}
    if packed:
        drawn |= _packed(drawn["means2d"], drawn["radii"], absgrad)
    return image, alpha, drawn


def _require_defaults(arguments: dict[str, Any]) -> None:
    """Raise DataFormatError where one of these arguments has a value that is not drawn here."""
    for name, only in ONLY.items():
        given = arguments[name]
        if name == "rolling_shutter" and getattr(given, "name", None) == "GLOBAL":
            continue
        if given is not only and (only is None or isinstance(given, torch.Tensor) or given != only):
            raise DataFormatError(f"gsplat.rasterization: '{name}' is {given!r}; only {only!r} is drawn here")


def _packed(means2d, radii, absgrad: bool) -> dict:
    """Rows of what is drawn only; its gradient is copied from the whole as soon as that is known."""
    cameras, gaussians = torch.where((radii > 0).all(-1))
    rows = means2d.detach()[cameras, gaussians].requires_grad_(means2d.requires_grad)
    if absgrad:
        rows.absgrad = torch.zeros_like(rows)

    def copy(gradient):
        rows.grad = gradient[cameras, gaussians]
        if absgrad:
            rows.absgrad.copy_(means2d.absgrad[cameras, gaussians])

    if means2d.requires_grad:
        means2d.register_hook(copy)
    return {"means2d": rows, "radii": radii[cameras, gaussians], "camera_ids": cameras, "gaussian_ids": gaussians}
