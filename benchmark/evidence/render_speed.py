"""How fast the renderer is, phase by phase, against its peers and against the instruction count, in one run.

    python -m gof_benchmark.evidence.render_speed [--quick] [--json FILE]

Takes about 10 min.

Every figure is the minimum of several repetitions, as wall time and as CPU time over all threads (on a shared machine
wall time is what the neighbours leave; ratios of CPU time within one run are the comparable figure). Mitsuba runs in
processes of its own, once with its own settings of the LLVM backend and once with ours, and the faster of the two
counts. The torch peer is a plain 16x16 tile loop under autograd, a weak baseline that is easy to check.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.core.files import write_json
from gof.core.gaussians import TransientGaussians
from gof.host.checks import cpu_name
from gof_benchmark.evidence import child
from gof_benchmark.evidence.render_peers import best, mitsuba_peer, torch_peer
from gof_benchmark.evidence.render_scenes import camera, flame

# Vector instructions per (pixel, Gaussian) of the blend kernels with three channels, counted in gof/render/blend.py:
# a fixed part and one per channel; without what a 4x4 block shares (fetching the Gaussian, the gradient scatter) and
# without register spills.
CHANNELS = 3
KERNEL_OPS = {"forward": 23 + CHANNELS, "backward": 38 + 2 * CHANNELS}
KERNEL_GOALS_NS = {"forward": 0.8, "backward": 1.6}


@dataclass(frozen=True)
class RenderSpeed:
    """Time a training step by its phases, against Mitsuba, a torch tile loop and the CPU's limit."""

    quick: bool = False
    """Small scene, few repetitions: does the script run."""
    json: Path | None = None
    """Also write every figure to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print the tables."""
    config = tyro.cli(RenderSpeed, prog="python -m gof_benchmark.evidence.render_speed", args=argv)
    result = measure(config.quick)
    print(report(result))
    if config.json:
        write_json(config.json, result)


