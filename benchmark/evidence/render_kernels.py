"""The native kernels against Dr.Jit's: the same steps, in turn, in one process; on one thread, and on all by the clock.

    python -m gof_benchmark.evidence.render_kernels [--quick] [--json FILE]

Takes about 2 min.

CPU time of one thread, smallest and median of the repetitions. On a shared machine both change from minute to minute;
because the two take turns their ratio does not. The last line has whole steps on all threads by the clock, which says
something on a machine that does nothing else: its load is printed. Gaussians lie in random order first, and along the
Morton curve (as `gof reconstruct` keeps them) second.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from gof.core.files import write_json
from gof.core.morton import morton_order
from gof_benchmark.evidence.render_scenes import flame
from gof_benchmark.evidence.render_speed import KERNEL_GOALS_NS, RandomTraining

KINDS = ("drjit", "native")
PIXELS = 16  # of a block
STEP_GOAL = 2.0
RATE_GOAL = 28  # steps/s by the clock on two cores


@dataclass(frozen=True)
class RenderKernels:
    """Time steps and their parts with both sets of kernels."""

    quick: bool = False
    """Small scene, few repetitions: does the script run."""
    json: Path | None = None
    """Also write every figure to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print the tables."""
    config = tyro.cli(RenderKernels, prog="python -m gof_benchmark.evidence.render_kernels", args=argv)
    size, repeats = ((5_000, 160, 90), 3) if config.quick else ((100_000, 640, 360), 9)
    orders = ("random order", "Morton order")
    result = {order: measure(*size, repeats, morton=order == "Morton order") for order in orders}
    for order, figures in result.items():
        print(report(f"{size[0]} Gaussians in {order}, {size[1]}x{size[2]}", figures))
    if config.json:
        write_json(config.json, result)


@contextmanager
def drawn_by(kind: str) -> Iterator[None]:
    """Kernels of this kind."""
    with patch.dict(os.environ, {"GOF_RENDER_KERNELS": kind}):
        yield


def measure(n: int, width: int, height: int, repeats: int, morton: bool) -> dict[str, Any]:
    """{part: {kind: [CPU ms, ...]}}, steps on all threads in wall ms, and the number of (block, Gaussian) pairs."""
    import drjit as dr

    gaussians = flame(n)
    if morton:
        gaussians = gaussians[morton_order(gaussians.position)]
    trainings = {}
    for kind in KINDS:
        with drawn_by(kind):
            trainings[kind] = RandomTraining(n, width, height, gaussians)
    whole = {
        "forward": lambda t: t.draw(),
        "forward + backward": lambda t: t.draw_and_differentiate(),
        "step without loss, with Adam": _step_without_loss,
        "step": lambda t: t.step(),
    }
    figures: dict[str, Any] = {"by the clock": _on_all_threads(trainings, repeats)}
    threads = dr.thread_count()
    dr.set_thread_count(1)
    try:
        for name, run in whole.items():
            figures[name] = {kind: [] for kind in KINDS}
            for repeat in range(repeats + 2):
                for kind, training in trainings.items():
                    with drawn_by(kind):
                        spent = _cpu_ms(lambda: run(training))  # noqa: B023
                    if repeat >= 2:  # the first compile
                        figures[name][kind].append(spent)
        figures |= _parts(trainings, repeats)
        figures["pairs"] = trainings["native"].frame.intersections
    finally:
        dr.set_thread_count(threads)
    return figures


def _on_all_threads(trainings: dict[str, RandomTraining], repeats: int) -> dict[str, list[float]]:
    """{kind: [wall ms of a step, ...]}."""
    found: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for repeat in range(repeats + 2):
        for kind, training in trainings.items():
            with drawn_by(kind):
                start = time.perf_counter()
                training.step()
                spent = 1e3 * (time.perf_counter() - start)
            if repeat >= 2:
                found[kind].append(spent)
    return found


def _cpu_ms(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return 1e3 * (time.process_time() - start)


def _step_without_loss(training: RandomTraining) -> None:
    training.draw_and_differentiate()
    training.optimizer.step()
    training.dr.sync_thread()


def _parts(trainings: dict[str, RandomTraining], repeats: int) -> dict[str, dict[str, list[float]]]:
    """Return the same for parts of a step, each between synchronisations."""
    from gof.render import blend, l1_ssim
    from gof.render.backend import Float
    from gof.render.native.operation import NativeBlend

    places = {
        "drjit": {
            "sort, lists": [(blend, "footprints"), (blend, "bin_band")],
            "blend forward": [(blend, "_forward")],
            "blend backward": [(blend, "_gradient")],
        },
        "native": {
            "sort, lists": [(NativeBlend, "_prepare"), (NativeBlend, "_bin")],
            "blend forward": [(NativeBlend, "_run_forward")],
            "blend backward": [(NativeBlend, "_run_backward")],
        },
    }
    figures = {name: {kind: [] for kind in KINDS} for name in (*places["native"], "L1 + SSIM, both ways", "Adam")}

    def loss(training: RandomTraining, image: list) -> None:
        dr = training.dr
        dr.enable_grad(image)
        dr.backward(l1_ssim(image, training.target))
        dr.eval(dr.grad(image))
        dr.sync_thread()

    for repeat in range(repeats + 2):
        for kind, training in trainings.items():
            dr, camera = training.dr, training.camera
            spent = dict.fromkeys(figures, 0.0)
            with drawn_by(kind), ExitStack() as watched:
                for name, functions in places[kind].items():
                    for owner, function in functions:
                        watch = _watched(getattr(owner, function), name, spent, dr)
                        watched.enter_context(patch.object(owner, function, watch))
                training.draw_and_differentiate()
                spent["Adam"] = _cpu_ms(lambda: (training.optimizer.step(), dr.sync_thread()))  # noqa: B023
                image = [dr.opaque(Float, 0.5, camera.width * camera.height) for _ in range(3)]
                spent["L1 + SSIM, both ways"] = _cpu_ms(lambda: loss(training, image))  # noqa: B023
            if repeat >= 2:
                for name, ms in spent.items():
                    figures[name][kind].append(ms)
    return figures


def _watched(function: Callable, name: str, spent: dict[str, float], dr) -> Callable:
    """Return the function, which adds what it takes to `spent`."""

    def watch(*args):
        dr.sync_thread()
        start = time.process_time()
        out = function(*args)
        dr.sync_thread()
        spent[name] += 1e3 * (time.process_time() - start)
        return out

    return watch


def report(title: str, figures: dict[str, Any]) -> str:
    """Return a table: CPU ms of both, ratios of the smallest and of the medians; the kernels also in ns per pair."""
    pairs = PIXELS * figures["pairs"]
    lines = [
        f"{title}, {figures['pairs']} (block, Gaussian) pairs; one thread, CPU ms: smallest (median)",
        f"{'':32s}{'Dr.Jit':>18s}{'native':>18s}{'ratio':>8s}{'median':>8s}",
    ]
    for name, kinds in figures.items():
        if name in ("pairs", "by the clock"):
            continue
        ours, theirs = np.array(kinds["native"]), np.array(kinds["drjit"])
        times = "".join(f"{x.min():9.2f} ({np.median(x):6.2f})" for x in (theirs, ours))
        line = f"{name:32s}{times}{theirs.min() / ours.min():7.2f}x{np.median(theirs) / np.median(ours):7.2f}x"
        if name == "step":
            line += f"  goal {STEP_GOAL:.1f}x"
        direction = name.removeprefix("blend ")
        if direction in KERNEL_GOALS_NS and direction != name:
            per_pair = [1e6 * x.min() / pairs for x in (theirs, ours)]
            line += f"  {per_pair[0]:.2f} and {per_pair[1]:.2f} ns per pair, goal {KERNEL_GOALS_NS[direction]}"
        lines.append(line)
    rates = [1e3 / min(figures["by the clock"][kind]) for kind in KINDS]
    middle = [1e3 / float(np.median(figures["by the clock"][kind])) for kind in KINDS]
    lines.append(
        f"steps/s on {os.cpu_count()} cores by the clock, load {os.getloadavg()[0]:.1f}: best (median) "
        f"Dr.Jit {rates[0]:.1f} ({middle[0]:.1f}), native {rates[1]:.1f} ({middle[1]:.1f}), goal {RATE_GOAL}"
    )
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    main()
