"""What each effect adds: processor seconds per solver step and per picture, memory and disk, measured one by one.

    python -m gof_benchmark.evidence.effect_costs --out out/effect_costs

Processor seconds rather than wall seconds, so that a busy machine changes little.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from gof.io.files import atomic_path, read_json, write_json
from gof_benchmark.commands.generate import claim, load_scene
from gof_benchmark.generator.blender_process import Renderer, run_stage
from gof_blender.pure import effects
from gof_blender.pure.layout import Layout

OPTIONS = {"obstacles": {}, "smoke": {"amount": 0.5}}
FRAMES, WARM_UP, RESOLUTION, PERCENTAGE = 4, 20, 48, 20


def measure(name: str | None, folder: Path) -> dict:
    """One small run with one effect, or with none; kept and not repeated."""
    result = folder / f"{name or 'none'}.json"
    if result.exists():
        return read_json(result)
    base = load_scene("demo")
    listed = (effects.module(name).Settings(**OPTIONS.get(name, {})),) if name else ()
    spec = replace(
        base,
        name="effect",
        effects=listed,
        clip=replace(base.clip, frames=FRAMES, warm_up_frames=WARM_UP),
        domain=replace(base.domain, resolution=RESOLUTION),
        cameras=replace(base.cameras, count=1),
        render=replace(base.render, percentage=PERCENTAGE),
    )
    layout = Layout((folder / (name or "none")).resolve())
    claim(layout, spec)
    bake = run_stage("bake", layout.root)
    pictures = [Renderer.render(layout.root, frame, 0) for frame in range(FRAMES)]
    Renderer.close(layout.root)
    video = run_stage("video", layout.root)["cpu_s"] if any(map(effects.encodes, listed)) else 0.0
    figures = {
        "effect": name or "(none)",
        "steps_per_frame": spec.steps_per_frame,
        "bake_cpu_s": bake["cpu_s"],
        "bake_mb": bake["peak_mb"],
        "picture_cpu_s": float(np.median([p["cpu_s"] for p in pictures[1:]])),
        "codec_cpu_s": video,
        "cache_mb": sum(path.stat().st_size for path in layout.bake.rglob("*") if path.is_file()) / 2**20,
    }
    write_json(result, figures)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/effect_costs"))
    out = parser.parse_args().out
    rows = [measure(name, out) for name in (None, *effects.names())]
    none = rows[0]
    lines = [
        "| effect | solver steps per frame | bake, CPU s | memory, MB | CPU s per picture | codec, CPU s | cache, MB |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        more = "" if row is none else f" ({row['bake_cpu_s'] - none['bake_cpu_s']:+.1f})"
        lines.append(
            f"| {row['effect']} | {row['steps_per_frame']} | {row['bake_cpu_s']:.1f}{more} | {row['bake_mb']:.0f} | "
            f"{row['picture_cpu_s']:.2f} | {row['codec_cpu_s']:.1f} | {row['cache_mb']:.1f} |"
        )
    with atomic_path(out / "effect_costs.md") as path:
        path.write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
