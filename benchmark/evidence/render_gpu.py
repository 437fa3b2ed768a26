"""The renderer on a GPU beside the CPU's kernels: the same pictures and gradients, and steps by the clock.

    python -m gof_benchmark.evidence.render_gpu [--quick] [--json FILE]

Takes about 1 min. Needs an NVIDIA GPU.

Three ways to draw take turns, each in a process of its own: native kernels and Dr.Jit's on all cores of the CPU, and
Dr.Jit's on an NVIDIA GPU (left out where there is none). Where gsplat and a CUDA build of PyTorch are installed, its
rasterizer draws and differentiates the same Gaussians; it has no loss and no optimiser. Times are medians, by the
clock, of calls that end with the device at rest; the calls before them compile. `busy` is what the GPU's kernels of a
step take one by one, `launches` how many there are: the rest of a step is the host's.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from gof.core.files import write_json
from gof.host.checks import cpu_name
from gof_benchmark.evidence import child
from gof_benchmark.evidence.render_scenes import camera, flame

SIZES = ((100_000, 640, 360), (300_000, 640, 360), (100_000, 1280, 720), (300_000, 1280, 720))
QUICK = ((5_000, 160, 90),)
WAYS = {
    "native, CPU": {"GOF_RENDER_BACKEND": "llvm", "GOF_RENDER_KERNELS": "native"},
    "Dr.Jit, CPU": {"GOF_RENDER_BACKEND": "llvm", "GOF_RENDER_KERNELS": "drjit"},
    "Dr.Jit, GPU": {"GOF_RENDER_BACKEND": "cuda", "GOF_RENDER_KERNELS": "drjit"},
}
FORWARD, BOTH, STEP = "forward", "forward + backward", "step"


@dataclass(frozen=True)
class RenderGpu:
    """Compare pictures, gradients and times of the ways to draw."""

    quick: bool = False
    """Small scene, few repetitions: does the script run."""
    json: Path | None = None
    """Also write every figure to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print the tables."""
    config = tyro.cli(RenderGpu, prog="python -m gof_benchmark.evidence.render_gpu", args=argv)
    result = measure(QUICK if config.quick else SIZES, 3 if config.quick else 11)
    print(report(result))
    if config.json:
        write_json(config.json, result)


def measure(sizes: tuple[tuple[int, int, int], ...], repeats: int) -> dict[str, Any]:
    """Return the machine, the largest and RMS differences, and the times of every size."""
    ways = {name: way for name, way in WAYS.items() if way["GOF_RENDER_BACKEND"] == "llvm" or has_gpu()}
    result: dict[str, Any] = {"machine": machine(), "sizes": sizes, "differences": {}, "times": {}}
    drawn = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, way in ways.items():
            path = Path(folder) / f"{len(drawn)}.npz"
            with patch.dict(os.environ, way):
                result["times"][name] = child.call(draw_and_time, sizes, repeats, str(path))
            drawn[name] = dict(np.load(path))
    first, *others = drawn
    for name in others:
        result["differences"][name] = differences(drawn[name], drawn[first])
    if has_gpu() and has_gsplat():
        result["machine"]["gsplat"] = version("gsplat")
        try:
            result["times"]["gsplat, GPU"] = child.call(time_gsplat, sizes, repeats)
        except RuntimeError as e:  # a peer's fault is no reason to lose our figures
            result["machine"]["gsplat"] += f" ({str(e).splitlines()[-1]})"
    return result


def has_gpu() -> bool:
    """Return whether Dr.Jit finds an NVIDIA GPU."""
    import drjit as dr

    return dr.has_backend(dr.JitBackend.CUDA)


def has_gsplat() -> bool:
    """Return whether gsplat's kernels and a CUDA build of PyTorch are here."""
    try:
        import torch
        from gsplat.cuda._backend import _C
    except ImportError:
        return False
    return torch.cuda.is_available() and _C is not None


def machine() -> dict[str, Any]:
    """Return what the figures hold for."""
    about = {"date": date.today().isoformat(), "cpu": cpu_name(), "cores": os.cpu_count(), "drjit": version("drjit")}
    asked = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        name, driver = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split(",")[:2]
        about |= {"gpu": name.strip(), "driver": driver.split()[0]}
    except (OSError, subprocess.CalledProcessError, ValueError):
        about["gpu"] = "none"
    return about


def draw_and_time(sizes: list[tuple[int, int, int]], repeats: int, out: str) -> list[dict[str, Any]]:
    """Draw the first size to a file, see `draw_once`; return the times of all, see `time_steps`."""
    draw_once(*sizes[0], out)
    return [time_steps(*size, repeats) for size in sizes]


def draw_once(n: int, width: int, height: int, out: str) -> None:
    """Write planes, and gradients of a random weighting of them, to a file."""
    import drjit as dr

    from gof.render import Splats, render_splats
    from gof.render.backend import Array3f, Array4f, floats
    from gof.render.scene import columns

    g, view, rng = flame(n), camera(width, height), np.random.default_rng(3)
    leaves: dict[str, Any] = {
        "position": columns(g.position, Array3f),
        "rotation": columns(g.rotation, Array4f),
        "scale": columns(g.scale, Array3f),
        "opacity": floats(g.opacity),
        "color": columns(g.color, Array3f),
    }
    dr.enable_grad(leaves)
    parameters = (leaves[name] for name in ("position", "rotation", "scale", "opacity"))
    frame = render_splats(Splats(*parameters, list(leaves["color"])), view, depth=True)
    planes = {"red": frame.color[0], "green": frame.color[1], "blue": frame.color[2]}
    planes |= {"alpha": frame.alpha, "depth": frame.depth}
    kept = {name: np.array(plane.numpy()) for name, plane in planes.items()}
    weights = rng.normal(size=(len(planes), width * height))
    dr.backward(sum(dr.sum(p * floats(w)) for p, w in zip(planes.values(), weights, strict=True)))
    kept |= {f"d/d {name}": np.array(dr.grad(leaf).numpy()) for name, leaf in leaves.items()}
    np.savez(out, **kept)


