"""`gof evaluate`: every score of a result against a dataset, with the controls and what each part cost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.table import Table
from rich.text import Text

from gof.commands.foreign_options import ForeignOptions
from gof.core.cameras import in_words
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.evaluate import Extras, Scores, evaluate
from gof.evaluate.controls import BOUNDS
from gof.evaluate.published import THEIRS
from gof.evaluate.scores import VelocityScore
from gof.host.progress import progress_bar
from gof.host.terminal import console
from gof.reconstruct.optical_flow import dis

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
    """Score a reconstruction against a dataset: DVE (L2, CosSim) with controls, PSNR and SSIM on held-out frames."""

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Result of a reconstruction: ours, or any method's that docs/importers.md lists."""
    truth: Path
    """Dataset folder with the true pictures and velocities."""
    other_method: tyro.conf.OmitArgPrefixes[ForeignOptions]
    align: Path | None = None
    """Cameras of the method's own world (COLMAP folder, dataset.json, transforms.json, or JSON name -> 4x4
    world_to_camera), to move it into ours."""
    out: Path | None = None
    """Folder to write scores.json to; an older scores.json there is replaced. Default, without --json: beside the
    result, where only older scores of the same result are replaced."""
    json: Path | None = None
    """File to write the scores to."""
    order: Literal[1, 3, 5, 7] = 3
    """Gauss-Hermite nodes per axis for the expected true velocity."""
    opacity: Literal["temporal", "base"] = "temporal"
    """Weight Gaussians by their opacity at each time, or by their peak opacity at all times."""
    weights: Path | None = None
    """Folder with the weight file of LPIPS (docs/leaderboard.md); without it that score is left out and named."""
    depth: Path | None = None
    """Folder of predicted or true depth maps CAMERA/FRAME.npy, for RMSE_depth."""
    flame_only: bool = False
    """Say that another method's result is a flame without a room: it is drawn over the fire-free plates, as ours is."""
    published: bool = False
    """Also the six picture figures that the paper's authors publish, by their definitions (docs/leaderboard.md)."""
    disparity: Path | None = None
    """Folder of maps of relative inverse depth CAMERA/FRAME.npy, for --published's error of depth."""
    images: bool = True
    """Also render the held-out frames and score them."""


def main(argv: list[str]) -> int:
    """The command line of `gof evaluate`."""
    config = tyro.cli(EvaluateConfig, prog="gof evaluate", args=argv)
    if config.disparity is not None and not config.published:
        raise GofError("--disparity is for --published's error of depth; give --published too, or leave it out")
    files = _files(config)
    foreign = config.other_method.options()  # numbers that are none are named before anything is read
    dataset = Dataset.open(config.truth)
    with progress_bar("evaluate") as progress:
        scores = evaluate(
            config.result,
            dataset,
            order=config.order,
            opacity=config.opacity,
            images=config.images,
            progress=progress,
            foreign=foreign,
            align=config.align,
            extras=Extras(config.weights, config.depth, dis if config.published else None, config.disparity),
            flame_only=config.flame_only,
        )
    out = console()
    for table in (velocity_table(scores), picture_table(scores), published_table(scores)):
        if table.row_count:
            out.print(table)
    for sentence in beaten_controls(scores):
        out.print(sentence, highlight=False)
    if scores.flow_prior is not None:
        out.print(f"learned flow prior: {'used' if scores.flow_prior else 'not used'}")
    absent = scores.images.absent if scores.images else ()
    for note in (*scores.import_.notes, *scores.warnings, *absent):
        out.print("note:", note, style="yellow")
    out.print("seconds: " + ", ".join(f"{name} {seconds:.1f}" for name, seconds in scores.costs.items()))
    for path in files:
        scores.write(path)
        out.print(f"scores written to {path}")
    return 0


def _files(config: EvaluateConfig) -> list[Path]:
    """Where the scores go: beside the result, where nothing else was asked for.

    Raises:
        GofError: what is beside it would be lost.
    """
    if config.out is None and config.json is None:
        return [_beside(config.result)]
    files = [] if config.out is None else [config.out / "scores.json"]
    if config.json is not None and config.json not in files:
        files.append(config.json)
    return files


