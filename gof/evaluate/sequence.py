"""DVE over the frames of a sequence, with the trivial baselines that tell a good score from an easy one."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from gof.core.errors import GofError
from gof.core.gaussians import MovingGaussians
from gof.evaluate.dve_frame import DVEResult, DVESequence, Opacity, Samples, Sums, probe, weighted_sums
from gof.evaluate.sparse_grid import fields_of
from gof.evaluate.trivial_baselines import fluctuation, layers, score_trivial_baselines
from gof.host.threads import map_beside


def dve_sequence(
    gaussians: MovingGaussians,
    sequence,
    times_s: Sequence[float] | np.ndarray | None = None,
    order: int = 3,
    opacity: Opacity = "temporal",
    include_static: bool = False,
    trivial_baselines: bool = True,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    controls: bool | None = None,
) -> DVESequence:
    """DVE over the frames of a sequence, with the trivial baselines that tell a good score from an easy one.

    Args:
        gaussians, order, opacity, include_static: as in `dve`.
        sequence: `VelocitySequence`: `.times_s` and `.at(time_s)` (which interpolates linearly between stored frames).
        times_s: times to score; default all of the sequence's.
        trivial_baselines: also score zero, random, shuffled, constant, per-height and true-centre velocities on the
            same Gaussians and the fluctuation (gof.evaluate.trivial_baselines). Keeps about 130 bytes per living
            Gaussian and frame; without them memory does not grow with the number of frames.
        seed: of the random and shuffled trivial baselines.
        progress: called with (frames done, frames in all).
        controls: the old name of `trivial_baselines`; goes with the next version.
    Raises:
        GofError: no dynamic Gaussian, no frame, no weight at any time, clocks that do not overlap, or a time outside
            the sequence.
        NonFiniteError: NaN or Inf in the field near a Gaussian.
    """
    if controls is not None:
        warnings.warn("dve_sequence(controls=) is now trivial_baselines=", DeprecationWarning, stacklevel=2)
        trivial_baselines = controls
    times = np.asarray(sequence.times_s if times_s is None else times_s, np.float64)
    times = _keep_covered(gaussians, times, include_static)
    fields, frames = fields_of(sequence), list[Samples]()

    def probed() -> Iterator[Samples]:
        for k, time_s in enumerate(times):
            # of a store only the chunks that Gaussians touch are read
            yield probe(gaussians, fields.at(float(time_s)), float(time_s), order, opacity, include_static)
            if progress:
                progress(k + 1, len(times))

    def sums_of(samples: Samples) -> tuple[Samples | None, Sums, Sums]:
        kept = samples if trivial_baselines else None
        return kept, weighted_sums(samples), weighted_sums(samples.only_inside())

    results: list[DVEResult] = []
    pooled = inside = Sums()
    for samples, own, own_inside in map_beside(sums_of, probed()):
        if samples is not None:
            frames.append(samples)
        pooled = pooled + own
        inside = inside + own_inside
        results.append(DVEResult.from_sums(own))
    if pooled.weight == 0:
        raise GofError(
            "no Gaussian has weight at any scored time; are t_mu and t_sigma in seconds on the dataset clock?"
        )
    scored = DVESequence(
        pooled=DVEResult.from_sums(pooled),
        frames=results,
        times_s=times.tolist(),
        inside=DVEResult.from_sums(inside),
        within_sd=pooled.within / pooled.stated if pooled.stated > 0 else None,
    )
    if not trivial_baselines:
        return scored
    layer = layers(frames)
    return replace(
        scored,
        trivial_baselines=score_trivial_baselines(gaussians, frames, layer, seed),
        fluctuation=fluctuation(frames, layer),
        probed=tuple(frames),
    )


def _keep_covered(gaussians: MovingGaussians, times: np.ndarray, include_static: bool) -> np.ndarray:
    """Return those of the times that the trajectory covers: frames that a method did not export cannot be scored."""
    _require_common_clock(gaussians, times, include_static)
    first, last = gaussians.covered_s
    times = times[(times >= first - 1e-6) & (times <= last + 1e-6)]
    if len(times) == 0:
        raise GofError(f"no scored time lies within the trajectory's {first:g}..{last:g} s")
    return times


def _require_common_clock(gaussians: MovingGaussians, times: np.ndarray, include_static: bool) -> None:
    if len(times) == 0:
        raise GofError("no frame to score: the list of times is empty")
    scored = gaussians.dynamic | include_static
    if not scored.any():
        raise GofError("the result has no dynamic Gaussian, so there is no velocity to score")
    if include_static and not gaussians.dynamic.all():
        return
    born, dead = gaussians.life()
    if born > times.max() or dead < times.min():
        raise GofError(
            f"clocks do not overlap: the Gaussians live in {born:g}..{dead:g} s, the true velocity covers "
            f"{times.min():g}..{times.max():g} s; convert the result to seconds on the dataset clock"
        )


def sanity_warnings(score: DVESequence) -> list[str]:
    """Plain-word hints that a result is in other units or another world; empty when nothing looks wrong."""
    p = score.pooled
    hints = []
    if p.weight_outside > 0.5:
        hints.append(
            f"{p.weight_outside:.0%} of the Gaussians' mass lies outside the velocity domain: another world frame, or "
            "positions in centimetres?"
        )
    if p.speed_ratio is not None and not 0.02 < abs(p.speed_ratio) < 50 and p.weight_zero_velocity < 0.5:
        hints.append(
            f"estimated speeds are {p.speed_ratio:.3g} times the true ones: velocities per millisecond, per frame or "
            "in cm/s?"
        )
    return hints
