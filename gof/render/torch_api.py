"""`rasterize`: gsplat's call on torch tensors, drawn by the Dr.Jit renderer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import index
from typing import Any

import drjit as dr
import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError, MissingDependencyError, require_finite
from gof.host import extras
from gof.render.backend import Array3f, Array4f, Float, floats, opaque
from gof.render.blend import MAX_ALPHA
from gof.render.harmonics import harmonics_color
from gof.render.rasterizer import render_splats
from gof.render.scene import MAX_CHANNELS, Splats

try:
    import torch
except ImportError as e:
    raise MissingDependencyError(
        f"gof.render.rasterize works on torch tensors: {extras.command('torch')}; or use render_splats without it"
    ) from e

RENDER_MODES = {
    "RGB": (True, None),
    "D": (False, "sum"),
    "ED": (False, "mean"),
    "RGB+D": (True, "sum"),
    "RGB+ED": (True, "mean"),
}


class Info(dict):
    """Outputs of a drawing by name; an unknown name is an error that lists the names."""

    def __missing__(self, key):
        raise DataFormatError(f"info['{key}'] is not made here; of a drawing there is {sorted(self)}")


def rasterize(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmats,
    Ks,
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    backgrounds=None,
    render_mode: str = "RGB",
    rasterize_mode: str = "classic",
    deterministic: bool = False,
    check_finite: bool = True,
    packed: bool = True,
    tile_size: int = 16,
    channel_chunk: int = 32,
    sparse_grad: bool = False,
    absgrad: bool = False,
    covars=None,
    means2d=None,
    max_alpha: float = MAX_ALPHA,
):
    """Draw Gaussians with gsplat's argument names, shapes and camera convention; differentiable.

    Args:
        means: (N, 3) world.  quats: (N, 4) wxyz, normalised here.  scales: (N, 3) linear.  opacities: (N,) in [0, 1].
        colors: (N, D) or (C, N, D) with D <= 8, or with `sh_degree` coefficients (N, K, D) or (C, N, K, D). None with
            "D" and "ED", which draw no colours.
        width, height: whole numbers of pixels, from 1 on.
        viewmats: (C, 4, 4) world to camera, OpenCV axes; gets a gradient.  Ks: (C, 3, 3) pixels; gets none.
        near_plane, far_plane: depths outside are not drawn.  radius_clip: Gaussians with a smaller radius in px are
            skipped.
        eps2d: px^2 added to the 2D covariance.
        sh_degree: 0 to 3; colours are max(0, 0.5 + harmonics) in the direction from the camera. Coefficients beyond
            (sh_degree + 1)^2 are not looked at.
        backgrounds: (C, D).
        render_mode: "RGB", "D" (sum w z), "ED" (divided by alpha), "RGB+D", "RGB+ED".
        rasterize_mode: "classic" or "antialiased".
        deterministic: gradients repeat bit for bit.
        check_finite: look for NaN and Inf in the Gaussians first (one reduction per parameter).
        packed, tile_size, channel_chunk: taken so that a call written for gsplat runs, and without effect: they choose
            how gsplat works (which layout its intermediates have, how many pixels share a list, how many channels are
            drawn at a time), not what it returns.
        sparse_grad: must be False; gradients are dense.
        absgrad: the backward pass also fills `.absgrad` of the probe, `means2d` or the leaf that is returned, with
            (C, N, 2): the sum over pixels of |dL/d(mean)|.
            At most 8 channels then, depth counted.
        covars: (N, 3, 3) world covariances instead of quats and scales, which are None then; the upper triangle is read
            and gets the gradient.
        means2d: (C, N, 2), a tensor of the caller's that gets the gradient of the 2D means, per px, through whatever
            made it; its values are not read. None: a new leaf, which is returned.
        max_alpha: the clamp of alpha; gsplat's is 0.999.
    Returns:
        colors (C, H, W, X), alphas (C, H, W, 1), and an `Info` with width, height, n_cameras, and per camera and
        Gaussian: "means2d" (C, N, 2) px, whose `.grad` the backward pass fills if it is not the caller's, "radii"
        (C, N) int32 px, 3 standard deviations rounded up (0 = not drawn, or outside the picture). No Gaussian (N = 0)
        gives the background, and no camera (C = 0) no picture; gradients have their shapes then, too.
    Raises:
        NonFiniteError (a ValueError), DataFormatError: named argument and rows, or shape.

    Results are float32 on the CPU whatever the inputs are; gradients have their tensor's type and device. Places are
    taken from each camera's centre in float64 first: a world far from zero (UTM coordinates) costs no digits where
    means and viewmats are float64. Digits that float32 inputs have rounded away are lost.
    """
    _require_options(render_mode, rasterize_mode, sparse_grad, {"near_plane": near_plane, "eps2d": eps2d})
    width, height = _whole("width", width), _whole("height", height)
    with_color, depth_mode = RENDER_MODES[render_mode]
    if colors is None and not with_color:
        colors, sh_degree, backgrounds = torch.zeros(len(means), 1), None, None
    inputs = _Inputs(means, quats, scales, opacities, colors, covars, viewmats, Ks, backgrounds)
    _require_inputs(inputs, means2d, sh_degree, check_finite=check_finite)
    projection = {
        "near": near_plane,
        "far": far_plane,
        "dilation": eps2d,
        "antialias": rasterize_mode == "antialiased",
        "min_radius": radius_clip,
    }
    drawing = {"deterministic": deterministic, "max_alpha": max_alpha, "absgrad": absgrad}
    options = _Options(width, height, with_color, depth_mode, sh_degree, projection | drawing)
    return _draw_pictures(inputs, means2d, options)


@dataclass(frozen=True)
class _Inputs:
    """Tensors of a call, with `rasterize`'s names and shapes."""

    means: torch.Tensor
    quats: torch.Tensor | None
    scales: torch.Tensor | None
    opacities: torch.Tensor
    colors: torch.Tensor
    covars: torch.Tensor | None
    viewmats: torch.Tensor
    Ks: torch.Tensor
    backgrounds: torch.Tensor | None

    @property
    def gaussians(self) -> dict[str, Any]:
        """Those that describe the Gaussians, by name."""
        described = {"means": self.means, "opacities": self.opacities, "colors": self.colors}
        shape = {"quats": self.quats, "scales": self.scales} if self.covars is None else {"covars": self.covars}
        return described | shape


