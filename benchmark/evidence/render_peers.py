"""Other renderers that ours is timed against on the same Gaussians, and how all are timed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from gof_benchmark.evidence.render_scenes import camera, flame


def best(function: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Return (wall ms, CPU ms): the smallest of each."""
    wall, cpu = math.inf, math.inf
    for _ in range(repeats):
        w, c = time.perf_counter(), time.process_time()
        function()
        wall, cpu = min(wall, time.perf_counter() - w), min(cpu, time.process_time() - c)
    return 1e3 * wall, 1e3 * cpu


def mitsuba_peer(n: int, width: int, height: int, ours: bool) -> dict:
    """Return times of `volprim_rf_basic` on the same scene, in this process."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    if ours:
        import gof.render.backend  # noqa: F401  its settings of the LLVM backend
    from gof.render.mitsuba_scene import scene

    loaded = scene(flame(n), camera(width, height), 0.0, spp=1, filter_sigma=0)
    params = mi.traverse(loaded)
    keys = [k for k in params.keys() if k.endswith(("opacities", "sh_coeffs"))]

    def forward():
        dr.eval(mi.render(loaded, spp=1))
        dr.sync_thread()

    def both():
        for k in keys:
            dr.enable_grad(params[k])
        params.update()
        dr.backward(dr.sum(dr.square(mi.render(loaded, params, spp=1)), axis=None))
        dr.eval([dr.grad(params[k]) for k in keys])
        dr.sync_thread()

    forward()
    both()
    return {
        "forward": best(forward, 3),
        "both": best(both, 3),
        "mean": float(np.array(mi.render(loaded, spp=4)).mean()),
    }


def torch_peer(n: int, width: int, height: int, repeats: int) -> dict[str, Any]:
    """Return a straightforward rasteriser: project, sort, loop over 16x16 tiles, blend with cumprod, autograd."""
    import torch

    g, view = flame(n), camera(width, height)
    leaves = [torch.tensor(v, requires_grad=True) for v in (g.position, g.rotation, g.scale, g.opacity, g.color)]

    def draw():
        position, rotation, scale, opacity, color = leaves
        mean, depth, covariance = _torch_project(position, rotation, scale, view)
        return _torch_tiles(mean, depth, covariance, opacity, color, width, height)

    def both():
        for leaf in leaves:
            leaf.grad = None
        (draw() ** 2).sum().backward()

    with torch.no_grad():
        mean = float(draw().mean())
        forward = best(draw, repeats)
    return {"forward": forward, "both": best(both, repeats), "mean": mean}


def _torch_project(position, rotation, scale, view):
    """Pixel means (N, 2), depths (N,) and pixel covariances (N, 2, 2), as in 3D Gaussian Splatting."""
    import torch

    W, K = torch.tensor(view.world_to_camera).float(), torch.tensor(view.K).float()
    p = position @ W[:3, :3].T + W[:3, 3]
    z = p[:, 2]
    mean = p[:, :2] / z[:, None] * torch.stack([K[0, 0], K[1, 1]]) + K[:2, 2]
    w, i, j, k = torch.nn.functional.normalize(rotation, dim=-1).unbind(-1)
    R = torch.stack(
        [
            1 - 2 * (j * j + k * k),
            2 * (i * j - w * k),
            2 * (i * k + w * j),
            2 * (i * j + w * k),
            1 - 2 * (i * i + k * k),
            2 * (j * k - w * i),
            2 * (i * k - w * j),
            2 * (j * k + w * i),
            1 - 2 * (i * i + j * j),
        ],
        -1,
    ).reshape(-1, 3, 3)
    J = torch.zeros(len(z), 2, 3)
    J[:, 0, 0] = K[0, 0] / z
    J[:, 1, 1] = K[1, 1] / z
    J[:, 0, 2] = -K[0, 0] * p[:, 0] / z**2
    J[:, 1, 2] = -K[1, 1] * p[:, 1] / z**2
    M = J @ W[:3, :3] @ (R * scale[:, None, :])
    return mean, z, M @ M.transpose(1, 2) + 0.3 * torch.eye(2)


def _torch_tiles(mean, depth, covariance, opacity, color, width: int, height: int):
    """Return (H, W, 3): every tile blends the Gaussians whose 3 sigma square touches it, front to back."""
    import torch

    conic, order = torch.linalg.inv(covariance), torch.argsort(depth.detach())
    radius = 3 * covariance.detach().diagonal(dim1=1, dim2=2).amax(-1).sqrt()
    low, high = mean.detach() - radius[:, None], mean.detach() + radius[:, None]
    rows = []
    for y0 in range(0, height, 16):
        row = []
        for x0 in range(0, width, 16):
            corner = torch.tensor([x0, y0])
            near = ((high > corner) & (low < corner + 16)).all(-1)
            ids = order[near[order]]
            h, v = min(16, height - y0), min(16, width - x0)
            yy, xx = torch.meshgrid(torch.arange(h) + y0 + 0.5, torch.arange(v) + x0 + 0.5, indexing="ij")
            d = torch.stack([xx, yy], -1).reshape(-1, 1, 2) - mean[ids]
            alpha = (opacity[ids] * torch.exp(-0.5 * torch.einsum("pni,nij,pnj->pn", d, conic[ids], d))).clamp(max=0.99)
            alpha = torch.where(alpha >= 1 / 255, alpha, 0.0)
            T = torch.cumprod(torch.cat([torch.ones(len(d), 1), 1 - alpha], 1), 1)[:, :-1]
            row.append(((T * alpha) @ color[ids]).reshape(h, v, 3))
        rows.append(torch.cat(row, 1))
    return torch.cat(rows, 0)
