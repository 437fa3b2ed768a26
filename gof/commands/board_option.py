"""The option --board of every command that reads footage of the LED board, and its old name."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np

from gof.capture.recognise import LOOK_AT
from gof.footage.videos import distinct_names, stored_frames

OLD = "--template"


def renamed(argv: list[str]) -> list[str]:
    """The arguments with --template as --board; says so on the error stream."""
    if not any(word == OLD or word.startswith(f"{OLD}=") for word in argv):
        return argv
    print(f"{OLD} is now called --board; the old name goes with the next version", file=sys.stderr)
    return [f"--board{word.removeprefix(OLD)}" if word.split("=")[0] == OLD else word for word in argv]


def first_frames(videos: list[Path]) -> dict[str, Iterable[np.ndarray]]:
    """Each video's first frames, read when they are asked for, by the camera's name."""
    return dict(zip(distinct_names(videos), (islice(stored_frames(video), LOOK_AT) for video in videos), strict=True))
