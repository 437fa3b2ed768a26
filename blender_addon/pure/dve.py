"""DVE of a reconstruction against the true velocity of a dataset, with numpy only.

The protocol is that of docs/scores.md, in its default form: three Gauss-Hermite nodes an axis, opacity at each time,
moving Gaussians only, every stored frame of the clip. `gof evaluate` computes these scores, and more; a test holds
the two against each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from ..core.datum import Datum
from ..core.description import DatasetDescription
from ..core.errors import DataFormatError, GofError
from ..core.fields import VelocitySequence, trilinear
from ..core.files import path_in
from ..core.records import read_record
from ..core.rotations import rotation_matrices
from .io.cloud import GaussianCloud


@dataclass(frozen=True)
class BaselineScore:
    """The score of velocities that anybody could guess."""

    l2: float | None


@dataclass(frozen=True)
class TrivialBaselines:
    """zero: no motion at all; constant: one vector for everything, the mean true velocity."""

    zero: BaselineScore | None = None
    constant: BaselineScore | None = None


@dataclass(frozen=True)
class SequenceScore:
    """DVE of a sequence.

    Attributes:
        l2: relative L2 error of the velocities; None where it is undefined.
        cos_sim: cosine similarity, likewise.
        frames_scored: number of frames where it is defined.
        weight_outside: share of the Gaussians' mass outside the velocity's domain, 0..1.
    """

    l2: float | None
    cos_sim: float | None
    frames_scored: int
    weight_outside: float


@dataclass(frozen=True)
class MotionScores:
    """dve: None where nothing could be scored; `warnings` say why, or what to mind."""

    SCHEMA: ClassVar[str] = "gof-scores"
    VERSION: ClassVar[int] = 1
    FORMER: ClassVar[dict[str, str]] = {"controls": "trivial_baselines"}  # of 0.2; goes with the next version

    dve: SequenceScore | None = None
    trivial_baselines: TrivialBaselines = field(default_factory=TrivialBaselines)
    warnings: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path) -> MotionScores:
        """Read a scores.json. Raises DataFormatError: absent, or not what this version reads (names the field)."""
        try:
            return read_record(cls, path)
        except GofError as error:
            raise DataFormatError(f"{error}; was it written by gof of another version?") from None

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values for people."""
        if self.dve is None:
            return [("DVE", "; ".join(self.warnings) or "undefined")]
        rows = [
            ("DVE L2", _number(self.dve.l2)),
            ("DVE CosSim", _number(self.dve.cos_sim)),
            ("Frames", str(self.dve.frames_scored)),
        ]
        if self.trivial_baselines.zero:
            rows.append(("L2 of no motion", _number(self.trivial_baselines.zero.l2)))
        if self.trivial_baselines.constant:
            rows.append(("L2 of one vector", _number(self.trivial_baselines.constant.l2)))
        return [*rows, ("Weight outside", f"{100 * self.dve.weight_outside:.0f} %")]


