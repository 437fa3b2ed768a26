"""Draw Gaussians: projection, binning, blending, in one differentiable call on Dr.Jit arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.render.backend import Array2f, Array3f, Array4f, Bool, Float, UInt, floats, kernels, opaque
from gof.render.bins import BLOCK, PAIR_BUDGET, Canvas
from gof.render.blend import MAX_ALPHA, DrJitBlend, Trace
from gof.render.harmonics import harmonics_color
from gof.render.light import add_light
from gof.render.project import Projected, ProjectionOptions, project
from gof.render.scene import MAX_CHANNELS, Splats, Stack, columns, require_finite_splats, transient_state
from gof.render.shutter import shutter_delay

MIN_ALPHA = 1 / 255  # fainter is not drawn


@dataclass
class Frame:
    """A drawn image. Planes are row-major (H * W,) and carry gradients to everything in `Splats`.

    The K images of a stack follow each other in planes (K * H * W,).
    """

    width: int
    height: int  # of one image
    color: list[Float]  # sum w_i c_i + (1 - alpha) background; emissive ones: see `gof.render.light`
    alpha: Float  # sum w_i in [0, 1); alpha + transmittance = 1
    depth: Float | None  # sum w_i z_i, m, not normalised
    dynamic_alpha: Float | None  # sum w_i dynamic_i
    mean2d: Array2f  # (N,) px, detached
    radius: Float  # (N,) px, 3 sigma along the longer axis; 0 = not drawn, or no part of the 3 sigma is in the picture
    trace: Trace

    @property
    def expected_depth(self) -> Float:
        """(H * W,) m: depth / alpha, 0 where alpha is below 1e-6."""
        if self.depth is None:
            raise DataFormatError("this frame was drawn without depth; call render_splats(..., depth=True)")
        seen = self.alpha > 1e-6
        return dr.select(seen, self.depth / dr.select(seen, self.alpha, 1.0), 0.0)

    @property
    def intersections(self) -> int:
        """(4x4 block, Gaussian) pairs that were evaluated."""
        return self.trace.pairs

    @property
    def mean2d_grad(self) -> Array2f | None:
        """(N,) dL/d(mean2d) per pixel after `dr.backward`; None before."""
        t = self.trace
        return None if t.mean_x_grad is None else Array2f(t.mean_x_grad, t.mean_y_grad)

    @property
    def mean2d_absgrad(self) -> Array2f | None:
        """(N,) sum over pixels of |dL/d(mean2d)| of each, after `dr.backward`; None before, or without `absgrad`."""
        return None if self.trace.mean_absgrad is None else Array2f(*self.trace.mean_absgrad)


def render_splats(
    splats: Splats,
    camera: Camera,
    background: list | None = None,
    *,
    emissive: bool = False,
    dynamic: Bool | Float | None = None,
    depth: bool = False,
    pose: list[Float] | None = None,
    deterministic: bool = False,
    pair_budget: int = PAIR_BUDGET,
    max_alpha: float = MAX_ALPHA,
    absgrad: bool = False,
    stack: Stack | None = None,
    **options,
) -> Frame:
    """Draw Gaussians front to back (3D Gaussian Splatting's image formation), differentiable.

    Args:
        splats: N Gaussians; gradients flow to every array that has `dr.enable_grad`.
        camera: pinhole camera; its shutter is not looked at, see `shutter_delay`.
        background: one float or Float (H * W) per channel; None = black.
        emissive: three channels of display values are added to the background as light, see `gof.render.light`.
        dynamic: (N,) weight of each Gaussian in `Frame.dynamic_alpha`; drawn in the same pass as the colour.
        depth: also accumulate camera depth.
        pose: 12 differentiable values (rows of the 3x4 world-to-camera matrix) that replace the camera's own.
        deterministic: gradients are summed in a fixed order, so that a run repeats bit for bit (the image always does).
        pair_budget: above this many (block, Gaussian) pairs the image is drawn in bands, one after another, and its
            lists are built again for the backward pass; bounds memory, at least one row of blocks is held.
        max_alpha: a Gaussian hides at most this part of what is behind it; where it is clamped its gradient is 0.
            gsplat's is 0.999; the nearer to 1, the more digits the gradient loses.
        absgrad: also leave `Frame.mean2d_absgrad`.
        stack: draw K images of the camera's at once, each with Gaussians of its own; a background has K images, too.
        options: near, far, dilation, antialias, min_radius of `gof.render.project.ProjectionOptions`.
    Raises:
        DataFormatError: an argument out of range, named.
    """
    width, height = camera.width, camera.height
    _require_fitting(splats, background, emissive, stack)
    if not MIN_ALPHA < max_alpha < 1:
        raise DataFormatError(f"'max_alpha' is {max_alpha}; it must be above 1/255 and below 1")
    trace, canvas = Trace(), Canvas(width, height, 1 if stack is None else stack.count)
    if len(splats) == 0:
        n_planes = len(splats.color) + int(depth) + int(dynamic is not None) + 1
        planes = [dr.zeros(Float, canvas.pictures * width * height) for _ in range(n_planes)]
        dr.enable_grad(planes)  # an empty set has nothing to differentiate, but a training loop may still call backward
        mean2d, radius = Array2f(Float(), Float()), Float()
    else:
        parameters = (splats.position, splats.rotation, splats.scale, splats.opacity)
        p = project(*parameters, camera, ProjectionOptions(**options), pose, splats.covariance)
        channels = list(splats.color)
        if depth:
            channels.append(p.depth)
        if dynamic is not None:
            channels.append(dr.select(dynamic, Float(1), Float(0)) if isinstance(dynamic, Bool) else dynamic)
        if absgrad and len(channels) > MAX_CHANNELS:
            raise DataFormatError(
                f"'absgrad' with {len(channels)} channels, depth and dynamic counted; at most {MAX_CHANNELS} go with it"
            )
        detached = dr.detach(p)
        mean2d, radius = Array2f(detached.mean_x, detached.mean_y), _radius(detached, width, height)
        if stack is not None:
            p = _place(p, stack, canvas)
            detached = dr.detach(p)
        geometry = [p.mean_x, p.mean_y, p.a, p.b, p.c, p.log2_opacity]
        dr.eval(geometry, channels, detached, radius)
        how = {"deterministic": deterministic, "pair_budget": pair_budget, "max_alpha": max_alpha, "absgrad": absgrad}
        planes, alpha = blend(geometry, channels, detached, canvas, trace, **how)
        planes = [_crop(plane, canvas) for plane in [*planes, alpha]]
    *planes, alpha = planes
    dynamic_alpha = planes.pop() if dynamic is not None else None
    depth_sum = planes.pop() if depth else None
    color = planes
    if background is not None and emissive:
        color = add_light(color, alpha, background)
    elif background is not None:
        through = 1 - alpha
        color = [dr.fma(through, b, c) for c, b in zip(color, background, strict=True)]
    return Frame(width, height, color, alpha, depth_sum, dynamic_alpha, mean2d, radius, trace)


def _require_fitting(splats: Splats, background: list | None, emissive: bool, stack: Stack | None) -> None:
    if stack is not None and (stack.count < 1 or len(stack.picture) != len(splats)):
        raise DataFormatError(
            f"'stack' has {stack.count} pictures, and those of {len(stack.picture)} of {len(splats)} Gaussians"
        )
    if background is not None and len(background) != len(splats.color):
        raise DataFormatError(f"'background' has {len(background)} channels, 'color' has {len(splats.color)}")
    if emissive and len(splats.color) != 3:
        raise DataFormatError(
            f"'color' has {len(splats.color)} channels; those of emissive Gaussians are red, green, blue"
        )


def blend(
    geometry: list[Float],
    channels: list[Float],
    projected: Projected,
    canvas: Canvas,
    trace: Trace,
    *,
    deterministic: bool = False,
    pair_budget: int = PAIR_BUDGET,
    max_alpha: float = MAX_ALPHA,
    absgrad: bool = False,
) -> tuple[list[Float], Float]:
    """Blend the channels of N Gaussians, with the kernels that `gof.render.backend.kernels` names.

    Args:
        geometry: mean_x, mean_y, a, b, c, log2_opacity, each (N,) (see `Projected`).
        channels: what to accumulate, each (N,).
        projected: where each Gaussian is, detached.
        canvas: what is drawn on.
        trace: filled with counts now and the 2D gradient in the backward pass.
        deterministic: sum gradients in a fixed order; slower, and 16 bytes per pair and four values.
        pair_budget: pairs held at a time.
        max_alpha: alpha is clamped at it, with gradient 0 there.
        absgrad: leave sum over pixels |dL/d(mean)| in the trace; at most 8 channels then.
    Returns:
        (sum w_i channel_i per channel, alpha = sum w_i), each a plane of whole blocks (4 rows x 4 columns), AD.
    """
    operation = DrJitBlend
    if kernels().name == "native":
        from gof.render.native.operation import NativeBlend as operation
    settings = projected, canvas, trace, deterministic, pair_budget, max_alpha, absgrad
    *planes, alpha = dr.custom(operation, geometry, channels, *settings)
    return planes, alpha


def _place(p: Projected, stack: Stack, canvas: Canvas) -> Projected:
    """Move the Gaussians down to where their pictures stand on the canvas."""
    within = stack.picture < stack.count  # others would be written beyond the canvas
    top = dr.select(within, stack.picture, 0) * UInt(canvas.picture_rows)
    return replace(p, mean_y=p.mean_y + Float(BLOCK * top), top=top, visible=p.visible & within)


def _radius(p: Projected, width: int, height: int) -> Float:
    """px; 0 where the square around the circle lies outside the picture."""
    r = p.radius
    inside = (dr.abs(p.mean_x - 0.5 * width) < r + 0.5 * width) & (dr.abs(p.mean_y - 0.5 * height) < r + 0.5 * height)
    return dr.select(inside, r, 0.0)


def _crop(plane: Float, canvas: Canvas) -> Float:
    """Cut a padded plane (whole blocks) to its images."""
    width, height, pictures = canvas
    if len(plane) == pictures * width * height:
        return plane
    i = dr.arange(UInt, pictures * width * height)
    row = i // width
    place = (row + row // height * (-height % BLOCK)) * (canvas.columns * BLOCK) + (i - row * width)
    return dr.gather(Float, plane, place, mode=dr.ReduceMode.NoConflicts)


def splats_at(gaussians: TransientGaussians, camera: Camera, time_s: float, *, shutter: str = "exact") -> Splats:
    """State of a reconstruction as a camera sees it at a time, without gradients.

    Args:
        time_s: seconds on the dataset clock; with a rolling shutter, when the first line is read.
        shutter: "exact" (delay t(p0) / (1 - grad t . v)), "first order" (t(p0)) or "global". Cameras without a row time
            cost nothing and are global.
    """
    g = gaussians
    position, velocity = columns(g.position, Array3f), columns(g.velocity, Array3f)
    # Times relative to the frame, so that float32 resolves microsecond delays late in a long clip.
    state = [floats(g.t_mu.astype(np.float64) - time_s), floats(g.t_sigma), floats(g.opacity)]
    dynamic = floats(g.dynamic) > 0
    seen, opacity = transient_state(position, velocity, *state, 0.0, dynamic)
    if shutter != "global" and camera.row_time_s > 0 and len(g):
        delay = shutter_delay(seen, velocity, camera, exact=shutter == "exact")
        seen, opacity = transient_state(position, velocity, *state, delay, dynamic)
    if g.color.ndim == 2:
        color = columns(g.color)
    else:
        coefficients = [columns(g.color[:, k]) for k in range(g.color.shape[1])]
        eye = Array3f(*(opaque(v) for v in camera.position))
        color = harmonics_color(coefficients, seen, eye, round(len(coefficients) ** 0.5) - 1)
    return Splats(seen, columns(g.rotation, Array4f), columns(g.scale, Array3f), opacity, color)


def render(
    gaussians: TransientGaussians, camera: Camera, time_s: float, background=None, *, shutter: str = "exact", **options
) -> dict[str, np.ndarray]:
    """Return a picture of a reconstruction at a time, as numpy arrays, without gradients.

    Args:
        gaussians: N Gaussians with plain colours or spherical harmonics.
        time_s, shutter: see `splats_at`.
        background: (3,) colour or (H, W, 3) image; None = black. A fourth value, 0..1, says how much of a pixel stands
            before the Gaussians instead of behind them. Emissive ones are added to it as light (`add_light`).
        options: near, far, dilation, antialias, min_radius of `gof.render.project.ProjectionOptions`.
    Returns:
        color (H, W, 3), alpha (H, W), depth (H, W) expected camera depth in m (0 where nothing is), dynamic_alpha (H,
        W).
    Raises:
        NonFiniteError: NaN or Inf in the Gaussians.
    """
    splats = splats_at(gaussians, camera, time_s, shutter=shutter)
    require_finite_splats(splats)
    shape = (camera.height, camera.width)
    before = None
    if background is not None:
        background = np.asarray(background, np.float32)
        image = np.broadcast_to(background[..., :3], (*shape, 3))
        before = np.broadcast_to(background[..., 3], shape) if background.shape[-1] == 4 else None
        background = [floats(image[..., c]) for c in range(3)]
    emissive, dynamic = gaussians.emissive, floats(gaussians.dynamic)
    frame = render_splats(splats, camera, background, emissive=emissive, dynamic=dynamic, depth=True, **options)

    def plane(values: Float) -> np.ndarray:
        return np.array(values.numpy()).reshape(shape)  # a copy: numpy must not alias Dr.Jit's memory

    drawn = {
        "color": np.stack([plane(c) for c in frame.color], -1),
        "alpha": plane(frame.alpha),
        "depth": plane(frame.expected_depth),
        "dynamic_alpha": plane(frame.dynamic_alpha),
    }
    if before is not None:
        through = 1 - before
        drawn["color"] = image + through[..., None] * (drawn["color"] - image)
        drawn |= {name: through * drawn[name] for name in ("alpha", "dynamic_alpha")}
    return drawn
