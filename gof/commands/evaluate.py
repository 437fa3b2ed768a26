"""`gof evaluate`: every score of a result against a dataset, with the controls and what each part cost."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.errors import DataFormatError
from gof.evaluate import controls as control_module
from gof.evaluate.dve import dve_sequence, sanity_warnings
from gof.evaluate.emission import FlameGrid, score_on_emission
from gof.evaluate.image_scores import Extras, Progress, image_scores, timed
from gof.gaussians import TransientGaussians
from gof.io.convert import ForeignOptions
from gof.io.files import write_json
from gof.io.importers import ImportOptions, Trajectory, read_result
from gof.io.importers.similarity import align_cameras, read_cameras, transformed
from gof.plates import background


def evaluate(
    result: Path | TransientGaussians | Trajectory,
    dataset: Dataset,
    order: int = 3,
    opacity: Literal["temporal", "base"] = "temporal",
    images: bool = True,
    progress: Progress | None = None,
    foreign: ImportOptions | None = None,
    align: Path | None = None,
    extras: Extras | None = None,
) -> dict[str, Any]:
    """All scores of a result.

    Pictures: every held-out frame of every camera, rendered over the result's own plate (`gof.plates`), else the fire-free one
    (over black when the result brings static Gaussians of its own); `flame` scores count pixels of the true flame mask only.
    Pixels of the sync board do not count. Velocities: DVE on every frame of the clip that has a true velocity field.

    Args:
        result: file or folder of any known method (gof.io.importers), or the Gaussians.
        dataset: what it was made from.
        order, opacity: of `dve`.
        images: also render and score pictures.
        progress: progress(done, total, stage=name).
        foreign: what a foreign result does not say; its frame time is the dataset's unless given.
        align: cameras of the method's own world (see `read_cameras`); the result is moved by the similarity that maps them onto
            the dataset's.
        extras: material for LPIPS, CGVQM and RMSE_depth; without it they are named as absent.
    Returns:
        JSON-ready dict: "import" {"method", "path", "options", "notes", "alignment"}, "dve" (see DVESequence.to_dict;
        with "on_emission", None without a flame grid in the dataset), "controls"
        {name: {"l2", "cos_sim", "skill", ...}}, "psnr", "psnr_flame", "psnr_plate", "psnr_flame_plate", likewise "ssim" and, where
        available, "flip" and "lpips", "temporal_l2", "rmse_depth", "cgvqm_2" and "cgvqm_5" (means over pictures; None where
        undefined), "images" (spread, every picture, "board_share" of pixels that do not count, and "absent": which scores are
        not there and why), "costs" {part: seconds}, "warnings".
    Raises:
        GofError: see `dve_sequence`.   DataFormatError: a file is damaged.
    """
    costs: dict[str, float] = {}
    progress = progress or (lambda *a, **k: None)
    with timed(costs, "load"):
        gaussians, origin = _load(result, dataset, foreign or ImportOptions(), align)
    scores: dict[str, Any] = {
        "gaussians": len(gaussians),
        "dynamic_gaussians": int(gaussians.dynamic.sum()),
        "import": origin,
        "warnings": [],
    }
    if dataset.meta.get("velocity"):
        with timed(costs, "dve"):
            scores |= _velocity_scores(gaussians, dataset, order, opacity, progress)
    else:
        scores |= {"dve": None, "controls": {}}
        scores["warnings"].append("the dataset has no true velocity field, so there is no DVE")
    if images:
        own = result if isinstance(result, Path) else None
        plates = [background(dataset, number, own) for number in range(len(dataset.cameras))]
        scores |= image_scores(gaussians, dataset, plates, costs, extras or Extras(), progress)
    return scores | {"costs": {name: round(seconds, 3) for name, seconds in costs.items()}}


def _load(
    result, dataset: Dataset, foreign: ImportOptions, align: Path | None
) -> tuple[TransientGaussians | Trajectory, dict[str, Any]]:
    if isinstance(result, (TransientGaussians, Trajectory)):
        gaussians, origin = result, {"method": "memory", "notes": []}
    else:
        options = replace(foreign, frame_time_s=foreign.frame_time_s or dataset.frame_time_s or None)
        imported = read_result(result, options)
        gaussians, origin = (
            imported.gaussians,
            {
                "method": imported.method,
                "notes": imported.notes,
                "path": str(imported.path),
                "options": asdict(options) | {"world": options.world and str(options.world)},
            },
        )
    if align is None:
        return gaussians, origin
    found = align_cameras(read_cameras(align), {c.name: c.world_to_camera for c in dataset.cameras})
    origin["alignment"] = {
        "matrix": found.matrix.tolist(),
        "scale": found.scale,
        "position_rms_m": found.position_rms_m,
        "rotation_max_deg": found.rotation_max_deg,
    }
    origin["notes"] = [
        *origin["notes"],
        f"moved by the similarity of {align}: scale {found.scale:.4g}; cameras then {found.position_rms_m * 1000:.2g} mm "
        f"(rms) and at most {found.rotation_max_deg:.2g} degrees off",
    ]
    moved = (
        gaussians.transformed(found.matrix)
        if isinstance(gaussians, Trajectory)
        else transformed(gaussians, found.matrix)
    )
    return moved, origin


def _velocity_scores(
    gaussians: TransientGaussians | Trajectory, dataset: Dataset, order: int, opacity: str, progress: Progress
) -> dict[str, Any]:
    truth = dataset.velocity
    slack = dataset.frame_time_s / 2
    in_clip = (truth.times_s >= dataset.times_s[0] - slack) & (truth.times_s <= dataset.times_s[-1] + slack)
    if not in_clip.any():
        raise DataFormatError(
            f"{dataset.path}: the velocity store covers {truth.times_s[0]:g}..{truth.times_s[-1]:g} s, the "
            f"clip {dataset.times_s[0]:g}..{dataset.times_s[-1]:g} s: their clocks do not overlap"
        )
    score = dve_sequence(
        gaussians,
        truth,
        truth.times_s[in_clip],
        order,
        opacity,
        progress=lambda done, total: progress(done, total, stage="DVE"),
    )
    dve = score.to_dict() | {"order": order, "opacity": opacity}
    controls = {}
    for name, control in score.controls.items():
        controls[name] = control.to_dict() | {"meaning": control_module.CONTROLS[name]}
        controls[name].pop("frames")
        dve[f"skill_over_{name}"] = control_module.skill(score.pooled, control.pooled)
    grid = dataset.path / "grids" / "flame.zarr"
    dve["on_emission"] = (
        None
        if not grid.exists()
        else score_on_emission(
            gaussians,
            truth,
            FlameGrid(grid),
            np.array(score.times_s),
            progress=lambda done, total: progress(done, total, stage="on emission"),
        ).to_dict()
    )
    return {"dve": dve, "controls": controls, "warnings": sanity_warnings(score)}


def table(scores: dict[str, Any]):
    """A rich table of the scores with the controls beside them."""
    from rich.table import Table

    def number(value, digits=3):
        return "-" if value is None else f"{value:.{digits}f}"

    velocity = Table(title="Velocity (DVE): lower L2 and higher CosSim are better", title_justify="left")
    for column in ("velocities", "L2", "CosSim", "what it is"):
        velocity.add_column(column, justify="right" if column in ("L2", "CosSim") else "left")
    if scores.get("dve"):
        d = scores["dve"]
        velocity.add_row("[bold]this result", number(d["l2"]), number(d["cos_sim"]), "all frames pooled")
        velocity.add_row(
            "  per frame",
            *(f"{number(d[f'{k}_frame_mean'])} ± {number(d[f'{k}_frame_std'])}" for k in ("l2", "cos_sim")),
            f"mean of {d['frames_scored']} frames",
        )
        velocity.add_row(
            "  fluctuation",
            number(d["fluctuation"]["l2"]),
            number(d["fluctuation"]["cos_sim"]),
            "after taking the mean per height from both; every mean scores 1 / 0",
        )
        if e := d["on_emission"]:
            velocity.add_row(
                "  on the emission",
                number(e["l2"]),
                number(e["cos_sim"]),
                f"where the flame shines; no Gaussian at {e['uncovered']:.1%} of it",
            )
            velocity.add_row(
                "    constant there",
                number(e["constant"]["l2"]),
                number(e["constant"]["cos_sim"]),
                "the mean true velocity of the same places",
            )
        for name, c in scores["controls"].items():
            velocity.add_row(f"control: {name}", number(c["l2"]), number(c["cos_sim"]), c["meaning"])
    pictures = Table(title="Held-out pictures", title_justify="left")
    for column in ("score", "result", "fire-free plate alone"):
        pictures.add_column(column, justify="left" if column == "score" else "right")
    for key, label, digits in (
        ("psnr_flame", "PSNR flame (dB)", 2),
        ("ssim_flame", "SSIM flame", 4),
        ("flip_flame", "FLIP flame", 4),
        ("psnr", "PSNR (dB)", 2),
        ("ssim", "SSIM", 4),
        ("flip", "FLIP", 4),
        ("lpips", "LPIPS", 4),
        ("temporal_l2", "change between frames, relative L2", 3),
        ("cgvqm_2", "CGVQM-2 of the whole video, 0..100", 2),
        ("cgvqm_5", "CGVQM-5 of the whole video, 0..100", 2),
        ("rmse_depth", "RMSE depth", 3),
    ):
        if key in scores:
            pictures.add_row(label, number(scores[key], digits), number(scores.get(f"{key}_plate"), digits))
    return velocity, pictures


@dataclass
class EvaluateConfig:
    """Score a reconstruction against a dataset: DVE (L2, CosSim) with controls, PSNR and SSIM on held-out frames."""

    result: tyro.conf.Positional[Path]
    """Result of a reconstruction: ours, or any method's that docs/importers.md lists."""
    truth: Path
    """Dataset folder with the true pictures and velocities."""
    foreign: tyro.conf.OmitArgPrefixes[ForeignOptions]
    align: Path | None = None
    """Cameras of the method's own world (COLMAP folder, dataset.json, or JSON name -> 4x4 world_to_camera), to move it into ours."""
    out: Path | None = None
    """Folder to write scores.json to; an older scores.json there is replaced."""
    json: Path | None = None
    """File to write the scores to."""
    order: Literal[1, 3, 5, 7] = 3
    """Gauss-Hermite nodes per axis for the expected true velocity."""
    opacity: Literal["temporal", "base"] = "temporal"
    """Weight Gaussians by their opacity at each time, or by their peak opacity at all times."""
    weights: Path | None = None
    """Folder with weight files of LPIPS and CGVQM (docs/dve.md); what is not there is left out and named."""
    depth: Path | None = None
    """Folder of predicted or true depth maps CAMERA/FRAME.npy, for RMSE_depth."""
    images: bool = True
    """Also render the held-out frames and score them."""


def main(argv: list[str]) -> int:
    """The command line of `gof evaluate`."""
    from rich.console import Console

    from gof.progress import progress_bar

    config = tyro.cli(EvaluateConfig, prog="gof evaluate", args=argv)
    dataset = Dataset.open(config.truth)
    with progress_bar("evaluate") as progress:
        scores = evaluate(
            config.result,
            dataset,
            config.order,
            config.opacity,
            config.images,
            progress,
            config.foreign.options(),
            config.align,
            Extras(config.weights, config.depth),
        )
    console = Console()
    for t in table(scores):
        if t.row_count:
            console.print(t)
    for warning in scores["import"]["notes"] + scores["warnings"] + scores.get("images", {}).get("absent", []):
        console.print("note:", warning, style="yellow", markup=False, highlight=False)
    console.print("seconds: " + ", ".join(f"{name} {seconds:.1f}" for name, seconds in scores["costs"].items()))
    for path in {config.out and config.out / "scores.json", config.json} - {None}:
        write_json(path, scores)
        console.print(f"scores written to {path}")
    return 0
