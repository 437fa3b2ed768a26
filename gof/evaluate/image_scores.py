"""Scores of pictures and videos: a result drawn at the held-out frames, against what the cameras saw."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gof.dataset import Dataset
from gof.errors import MissingDependencyError
from gof.evaluate import perceptual, video
from gof.evaluate.depth import read_depth, rmse_depth
from gof.evaluate.dve import state_at
from gof.evaluate.image import psnr, ssim, temporal_l2
from gof.gaussians import TransientGaussians
from gof.io.importers import Trajectory

Progress = Callable[..., None]  # progress(done, total, stage=...)
Draw = Callable[[int, int], dict[str, np.ndarray]]  # (camera, frame) -> what `gof.render.render` gives


@dataclass(frozen=True)
class Extras:
    """Material for scores that need more than the dataset."""

    weights: Path | None = None  # folder of weight files, for LPIPS and CGVQM
    depth: Path | None = None  # folder of CAMERA/FRAME.npy depth maps, for RMSE_depth


@contextmanager
def timed(costs: dict[str, float], name: str):
    """Add the seconds of a block to costs[name]."""
    start = time.perf_counter()
    yield
    costs[name] = costs.get(name, 0.0) + time.perf_counter() - start


def image_scores(
    gaussians: TransientGaussians | Trajectory,
    dataset: Dataset,
    plates: list[np.ndarray],
    costs: dict[str, float],
    extras: Extras,
    progress: Progress,
) -> dict[str, Any]:
    """Means over every held-out frame of every camera; `gof.commands.evaluate.evaluate` says under which names.

    Pixels of a camera's sync board (`Dataset.board_weight`) do not count, softly at its edge; for scores of a network both
    pictures are faded to black there.
    """
    from gof.render import render

    own_background = not gaussians.dynamic.all()

    def draw(number: int, frame: int) -> dict[str, np.ndarray]:
        time_s = float(dataset.camera_times_s(number)[frame])
        with timed(costs, "render"):
            drawn = render(
                state_at(gaussians, time_s),
                dataset.cameras[number],
                time_s,
                background=(0, 0, 0) if own_background else plates[number],
            )
        return drawn | {"color": np.clip(drawn["color"], 0, 1)}

    single, absent = _single_scores(extras)
    boards = [dataset.board_weight(number) for number in range(len(dataset.cameras))]
    rows: list[dict[str, Any]] = []
    for number in range(len(dataset.cameras)):
        for frame in dataset.test_frames:
            rows.append(_row(dataset, number, frame, draw, boards[number], single, extras, costs))
            progress(len(rows), len(dataset.test_frames) * len(dataset.cameras), stage="pictures")
    out: dict[str, Any] = {}
    spread = {}
    for key in dict.fromkeys(k for row in rows for k in row if k not in ("camera", "frame", "flame_share")):
        values = [r[key] for r in rows if r.get(key) is not None and np.isfinite(r[key])]
        out[key] = float(np.mean(values)) if values else None
        spread[f"{key}_std"] = float(np.std(values)) if values else None
    for row in rows:  # identical pictures have an infinite PSNR, which JSON has no number for
        row |= {k: None for k, v in row.items() if isinstance(v, float) and not np.isfinite(v)}
    if extras.weights is not None:
        try:
            out |= _video_scores(dataset, draw, boards, extras.weights, costs, progress)
        except MissingDependencyError as e:
            absent.append(str(e))
    covered = [0.0 if w is None else float(1 - w.mean()) for w in boards]
    return out | {
        "images": {
            "count": len(rows),
            "absent": absent,
            "board_share": float(np.mean(covered)),
            **spread,
            "pictures": rows,
        }
    }


def _row(
    dataset: Dataset,
    number: int,
    frame: int,
    draw: Draw,
    board: np.ndarray | None,
    single: dict[str, Callable],
    extras: Extras,
    costs: dict[str, float],
) -> dict[str, Any]:
    """All scores of one held-out frame of one camera."""
    drawn = draw(number, frame)
    after = frame + 1 if frame + 1 < len(dataset.times_s) else None
    next_drawn = None if after is None else draw(number, after)
    with timed(costs, "images"):
        image, truth, mask = drawn["color"], dataset.image(number, frame), dataset.mask(number, frame)
        row = {
            "camera": dataset.cameras[number].name,
            "frame": frame,
            "flame_share": None if mask is None else float(mask.mean()),
        }
        for suffix, picture in (("", image), ("_plate", dataset.static(number))):
            for name, score in single.items():
                row[f"{name}{suffix}"] = score(picture, truth, board)
                if name != "lpips":
                    row[f"{name}_flame{suffix}"] = None if mask is None else score(picture, truth, _both(mask, board))
        if next_drawn is not None:
            either = None if mask is None else np.maximum(mask, dataset.mask(number, after))
            row["temporal_l2"] = temporal_l2(
                (image, next_drawn["color"]), (truth, dataset.image(number, after)), _both(either, board)
            )
            row["temporal_l2_plate"] = 1.0 if row["temporal_l2"] is not None else None
        if extras.depth is not None:
            seen = _both(_both(drawn["alpha"] > 0.1, mask), board)
            found = rmse_depth(drawn["depth"], read_depth(extras.depth, row["camera"], frame), seen)
            row["rmse_depth"] = None if found is None else found.rmse
    return row


def _both(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    """Product of two weights, None standing for 1 everywhere."""
    return b if a is None else a if b is None else a * b


def _faded(picture: np.ndarray, weight: np.ndarray | None) -> np.ndarray:
    return picture if weight is None else picture * weight[..., None]


def _single_scores(extras: Extras) -> tuple[dict[str, Callable], list[str]]:
    """Scores (picture, truth, weights) of one picture that can be computed here, and for each of the others why not."""
    scores, absent = {"psnr": psnr, "ssim": ssim}, []
    probe = np.zeros((64, 64, 3))
    optional = {"flip": perceptual.flip}
    if extras.weights is not None:
        optional["lpips"] = lambda image, truth, weight: perceptual.lpips(
            _faded(image, weight), _faded(truth, weight), extras.weights
        )
    else:
        absent.append("LPIPS and CGVQM: give --weights, the folder with their weight files")
    for name, score in optional.items():
        try:
            score(probe, probe, None)
            scores[name] = score
        except MissingDependencyError as e:
            absent.append(str(e))
    return scores, absent


def _video_scores(
    dataset: Dataset,
    draw: Draw,
    boards: list[np.ndarray | None],
    weights: Path,
    costs: dict[str, float],
    progress: Progress,
) -> dict[str, float]:
    """CGVQM of every frame of every camera, training frames too: a video with gaps would be another video."""
    names, frames, clip = video.available(weights), len(dataset.times_s), video.clip_length(dataset.frame_time_s)
    out, done = {}, 0
    for name in names:
        qualities = []
        for number, board in enumerate(boards):
            drawn_s = costs.get("render", 0.0)
            with timed(costs, "video"):
                qualities.append(
                    video.cgvqm(
                        frames,
                        lambda k, n=number, b=board: (_faded(draw(n, k)["color"], b), _faded(dataset.image(n, k), b)),
                        clip,
                        weights,
                        name,
                    )
                )
            costs["video"] -= costs["render"] - drawn_s  # drawing is counted there
            done += 1
            progress(done, len(names) * len(boards), stage="video")
        out[name] = float(np.mean(qualities))
    return out
