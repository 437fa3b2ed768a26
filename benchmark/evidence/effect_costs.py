"""The cost of each effect: CPU seconds per solver step and per picture, memory and disk, measured one by one.

    python -m gof_benchmark.evidence.effect_costs [--out out/effect_costs]

Takes about 5 min.

CPU seconds rather than wall seconds, so that a busy machine changes little.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core.files import atomic_path, read_json, write_json
from gof_benchmark.generator.blender_process import Renderer, run_stage
from gof_benchmark.scenes import claim, load_scene
from gof_blender.pure import effects
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

NONE = "(none)"
OPTIONS = {"obstacles": {}, "smoke": {"amount": 0.5}}
FRAMES = 4
WARM_UP = 20
RESOLUTION = 48
PERCENTAGE = 20


@dataclass(frozen=True)
class EffectCosts:
    """Make a tiny dataset with each effect alone, and one with none, and compare what they cost."""

    out: Path = Path("out/effect_costs")
    """Folder for the runs and effect_costs.md; what is finished there is not made again."""


@dataclass(frozen=True)
class EffectCost:
    """One small run; the picture is the median of those after the first, which loads the scene."""

    effect: str
    steps_per_frame: int
    bake_cpu_s: float
    bake_mb: float
    picture_cpu_s: float
    codec_cpu_s: float
    cache_mb: float


def main(argv: list[str] | None = None) -> None:
    """Print the table, and write it."""
    config = tyro.cli(EffectCosts, prog="python -m gof_benchmark.evidence.effect_costs", args=argv)
    none, *others = [measure(name, config.out) for name in (None, *effects.names())]
    lines = [
        "| effect | solver steps per frame | bake, CPU s | memory, MB | CPU s per picture | codec, CPU s | cache, MB |",
        "|---|---|---|---|---|---|---|",
        _line(none, ""),
        *(_line(row, f" ({row.bake_cpu_s - none.bake_cpu_s:+.1f})") for row in others),
    ]
    with atomic_path(config.out / "effect_costs.md") as path:
        path.write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


def _line(row: EffectCost, more: str) -> str:
    return (
        f"| {row.effect} | {row.steps_per_frame} | {row.bake_cpu_s:.1f}{more} | {row.bake_mb:.0f} | "
        f"{row.picture_cpu_s:.2f} | {row.codec_cpu_s:.1f} | {row.cache_mb:.1f} |"
    )


def measure(name: str | None, folder: Path) -> EffectCost:
    """Return one small run with one effect, or with none; kept and not repeated."""
    result = folder / f"{name or 'none'}.json"
    if not result.exists():
        spec = small_spec(name)
        write_json(result, asdict(run(spec, Layout((folder / (name or "none")).resolve()), name or NONE)))
    return EffectCost(**read_json(result))


def small_spec(name: str | None) -> SceneSpec:
    """Return the demo's fire, coarse and short, seen by one camera, with this effect alone."""
    base = load_scene("demo")
    return replace(
        base,
        name="effect",
        effects=(effects.module(name).Settings(**OPTIONS.get(name, {})),) if name else (),
        clip=replace(base.clip, frames=FRAMES, warm_up_frames=WARM_UP),
        domain=replace(base.domain, resolution=RESOLUTION),
        cameras=replace(base.cameras, count=1),
        render=replace(base.render, percentage=PERCENTAGE),
    )


def run(spec: SceneSpec, layout: Layout, effect: str) -> EffectCost:
    """Bake, render, and pass the pictures through a codec if the effect is one."""
    claim(layout, spec)
    bake = run_stage("bake", layout.root)
    pictures = [Renderer.render(layout.root, frame, 0) for frame in range(FRAMES)]
    Renderer.close(layout.root)
    encodes = any(map(effects.encodes, spec.effects))
    return EffectCost(
        effect=effect,
        steps_per_frame=spec.timeline.steps_per_frame,
        bake_cpu_s=bake.cpu_s,
        bake_mb=bake.peak_mb,
        picture_cpu_s=float(np.median([picture.cpu_s for picture in pictures[1:]])),
        codec_cpu_s=run_stage("video", layout.root).cpu_s if encodes else 0.0,
        cache_mb=sum(path.stat().st_size for path in layout.bake.rglob("*") if path.is_file()) / 2**20,
    )


if __name__ == "__main__":
    main()
