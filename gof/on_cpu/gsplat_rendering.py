"""`gsplat.rendering.rasterization` (gsplat 1.5) by our renderer; the rest of gsplat, its strategies too, is its own.

Different from gsplat: "radii" has the wider axis at 3 standard deviations in both columns (there: each axis, cut
where alpha falls below 1/255); of "info" only what strategies read is there, and asking for another entry is an error.
"""

from __future__ import annotations

import torch

from gof.errors import DataFormatError
from gof.render import rasterize

MAX_ALPHA = 0.999
# Arguments that change the picture and are not drawn here, with the only value that is taken.
ONLY = {
    "distributed": False,
    "camera_model": "pinhole",
    "segmented": False,
    "with_ut": False,
    "with_eval3d": False,
    "radial_coeffs": None,
    "tangential_coeffs": None,
    "thin_prism_coeffs": None,
    "ftheta_coeffs": None,
    "viewmats_rs": None,
}


class Info(dict):
    """What gsplat tells of a drawing, as far as it is known here."""

    def __missing__(self, key):
        raise DataFormatError(f"gsplat.rasterization: info['{key}'] is not made here; of it there is {sorted(self)}")


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
    tile_size: int = 16,
    backgrounds=None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    covars=None,
    **others,
):
    """gsplat's call, with its names, shapes and defaults; `gof.render.rasterize` says what each means.

    Returns:
        colors (C, H, W, D), alphas (C, H, W, 1), and an info with "means2d" and "radii" of (C, N, 2), or packed of
        (those drawn, 2) beside their "camera_ids" and "gaussian_ids".
    Raises:
        DataFormatError: an argument that gsplat 1.5 does not have, or that is not drawn here.
    """
    for name, value in others.items():
        if name == "rolling_shutter" and getattr(value, "name", None) == "GLOBAL":
            continue
        if name not in ONLY or (value is not ONLY[name] and value != ONLY[name]):
            taken = f"only {ONLY[name]!r} is drawn here" if name in ONLY else "gsplat 1.5 has no such argument"
            raise DataFormatError(f"gsplat.rasterization: '{name}' is {value!r}; {taken}")
    if covars is not None:
        quats = scales = None
    image, alpha, drawn = rasterize(
        means,
        quats,
        scales,
        opacities,
        colors,
        viewmats,
        Ks,
        width,
        height,
        near_plane=near_plane,
        far_plane=far_plane,
        radius_clip=radius_clip,
        eps2d=eps2d,
        sh_degree=sh_degree,
        backgrounds=backgrounds,
        render_mode=render_mode,
        rasterize_mode=rasterize_mode,
        sparse_grad=sparse_grad,
        absgrad=absgrad,
        covars=covars,
        max_alpha=MAX_ALPHA,
    )
    means2d, radii = drawn["means2d"], drawn["radii"][..., None].expand(-1, -1, 2)
    info = Info(width=width, height=height, n_cameras=len(viewmats), tile_size=tile_size, gaussian_ids=None)
    info |= {"means2d": means2d, "radii": radii, "opacities": opacities}
    if packed:
        info |= _packed(means2d, radii, absgrad)
    return image, alpha, info


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
