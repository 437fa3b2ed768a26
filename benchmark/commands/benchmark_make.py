"""`gof benchmark make`: the scenes of a size, and whether their truth is the recorded one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.core.errors import MissingDependencyError
from gof.core.time_left import duration
from gof.dataset import Dataset
from gof.host.terminal import console
from gof_benchmark.fires.making import make, predicted_s
from gof_benchmark.suite import Size, choose
from gof_benchmark.suite.made import compare

SIGNS = {"same": "✓", "not to the bit": "?", "unknown": "?"}


@dataclass
class MakeConfig:
    """Make the scenes of GoF-Bench 2 in a size, as WORK/SIZE/SCENE, and compare their truth with the recorded one.

    Examples:
      gof benchmark make bench --size preview

    Stopped at any time, the same command goes on where it was. Fires of OpenFOAM are first solved into
    WORK/openfoam/FIRE/grids; where OpenFOAM is not installed they are left out, and named.
    """

    work: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="WORK")]]
    """Folder of everything; made if it is not there."""
    size: Size = "preview"
    """preview: minutes; standard: hours; full: a cluster."""
    scenes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="dev|test|NAME")] = ()
    """Only these, or the part for development, or that for scores; default: all."""


def main(argv: list[str]) -> int:
    """Run `gof benchmark make`; 1 where a scene could not be made."""
    config = read_options(MakeConfig, "benchmark make", argv)
    chosen = choose(config.size, config.scenes)
    out, left_out, found = console(), [], {}
    folders = {scene.name: config.work / config.size / scene.name for scene in chosen}
    left_s = sum(predicted_s(scene.spec, scene.foam, folders[scene.name], config.work) for scene in chosen)
    out.print(f"{len(chosen)} scenes, about {duration(left_s)} left")
    for number, scene in enumerate(chosen, 1):
        out.print(f"[{number}/{len(chosen)}] {scene.name}", markup=False)
        try:
            make(scene.spec, scene.foam, folders[scene.name], config.work)
        except MissingDependencyError as e:
            left_out.append(scene.name)
            out.print(f"left out: {e}", markup=False)
            continue
        verdict, said = compare(scene, config.size, Dataset.open(folders[scene.name]))
        found[scene.name] = {"truth": verdict, "said": said}
        out.print(f"{SIGNS[verdict]} {scene.name}: {said}", markup=False, highlight=False)
    write_figures({"size": config.size, "scenes": found, "left_out": left_out})
    if left_out:
        out.print(f"not made, because OpenFOAM is not installed: {', '.join(left_out)}")
    return 1 if left_out else 0
