"""`gof report`: collect pictures, scores and costs, and write OUT/report.html, which needs no other file and no network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from PIL import Image

from gof.costs import StageCost, StageLog
from gof.dataset import Dataset
from gof.errors import DataFormatError
from gof.gaussians import TransientGaussians
from gof.io.files import atomic_path, read_json, write_json
from gof.plates import background
from gof.progress import progress_bar
from gof.report import animation as pictures
from gof.report.machine import machine, versions
from gof.report.velocity import legend


@dataclass(frozen=True)
class Preview:
    """A frame rendered by Blender from the imported result, and which true picture it shows."""

    image: Path
    camera: int
    frame: int


def build_report(
    out_dir: Path,
    dataset: Dataset,
    result: Path,
    scores: dict[str, Any],
    stages: Sequence[StageCost | dict] = (),
    preview: Preview | None = None,
    stage_pictures: Path | None = None,
    camera: int | None = None,
    progress: Callable[..., None] | None = None,
) -> Path:
    """Write out_dir/report.html, and out_dir/pictures/animation.webp and .png for use elsewhere; older ones are replaced.

    Args:
        out_dir: folder of the report.
        dataset, result: what was reconstructed, and the file of `TransientGaussians.save`.
        scores: of `gof.evaluate.evaluate`.
        stages: cost of every stage, in order.
        preview: a Blender picture to show beside the true one.
        stage_pictures: folder of PNGs with captions.json {file name: caption}; default `result`'s folder / "stages".
        camera: number of the camera of the animation; default the middle one.
        progress: progress(done, total, stage=name).
    Returns:
        path of report.html.
    Raises:
        DataFormatError: a picture or a file cannot be read.
    """
    gaussians = TransientGaussians.load(result)
    progress = progress or (lambda *a, **k: None)
    camera = len(dataset.cameras) // 2 if camera is None else camera
    plates = [background(dataset, number, result) for number in range(len(dataset.cameras))]
    animation = pictures.animate(
        dataset, gaussians, plates[camera], camera, lambda done, total: progress(done, total, stage="animation")
    )
    folder = out_dir / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / "animation.webp") as temporary:
        animation.save(temporary)
    with atomic_path(folder / "animation.png") as temporary:
        Image.fromarray(animation.frames[animation.still]).save(temporary)

    frame = pictures.brightest_frame(dataset)
    content = {
        "name": dataset.meta["name"],
        "dataset": _facts(dataset, gaussians),
        "animation": animation,
        "animation_uri": pictures.file_uri(folder / "animation.webp"),
        "still_uri": pictures.data_uri(folder / "animation.png"),
        "animation_camera": dataset.cameras[camera].name,
        "legend_uri": pictures.data_uri(legend(), "png"),
        "longest_px_per_frame": animation.longest * dataset.frame_time_s,
        "views": pictures.three_views(dataset, gaussians, plates, frame),
        "views_frame": frame,
        "views_time_ms": 1000 * (dataset.times_s[frame] - dataset.times_s[0]),
        "views_held_out": frame in dataset.test_frames,
        "scores": scores,
        "verdicts": verdicts(scores),
        "chart": _chart(scores),
        "stages": [asdict(s) if isinstance(s, StageCost) else s for s in stages],
        "preview": _preview(preview, dataset),
        "stage_pictures": _stage_pictures(stage_pictures or result.parent / "stages"),
        "machine": machine(),
        "versions": versions() | _provenance(dataset),
        "effects": dataset.meta.get("effects", []),
    }
    with atomic_path(out_dir / "report.html") as temporary:
        temporary.write_text(_render(content), encoding="utf-8")
    return out_dir / "report.html"


def verdicts(scores: dict[str, Any]) -> list[tuple[bool, str]]:
    """What the scores mean in plain words: (good, sentence)."""
    out = []
    dve, controls = scores.get("dve"), scores.get("controls", {})
    if dve and dve["l2"] is not None:
        questions = (
            ("zero", "standing still"),
            ("random", "moving at the same speed in random directions"),
            ("constant", "the best single vector for everything (fitted to the truth)"),
            ("height_mean", "the mean velocity of each height (fitted to the truth)"),
        )
        for name, words in questions:
            other = controls.get(name)
            if other and other["l2"] is not None:
                closer, straighter = dve["l2"] < other["l2"], dve["cos_sim"] > other["cos_sim"]
                how = {
                    (True, True): "Better than",
                    (False, False): "Not better than",
                    (True, False): "Closer in size, not in direction, than",
                    (False, True): "Better in direction, not in size, than",
                }[closer, straighter]
                out.append(
                    (
                        closer and straighter,
                        f"{how} {words}: L2 {dve['l2']:.3f} against {other['l2']:.3f}, "
                        f"CosSim {dve['cos_sim']:.3f} against {other['cos_sim']:.3f}.",
                    )
                )
        gain = dve["speed_ratio"]
        out.append((0.8 <= gain <= 1.25, f"Speeds are {gain:.2f} times the true ones."))
    if scores.get("psnr_flame") is not None:
        gain = scores["psnr_flame"] - scores["psnr_flame_plate"]
        out.append(
            (
                gain > 0,
                f"On flame pixels of held-out frames, {abs(gain):.1f} dB {'above' if gain > 0 else 'below'} the "
                "fire-free plate alone.",
            )
        )
    return out


def _facts(dataset: Dataset, gaussians: TransientGaussians) -> dict[str, str]:
    camera, frame_s = dataset.cameras[0], dataset.frame_time_s
    return {
        "cameras": f"{len(dataset.cameras)}, {camera.width} x {camera.height} px",
        "frames": f"{len(dataset.times_s)} ({len(dataset.test_frames)} held out)"
        + (f" at {1 / frame_s:.4g} per second" if frame_s else ""),
        "Gaussians": f"{len(gaussians):,}"
        + ("" if gaussians.dynamic.all() else f" ({int(gaussians.dynamic.sum()):,} dynamic)"),
    }


def _chart(scores: dict[str, Any]) -> dict[str, Any] | None:
    """L2 over time as SVG points in a 600 x 180 box; None below two scored frames. Undefined frames leave a gap."""
    frames = (scores.get("dve") or {}).get("frames", [])
    values = [f["l2"] for f in frames if f["l2"] is not None]
    if len(values) < 2:
        return None
    times = np.array([f["time_s"] for f in frames])
    top = 1.1 * max([1.0, *values])
    constant = scores["controls"].get("constant", {}).get("l2")
    x = 40 + 550 * (times - times[0]) / (times[-1] - times[0])

    def y(value):
        return round(165 - 150 * value / top, 1)

    lines, line = [], []
    for xk, f in zip(x, frames, strict=True):
        if f["l2"] is None:
            lines, line = [*lines, line], []
        else:
            line.append(f"{xk:.1f},{y(f['l2'])}")
    return {
        "lines": [" ".join(part) for part in [*lines, line] if part],
        "zero": y(0),
        "one": y(1.0),
        "constant": None if constant is None else y(constant),
        "constant_label": None
        if constant is None
        else y(constant) + (13 if np.mean(values) > constant else -5),  # clear of the line
        "end_ms": round(1000 * (times[-1] - times[0])),
    }


def _preview(preview: Preview | None, dataset: Dataset) -> dict[str, Any] | None:
    if preview is None:
        return None
    if not preview.image.is_file():
        raise DataFormatError(f"{preview.image}: no such picture; render the Blender preview first")
    truth = pictures.to_bytes(dataset.image(preview.camera, preview.frame))
    return {
        "truth": pictures.data_uri(pictures.enlarge(truth, pictures.factor_for(truth.shape[1]))),
        "image": pictures.data_uri(preview.image),
        "camera": dataset.cameras[preview.camera].name,
        "frame": preview.frame,
    }


def _stage_pictures(folder: Path) -> list[tuple[str, str]]:
    """[(caption, data URI)] in the order of captions.json; empty when there is none."""
    if not (folder / "captions.json").exists():
        return []
    captions = read_json(folder / "captions.json")
    return [
        (caption, pictures.data_uri(folder / name)) for name, caption in captions.items() if (folder / name).is_file()
    ]


def _provenance(dataset: Dataset) -> dict[str, str]:
    return {
        f"dataset: {k}": str(v)
        for k, v in dataset.meta.get("provenance", {}).items()
        if isinstance(v, str | int | float)
    }


def _render(content: dict[str, Any]) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("gof.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = lambda value, digits=3: "n/a" if value is None else f"{value:.{digits}f}"
    environment.filters["duration"] = lambda s: f"{s:.1f} s" if s < 100 else f"{int(s // 60)} min {int(s % 60)} s"
    return environment.get_template("template.html").render(content)


@dataclass
class ReportConfig:
    """Write OUT/report.html: pictures, animation, scores and costs of a reconstruction on one self-contained page.

    Reads OUT/scores.json (of `gof evaluate --out OUT`), costs.json of the dataset, the result's folder and OUT, the
    stage pictures beside the result, and OUT/preview.json {"image", "camera", "frame"} when there is one.
    """

    out_dir: tyro.conf.Positional[Path]
    """Folder of the report; it holds scores.json."""
    dataset: Path | None = None
    """Dataset folder; default OUT/dataset."""
    result: Path | None = None
    """Result file; default OUT/result.npz, or OUT/reconstruct/result.npz."""
    camera: int | None = None
    """Number of the camera of the animation; default the middle one."""
    json: Path | None = None
    """Also write the page's name and size to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof report`."""
    config = tyro.cli(ReportConfig, prog="gof report", args=argv)
    out = config.out_dir
    result = config.result or next(
        (p for p in (out / "result.npz", out / "reconstruct/result.npz") if p.exists()), out / "result.npz"
    )
    if not (out / "scores.json").exists():
        raise DataFormatError(
            f"{out}/scores.json: no such file; run 'gof evaluate {result} --truth DATASET --out {out}' first"
        )
    dataset = Dataset.open(config.dataset or out / "dataset")
    logs = dict.fromkeys(folder.resolve() for folder in (dataset.path, result.parent, out))
    stages = [stage for folder in logs for stage in StageLog(folder / "costs.json").stages()]
    preview = None
    if (out / "preview.json").exists():
        p = read_json(out / "preview.json")
        try:
            preview = Preview(out / p["image"], int(p["camera"]), int(p["frame"]))
        except (KeyError, TypeError, ValueError) as e:
            raise DataFormatError(
                f"{out}/preview.json: expected image, camera and frame ({type(e).__name__}: {e})"
            ) from e
    with progress_bar("report") as progress:
        path = build_report(
            out,
            dataset,
            result,
            read_json(out / "scores.json"),
            stages,
            preview,
            camera=config.camera,
            progress=progress,
        )
    if config.json:
        write_json(config.json, {"report": str(path), "bytes": path.stat().st_size})
    print(f"{path} ({path.stat().st_size / 2**20:.1f} MB)")
    return 0