def differences(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Return of each plane and gradient the largest and the RMS difference, over the RMS of theirs."""
    out = {}
    for name, values in theirs.items():
        away = ours[name].astype(np.float64) - values
        size = float(np.sqrt(np.mean(values.astype(np.float64) ** 2)))
        largest, rms = float(np.abs(away).max()), float(np.sqrt(np.mean(away**2)))
        out[name] = {"largest": largest / size, "rms": rms / size}
    return out


def median_ms(function: Callable[[], object], repeats: int) -> float:
    """Return the median by the clock of a function that leaves nothing running; three calls before it compile."""
    spent = []
    for repeat in range(repeats + 3):
        start = time.perf_counter()
        function()
        if repeat >= 3:
            spent.append(1e3 * (time.perf_counter() - start))
    return float(np.median(spent))


def time_steps(n: int, width: int, height: int, repeats: int) -> dict[str, Any]:
    """Return the ms of drawing, of drawing and differentiating, and of a training step."""
    import drjit as dr

    from gof.render.backend import BACKEND
    from gof_benchmark.evidence.render_speed import RandomTraining

    training = RandomTraining(n, width, height)
    calls = {FORWARD: training.draw, BOTH: training.draw_and_differentiate, STEP: training.step}
    out: dict[str, Any] = {name: median_ms(call, repeats) for name, call in calls.items()}
    if BACKEND == "cuda":
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            training.step()
            history = [k for k in dr.kernel_history() if k["type"] != dr.KernelType.LLVMHostFunc]
        out["launches"] = len(history)
        out["busy"] = float(sum(k["execution_time"] for k in history))
        slowest = sorted(history, key=lambda k: -k["execution_time"])[:6]
        out["slowest"] = [[str(k["type"]), int(k["size"]), float(k["execution_time"])] for k in slowest]
    return out


def time_gsplat(sizes: list[tuple[int, int, int]], repeats: int) -> list[dict[str, Any]]:
    """Return the same of gsplat's rasterizer, without a training step."""
    return [_time_gsplat(*size, repeats) for size in sizes]


def _time_gsplat(n: int, width: int, height: int, repeats: int) -> dict[str, Any]:
    import torch
    from gsplat import rasterization

    g, view = flame(n), camera(width, height)

    def leaf(values):
        return torch.tensor(np.asarray(values), dtype=torch.float32, device="cuda", requires_grad=True)

    leaves = [leaf(v) for v in (g.position, g.rotation, g.scale, g.opacity, g.color)]
    world, intrinsic = (torch.tensor(np.asarray(m), dtype=torch.float32, device="cuda")[None] for m in _matrices(view))

    def draw():
        picture = rasterization(*leaves, world, intrinsic, width, height)[0]
        torch.cuda.synchronize()
        return picture

    def both():
        for values in leaves:
            values.grad = None
        (draw() ** 2).sum().backward()
        torch.cuda.synchronize()

    with torch.no_grad():
        forward = median_ms(draw, repeats)
    return {FORWARD: forward, BOTH: median_ms(both, repeats)}


def _matrices(view) -> tuple[np.ndarray, np.ndarray]:
    return np.vstack([view.world_to_camera[:3], [0, 0, 0, 1]]), view.K


def report(result: dict[str, Any]) -> str:
    """Return the tables as text."""
    about = result["machine"]
    lines = [
        f"{about['date']}: {about['gpu']}, driver {about.get('driver', '-')}, Dr.Jit {about['drjit']}, "
        f"gsplat {about.get('gsplat', '-')}; "
        f"{about['cpu']}, {about['cores']} cores",
        "",
        "Differences from the native kernels over the RMS of the plane or gradient: largest (RMS)",
    ]
    for way, found in result["differences"].items():
        lines.append(f"  {way}: " + ", ".join(f"{k} {v['largest']:.1e} ({v['rms']:.1e})" for k, v in found.items()))
    lines += [
        "",
        "| Gaussians, picture | drawn by | forward ms | and backward ms | step ms | steps/s | busy ms | launches |",
    ]
    lines.append("|---|---|---:|---:|---:|---:|---:|---:|")
    for k, (n, width, height) in enumerate(result["sizes"]):
        for way, ms in ((name, found[k]) for name, found in result["times"].items()):
            size = f"{n}, {width}x{height}"
            step = (f"{ms[STEP]:.1f}", f"{1e3 / ms[STEP]:.0f}") if STEP in ms else ("", "")
            busy = (f"{ms['busy']:.2f}", str(ms["launches"])) if "busy" in ms else ("", "")
            cells = size, way, f"{ms[FORWARD]:.2f}", f"{ms[BOTH]:.2f}", *step, *busy
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
