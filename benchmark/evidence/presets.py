"""The settings of every preset and the cost of the demo with it, as `gof generate` and `gof reconstruct` predict them.

    python -m gof_benchmark.evidence.presets

Takes about 2 min.

The first time it measures this machine, as `gof generate --estimate` does. Costs are of this machine without other
work. A reconstruction is of the dataset that the same preset generates, with a flame that fills the pictures.
"""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass, replace

import tyro

from gof.commands.reconstruct import ReconstructConfig
from gof.core.description import held_out
from gof.core.ladder import LADDER
from gof.core.records import read_record
from gof.core.time_left import MachineLoad, Paces, duration
from gof.reconstruct.forecast import ClipShape, expected_bytes, expected_parts
from gof.reconstruct.memory import GB
from gof.reconstruct.presets import PRESETS, Effort, effort_of
from gof.reconstruct.settings import ReconstructionSettings
from gof.reconstruct.shrink import fitting_px
from gof_benchmark.generator import machine
from gof_benchmark.scenes import load_scene
from gof_benchmark.suite import FILE, SuiteList
from gof_blender.pure.rig import role_of
from gof_blender.pure.spec import SceneSpec

COLUMNS = (
    "preset",
    "dataset: frames, cells, picture, samples",
    "`gof generate demo`",
    "reconstruction: steps, Gaussians, voxels, longer side in px",
    "`gof reconstruct`",
    "memory, generate; reconstruct",
    "benchmark",
    "for",
)
PURPOSES = {
    "toy": "does it work?",
    "preview": "a look; the truest motion",
    "standard": "filmed flames",
    "large": "pictures of the whole sensor",
    "full": "the paper's effort, on a cluster",
}


@dataclass(frozen=True)
class PresetCosts:
    """Print what every preset is, and what the demo costs with it on this machine without other work."""


def shape_of(spec: SceneSpec, longest_side: int) -> ClipShape:
    """Return the shape of a spec's dataset, as it is reconstructed with pictures of at most `longest_side` px."""
    cameras = sum(role_of(name) == "train" for name in spec.cameras.names)
    picture = math.prod(fitting_px(*spec.picture_px, longest_side))
    return ClipShape(len(held_out(spec.clip.frames).train), (picture,) * cameras)


def reconstruction_of(preset: str, spec: SceneSpec) -> tuple[ClipShape, Effort]:
    """Return the clip and the effort of `gof reconstruct --preset` for a spec's dataset."""
    clip = shape_of(spec, PRESETS[preset].longest_side)
    return clip, effort_of(preset, clip=(clip.frames, len(clip.pictures_px)))


def row(preset: str, coefficients: machine.Machine, load: MachineLoad) -> tuple[str, ...]:
    """Return the cells of COLUMNS of a preset.

    Args:
        coefficients: of the machine that generates.   load: of the one that reconstructs.
    """
    spec = load_scene("demo", preset)
    making = machine.predict(spec, coefficients)
    clip, effort = reconstruction_of(preset, spec)
    settings = ReconstructionSettings(spec.name, **asdict(effort))
    fitting_s = sum(Paces.known().expected_s(expected_parts(clip, settings), load).values())
    default = " (default)" if preset == ReconstructConfig.preset else ""
    return (
        f"`{preset}`",
        f"{spec.clip.frames}, {spec.domain.resolution}, {spec.render.percentage} %, {spec.render.samples}",
        duration(making.total_s),
        ", ".join(map(spaced, astuple(effort))) + default,
        duration(fitting_s),
        f"{making.memory_mb / 1000:.1f} GB; {expected_bytes(clip, settings) / GB:.1f} GB",
        scenes_in_words(preset),
        PURPOSES[preset],
    )


def spaced(number: int) -> str:
    """Return a whole number as pages write it: with spaces from 10 000 on."""
    return f"{number:,}".replace(",", " ") if number >= 10_000 else str(number)


def scenes_in_words(preset: str) -> str:
    """Return which scenes of the benchmark there are in this size, "-" where there is none."""
    sizes = read_record(SuiteList, FILE).sizes
    if preset not in sizes:
        return "-"
    scenes = sizes[preset].scenes
    return "all scenes" if scenes is None else f"{len(scenes)} scenes"


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    tyro.cli(PresetCosts, prog="python -m gof_benchmark.evidence.presets", args=argv)
    coefficients = machine.this_machine()
    load = replace(MachineLoad.measured_now(), crowded=1.0)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for preset in LADDER:
        print(f"| {' | '.join(row(preset, coefficients, load))} |")
    print(f"\ncalibration's own error: {100 * coefficients.error:.0f} %; {load.slow:.2f} times as slow as the models'")


if __name__ == "__main__":
    main()
