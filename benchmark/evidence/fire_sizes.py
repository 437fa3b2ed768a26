"""How fast our own solver's gas is at three sizes, as it was and as it follows the fire's size, beside McCaffrey's law.

    python -m gof_benchmark.evidence.fire_sizes

Takes about 3 min.

Each fire is baked twice, with `fire.speeds` "solver" and "physical"; nothing is rendered.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.host.processes import python_command
from gof_benchmark.fires import measures
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import vorticity
from gof_blender.pure.fires import Domain, Fire
from gof_blender.pure.rig import Rig
from gof_blender.pure.spec import SceneSpec
from gof_blender.pure.timing import Clip

SIZES = {
    "candle": (
        Fire("propane_low", "disc", (0, 0, 0.012), 0.006),
        Domain((-0.025, -0.025, 0), (0.05, 0.05, 0.1)),
        200,
        60,
    ),
    "campfire": (Fire("wood", "logs", (0, 0, 0.14), 0.25), Domain((-0.6, -0.6, 0), (1.2, 1.2, 1.8)), 50, 70),
    "pool": (Fire("gasoline", "disc", (0, 0, 0.35), 2.0), Domain((-5, -5, 0), (10, 10, 14)), 20, 50),
}
"""Burner, box, frames per second, and frames until the flame has developed."""
FRAMES = 24
SPEEDS = ("solver", "physical")
HEIGHTS = (0.15, 0.3, 0.5, 0.7, 1.0, 1.3)  # of the flame's


@dataclass(frozen=True)
class FireSizes:
    """Bake a candle, a campfire and a pool and print the speed of their gas."""

    resolution: int = 40
    """Cells along each box's longest side."""


def sized(name: str, resolution: int, speeds: str = "physical", light: str = "soot") -> SceneSpec:
    """Return one of SIZES as a spec, seen by a camera at two heights' distance."""
    fire, box, fps, warm_up = SIZES[name]
    tall = max(box.size)
    return SceneSpec(
        f"{name}_{speeds}",
        clip=Clip(FRAMES, float(fps), warm_up),
        domain=replace(box, resolution=resolution),
        fire=replace(fire, speeds=speeds, light=light),
        cameras=Rig(count=1, radius=2.1 * tall, height=0.45 * tall, look_at=(0, 0, 0.42 * tall)),
        background="ground",
        effects=(vorticity.Settings(),),
    )


def bake(spec: SceneSpec, folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (velocity (T, X, Y, Z, 3) m/s, flame (T, X, Y, Z), z (Z,) m above the burner) of a spec's frames.

    Baked and read in a Blender process of its own.
    """
    scene_spec.save(spec, folder / "spec.json")
    done = subprocess.run(
        python_command("-m", "gof_benchmark.evidence.fire_sizes", "--inside", str(folder)),
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    if not (folder / "grids.npz").is_file():
        raise RuntimeError(f"{spec.name} was not baked:\n{done.stderr[-2000:]}")
    with np.load(folder / "grids.npz") as grids:
        return grids["velocity"], grids["flame"], grids["height"]


def bake_inside(folder: Path) -> None:
    """In Blender: bake folder/spec.json and write folder/grids.npz."""
    from gof_blender.pure.layout import Layout
    from gof_blender.scene import mantaflow
    from gof_blender.scene.mantaflow_source import MantaflowSource
    from gof_blender.worker.generate import bake as bake_stage

    spec, layout = scene_spec.load(folder / "spec.json"), Layout(folder.resolve())
    layout.hidden.mkdir(exist_ok=True)
    os.chdir(layout.hidden)
    bake_stage(spec, layout, lambda done, total: None)
    source = MantaflowSource(replace(spec, fire=replace(spec.fire, light="reaction")))
    steps = [spec.timeline.blender_frame(frame) for frame in range(spec.clip.frames)]
    flame = [source.scalars(step)["flame"] for step in steps]
    velocity = [source.velocity(step) for step in steps]
    matrix = source.index_to_world
    height = matrix[2, 3] + matrix[2, 2] * (np.arange(flame[0].shape[2]) + 0.5) - spec.fire.burner.position[2]
    np.savez(layout.root / "grids.npz", velocity=np.array(velocity), flame=np.array(flame), height=height)
    mantaflow.leave()


def row(spec: SceneSpec, folder: Path) -> tuple[str, float]:
    """Return a line of the table, and the speed of the gas in the flame, m/s."""
    velocity, flame, height = bake(spec, folder)
    diameter = 2 * spec.fire.radius
    speed = np.linalg.norm(velocity, axis=-1)
    burning = np.median(speed[flame > 0.1]) if (flame > 0.1).any() else float("nan")
    tall = measures.flame_height(flame.max((1, 2)), height)
    middle = [side // 2 for side in flame.shape[1:3]]
    axis = velocity[:, middle[0] - 1 : middle[0] + 1, middle[1] - 1 : middle[1] + 1, :, 2].mean((0, 1, 2))
    heat = measures.heskestad_heat(max(tall, 1e-6), diameter)
    at = np.array(HEIGHTS) * tall
    over = np.interp(at, height, axis) / measures.mccaffrey_speed(at, heat)
    cut = " (leaves the box)" if tall > 0.97 * height[-1] else ""
    line = (
        f"| {spec.name} | {diameter:g} | {tall:.3g}{cut} | {burning:.2f} | {speed.max((1, 2, 3)).mean():.2f} | "
        + ", ".join(f"{ratio:.2f}" for ratio in over)
        + " |"
    )
    return line, float(burning)


def main(argv: list[str] | None = None) -> None:
    """Print a table of all bakes, and one of a line a size."""
    if argv is None and sys.argv[1:2] == ["--inside"]:
        bake_inside(Path(sys.argv[2]))
        return
    config = tyro.cli(FireSizes, prog="python -m gof_benchmark.evidence.fire_sizes", args=argv)
    print(
        f"| fire | burner, m | flame, m | gas in the flame, m/s | fastest, m/s | axis / McCaffrey at {HEIGHTS} of it |"
    )
    print("|---|---|---|---|---|---|")
    gas = {}
    for name in SIZES:
        for speeds in SPEEDS:
            with tempfile.TemporaryDirectory() as folder:
                line, gas[name, speeds] = row(sized(name, config.resolution, speeds), Path(folder))
            print(line, flush=True)
    print("\n| fire | burner, m | gas in the flame, m/s: `solver` | `physical` |\n|---|---|---|---|")
    for name, (fire, *_) in SIZES.items():
        print(f"| {name} | {2 * fire.radius:g} | {' | '.join(f'{gas[name, speeds]:.2f}' for speeds in SPEEDS)} |")


if __name__ == "__main__":
    main()
