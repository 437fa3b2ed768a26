"""Where the demo's flame draws its air from: the gas' speed on the axis, with all sides open and with a floor.

    python -m gof_benchmark.evidence.gas_from_below

Takes about 2 min.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof_benchmark.commands import generate
from gof_benchmark.fires.flames import flame_of
from gof_benchmark.fires.how_real import laws, seen
from gof_benchmark.scenes import load_scene
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import floor
from gof_blender.pure.spec import SceneSpec

FRAMES = 120
HEIGHTS_M = (-0.10, -0.05, 0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7)


@dataclass
class GasFromBelow:
    """Bake the demo twice, with its open bottom and with the effect `floor`, and print the mean speed on the axis.

    Coarser than the demo (48 cells along the longest side), longer (1.2 s), and with tiny pictures.
    """

    resolution: int = 48
    """Cells along the longest side."""


def small_demo(resolution: int) -> SceneSpec:
    """Return the demo with one camera and tiny pictures."""
    demo = load_scene("demo")
    return replace(
        demo,
        clip=replace(demo.clip, frames=FRAMES),
        domain=replace(demo.domain, resolution=resolution),
        cameras=replace(demo.cameras, count=1),
        render=replace(demo.render, percentage=6, samples=1, plate_samples=1),
        background="studio",
    )


def measured(spec: SceneSpec, folder: Path) -> tuple[np.ndarray, str]:
    """Return (speeds m/s at HEIGHTS_M above the burner, what the laws say of the fire) of a spec."""
    scene_spec.save(spec, folder / f"{spec.name}.json")
    generate.main([str(folder / f"{spec.name}.json"), "--out", str(folder / spec.name)])
    flame = flame_of(folder / spec.name)
    figures, axis = laws(flame.truth, height := seen(flame).height), flame.truth.axis
    words = (
        f"{spec.name}: flame {height:.2f} m, speed over McCaffrey's {figures.rise_ratio:.2f}, "
        f"exponent {figures.rise_exponent:.2f} (0.5), intermittent zone {figures.plateau_ratio:.2f}"
    )
    return np.interp(HEIGHTS_M, axis.height_m, axis.speed_m_s), words


def main(argv: list[str] | None = None) -> None:
    """Bake and print."""
    config = tyro.cli(GasFromBelow, prog="python -m gof_benchmark.evidence.gas_from_below", args=argv)
    demo = replace(small_demo(config.resolution), name="open")
    with tempfile.TemporaryDirectory() as folder:
        as_it_is, first = measured(demo, Path(folder))
        closed = replace(demo, name="floor", effects=(*demo.effects, floor.Settings()))
        with_floor, second = measured(closed, Path(folder))
    print(first, second, "", sep="\n")
    print("| height above the burner, m | open, m/s | floor, m/s |", "|---|---|---|", sep="\n")
    for row in zip(HEIGHTS_M, as_it_is, with_floor, strict=True):
        print("| {:.2f} | {:.2f} | {:.2f} |".format(*row))


if __name__ == "__main__":
    main()
