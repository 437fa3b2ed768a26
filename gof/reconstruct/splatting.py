"""3D Gaussian Splatting of a few fire-free plates, held to their depth maps (paper, "Static Scene").

Loss: 0.8 L1 + 0.2 (1 - SSIM) + w mean |1/D - 1/D_render| z, w falling exponentially from 100 to 1 (paper: 100 times the
weights of 3DGS). The depth term is in disparity times the scene's median depth z, which has no unit and is what stereo
measures evenly. Gaussians are cloned and split where the pictures pull hardest, and none is
pruned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import drjit as dr
import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import NonFiniteError
from gof.core.gaussians import TransientGaussians
from gof.core.morton import morton_order
from gof.core.rotations import rotation_matrices
from gof.render import Splats, Target, l1_ssim, render_splats
from gof.render.adam import Adam
from gof.render.backend import Array3f, Array4f, Float
from gof.render.rasterizer import Frame

SSIM_WEIGHT = 0.2
DEPTH_WEIGHT = (100.0, 1.0)  # first and last step (paper: 100 times those of 3DGS)
DENSIFY_EVERY = 100  # steps
DENSIFY_UNTIL = 0.5  # of all steps
PULL = 2e-4  # mean gradient of the centre, in half picture widths, above which a Gaussian is cloned or split (3DGS)
LARGE = 0.01  # of the scene's size, larger ones are split, smaller ones cloned (3DGS)
SPLIT_SHRINK = 1.6  # (3DGS)
# 3DGS; that of positions times the scene's size.
RATES = {"position": 1.6e-4, "log_scale": 5e-3, "rotation": 1e-3, "opacity": 0.05, "color": 2.5e-3}
POSITION_DECAY = 0.01


def optimize_background(
    seeds: TransientGaussians,
    cameras: list[Camera],
    plates: Sequence[np.ndarray],
    depths: list[np.ndarray] | None,
    steps: int,
    budget: int,
    rng: np.random.Generator,
    progress=lambda done, total, **_: None,
) -> TransientGaussians:
    """3D Gaussian Splatting of the plates.

    Args:
        plates: C x (H, W, 3) display values.   depths: C x (H, W) m, or None for no depth term.
        budget: densification ends at so many Gaussians.
    Raises:
        NonFiniteError: the loss became NaN or Inf.
    """
    # 3DGS takes the cameras' spread as the scene's size; of three cameras side by side their distance says more.
    size = float(np.median(np.concatenate([c.to_camera(seeds.position)[:, 2] for c in cameras])))
    optimizer = _adam(_to_raw(seeds[morton_order(seeds.position)]), size)
    targets = [Target(plate) for plate in plates]
    disparity = None if depths is None else [Float(np.ascontiguousarray(size / d.ravel(), np.float32)) for d in depths]
    pull = _Pull.none(len(seeds))
    order: list[int] = []
    for step in range(steps):
        order = order or rng.permutation(len(plates)).tolist()
        c = order.pop()
        done = step / max(steps - 1, 1)
        optimizer.set_learning_rate({"position": RATES["position"] * size * POSITION_DECAY**done})
        frame = render_splats(_splats(optimizer), cameras[c], depth=depths is not None, near=0.01 * size)
        loss = l1_ssim(frame.color, targets[c], ssim_weight=SSIM_WEIGHT)
        if disparity is not None:
            weight = DEPTH_WEIGHT[0] * (DEPTH_WEIGHT[1] / DEPTH_WEIGHT[0]) ** done
            loss += weight * _depth_term(frame, disparity[c], size)
        dr.backward(loss)
        grows = step < DENSIFY_UNTIL * steps
        if grows:
            pull.add(frame, cameras[c].width)
        optimizer.step()
        dr.eval(list(optimizer.values()))
        if (step + 1) % DENSIFY_EVERY == 0:
            value = float(loss.array[0])
            if not np.isfinite(value):
                raise NonFiniteError(
                    f"step {step}: the loss of the background is {value}; report this dataset as a bug"
                )
            if grows and len(pull.total) < budget:
                optimizer = _densify(optimizer, pull.mean(), size, budget, rng)
                pull = _Pull.none(dr.width(optimizer["opacity"]))
            progress(step + 1, steps, note=f"loss {value:.4f}, {len(pull.total)} Gaussians")
    return _from_raw(optimizer)


def _depth_term(frame: Frame, disparity: Float, size: float) -> Float:
    """Mean difference of rendered and known disparity, both times the scene's size."""
    covered = dr.detach(frame.alpha) > 0.5  # elsewhere the expected depth is of almost nothing
    rendered = dr.select(covered, size / dr.maximum(frame.expected_depth, 1e-3 * size), disparity)
    return dr.mean(dr.abs(rendered - disparity))


