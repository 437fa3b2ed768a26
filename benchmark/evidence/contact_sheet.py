"""A scene at a glance: its cameras (rows) at five times (columns), from a dataset or from just the pictures it needs.

    python -m gof_benchmark.evidence.contact_sheet SCENE --work WORK --out PICTURE

Takes about 10 min a scene.

The sheets of the built-in scenes lie beside their specs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from gof_benchmark.generator.blender_process import Renderer, run_stage
from gof_benchmark.scenes import claim, load_scene
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

TIMES = 5


@dataclass(frozen=True)
class ContactSheet:
    """Put pictures of a scene into one: cameras below each other, times side by side."""

    scene: tyro.conf.Positional[str]
    """Built-in scene or spec file."""
    work: Path
    """Dataset folder to use or to begin."""
    out: Path
    """Picture to write."""


def main(argv: list[str] | None = None) -> None:
    """Write the sheet."""
    config = tyro.cli(ContactSheet, prog="python -m gof_benchmark.evidence.contact_sheet", args=argv)
    make(load_scene(config.scene), Layout(config.work.resolve()), config.out)


def make(spec: SceneSpec, layout: Layout, out: Path) -> None:
    """Simulate and render what is missing in `layout` and write the sheet."""
    claim(layout, spec)
    run_stage("bake", layout.root)
    frames = [round((index + 0.5) * spec.clip.frames / TIMES) for index in range(TIMES)]
    cameras = range(spec.cameras.count)
    for frame in frames:
        for camera in cameras:
            Renderer.render(layout.root, frame, camera)
    Renderer.close(layout.root)
    compose([[layout.frame(spec.cameras.names[camera], frame).rgb for frame in frames] for camera in cameras], out)


def compose(rows: list[list[Path]], out: Path, gap: int = 4) -> None:
    """Put pictures of one size into a table."""
    from PIL import Image

    pictures = [[Image.open(path).convert("RGB") for path in row] for row in rows]
    width, height = pictures[0][0].size
    sheet = Image.new("RGB", (len(rows[0]) * (width + gap) - gap, len(rows) * (height + gap) - gap), "white")
    for y, row in enumerate(pictures):
        for x, picture in enumerate(row):
            sheet.paste(picture, (x * (width + gap), y * (height + gap)))
    out.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(out, quality=88)


if __name__ == "__main__":
    main()
