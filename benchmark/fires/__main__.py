"""Make the benchmark's fires: `python -m gof_benchmark.fires WORK`; what there is: `--list`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from gof.core.errors import DataFormatError, GofError, MissingDependencyError
from gof.core.time_left import duration
from gof_benchmark.fires import SPLITS, BenchmarkFire, fires
from gof_benchmark.fires.making import make, predicted_s
from gof_benchmark.fires.twins import simulated, traits, traits_by_name, twins_table
from gof_benchmark.scenes import built_in_scenes, load_scene


@dataclass
class Make:
    """Make the fires that methods are developed on (dev) and scored on (test): datasets as `gof generate` makes them.

    Each becomes WORK/dev/NAME or WORK/test/NAME. Those of OpenFOAM are first solved into WORK/openfoam/FIRE/grids;
    where OpenFOAM is not installed they are left out, and named. Stopped at any time, the same command goes on where it
    was. On two free cores everything takes some three hours.
    """

    work: tyro.conf.Positional[Path | None] = None
    """Folder of all fires; made if it is not there."""
    split: Literal["dev", "test", "all"] = "all"
    """Which part."""
    list: bool = False
    """Only print what there is, and how far each test fire is from all that a method may be developed on."""


def inventory(listed: list[BenchmarkFire]) -> str:
    """Markdown: one line a fire, what burns and how it is seen."""
    lines = [
        "| fire | solver | fuel | burner | radius, m | jet, m/s | wind | eddies | cameras | frames | room |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for fire in listed:
        what, rig, clip = traits(fire), fire.spec.cameras, fire.spec.clip
        cells = (
            fire.name,
            what.solver,
            what.fuel,
            what.shape,
            f"{what.radius:.3f}",
            f"{what.jet:.2g}",
            f"{what.wind:g}",
            f"{what.eddies:g}, {what.flame_eddies:g}" if fire.foam is None else "its own",
            f"{rig.count} over {rig.arc_deg:g} deg, {'portrait' if rig.portrait else 'landscape'}",
            f"{clip.frames} at {clip.fps:g} Hz",
            fire.spec.background,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def seen_before(listed: list[BenchmarkFire]) -> dict:
    """Traits of all that a method may be developed on: the dev fires, and the built-in scenes."""
    scenes = {f"scenes/{name}": simulated(load_scene(name)) for name in built_in_scenes()}
    return traits_by_name([fire for fire in listed if fire.split == "dev"]) | scenes


def main(argv: list[str] | None = None) -> int:
    config = tyro.cli(Make, prog="python -m gof_benchmark.fires", args=argv)
    try:
        everything = [fire for split in SPLITS for fire in fires(split)]
        chosen = [fire for fire in everything if config.split in (fire.split, "all")]
        if config.list:
            tests = traits_by_name([fire for fire in everything if fire.split == "test"])
            print(inventory(chosen), twins_table(tests, seen_before(everything)), sep="\n\n")
            return 0
        if config.work is None:
            raise DataFormatError("name the folder of the fires: python -m gof_benchmark.fires WORK")
        return _make_all(chosen, config.work)
    except GofError as e:
        print(f"fires: {e}", file=sys.stderr)
        return 1


def _make_all(chosen: list[BenchmarkFire], work: Path) -> int:
    left_s = sum(predicted_s(fire.spec, fire.foam, work / fire.name, work) for fire in chosen)
    print(f"{len(chosen)} fires, about {duration(left_s)} left", flush=True)
    left_out = []
    for number, fire in enumerate(chosen, 1):
        print(f"[{number}/{len(chosen)}] {fire.name}", flush=True)
        try:
            make(fire.spec, fire.foam, work / fire.name, work)
        except MissingDependencyError as e:
            left_out.append(fire.name)
            print(f"left out: {e}", flush=True)
    if left_out:
        print(f"not made, because OpenFOAM is not installed: {', '.join(left_out)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
