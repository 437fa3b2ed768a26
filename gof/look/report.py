"""The report: pictures, scores and costs in one HTML file that needs no other file and no network."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, ClassVar, NamedTuple

from PIL import Image

import gof
from gof.core.cameras import in_words
from gof.core.costs import StageCost
from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, is_name, path_in
from gof.core.gaussians import TransientGaussians
from gof.core.records import read_record, write_record
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.leaderboard import best_baseline
from gof.evaluate.scores import Scores
from gof.host.checks import machine, versions
from gof.look import animation as pictures
from gof.look.charts import around_chart, frame_chart
from gof.look.images import data_uri, enlarge, factor_for, file_uri, to_bytes
from gof.look.pages import PagePicture, duration, template
from gof.look.path import GUESSED_DEG
from gof.look.score_table import ScoreTable
from gof.look.velocity import legend
from gof.reconstruct.captions import Captions

RIGHT_SPEED = (0.8, 1.25)  # ratios of the estimated to the true speed that are called right
IN_PATH = r"[^\\/'\",;:\n]"
FOLDERS = re.compile(rf"(?<![\w.:/\\])(?:~|[A-Za-z]:)?[\\/](?:{IN_PATH}+[\\/])*(?={IN_PATH})")  # of an absolute path


def build_report(
    out_dir: Path,
    dataset: Dataset,
    result: Path,
    scores: Scores,
    stages: Sequence[StageCost] = (),
    preview: Preview | None = None,
    camera: int | None = None,
    fire_removal: Sequence[Sequence[PagePicture | None]] = (),
    train_s: float | None = None,
    progress: Callable[..., None] | None = None,
) -> Path:
    """Write out_dir/report.html, and out_dir/pictures/animation.webp and .png for use elsewhere; replaces older ones.

    Args:
        out_dir: folder of the report.
        dataset, result: what was reconstructed, and the file of `TransientGaussians.save`; PNGs in a folder "stages"
            beside it are shown with their captions (`gof.reconstruct.captions`).
        stages: cost of every stage, in order.
        preview: a Blender picture to show beside the true one; its image lies in `out_dir`.
        camera: number of the camera of the animation; default the middle one.
        fire_removal: rows of pictures that show what the plates are worth, one for each camera.
        train_s: seconds that the reconstruction took.
        progress: progress(done, total, stage=name).
    Returns:
        path of report.html.
    Raises:
        DataFormatError: a picture or a file cannot be read.
    """
    gaussians = TransientGaussians.load(result).measured_from(dataset.datum)
    progress = progress or (lambda *a, **k: None)
    camera = len(dataset.cameras) // 2 if camera is None else camera
    plates = [background(dataset, number, result) for number in range(len(dataset.cameras))]
    animation = pictures.animate(
        dataset, gaussians, plates[camera], camera, lambda done, total: progress(done, total, stage="animation")
    )
    folder = out_dir / "pictures"
    frame = pictures.brightest_frame(dataset)
    today = time.strftime("%Y-%m-%d")
    with ThreadPoolExecutor(1) as beside:
        saved = beside.submit(_save, animation, folder)  # the encoder lets go of Python's lock
        content = {
            "name": dataset.description.name,
            "made": f"{today}, gof report {gof.__version__}",
            "dataset": _facts(dataset),
            "animation": animation,
            "animation_camera": dataset.cameras[camera].name,
            "legend_uri": data_uri(legend(), "png"),
            "longest_px_per_frame": animation.longest * dataset.frame_time_s,
            "views": pictures.all_views(dataset, gaussians, plates, frame),
            "views_frame": frame,
            "views_time_ms": 1000 * (dataset.times_s[frame] - dataset.times_s[0]),
            "views_held_out": frame in dataset.test_frames,
            "filmed": dataset.description.is_filmed,
            "in_metres": dataset.description.in_metres,
            "original": pictures.original(dataset),
            **_tell_scores(scores, f"{dataset.description.name}, gof {gof.__version__}, {today}"),
            "answers": answers(scores, train_s),
            "around": _around(dataset, gaussians, scores),
            "stages": list(stages),
            "preview": _preview(preview, out_dir, dataset),
            "fire_removal": fire_removal,
            "stage_pictures": _stage_pictures(result.parent / "stages"),
            "machine": machine(),
            "versions": versions() | _provenance(dataset),
            "effects": dataset.description.effects,
        }
        saved.result()
    content |= {
        "animation_uri": file_uri(folder / "animation.webp"),
        "still_uri": data_uri(folder / "animation.png"),
    }
    with atomic_path(out_dir / "report.html") as temporary:
        temporary.write_text(template("report.html").render(content), encoding="utf-8")
    return out_dir / "report.html"


def _save(animation: pictures.Animation, folder: Path) -> None:
    """Write folder/animation.webp, and its frame with most flame as animation.png."""
    animation.save(folder / "animation.webp")
    with atomic_path(folder / "animation.png") as temporary:
        Image.fromarray(animation.frames[animation.still]).save(temporary)


def _tell_scores(scores: Scores, title: str) -> dict[str, Any]:
    """Return the parts of the page that the scores alone fill; `title` stands above the LaTeX table."""
    table = ScoreTable.of(scores)
    return {
        "picture_size": in_words(scores.images.sizes_px) if scores.images else "",
        "scores": scores,
        "table": table,
        "latex": table.rows and table.latex(title),
        "warnings": [_without_folders(warning) for warning in scores.warnings],
        "chart": chart.svg() if (chart := frame_chart(scores)) else "",
        "around_chart": chart.svg() if (chart := around_chart(scores)) else "",
    }


def _facts(dataset: Dataset) -> dict[str, str]:
    camera, frame_s = dataset.cameras[0], dataset.frame_time_s
    return {
        "cameras": f"{len(dataset.cameras)}, {camera.width} x {camera.height} px",
        "frames": f"{len(dataset.times_s)} ({len(dataset.test_frames)} held out)"
        + (f" at {1 / frame_s:.4g} per second" if frame_s else ""),
    }


def _around(dataset: Dataset, gaussians: TransientGaussians, scores: Scores) -> list[tuple[str, list[tuple[str, str]]]]:
    """Pictures from all around, where they were scored."""
    around = dataset.around_view()
    angles_deg = {view.camera: view.angle_deg for view in scores.around}
    return pictures.views_around(around, gaussians, angles_deg) if around and angles_deg else []


def _preview(preview: Preview | None, folder: Path, dataset: Dataset) -> dict[str, Any] | None:
    if preview is None:
        return None
    if not (0 <= preview.camera < len(dataset.cameras) and 0 <= preview.frame < len(dataset.times_s)):
        raise DataFormatError(
            f"{folder}/preview.json: the dataset has no frame {preview.frame} of a camera {preview.camera}"
        )
    image = path_in(folder, preview.image)
    if not image.is_file():
        raise DataFormatError(f"{image}: no such picture; render the Blender preview first")
    truth = to_bytes(dataset.image(preview.camera, preview.frame))
    return {
        "truth": data_uri(enlarge(truth, factor_for(truth.shape[1]))),
        "shape": f"{truth.shape[1]} / {truth.shape[0]}",
        "image": data_uri(image),
        "camera": dataset.cameras[preview.camera].name,
        "frame": preview.frame,
    }


def _stage_pictures(folder: Path) -> list[tuple[str, str]]:
    """[(caption, data URI)] in the order of the captions; empty when there are none."""
    captions = Captions.read(folder).images
    files = [(c.text, path_in(folder, c.file)) for c in captions]
    return [(text, data_uri(file)) for text, file in files if file.is_file()]


def _provenance(dataset: Dataset) -> dict[str, str]:
    provenance = dataset.description.provenance
    shown = {
        k.replace("_", " "): _without_folders(str(v)) for k, v in provenance.items() if isinstance(v, str | int | float)
    }
    return {f"dataset: {words}": value for words, value in shown.items()}


def _without_folders(words: str) -> str:
    """Return a text in which absolute paths are file names: folders tell of a machine and its users."""
    return FOLDERS.sub("", words)


# ---------------------------------------------------------------- the answer in four tiles


class Answer(NamedTuple):
    """A tile: its name, the figure with its unit, lines below it, and whether that is good; None: neither."""

    name: str
    figure: str
    lines: tuple[str, ...]
    good: bool | None = None


def answers(scores: Scores, train_s: float | None) -> list[Answer]:
    """Return motion, speed, pictures and time, or what there is of them; the number of Gaussians where one is
    missing."""
    found = [_motion(scores), _speed(scores), _pictures(scores)]
    many, dynamic = f"{scores.gaussians:,}", scores.dynamic_gaussians
    has_own_tile = scores.dve is None or not train_s
    if train_s:
        found.append(Answer("time it took", duration(train_s), () if has_own_tile else (f"for {many} Gaussians",)))
    if has_own_tile:
        lines = () if dynamic == scores.gaussians else (f"{dynamic:,} of them dynamic",)
        found.append(Answer("Gaussians", many, lines))
    return [answer for answer in found if answer]


def _motion(scores: Scores) -> Answer | None:
    """Return the error beside the best trivial baseline's: by EVE, which ranks, where it is known, and by DVE."""
    dve, errors = scores.dve, []
    if dve is None:
        return None
    if (eve := dve.eve) and eve.l2 is not None and (best := best_baseline(eve.baselines, "l2")):
        errors.append(("EVE", eve.l2, best[1]))
    if dve.l2 is not None and (best := best_baseline(scores.trivial_baselines, "l2")):
        errors.append(("DVE", dve.l2, best[1]))
    if not errors:
        return None
    (name, l2, best_l2), *rest = errors
    lines = [f"best trivial baseline {best_l2:.3f}: {_beaten(l2 < best_l2)}"]
    lines += [f"by {name} {l2:.3f} against {best:.3f}: {_beaten(l2 < best)}" for name, l2, best in rest]
    return Answer(f"motion error ({name} L2)", f"{l2:.3f}", tuple(lines), l2 < best_l2)


