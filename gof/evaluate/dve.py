"""DVE: density-weighted volumetric evaluation of Gaussian velocities against a true velocity field.

Paper, "Velocity Metrics": with the weight w = s_x s_y s_z alpha of each Gaussian and the expected true velocity
vbar = E[V] over the Gaussian,

    L2     = sqrt( sum w |v - vbar|^2 / sum w |vbar|^2 )          0 is perfect, 1 is what zero velocity scores
    CosSim = sum w cos(v, vbar) / sum w                           1 is perfect, 0 is what random directions score

What the paper leaves open is decided here and documented in docs/dve.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from dataclasses import field as dataclass_field
from typing import Literal

import numpy as np

from gof.errors import GofError, NonFiniteError
from gof.evaluate.quadrature import VelocityLike, expected_velocity
from gof.evaluate.sparse_grid import StoredField
from gof.evaluate.wavelength import share_of_short_waves
from gof.fields import VelocitySequence
from gof.gaussians import TransientGaussians
from gof.io.importers import Trajectory, life

CULL_SHARE = 1e-9  # total share of weight, and of weighted squared speed, that may be skipped per frame
WIDE_VOXELS = 2.0  # beyond this standard deviation three nodes per axis no longer see the field between them


@dataclass(frozen=True)
class Samples:
    """What the M Gaussians that live at one time contribute to a score; all float64."""

    time_s: float
    index: np.ndarray  # (M,) row in the scored set of Gaussians
    position: np.ndarray  # (M, 3) m, centre at this time
    weight: np.ndarray  # (M,) m^3, s_x s_y s_z alpha, > 0
    velocity: np.ndarray  # (M, 3) m/s, estimated
    truth: np.ndarray  # (M, 3) m/s, expected true velocity; the field is zero outside its domain
    truth_centre: np.ndarray  # (M, 3) m/s, true velocity at the centre
    inside: np.ndarray  # (M,) share of the Gaussian inside the domain, 0..1
    wide: np.ndarray  # (M,) bool, largest standard deviation above WIDE_VOXELS
    culled: int  # Gaussians skipped for negligible weight
    short_waves: float = 0.0  # share of the weight in Gaussians wider than 1.5 rad of the local wavelength, 0..1

    def only_inside(self) -> Samples:
        """The Gaussians with at least half of their mass in the domain; truth is averaged over that part alone."""
        if (self.inside == 1).all():
            return self
        keep = self.inside >= 0.5
        arrays = {
            f.name: getattr(self, f.name)[keep]
            for f in fields(self)
            if f.name not in ("time_s", "culled", "short_waves")
        }
        arrays["truth"] = arrays["truth"] / arrays["inside"][:, None]
        return replace(self, **arrays)


@dataclass(frozen=True)
class Sums:
    """Weighted sums of one or more frames; adding two pools them. Weights in m^3, speeds in m/s."""

    n: int = 0
    culled: int = 0
    weight: float = 0.0
    error2: float = 0.0
    truth2: float = 0.0
    velocity2: float = 0.0
    dot: float = 0.0
    cosine: float = 0.0
    outside: float = 0.0
    zero_truth: float = 0.0
    zero_velocity: float = 0.0
    wide: float = 0.0
    short_waves: float = 0.0
    error2_axis: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __add__(self, other: Sums) -> Sums:
        total = {
            f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self) if f.name != "error2_axis"
        }
        return Sums(**total, error2_axis=tuple(np.add(self.error2_axis, other.error2_axis).tolist()))


@dataclass(frozen=True)
class DVEResult:
    """The score of one frame or of several pooled. Shares are of the total weight, 0..1."""

    l2: float | None  # relative L2, >= 0; None: undefined, `undefined` says why
    cos_sim: float | None  # weighted cosine similarity, -1..1
    n: int  # Gaussians scored (summed over frames when pooled)
    n_culled: int  # Gaussians skipped: together below CULL_SHARE of the weight
    weight: float  # m^3
    weight_outside: float  # share of the Gaussians' mass outside the domain, where the truth counts as zero
    weight_zero_truth: float  # share with no true direction; it adds 0 to CosSim's numerator
    weight_zero_velocity: float  # share with no estimated direction; likewise
    weight_undersampled: float  # share of Gaussians wider than 2 voxels, whose quadrature is doubtful
    weight_short_waves: (
        float  # share of Gaussians wider than 1.5 rad of the field's local wavelength (gof.evaluate.wavelength)
    )
    speed_ratio: float | None  # least-squares gain sum w v.vbar / sum w |vbar|^2; 1: the speed is right
    l2_axis: tuple[float, float, float] | None  # error along world x, y, z over the norm of the whole truth
    undefined: str = ""

    @classmethod
    def from_sums(cls, s: Sums) -> DVEResult:
        """Ratios of the sums. Nothing to divide by gives None with a reason, never NaN."""
        share = (lambda part: min(part / s.weight, 1.0)) if s.weight > 0 else (lambda part: 0.0)
        has_truth = s.truth2 > 0
        reason = (
            ""
            if has_truth
            else "no Gaussian has weight"
            if s.weight == 0
            else "the true velocity is zero wherever there are Gaussians"
        )
        return cls(
            l2=float(np.sqrt(s.error2 / s.truth2)) if has_truth else None,
            cos_sim=float(np.clip(s.cosine / s.weight, -1, 1)) if s.weight > 0 else None,
            n=s.n,
            n_culled=s.culled,
            weight=s.weight,
            weight_outside=share(s.outside),
            weight_zero_truth=share(s.zero_truth),
            weight_zero_velocity=share(s.zero_velocity),
            weight_undersampled=share(s.wide),
            weight_short_waves=share(s.short_waves),
            speed_ratio=s.dot / s.truth2 if has_truth else None,
            l2_axis=tuple(float(np.sqrt(e / s.truth2)) for e in s.error2_axis) if has_truth else None,
            undefined=reason,
        )

    def to_dict(self) -> dict:
        """JSON-ready."""
        return asdict(self)


@dataclass(frozen=True)
class DVESequence:
    """The score of a sequence: `pooled` sums over all Gaussians of all frames, `frames` holds each frame's own score."""

    pooled: DVEResult
    frames: list[DVEResult]
    times_s: list[float]
    inside: DVEResult | None = None  # pooled over the Gaussians inside the domain; not computed for controls
    controls: dict[str, DVESequence] = dataclass_field(default_factory=dict)
    fluctuation: DVEResult | None = None

    @property
    def l2(self) -> float | None:
        return self.pooled.l2

    @property
    def cos_sim(self) -> float | None:
        return self.pooled.cos_sim

    def spread(self, name: Literal["l2", "cos_sim"]) -> tuple[float, float, int] | None:
        """Mean and (population) standard deviation over the frames where the score is defined, and their number."""
        values = [getattr(f, name) for f in self.frames if not f.undefined]
        return (float(np.mean(values)), float(np.std(values)), len(values)) if values else None

    def to_dict(self) -> dict:
        """JSON-ready: the pooled score's fields, mean and spread over frames, and one entry per frame."""
        out = self.pooled.to_dict()
        for name in ("l2", "cos_sim"):
            mean, std, count = self.spread(name) or (None, None, 0)
            out |= {f"{name}_frame_mean": mean, f"{name}_frame_std": std, "frames_scored": count}
        out["frames"] = [
            {"time_s": t, "l2": f.l2, "cos_sim": f.cos_sim, "n": f.n, "undefined": f.undefined}
            for t, f in zip(self.times_s, self.frames, strict=True)
        ]
        if self.inside is not None:
            out["inside"] = {"l2": self.inside.l2, "cos_sim": self.inside.cos_sim}
        if self.fluctuation is not None:
            out["fluctuation"] = self.fluctuation.to_dict()
        return out


