"""All built-in scenes, a candle, a campfire and a pool in one picture: as published, and at the looks of today.

    python -m gof_benchmark.evidence.looks_sheet --work WORK --out docs/figures/looks_sheet.webp

Takes about 8 min.

A row is a way to shine (`fire.light`), a column a fire; the pictures are of the first frame. More frames, at a rate,
are for the flicker that `flame_looks` measures. Bakes and pictures that lie in the work folder are not made again.
Beside each picture's name it prints how the flame is exposed, and what a picture cost.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof_benchmark.evidence import contact_sheet, fire_sizes
from gof_benchmark.generator.blender_process import Renderer, run_stage
from gof_benchmark.scenes import built_in_scenes, claim, load_scene
from gof_blender.pure.effects import fine_noise
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

ROWS: dict[str, Callable[[SceneSpec], SceneSpec]] = {
    "published": lambda spec: with_light(spec, "reaction", "solver"),
    "soot": lambda spec: with_light(spec, "soot", "physical"),
    "sheets": lambda spec: with_light(spec, "sheets", "physical"),
    "soot_noise": lambda spec: with_noise(with_light(spec, "soot", "physical")),
    "sheets_noise": lambda spec: with_noise(with_light(spec, "sheets", "physical")),
}
"""Versions 1, 2 and 3 of the spec by default; the last two also with the effect `fine_noise`."""


@dataclass(frozen=True)
class LooksSheet:
    """Bake and render every scene in every light, and put their first frames into one picture."""

    work: Path
    """Folder of the datasets; what is there is used."""
    out: Path
    """Picture to write (.webp, .jpg, .png)."""
    resolution: int = 48
    """Cells along each box's longest side."""
    percentage: int = 17
    """For 720 x 1280 pixels."""
    samples: int = 16
    """Cycles samples a pixel."""
    fires: tuple[str, ...] = ()
    """Names of those to make; all without any."""
    lights: tuple[str, ...] = ("published", "soot", "sheets")
    """Rows of the sheet, names in `ROWS`."""
    frames: int = 1
    """For each clip."""
    rate_hz: float | None = None
    """For the frames; each fire's own without."""


def main(argv: list[str] | None = None) -> None:
    """Make what is missing, print a table, write the sheet."""
    config = tyro.cli(LooksSheet, prog="python -m gof_benchmark.evidence.looks_sheet", args=argv)
    fires = {name: fire_sizes.sized(name, config.resolution) for name in fire_sizes.SIZES}
    fires |= {name: load_scene(name) for name in built_in_scenes()}
    fires = {name: fires[name] for name in config.fires or fires}
    print("| fire | light | clipped | black | bake, CPU s | picture, CPU s |", "|---|---|---|---|---|---|", sep="\n")
    rows = []
    for light in config.lights:
        specs = {name: ROWS[light](small(spec, config)) for name, spec in fires.items()}
        rows.append([picture(light, name, spec, config.work / f"{name}_{light}") for name, spec in specs.items()])
    contact_sheet.compose(rows, config.out)


def with_light(spec: SceneSpec, light: str, speeds: str) -> SceneSpec:
    return replace(spec, fire=replace(spec.fire, light=light, speeds=speeds))


def with_noise(spec: SceneSpec) -> SceneSpec:
    return replace(spec, effects=(*spec.effects, fine_noise.Settings()))


def small(spec: SceneSpec, config: LooksSheet) -> SceneSpec:
    """Return the first frames after the warm-up, seen by one camera from the middle of the arc."""
    rate = config.rate_hz or spec.clip.fps
    warm_up = round(spec.clip.warm_up_frames * rate / spec.clip.fps)
    return replace(
        spec,
        clip=replace(spec.clip, frames=config.frames, fps=rate, warm_up_frames=warm_up),
        domain=replace(spec.domain, resolution=config.resolution),
        cameras=replace(spec.cameras, count=1, eval_count=0, sensor_px=(1280, 720), roll_deg=90),
        render=replace(spec.render, percentage=config.percentage, samples=config.samples, plate_samples=config.samples),
    )


def picture(light: str, name: str, spec: SceneSpec, folder: Path) -> Path:
    """Return the display picture of a spec's first frame; a line of the table is printed."""
    layout = Layout(folder.resolve())
    claim(layout, spec)
    baked = "-" if layout.bake_marker.is_file() else f"{run_stage('bake', layout.root).cpu_s:.0f}"
    made = [layout.frame(spec.cameras.names[0], frame) for frame in range(spec.clip.frames)]
    missing = [frame for frame, files in enumerate(made) if not files.exr.is_file()]
    costs = [Renderer.render(layout.root, frame, 0).cpu_s for frame in missing]
    Renderer.close(layout.root)
    rendered = f"{np.median(costs):.1f}" if costs else "-"
    seen = json.loads(layout.brightness.read_text())
    print(f"| {name} | {light} | {seen['clipped']:.2f} | {seen['black']:.2f} | {baked} | {rendered} |", flush=True)
    return made[0].rgb


if __name__ == "__main__":
    main()
