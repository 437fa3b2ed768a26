"""DVE: density-weighted volumetric evaluation of Gaussian velocities against a true velocity field.

Paper, "Velocity Metrics": with the weight w = s_x s_y s_z alpha of each Gaussian and the expected true velocity
vbar = E[V] over the Gaussian,

    L2     = sqrt( sum w |v - vbar|^2 / sum w |vbar|^2 )          0 is perfect, 1 is what zero velocity scores
    CosSim = sum w cos(v, vbar) / sum w                           1 is perfect, 0 is what random directions score

Choices that the paper leaves open are made here and documented in docs/scores.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from dataclasses import field as dataclass_field
from typing import Any, Literal

import numpy as np

from gof.core.errors import GofError, NonFiniteError
from gof.core.gaussians import MovingGaussians
from gof.evaluate.expectation import expected_velocity
from gof.evaluate.quadrature import VelocityLike
from gof.host.threads import map_on_cores

Opacity = Literal["temporal", "base"]

CULL_SHARE = 1e-9  # total share of weight, and of weighted squared speed, that may be skipped per frame
WIDE_VOXELS = 2.0  # beyond this standard deviation three nodes per axis no longer see the field between them


@dataclass(frozen=True)
class Samples:
    """The contributions to a score of the M Gaussians that live at one time; all float64."""

    time_s: float
    index: np.ndarray  # (M,) row in the scored set of Gaussians
    position: np.ndarray  # (M, 3) m, centre at this time
    weight: np.ndarray  # (M,) m^3, s_x s_y s_z alpha, > 0
    velocity: np.ndarray  # (M, 3) m/s, estimated
    velocity_sd: np.ndarray  # (M,) m/s, how sure its components are; inf: unknown
    truth: np.ndarray  # (M, 3) m/s, expected true velocity; the field is zero outside its domain
    truth_centre: np.ndarray  # (M, 3) m/s, true velocity at the centre
    inside: np.ndarray  # (M,) share of the Gaussian inside the domain, 0..1
    wide: np.ndarray  # (M,) bool, largest standard deviation above WIDE_VOXELS
    culled: int  # Gaussians skipped for negligible weight

    def only_inside(self) -> Samples:
        """Return the Gaussians with at least half of their mass in the domain; truth is averaged over that part
        alone."""
        if (self.inside == 1).all():
            return self
        keep = self.inside >= 0.5
        rows: dict[str, Any] = {
            f.name: value[keep] for f in fields(self) if isinstance(value := getattr(self, f.name), np.ndarray)
        }
        rows["truth"] = rows["truth"] / rows["inside"][:, None]
        return replace(self, **rows)


@dataclass(frozen=True)
class Sums:
    """Weighted sums of one or more frames; adding two pools them. Weights in m^3, speeds in m/s."""

    n: int = 0
    culled: int = 0
    weight: float = 0.0
    error2: float = 0.0
    truth2: float = 0.0
    dot: float = 0.0
    cosine: float = 0.0
    outside: float = 0.0
    zero_truth: float = 0.0
    zero_velocity: float = 0.0
    wide: float = 0.0
    stated: float = 0.0  # of Gaussians that say how sure they are
    within: float = 0.0  # of those, times the share of their components within one standard deviation of the truth
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
    weight_undersampled: float  # share of Gaussians wider than 2 voxels, whose quadrature is uncertain
    speed_ratio: float | None  # least-squares gain sum w v.vbar / sum w |vbar|^2; 1: the speed is right
    l2_axis: tuple[float, float, float] | None  # error along world x, y, z over the norm of the whole truth
    undefined: str = ""

    @classmethod
    def from_sums(cls, s: Sums) -> DVEResult:
        """Ratios of the sums. Nothing to divide by gives None with a reason, never NaN."""
        share = (lambda part: min(part / s.weight, 1.0)) if s.weight > 0 else (lambda part: 0.0)
        has_truth = s.truth2 > 0
        reason = ""
        if s.weight == 0:
            reason = "no Gaussian has weight"
        elif not has_truth:
            reason = "the true velocity is zero wherever there are Gaussians"
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
            speed_ratio=s.dot / s.truth2 if has_truth else None,
            l2_axis=_axes(float(np.sqrt(e / s.truth2)) for e in s.error2_axis) if has_truth else None,
            undefined=reason,
        )


@dataclass(frozen=True)
class DVESequence:
    """The score of a sequence: `pooled` over all Gaussians of all frames, and each frame's own score in `frames`."""

    pooled: DVEResult
    frames: list[DVEResult]
    times_s: list[float]
    inside: DVEResult | None = None  # pooled over the Gaussians inside the domain; not computed for trivial baselines
    trivial_baselines: dict[str, DVESequence] = dataclass_field(default_factory=dict)
    fluctuation: DVEResult | None = None
    within_sd: float | None = None  # share of the velocity within one standard deviation of the truth; None: no v_sd
    probed: tuple[Samples, ...] = ()  # what was scored, frame by frame; kept where trivial baselines are

    @property
    def l2(self) -> float | None:
        return self.pooled.l2

    @property
    def cos_sim(self) -> float | None:
        return self.pooled.cos_sim

    def spread(self, name: Literal["l2", "cos_sim"]) -> tuple[float, float, int] | None:
        """Return mean and (population) standard deviation over the frames where the score is defined, and their
        number."""
        values = [getattr(f, name) for f in self.frames if not f.undefined]
        return (float(np.mean(values)), float(np.std(values)), len(values)) if values else None