def _number(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"


NODE = np.sqrt(3.0)  # roots of He_3: -NODE, 0, NODE, with the weights 1/6, 2/3, 1/6
NODES = NODE * (np.array(list(np.ndindex(3, 3, 3))) - 1.0)
WEIGHTS = np.prod(np.where(NODES == 0, 2 / 3, 1 / 6), axis=1)
BATCH = 1200  # Gaussians whose nodes are held at once
CULL_SHARE = 1e-9  # of weight, and of weighted squared speed, that may be skipped in a frame
CLAMP = 40.0  # lifetimes away from its moment a Gaussian is gone in any precision


@dataclass(frozen=True)
class ProbedFrame:
    """Moving Gaussians at one time: weight (M,) m^3; velocity of the gas, truth (M, 3) m/s; inside (M,), share in the
    box."""

    weight: np.ndarray
    velocity: np.ndarray
    truth: np.ndarray
    inside: np.ndarray


@dataclass(frozen=True)
class CellWindow:
    """Cells of one stored frame, in memory.

    Attributes:
        cells: (x, y, z, 3) m/s.
        start: (3,) index of the first of them in the whole grid.
        grid: cells of the whole grid.
        world_to_index: (4, 4) world metres to continuous cell index, of the whole grid.
    """

    cells: np.ndarray
    start: np.ndarray
    grid: tuple[int, int, int]
    world_to_index: np.ndarray

    @classmethod
    def read(cls, truth: VelocitySequence, number: int, low: np.ndarray, high: np.ndarray) -> CellWindow:
        """Return the cells that points between two world corners (3,) are interpolated from. Raises:
        DataFormatError."""
        to_index, grid = np.linalg.inv(truth.index_to_world), truth.resolution
        corners = np.where(np.array(list(np.ndindex(2, 2, 2))), high, low) @ to_index[:3, :3].T + to_index[:3, 3]
        start = np.clip(np.floor(corners.min(0) - 0.5), 0, np.array(grid) - 1).astype(int)
        stop = np.clip(np.floor(corners.max(0) - 0.5) + 2, start + 1, grid).astype(int)
        return cls(truth.cells(number, *map(slice, start, stop)), start, grid, to_index)

    def coordinate(self, points: np.ndarray) -> np.ndarray:
        """Convert world points (N, 3) to continuous cell index: the centre of cell i has i + 0.5."""
        return points @ self.world_to_index[:3, :3].T + self.world_to_index[:3, 3]

    def contains(self, coordinate: np.ndarray) -> np.ndarray:
        """Return whether continuous cell indices (N, 3) lie in the whole grid, (N,)."""
        return ((coordinate >= 0) & (coordinate <= self.grid)).all(1)


@dataclass(frozen=True)
class FrameSums:
    """Weighted sums over the Gaussians of one or more frames. Weights in m^3, speeds in m/s."""

    weight: float = 0.0
    error2: float = 0.0
    truth2: float = 0.0
    cosine: float = 0.0
    outside: float = 0.0
    truth: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __add__(self, other: FrameSums) -> FrameSums:
        plain = {name: getattr(self, name) + getattr(other, name) for name in vars(self) if name != "truth"}
        return FrameSums(**plain, truth=tuple(np.add(self.truth, other.truth).tolist()))

    @classmethod
    def of(cls, frame: ProbedFrame) -> FrameSums:
        weight, velocity, truth = frame.weight, frame.velocity, frame.truth
        norms = np.linalg.norm(velocity, axis=1) * np.linalg.norm(truth, axis=1)
        dot = (velocity * truth).sum(1)
        cosine = np.divide(dot, norms, out=np.zeros_like(dot), where=norms > 0)  # no direction, no agreement
        return cls(
            weight=float(weight.sum()),
            error2=float((weight * ((velocity - truth) ** 2).sum(1)).sum()),
            truth2=float((weight * (truth**2).sum(1)).sum()),
            cosine=float((weight * np.clip(cosine, -1, 1)).sum()),
            outside=float((weight * (1 - frame.inside)).sum()),
            truth=tuple((weight[:, None] * truth).sum(0).tolist()),
        )

    @property
    def l2(self) -> float | None:
        """Relative L2 error; None where the truth stands still."""
        return float(np.sqrt(self.error2 / self.truth2)) if self.truth2 > 0 else None

    @property
    def l2_constant(self) -> float | None:
        """Return the L2 of the best single vector, the mean true velocity: what it leaves is the truth's variance."""
        if not self.truth2 > 0:
            return None
        explained = sum(part**2 for part in self.truth) / self.weight
        return float(np.sqrt(max(self.truth2 - explained, 0.0) / self.truth2))


def frame_rate(dataset: Path) -> float:
    """Return frames per second of a dataset's clip; 24 for a single frame. Raises: DataFormatError: no dataset."""
    time_s = DatasetDescription.read(dataset).time_s
    return float(1 / np.median(np.diff(time_s))) if len(time_s) > 1 else 24.0


def true_velocity(dataset: Path, datum: Datum | None = None) -> VelocitySequence:
    """Return the true velocity of a dataset folder, its places and times counted from a datum.

    Raises: DataFormatError: there is none, or no dataset.
    """
    name = DatasetDescription.read(dataset).velocity
    if not name:
        raise DataFormatError(f"{dataset}: the dataset has no true velocity (a real capture?); choose a generated one")
    return VelocitySequence.open(path_in(dataset, name)).measured_from(datum or Datum())


def score(cloud: GaussianCloud, dataset: Path) -> Iterator[tuple[int, int, MotionScores]]:
    """Score frame after frame: (frames done, frames in all, the score of those).

    Raises:
        DataFormatError: no dataset, one without true velocity or of another time, a damaged store; numbered stills,
            which say no velocity; nothing that moves.
    """
    if cloud.begin is not None:
        raise DataFormatError(
            "numbered stills say where Gaussians are, not how fast; set Python to one that has gof, which scores them"
        )
    if not cloud.dynamic.any():
        raise DataFormatError("the reconstruction has no moving Gaussian, so there is no velocity to score")
    truth = true_velocity(dataset, cloud.datum)
    clip_s = np.array(DatasetDescription.read(dataset).time_s) - (cloud.datum or Datum()).time_s
    frames = _frames(truth, clip_s, dataset)
    total, scored = FrameSums(), 0
    for done, number in enumerate(frames, 1):
        sums = FrameSums.of(probe(cloud, truth, number))
        scored += sums.truth2 > 0
        total = total + sums
        yield done, len(frames), _scores(total, scored)


def _scores(sums: FrameSums, frames: int) -> MotionScores:
    if sums.weight == 0:
        none = "no Gaussian has weight at any of the dataset's times: is its time in seconds of the same clock?"
        return MotionScores(warnings=(none,))
    still = sums.truth2 == 0
    found = SequenceScore(
        l2=sums.l2,
        cos_sim=float(np.clip(sums.cosine / sums.weight, -1, 1)),
        frames_scored=frames,
        weight_outside=min(sums.outside / sums.weight, 1.0),
    )
    trivial_baselines = TrivialBaselines(BaselineScore(None if still else 1.0), BaselineScore(sums.l2_constant))
    return MotionScores(
        found, trivial_baselines, ("the true velocity is zero wherever there are Gaussians",) if still else ()
    )


def _frames(truth: VelocitySequence, clip_s: np.ndarray, dataset: Path) -> list[int]:
    """Return numbers of the stored frames that lie in the clip, half a frame's time around it included."""
    slack = float(np.median(np.diff(clip_s))) / 2 if len(clip_s) > 1 else 0.0
    in_clip = (truth.times_s >= clip_s[0] - slack) & (truth.times_s <= clip_s[-1] + slack)
    if not in_clip.any():
        raise DataFormatError(
            f"{dataset}: its true velocity covers {truth.times_s[0]:g} to {truth.times_s[-1]:g} s, its pictures "
            f"{clip_s[0]:g} to {clip_s[-1]:g} s: make the dataset again"
        )
    return np.flatnonzero(in_clip).tolist()


def probe(cloud: GaussianCloud, truth: VelocitySequence, number: int) -> ProbedFrame:
    """Return the Gaussians that live and move at a stored frame, with the expected true velocity under each. Raises:
    DataFormatError."""
    dt = np.where(cloud.dynamic, truth.times_s[number] - cloud.t_mu, 0.0)
    position = (cloud.position + dt[:, None] * cloud.velocity).astype(np.float32).astype(float)
    window = np.exp(-0.5 * np.clip(dt / cloud.t_sigma, -CLAMP, CLAMP) ** 2)
    opacity = (cloud.opacity * window).astype(np.float32)
    scale, velocity = cloud.scale.astype(float), cloud.moving_gas.astype(float)
    weight = np.where(cloud.dynamic, scale.prod(1) * opacity, 0.0)
    rows = _not_negligible(weight, weight * (velocity**2).sum(1))
    mean, inside = expected_velocity(truth, number, position[rows], scale[rows], cloud.rotation[rows])
    return ProbedFrame(weight[rows], velocity[rows], mean, inside)


def _not_negligible(weight: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Return rows with weight; the others together hold less than CULL_SHARE of `weight` and of `power`, both (N,) >=
    0."""
    living = max(int(np.count_nonzero(weight)), 1)
    heavy = weight >= CULL_SHARE * weight.sum() / living
    strong = power > CULL_SHARE * power.sum() / living
    return np.flatnonzero((weight > 0) & (heavy | strong))


def expected_velocity(
    truth: VelocitySequence, number: int, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """E[V(X)] for X ~ N(position, R diag(scale^2) R^T) at a stored frame, by 27 nodes; outside its domain V is zero.

    Args:
        position: (M, 3) m.   scale: (M, 3) standard deviations, m.   rotation: (M, 4) unit quaternions wxyz.
    Returns:
        (M, 3) m/s, and (M,) share of the nodes' weight that lies in the domain. Raises: DataFormatError.
    """
    mean, inside = np.zeros((len(position), 3)), np.ones(len(position))
    if not len(position):
        return mean, inside
    reach = NODE * np.sqrt(3.0) * scale.max(1, keepdims=True)  # the corner node, whatever the rotation
    window = CellWindow.read(truth, number, (position - reach).min(0), (position + reach).max(0))
    for start in range(0, len(position), BATCH):
        rows = slice(start, start + BATCH)
        axes = rotation_matrices(rotation[rows]) * scale[rows, None, :]  # columns: own axes times deviation
        points = position[rows, None, :] + np.einsum("mij,pj->mpi", axes, NODES)
        coordinate = window.coordinate(points.reshape(-1, 3))
        within = window.contains(coordinate).reshape(-1, len(WEIGHTS))
        velocity = trilinear(window.cells, coordinate - 0.5 - window.start).reshape(-1, len(WEIGHTS), 3)
        mean[rows] = np.einsum("p,mpi->mi", WEIGHTS, velocity * within[..., None])
        inside[rows] = within @ WEIGHTS
    inside[inside > 1 - 1e-12] = 1.0  # the weights' own rounding
    return mean, inside
