"""Batches: frames of one camera so far apart that hardly a Gaussian shines in two of them, drawn in one step.

Half of the time of a small picture's step goes into starting kernels, however much they do. Frames that share no
Gaussian teach as much side by side as one after the other, so a batch has them for the price of one start.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gof.reconstruct.observation import Observation
from gof.reconstruct.parameters import GROUP
from gof.reconstruct.unseen import UnseenViews
from gof.reconstruct.windows import Windows
from gof.render import Target
from gof.render.backend import Bool, Float

LIFE = 4.5  # t_sigma: so far from each other, a fiftieth of the Gaussians shines in both of two frames
USUAL_LIFE = 2.0  # t_sigma in training frames: the demo has 2.04
MOST, PIXELS = 4, 400_000  # frames of a batch, and their pixels: more save little, and take memory
WHITE = 0.8  # display value from which light beyond white may be behind it: pictures are compressed and shrunk


def count_together(t_sigma: np.ndarray, time_s: np.ndarray, pixels: int) -> int:
    """Return how many frames of a clip fit into a batch: it lasts as many lives of Gaussians as they are at the start.

    Args:
        t_sigma: (N,) s, > 0, of the seeds.   time_s: (F,) of the frames.   pixels: of a window.
    """
    life = LIFE * float(np.median(t_sigma)) if len(t_sigma) else np.inf
    return int(np.clip(np.ptp(time_s) / life, 1, np.clip(PIXELS // pixels, 1, MOST)))


def expect_together(frames: int, pixels: int) -> int:
    """Return the same before there are Gaussians. frames: of the clip, >= 0.   pixels: of a window, >= 0."""
    return count_together(np.full(1, USUAL_LIFE), np.arange(max(frames, 1)), max(pixels, 1))


class Batch(NamedTuple):
    """Frames of camera `c`, ascending.   number: of the batch, counted from the run's first."""

    c: int
    frames: tuple[int, ...]
    number: int


class TrainingPictures:
    """The delivered training pictures' windows, each brought to the renderer when it is drawn against.

    Made ready again every time: a fiftieth of a step, and kept they would take as much memory as all else.
    """

    def __init__(
        self, observation: Observation, windows: Windows, unseen: UnseenViews | None = None, together: int = 1
    ):
        """together: frames of a batch, at most."""
        self._observation, self._windows = observation, windows
        self.unseen = unseen
        imagined = np.zeros(0, int) if unseen is None else unseen.frames
        self._batches = _make_batches(observation.delivered, imagined, together)
        self._pictures = int(observation.delivered.sum())
        self._epoch: tuple[int, int] | None = None  # seed and number of the one whose order is known
        self._order = np.arange(len(self._batches))
        self._ends = self._order

    def choose(self, seed: int, done: int, most: int) -> Batch:
        """Return what is drawn after so many pictures: every batch once an epoch, in an order of its own, the same when
        resumed.

        Args:
            most: frames, where fewer pictures than a batch has are left of the run.
        """
        epoch, place = divmod(done, self._pictures)
        if (seed, epoch) != self._epoch:
            order = np.random.default_rng((seed, epoch)).permutation(len(self._batches))
            ends = np.cumsum([len(self._batches[k][1]) for k in order])
            self._epoch, self._order, self._ends = (seed, epoch), order, ends
        turn = int(np.searchsorted(self._ends, place, "right"))
        c, frames = self._batches[self._order[turn]]
        left = int(self._ends[turn]) - place
        return Batch(c, frames[len(frames) - left :][:most], epoch * len(self._batches) + turn)

    def target(self, batch: Batch) -> Target:
        """Return the pictures, ready for the loss."""
        return Target(self._cut(self._observation.image, batch))

    def white(self, batch: Batch) -> list[Bool]:
        """Return three planes: where a picture shows as much of a channel as it can."""
        seen = self._cut(self._observation.image, batch) >= WHITE
        return [Bool(np.ascontiguousarray(seen[..., channel].ravel())) for channel in range(3)]

    def outside(self, batch: Batch) -> Float:
        """1 where no flame may be, else 0."""
        return Float(np.ascontiguousarray(~self._cut(self._observation.allowed, batch).ravel(), np.float32))

    def _cut(self, pictures: np.ndarray, batch: Batch) -> np.ndarray:
        """Windows (K, height, width, ...) of those of (F, C, H, W, ...) that a batch draws."""
        return np.stack([self._windows.cut(batch.c, pictures[f, batch.c]) for f in batch.frames])


def _make_batches(delivered: np.ndarray, imagined: np.ndarray, together: int) -> list[tuple[int, tuple[int, ...]]]:
    """Every picture (F, C) once, by camera: those of a batch are as far apart as can be, and have all a view from where
    no camera stood or none."""
    batches = []
    is_imagined = np.isin(np.arange(len(delivered)), imagined)
    for c, taken in enumerate(delivered.T):
        for frames in (np.flatnonzero(taken & is_imagined), np.flatnonzero(taken & ~is_imagined)):
            apart = -(-len(frames) // together)
            batches += [(c, tuple(frames[first::apart].tolist())) for first in range(apart)]
    return sorted(batches, key=lambda batch: (batch[1], batch[0]))


def sort_by_picture(alight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the Gaussians that a batch draws, in whole groups of GROUP neighbours, moved at memory's speed.

    Args:
        alight: (K, N) bool, whether each can be seen in each picture.
    Returns:
        rows (R,) uint32, ascending, at least one group; places among them (A,) of those that are in another picture,
        too; and the picture (R + A,) of each row and each of these.
    """
    count = alight.shape[1]
    groups = np.zeros(-(-count // GROUP) * GROUP, bool)
    for mask in alight:
        groups[:count] |= mask
    numbers = np.flatnonzero(groups.reshape(-1, GROUP).any(1))
    numbers = numbers if len(numbers) else np.zeros(1, np.int64)
    rows = (GROUP * numbers[:, None] + np.arange(GROUP)).ravel()
    rows = rows[rows < count].astype(np.uint32)
    first, again, pictures = np.zeros(len(rows), np.uint32), [], []
    seen = alight[0][rows]
    for k, mask in enumerate(alight[1:], 1):
        lit = mask[rows]
        again.append(np.flatnonzero(lit & seen).astype(np.uint32))
        pictures.append(np.full(len(again[-1]), k, np.uint32))
        first[lit & ~seen] = k
        seen |= lit
    return rows, np.concatenate([rows[:0], *again]), np.concatenate([first, *pictures])
