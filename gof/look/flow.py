"""Motion of every pixel by a result, in a dataset's cameras: drawn, and written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from gof.core.flow import write_flow
from gof.core.gaussians import MovingGaussians
from gof.evaluate.flow import CameraFrames, motion, true_motion
from gof.evaluate.screen_motion import ScreenVelocity
from gof.footage.pictures import write_picture
from gof.look.images import side_by_side
from gof.look.velocity import draw, fastest

FlowFile = Literal["exr", "flo", "png"]


def write_views(
    gaussians: MovingGaussians,
    chosen: Sequence[CameraFrames],
    out: Path,
    kinds: Sequence[FlowFile],
    progress: Callable[[int, int], None],
) -> float:
    """Write OUT/CAMERA/000000.exr (.flo, .png) of every frame; returns the speed of full brightness in the pictures,
    px/s.

    A picture shows the result's motion, and right of it the true one where it is known. EXR and FLO hold px per frame,
    as the dataset's true motion does.
    """
    frame_time_s = chosen[0].dataset.frame_time_s
    longest = _longest(gaussians, chosen)
    total, done = sum(len(view.frames) for view in chosen), 0
    notes = {"unit": "pixels per frame, right and down", "frame_time_s": f"{frame_time_s:.9g}"}
    for view in chosen:
        for frame in view.frames:
            drawn = motion(gaussians, view, frame)
            path = out / view.name / f"{frame:06d}.exr"
            path.parent.mkdir(parents=True, exist_ok=True)
            for kind in kinds:
                if kind == "png":
                    write_picture(path.with_suffix(".png"), _picture(drawn, view, frame, longest)[..., ::-1])
                else:
                    write_flow(path.with_suffix(f".{kind}"), drawn.flow * frame_time_s, drawn.alpha, notes)
            done += 1
            progress(done, total)
    return longest


def _longest(gaussians: MovingGaussians, chosen: Sequence[CameraFrames]) -> float:
    """Return one speed of full brightness for all pictures, px/s: that of the middle frames."""
    return fastest([motion(gaussians, view, view.frames[len(view.frames) // 2]) for view in chosen])


def _picture(drawn: ScreenVelocity, view: CameraFrames, frame: int, longest: float) -> np.ndarray:
    panels = [draw(drawn, longest, scale=1)]
    if view.has_truth:
        flow, known = true_motion(view, frame)
        truth = ScreenVelocity(flow / view.dataset.frame_time_s * known[..., None], known.astype(np.float64))
        panels.append(draw(truth, longest, scale=1))
    return side_by_side(panels)
