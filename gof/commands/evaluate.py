"""`gof evaluate`: every score of a result against a dataset, with the trivial baselines and what each part cost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.table import Table
from rich.text import Text

from gof.commands.everywhere import beside, figures_file, may_overwrite, require_free
from gof.commands.flow import motion_table
from gof.commands.read import read_options
from gof.core.cameras import in_words
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.evaluate import Extras, Scores, evaluate
from gof.evaluate.authors_figures import THEIRS
from gof.evaluate.eve import BASELINES
from gof.evaluate.scores import VelocityScore
from gof.evaluate.trivial_baselines import BOUNDS
from gof.host.terminal import console, progress_bar
from gof.ingest.depth import KINDS, write_frame_depths
from gof.reconstruct.optical_flow import dis

FILE, MAPS = "scores.json", "depth_maps"

PICTURE_ROWS = (
    ("psnr_flame", "PSNR flame (dB)", 2),
    ("ssim_flame", "SSIM flame", 4),
    ("flip_flame", "FLIP flame", 4),
    ("psnr", "PSNR (dB)", 2),
    ("ssim", "SSIM", 4),
    ("flip", "FLIP", 4),
    ("lpips", "LPIPS", 4),
    ("temporal_l2", "change between frames, relative L2", 3),
    ("rmse_depth", "RMSE depth", 3),
)
PUBLISHED_ROWS = (
    ("psnr_flame", "PSNR flame (dB)", 2),
    ("ssim_flame", "SSIM flame", 3),
    ("rmse_depth_flame", "RMSE of flame's inverse depth", 3),
    ("lpips", "LPIPS", 3),
    ("psnr_no_sync", "PSNR without board (dB)", 2),
    ("ssim_no_sync", "SSIM without board", 3),
)


@dataclass
class EvaluateConfig:
    """Score a reconstruction against a dataset: DVE (L2, CosSim) with trivial baselines, PSNR and SSIM on held-out
    frames.

    Examples:
      gof evaluate out/fire --dataset data/fire
      gof evaluate out/other.ply --dataset data/fire --out boards/other

    Units of time, worlds and dates that another method's files lack are written down once by `gof convert RESULT`.
    Higher orders of quadrature, and weights by peak opacity: `gof study score`.
    """

    BARE: ClassVar = {"--published": "none"}
    FIGURES: ClassVar = (Scores,)

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Result of a reconstruction: ours, or any method's that docs/importers.md lists."""
    dataset: Path
    """Dataset folder: its pictures and, where it has them, true velocities."""
    out: Path | None = None
    """Folder for scores.json. Default, without --json: beside the result, where its older scores are replaced."""
    align: Path | None = None
    """Cameras of the method's own world (COLMAP folder, dataset.json, transforms.json, or JSON name -> 4x4
    world_to_camera), to move it into ours."""
    weights: Path | None = None
    """Folder with the weight file of LPIPS (docs/scores.md); without it that score is left out and named."""
    published: Annotated[str | None, tyro.conf.arg(metavar="[none|make|FOLDER]")] = None
    """Also the six picture figures that the paper's authors publish, by their definitions (docs/scores.md), and
    errors of depth, against maps in a FOLDER of `gof depth` or CAMERA/FRAME.npy in metres; "make": maps that are made
    now, as by `gof depth`, beside the scores; without a value or "none": without errors of depth."""
    images: bool = True
    """Do not render and score the held-out frames."""


def main(argv: list[str]) -> int:
    """Run `gof evaluate`."""
    config = read_options(EvaluateConfig, "evaluate", argv)
    files = _files(config)
    dataset = Dataset.open(config.dataset)
    depth, disparity = _depth_maps(config.published, dataset, files[0].parent)
    with progress_bar("evaluate") as progress:
        scores = evaluate(
            config.result,
            dataset,
            images=config.images,
            progress=progress,
            align=config.align,
            extras=Extras(config.weights, depth, dis if config.published else None, disparity, dis),
        )
    for path in files:  # first: the reader of what follows may leave (`| head`)
        scores.write(path)
    out = console()
    for of in (eve_table, velocity_table, picture_table, around_table, light_table, published_table):
        if (table := of(scores)).row_count:
            out.print(table)
    if scores.flow is not None:
        out.print(motion_table(scores.flow))
    for sentence in beaten_trivial_baselines(scores):
        out.print(sentence, highlight=False)
    if scores.flow_prior is not None:
        out.print(f"learned flow prior: {'used' if scores.flow_prior else 'not used'}")
    absent = scores.images.absent if scores.images else ()
    for note in (*scores.import_.notes, *scores.warnings, *absent):
        out.print("note:", note, style="yellow")
    out.print("seconds: " + ", ".join(f"{name} {seconds:.1f}" for name, seconds in scores.costs.items()))
    for path in files:
        out.print(f"scores written to {path}")
    return 0