class RandomTraining:
    """A training step on the random flame, whole or in phases."""

    def __init__(self, n: int, width: int, height: int, gaussians: TransientGaussians | None = None):
        import drjit as dr

        from gof.render import Target
        from gof.render.adam import Adam
        from gof.render.backend import Array3f, Array4f, Float, floats
        from gof.render.scene import columns

        self.dr, self.Float, self.n, self.camera = dr, Float, n, camera(width, height)
        g = flame(n) if gaussians is None else gaussians
        logit = np.log(g.opacity / (1 - g.opacity))
        self.raw = {
            "position": columns(g.position, Array3f),
            "rotation": columns(g.rotation, Array4f),
            "scale": columns(np.log(g.scale), Array3f),
            "opacity": floats(logit),
            "color": columns(g.color, Array3f),
        }
        self.optimizer = Adam(lr=1e-4, params=self.raw)
        self.target = Target(np.random.default_rng(1).random((height, width, 3)))

    def add(self, more: TransientGaussians) -> None:
        """Add Gaussians behind those that there are, without Adam's moments, as density control adds them."""
        born = RandomTraining(len(more), self.camera.width, self.camera.height, more).raw
        self.optimizer.regroup(born, np.arange(self.n), born, np.arange(self.n + len(more)))
        self.n += len(more)

    def splats(self):
        from gof.render import Splats

        p = self.optimizer
        dr = self.dr
        return Splats(
            p["position"], p["rotation"], dr.exp(p["scale"]), 1 / (1 + dr.exp(-p["opacity"])), list(p["color"])
        )

    def step(self) -> None:
        from gof.render import l1_ssim, render_splats

        self.frame = render_splats(self.splats(), self.camera)
        self.dr.backward(l1_ssim(self.frame.color, self.target))
        self.optimizer.step()
        self.dr.sync_thread()

    def draw(self):
        from gof.render import render_splats

        frame = render_splats(self.splats(), self.camera)
        self.dr.eval(frame.color)
        self.dr.sync_thread()
        return frame

    def draw_and_differentiate(self) -> None:
        frame = self.draw()
        self.dr.backward(sum(self.dr.sum(c * c) for c in frame.color))
        self.dr.eval([self.dr.grad(self.optimizer[k]) for k in self.raw])
        self.dr.sync_thread()

    def phases(self, repeats: int) -> dict[str, tuple[float, float]]:
        """Return (wall, CPU) ms of each phase of the Dr.Jit kernels on its own, with a synchronisation after it.

        `render_kernels` has those of the native ones beside them.
        """
        from gof.render import bins, blend, l1_ssim, project
        from gof.render.backend import pack

        dr, Float = self.dr, self.Float
        s = self.splats()
        parameters = dr.detach([s.position, s.rotation, s.scale, s.opacity])
        dr.eval(parameters)

        def projected():
            p = project.project(*parameters, self.camera, project.ProjectionOptions())
            dr.eval(p)
            dr.sync_thread()
            return p

        p, canvas = projected(), bins.Canvas(self.camera.width, self.camera.height)
        shapes = bins.footprints(p, canvas)
        band = bins.bin_band(shapes, 0, shapes.rows)
        records = pack([p.mean_x, p.mean_y, p.a, p.b, p.c, p.log2_opacity, *dr.detach(list(s.color))], blend.stride(9))
        planes = [dr.empty(Float, shapes.rows * shapes.columns * 16) for _ in range(4)]
        size = blend._capacity(self.n) * blend.stride(9)
        image = [dr.opaque(Float, 0.5, self.camera.width * self.camera.height) for _ in range(3)]
        grads = [dr.opaque(Float, 1e-3, len(planes[0])) for _ in range(4)]
        lists, share = blend.shared(band.lists, blend.SHARE), blend.SHARE
        forward = records, lists, planes, 3, shapes.columns, blend.MAX_ALPHA, share
        backward = records, lists, planes, grads, 3, shapes.columns, blend.MAX_ALPHA, False, share, size

        def run(function):
            def timed():
                dr.eval(function())
                dr.sync_thread()

            timed()
            return best(timed, repeats)

        def loss():
            dr.enable_grad(image)
            dr.backward(l1_ssim(image, self.target))
            return dr.grad(image)

        return {
            "project": best(projected, repeats),
            "sort by depth, ellipses": run(lambda: bins.footprints(p, canvas)),
            "pairs, sort by block": run(lambda: bins.bin_band(shapes, 0, shapes.rows).lists),
            "blend forward": run(lambda: blend._forward(*forward)),
            "L1 + SSIM, both ways": run(loss),
            "blend backward": run(lambda: blend._gradient(*backward)),
        }


def vector_rate(repeats: int) -> float:
    """Fused multiply-adds per nanosecond and thread, per lane, that a register-only Dr.Jit kernel reaches here."""
    import drjit as dr

    from gof.render.backend import Float, UInt

    lanes, rounds = 4096, 200

    def run():
        def body(i, a):
            for _ in range(16):
                a = [dr.fma(v, 0.999, 0.001) for v in a]
            return i + 1, a

        start = [dr.arange(Float, lanes) * 1e-3 + k for k in range(12)]
        _, a = dr.while_loop((UInt(0), start), lambda i, a: i < rounds, body)
        dr.eval(a)
        dr.sync_thread()

    run()
    return lanes * rounds * 16 * 12 / (best(run, repeats)[1] * 1e6)


def one_thread(training: RandomTraining, repeats: int) -> dict:
    """CPU time without idle threads waiting in it, and what the core gave meanwhile."""
    import drjit as dr

    threads = dr.thread_count()
    dr.set_thread_count(1)
    try:
        rate, step, both = 0.0, math.inf, math.inf
        for _ in range(repeats):
            step, both = min(step, best(training.step, 1)[1]), min(both, best(training.draw_and_differentiate, 1)[1])
            rate = max(rate, vector_rate(1))
        return {"step_ms": step, "both_ms": both, "fma_per_ns": rate}
    finally:
        dr.set_thread_count(threads)