def _beside(result: Path) -> Path:
    """scores.json beside a result, or in the folder of a reconstruction. Raises GofError: it is of another result."""
    path = (result if (result / "result.npz").is_file() else result.absolute().parent) / "scores.json"
    if not path.exists():
        return path
    try:
        of = Scores.read(path).import_.path
    except DataFormatError as e:
        raise GofError(f"{path}: is in the way and holds no scores that can be read; give --out FOLDER") from e
    if of is None or Path(of).resolve() not in (result.resolve(), (result / "result.npz").resolve()):
        raise GofError(f"{path}: holds the scores of another result ({of or 'unknown'}); give --out FOLDER")
    return path


def velocity_table(scores: Scores) -> Table:
    """The velocities' scores with those of the controls; empty without true velocities."""
    table = Table(title="Velocity (DVE): lower L2 and higher CosSim are better", title_justify="left")
    for column in ("velocities", "L2", "CosSim", "what it is"):
        table.add_column(column, justify="right" if column in ("L2", "CosSim") else "left")
    if scores.dve:
        _add_own_rows(table, scores.dve)
    for name, control in scores.controls.items():
        table.add_row(f"control: {name}", _number(control.l2), _number(control.cos_sim), control.meaning)
    return table


def beaten_controls(scores: Scores) -> list[str]:
    """Per figure a sentence: which controls the result beats in it, and which not; none where it is undefined."""
    sentences = []
    for key, label, sign in (("l2", "L2", -1), ("cos_sim", "CosSim", 1)):
        own = None if scores.dve is None else getattr(scores.dve, key)
        theirs = {name: getattr(c, key) for name, c in scores.controls.items() if name not in BOUNDS}
        theirs = {name: value for name, value in theirs.items() if value is not None}
        if own is None or not theirs:
            continue
        beaten = [name for name, value in theirs.items() if sign * own > sign * value]
        others = [name for name in theirs if name not in beaten]
        sentence = f"{label} beats {', '.join(beaten) or 'no control'}"
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
    if dve.within_sd is not None:
        meaning = f"{dve.within_sd:.0%} within one standard deviation of the truth (68 % if v_sd is right)"
        table.add_row("  its own doubt", "", "", meaning)
    if emission := dve.on_emission:
        table.add_row(
            "  on the emission",
            _number(emission.l2),
            _number(emission.cos_sim),
            f"where the flame shines; no Gaussian at {emission.uncovered:.1%} of it",
        )
        table.add_row(
            "    constant there",
            _number(emission.constant.l2),
            _number(emission.constant.cos_sim),
            "the mean true velocity of the same places",
        )


def picture_table(scores: Scores) -> Table:
    """The pictures' scores with those of the plate; scores that no picture has are left out."""
    table = Table(title=f"Held-out pictures{_at_size(scores)}", title_justify="left")
    for column in ("score", "result", "fire-free plate alone"):
        table.add_column(column, justify="left" if column == "score" else "right")
    for key, label, digits in PICTURE_ROWS:
        own = getattr(scores, key)
        plate = getattr(scores, f"{key}_plate", None)
        if own is not None or plate is not None:
            table.add_row(label + _counted(scores, key), _number(own, digits), _number(plate, digits))
    return table


def _counted(scores: Scores, key: str) -> str:
    """How many pictures a mean is of, where not all have the figure: of a flame where there is none, say."""
    pictures = scores.images.pictures if scores.images else ()
    count = sum(getattr(picture, key, None) is not None for picture in pictures)
    return f", {count} of {len(pictures)} pictures" if 0 < count < len(pictures) else ""


def published_table(scores: Scores) -> Table:
    """The authors' figures beside what they publish; empty when not asked for."""
    table = Table(title=f"Held-out pictures{_at_size(scores)}, by the authors' definitions", title_justify="left")
    for column in ("score", "result", "published, other footage"):
        table.add_column(column, justify="left" if column == "score" else "right")
    if scores.published is not None:
        for key, label, digits in PUBLISHED_ROWS:
            table.add_row(label, _number(getattr(scores.published, key), digits), _number(getattr(THEIRS, key), digits))
    return table


def _at_size(scores: Scores) -> str:
    """The pictures' size, in words that follow others."""
    words = in_words(scores.images.sizes_px) if scores.images else ""
    return f" at {words}" if words else ""


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
