"""The player's page, and `gof share`: one HTML file that plays from the disk, without a network.

The page's own code lies beside this file: `unpack.js` turns the columns of `quantise.py` into numbers, `sort.js` orders
them in a worker, `draw.js` and the shaders draw, `view.js` turns the camera, `greet.js` is the page's first seconds,
`links.js` its state as an address, `player.js` is what people touch. `live.py` serves the same page to this machine.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import gof
from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.fields import VelocitySequence
from gof.core.files import atomic_path
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.pack import read_credit
from gof.dataset.plates import background
from gof.look.images import PLATE_QUALITY, PLATE_SIDE, VIRIDIS, base64_text, frames_within, ramp, webp
from gof.look.pages import template
from gof.look.player import legend
from gof.look.player.opened import Opened, measured_alike, middle_of, time_span
from gof.look.player.quantise import Packed, PackedFidelity, measure, pack, unpack

PLAYER = Path(__file__).parent
SCRIPTS = ("unpack.js", "view.js", "draw.js", "pictures.js", "greet.js", "links.js", "player.js")
LIVE = "live.js"  # of the page of `gof view` alone
SHADERS = ("splat.glsl", "line.glsl", "pane.glsl")  # each a shader of corners, then one of fragments
FRAGMENTS = "//// the fragments\n"
FILLED = 0.65  # of the picture's height, by the flame, where no dataset has a camera
# In dataset.json, what its provenance may say for people to read.
CREDITS = {"authors": "Made by {}.", "licence": "Licence: {}.", "data_set": "Data set: {}."}
CHECKED = 3  # cameras, and times, at which quantisation is measured


@dataclass(frozen=True)
class Shared:
    """A page that was written: its size, that of the Gaussians in it (base64), and what quantising cost each result."""

    path: Path
    bytes: int
    gaussian_bytes: list[int]
    agreement: list[PackedFidelity]
    notes: list[str]


@dataclass(frozen=True)
class PageSetting:
    """Setting in which results are shown: the part that does not change with them.

    Attributes:
        dataset: None where there is none.
        first_s, length_s: of the clip.
        middle: (3,) m, of the flame.
        views: (dataset, number of a camera in it).   cameras: theirs, or one in front of the flame.
    """

    dataset: Dataset | None
    first_s: float
    length_s: float
    middle: np.ndarray
    views: list[tuple[Dataset, int]]
    cameras: list[Camera]

    @classmethod
    def of(cls, results: Sequence[Opened], dataset: Dataset | None) -> PageSetting:
        spans = [time_span(result.gaussians, dataset) for result in results]
        first_s, last_s = min(first for first, _ in spans), max(last for _, last in spans)
        middle_s = (first_s + last_s) / 2
        middle, reach = middle_of(results[0].gaussians.state_at(middle_s), middle_s)
        views = _views(dataset)
        cameras = [d.cameras[c] for d, c in views] or [front_camera(middle, reach)]
        return cls(dataset, first_s, last_s - first_s, middle, views, cameras)

    def content(
        self, first: Opened, pictures_mb: float, progress: Callable[[int, int], None]
    ) -> tuple[dict[str, Any], str]:
        """Return the setting for the page, as JSON, and in words how recorded pictures were changed.

        Args:
            first: the result whose plates lie behind the flame.
            pictures_mb: at most so much of recorded pictures; 0 = none.
        """
        frames, changes = frames_within(self.views, round(pictures_mb * 1e6), progress)
        plates = _plates(self.views, first)
        dataset = self.dataset
        return {
            "first_s": self.first_s,
            "length_s": self.length_s,
            "frame_s": [] if dataset is None else (dataset.times_s - self.first_s).tolist(),
            "held_out": [] if dataset is None else dataset.test_frames,
            "centre": self.middle.tolist(),
            "start": 0 if dataset is None else len(dataset.cameras) // 2,
            "given": 0 if dataset is None else len(dataset.cameras),  # the first cameras: a method may learn from them
            "cameras": [_camera(*item) for item in zip(self.cameras, plates, frames or [None], strict=True)],
            "line_s": legend.line_s(self.length_s),
            "lines": legend.MOST_LINES,
            "scheme": ramp(VIRIDIS).ravel().tolist(),
            "colours": legend.COLOURS,
            "credit": "" if dataset is None else credit(dataset),
            "notes": {
                "speed": legend.SPEED_NOTE,
                "uncertainty": legend.UNCERTAINTY_NOTE,
                "line": legend.line_note(legend.line_s(self.length_s)),
            },
        }, changes

    def truth_at(self, gaussians: TransientGaussians) -> np.ndarray | None:
        """Return the true velocity (N, 3) m/s at the Gaussians, None where it is not known."""
        if self.dataset is None or not self.dataset.has_velocity:
            return None
        return true_velocity(gaussians, self.dataset.velocity)


def scales(states: Sequence[TransientGaussians], truths: Sequence[np.ndarray | None]) -> dict[str, Any]:
    """Return the meaning of the last colours, and the words below the colours, of all these Gaussians."""
    speed_max, uncertainty_max = legend.speed_scale(states, truths), legend.uncertainty_scale(states)
    return {
        "speed_max": speed_max,
        "uncertainty_max": uncertainty_max,
        "speed_ticks": legend.ticks(speed_max),
        "uncertainty_ticks": legend.ticks(uncertainty_max),
    }


def packed_result(name: str, packed: Packed) -> dict[str, Any]:
    """Return quantised Gaussians as JSON."""
    return {"name": name, "header": packed.header(), "data": base64_text(packed.data)}


def share_page(
    results: list[Opened[TransientGaussians]],
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
    results = measured_alike(results, dataset)
    setting = PageSetting.of(results, dataset)
    packed, agreement, truths = [], [], []
    with ThreadPoolExecutor(1) as beside:  # pictures are decoded and encoded without Python's lock
        pictures_progress = partial(progress, stage="pictures")
        pictures = beside.submit(setting.content, results[0], pictures_mb, pictures_progress)
        for number, result in enumerate(results):
            progress(number, len(results), stage=f"quantise {result.name}")
            truths.append(setting.truth_at(result.gaussians))
            packed.append(pack(result.gaussians, truths[-1]))
            agreement.append(_checked(result.gaussians, packed[-1], setting))
        content, changes = pictures.result()
    shown = [packed_result(result.name, one) for result, one in zip(results, packed, strict=True)]
    content |= scales([result.gaussians for result in results], truths)
    content |= {
        "results": shown,
        "file": out.stem,
        "subtitle": subtitle(results, setting),
        "facts": _facts(results, packed, agreement, dataset, changes),
    }
    html = assemble(content, title or title_of(results, dataset))
    with atomic_path(out) as temporary:
        temporary.write_text(html, encoding="utf-8")
    known = setting.views
    notes = (
        [f"recorded: {changes}"] if known else ["no --dataset: no cameras, recorded pictures or true velocity in it"]
    )
    return Shared(out, out.stat().st_size, [len(one["data"]) for one in shown], agreement, notes)


def title_of(results: Sequence[Opened], dataset: Dataset | None) -> str:
    """Return a page's usual heading."""
    return results[0].name if dataset is None else dataset.description.name