def _beaten(better: bool) -> str:
    return "beaten" if better else "not beaten"


def _speed(scores: Scores) -> Answer | None:
    dve = scores.dve
    both = [("EVE", dve and dve.eve), ("DVE", dve)]
    ratios = [(name, score.speed_ratio) for name, score in both if score and score.speed_ratio is not None]
    if not ratios:
        return None
    (name, ratio), *rest = ratios
    low, high = RIGHT_SPEED
    word = "too slow" if ratio < low else "too fast" if ratio > high else "right"
    lines = (f"{word} (right: {low} to {high})", *(f"by {other} {value:.2f}" for other, value in rest))
    return Answer(f"speed over true speed ({name})", f"{ratio:.2f}", lines, low <= ratio <= high)


def _pictures(scores: Scores) -> Answer | None:
    """Return the flame's dB at held-out times, beside what is to be beaten, and from the side."""
    own = scores.psnr_flame
    if own is None:
        return None
    known = [("2D baseline", scores.psnr_flame_between), ("background alone", scores.psnr_flame_plate)]
    beside = [(name, db) for name, db in known if db is not None][:1]
    lines = [f"{name} {db:.1f} dB: {_beaten(own > db)}" for name, db in beside]
    sides = [(v.angle_deg, v.psnr_flame) for v in scores.around if v.psnr_flame is not None]
    sides = [(angle, db) for angle, db in sides if angle > GUESSED_DEG]
    if sides:
        angles = dict.fromkeys(f"{end(angle for angle, _ in sides):.0f}°" for end in (min, max))
        lines.append(f"from other sides ({' to '.join(angles)}) {fmean(db for _, db in sides):.1f} dB")
    good = own > beside[0][1] if beside else None
    return Answer("flame PSNR, held-out pictures", f"{own:.1f} dB", tuple(lines), good)


# ----------------------------------------------------------------
# `preview.json`: a picture of the result in Blender, and which true picture it shows. `gof import` writes it.


PREVIEW = "preview.json"


@dataclass(frozen=True)
class Preview:
    """A frame rendered by Blender from the imported result.

    Attributes:
        image: name of the picture, in the folder of preview.json.
        camera: number of the dataset's camera.   frame: of the dataset.
        result: of which result, by `digest`; None: not said, as before 0.4.

    Raises:
        DataFormatError: `image` is a path.
    """

    SCHEMA: ClassVar[str] = "gof-preview"
    VERSION: ClassVar[int] = 1

    image: str
    camera: int
    frame: int
    result: str | None = None

    def __post_init__(self):
        if not is_name(self.image):
            raise DataFormatError(f"image: {self.image[:80]!r} cannot be the name of a picture in this folder")

    @classmethod
    def read(cls, path: Path) -> Preview:
        return read_record(cls, path)

    def write(self, path: Path) -> None:
        write_record(path, self)
