"""Numbered 3DGS PLYs as one cloud: every Gaussian of every file, seen from its file's time until the next one's.

Where two files hold the same number of Gaussians, row n is taken for the same Gaussian in both and moves straight from
one to the other. Otherwise it rests until the next file replaces it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from . import FileFormatError
from .cloud import GaussianCloud, checked, refuse_unread, splats
from .numbered import frame_of, is_hidden, number_files
from .ply_file import PlyVertices


def read(paths: list[Path], fps: float, step: int = 1) -> GaussianCloud:
    """File number k is at k / fps seconds; `paths` in the order of their numbers, two at least.

    Raises:
        FileFormatError: see `gaussians_file.load`; names the file that is wrong.
    """
    time_s = np.array([frame_of(path)[1] for path in paths], float) / fps
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
    """PLYs in the order of their frames; hidden files are left out. Raises: FileFormatError: as `number_files`."""
    for path in paths:
        if path.suffix.lower() != ".ply" and not is_hidden(path):
            raise FileFormatError(f"{path}: not a numbered .ply (such as frame_012.ply); remove it from the sequence")
    return [path for _, path in number_files(paths)]