def credit(dataset: Dataset) -> str:
    """Return a dataset's makers and licence in words: of the card of `gof pack`, else of its provenance; empty where
    neither says."""
    if text := read_credit(dataset.path):
        return text
    made = dataset.description.provenance
    found = {name: made[name] for name in CREDITS if made.get(name)}
    return " ".join(
        CREDITS[name].format(", ".join(map(str, value)) if isinstance(value, list) else value)
        for name, value in found.items()
    )


def assemble(content: dict[str, Any], title: str) -> str:
    """Return the page: texts of `player/` around the content. Only the script and the style that are in it may run in
    it."""
    live = content.get("live", False)
    script = "\n".join(_text(name) for name in (*([LIVE] if live else []), *SCRIPTS))
    style = _text("style.css")
    own = {"shaders": {name: _text(name).split(FRAGMENTS) for name in SHADERS}, "sorter": _text("sort.js")}
    return template("player/page.html").render(
        title=title,
        live=live,
        controls=legend,
        generator=f"gof {gof.__version__}",
        style=style,
        script=script,
        content=json.dumps(content | own, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def front_camera(middle: np.ndarray, reach: float) -> Camera:
    """Return a camera before a flame, so far that it fills most of the picture: where no dataset says where to
    stand."""
    width, height, focal = 720, 960, 1400.0
    eye = middle - np.array([0.0, max(2 * reach * focal / (FILLED * height), 3 * reach), 0.0])
    rows = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rows, -rows @ eye
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera("front", width, height, K, pose)


def true_velocity(gaussians: TransientGaussians, truth: VelocitySequence) -> np.ndarray:
    """Return (N, 3) m/s of the gas at each Gaussian's centre at its own time t_mu; 0 outside the field."""
    return truth.sample(gaussians.position, gaussians.t_mu.astype(np.float64))[0]


# ---------------------------------------------------------------- parts


def _text(name: str) -> str:
    return (PLAYER / name).read_text(encoding="utf-8")


def _views(dataset: Dataset | None) -> list[tuple[Dataset, int]]:
    """Return the cameras that a method may learn from, then those for novel views."""
    if dataset is None:
        return []
    novel = dataset.evaluation_view()
    both = [dataset] if novel is None else [dataset, novel]
    return [(d, c) for d in both for c in range(len(d.cameras))]


def _plates(views: list[tuple[Dataset, int]], result: Opened) -> list[str | None]:
    """Return the pictures behind the flame: the result's plates; none where it has a static scene of its own."""
    if not views:
        return [None]
    if not result.gaussians.dynamic.all():
        return [None] * len(views)
    plates = [background(dataset, camera, result.path) for dataset, camera in views]
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
        "picture_width": _width(frames or []),
    }


def _width(frames: list[str | None]) -> int | None:
    """Return the width in px of a camera's recorded pictures; None where it has none."""
    first = next(filter(None, frames), None)
    return None if first is None else Image.open(io.BytesIO(base64.b64decode(first))).width


def _checked(gaussians: TransientGaussians, packed: Packed, setting: PageSetting) -> PackedFidelity:
    cameras = setting.cameras
    some = [cameras[i] for i in sorted({int(k) for k in np.linspace(0, len(cameras) - 1, CHECKED)})]
    times = [setting.first_s + share * setting.length_s for share in np.linspace(0, 1, CHECKED + 2)[1:-1]]
    return measure(gaussians, unpack(packed), some, times)


def subtitle(results: Sequence[Opened], setting: PageSetting) -> str:
    """Return the number of Gaussians and the length of the clip."""
    count = " and ".join(f"{len(result.gaussians):,}" for result in results)
    return f"{count} transient Gaussians, {1e3 * setting.length_s:.0f} ms"


def _facts(
    results: list[Opened], packed: list[Packed], agreement: list[PackedFidelity], dataset: Dataset | None, recorded: str
) -> list[tuple[str, str]]:
    """Return the text under "About this file"; it names no folder of its author."""
    facts = []
    for result, p, a in zip(results, packed, agreement, strict=True):
        facts.append((result.name, f"{len(result.gaussians):,} Gaussians, read as {result.method}"))
        facts.append(("quantised", f"{len(p.data) / p.count:.0f} bytes each; {in_words(a)}"))
    if dataset is not None:
        facts.append(("dataset", dataset.description.name))
        facts.append(("filmed", recorded))
    return [*facts, ("made by", f"gof {gof.__version__}")]


def in_words(agreement: PackedFidelity) -> str:
    """Quantisation's cost as people read it."""
    if not np.isfinite(agreement.psnr_db):
        return "draws the unquantised picture"
    return (
        f"{agreement.psnr_db:.1f} dB from the unquantised picture at worst, "
        f"centres within {agreement.moved_px:.2g} px, velocities within {1e3 * agreement.velocity_m_s:.1g} mm/s"
    )
