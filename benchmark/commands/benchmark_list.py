"""`gof benchmark list`: the scenes of the suite."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.core.time_left import duration
from gof.host.terminal import console
from gof_benchmark.suite import Size, SuiteScene, choose, suite_name
from gof_blender.pure.cost_model import predict_here

WHOLE = ("scene", "split", "solver", "picture", "spec")  # columns that are not folded in a narrow window


@dataclass
class ListConfig:
    """List the scenes of GoF-Bench 2: fire, cameras, and what each costs to make.

    Examples:
      gof benchmark list --size preview
    """

    size: Size = "standard"
    """preview: minutes; standard: hours; full: a cluster."""
    scenes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="dev|test|NAME")] = ()
    """Only these, or dev: for choosing and tuning, or test: scored only; default: all."""


@dataclass(frozen=True)
class Line:
    """A scene in words."""

    scene: str
    split: str
    fire: str
    solver: str
    cameras: str
    picture: str
    frames: str
    surroundings: str
    spec: str

    @classmethod
    def of(cls, scene: SuiteScene) -> Line:
        rig, clip = scene.spec.cameras, scene.spec.clip
        across, up = scene.spec.picture_px if rig.roll_deg % 180 == 0 else scene.spec.picture_px[::-1]
        return cls(
            scene=scene.name,
            split=scene.split,
            fire=scene.fire,
            solver=scene.solver,
            cameras=f"{rig.count} over {rig.arc_deg:g} deg",
            picture=f"{across}x{up}",
            frames=f"{clip.frames} at {clip.fps:g} Hz",
            surroundings=scene.spec.background,
            spec=scene.digest[:12],
        )


def main(argv: list[str]) -> int:
    """Run `gof benchmark list`."""
    config = read_options(ListConfig, "benchmark list", argv)
    scenes = choose(config.size, config.scenes)
    lines = [asdict(Line.of(scene)) for scene in scenes]
    table = Table(title=f"{suite_name()}, {config.size}", title_justify="left", box=SIMPLE_HEAD, padding=0)
    for heading in Line.__dataclass_fields__:
        table.add_column(heading, no_wrap=heading in WHOLE, overflow="fold")
    for line in lines:
        table.add_row(*line.values())
    out = console()
    out.print(table)
    ours = [scene.spec for scene in scenes if scene.foam is None]
    seconds = sum(predict_here(spec).total_s for spec in ours)
    out.print(
        f"about {duration(seconds)} for those that Mantaflow makes; OpenFOAM's take half an hour of one core each"
    )
    write_figures({"suite": suite_name(), "size": config.size, "scenes": lines})
    return 0
