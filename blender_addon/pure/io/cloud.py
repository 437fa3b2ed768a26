"""Reconstructions as Blender shows them: results of ours, FTGS-PLYs, a 3DGS PLY as a still, or numbered ones.

Where two numbered PLYs hold the same number of Gaussians, row n is taken for the same Gaussian in both and moves
straight from one to the other. Otherwise it rests until the next file replaces it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core import ftgs, npz, results
from ...core.errors import DataFormatError, GofError, naming
from ...core.gaussians import TransientGaussians
from ...core.harmonics import plain_color
from ...core.numbered import frame_of, is_hidden, number_files
from ...core.ply import Ply
from ...core.ply_file import count_vertices

SPLATS = {
    ".splat": "a file of antimatter15's web viewer",
    ".spz": "a file of Niantic's SPZ",
    ".ksplat": "a file of mkkellogg's web viewer",
    ".sog": "a file of PlayCanvas' SOG",
    ".glb": "a GLB",
    ".gltf": "a glTF",
    ".usdz": "a USDZ",
}


@dataclass(frozen=True)
class CloudTiming:
    """Facts about time that the files of other methods do not hold.

    Attributes:
        fps: numbers per second of a PLY sequence, frames per second of an FTGS-PLY's clip.
        clip_s: seconds from the first to the last frame of an FTGS-PLY; None = from its number of frames and fps.
    """

    fps: float = 24.0
    clip_s: float | None = None


@dataclass
class GaussianCloud(TransientGaussians):
    """Transient Gaussians in display colours (N, 3), as seen from all sides; of harmonics the constant one counts.

    Args:
        begin, end: (N,) s; where they are given, a row is seen while begin <= t < end only.
    """

    begin: np.ndarray | None = None
    end: np.ndarray | None = None

    def __post_init__(self):
        super().__post_init__()
        self.color = plain_color(self.color)

    @property
    def says_uncertainty(self) -> bool:
        """Return whether the standard deviation of any velocity is known."""
        return bool(np.isfinite(self.velocity_sd).any())


def load(source: str | Path | Sequence[Path], clock: CloudTiming | None = None, step: int = 1) -> GaussianCloud:
    """Read a result; what it is follows from its content.

    Args:
        source: a file, a folder of numbered PLYs, or a list of numbered PLYs.
        clock: see `CloudTiming`.
        step: read every step-th Gaussian only.

    Raises:
        DataFormatError, NonFiniteError: no such file, wrong suffix, schema or layout, missing field, truncated, no
            points, NaN or Inf, a value outside its range, or a time without a unit. Rows are those of the file.
    """
    clock = clock or CloudTiming()
    paths = files_of(source)
    try:
        cloud = _of_sequence(paths, clock.fps, step) if len(paths) > 1 else _of_file(paths[0], clock, step)
    except GofError:
        if step > 1:
            load(source, clock)  # which names the rows as the file counts them
        raise
    if not len(cloud):
        raise DataFormatError(f"{paths[0]}: holds 0 points; did the reconstruction end well?")
    return cloud


def count(source: str | Path | Sequence[Path]) -> int:
    """Return number of Gaussians that `load` would make, from the files' headers alone. Raises: as `load`."""
    return sum(_count_npz(path) if path.suffix.lower() == ".npz" else count_vertices(path) for path in files_of(source))


def files_of(source: str | Path | Sequence[Path]) -> list[Path]:
    """Return the files that a source stands for, numbered ones in order. Raises: DataFormatError."""
    if not isinstance(source, (str, Path)):
        return _numbered([Path(path) for path in source]) if len(source) > 1 else files_of(source[0])
    path = Path(source)
    if path.is_dir():
        found = _numbered([file for file in path.iterdir() if file.suffix.lower() == ".ply"])
        if not found:
            raise DataFormatError(f"{path}: no numbered .ply files in this folder; choose result.npz or result.ply")
        return found
    if path.suffix.lower() not in (".npz", ".ply"):
        if kind := SPLATS.get(path.suffix.lower()):
            raise DataFormatError(f"{path}: {kind}: open it in SuperSplat and export an uncompressed PLY")
        raise DataFormatError(
            f"{path}: unknown suffix '{path.suffix}'; a result is .npz or .ply. Checkpoints of other "
            "methods: `gof convert` makes a result of them"
        )
    if not path.is_file():
        raise DataFormatError(f"{path}: no such file")
    return [path]


def _numbered(paths: list[Path]) -> list[Path]:
    for path in paths:
        if path.suffix.lower() != ".ply" and not is_hidden(path):
            raise DataFormatError(f"{path}: not a numbered .ply (such as frame_012.ply); remove it from the sequence")
    return [path for _, path in number_files(paths)]


def _count_npz(path: Path) -> int:
    try:
        return next(iter(npz.shapes(path)["x0"]), 0)
    except (GofError, *npz.DAMAGE):
        return 0  # `load` says what is wrong


def _of_file(path: Path, clock: CloudTiming, step: int) -> GaussianCloud:
    with naming(path):
        if path.suffix.lower() == ".npz":
            arrays, whole = results.load(path, step)
            return GaussianCloud(**arrays, datum=whole.datum, emissive=whole.emissive)
        ply = Ply.read(path, step)
        if ftgs.matches(ply):
            values, facts = ftgs.read(ply)
            remedy = "set Clip (seconds from the first to the last frame)"
            start, unit = ftgs.place_in_time(path, facts, 0.0, clock.clip_s, 1 / clock.fps, remedy)
            return GaussianCloud(**ftgs.moving(values, facts, start, unit).arrays())
        if any(map(ply.has, results.PROPERTIES)):
            arrays, whole = results.of_ply(ply)
            return GaussianCloud(**arrays, datum=whole.datum, emissive=whole.emissive)
        n, values = len(ply.vertex), ply.splats()
        ply.require_read()
        still = {"velocity": np.zeros((n, 3)), "t_mu": np.zeros(n), "t_sigma": np.full(n, np.inf)}
        return GaussianCloud(**values, **still, dynamic=np.zeros(n, bool))


def _of_sequence(paths: list[Path], fps: float, step: int) -> GaussianCloud:
    """File number k is at k / fps seconds; `paths` in the order of their numbers, two at least."""
    time_s = np.array([frame_of(path)[1] for path in paths], float) / fps
    states = [_state(path, step) for path in paths]
    ends = np.append(time_s[1:], 2 * time_s[-1] - time_s[-2])
    parts = []
    for k, (state, path) in enumerate(zip(states, paths, strict=True)):
        n = len(state["position"])
        after = states[min(k + 1, len(states) - 1)]["position"]
        velocity = (after - state["position"]) / (ends[k] - time_s[k]) if len(after) == n else np.zeros((n, 3))
        moves = {"velocity": velocity, "t_mu": np.full(n, time_s[k]), "t_sigma": np.full(n, np.inf)}
        seen = {"dynamic": np.ones(n, bool), "begin": np.full(n, time_s[k]), "end": np.full(n, ends[k])}
        with naming(path):
            parts.append(GaussianCloud(**state, **moves, **seen))
    return GaussianCloud.concatenate(parts)


def _state(path: Path, step: int) -> dict[str, np.ndarray]:
    ply = Ply.read(path, step)
    if not len(ply.vertex):
        raise DataFormatError(f"{path}: holds 0 points; remove it from the sequence")
    values = ply.splats()
    ply.require_read()
    return values
