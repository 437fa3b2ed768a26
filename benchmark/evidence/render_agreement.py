"""Does the renderer agree with what it must agree with: gradients with float64 central differences, pictures with Mitsuba.

python -m gof_benchmark.evidence.render_agreement [--picture FILE.png]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gof.gaussians import TransientGaussians
from gof_benchmark.evidence.render_scenes import camera, flame

ENTRIES = 40  # central differences per parameter and scene
TIME_S = 0.04


def gradient_table(scenes: int = 3, n: int = 25) -> dict[str, float]:
    """Worst |gradient - central difference| over a parameter's entries, relative to the parameter's largest difference.

    The loss is a random weighting of colour, alpha and depth of moving Gaussians at one time. The twin keeps the 1/255 skip,
    the 0.99 clamp and the stop, where the image jumps: an entry whose difference changes with half the step straddles such a
    jump, has no derivative to compare with, and is drawn again (about one in a thousand).
    """
    import drjit as dr

    from gof.render import Splats, reference, render_splats, transient_state
    from gof.render.backend import Array3f, Array4f, floats
    from gof.render.scene import columns

    worst: dict[str, float] = {}
    cam = camera(24, 20)
    for seed in range(scenes):
        r = np.random.default_rng(seed)
        f32 = lambda a: np.asarray(a, np.float32).astype(np.float64)  # noqa: E731
        values = {
            "x0": f32(r.normal([0, 0, 0.58], 0.25, (n, 3))),
            "velocity": f32(r.normal(size=(n, 3))),
            "t_mu": f32(r.uniform(0, 0.1, n)),
            "t_sigma": f32(r.uniform(0.03, 0.2, n)),
            "opacity": f32(r.uniform(0.1, 0.9, n)),
            "rotation": f32(r.normal(size=(n, 4))),
            "scale": f32(np.exp(r.normal(np.log(0.1), 0.5, (n, 3)))),
            "color": f32(r.uniform(-0.2, 1.5, (n, 3))),
        }
        weights = r.normal(size=(5, 20, 24))

        def objective(v):
            x, o = reference.transient_state(v["x0"], v["velocity"], v["t_mu"], v["t_sigma"], v["opacity"], TIME_S)
            color, alpha, depth = reference.render(x, v["rotation"], v["scale"], o, v["color"], cam)
            return sum((w * p).sum() for w, p in zip(weights, [*color.transpose(2, 0, 1), alpha, depth], strict=True))  # noqa: B023

        arrays = {
            k: floats(v) if v.ndim == 1 else columns(v, Array4f if v.shape[1] == 4 else Array3f)
            for k, v in values.items()
        }
        dr.enable_grad(arrays)
        a = arrays
        x, o = transient_state(a["x0"], a["velocity"], a["t_mu"], a["t_sigma"], a["opacity"], TIME_S)
        frame = render_splats(Splats(x, a["rotation"], a["scale"], o, list(a["color"])), cam, depth=True)
        dr.backward(
            sum(dr.sum(p * floats(w)) for p, w in zip([*frame.color, frame.alpha, frame.depth], weights, strict=True))
        )
        for name, value in values.items():
            grad = dr.grad(arrays[name])
            grad = np.array(grad.numpy()) if value.ndim == 1 else np.array(grad.numpy()).T
            got, want = [], []
            while len(want) < ENTRIES:
                pick = tuple(r.integers(0, k) for k in value.shape)
                slopes = []
                for step in (1e-6, 0.5e-6):
                    ends = []
                    for sign in (1, -1):
                        moved = values | {name: value.copy()}
                        moved[name][pick] += sign * step
                        ends.append(objective(moved))
                    slopes.append((ends[0] - ends[1]) / (2 * step))
                if abs(slopes[0] - slopes[1]) > 1e-3 * abs(slopes[0]) + 1e-5:
                    continue
                want.append(slopes[0])
                got.append(grad[pick])
            error = np.abs(np.array(got) - want).max() / np.abs(want).max()
            worst[name] = max(worst.get(name, 0.0), float(error))
    return worst


def mitsuba_comparison(n: int = 300, spp: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """(ours, Mitsuba's) (H, W, 3) of a flame of fat Gaussians, so that the pixel filters matter little."""
    from gof.render import render
    from gof.render.mitsuba_scene import render_mitsuba

    g = flame(n)
    fat = TransientGaussians(
        g.position, g.velocity, g.t_mu, g.t_sigma, 0.45 * g.scale, g.rotation, g.opacity, g.color, g.dynamic
    )
    cam = camera(240, 180)
    return render(fat, cam, 0.0, antialias=True)["color"], render_mitsuba(fat, cam, 0.0, spp=spp)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--picture", type=Path, help="write ours | Mitsuba's | 5 x difference (grey = equal) to this PNG"
    )
    args = parser.parse_args()
    print("gradient against central differences in float64, worst relative error:")
    for name, error in gradient_table().items():
        print(f"  {name:10s} {error:.1e}")
    ours, theirs = mitsuba_comparison()
    difference = ours - theirs
    print(
        f"Mitsuba: sum|difference| / sum = {np.abs(difference).sum() / ours.sum():.3f}, mean ratio {ours.mean() / theirs.mean():.4f}, "
        f"largest {np.abs(difference).max():.3f} of {ours.max():.3f}"
    )
    if args.picture:
        from PIL import Image

        from gof.io.files import atomic_path

        panel = np.concatenate([ours, theirs, 0.5 + 5 * difference], 1)
        with atomic_path(args.picture) as path:
            Image.fromarray((255 * np.clip(panel, 0, 1) + 0.5).astype(np.uint8)).save(path)


if __name__ == "__main__":
    main()