def _draw_pictures(inputs: _Inputs, means2d, options: _Options) -> tuple:
    """Draw the Gaussians with every camera; returns as `rasterize` does."""
    n, c = len(inputs.means), len(inputs.viewmats)
    probe = _make_probe(inputs) if means2d is None else means2d
    if options.drawing["absgrad"]:
        probe.absgrad = torch.zeros(c, n, 2)
    info = Info(width=options.width, height=options.height, n_cameras=c)
    if n == 0 or c == 0:
        image, alpha = _draw_nothing(inputs, probe, options)
        info |= {"means2d": probe, "radii": torch.zeros(c, n, dtype=torch.int32)}
        return image, alpha, info
    read = _keep_read(inputs, options.sh_degree)
    views = [_draw_picture(read, probe, i, options) for i in range(c)]
    images, alphas, centres, radii = map(torch.stack, zip(*views, strict=True))
    if means2d is None:
        probe.data.copy_(centres)
        centres = probe
    info |= {"means2d": centres, "radii": radii}
    return images, alphas, info


def _make_probe(inputs: _Inputs) -> torch.Tensor:
    """Return a leaf that every camera reads, so that autograd fills its .grad."""
    tensors = *inputs.gaussians.values(), inputs.viewmats
    learns = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    return torch.zeros(len(inputs.viewmats), len(inputs.means), 2, requires_grad=learns)


def _keep_read(inputs: _Inputs, sh_degree: int | None) -> _Inputs:
    """Return the parts that are read: coefficients up to the degree, and covars' upper triangles (N, 6)."""
    colors, covars = inputs.colors, inputs.covars
    if sh_degree is not None:
        colors = colors[..., : (sh_degree + 1) ** 2, :]
    if covars is not None:
        upper, right = np.triu_indices(3)
        covars = covars[:, upper, right]
    return replace(inputs, colors=colors, covars=covars)


