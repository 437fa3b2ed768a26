"""Motion of every pixel by a result, against the exact one of a simulated fire."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gof.core.flow import FlowErrors, FlowScore
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.evaluate.screen_motion import ScreenVelocity, screen_velocity

FAINT = 1 / 255  # of a pixel: less of a flame changes no 8-bit picture, and has no motion that could be seen
IN_FLAME = 0.5  # of a mask


@dataclass(frozen=True)
class CameraFrames:
    """A camera of a dataset and its frames, by numbers; `dataset` is that whose `cameras` hold it."""

    dataset: Dataset
    camera: int
    frames: tuple[int, ...]

    @property
    def name(self) -> str:
        """Return the camera's name."""
        return self.dataset.cameras[self.camera].name

    @property
    def has_truth(self) -> bool:
        """Return whether the true motion is known."""
        return bool(self.frames) and self.dataset.has_flow(self.camera)


def views(dataset: Dataset, frames: Iterable[int]) -> list[CameraFrames]:
    """Return a dataset's cameras, of every role, with those of the frames that they have pictures of, maybe none."""
    parts = [part for part in (dataset, dataset.evaluation_view(), dataset.around_view()) if part is not None]
    found = []
    for part in parts:
        for number in range(len(part.cameras)):
            known = set(part.frames(number))
            found.append(CameraFrames(part, number, tuple(k for k in frames if k in known)))
    return found


def motion(gaussians: MovingGaussians, view: CameraFrames, frame: int, nominal: bool = False) -> ScreenVelocity:
    """Draw the motion of a camera's pixels at a frame, px/s: the projected velocities J v, blended as colours are.

    Args:
        nominal: at the frame's nominal time by a global shutter, as the true motion is; else as the camera sees it.
    """
    camera = view.dataset.cameras[view.camera]
    time_s = float(view.dataset.camera_times_s(view.camera)[frame])
    if nominal:
        camera, time_s = replace(camera, row_time_s=0.0), float(view.dataset.times_s[frame])
    drawn = screen_velocity(gaussians.state_at(time_s), camera, time_s)
    seen = drawn.alpha >= FAINT
    return ScreenVelocity(np.where(seen[..., None], drawn.flow, 0), np.where(seen, drawn.alpha, 0))


def true_motion(view: CameraFrames, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the exact motion (H, W, 2), px per frame, and where it is known and flame is seen, (H, W) bool."""
    flow, light = view.dataset.true_flow(view.camera, frame)
    mask = view.dataset.mask(view.camera, frame)
    return flow, (light > 0) & (True if mask is None else mask > IN_FLAME)


@dataclass(frozen=True)
class FlowScores:
    """Errors of a result, and of two that know next to nothing, over the same pixels inside the flame masks.

    Attributes:
        zero: nothing moves.   mean: every pixel of a camera moves as the true mean of that camera.
        covered: share in [0, 1] of the pixels where the result draws something; elsewhere it says that nothing moves.
        pictures: that were compared.   frame_time_s: from px per frame to px/s.
    """

    result: FlowScore
    zero: FlowScore
    mean: FlowScore
    covered: float
    pictures: int
    frame_time_s: float


def score_views(
    gaussians: MovingGaussians, chosen: Sequence[CameraFrames], progress: Callable[[int, int], None]
) -> FlowScores | None:
    """Compare motion with the simulation's; None where no camera has it, or no flame is seen.

    Raises:
        DataFormatError: a file of true motion is absent or damaged.
    """
    chosen = [view for view in chosen if view.has_truth]
    result, zero, mean = (FlowErrors() for _ in range(3))
    total, done, covered, pictures = sum(len(view.frames) for view in chosen), 0, 0, 0
    for view in chosen:
        average = _mean_motion(view)
        for frame in view.frames:
            flow, known = true_motion(view, frame)
            done += 1
            progress(done, total)
            if not known.any():
                continue
            truth = flow[known]
            drawn = motion(gaussians, view, frame, nominal=True)
            result.add(drawn.flow[known] * view.dataset.frame_time_s, truth)
            zero.add(np.zeros_like(truth), truth)
            mean.add(np.broadcast_to(average, truth.shape), truth)
            covered += int((drawn.alpha[known] > 0).sum())
            pictures += 1
    if not result.pixels:
        return None
    scores = result.score(), zero.score(), mean.score()
    return FlowScores(*scores, covered / result.pixels, pictures, chosen[0].dataset.frame_time_s)


def _mean_motion(view: CameraFrames) -> np.ndarray:
    """Return the mean true motion (2,) of a camera's flame pixels over its frames, px per frame."""
    total, count = np.zeros(2), 0
    for frame in view.frames:
        flow, known = true_motion(view, frame)
        total += flow[known].sum(0, dtype=np.float64)
        count += int(known.sum())
    return total / max(count, 1)