def probe(
    gaussians: MovingGaussians,
    field: VelocityLike,
    time_s: float,
    order: int = 3,
    opacity: Opacity = "temporal",
    include_static: bool = False,
) -> Samples:
    """Weights, estimated and expected true velocities of the Gaussians that live at `time_s`.

    Gaussians are skipped (and counted) when their weight is below CULL_SHARE / N of the total *and* their weighted
    squared speed is below CULL_SHARE / N of that total: together they hold less than CULL_SHARE = 1e-9 of both, so
    CosSim moves by less than 2e-9, and L2's numerator by less than 2e-9 (sum w |v|^2 + max |V|^2 sum w).

    Raises:
        NonFiniteError: the field is NaN or Inf where a Gaussian reads it.
        GofError: unknown `opacity` or `order`.
    """
    if opacity not in ("temporal", "base"):
        raise GofError(f"opacity must be 'temporal' or 'base', got '{opacity}'")
    state = gaussians.state_at(time_s)
    position, alpha = state.at(time_s)
    if opacity == "base":
        alpha = state.opacity
    velocity = state.moving_gas.astype(np.float64)
    length, width, depth = state.scale.astype(np.float64).T
    weight = length * width * depth * alpha
    weight[~(state.dynamic | include_static)] = 0.0
    index = _not_negligible(weight, weight * _row_dot(velocity, velocity))
    position, scale = position[index].astype(np.float64), state.scale[index].astype(np.float64)
    truth = expected_velocity(field, position, scale, state.rotation[index], order)
    if not np.isfinite(truth.mean).all():
        bad = ~np.isfinite(truth.mean).all(1)
        raise NonFiniteError(
            f"the true velocity field at {time_s:g} s is NaN or Inf near {position[bad][0].round(4).tolist()} m "
            f"({int(bad.sum())} of {len(index)} Gaussians read such cells); repair the velocity store"
        )
    return Samples(
        time_s=float(time_s),
        index=index,
        position=position,
        weight=weight[index],
        velocity=velocity[index],
        velocity_sd=state.velocity_sd[index].astype(np.float64),
        truth=truth.mean,
        truth_centre=truth.centre,
        inside=truth.inside,
        wide=largest(scale) > WIDE_VOXELS * field.voxel_size,
        culled=int(np.count_nonzero(weight)) - len(index),
    )


