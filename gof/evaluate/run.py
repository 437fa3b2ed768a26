"""`gof evaluate`: every score of a result against a dataset, with the controls and what each part cost."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.errors import DataFormatError, MissingDependencyError
from gof.evaluate import controls as control_module
from gof.evaluate.depth import read_depth, rmse_depth
from gof.evaluate.dve import dve_sequence, sanity_warnings, state_at
from gof.evaluate.image import psnr, ssim
from gof.gaussians import TransientGaussians
from gof.io.convert import ForeignOptions
from gof.io.files import write_json
from gof.io.importers import ImportOptions, Trajectory, read_result
from gof.io.importers.similarity import align_cameras, read_cameras, transformed

Progress = Callable[..., None]  # progress(done, total, stage=...)


@dataclass(frozen=True)
class Extras:
    """Material for scores that need more than the dataset."""

    weights: Path | None = None  # folder of weight files, for LPIPS
    depth: Path | None = None  # folder of CAMERA/FRAME.npy depth maps, for RMSE_depth


def evaluate(result: Path | TransientGaussians | Trajectory, dataset: Dataset, order: int = 3,
             opacity: Literal["temporal", "base"] = "temporal", images: bool = True, progress: Progress | None = None,
             foreign: ImportOptions | None = None, align: Path | None = None, extras: Extras | None = None) -> dict[str, Any]:
    """All scores of a result.

    Pictures: every held-out frame of every camera, rendered over the fire-free plate (over black when the result brings
    static Gaussians of its own); `flame` scores count pixels of the true flame mask only. Velocities: DVE on every frame of
    the clip that has a true velocity field.

    Args:
        result: file or folder of any known method (gof.io.importers), or the Gaussians.
        dataset: what it was made from.
        order, opacity: of `dve`.
        images: also render and score pictures.
        progress: progress(done, total, stage=name).
        foreign: what a foreign result does not say; its frame time is the dataset's unless given.
        align: cameras of the method's own world (see `read_cameras`); the result is moved by the similarity that maps them onto
            the dataset's.
        extras: material for LPIPS and RMSE_depth; without it they are named as absent.
    Returns:
        JSON-ready dict: "import" {"method", "path", "options", "notes", "alignment"}, "dve" (see DVESequence.to_dict), "controls" {name: {"l2", "cos_sim", "skill", ...}}, "psnr",
        "psnr_flame", "psnr_plate", "psnr_flame_plate", "ssim", "ssim_flame", "ssim_plate", "ssim_flame_plate" (means over
        pictures; None where undefined; likewise "flip" and "lpips" where available, "temporal_l2" and "rmse_depth"), "images" (spread,
        every picture, and "absent": which scores are not there and why), "costs" {part: seconds}, "warnings".
    Raises:
        GofError: see `dve_sequence`.   DataFormatError: a file is damaged.
    """
    costs: dict[str, float] = {}
    progress = progress or (lambda *a, **k: None)
    with _timed(costs, "load"):
        gaussians, origin = _load(result, dataset, foreign or ImportOptions(), align)
    scores: dict[str, Any] = {"gaussians": len(gaussians), "dynamic_gaussians": int(gaussians.dynamic.sum()), "import": origin, "warnings": []}
    if dataset.meta.get("velocity"):
        with _timed(costs, "dve"):
            scores |= _velocity_scores(gaussians, dataset, order, opacity, progress)
    else:
        scores |= {"dve": None, "controls": {}}
        scores["warnings"].append("the dataset has no true velocity field, so there is no DVE")
    if images:
        scores |= _image_scores(gaussians, dataset, costs, extras or Extras(), progress)
    return scores | {"costs": {name: round(seconds, 3) for name, seconds in costs.items()}}


def _load(result, dataset: Dataset, foreign: ImportOptions, align: Path | None) -> tuple[TransientGaussians | Trajectory, dict[str, Any]]:
    if isinstance(result, (TransientGaussians, Trajectory)):
        gaussians, origin = result, {"method": "memory", "notes": []}
    else:
        options = replace(foreign, frame_time_s=foreign.frame_time_s or dataset.frame_time_s or None)
        imported = read_result(result, options)
        gaussians, origin = imported.gaussians, {"method": imported.method, "notes": imported.notes, "path": str(imported.path),
                                                 "options": asdict(options) | {"world": options.world and str(options.world)}}
    if align is None:
        return gaussians, origin
    found = align_cameras(read_cameras(align), {c.name: c.world_to_camera for c in dataset.cameras})
    origin["alignment"] = {"matrix": found.matrix.tolist(), "scale": found.scale, "position_rms_m": found.position_rms_m,
                           "rotation_max_deg": found.rotation_max_deg}
    origin["notes"] = [*origin["notes"], f"moved by the similarity of {align}: scale {found.scale:.4g}; cameras then {found.position_rms_m * 1000:.2g} mm "
                       f"(rms) and at most {found.rotation_max_deg:.2g} degrees off"]
    moved = gaussians.transformed(found.matrix) if isinstance(gaussians, Trajectory) else transformed(gaussians, found.matrix)
    return moved, origin


@contextmanager
def _timed(costs: dict[str, float], name: str):
    start = time.perf_counter()
    yield
    costs[name] = costs.get(name, 0.0) + time.perf_counter() - start


def _velocity_scores(gaussians: TransientGaussians | Trajectory, dataset: Dataset, order: int, opacity: str,
                     progress: Progress) -> dict[str, Any]:
    truth = dataset.velocity
    slack = dataset.frame_time_s / 2
    in_clip = (truth.times_s >= dataset.times_s[0] - slack) & (truth.times_s <= dataset.times_s[-1] + slack)
    if not in_clip.any():
        raise DataFormatError(f"{dataset.path}: the velocity store covers {truth.times_s[0]:g}..{truth.times_s[-1]:g} s, the "
                              f"clip {dataset.times_s[0]:g}..{dataset.times_s[-1]:g} s: their clocks do not overlap")
    score = dve_sequence(gaussians, truth, truth.times_s[in_clip], order, opacity,
                         progress=lambda done, total: progress(done, total, stage="DVE"))
    dve = score.to_dict() | {"order": order, "opacity": opacity}
    controls = {}
    for name, control in score.controls.items():
        controls[name] = control.to_dict() | {"meaning": control_module.CONTROLS[name]}
        controls[name].pop("frames")
        dve[f"skill_over_{name}"] = control_module.skill(score.pooled, control.pooled)
    return {"dve": dve, "controls": controls, "warnings": sanity_warnings(score)}


def _image_scores(gaussians: TransientGaussians | Trajectory, dataset: Dataset, costs: dict[str, float], extras: Extras,
                  progress: Progress) -> dict[str, Any]:
    from gof.evaluate.image import temporal_l2
    from gof.render import render

    own_background = not gaussians.dynamic.all()
    single, absent = _single_image_scores(extras)
    rows: list[dict[str, Any]] = []
    total = len(dataset.test_frames) * len(dataset.cameras)

    def draw(number: int, frame: int, plate: np.ndarray) -> dict[str, np.ndarray]:
        time_s = float(dataset.camera_times_s(number)[frame])
        with _timed(costs, "render"):
            return render(state_at(gaussians, time_s), dataset.cameras[number], time_s, background=(0, 0, 0) if own_background else plate)

    for number, camera in enumerate(dataset.cameras):
        plate = dataset.static(number)
        for frame in dataset.test_frames:
            drawn = draw(number, frame, plate)
            after = frame + 1 if frame + 1 < len(dataset.times_s) else None
            next_drawn = None if after is None else draw(number, after, plate)
            with _timed(costs, "images"):
                image, truth, mask = np.clip(drawn["color"], 0, 1), dataset.image(number, frame), dataset.mask(number, frame)
                row = {"camera": camera.name, "frame": frame, "flame_share": None if mask is None else float(mask.mean())}
                for suffix, picture in (("", image), ("_plate", plate)):
                    for name, score in single.items():
                        row[f"{name}{suffix}"] = score(picture, truth)
                        if name != "lpips":
                            row[f"{name}_flame{suffix}"] = None if mask is None else score(picture, truth, mask)
                if next_drawn is not None:
                    either = None if mask is None else np.maximum(mask, dataset.mask(number, after))
                    row["temporal_l2"] = temporal_l2((image, np.clip(next_drawn["color"], 0, 1)), (truth, dataset.image(number, after)), either)
                    row["temporal_l2_plate"] = 1.0 if row["temporal_l2"] is not None else None
                if extras.depth is not None:
                    seen = (drawn["alpha"] > 0.1) * (1.0 if mask is None else mask)
                    found = rmse_depth(drawn["depth"], read_depth(extras.depth, camera.name, frame), seen)
                    row["rmse_depth"] = None if found is None else found.rmse
                rows.append(row)
            progress(len(rows), total, stage="pictures")
    out: dict[str, Any] = {}
    spread = {}
    for key in dict.fromkeys(k for row in rows for k in row if k not in ("camera", "frame", "flame_share")):
        values = [r[key] for r in rows if r.get(key) is not None and np.isfinite(r[key])]
        out[key] = float(np.mean(values)) if values else None
        spread[f"{key}_std"] = float(np.std(values)) if values else None
    for row in rows:  # identical pictures have an infinite PSNR, which JSON has no number for
        row |= {k: None for k, v in row.items() if isinstance(v, float) and not np.isfinite(v)}
    return out | {"images": {"count": len(rows), "absent": absent, **spread, "pictures": rows}}


def _single_image_scores(extras: Extras) -> tuple[dict[str, Callable], list[str]]:
    """Scores of one picture that can be computed here, and for each of the others why not."""
    from gof.evaluate import perceptual

    scores, absent = {"psnr": psnr, "ssim": ssim}, []
    probe = np.zeros((64, 64, 3))
    optional = {"flip": perceptual.flip}
    if extras.weights is not None:
        optional["lpips"] = lambda image, truth: perceptual.lpips(image, truth, extras.weights)
    else:
        absent.append("LPIPS: give --weights, the folder with its weight files")
    for name, score in optional.items():
        try:
            score(probe, probe)
            scores[name] = score
        except MissingDependencyError as e:
            absent.append(str(e))
    return scores, absent


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
        velocity.add_row("  per frame", *(f"{number(d[f'{k}_frame_mean'])} ± {number(d[f'{k}_frame_std'])}"
                                          for k in ("l2", "cos_sim")), f"mean of {d['frames_scored']} frames")
        velocity.add_row("  fluctuation", number(d["fluctuation"]["l2"]), number(d["fluctuation"]["cos_sim"]),
                         "after taking the mean per height from both; every mean scores 1 / 0")
        for name, c in scores["controls"].items():
            velocity.add_row(f"control: {name}", number(c["l2"]), number(c["cos_sim"]), c["meaning"])
    pictures = Table(title="Held-out pictures", title_justify="left")
    for column in ("score", "result", "fire-free plate alone"):
        pictures.add_column(column, justify="left" if column == "score" else "right")
    for key, label, digits in (("psnr_flame", "PSNR flame (dB)", 2), ("ssim_flame", "SSIM flame", 4), ("flip_flame", "FLIP flame", 4),
                               ("psnr", "PSNR (dB)", 2), ("ssim", "SSIM", 4), ("flip", "FLIP", 4), ("lpips", "LPIPS", 4),
                               ("temporal_l2", "change between frames, relative L2", 3), ("rmse_depth", "RMSE depth", 3)):
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
    """Folder with LPIPS weight files; without it LPIPS is left out."""
    depth: Path | None = None
    """Folder of predicted or true depth maps CAMERA/FRAME.npy, for RMSE_depth."""
    images: bool = True
    """Also render the held-out frames and score them."""


def main(argv: list[str]) -> int:
    """The command line of `gof evaluate`."""
    from rich.console import Console

    from gof.stages import progress_bar

    config = tyro.cli(EvaluateConfig, prog="gof evaluate", args=argv)
    dataset = Dataset.open(config.truth)
    with progress_bar("evaluate") as progress:
        scores = evaluate(config.result, dataset, config.order, config.opacity, config.images, progress,
                          config.foreign.options(), config.align, Extras(config.weights, config.depth))
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