def state_at(gaussians: TransientGaussians | Trajectory, time_s: float) -> TransientGaussians:
    """What can be scored or drawn at `time_s`: transient Gaussians as they are, a trajectory's state at that time."""
    return gaussians.state(time_s) if isinstance(gaussians, Trajectory) else gaussians


def probe(
    gaussians: TransientGaussians | Trajectory,
    field: VelocityLike,
    time_s: float,
    order: int = 3,
    opacity: Literal["temporal", "base"] = "temporal",
    include_static: bool = False,
) -> Samples:
    """Weights, estimated and expected true velocities of the Gaussians that live at `time_s`.

    Gaussians are skipped (and counted) when their weight is below CULL_SHARE / N of the total *and* their weighted squared
    speed is below CULL_SHARE / N of that total: together they hold less than CULL_SHARE = 1e-9 of both, so CosSim moves by
    less than 2e-9, and L2's numerator by less than 2e-9 (sum w |v|^2 + max |V|^2 sum w).

    Raises:
        NonFiniteError: the field is NaN or Inf where a Gaussian reads it.
        GofError: unknown `opacity` or `order`.
    """
    if opacity not in ("temporal", "base"):
        raise GofError(f"opacity must be 'temporal' or 'base', got '{opacity}'")
    gaussians = state_at(gaussians, time_s)
    position, alpha = gaussians.at(time_s)
    if opacity == "base":
        alpha = gaussians.opacity
    velocity = np.where(gaussians.dynamic[:, None], gaussians.velocity, 0.0).astype(np.float64)
    weight = gaussians.scale.astype(np.float64).prod(1) * alpha
    weight[~(gaussians.dynamic | include_static)] = 0.0
    power = weight * _row_dot(velocity, velocity)
    living = int(np.count_nonzero(weight))
    index = np.flatnonzero(
        (weight > 0)
        & ((weight >= CULL_SHARE * weight.sum() / max(living, 1)) | (power > CULL_SHARE * power.sum() / max(living, 1)))
    )
    position, scale = position[index].astype(np.float64), gaussians.scale[index].astype(np.float64)
    truth = expected_velocity(field, position, scale, gaussians.rotation[index], order)
    bad = ~np.isfinite(truth.mean).all(1)
    if bad.any():
        raise NonFiniteError(
            f"the true velocity field at {time_s:g} s is NaN or Inf near {position[bad][0].round(4).tolist()} m "
            f"({int(bad.sum())} of {len(index)} Gaussians read such cells); repair the velocity store"
        )
    return Samples(
        float(time_s),
        index,
        position,
        weight[index],
        velocity[index],
        *truth,
        scale.max(1, initial=0.0) > WIDE_VOXELS * field.voxel_size,
        living - len(index),
        share_of_short_waves(field, position, scale, gaussians.rotation[index], weight[index]),
    )


