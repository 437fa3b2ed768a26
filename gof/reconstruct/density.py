"""Density control of the flame's Gaussians as in 3D Gaussian Splatting, which the paper does not change.

Every 100 steps those that the pictures pull hardest are cloned, or split where they are large, and those that are faint
are pruned, later on also those that are wide. Constants are those of 3DGS in the authors' published code (`eccv-demo`);
it never resets opacities, and its limit of 20 px never acts, because what it looks at was just set to 0. Three things
are ours: there are never more than MOST_GROWTH times the seeds, so that the memory is known beforehand; the pull holds
that of the alpha loss too, which is drawn in the same pass here; and it is averaged from step FIRST on, not from 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.core.morton import morton_order
from gof.reconstruct.parameters import from_raw, per_gaussian, to_raw
from gof.reconstruct.splatting import LARGE, PULL, SPLIT_SHRINK, within
from gof.render.adam import Adam
from gof.render.rasterizer import Frame

FIRST, EVERY = 500, 100  # steps
UNTIL = 0.5  # of all steps: 15 000 of the paper's 30 000
FAINT = 0.005  # opacity below which a Gaussian is pruned
WIDE_AFTER, WIDE = 3000, 0.1  # steps, from which on wide ones are pruned too: standard deviation by cameras' extent
MOST_GROWTH = 3  # times the seeds


@dataclass
class _Seen:
    """Statistics of each Gaussian over the pictures since the last change, (N,).

    Attributes:
        pull: sum of the gradients of its centre, in half picture sides (3DGS).   times: in how many pictures it was.
    """

    pull: np.ndarray
    times: np.ndarray

    @classmethod
    def nothing(cls, count: int) -> _Seen:
        return cls(np.zeros(count), np.zeros(count))


class DensityControl:
    """Watches an optimisation and changes, when it is time, which Gaussians there are."""

    def __init__(self, seeds: int, extent: float, voxel_size: float, start_s: float, steps: int, seed: int):
        """
        Args:
            seeds: how many Gaussians the optimisation starts from.   extent: of the cameras, m (`cameras_extent`).
            voxel_size, start_s: of the raw parameters, see `to_raw`.   steps: of the whole optimisation.
            seed: of where the halves of a Gaussian go.
        """
        self._most, self._extent, self._units = MOST_GROWTH * seeds, extent, (voxel_size, start_s)
        self._last, self._seed = UNTIL * steps, seed
        self._seen: _Seen | None = None

    def watch(self, step: int, frame: Frame, camera: Camera, count: int) -> None:
        """Take in the gradients of a picture after its backward pass; its first `count` Gaussians are the flame's."""
        if not FIRST <= step < self._last:
            return
        if self._seen is None:
            self._seen = _Seen.nothing(count)
        half = np.array([camera.width / 2, camera.height / 2])[:, None]
        assert frame.mean2d_grad is not None, "it is there after a backward pass"
        gradient = np.stack([g.numpy()[:count] for g in frame.mean2d_grad])  # by column: compiles nothing
        pull = np.linalg.norm(gradient * half, axis=0)
        drawn = frame.radius.numpy()[:count] > 0
        self._seen.pull[drawn] += pull[drawn]
        self._seen.times[drawn] += 1

    def change(self, step: int, optimizer: Adam) -> None:
        """Clone, split and prune after a step, where it is time; who stays keeps Adam's moments, who is new has none.

        The last Gaussian is never pruned.
        """
        done = step + 1
        if self._seen is None or done <= FIRST or done % EVERY or done >= self._last:
            return
        seen, self._seen = self._seen, None
        old = from_raw(optimizer, *self._units)
        kept, born = changed(old, seen, self._most, self._extent, done > WIDE_AFTER, (self._seed, done))
        if len(kept) == len(old) and not len(born):
            return
        both = TransientGaussians.concatenate([old[kept], born])
        order = morton_order(both.position)  # neighbours in space side by side in memory: speed only
        names = per_gaussian(optimizer)
        raw = to_raw(born, *self._units, color_of_light="color_logit" in names) if len(born) else {}
        optimizer.regroup(names, kept, raw, order)


def changed(
    old: TransientGaussians, seen: _Seen, most: int, extent: float, prune_wide: bool, seed: tuple[int, int]
) -> tuple[np.ndarray, TransientGaussians]:
    """Return the rows of the Gaussians that stay, and the new Gaussians.

    Args:
        most: there will be no more; who is pulled hardest comes first.   extent: m, of the cameras.
        prune_wide: also prune what is wide.   seed: of where halves go.
    """
    rng = np.random.default_rng(seed)
    pull = seen.pull / np.maximum(seen.times, 1)
    pulled = np.flatnonzero(pull >= PULL)
    pulled = pulled[np.argsort(-pull[pulled], kind="stable")][: max(most - len(old), 0)]
    large = old.scale[pulled].max(1) > LARGE * extent
    halves = old[np.repeat(pulled[large], 2)]
    halves = replace(halves, position=halves.position + within(halves, rng), scale=halves.scale / SPLIT_SHRINK)
    born = TransientGaussians.concatenate([old[pulled[~large]], halves])
    remains = np.ones(len(old), bool)
    remains[pulled[large]] = False
    remains &= old.opacity >= FAINT
    stays = born.opacity >= FAINT
    if prune_wide:
        remains &= old.scale.max(1) <= WIDE * extent
        stays &= born.scale.max(1) <= WIDE * extent
    if not remains.any() and not stays.any():
        remains[np.argmax(old.opacity)] = True
    return np.flatnonzero(remains), born[stays]
