"""The first frames of the footage of each camera, in which a board is recognised."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np

from gof.capture.recognise import LOOK_AT
from gof.footage.videos import distinct_names, stored_frames


def first_frames(videos: list[Path]) -> dict[str, Iterable[np.ndarray]]:
    """Each video's first frames, read when they are asked for, by the camera's name."""
    return dict(zip(distinct_names(videos), (islice(stored_frames(video), LOOK_AT) for video in videos), strict=True))
