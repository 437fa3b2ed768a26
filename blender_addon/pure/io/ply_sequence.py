"""Numbered 3DGS PLYs as one cloud: every Gaussian of every file, seen from its file's time until the next one's.

Where two files hold the same number of Gaussians, row n is taken for the same Gaussian in both and moves straight from
one to the other. Otherwise it rests until the next file replaces it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from . import FileFormatError
from .cloud import GaussianCloud, checked, refuse_unread, splats
from .ply_file import PlyVertices


def read(paths: list[Path], fps: float, step: int = 1) -> GaussianCloud:
    """File number k is at k / fps seconds; `paths` in the order of their numbers, two at least.

    Raises:
        FileFormatError: see `gaussians_file.load`; names the file that is wrong.
    """
    time_s = np.array([frame_number(path) for path in paths]) / fps
    states = []
    for path in paths:
        ply = PlyVertices(path)
        refuse_unread(ply)
        rows = ply.rows(step)
        if not len(rows):
            raise FileFormatError(f"{path}: holds 0 points; remove it from the sequence")
        states.append(splats(rows, ply, step))
    ends = np.append(time_s[1:], 2 * time_s[-1] - time_s[-2])
    parts = []
    for k, (state, path) in enumerate(zip(states, paths, strict=True)):
        n = len(state["position"])
        after = states[k + 1]["position"] if k + 1 < len(states) else state["position"]
        velocity = (after - state["position"]) / (ends[k] - time_s[k]) if len(after) == n else np.zeros((n, 3))
        parts.append(
            checked(
                state
                | {
                    "velocity": velocity,
                    "t_mu": np.full(n, time_s[k]),
                    "t_sigma": np.full(n, np.inf),
                    "dynamic": np.ones(n, bool),
                    "begin": np.full(n, time_s[k]),
                    "end": np.full(n, ends[k]),
                },
                path,
            )
        )
    names = [name for name in vars(parts[0]) if getattr(parts[0], name) is not None]
    return GaussianCloud(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def numbered(paths: list[Path]) -> list[Path]:
    """PLYs in the order of the last number in their names. Raises: FileFormatError: one has none, or another's."""
    numbers = [frame_number(path) for path in paths]
    if len(set(numbers)) < len(numbers):
        raise FileFormatError(f"{paths[0].parent}: several files have the same number; keep one sequence per folder")
    return [path for _, path in sorted(zip(numbers, paths, strict=True))]


def frame_number(path: Path) -> int:
    """The last number in a file's name. Raises: FileFormatError."""
    found = re.findall(r"\d+", path.stem)
    if path.suffix.lower() != ".ply" or not found:
        raise FileFormatError(f"{path}: not a numbered .ply (such as frame_012.ply); remove it from the sequence")
    return int(found[-1])