def _draw_picture(inputs: _Inputs, probe: torch.Tensor, i: int, options: _Options) -> tuple:
    """Draw what camera i sees."""
    colors = inputs.colors
    per_camera = colors.ndim == (3 if options.sh_degree is None else 4)
    return _Rasterize.apply(
        inputs.means,
        inputs.quats,
        inputs.scales,
        inputs.covars,
        inputs.opacities,
        colors[i] if per_camera else colors,
        inputs.viewmats[i],
        None if inputs.backgrounds is None else inputs.backgrounds[i],
        probe[i],
        probe.absgrad[i] if options.drawing["absgrad"] else None,
        inputs.Ks[i],
        options,
    )


def _whole(name: str, value) -> int:
    """Return a side of a picture, also of a tensor or an array that holds one whole number."""
    try:
        number = index(value)
    except TypeError as e:
        raise DataFormatError(f"'{name}' is {value!r}; it must be a whole number of pixels") from e
    if number < 1:
        raise DataFormatError(f"'{name}' is {number}; it must be 1 or more")
    return number


def _draw_nothing(inputs: _Inputs, probe: torch.Tensor, options: _Options) -> tuple:
    """Pictures without a Gaussian: backgrounds, no depth, alpha 0. Their inputs get gradient 0."""
    cameras, channels, backgrounds = len(inputs.viewmats), inputs.colors.shape[-1], inputs.backgrounds
    size = (cameras, options.height, options.width)
    drawn_from = (*inputs.gaussians.values(), inputs.quats, inputs.scales, inputs.viewmats, probe)
    none = sum(tensor.reshape(-1)[:0].sum().to("cpu", torch.float32) for tensor in drawn_from if tensor is not None)
    planes = []
    if options.with_color:
        black = torch.zeros(cameras, channels)
        color = black if backgrounds is None else backgrounds.to("cpu", torch.float32)
        planes.append(color[:, None, None, :].expand(*size, channels))
    if options.depth_mode:
        planes.append(torch.zeros(*size, 1))
    return torch.cat(planes, -1) + none, torch.zeros(*size, 1) + none


@dataclass(frozen=True)
class _Options:
    """Options that all cameras of a call share. depth_mode: None, "sum" or "mean"; drawing: options of
    `gof.render.render_splats`."""

    width: int
    height: int
    with_color: bool
    depth_mode: str | None
    sh_degree: int | None
    drawing: dict[str, Any]


def _require_options(render_mode: str, rasterize_mode: str, sparse_grad: bool, positive: dict[str, float]) -> None:
    if render_mode not in RENDER_MODES or rasterize_mode not in ("classic", "antialiased"):
        raise DataFormatError(
            f"render_mode '{render_mode}' is not one of {list(RENDER_MODES)}, or rasterize_mode '{rasterize_mode}' "
            "is neither 'classic' nor 'antialiased'"
        )
    if sparse_grad:
        raise DataFormatError("rasterize has dense gradients; call it with sparse_grad=False")
    for name, value in positive.items():
        if not value > 0:
            raise DataFormatError(f"'{name}' is {value}; it must be > 0")


def _require_inputs(inputs: _Inputs, means2d, sh_degree: int | None, *, check_finite: bool) -> None:
    _require_shapes(inputs, sh_degree)
    if check_finite:
        for name, tensor in inputs.gaussians.items():
            require_finite(name, tensor.detach().cpu().numpy())
    if inputs.covars is not None and (inputs.quats is not None or inputs.scales is not None):
        raise DataFormatError("'covars' stands instead of 'quats' and 'scales'; give None for these")
    probed = len(inputs.viewmats), len(inputs.means), 2
    if means2d is not None and tuple(means2d.shape) != probed:
        raise DataFormatError(f"'means2d' has shape {tuple(means2d.shape)}, expected {probed}")


