"""`gof share`: results as one HTML file that plays from the disk and asks nothing of the network.

The page's own code lies in `player/`: `unpack.js` turns the columns of `quantise.py` into numbers, `sort.js` orders
them in a worker, `draw.js` and the shaders draw, `view.js` turns the camera, `player.js` is what people touch.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import gof
from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.files import atomic_path
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.look import legend
from gof.look import switches as controls
from gof.look.player.agreement import Agreement, measure
from gof.look.player.opened import Opened, middle_of, time_span
from gof.look.player.quantise import Packed, pack, unpack
from gof.look.player.recorded import PLATE_QUALITY, PLATE_SIDE, base64_text, frames_within, webp
from gof.look.player.truth import true_velocity

PLAYER = Path(__file__).parent
SCRIPTS = ("unpack.js", "view.js", "draw.js", "pictures.js", "player.js")
SHADERS = [f"{name}.{kind}.glsl" for name in ("splat", "line", "pane") for kind in ("vert", "frag")]
FILLED = 0.65  # of the picture's height, by the flame, where no dataset has a camera
CHECKED = 3  # cameras, and times, at which quantisation is measured


@dataclass(frozen=True)
class Shared:
    """What was written: its size, that of the Gaussians in it (base64), and what quantising cost each result."""

    path: Path
    bytes: int
    gaussian_bytes: list[int]
    agreement: list[Agreement]
    notes: list[str]


def share_page(
    results: list[Opened],
    out: Path,
    dataset: Dataset | None = None,
    title: str | None = None,
    pictures_mb: float = 2.0,
    progress: Callable[..., None] | None = None,
) -> Shared:
    """Write the page.

    Args:
        results: what to show, side by side, on one clock and in one world.
        out: the file; an older one is replaced.
        dataset: its cameras, plates, recorded frames and, where it is known, the true velocity.
        title: default: the dataset's name, or the first result's.
        pictures_mb: at most so much of recorded pictures; 0 = none.
    Raises:
        GofError: two results of one name.   DataFormatError: a picture cannot be read.
    """
    names = [result.name for result in results]
    if len(set(names)) < len(names):
        raise GofError(f"two results are called {names}; give each a name of its own: NAME=RESULT")
    progress = progress or (lambda *a, **k: None)
    results = _measured_alike(results, dataset)
    first_s, last_s = _span(results, dataset)
    middle, reach = middle_of(results[0].gaussians, (first_s + last_s) / 2)
    views = _views(dataset)
    cameras = [d.cameras[c] for d, c in views] or [front_camera(middle, reach)]
    truth = dataset.velocity if dataset is not None and dataset.has_velocity else None
    packed, agreement, truths = [], [], []
    for number, result in enumerate(results):
        progress(number, len(results), stage=f"quantise {result.name}")
        truths.append(None if truth is None else true_velocity(result.gaussians, truth))
        packed.append(pack(result.gaussians, truths[-1]))
        agreement.append(_checked(result.gaussians, packed[-1], cameras, first_s, last_s))
    frames, said = frames_within(views, round(pictures_mb * 1e6), lambda i, n: progress(i, n, stage="pictures"))
    plates = _plates(views, results)
    texts = [base64_text(p.data) for p in packed]
    shown = [result.gaussians for result in results]
    speed_max, doubt_max = legend.speed_scale(shown, truths), legend.doubt_scale(shown)
    line_s = legend.line_s(last_s - first_s)
    content = {
        "first_s": first_s,
        "length_s": last_s - first_s,
        "frame_s": [] if dataset is None else (dataset.times_s - first_s).tolist(),
        "held_out": [] if dataset is None else dataset.test_frames,
        "centre": middle.tolist(),
        "start": _middle_camera(dataset),
        "cameras": [_camera(*item) for item in zip(cameras, plates, frames or [None], strict=True)],
        "results": [
            {"name": r.name, "header": p.header(), "data": text}
            for r, p, text in zip(results, packed, texts, strict=True)
        ],
        "speed_max": speed_max,
        "doubt_max": doubt_max,
        "speed_ticks": legend.ticks(speed_max),
        "doubt_ticks": legend.ticks(doubt_max),
        "notes": {"speed": legend.SPEED_NOTE, "doubt": legend.DOUBT_NOTE, "line": legend.line_note(line_s)},
        "line_s": line_s,
        "lines": legend.LINES,
        "scheme": controls.scheme().ravel().tolist(),
        "colours": controls.COLOURS,
        "file": out.stem,
        "subtitle": _subtitle(results, last_s - first_s),
        "facts": _facts(results, packed, agreement, dataset, said),
    }
    title = title or (dataset.description.name if dataset is not None else results[0].name)
    html = assemble(content, title)
    with atomic_path(out) as temporary:
        temporary.write_text(html, encoding="utf-8")
    notes = [f"recorded: {said}"] if views else ["no --dataset: no cameras, recorded pictures or true velocity in it"]
    return Shared(out, out.stat().st_size, [len(text) for text in texts], agreement, notes)


def _measured_alike(results: list[Opened], dataset: Dataset | None) -> list[Opened]:
    """All from the dataset's datum; without one, from the first result's."""
    datum = results[0].gaussians.datum if dataset is None else dataset.datum
    if datum is None:
        return results
    return [replace(result, gaussians=result.gaussians.measured_from(datum)) for result in results]


def assemble(content: dict[str, Any], title: str) -> str:
    """The page: texts of `player/` around the content. Only the script and the style that are in it may run in it."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(loader=PackageLoader("gof.look", "player"), autoescape=True, undefined=StrictUndefined)
    script = "\n".join(_text(name) for name in SCRIPTS)
    style = _text("style.css")
    own = {"shaders": {name: _text(name) for name in SHADERS}, "sorter": _text("sort.js")}
    return environment.get_template("page.html").render(
        title=title,
        controls=controls,
        generator=f"gof {gof.__version__}",
        style=style,
        script=script,
        style_hash=_hash(style),
        script_hash=_hash(script),
        content=json.dumps(content | own, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def front_camera(middle: np.ndarray, reach: float) -> Camera:
    """A camera before a flame, so far that it fills most of the picture: where no dataset says where to stand."""
    width, height, focal = 720, 960, 1400.0
    eye = middle - np.array([0.0, max(2 * reach * focal / (FILLED * height), 3 * reach), 0.0])
    rows = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rows, -rows @ eye
    return Camera("front", width, height, [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], pose)


# ---------------------------------------------------------------- parts


def _text(name: str) -> str:
    return (PLAYER / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """As a Content-Security-Policy names a script or a style."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _span(results: list[Opened], dataset: Dataset | None) -> tuple[float, float]:
    spans = [time_span(result.gaussians, dataset) for result in results]
    return min(first for first, _ in spans), max(last for _, last in spans)


def _views(dataset: Dataset | None) -> list[tuple[Dataset, int]]:
    """The cameras that a method may learn from, then those for novel views."""
    if dataset is None:
        return []
    novel = dataset.evaluation_view()
    both = [dataset] if novel is None else [dataset, novel]
    return [(d, c) for d in both for c in range(len(d.cameras))]


def _middle_camera(dataset: Dataset | None) -> int:
    return 0 if dataset is None else len(dataset.cameras) // 2


def _plates(views: list[tuple[Dataset, int]], results: list[Opened]) -> list[str | None]:
    """What lies behind the flame: the first result's plates; none where it has a static scene of its own."""
    if not views:
        return [None]
    if not results[0].gaussians.dynamic.all():
        return [None] * len(views)
    plates = [background(dataset, camera, results[0].path) for dataset, camera in views]
    return [base64_text(webp(plate[..., :3], PLATE_SIDE, PLATE_QUALITY)) for plate in plates]


def _camera(camera: Camera, plate: str | None, frames: list[str | None] | None) -> dict[str, Any]:
    K = camera.K
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "K": [K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2]],
        "pose": camera.world_to_camera[:3].ravel().tolist(),
        "plate": plate,
        "frames": frames,
    }


def _checked(
    gaussians: TransientGaussians, packed: Packed, cameras: list[Camera], first_s: float, last_s: float
) -> Agreement:
    some = [cameras[i] for i in sorted({int(k) for k in np.linspace(0, len(cameras) - 1, CHECKED)})]
    times = [first_s + share * (last_s - first_s) for share in np.linspace(0, 1, CHECKED + 2)[1:-1]]
    return measure(gaussians, unpack(packed), some, times)


def _subtitle(results: list[Opened], length_s: float) -> str:
    count = " and ".join(f"{len(result.gaussians):,}" for result in results)
    return f"{count} transient Gaussians, {1e3 * length_s:.0f} ms"


def _facts(
    results: list[Opened], packed: list[Packed], agreement: list[Agreement], dataset: Dataset | None, recorded: str
) -> list[tuple[str, str]]:
    """What stands under "About this file"; nothing of where its author keeps files."""
    facts = []
    for result, p, a in zip(results, packed, agreement, strict=True):
        facts.append((result.name, f"{len(result.gaussians):,} Gaussians, read as {result.method}"))
        facts.append(("quantised", f"{len(p.data) / p.count:.0f} bytes each; {in_words(a)}"))
    if dataset is not None:
        facts.append(("dataset", dataset.description.name))
        facts.append(("recorded", recorded))
    return [*facts, ("made by", f"gof {gof.__version__}")]


def in_words(agreement: Agreement) -> str:
    """Quantisation's cost as people read it."""
    if not np.isfinite(agreement.psnr_db):
        return "draws the unquantised picture"
    return (
        f"{agreement.psnr_db:.1f} dB from the unquantised picture at worst, "
        f"centres within {agreement.moved_px:.2g} px, velocities within {1e3 * agreement.velocity_m_s:.1g} mm/s"
    )