@dataclass
class _Pull:
    """Gradients at each Gaussian's centre: their sum (N,), and the number of pictures that show it (N,)."""

    total: np.ndarray
    seen: np.ndarray

    @classmethod
    def none(cls, count: int) -> _Pull:
        return cls(np.zeros(count), np.zeros(count))

    def add(self, frame: Frame, width: int) -> None:
        """Add the gradients of a frame after the backward pass, in half picture widths (3DGS)."""
        moved = np.hypot(*np.array(frame.mean2d_grad)) * width / 2
        drawn = frame.radius.numpy() > 0
        self.total[drawn] += moved[drawn]
        self.seen[drawn] += 1

    def mean(self) -> np.ndarray:
        return self.total / np.maximum(self.seen, 1)


def _densify(optimizer: Adam, pull: np.ndarray, size: float, budget: int, rng: np.random.Generator) -> Adam:
    """Clone small and split large Gaussians that the pictures pull hardest, up to the budget.

    Adam starts anew for them; those that were there keep their moments.
    """
    g = _from_raw(optimizer)
    wanted = np.flatnonzero(pull > PULL)
    wanted = wanted[np.argsort(-pull[wanted], kind="stable")][: budget - len(g)]
    if not len(wanted):
        return optimizer
    child = g[wanted]
    split = child.scale.max(1) > LARGE * size
    scale = np.where(split[:, None], child.scale / SPLIT_SHRINK, child.scale)
    child = replace(child, scale=scale, position=child.position + split[:, None] * within(child, rng))
    g.scale[wanted] = scale  # the parent of a split shrinks as its child does, and moves the other way
    g.position[wanted] += split[:, None] * within(g[wanted], rng)
    both = TransientGaussians.concatenate([g, child])
    order = morton_order(both.position)  # neighbours in space side by side in memory: speed only
    grown = _adam(_to_raw(both[order]), size)
    for name in grown.keys():  # those that were there keep their moments
        value, promoted, rate, (t, *_, extra) = grown.state[name]
        _, _, _, (t, m, v, _) = optimizer.state[name]
        kind = type(dr.detach(value))
        m, v = (kind(_with_zeros(np.array(x), len(wanted))[..., order]) for x in (m, v))
        grown.state[name] = (value, promoted, rate, (t, m, v, extra))
    return grown


def _with_zeros(x: np.ndarray, count: int) -> np.ndarray:
    """`count` zeros after the last axis' values."""
    return np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, count)])


def within(g: TransientGaussians, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) a random offset drawn from each Gaussian, m."""
    return np.einsum("nij,nj->ni", rotation_matrices(g.rotation), rng.normal(size=(len(g), 3)) * g.scale)


def _adam(raw: dict, size: float) -> Adam:
    optimizer = Adam(lr=1.0, params=raw, epsilon=1e-15)
    optimizer.set_learning_rate(RATES | {"position": RATES["position"] * size})
    return optimizer


def _splats(raw) -> Splats:
    color = raw["color"]
    opacity = 1 / (1 + dr.exp(-raw["opacity"]))
    return Splats(raw["position"], raw["rotation"], dr.exp(raw["log_scale"]), opacity, [color.x, color.y, color.z])


def _to_raw(g: TransientGaussians) -> dict:
    opacity = np.clip(g.opacity.astype(np.float64), 1e-4, 1 - 1e-4)

    def columns(x: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(x.T, np.float32)

    return {
        "position": Array3f(columns(g.position)),
        "log_scale": Array3f(columns(np.log(g.scale))),
        "rotation": Array4f(columns(g.rotation)),
        "opacity": Float((np.log(opacity) - np.log1p(-opacity)).astype(np.float32)),
        "color": Array3f(columns(g.color)),
    }


def _from_raw(raw) -> TransientGaussians:
    values = {name: np.array(dr.detach(raw[name])) for name in RATES}
    n = values["opacity"].shape[-1]
    return TransientGaussians(
        position=values["position"].T,
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.exp(values["log_scale"].T.astype(np.float64)),
        rotation=values["rotation"].T,
        opacity=1 / (1 + np.exp(-values["opacity"].astype(np.float64))),
        color=values["color"].T,
        dynamic=np.zeros(n, bool),
    )
