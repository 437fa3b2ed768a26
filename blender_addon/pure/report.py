"""The page of a finished dataset: pictures of every camera, what it holds, and what each stage cost. Never imports bpy."""

from __future__ import annotations

import json
import os
from html import escape

from .layout import Layout

SHOWN = 4  # frames per camera

PAGE = """<!doctype html>
<meta charset="utf-8"><title>{name}</title>
<style>
body {{ font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 70em; background: #16181c; color: #ddd }}
table {{ border-collapse: collapse }} td, th {{ padding: .2em .8em; text-align: left; border-bottom: 1px solid #333 }}
img {{ height: 15em; margin: 2px }} code {{ color: #fb8 }}
</style>
<h1>{name}</h1>
<p>{summary}</p>
{pictures}
<h2>What it cost</h2>
<table><tr><th>stage<th>seconds<th>peak memory, MB</tr>{costs}</table>
<h2>What it holds</h2>
<table>{files}</table>
"""


def write(layout: Layout) -> None:
    """Write the page of a dataset whose dataset.json is there; pictures are those of the dataset, not copies."""
    data = json.loads(layout.description.read_text(encoding="utf-8"))
    stages = json.loads(layout.costs.read_text(encoding="utf-8"))["stages"] if layout.costs.is_file() else []
    spec, times, cameras = data["spec"], data["time_s"], data["cameras"]
    effects = ", ".join(data["effects"]) or "none"
    summary = (
        f"{escape(spec['fire']['fuel'].replace('_', ' '))} in {escape(spec['background'].replace('_', ' '))}; effects: {escape(effects)}. "
        f"{len(times)} frames at {spec['clip']['fps']:g} per second, {len(cameras)} cameras of {cameras[0]['width']} x {cameras[0]['height']} "
        f"pixels, velocity on {' x '.join(map(str, data['domain']['resolution']))} cells of {1000 * data['domain']['voxel_size']:.1f} mm."
    )
    frames = sorted({round(k * (len(times) - 1) / max(SHOWN - 1, 1)) for k in range(SHOWN)})
    files = {
        "dataset.json": "cameras, clock, splits; opened by <code>gof.dataset.Dataset.open</code>",
        "cameras/": "pictures, flame masks, linear EXR with depth and the flame alone",
        "static/": "the same views without the fire",
        "velocity.zarr": "velocity of the gas in m/s at every frame",
        "scene.blend": "the scene itself",
        "spec.json": "how it was made: <code>gof generate spec.json --out DIR</code> makes it again",
        ".cache/": "logs and the solver's cache; may be deleted",
    }
    page = PAGE.format(
        name=escape(data["name"]),
        summary=summary,
        pictures="\n".join(_row(camera, frames, times) for camera in cameras),
        costs="".join(f"<tr><td>{escape(s['name'])}<td>{s['seconds']:.1f}<td>{s['peak_mb']:.0f}</tr>" for s in stages),
        files="".join(f"<tr><td><code>{name}</code><td>{text}</tr>" for name, text in files.items()),
    )
    draft = layout.report.with_name(f".tmp-{layout.report.name}")
    draft.write_text(page, encoding="utf-8")
    os.replace(draft, layout.report)


def _row(camera: dict, frames: list[int], times: list[float]) -> str:
    images = [(camera["static"], "without fire")] + [
        (camera["rgb"].format(frame=k), f"{times[k]:.3f} s") for k in frames
    ]
    pictures = "".join(f'<img src="{escape(path)}" title="{text}" alt="{text}">' for path, text in images)
    return f"<h2>{escape(camera['name'])}{' (evaluation)' if camera['role'] == 'eval' else ''}</h2><p>{pictures}</p>"