def _files(config: EvaluateConfig) -> list[Path]:
    """Return where the scores go: to --out, to --json, or beside the result.

    Raises:
        GofError: the result or its folder is not there, or something in the way would be lost.
    """
    if not config.result.exists():
        raise DataFormatError(f"{config.result}: no such file or folder")
    more = figures_file()
    if config.out is None:
        return [_beside(config.result) if more is None else more]
    require_free(config.out / FILE)
    return [config.out / FILE] if more is None or more == config.out / FILE else [config.out / FILE, more]


def _beside(result: Path) -> Path:
    """scores.json beside a result, or in the folder of a reconstruction. Raises GofError: it is of another result."""
    path = beside(result if (result / "result.npz").is_file() else result.absolute(), FILE)
    if not path.exists() or may_overwrite():
        return path
    try:
        of = Scores.read(path).import_.path
    except DataFormatError as e:
        raise GofError(f"{path}: is in the way and holds no scores that can be read; give --out FOLDER") from e
    if of is None or Path(of).resolve() not in (result.resolve(), (result / "result.npz").resolve()):
        raise GofError(f"{path}: holds the scores of another result ({of or 'unknown'}); give --out FOLDER")
    return path


def _depth_maps(published: str | None, dataset: Dataset, out: Path) -> tuple[Path | None, Path | None]:
    """Folders of depth in metres and of relative inverse depth, as --published names them; None where there is none.

    Raises:
        GofError: the folder holds no maps; with "make", see `write_frame_depths`.
    """
    if published is None or published == "none":
        return None, None
    if published == "make":
        folder = out / MAPS
        with progress_bar("depth") as progress:
            write_frame_depths(dataset, dataset.test_frames, folder, None, progress)
    else:
        folder = Path(published)
    depth, disparity = (folder / kind if (folder / kind).is_dir() else None for kind in KINDS)
    if (depth, disparity) != (None, None):
        return depth, disparity
    if not any((folder / camera.name).is_dir() for camera in dataset.cameras):
        raise GofError(f"--published {folder}: holds neither depth/ nor CAMERA/ of this dataset; gof depth writes them")
    return folder, None


def velocity_table(scores: Scores) -> Table:
    """Return the velocities' scores with those of the trivial baselines; empty without true velocities."""
    table = Table(title="Velocity (DVE): lower L2 and higher CosSim are better", title_justify="left")
    for column in ("velocities", "L2", "CosSim", "what it is"):
        table.add_column(column, justify="right" if column in ("L2", "CosSim") else "left")
    if scores.dve:
        _add_own_rows(table, scores.dve)
    for name, trivial_baseline in scores.trivial_baselines.items():
        table.add_row(
            f"trivial: {name}",
            _number(trivial_baseline.l2),
            _number(trivial_baseline.cos_sim),
            trivial_baseline.meaning,
        )
    return table


def beaten_trivial_baselines(scores: Scores) -> list[str]:
    """Per figure a sentence: which trivial baselines the result beats in it, and which not; none where it is
    undefined."""
    sentences = []
    for key, label, sign in (("l2", "L2", -1), ("cos_sim", "CosSim", 1)):
        own = None if scores.dve is None else getattr(scores.dve, key)
        theirs = {name: getattr(c, key) for name, c in scores.trivial_baselines.items() if name not in BOUNDS}
        theirs = {name: value for name, value in theirs.items() if value is not None}
        if own is None or not theirs:
            continue
        beaten = [name for name, value in theirs.items() if sign * own > sign * value]
        others = [name for name in theirs if name not in beaten]
        sentence = f"{label} beats {', '.join(beaten) or 'no trivial baseline'}"
        sentences.append(f"{sentence}; not {', '.join(others)}" if others else sentence)
    return sentences


def _add_own_rows(table: Table, dve: VelocityScore) -> None:
    table.add_row(Text("this result", "bold"), _number(dve.l2), _number(dve.cos_sim), "all frames pooled")
    table.add_row(
        "  per frame",
        f"{_number(dve.l2_frame_mean)} ± {_number(dve.l2_frame_std)}",
        f"{_number(dve.cos_sim_frame_mean)} ± {_number(dve.cos_sim_frame_std)}",
        f"mean of {dve.frames_scored} frames",
    )
    table.add_row(
        "  fluctuation",
        _number(dve.fluctuation.l2),
        _number(dve.fluctuation.cos_sim),
        "after taking the mean per height from both; every mean scores 1 / 0",
    )
    if (settled := dve.settled) is not None:
        table.add_row(
            "  more nodes",
            f"{_number(settled.l2)} ± {settled.l2_off:.4f}",
            f"{_number(settled.cos_sim)} ± {settled.cos_sim_off:.4f}",
            f"{settled.order} nodes per axis, where digits hold; the paper's {dve.order} are above",
        )
    if dve.motion is not None:
        table.add_row(
            "  against its motion",
            _number(dve.motion.l2),
            _number(dve.motion.cos_sim),
            "its velocities and the motion of its Gaussians: 0 / 1 where they are one",
        )
    if dve.within_sd is not None:
        meaning = f"{dve.within_sd:.0%} within one standard deviation of the truth (68 % if v_sd is right)"
        table.add_row("  its own uncertainty", "", "", meaning)


