"""The page of a finished dataset: pictures of every camera, what it holds, and what each stage cost."""

from __future__ import annotations

from html import escape

from ..core.costs import StageCost, StageLog
from ..core.description import CameraEntry, DatasetDescription
from ..core.files import read_json, write_text
from .brightness import Brightness
from .layout import Layout
from .spec import SceneSpec

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


FILES = {
    "dataset.json": "cameras, clock, splits; opened by <code>gof.dataset.Dataset.open</code>",
    "cameras/": "pictures, flame masks, linear EXR with depth and the flame alone",
    "static/": "the same views without the fire",
    "velocity.zarr": "velocity of the gas in m/s at every frame",
    "scene.blend": "the scene itself",
    "spec.json": "how it was made: <code>gof generate spec.json --out DIR</code> makes it again",
    ".cache/": "logs and the solver's cache; may be deleted",
}


def write(layout: Layout) -> None:
    """Write the page of a finished dataset; pictures are those of the dataset, not copies."""
    dataset, stages = DatasetDescription.read(layout.root), StageLog(layout.costs).stages()
    times = dataset.time_s
    shown = sorted({round(k * (len(times) - 1) / max(SHOWN - 1, 1)) for k in range(SHOWN)})
    page = PAGE.format(
        name=escape(dataset.name),
        summary=_summary(dataset, layout, stages),
        pictures="\n".join(_row(camera, shown, times) for camera in dataset.cameras),
        costs="".join(f"<tr><td>{escape(s.name)}<td>{s.seconds:.1f}<td>{s.peak_mb:.0f}</tr>" for s in stages),
        files="".join(f"<tr><td><code>{name}</code><td>{text}</tr>" for name, text in FILES.items()),
    )
    write_text(layout.report, page)


def _summary(dataset: DatasetDescription, layout: Layout, stages: tuple[StageCost, ...]) -> str:
    spec, first = SceneSpec.from_dict(dataset.spec), dataset.cameras[0]
    store = read_json(layout.velocity / "zarr.json")
    cells = " x ".join(map(str, store["shape"][1:4]))
    effects = ", ".join(dataset.effects) or "none"
    fire = dataset.provenance.get("fire")  # of another solver
    burns = f"{fire['name']} ({fire['solver']})" if fire else spec.fire.title
    exposed = next((cost.settings["brightness"] for cost in stages if "brightness" in cost.settings), None)
    flame = f" {str(Brightness(**exposed)).capitalize()}." if exposed else ""
    return (
        f"{escape(burns)} in {escape(spec.background.replace('_', ' '))}; "
        f"effects: {escape(effects)}. {len(dataset.time_s)} frames at {spec.clip.fps:g} per second, "
        f"{len(dataset.cameras)} cameras of {first.width} x {first.height} pixels, "
        f"velocity on {cells} cells of {1000 * store['attributes']['voxel_size']:.1f} mm.{flame}"
    )


def _row(camera: CameraEntry, frames: list[int], times: tuple[float, ...]) -> str:
    images = [(camera.static, "without fire")] + [(camera.rgb.format(frame=k), f"{times[k]:.3f} s") for k in frames]
    pictures = "".join(f'<img src="{escape(path)}" title="{text}" alt="{text}">' for path, text in images)
    return f"<h2>{escape(camera.name)}{' (evaluation)' if camera.role == 'eval' else ''}</h2><p>{pictures}</p>"