def weighted_sums(samples: Samples, velocity: np.ndarray | None = None, truth: np.ndarray | None = None) -> Sums:
    """The sums behind a score; `velocity` and `truth` (M, 3) m/s replace the samples' own (controls, fluctuation)."""
    v = samples.velocity if velocity is None else velocity
    t = samples.truth if truth is None else truth
    w = samples.weight
    v2, t2, dot = _row_dot(v, v), _row_dot(t, t), _row_dot(v, t)
    norms = np.sqrt(v2) * np.sqrt(t2)
    cosine = np.divide(dot, norms, out=np.zeros_like(dot), where=norms > 0)  # no direction, no agreement: 0
    error2_axis = [_sum(w * (v[:, k] - t[:, k]) ** 2) for k in range(3)]
    return Sums(
        n=len(w),
        culled=samples.culled,
        weight=_sum(w),
        error2=sum(error2_axis),
        truth2=_sum(w * t2),
        velocity2=_sum(w * v2),
        dot=_sum(w * dot),
        cosine=_sum(w * np.clip(cosine, -1, 1)),
        outside=_sum(w * (1 - samples.inside)),
        zero_truth=_sum(w[t2 == 0]),
        zero_velocity=_sum(w[v2 == 0]),
        wide=_sum(w[samples.wide]),
        short_waves=samples.short_waves * _sum(w),
        error2_axis=tuple(error2_axis),
    )


def _row_dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nk,nk->n", a, b)


def _sum(values: np.ndarray) -> float:
    return float(np.sum(values))  # pairwise on contiguous memory: relative error ~ eps log2(M)


def dve(
    gaussians: TransientGaussians | Trajectory,
    field: VelocityLike,
    time_s: float,
    order: int = 3,
    opacity: Literal["temporal", "base"] = "temporal",
    include_static: bool = False,
) -> DVEResult:
    """DVE of one frame.

    Args:
        gaussians: the result to score, world metres and m/s.
        field: true velocity at `time_s`, m/s at world points (`VelocityField` or anything with sample/contains/voxel_size).
        time_s: seconds on the dataset clock.
        order: Gauss-Hermite nodes per axis (1, 3, 5, 7); the paper's "third order" is read as 3, so 27 nodes.
        opacity: "temporal" weights a Gaussian by its opacity at `time_s`; "base" by its opacity at t_mu, dead or alive.
        include_static: also score static Gaussians, as zero velocity.
    Returns:
        DVEResult; l2 is None (with a reason) when no Gaussian has weight or the true field is zero at all of them.
    Raises:
        NonFiniteError: NaN or Inf in the field near a Gaussian.
    """
    return DVEResult.from_sums(weighted_sums(probe(gaussians, field, time_s, order, opacity, include_static)))


def score_sequence(frames: Sequence[Samples], velocities: Iterable[np.ndarray]) -> DVESequence:
    """Score frames that are already probed with other velocities, (M, 3) m/s per frame, in place of the estimated ones."""
    sums = [weighted_sums(f, v) for f, v in zip(frames, velocities, strict=True)]
    return DVESequence(
        pooled=DVEResult.from_sums(sum(sums, Sums())),
        frames=[DVEResult.from_sums(s) for s in sums],
        times_s=[f.time_s for f in frames],
    )


