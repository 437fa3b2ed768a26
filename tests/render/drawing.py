"""Drawing and differentiating small scenes, shared by the renderer's tests. Importing it needs Dr.Jit."""

import drjit as dr
import numpy as np

from gof.render import Splats
from gof.render.backend import Array3f, Array4f, floats
from gof.render.scene import columns


def splats(g, grad=False):
    s = Splats(
        columns(g["position"], Array3f),
        columns(g["rotation"], Array4f),
        columns(g["scale"], Array3f),
        floats(g["opacity"]),
        columns(g["color"]),
    )
    if grad:
        dr.enable_grad(s.position, s.rotation, s.scale, s.opacity, s.color)
    return s


def image(planes, cam):
    return np.stack([np.array(p.numpy()) for p in planes], -1).reshape(cam.height, cam.width, len(planes))


def gradients(s):
    def stack(parts):
        return np.stack([np.broadcast_to(dr.grad(p).numpy(), len(s)) for p in parts], -1)

    return {
        "position": stack(s.position),
        "rotation": stack(s.rotation),
        "scale": stack(s.scale),
        "opacity": stack([s.opacity])[:, 0],
        "color": stack(s.color),
    }


def loss_weights(cam, channels, seed=5):
    """Weights of colour (H, W, channels) and of alpha and depth (2, H, W)."""
    r = np.random.default_rng(seed)
    color = r.normal(size=(cam.height, cam.width, channels))
    extra = r.normal(size=(2, cam.height, cam.width))
    return color.astype(np.float32), extra.astype(np.float32)


def weighted_sum(frame, weights, extra):
    total = sum(dr.sum(c * floats(weights[..., k])) for k, c in enumerate(frame.color))
    return total + dr.sum(frame.alpha * floats(extra[0])) + dr.sum(frame.depth * floats(extra[1]))
