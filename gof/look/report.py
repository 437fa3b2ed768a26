"""The report: pictures, scores and costs in one HTML file that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from PIL import Image

from gof.core.cameras import in_words
from gof.core.costs import StageCost
from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, is_name, path_in
from gof.core.gaussians import TransientGaussians
from gof.core.records import read_record, write_record
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.scores import Agreement, ClipScore, EveFigures, Scores
from gof.host.checks import machine, versions
from gof.look import animation as pictures
from gof.look.charts import around_chart, frame_chart
from gof.look.images import data_uri, enlarge, factor_for, file_uri, to_bytes
from gof.look.pages import PagePicture, template
from gof.look.velocity import legend
from gof.reconstruct.captions import Captions

COMPARED = {
    "zero": "standing still",
    "random": "moving at the same speed in random directions",
    "constant": "the best single vector for everything (fitted to the truth)",
    "height_mean": "the mean velocity of each height (fitted to the truth)",
}
OUTCOMES = {  # by (smaller L2, larger CosSim)
    (True, True): "Better than",
    (False, False): "Not better than",
    (True, False): "Closer in size, not in direction, than",
    (False, True): "Better in direction, not in size, than",
}
RIGHT_SPEED = (0.8, 1.25)  # ratios of the estimated to the true speed that are called right


def build_report(
    out_dir: Path,
    dataset: Dataset,
    result: Path,
    scores: Scores,
    stages: Sequence[StageCost] = (),
    preview: Preview | None = None,
    stage_pictures: Path | None = None,
    camera: int | None = None,
    fire_removal: Sequence[Sequence[PagePicture | None]] = (),
    progress: Callable[..., None] | None = None,
) -> Path:
    """Write out_dir/report.html, and out_dir/pictures/animation.webp and .png for use elsewhere; replaces older ones.

    Args:
        out_dir: folder of the report.
        dataset, result: what was reconstructed, and the file of `TransientGaussians.save`.
        stages: cost of every stage, in order.
        preview: a Blender picture to show beside the true one; its image lies in `out_dir`.
        stage_pictures: folder of PNGs with their captions (`gof.reconstruct.captions`); default: "stages" beside
            `result`.
        camera: number of the camera of the animation; default the middle one.
        fire_removal: rows of pictures that show what the plates are worth, one for each camera.
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
    _save(animation, folder)
    frame = pictures.brightest_frame(dataset)
    content = {
        "name": dataset.description.name,
        "dataset": _facts(dataset, gaussians),
        "animation": animation,
        "animation_uri": file_uri(folder / "animation.webp"),
        "still_uri": data_uri(folder / "animation.png"),
        "animation_camera": dataset.cameras[camera].name,
        "legend_uri": data_uri(legend(), "png"),
        "longest_px_per_frame": animation.longest * dataset.frame_time_s,
        "views": pictures.three_views(dataset, gaussians, plates, frame),
        "views_frame": frame,
        "views_time_ms": 1000 * (dataset.times_s[frame] - dataset.times_s[0]),
        "views_held_out": frame in dataset.test_frames,
        "filmed": dataset.description.is_filmed,
        "in_metres": dataset.description.in_metres,
        "original": pictures.original(dataset),
        "picture_size": in_words(scores.images.sizes_px) if scores.images else "",
        "scores": scores,
        "verdicts": verdicts(scores),
        "chart": chart.svg() if (chart := frame_chart(scores)) else "",
        "around": _around(dataset, gaussians, scores),
        "around_chart": chart.svg() if (chart := around_chart(scores)) else "",
        "stages": list(stages),
        "preview": _preview(preview, out_dir, dataset),
        "fire_removal": fire_removal,
        "stage_pictures": _stage_pictures(stage_pictures or result.parent / "stages"),
        "machine": machine(),
        "versions": versions() | _provenance(dataset),
        "effects": dataset.description.effects,
    }
    with atomic_path(out_dir / "report.html") as temporary:
        temporary.write_text(template("report.html").render(content), encoding="utf-8")
    return out_dir / "report.html"


def _save(animation: pictures.Animation, folder: Path) -> None:
    """Write folder/animation.webp, and its frame with most flame as animation.png."""
    animation.save(folder / "animation.webp")
    with atomic_path(folder / "animation.png") as temporary:
        Image.fromarray(animation.frames[animation.still]).save(temporary)


