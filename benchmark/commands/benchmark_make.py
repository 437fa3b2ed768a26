"""`gof benchmark make`: the scenes of a size, and whether their truth is the recorded one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gof.core.errors import MissingDependencyError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.host.terminal import console
from gof_benchmark.fires.making import make, predicted_s
from gof_benchmark.suite import Size, pick, scenes_of
from gof_benchmark.suite.truths import compare
from gof_blender.pure.cost_model import duration

SIGNS = {"same": "✓", "not to the bit": "?", "unknown": "?"}


@dataclass
class MakeConfig:
    """Make the scenes of GoF-Bench 1 in a size, as WORK/SIZE/SCENE, and compare their truth with the recorded one.

    Stopped at any time, the same command goes on where it was. Fires of OpenFOAM are first solved into
    WORK/openfoam/FIRE/grids; where OpenFOAM is not installed they are left out, and named.
    """

    work: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="WORK")]]
    """Folder of everything; made if it is not there."""
    size: Size = "smoke"
    """smoke: minutes; standard: hours; paper: a cluster."""
    split: Literal["dev", "test", "all"] = "all"
    """Which part."""
    scenes: tuple[str, ...] = field(default=())
    """Only these."""
    json: Path | None = None
    """Also write what was found about each scene's truth to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof benchmark make`; 1 where a scene could not be made."""
    config = tyro.cli(MakeConfig, prog="gof benchmark make", args=argv)
    chosen = pick(scenes_of(config.size, config.split), config.scenes)
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
    if config.json is not None:
        write_json(config.json, {"size": config.size, "scenes": found, "left_out": left_out})
    if left_out:
        out.print(f"not made, because OpenFOAM is not installed: {', '.join(left_out)}")
    return 1 if left_out else 0