def _require_shapes(inputs: _Inputs, sh_degree: int | None) -> None:
    n, c, gaussians, backgrounds = len(inputs.means), len(inputs.viewmats), inputs.gaussians, inputs.backgrounds
    expected = {
        "means": (n, 3),
        "quats": (n, 4),
        "scales": (n, 3),
        "covars": (n, 3, 3),
        "opacities": (n,),
        "viewmats": (c, 4, 4),
        "Ks": (c, 3, 3),
    }
    for name, tensor in (gaussians | {"viewmats": inputs.viewmats, "Ks": inputs.Ks}).items():
        if name in expected and (tensor is None or tuple(tensor.shape) != expected[name]):
            shape = None if tensor is None else tuple(tensor.shape)
            raise DataFormatError(f"'{name}' has shape {shape}, expected {expected[name]}")
    colors = gaussians["colors"]
    if colors is None:
        raise DataFormatError("'colors' is None; only render_mode 'D' and 'ED' go without")
    tail = 1 if sh_degree is None else 2
    if tuple(colors.shape[:-tail]) not in ((n,), (c, n)):
        raise DataFormatError(
            f"'colors' has shape {tuple(colors.shape)}; expected ([{c},] {n}, {'D' if sh_degree is None else 'K, D'})"
        )
    if not 1 <= colors.shape[-1] <= MAX_CHANNELS:
        raise DataFormatError(f"'colors' has {colors.shape[-1]} channels; 1 to {MAX_CHANNELS} can be drawn in one call")
    if sh_degree is not None and not (0 <= sh_degree <= 3 and colors.shape[-2] >= (sh_degree + 1) ** 2):
        raise DataFormatError(
            f"'sh_degree' is {sh_degree}, of 0 to 3; 'colors' has {colors.shape[-2]} coefficients, of (sh_degree + 1)^2"
        )
    if backgrounds is not None and tuple(backgrounds.shape) != (c, colors.shape[-1]):
        raise DataFormatError(f"'backgrounds' has shape {tuple(backgrounds.shape)}, expected {(c, colors.shape[-1])}")


def _columns(tensor) -> list[Float]:
    """(N, ...) tensor to one Float (N,) per trailing entry."""
    flat = tensor.detach().to("cpu", torch.float32).reshape(len(tensor), -1).numpy()
    return [floats(column) for column in np.ascontiguousarray(flat.T)]


def _tensor(planes: list[Float], shape: tuple) -> torch.Tensor:
    """Planes side by side in a tensor's last dimension."""
    out = torch.empty(*shape)
    size = out.numel() // len(planes)
    for k, plane in enumerate(planes):
        values = np.broadcast_to(dr.detach(plane).numpy(), size).copy()
        out.view(-1, len(planes))[:, k] = torch.from_numpy(values)
    return out


def _eye(world_to_camera: list[Float], zero: np.ndarray) -> Array3f:
    """Centre of a camera whose t + R zero stands in its row-major 3x4 matrix, counted from zero (3,).

    It is -R^T t - zero, entry by entry as matrices that are no longer rotations have it: R^T R zero comes in with its
    derivative only, for its value has no digits left where zero is large.
    """
    R, t = world_to_camera, [world_to_camera[k] for k in (3, 7, 11)]
    moved = [sum(R[4 * i + k] * opaque(zero[k]) for k in range(3)) for i in range(3)]
    back = [sum(R[4 * i + k] * moved[i] for i in range(3)) for k in range(3)]
    return Array3f(*(-sum(R[4 * i + k] * t[i] for i in range(3)) + (back[k] - dr.detach(back[k])) for k in range(3)))


