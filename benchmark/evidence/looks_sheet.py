"""All built-in scenes, a candle, a campfire and a pool in one picture: as published, and at the looks of today.

    python -m gof_benchmark.evidence.looks_sheet --work out/looks --out docs/figures/looks_sheet.webp

A row is a way to shine (`fire.light`), a column a fire. Bakes and pictures that lie in the work folder are not made
again. Beside each picture's name it prints how the flame is exposed, and what the picture cost.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from gof_benchmark.evidence import contact_sheet, fire_sizes
from gof_benchmark.generator.blender_process import Renderer, run_stage
from gof_benchmark.scenes import built_in_scenes, claim, load_scene
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

ROWS: dict[str, Callable[[SceneSpec], SceneSpec]] = {
    "published": lambda spec: with_light(spec, "reaction", "solver"),
    "soot": lambda spec: with_light(spec, "soot", "physical"),
    "sheets": lambda spec: with_light(spec, "sheets", "physical"),
}
"""Version 1 of the spec, the defaults of version 2, and its other light."""


@dataclass(frozen=True)
class LooksSheet:
    """Bake and render one frame of every scene in every light, and put them into one picture."""

    work: Path
    """Folder of the datasets; what is there is used."""
    out: Path
    """Picture to write (.webp, .jpg, .png)."""
    resolution: int = 48
    """Cells along each box's longest side."""
    percentage: int = 17
    """Of 720 x 1280 pixels."""
    samples: int = 16
    """Cycles samples a pixel."""


def main(argv: list[str] | None = None) -> None:
    """Make what is missing, print a table, write the sheet."""
    config = tyro.cli(LooksSheet, prog="python -m gof_benchmark.evidence.looks_sheet", args=argv)
    fires = {name: fire_sizes.sized(name, config.resolution) for name in fire_sizes.SIZES}
    fires |= {name: load_scene(name) for name in built_in_scenes()}
    print("| fire | light | clipped | black | bake, CPU s | picture, CPU s |", "|---|---|---|---|---|---|", sep="\n")
    rows = []
    for light, change in ROWS.items():
        specs = {name: change(small(spec, config)) for name, spec in fires.items()}
        rows.append([picture(light, name, spec, config.work / f"{name}_{light}") for name, spec in specs.items()])
    contact_sheet.compose(rows, config.out)


def with_light(spec: SceneSpec, light: str, speeds: str) -> SceneSpec:
    return replace(spec, fire=replace(spec.fire, light=light, speeds=speeds))


def small(spec: SceneSpec, config: LooksSheet) -> SceneSpec:
    """The first frame after the warm-up, seen by one camera from the middle of the arc."""
    return replace(
        spec,
        clip=replace(spec.clip, frames=1),
        domain=replace(spec.domain, resolution=config.resolution),
        cameras=replace(spec.cameras, count=1, eval_count=0, sensor_px=(1280, 720), roll_deg=90),
        render=replace(spec.render, percentage=config.percentage, samples=config.samples, plate_samples=config.samples),
    )


def picture(light: str, name: str, spec: SceneSpec, folder: Path) -> Path:
    """The display picture of a spec's first frame; a line of the table is printed."""
    layout = Layout(folder.resolve())
    claim(layout, spec)
    baked = "-" if layout.bake_marker.is_file() else f"{run_stage('bake', layout.root).cpu_s:.0f}"
    made = layout.frame(spec.cameras.names[0], 0)
    rendered = "-"
    if not made.exr.is_file():
        rendered = f"{Renderer.render(layout.root, 0, 0).cpu_s:.1f}"
        Renderer.close(layout.root)
    seen = json.loads(layout.brightness.read_text())
    print(f"| {name} | {light} | {seen['clipped']:.2f} | {seen['black']:.2f} | {baked} | {rendered} |", flush=True)
    return made.rgb


if __name__ == "__main__":
    main()
