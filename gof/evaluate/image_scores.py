"""Scores of pictures: a result drawn at the held-out frames, against what the cameras saw."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.cameras import sizes_px
from gof.core.costs import timed
from gof.core.errors import MissingDependencyError, NonFiniteError
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.evaluate.authors_figures import Flow, PublishedFrame, drawn_disparity, mean_figures, published_figures
from gof.evaluate.between import between_neighbours
from gof.evaluate.depth import read_depth, rmse_to_map
from gof.evaluate.image import flip_by_mask, lpips, psnr_by_mask, ssim_by_mask, temporal_l2
from gof.evaluate.scores import FIGURES, ImageScores, PictureFigures, PictureScore, PublishedFigures
from gof.host.threads import map_beside

Progress = Callable[..., None]  # progress(done, total, stage=...)
Weights = np.ndarray | None  # (H, W) what a pixel counts for, 0..1; None = all count
Background = np.ndarray | tuple[float, float, float]  # (H, W, 3) display values, or one colour
# A picture and its truth, (H, W, 3), to a score with each of the weights.
Metric = Callable[[np.ndarray, np.ndarray, Sequence[Weights]], Sequence[float | None]]

BLACK = (0.0, 0.0, 0.0)
BETWEEN = ("psnr", "ssim")  # of the two frames around
VISIBLE = 0.1  # opacity of a pixel from which on its depth counts


@dataclass(frozen=True)
class Extras:
    """Material for scores that need more than the dataset."""

    weights: Path | None = None  # folder of LPIPS' weight file
    depth: Path | None = None  # folder of CAMERA/FRAME.npy depth maps, for RMSE_depth
    flow: Flow | None = None  # optical flow, for the figures that the authors publish; None leaves them out
    disparity: Path | None = None  # folder of CAMERA/FRAME.npy maps of inverse depth, for their error of depth
    carry: Flow | None = None  # optical flow, along which the two frames around are carried; None leaves them out


@dataclass(frozen=True)
class FoundImageScores:
    """`means` over pictures, and what is behind them.

    `published`: means of the authors' figures; None when they were not requested.
    """

    means: PictureFigures
    published: PublishedFigures | None
    images: ImageScores


@dataclass(frozen=True)
class Metrics:
    """Scores of one picture that can be computed here, and of the others why not."""

    picture: dict[str, Metric]
    absent: list[str]


@dataclass(frozen=True)
class ScoredView:
    """A camera by its number, and what its pictures are scored with: all (H, W, 3) display values, `board` (H, W)."""

    number: int
    background: Background  # what the result is drawn over
    plate: np.ndarray  # the dataset's fire-free picture, scored beside the result
    board: Weights  # 0 on the sync board


@dataclass(frozen=True)
class ScoredFrame:
    """A frame of a camera, drawn and as it was."""

    number: int
    image: np.ndarray  # (H, W, 3) drawn, display values in [0, 1]
    alpha: np.ndarray  # (H, W) drawn
    depth: np.ndarray  # (H, W) drawn, m
    disparity: np.ndarray | None  # (H, W) drawn, 1/m; None when not asked for
    truth: np.ndarray  # (H, W, 3)
    mask: Weights  # 1 where flame is; None = the dataset does not say


def image_scores(
    gaussians: MovingGaussians,
    dataset: Dataset,
    known: np.ndarray,
    plates: list[np.ndarray],
    backgrounds: list[Background],
    costs: dict[str, float],
    extras: Extras,
    progress: Progress,
) -> FoundImageScores:
    """Scores of every held-out frame of every camera; each frame is drawn once, for all scores that look at it.

    Pixels of a camera's sync board (`Dataset.board_weight`) do not count, softly at its edge; for scores of a network
    both pictures are faded to black there.

    Args:
        known: (T,) bool, the frames that the result says something about.
        plates: per camera, the dataset's fire-free picture.
        backgrounds: per camera, what the result is drawn over.
        costs: seconds by part; "render" and, beside it, "images" are added.
    """
    metrics = _metrics(extras)
    frames = [k for k in _frames_to_draw(dataset) if known[k]]
    boards = [dataset.board_weight(number) for number in range(len(dataset.cameras))]

    def held_out() -> Iterator[tuple[ScoredView, ScoredFrame, ScoredFrame | None]]:
        for number, board in enumerate(boards):
            view = ScoredView(number, backgrounds[number], plates[number], board)
            for i, (frame, after) in enumerate(_with_next(_draw(gaussians, dataset, view, frames, extras, costs))):
                if frame.number in dataset.test_frames:
                    yield view, frame, after
                progress(number * len(frames) + i + 1, len(boards) * len(frames), stage="pictures")

    def score(of: tuple[ScoredView, ScoredFrame, ScoredFrame | None]) -> tuple[PictureScore, PublishedFigures | None]:
        view, frame, after = of
        with timed(costs, "images"):
            row = _picture_score(dataset, view, frame, after, metrics, extras)
            if extras.flow is None or after is None:
                return row, None
            return row, _published(dataset, view, frame, after, extras)

    scored = list(map_beside(score, held_out()))
    rows = [row for row, _ in scored]
    published = [figures for _, figures in scored if figures is not None]
    covered = [0.0 if board is None else float(1 - board.mean()) for board in boards]
    statistics = {name: _mean_and_spread([getattr(row, name) for row in rows]) for name in FIGURES}
    return FoundImageScores(
        means=PictureFigures(**{name: mean for name, (mean, _) in statistics.items()}),
        published=None if extras.flow is None else mean_figures(published),
        images=ImageScores(
            count=len(rows),
            absent=tuple(metrics.absent),
            board_share=float(np.mean(covered)),
            pictures=tuple(rows),
            sizes_px=sizes_px(dataset.cameras),
            **{f"{name}_std": spread for name, (_, spread) in statistics.items()},
        ),
    )


def _metrics(extras: Extras) -> Metrics:
    """Return the image scores that can be computed here, and why others are absent."""
    metrics = Metrics({"psnr": psnr_by_mask, "ssim": ssim_by_mask}, [])
    optional: dict[str, Metric] = {"flip": flip_by_mask}
    weights = extras.weights
    if weights is None:
        metrics.absent.append("LPIPS: give --weights, the folder with its weight file")
    else:
        optional["lpips"] = lambda image, truth, of: [lpips(_faded(image, w), _faded(truth, w), weights) for w in of]
    black = np.zeros((64, 64, 3))
    for name, metric in optional.items():
        try:
            metric(black, black, [None])
            metrics.picture[name] = metric
        except MissingDependencyError as e:
            metrics.absent.append(str(e))
    return metrics


def _frames_to_draw(dataset: Dataset) -> list[int]:
    """Held-out frames and the ones after them."""
    count = len(dataset.times_s)
    return sorted({k for held_out in dataset.test_frames for k in (held_out, held_out + 1) if k < count})


def _draw(
    gaussians: MovingGaussians,
    dataset: Dataset,
    view: ScoredView,
    frames: list[int],
    extras: Extras,
    costs: dict[str, float],
) -> Iterator[ScoredFrame]:
    """Yield the frames of a camera in order, one at a time."""
    from gof.render import render  # here: it loads the compiler

    times_s = dataset.camera_times_s(view.number)
    for k in frames:
        time_s = float(times_s[k])
        with timed(costs, "render"):
            state, camera = gaussians.state_at(time_s), dataset.cameras[view.number]
            drawn = render(state, camera, time_s, background=view.background)
            disparity = None if extras.flow is None else drawn_disparity(state, camera, time_s)
            truth = dataset.image(view.number, k)
            mask = dataset.mask(view.number, k)
        yield ScoredFrame(k, np.clip(drawn["color"], 0, 1), drawn["alpha"], drawn["depth"], disparity, truth, mask)


def _with_next(frames: Iterable[ScoredFrame]) -> Iterator[tuple[ScoredFrame, ScoredFrame | None]]:
    """Yield every frame with the one that follows it in the clip; None where that is not among them."""
    before = None
    for frame in frames:
        if before is not None:
            yield before, frame if frame.number == before.number + 1 else None
        before = frame
    if before is not None:
        yield before, None


def _picture_score(
    dataset: Dataset, view: ScoredView, frame: ScoredFrame, after: ScoredFrame | None, metrics: Metrics, extras: Extras
) -> PictureScore:
    """Return all scores of one held-out frame of one camera."""
    camera, mask, board = dataset.cameras[view.number].name, frame.mask, view.board
    figures: dict[str, float | None] = {}
    pictures: dict[str, np.ndarray | None] = {"": frame.image, "_plate": view.plate}
    if extras.carry is not None:
        pictures["_between"] = between_neighbours(dataset, view.number, frame.number, extras.carry)
    for suffix, picture in pictures.items():
        for name, metric in metrics.picture.items():
            if picture is None or (suffix == "_between" and name not in BETWEEN):
                continue
            weights = {name: board}
            if name != "lpips" and mask is not None:
                weights[f"{name}_flame"] = _both(mask, board)
            found = metric(picture, frame.truth, list(weights.values()))
            figures |= {f"{of}{suffix}": value for of, value in zip(weights, found, strict=True)}
    if after is not None:
        either = None if mask is None or after.mask is None else np.maximum(mask, after.mask)
        change = temporal_l2((frame.image, after.image), (frame.truth, after.truth), _both(either, board))
        figures["temporal_l2"] = change
        figures["temporal_l2_plate"] = None if change is None else 1.0  # a still picture's, by definition
    if extras.depth is not None:
        seen = _both(_both(frame.alpha > VISIBLE, mask), board)
        depth = rmse_to_map(frame.depth, extras.depth, camera, frame.number, seen)
        figures["rmse_depth"] = None if depth is None else depth.rmse
    for name, value in figures.items():
        if value is not None and not np.isfinite(value):
            raise NonFiniteError(f"{name} of camera {camera}, frame {frame.number} is {value}")
    flame_share = None if mask is None else float(mask.mean())
    return PictureScore(camera=camera, frame=frame.number, flame_share=flame_share, **figures)


def _published(
    dataset: Dataset, view: ScoredView, frame: ScoredFrame, after: ScoredFrame, extras: Extras
) -> PublishedFigures:
    """Return the authors' figures of one held-out frame of one camera."""
    camera = dataset.cameras[view.number].name
    expected = None if extras.disparity is None else read_depth(extras.disparity, camera, frame.number)
    board = None if view.board is None else view.board < 0.5
    assert frame.disparity is not None and extras.flow is not None, "drawn where these figures are wanted"
    seen = PublishedFrame(frame.image, frame.truth, after.truth, board, frame.disparity, expected)
    return published_figures(seen, extras.flow, extras.weights)


def _mean_and_spread(values: list[float | None]) -> tuple[float | None, float | None]:
    """Return mean and (population) standard deviation of the defined values; None without any."""
    defined = [value for value in values if value is not None]
    return (float(np.mean(defined)), float(np.std(defined))) if defined else (None, None)


def _both(a: Weights, b: Weights) -> Weights:
    """Product of two weights."""
    if a is None or b is None:
        return b if a is None else a
    return a * b


def _faded(picture: np.ndarray, weight: Weights) -> np.ndarray:
    return picture if weight is None else picture * weight[..., None]