class _Rasterize(torch.autograd.Function):
    """One camera."""

    @staticmethod
    def forward(
        ctx, means, quats, scales, covars, opacities, colors, viewmat, background, means2d, absgrad, K, options
    ):
        inputs = {
            "means": means,
            "quats": quats,
            "scales": scales,
            "covars": covars,
            "opacities": opacities,
            "colors": colors,
        }
        # From the camera's centre: float32 has no digits left for pixels where the world's zero is far away (UTM).
        view = viewmat.detach().to("cpu", torch.float64).numpy().copy()
        ctx.centre = -view[:3, :3].T @ view[:3, 3]
        view[:3, 3] += view[:3, :3] @ ctx.centre
        drawn = inputs | {"means": means.detach().to("cpu", torch.float64) - torch.from_numpy(ctx.centre)}
        leaves = {name: _columns(t) for name, t in drawn.items() if t is not None}
        leaves["viewmat"] = [dr.opaque(Float, float(v)) for v in view[:3].reshape(-1)]
        if background is not None:
            leaves["background"] = [dr.opaque(Float, float(v)) for v in background.detach().reshape(-1)]
        ctx.tensors = {**inputs, "viewmat": viewmat, "background": background}
        needed = dict(zip(ctx.tensors, ctx.needs_input_grad, strict=False))
        needed["means"] |= ctx.needs_input_grad[8]  # keeps the graph alive for the gradient of the 2D means
        for name, arrays in leaves.items():
            if needed[name]:
                dr.enable_grad(arrays)

        camera = Camera("rasterize", options.width, options.height, K.detach().cpu().double().numpy(), view)
        position, color = Array3f(*leaves["means"]), leaves["colors"]
        if options.sh_degree is not None:
            d = colors.shape[-1]
            coefficients = [color[k * d : (k + 1) * d] for k in range(colors.shape[-2])]
            color = harmonics_color(coefficients, position, _eye(leaves["viewmat"], ctx.centre), options.sh_degree)
        shape = (Array4f(*leaves["quats"]), Array3f(*leaves["scales"])) if covars is None else (None, None)
        splats = Splats(position, *shape, leaves["opacities"][0], color, leaves.get("covars"))
        frame = render_splats(
            splats,
            camera,
            leaves.get("background"),
            depth=options.depth_mode is not None,
            pose=leaves["viewmat"],
            **options.drawing,
        )
        planes = list(frame.color) if options.with_color else []
        if options.depth_mode:
            planes.append(frame.depth if options.depth_mode == "sum" else frame.expected_depth)
        ctx.leaves, ctx.needed, ctx.frame, ctx.planes = leaves, needed, frame, [*planes, frame.alpha]
        ctx.absgrad = absgrad
        mean2d = _tensor([frame.mean2d.x, frame.mean2d.y], (len(means), 2))
        radius = _tensor([frame.radius], (len(means),)).ceil().int()
        ctx.mark_non_differentiable(mean2d, radius)
        size = (options.height, options.width)
        return _tensor(planes, (*size, len(planes))), _tensor([frame.alpha], (*size, 1)), mean2d, radius

    @staticmethod
    def backward(ctx, g_image, g_alpha, _g_mean2d, _g_radius):
        if ctx.frame is None:
            raise RuntimeError(
                "rasterize: backward was called twice; call rasterize again (retain_graph is not supported)"
            )
        flows = [p for p in ctx.planes if dr.grad_enabled(p)]
        grads = [*_columns(g_image.reshape(-1, g_image.shape[-1])), *_columns(g_alpha.reshape(-1, 1))]
        for plane, grad in zip(ctx.planes, grads, strict=True):
            if dr.grad_enabled(plane):
                dr.set_grad(plane, grad)
        if flows:
            for plane in flows:
                dr.enqueue(dr.ADMode.Backward, plane)
            dr.traverse(dr.ADMode.Backward)
        out = []
        for name, like in ctx.tensors.items():
            if like is None or not ctx.needed[name]:
                out.append(None)
            elif name == "viewmat":
                grad = torch.zeros(4, 4)
                grad[:3] = _tensor([dr.grad(v) for v in ctx.leaves[name]], (1, 12)).reshape(3, 4)
                grad[:3, :3] += torch.outer(grad[:3, 3], torch.from_numpy(ctx.centre).float())  # t + R centre is drawn
                out.append(grad.to(like))
            else:
                out.append(_tensor([dr.grad(v) for v in ctx.leaves[name]], tuple(like.shape)).to(like))
        mean2d = ctx.frame.mean2d_grad
        probe = None if mean2d is None else _tensor([mean2d.x, mean2d.y], (len(ctx.tensors["means"]), 2))
        if ctx.absgrad is not None and mean2d is not None:
            absolute = ctx.frame.mean2d_absgrad
            ctx.absgrad.copy_(_tensor([absolute.x, absolute.y], tuple(ctx.absgrad.shape)))
        ctx.frame = ctx.leaves = ctx.planes = None
        return (*out, probe, None, None, None)