def eve_table(scores: Scores) -> Table:
    """Return the velocities' scores where the fire is, which rank; empty without the fire's true light."""
    table = Table(title="Velocity where the fire is (EVE), which ranks", title_justify="left")
    for column in ("velocities", "L2", "CosSim", "what it is"):
        table.add_column(column, justify="right" if column in ("L2", "CosSim") else "left")
    if scores.dve is None or (eve := scores.dve.eve) is None:
        return table
    own = [
        _number(value) if sd is None else f"{_number(value)} ± {_number(sd)}"
        for value, sd in ((eve.l2, eve.l2_sd), (eve.cos_sim, eve.cos_sim_sd))
    ]
    where = f"its visible Gaussians; none at {eve.empty:.1%} of the light"
    table.add_row(Text("this result", "bold"), *own, where)
    rest = eve.fluctuation
    table.add_row("  fluctuation", _number(rest.l2), _number(rest.cos_sim), "without each place's own mean over time")
    for name, found in eve.baselines.items():
        table.add_row(f"trivial: {name}", _number(found.l2), _number(found.cos_sim), BASELINES[name])
    return table


def picture_table(scores: Scores) -> Table:
    """Return the pictures' scores with those of the plate, and of the two frames around; scores that no picture has
    are left out."""
    table = Table(title=f"Held-out pictures{_at_size(scores)}", title_justify="left")
    around = scores.psnr_between is not None  # of the very camera: no method has them for a view that was not filmed
    for column in ("score", "result", "background alone", *(("two frames around",) if around else ())):
        table.add_column(column, justify="left" if column == "score" else "right")
    for key, label, digits in PICTURE_ROWS:
        own = getattr(scores, key)
        plate = getattr(scores, f"{key}_plate", None)
        if own is not None or plate is not None:
            row = [label + _counted(scores, key), _number(own, digits), _number(plate, digits)]
            table.add_row(*row, *([_number(getattr(scores, f"{key}_between", None), digits)] if around else []))
    return table


def around_table(scores: Scores) -> Table:
    """Return the pictures from all around, by the angle from the nearest given camera; empty without such cameras."""
    table = Table(title="From all around: the flame over backgrounds not given to the result", title_justify="left")
    for column in ("angle", "cameras", "PSNR flame (dB)", "SSIM flame", "sharpness / true", "false colour"):
        table.add_column(column, justify="right")
    for angle in sorted({round(score.angle_deg) for score in scores.around}):
        those = [score for score in scores.around if round(score.angle_deg) == angle]
        means = {
            key: [value for value in (getattr(score, key) for score in those) if value is not None]
            for key in ("psnr_flame", "ssim_flame", "gradient_ratio", "false_colour")
        }
        psnr, ssim, sharp, false = (sum(found) / len(found) if found else None for found in means.values())
        share = "-" if false is None else f"{false:.1%}"
        table.add_row(f"{angle}°", str(len(those)), _number(psnr, 2), _number(ssim), _number(sharp, 2), share)
    return table


def light_table(scores: Scores) -> Table:
    """Return where the light is in space; empty without true light."""
    table = Table(title="The light in space, against the true light", title_justify="left")
    for column in ("score", "result", "truth", "meaning"):
        table.add_column(column, justify="left" if column in ("score", "meaning") else "right")
    light = scores.light
    if light is not None:
        table.add_row("relative L2", _number(light.relative_l2), "0", "of light per cell, 32 cells along the flame")
        table.add_row("correlation", _number(light.correlation), "1", "cosine of the two")
        table.add_row("outside", f"{light.outside:.1%}", "0.0%", "light more than a cell away from all flame")
        table.add_row("smear", _number(light.smear, 2), "1", "extent along the middle view over extent across")
    return table


def _counted(scores: Scores, key: str) -> str:
    """Return the number of pictures of a mean, where not all have the figure: of a flame where there is none, say."""
    pictures = scores.images.pictures if scores.images else ()
    count = sum(getattr(picture, key, None) is not None for picture in pictures)
    return f", {count} of {len(pictures)} pictures" if 0 < count < len(pictures) else ""


def published_table(scores: Scores) -> Table:
    """Return the authors' figures beside what they publish; empty without --published."""
    table = Table(title=f"Held-out pictures{_at_size(scores)}, by the authors' definitions", title_justify="left")
    for column in ("score", "result", "published, other footage"):
        table.add_column(column, justify="left" if column == "score" else "right")
    if scores.published is not None:
        for key, label, digits in PUBLISHED_ROWS:
            table.add_row(label, _number(getattr(scores.published, key), digits), _number(getattr(THEIRS, key), digits))
    return table


def _at_size(scores: Scores) -> str:
    """Return the pictures' size, in words that follow others."""
    words = in_words(scores.images.sizes_px) if scores.images else ""
    return f" at {words}" if words else ""


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