def _facts(dataset: Dataset, gaussians: TransientGaussians) -> dict[str, str]:
    camera, frame_s = dataset.cameras[0], dataset.frame_time_s
    return {
        "cameras": f"{len(dataset.cameras)}, {camera.width} x {camera.height} px",
        "frames": f"{len(dataset.times_s)} ({len(dataset.test_frames)} held out)"
        + (f" at {1 / frame_s:.4g} per second" if frame_s else ""),
        "Gaussians": f"{len(gaussians):,}"
        + ("" if gaussians.dynamic.all() else f" ({int(gaussians.dynamic.sum()):,} dynamic)"),
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
    shown = {k.replace("_", " "): str(v) for k, v in provenance.items() if isinstance(v, str | int | float)}
    return {f"dataset: {words}": value for words, value in shown.items()}


# ---------------------------------------------------------------- scores in plain words


class Verdict(NamedTuple):
    good: bool
    sentence: str


def verdicts(scores: Scores) -> list[Verdict]:
    """Return the velocities against the trivial baselines, their speed, the flame's pixels against the plate: what is
    defined of it."""
    out = []
    eve = None if scores.dve is None else scores.dve.eve
    if (own := _defined(eve)) and (constant := _defined(eve and eve.baselines.get("constant"))):
        sentence = f"Where the fire is (EVE): L2 {own.l2:.3f} against {constant.l2:.3f} of one constant vector, "
        sentence += f"CosSim {own.cos_sim:.3f} against {constant.cos_sim:.3f}."
        out.append(Verdict(all(own.better_than(constant)), sentence))
    if scores.dve is not None and (own := _defined(scores.dve)):
        for name, words in COMPARED.items():
            if trivial_baseline := _defined(scores.trivial_baselines.get(name)):
                out.append(_against(trivial_baseline, words, own))
        ratio = scores.dve.speed_ratio
        low, high = RIGHT_SPEED
        if ratio is not None:
            out.append(Verdict(low <= ratio <= high, f"Speeds are {ratio:.2f} times the true ones."))
    if scores.psnr_flame is not None and scores.psnr_flame_plate is not None:
        gain = scores.psnr_flame - scores.psnr_flame_plate
        side = "above" if gain > 0 else "below"
        size = in_words(scores.images.sizes_px) if scores.images else ""
        where = f"held-out frames ({size})" if size else "held-out frames"
        sentence = f"On flame pixels of {where}, {abs(gain):.1f} dB {side} the fire-free background alone."
        out.append(Verdict(gain > 0, sentence))
    if scores.psnr_flame is not None and scores.psnr_flame_between is not None:
        gain = scores.psnr_flame - scores.psnr_flame_between
        side = "above" if gain > 0 else "below"
        out.append(
            Verdict(gain > 0, f"There, {abs(gain):.1f} dB {side} the two frames around, carried along their flow.")
        )
    return out


class Closeness(NamedTuple):
    """How close velocities are to the true ones."""

    l2: float
    cos_sim: float

    def better_than(self, other: Closeness) -> tuple[bool, bool]:
        """Return whether they are closer, and whether their directions agree better."""
        return self.l2 < other.l2, self.cos_sim > other.cos_sim


def _defined(score: Agreement | EveFigures | ClipScore | None) -> Closeness | None:
    """Return both figures; None where one is not defined."""
    if score is None or score.l2 is None or score.cos_sim is None:
        return None
    return Closeness(score.l2, score.cos_sim)


def _against(trivial_baseline: Closeness, words: str, dve: Closeness) -> Verdict:
    closer, straighter = dve.better_than(trivial_baseline)
    return Verdict(
        closer and straighter,
        f"{OUTCOMES[closer, straighter]} {words}: L2 {dve.l2:.3f} against {trivial_baseline.l2:.3f}, "
        f"CosSim {dve.cos_sim:.3f} against {trivial_baseline.cos_sim:.3f}.",
    )


# ----------------------------------------------------------------
# `preview.json`: a picture of the result in Blender, and which true picture it shows. `gof import` writes it.


@dataclass(frozen=True)
class Preview:
    """A frame rendered by Blender from the imported result.

    Attributes:
        image: name of the picture, in the folder of preview.json.
        camera: number of the dataset's camera.   frame: of the dataset.

    Raises:
        DataFormatError: `image` is a path.
    """

    SCHEMA: ClassVar[str] = "gof-preview"
    VERSION: ClassVar[int] = 1

    image: str
    camera: int
    frame: int

    def __post_init__(self):
        if not is_name(self.image):
            raise DataFormatError(f"image: {self.image[:80]!r} cannot be the name of a picture in this folder")

    @classmethod
    def read(cls, path: Path) -> Preview:
        return read_record(cls, path)

    def write(self, path: Path) -> None:
        write_record(path, self)
