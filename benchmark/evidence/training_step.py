"""The cost of a step of a real reconstruction: all Gaussians, those alight, by Dr.Jit's kernels, and in batches.

    python -m gof_benchmark.evidence.training_step DATASET [--preset standard] [--steps 40]

Takes about 1 min.

The first stages of `gof reconstruct DATASET`, then the same steps from the same seeds in turn, on one thread and, by
the clock, on all. Most of a clip's Gaussians live at another time than a picture's: `gof reconstruct` leaves them out
before it projects (`gof.reconstruct.parameters.alight`), and draws several frames at once (`gof.reconstruct.batches`).
Prints how many it draws, the time of a picture, what the renderer's native kernels, leaving out and batches are worth,
and how far the parameters differ after the last step.
"""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from gof.commands.read import Preset
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.reconstruct.presets import effort_of, size_of
from gof.reconstruct.settings import ReconstructionSettings
from gof_benchmark.evidence.render_kernels import drawn_by

WARM_UP = 5  # steps: the first compile
WAYS = {  # kernels; whether it leaves out who is not alight, and draws batches
    "Dr.Jit's kernels, all Gaussians": ("drjit", False, False),
    "Dr.Jit's kernels, those alight": ("drjit", True, False),
    "native kernels, all Gaussians": ("native", False, False),
    "native kernels, those alight": ("native", True, False),
    "native kernels, alight, in batches": ("native", True, True),
}


@dataclass(frozen=True)
class TrainingStep:
    """Time steps of a dataset's reconstruction."""

    dataset: tyro.conf.Positional[Path]
    """Dataset folder."""
    preset: Preset = "preview"
    """Whose Gaussians, voxels and picture size."""
    gaussians: int | None = None
    """Instead of the preset's."""
    longest_side: int | None = None
    """Instead of the preset's."""
    steps: int = 40
    """For each way."""
    json: Path | None = None
    """Also write every figure to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(TrainingStep, prog="python -m gof_benchmark.evidence.training_step", args=argv)
    from gof.reconstruct import stages
    from gof.reconstruct.pipeline import reconstruct

    dataset = Dataset.open(config.dataset)
    effort = effort_of(config.preset, gaussians=config.gaussians, max_size=config.longest_side, clip=size_of(dataset))
    settings = ReconstructionSettings.of(dataset, effort)
    figures: dict[str, Any] = {}

    def timed(seeds, observation, windows, surroundings, schedule, units, *_):
        figures.update(measure(seeds, observation, windows, surroundings, schedule, units, config.steps))
        raise _Measured

    with tempfile.TemporaryDirectory() as folder, patch.object(stages, "optimize", timed), suppress(_Measured):
        reconstruct(dataset, settings, Path(folder))
    print(report(figures))
    if config.json:
        write_json(config.json, figures)


class _Measured(Exception):
    """Ends a reconstruction before its first step."""


def measure(seeds, observation, windows, surroundings, schedule, units, steps: int) -> dict[str, Any]:
    """Return ms of each picture by way: of CPU time on one thread, then by the clock on all; see `optimize`."""
    import drjit as dr

    from gof.reconstruct.batches import TrainingPictures, count_together
    from gof.reconstruct.optimize import BatchGaussians, Flame, take_step

    together = count_together(seeds.t_sigma, observation.time_s, windows.width * windows.height)
    sizes = {way: together if in_batches else 1 for way, (_, _, in_batches) in WAYS.items()}
    flames = {way: Flame(seeds, observation, windows, surroundings, schedule, units, n) for way, n in sizes.items()}
    pictures = {way: TrainingPictures(observation, windows, together=n) for way, n in sizes.items()}
    done = dict.fromkeys(WAYS, 0)
    drawn: list[int] = []

    def step(way: str) -> int:
        kernels, leaves_out, _ = WAYS[way]
        with ExitStack() as stack:
            stack.enter_context(drawn_by(kernels))
            if not leaves_out:
                stack.enter_context(
                    patch.object(Flame, "shown", lambda flame, *_: BatchGaussians(flame.optimizer, None))
                )
            _, taken = take_step(done[way], flames[way], pictures[way], schedule, units)
            dr.sync_thread()
        done[way] += taken
        return taken

    shown = Flame.shown

    def counted(flame: Flame, *view) -> Any:
        found = shown(flame, *view)
        if found.stack is None:
            drawn.append(dr.width(found.raw["t_mu"]))
        return found

    figures: dict[str, Any] = {"gaussians": len(seeds), "pixels": [windows.width, windows.height], "together": together}
    threads = dr.thread_count()
    with patch.object(Flame, "shown", counted):
        for name, many, clock in (("cpu_ms", 1, time.process_time), ("wall_ms", threads, time.perf_counter)):
            dr.set_thread_count(many)
            figures[name] = {way: [] for way in WAYS}
            for repeat in range(steps + WARM_UP):
                for way, spent in figures[name].items():
                    start = clock()
                    taken = step(way)
                    if repeat >= WARM_UP:
                        spent.append(1e3 * (clock() - start) / taken)
    figures |= {"threads": threads, "drawn": float(np.mean(drawn)), "differ": _differ(flames, units)}
    return figures


def _differ(flames: dict[str, Any], units) -> float:
    """Return largest difference of a position between both native ways of a picture a step, in voxels."""
    alike = [way for way, (kernels, _, in_batches) in WAYS.items() if kernels == "native" and not in_batches]
    places = [flames[way].state()[0].position for way in alike]
    return float(np.abs(places[0] - places[1]).max() / units.voxel_size)


def report(figures: dict[str, Any]) -> str:
    """Return a table: milliseconds of a picture, smallest and median, and how many times as fast as the first way."""
    width, height = figures["pixels"]
    share = figures["drawn"] / figures["gaussians"]
    lines = [
        f"{figures['gaussians']} Gaussians, of which a step draws {figures['drawn']:.0f} ({share:.0%}), "
        f"windows of {width}x{height} px, {figures['together']} in a batch; smallest (median) of a picture",
        f"{'':34s}{'CPU ms, 1 thread':>20s}{'':>8s}{'wall ms, ' + str(figures['threads']) + ' threads':>22s}",
    ]
    first = next(iter(WAYS))
    for way in WAYS:
        cells = ""
        for name in ("cpu_ms", "wall_ms"):
            own, base = np.array(figures[name][way]), np.array(figures[name][first])
            cells += f"{own.min():10.1f} ({np.median(own):6.1f}){np.median(base) / np.median(own):7.2f}x   "
        lines.append(f"{way:34s}{cells}")
    lines.append(
        f"after {len(figures['cpu_ms'][first]) * 2 + 2 * WARM_UP} steps the positions of the two native ways without "
        f"batches differ by {figures['differ']:.1e} voxels at most"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