def growth(quick: bool, repeats: int) -> tuple[list[dict], dict]:
    """Step time over N and over image size, with the number of kernels compiled after the first two steps."""
    import drjit as dr

    counts = (10_000, 30_000, 100_000) if quick else (10_000, 30_000, 100_000, 300_000, 1_000_000)
    cases = [(n, 640, 360) for n in counts] + [(100_000, 320, 180), (100_000, 1280, 720)]
    rows = []
    for n, w, h in cases:
        training = RandomTraining(n, w, h)
        training.step()
        training.step()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            training.step()
            late = sum(not k["cache_hit"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT)
        wall, cpu = best(training.step, repeats)
        rows.append(
            {
                "n": n,
                "width": w,
                "height": h,
                "pairs": training.frame.intersections,
                "wall_ms": wall,
                "cpu_ms": cpu,
                "compiled_late": late,
            }
        )
    by_n = rows[: len(counts)]
    by_size = [rows[-2], rows[counts.index(100_000)], rows[-1]]
    return rows, {
        "cpu ~ N^": _exponent([r["n"] for r in by_n], [r["cpu_ms"] for r in by_n]),
        "cpu ~ pixels^": _exponent([r["width"] * r["height"] for r in by_size], [r["cpu_ms"] for r in by_size]),
    }


def _exponent(xs: list[float], ys: list[float]) -> float:
    """p of y ~ x^p, least squares in logarithms."""
    return float(np.polyfit(np.log(xs), np.log(ys), 1)[0])


def measure(quick: bool) -> dict[str, Any]:
    """Return all figures."""
    import drjit as dr

    from gof.render.backend import kernels

    repeats = 5 if quick else 25
    n, w, h = (20_000, 320, 180) if quick else (100_000, 640, 360)
    result: dict[str, Any] = {
        "machine": {
            "cpu": cpu_name(),
            "threads": dr.thread_count(),
            "drjit": dr.__version__,
            "kernels": kernels().name,
        },
        "scene": [n, w, h],
    }
    training = _warm(RandomTraining(n, w, h))
    result["step"] = best(training.step, repeats)
    result["forward"] = best(training.draw, repeats)
    result["both"] = best(training.draw_and_differentiate, repeats)
    result["one_thread"] = one_thread(training, repeats)
    result["mean"] = float(np.mean([c.numpy().mean() for c in training.draw().color]))
    result["pairs"] = training.frame.intersections
    result["phases"] = training.phases(repeats)
    result["fma_per_ns"] = vector_rate(repeats)
    result["kernels"] = _kernels(result)
    result["mitsuba"] = {
        "its own settings": child.call(mitsuba_peer, n, w, h, False),
        "our LLVM settings": child.call(mitsuba_peer, n, w, h, True),
    }
    result["torch"] = _against_torch(quick, repeats)
    result["growth"], result["exponents"] = growth(quick, max(3, repeats // 4))
    return result


def _warm(training: RandomTraining) -> RandomTraining:
    """With its kernels compiled."""
    for _ in range(3):
        training.step()
        training.draw_and_differentiate()
    return training


def _kernels(result: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Time of the blend kernels per evaluated (pixel, Gaussian) pair, and what the CPU's vector rate allows."""
    evaluated = 16 * result["pairs"]  # a pair of a 4x4 block and a Gaussian is 16 pixels
    return {
        name: {
            "ns_per_pair": 1e6 * result["phases"][f"blend {name}"][1] / evaluated,
            "limit_ns": ops / result["fma_per_ns"],
            "ops": ops,
        }
        for name, ops in KERNEL_OPS.items()
    }


def _against_torch(quick: bool, repeats: int) -> dict[str, Any]:
    n, w, h = (2_000, 160, 90) if quick else (20_000, 320, 180)
    small = RandomTraining(n, w, h)
    for _ in range(3):
        small.draw_and_differentiate()
    return {
        "scene": [n, w, h],
        "peer": torch_peer(n, w, h, 2),
        "ours_forward": best(small.draw, repeats),
        "ours_both": best(small.draw_and_differentiate, repeats),
    }


# ---------------------------------------------------------------- the tables as text


def report(r: dict[str, Any]) -> str:
    """Return all tables."""
    return "\n".join([*_times(r), "", *_ratios(r), "", *_kernel_limits(r), "", *_growth_table(r)])


def _time_line(name: str, wall_and_cpu: tuple[float, float]) -> str:
    wall, cpu = wall_and_cpu
    return f"{name:44s}{wall:10.2f}{cpu:10.2f}"


def _times(r: dict[str, Any]) -> list[str]:
    one, torch = r["one_thread"], r["torch"]
    lines = [
        f"scene {r['scene'][0]} Gaussians, {r['scene'][1]}x{r['scene'][2]}, {r['pairs']} (block, Gaussian) pairs; "
        f"{r['machine']['cpu']}, {r['machine']['threads']} threads; {r['machine']['kernels']} kernels",
        "",
        f"{'what':44s}{'wall ms':>10s}{'CPU ms':>10s}",
        *(_time_line(f"  {name} (Dr.Jit)", t) for name, t in r["phases"].items()),
        _time_line("full training step with Adam", r["step"]),
        _time_line("forward", r["forward"]),
        _time_line("forward + backward", r["both"]),
        f"one thread: step {one['step_ms']:.1f} CPU ms, forward + backward {one['both_ms']:.1f} CPU ms, while the "
        f"core gave {one['fma_per_ns']:.0f} fused multiply-adds per ns",
    ]
    for name, peer in r["mitsuba"].items():
        lines.append(_time_line(f"Mitsuba volprim_rf_basic forward ({name})", peer["forward"]))
        lines.append(_time_line(f"Mitsuba forward + backward ({name})", peer["both"]))
    return [
        *lines,
        _time_line("torch tile loop forward " + "x".join(map(str, torch["scene"])), torch["peer"]["forward"]),
        _time_line("torch tile loop forward + backward", torch["peer"]["both"]),
        _time_line("  ours, same scene, forward + backward", torch["ours_both"]),
    ]


def _ratios(r: dict[str, Any]) -> list[str]:
    """Against the faster of the two Mitsubas, and against torch."""
    fastest = {key: np.min([peer[key] for peer in r["mitsuba"].values()], axis=0) for key in ("forward", "both")}
    lines = [f"{'ratio':44s}{'wall':>10s}{'CPU':>10s}{'goal':>10s}"]
    for name, peer, ours, goal in (
        ("forward vs Mitsuba", fastest["forward"], r["forward"], 40),
        ("both vs Mitsuba", fastest["both"], r["both"], 80),
        ("both vs torch tile loop", r["torch"]["peer"]["both"], r["torch"]["ours_both"], 150),
    ):
        lines.append(f"{name:44s}{peer[0] / ours[0]:9.0f}x{peer[1] / ours[1]:9.0f}x{goal:9d}x")
    return lines


def _kernel_limits(r: dict[str, Any]) -> list[str]:
    lines = [
        f"{'Dr.Jit kernel':20s}{'CPU ns/pair':>12s}{'goal':>8s}{'instructions':>14s}{'limit ns':>10s}{'of limit':>10s}"
    ]
    for name, k in r["kernels"].items():
        lines.append(
            f"blend {name:14s}{k['ns_per_pair']:12.2f}{KERNEL_GOALS_NS[name]:8.1f}{k['ops']:14d}"
            f"{k['limit_ns']:10.2f}{k['limit_ns'] / k['ns_per_pair']:10.0%}"
        )
    rate = r["fma_per_ns"]
    return [
        *lines,
        f"(limit: those instructions at the {rate:.1f} fused multiply-adds per ns and thread measured here)",
    ]


def _growth_table(r: dict[str, Any]) -> list[str]:
    lines = [f"{'N':>9s}{'image':>12s}{'pairs':>10s}{'wall ms':>10s}{'CPU ms':>10s}{'compiled late':>15s}"]
    for g in r["growth"]:
        lines.append(
            f"{g['n']:9d}{g['width']:7d}x{g['height']:<4d}{g['pairs']:10d}{g['wall_ms']:10.1f}{g['cpu_ms']:10.1f}"
            f"{g['compiled_late']:15d}"
        )
    mitsuba = next(iter(r["mitsuba"].values()))
    return [
        *lines,
        "  ".join(f"{k}{v:.2f}" for k, v in r["exponents"].items()),
        f"mean of the image: ours {r['mean']:.4f}, Mitsuba {mitsuba['mean']:.4f}",
    ]


if __name__ == "__main__":
    main()
