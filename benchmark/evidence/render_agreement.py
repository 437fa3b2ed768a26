"""Does the renderer agree with what it must agree with: gradients with central differences, pictures with Mitsuba.

    python -m gof_benchmark.evidence.render_agreement [--picture FILE.png]

Takes about 2 min.

Central differences are those of the float64 twin (gof/render/reference.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof_benchmark.evidence.render_scenes import camera, flame

ENTRIES = 40  # central differences per parameter and scene
TIME_S = 0.04
STEP = 1e-6  # of the central differences

Parameters = dict[str, np.ndarray]


@dataclass(frozen=True)
class RenderAgreement:
    """Print the worst gradient error of every parameter, and how far a flame is from Mitsuba's picture of it."""

    picture: Path | None = None
    """Write ours | Mitsuba's | 5 x difference (grey = equal) to this PNG."""


def main(argv: list[str] | None = None) -> None:
    """Print both."""
    config = tyro.cli(RenderAgreement, prog="python -m gof_benchmark.evidence.render_agreement", args=argv)
    print("gradient against central differences in float64, worst relative error:")
    for name, error in gradient_table().items():
        print(f"  {name:10s} {error:.1e}")
    ours, theirs = mitsuba_comparison()
    difference = ours - theirs
    print(
        f"Mitsuba: sum|difference| / sum = {np.abs(difference).sum() / ours.sum():.3f}, mean ratio "
        f"{ours.mean() / theirs.mean():.4f}, largest {np.abs(difference).max():.3f} of {ours.max():.3f}"
    )
    if config.picture:
        write_picture(config.picture, ours, theirs)


def gradient_table(scenes: int = 3, n: int = 25) -> dict[str, float]:
    """Worst |gradient - central difference| over a parameter's entries, relative to the parameter's largest difference.

    The loss is a random weighting of colour, alpha and depth of moving Gaussians at one time.
    """
    worst: dict[str, float] = {}
    small_camera = camera(24, 20)
    for seed in range(scenes):
        rng = np.random.default_rng(seed)
        values = random_parameters(rng, n)
        weights = rng.normal(size=(5, small_camera.height, small_camera.width))
        gradient = gradients(values, weights, small_camera)

        def objective(v: Parameters, weights: np.ndarray = weights) -> float:
            return reference_objective(v, weights, small_camera)

        for name in values:
            got, want = compare_entries(name, values, gradient[name], objective, rng)
            error = np.abs(got - want).max() / np.abs(want).max()
            worst[name] = max(worst.get(name, 0.0), float(error))
    return worst


def random_parameters(rng: np.random.Generator, n: int) -> Parameters:
    """N moving Gaussians, float64 values that float32 holds exactly."""
    values = {
        "x0": rng.normal([0, 0, 0.58], 0.25, (n, 3)),
        "velocity": rng.normal(size=(n, 3)),
        "t_mu": rng.uniform(0, 0.1, n),
        "t_sigma": rng.uniform(0.03, 0.2, n),
        "opacity": rng.uniform(0.1, 0.9, n),
        "rotation": rng.normal(size=(n, 4)),
        "scale": np.exp(rng.normal(np.log(0.1), 0.5, (n, 3))),
        "color": rng.uniform(-0.2, 1.5, (n, 3)),
    }
    return {name: value.astype(np.float32).astype(np.float64) for name, value in values.items()}


def reference_objective(v: Parameters, weights: np.ndarray, view: Camera) -> float:
    """Return the loss by the twin, in float64."""
    from gof.render import reference

    x, o = reference.transient_state(v["x0"], v["velocity"], v["t_mu"], v["t_sigma"], v["opacity"], TIME_S)
    color, alpha, depth = reference.render(x, v["rotation"], v["scale"], o, v["color"], view)
    planes = [*color.transpose(2, 0, 1), alpha, depth]
    return sum((weight * plane).sum() for weight, plane in zip(weights, planes, strict=True))


def gradients(values: Parameters, weights: np.ndarray, view: Camera) -> Parameters:
    """Return the renderer's gradient of the same loss, in the shapes of the parameters."""
    import drjit as dr

    from gof.render import Splats, render_splats, transient_state
    from gof.render.backend import Array3f, Array4f, floats
    from gof.render.scene import columns

    kinds = {3: Array3f, 4: Array4f}
    arrays = {
        name: floats(value) if value.ndim == 1 else columns(value, kinds[value.shape[1]])
        for name, value in values.items()
    }
    dr.enable_grad(arrays)
    a = arrays
    x, o = transient_state(a["x0"], a["velocity"], a["t_mu"], a["t_sigma"], a["opacity"], TIME_S)
    frame = render_splats(Splats(x, a["rotation"], a["scale"], o, list(a["color"])), view, depth=True)
    planes = [*frame.color, frame.alpha, frame.depth]
    dr.backward(sum(dr.sum(plane * floats(weight)) for plane, weight in zip(planes, weights, strict=True)))
    return {name: np.array(dr.grad(array).numpy()).T for name, array in arrays.items()}


def compare_entries(
    name: str,
    values: Parameters,
    gradient: np.ndarray,
    objective: Callable[[Parameters], float],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """`ENTRIES` entries of a parameter's gradient, and their central differences.

    The twin keeps the 1/255 skip, the 0.99 clamp and the stop, where the image jumps: an entry whose difference changes
    with half the step straddles such a jump, has no derivative to compare with, and is drawn again (about one in a
    thousand).
    """

    def slope(entry: tuple[int, ...], step: float) -> float:
        ends = []
        for sign in (1, -1):
            moved = values | {name: values[name].copy()}
            moved[name][entry] += sign * step
            ends.append(objective(moved))
        return (ends[0] - ends[1]) / (2 * step)

    got, want = [], []
    while len(want) < ENTRIES:
        entry = tuple(rng.integers(0, side) for side in values[name].shape)
        whole, half = slope(entry, STEP), slope(entry, 0.5 * STEP)
        if abs(whole - half) > 1e-3 * abs(whole) + 1e-5:
            continue
        want.append(whole)
        got.append(gradient[entry])
    return np.array(got), np.array(want)


def mitsuba_comparison(n: int = 300, spp: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """Return (ours, Mitsuba's) (H, W, 3) of a flame of fat Gaussians, so that the pixel filters matter little."""
    from gof.render import render
    from gof.render.mitsuba_scene import render_mitsuba

    g = flame(n)
    fat = TransientGaussians(
        g.position, g.velocity, g.t_mu, g.t_sigma, 0.45 * g.scale, g.rotation, g.opacity, g.color, g.dynamic
    )
    cam = camera(240, 180)
    return render(fat, cam, 0.0, antialias=True)["color"], render_mitsuba(fat, cam, 0.0, spp=spp)


def write_picture(path: Path, ours: np.ndarray, theirs: np.ndarray) -> None:
    from PIL import Image

    from gof.core.files import atomic_path

    panel = np.concatenate([ours, theirs, 0.5 + 5 * (ours - theirs)], 1)
    with atomic_path(path) as temporary:
        Image.fromarray((255 * np.clip(panel, 0, 1) + 0.5).astype(np.uint8)).save(temporary)


if __name__ == "__main__":
    main()