def dve_sequence(
    gaussians: TransientGaussians | Trajectory,
    sequence,
    times_s: Sequence[float] | None = None,
    order: int = 3,
    opacity: Literal["temporal", "base"] = "temporal",
    include_static: bool = False,
    controls: bool = True,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> DVESequence:
    """DVE over the frames of a sequence, with the controls that tell a good score from an easy one.

    Args:
        gaussians, order, opacity, include_static: as in `dve`.
        sequence: `VelocitySequence`: `.times_s` and `.at(time_s)` (which interpolates linearly between stored frames).
        times_s: times to score; default all of the sequence's.
        controls: also score zero, random, shuffled, constant, per-height and true-centre velocities on the same Gaussians and
            the fluctuation (gof.evaluate.controls). Keeps about 130 bytes per living Gaussian and frame; without them
            memory does not grow with the number of frames.
        seed: of the random and shuffled controls.
        progress: called with (frames done, frames in all).
    Raises:
        GofError: no dynamic Gaussian, no frame, no weight at any time, clocks that do not overlap, or a time outside
            the sequence.
        NonFiniteError: NaN or Inf in the field near a Gaussian.
    """
    times = np.asarray(sequence.times_s if times_s is None else times_s, np.float64)
    _require_common_clock(gaussians, times, include_static)
    if isinstance(gaussians, Trajectory):  # frames that the method did not export cannot be scored
        times = times[(times >= gaussians.time_s[0] - 1e-6) & (times <= gaussians.time_s[-1] + 1e-6)]
        if len(times) == 0:
            raise GofError(
                f"no scored time lies within the trajectory's {gaussians.time_s[0]:g}..{gaussians.time_s[-1]:g} s"
            )
    frames: list[Samples] = []
    results: list[DVEResult] = []
    pooled, inside = Sums(), Sums()
    for k, time_s in enumerate(times):
        # of a store only the chunks that Gaussians touch are read
        stored = isinstance(sequence, VelocitySequence)
        field = StoredField(sequence, float(time_s)) if stored else sequence.at(float(time_s))
        samples = probe(gaussians, field, float(time_s), order, opacity, include_static)
        if controls:
            frames.append(samples)
        own = weighted_sums(samples)
        pooled, inside = pooled + own, inside + weighted_sums(samples.only_inside())
        results.append(DVEResult.from_sums(own))
        if progress:
            progress(k + 1, len(times))
    if pooled.weight == 0:
        raise GofError(
            "no Gaussian has weight at any scored time; are t_mu and t_sigma in seconds on the dataset clock?"
        )
    scored = DVESequence(DVEResult.from_sums(pooled), results, times.tolist(), DVEResult.from_sums(inside))
    if not controls:
        return scored
    from gof.evaluate.controls import fluctuation, score_controls

    return replace(scored, controls=score_controls(gaussians, frames, seed), fluctuation=fluctuation(frames))


def _require_common_clock(gaussians: TransientGaussians | Trajectory, times: np.ndarray, include_static: bool) -> None:
    if len(times) == 0:
        raise GofError("no frame to score: the list of times is empty")
    scored = gaussians.dynamic | include_static
    if not scored.any():
        raise GofError("the result has no dynamic Gaussian, so there is no velocity to score")
    if include_static and not gaussians.dynamic.all():
        return
    born, dead = life(gaussians)
    if born > times.max() or dead < times.min():
        raise GofError(
            f"clocks do not overlap: the Gaussians live in {born:g}..{dead:g} s, the true velocity covers "
            f"{times.min():g}..{times.max():g} s; convert the result to seconds on the dataset clock"
        )


def sanity_warnings(score: DVESequence) -> list[str]:
    """Plain-word hints that a result is in other units or another world; empty when nothing looks wrong."""
    p, hints = score.pooled, []
    if p.weight_outside > 0.5:
        hints.append(
            f"{p.weight_outside:.0%} of the Gaussians' mass lies outside the velocity domain: another world frame, or "
            "positions in centimetres?"
        )
    if p.speed_ratio is not None and not 0.02 < abs(p.speed_ratio) < 50 and p.weight_zero_velocity < 0.5:
        hints.append(
            f"estimated speeds are {p.speed_ratio:.3g} times the true ones: velocities per millisecond, per frame or in "
            "cm/s?"
        )
    if p.weight_short_waves > 0.1:
        hints.append(
            f"{p.weight_short_waves:.0%} of the weight is in Gaussians wider than 1.5 rad of the flow's local wavelength, "
            "where three nodes per axis fail: compare order 3 with 5 or 7 before trusting the last digits"
        )
    return hints
