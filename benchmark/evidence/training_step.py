"""The cost of a step of a real reconstruction: with all Gaussians, with those alight, and by Dr.Jit's kernels.

    python -m gof_benchmark.evidence.training_step DATASET [--preset standard] [--steps 40]

Takes about 1 min.

The first stages of `gof reconstruct DATASET`, then the same steps from the same seeds in turn, on one thread and, by
the clock, on all. Most of a clip's Gaussians live at another time than a picture's: `gof reconstruct` leaves them out
before it projects (`gof.reconstruct.parameters.alight`). Prints how many it draws, CPU time of a step, what the
renderer's native kernels and leaving out are worth, and how far the parameters differ after the last step.
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
WAYS = {
    "Dr.Jit's kernels, all Gaussians": ("drjit", False),
    "Dr.Jit's kernels, those alight": ("drjit", True),
    "native kernels, all Gaussians": ("native", False),
    "native kernels, those alight": ("native", True),
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
    """Return milliseconds of each step by way: of CPU time on one thread, then by the clock on all; see `optimize`."""
    import drjit as dr

    from gof.reconstruct.batches import TrainingPictures
    from gof.reconstruct.optimize import Flame, Shown, take_step

    flames = {way: Flame(seeds, observation, windows, surroundings, schedule, units) for way in WAYS}
    pictures = {way: TrainingPictures(observation, windows) for way in WAYS}  # each ready for its own kernels
    drawn: list[int] = []

    def step(way: str, number: int) -> None:
        kernels, leaves_out = WAYS[way]
        with ExitStack() as stack:
            stack.enter_context(drawn_by(kernels))
            if not leaves_out:
                stack.enter_context(patch.object(Flame, "shown", lambda flame, *_: Shown(flame.optimizer, None)))
            take_step(number, flames[way], pictures[way], schedule, units)
            dr.sync_thread()

    shown = Flame.shown

    def counted(flame: Flame, *view) -> Any:
        found = shown(flame, *view)
        drawn.append(dr.width(found.raw["t_mu"]))
        return found

    figures: dict[str, Any] = {"gaussians": len(seeds), "pixels": [windows.width, windows.height]}
    threads, number = dr.thread_count(), 0
    with patch.object(Flame, "shown", counted):
        for name, many, clock in (("cpu_ms", 1, time.process_time), ("wall_ms", threads, time.perf_counter)):
            dr.set_thread_count(many)
            figures[name] = {way: [] for way in WAYS}
            for repeat in range(steps + WARM_UP):
                for way, spent in figures[name].items():
                    start = clock()
                    step(way, number)
                    if repeat >= WARM_UP:
                        spent.append(1e3 * (clock() - start))
                number += 1
    figures |= {"threads": threads, "drawn": float(np.mean(drawn)), "differ": _differ(flames, units)}
    return figures


def _differ(flames: dict[str, Any], units) -> float:
    """Return largest difference of a position between the two native ways after all steps, in voxels."""
    places = [flames[way].state()[0].position for way, (kernels, _) in WAYS.items() if kernels == "native"]
    return float(np.abs(places[0] - places[1]).max() / units.voxel_size)


def report(figures: dict[str, Any]) -> str:
    """Return a table: milliseconds of a step, smallest and median, and how many times as fast as the first way."""
    width, height = figures["pixels"]
    share = figures["drawn"] / figures["gaussians"]
    lines = [
        f"{figures['gaussians']} Gaussians, of which a step draws {figures['drawn']:.0f} ({share:.0%}), "
        f"windows of {width}x{height} px; smallest (median)",
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
        f"after {len(figures['cpu_ms'][first]) * 2 + 2 * WARM_UP} steps the positions of the last two differ by "
        f"{figures['differ']:.1e} voxels at most"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