def _axes(values: Iterable[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z


def largest(values: np.ndarray) -> np.ndarray:
    """Return the largest of the three values of each row (M, 3); numpy's own `max` takes thirty times as long."""
    first, second, third = values.T
    return np.maximum(np.maximum(first, second), third)


def _not_negligible(weight: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Return rows with weight; the others together hold less than CULL_SHARE of `weight` and of `power`, both (N,) >=
    0."""
    living = max(int(np.count_nonzero(weight)), 1)
    heavy = weight >= CULL_SHARE * weight.sum() / living
    strong = power > CULL_SHARE * power.sum() / living
    return np.flatnonzero((weight > 0) & (heavy | strong))


def agreement_sums(weight: np.ndarray, velocity: np.ndarray, truth: np.ndarray) -> Sums:
    """Return the sums behind L2 and CosSim. weight (M,) >= 0; velocity, truth (M, 3) m/s."""
    v2, t2, dot = _row_dot(velocity, velocity), _row_dot(truth, truth), _row_dot(velocity, truth)
    norms = np.sqrt(v2) * np.sqrt(t2)
    cosine = np.divide(dot, norms, out=np.zeros_like(dot), where=norms > 0)  # no direction, no agreement: 0
    error2_axis = [_sum(weight * (velocity[:, k] - truth[:, k]) ** 2) for k in range(3)]
    return Sums(
        n=len(weight),
        weight=_sum(weight),
        error2=sum(error2_axis),
        truth2=_sum(weight * t2),
        dot=_sum(weight * dot),
        cosine=_sum(weight * np.clip(cosine, -1, 1)),
        zero_truth=_sum(weight[t2 == 0]),
        zero_velocity=_sum(weight[v2 == 0]),
        error2_axis=_axes(error2_axis),
    )


def weighted_sums(samples: Samples, velocity: np.ndarray | None = None, truth: np.ndarray | None = None) -> Sums:
    """Return the sums of one frame; `velocity` and `truth` (M, 3) m/s replace the samples' own (trivial baselines,
    fluctuation)."""
    own = velocity is None and truth is None
    velocity = samples.velocity if velocity is None else velocity
    truth = samples.truth if truth is None else truth
    sums = agreement_sums(samples.weight, velocity, truth)
    if own:  # trivial baselines have no uncertainty of their own
        stated = np.where(np.isfinite(samples.velocity_sd), samples.weight, 0)
        within = [np.abs(velocity[:, k] - truth[:, k]) <= samples.velocity_sd for k in range(3)]
        sums = replace(sums, stated=_sum(stated), within=_sum(stated * sum(within) / 3))
    return replace(
        sums,
        culled=samples.culled,
        outside=_sum(samples.weight * (1 - samples.inside)),
        wide=_sum(samples.weight[samples.wide]),
    )


def _row_dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nk,nk->n", a, b)


def _sum(values: np.ndarray) -> float:
    return float(np.sum(values))  # pairwise on contiguous memory: relative error ~ eps log2(M)


def dve(
    gaussians: MovingGaussians,
    field: VelocityLike,
    time_s: float,
    order: int = 3,
    opacity: Opacity = "temporal",
    include_static: bool = False,
) -> DVEResult:
    """DVE of one frame.

    Args:
        gaussians: the result to score, world metres and m/s.
        field: true velocity at `time_s`, m/s at world points (`VelocityField` or anything with
            sample/contains/voxel_size).
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
    """Score probed frames with other velocities, (M, 3) m/s per frame, in place of the estimated ones."""
    sums = map_on_cores(lambda of: weighted_sums(*of), zip(frames, velocities, strict=True))
    return DVESequence(
        pooled=DVEResult.from_sums(sum(sums, Sums())),
        frames=[DVEResult.from_sums(s) for s in sums],
        times_s=[f.time_s for f in frames],
    )
