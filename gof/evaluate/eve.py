"""EVE, the emission-weighted evaluation of velocities: DVE's two numbers where the fire is, not where a result's
Gaussians are.

With e(x, t) the true light of a place, V(x, t) the true velocity there, and v(x, t) the mean velocity of the result's
visible Gaussians (`gof.evaluate.visible`), or zero where next to nothing of the result is,

    L2     = sqrt( sum e |v - V|^2 / sum e |V|^2 )
    CosSim = sum e cos(v, V) / sum e

summed over places and frames. Nothing in these weights is the result's choice. The fluctuation is the same two figures
of what is left of v and of V without their own mean over time at each place, weighted by e: every steady field, the
clip's true mean too, has L2 1 and CosSim 0 there.

The sums are over PLACES places of the clip, drawn from the light of all its frames and asked at every frame in which
they burn; they are the same for every result.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from gof.core.costs import timed
from gof.core.fields import VelocitySequence
from gof.core.gaussians import MovingGaussians, TransientGaussians
from gof.evaluate.dve_frame import DVEResult, Sums, agreement_sums
from gof.evaluate.emission import FlameGrid
from gof.evaluate.intervals import own_generator
from gof.evaluate.sparse_grid import StoredField, StoredFields, fields_of
from gof.evaluate.visible import opacity_per_metre
from gof.host.threads import map_on_cores

GRADIENTS = 128  # places per frame, drawn from its light; six velocities each
PLACES = 1024  # of a clip, each asked at every frame in which it burns
GROUPS = 8  # of places, each spread over the whole flame; they tell how exact the sums are
EMPTY = 0.01  # of the mean opacity per metre where the flame is; below, nothing of the result is there
LAYERS = 32  # of the mean velocity per height

BASELINES = {
    "constant": "one vector everywhere: the mean true velocity",
    "height_mean": "the mean true velocity of each height, everywhere",
    "mean_field": "the clip's mean true velocity of each place: nothing unsteady",
    "light": "the Gaussians' own motion, where the result also states a velocity of the gas",
    "true_centre": "the true velocity at each Gaussian's centre: the best that one vector a Gaussian can do",
}


@dataclass(frozen=True)
class ClipPlaces:
    """Places of a clip: where it burns at any time, and how much light of each frame each place stands for.

    Attributes:
        times_s: (T,).   position: (M, 3) world m.
        light: (T, M) >= 0; the sum over M is, on average, the frame's whole light.
        truth: (T, M, 3) m/s; zero where `light` is.
    """

    times_s: np.ndarray
    position: np.ndarray
    light: np.ndarray
    truth: np.ndarray

    @classmethod
    def draw(
        cls,
        truth: VelocitySequence | StoredFields,
        flame: FlameGrid,
        times_s: np.ndarray,
        count: int = PLACES,
        seed: int = 0,
    ) -> ClipPlaces:
        """Draw equally many from every frame's light.

        A place stands for its light over the density with which it was drawn, the mean over frames of their
        normalised light, so that sums over places are right on average whichever frame it was drawn from.

        Raises:
            DataFormatError: see `FlameGrid.places`.
        """
        rng = own_generator("places of the clip", seed)
        fields, times_s = fields_of(truth), np.asarray(times_s, np.float64)
        each = -(-count // len(times_s))
        drawn = [flame.places(float(time_s), each, rng) for time_s in times_s]
        position = np.concatenate([np.zeros((0, 3)), *drawn])
        found = [flame.light_at(float(time_s), position) for time_s in times_s]
        light, whole = np.array([one for one, _ in found]), np.array([total for _, total in found])
        burning = whole > 0
        density = (light[burning] / whole[burning, None]).mean(0) if burning.any() else np.ones(len(position))
        light = light / np.where(density > 0, density, 1) / max(len(position), 1)
        velocity = np.zeros((*light.shape, 3))
        for k, time_s in enumerate(times_s):
            rows = np.flatnonzero(light[k])
            velocity[k, rows] = fields.at(float(time_s)).sample(position[rows])
        return cls(times_s, position, light, velocity)


@dataclass(frozen=True)
class EveResult:
    """EVE of a clip.

    Attributes:
        pooled: over places and frames.   frames: of each frame.   fluctuation: see above.
        l2_sd, cos_sim_sd: standard deviation of `pooled` from the number of places; None where it is undefined.
        empty: share of the true light where nothing of the result is, 0..1.
        baselines: by name (BASELINES); "light" only where gas and light have a velocity each.
    """

    pooled: DVEResult
    frames: list[DVEResult]
    times_s: list[float]
    fluctuation: DVEResult
    l2_sd: float | None
    cos_sim_sd: float | None
    empty: float
    baselines: dict[str, DVEResult] = field(default_factory=dict)


def score_where_it_burns(
    gaussians: MovingGaussians,
    truth: VelocitySequence | StoredFields,
    flame: FlameGrid,
    times_s: np.ndarray,
    costs: dict[str, float],
    progress: Callable[..., None],
) -> tuple[EveResult, GradientErrors]:
    """Score a result's velocities where the fire is, and their gradients there.

    Args:
        truth, flame, times_s: as in `score_eve`.
        costs: seconds by part; "eve" and "gradients" are added.
        progress: progress(done, total, stage=name).
    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    fields = fields_of(truth)
    with timed(costs, "eve"):
        eve = score_eve(gaussians, fields, flame, times_s, progress=partial(progress, stage="EVE"))
    with timed(costs, "gradients"):
        return eve, score_gradients(gaussians, fields, flame, times_s, progress=partial(progress, stage="gradients"))


def score_eve(
    gaussians: MovingGaussians,
    truth: VelocitySequence | StoredFields,
    flame: FlameGrid,
    times_s: np.ndarray,
    places: ClipPlaces | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> EveResult:
    """Score a result's velocities where the fire is.

    Args:
        truth, flame: true velocity and light, with frames at all of `times_s` (T,).
        places: of `ClipPlaces.draw` for the same truth and times, where several results are scored; default: drawn.
        progress: progress(done, total).
    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    fields = fields_of(truth)
    places = ClipPlaces.draw(fields, flame, times_s) if places is None else places
    answers: dict[str, np.ndarray] = {}
    weights = np.zeros(places.light.shape)

    def asked(k: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        time_s, rows = float(places.times_s[k]), np.flatnonzero(places.light[k])
        state = gaussians.state_at(time_s)
        visible = opacity_per_metre(places.position[rows], state, time_s)
        velocities = _compared_velocities(state, fields.at(time_s), time_s, visible.gaussian)
        return rows, visible.total(), {name: visible.mean_velocity(velocity) for name, velocity in velocities.items()}

    for k, (rows, total, means) in enumerate(map_on_cores(asked, range(len(places.times_s)), progress)):
        weights[k, rows] = total
        for name, velocity in means.items():
            answers.setdefault(name, np.zeros_like(places.truth))[k, rows] = velocity
    mean = (places.light * weights).sum() / max(places.light.sum(), 1e-300)
    empty = weights <= EMPTY * mean
    for velocity in answers.values():
        velocity[empty] = 0
    return _result(places, answers, empty)


def _compared_velocities(
    state: TransientGaussians, field: StoredField, time_s: float, seen: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the velocities (N, 3) of the Gaussians that are compared; "true_centre" of the `seen` rows alone."""
    moving = state.dynamic[:, None]
    velocities = {"own": state.moving_gas.astype(np.float64)}
    if state.gas_velocity is not None:
        velocities["light"] = np.where(moving, state.velocity, 0).astype(np.float64)
    rows = np.unique(seen)
    velocities["true_centre"] = np.zeros((len(state), 3))
    velocities["true_centre"][rows] = field.sample(state.at(time_s)[0][rows].astype(np.float64))
    return velocities


def _result(places: ClipPlaces, answers: dict[str, np.ndarray], empty: np.ndarray) -> EveResult:
    own, true, light = answers.pop("own"), places.truth, places.light
    frames = [agreement_sums(w, v, t) for w, v, t in zip(light, own, true, strict=True)]
    groups = np.arange(light.shape[1]) % GROUPS
    without = (groups != group for group in range(GROUPS))
    apart = [DVEResult.from_sums(_sums(light[:, one], own[:, one], true[:, one])) for one in without]
    return EveResult(
        pooled=DVEResult.from_sums(sum(frames, Sums())),
        frames=[DVEResult.from_sums(one) for one in frames],
        times_s=places.times_s.tolist(),
        fluctuation=DVEResult.from_sums(_sums(light, _unsteady(own, light), _unsteady(true, light))),
        l2_sd=_jackknife([one.l2 for one in apart]),
        cos_sim_sd=_jackknife([one.cos_sim for one in apart]),
        empty=float(light[empty].sum() / max(light.sum(), 1e-300)),
        baselines={
            name: DVEResult.from_sums(_sums(light, velocity, true))
            for name, velocity in (_means(places) | answers).items()
        },
    )


def _sums(light: np.ndarray, velocity: np.ndarray, truth: np.ndarray) -> Sums:
    return agreement_sums(light.ravel(), velocity.reshape(-1, 3), truth.reshape(-1, 3))


def _unsteady(velocity: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return velocities (T, M, 3) without their mean over time at each place, by light (T, M)."""
    rest = velocity - _mean_over_time(velocity, light)
    rest[np.abs(rest).max(-1) <= 1e-9 * np.abs(velocity).max(initial=0)] = 0  # rounding is no fluctuation
    return rest


def _mean_over_time(velocity: np.ndarray, light: np.ndarray) -> np.ndarray:
    total = light.sum(0)
    return np.einsum("tm,tmk->mk", light, velocity) / np.where(total > 0, total, 1)[:, None]


def _means(places: ClipPlaces) -> dict[str, np.ndarray]:
    """Return the velocities (T, M, 3) of the baselines that know the truth and nothing of the result."""
    light, true = places.light, places.truth
    weight, means = light.sum(0), _mean_over_time(true, light)
    height = places.position[:, 2]
    edges = np.quantile(height, np.linspace(0, 1, LAYERS + 1)[1:-1]) if len(height) else []
    layer = np.searchsorted(edges, height)
    total = np.maximum(np.bincount(layer, weight, LAYERS), 1e-300)
    of_layer = np.stack([np.bincount(layer, weight * means[:, k], LAYERS) for k in range(3)], 1) / total[:, None]
    constant = (weight[:, None] * means).sum(0) / max(weight.sum(), 1e-300)
    shape = true.shape
    return {
        "constant": np.broadcast_to(constant, shape),
        "height_mean": np.broadcast_to(of_layer[layer], shape),
        "mean_field": np.broadcast_to(means, shape),
    }


def _jackknife(values: list[float | None]) -> float | None:
    """Return the standard deviation of a figure from its values without one group of places each."""
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return None
    return float(np.sqrt((len(known) - 1) * np.var(known)))


# ---------------------------------------------------------------- gradients
#
# For a result and the truth, the central difference over one cell of the true grid to each side of a place. Where no
# Gaussian is on one of the six sides, a result says nothing of how the flow changes, and its gradient counts as zero.
#
#     vorticity   sqrt( sum |w - W|^2 / sum |W|^2 )            w, W: curl of the result's and of the true velocity
#     divergence  sqrt( sum (d - D)^2 / sum |grad V|^2 )       d, D: divergence; over the size of the true gradient, as
#                                                              a true divergence is next to nothing outside the flame


@dataclass(frozen=True)
class GradientErrors:
    """Pooled over all frames; None where the true gradient is zero, or nothing shines.

    Attributes:
        still_divergence_l2: the divergence error of a flow that stands still (its vorticity error is 1).
        uncovered: share of the places without a Gaussian on one of their sides, 0..1.
    """

    vorticity_l2: float | None
    divergence_l2: float | None
    still_divergence_l2: float | None
    uncovered: float


def score_gradients(
    gaussians: MovingGaussians,
    truth: VelocitySequence | StoredFields,
    flame: FlameGrid,
    times_s: np.ndarray,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> GradientErrors:
    """Return errors at GRADIENTS places per frame, drawn from the true emission; the seed makes them the same for all
    results.

    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    rng, fields = own_generator("places of gradients", seed), fields_of(truth)
    drawn = [(time_s, flame.places(time_s, GRADIENTS, rng)) for time_s in map(float, times_s)]

    def errors(of: tuple[float, np.ndarray]) -> tuple[np.ndarray, int]:
        time_s, places = of
        if not len(places):
            return np.zeros(5), 0
        field, state = fields.at(time_s), gaussians.state_at(time_s)
        sides = six_sides(places, field.voxel_size)
        seen = opacity_per_metre(sides, state, time_s)
        velocity = seen.mean_velocity(state.moving_gas)
        known = (seen.total() > 0).reshape(6, -1).all(0)
        found = gradient(velocity, field.voxel_size) * known[:, None, None]
        true = gradient(field.sample(sides).astype(np.float64), field.voxel_size)
        return _squares(found, true), int((~known).sum())

    found = map_on_cores(errors, drawn, progress)
    sums = sum((squares for squares, _ in found), np.zeros(5))
    uncovered, count = sum(unknown for _, unknown in found), sum(len(places) for _, places in drawn)
    rotation, true_rotation, expansion, true_expansion, size = sums
    return GradientErrors(
        vorticity_l2=float(np.sqrt(rotation / true_rotation)) if true_rotation > 0 else None,
        divergence_l2=float(np.sqrt(expansion / size)) if size > 0 else None,
        still_divergence_l2=float(np.sqrt(true_expansion / size)) if size > 0 else None,
        uncovered=uncovered / max(count, 1),
    )


def six_sides(places: np.ndarray, step: float) -> np.ndarray:
    """Return (6 M, 3): the places (M, 3) moved by a step along +x, +y, +z, -x, -y, -z."""
    moves = step * np.concatenate([np.eye(3), -np.eye(3)])
    return (moves[:, None] + places).reshape(-1, 3)


def gradient(values: np.ndarray, step: float) -> np.ndarray:
    """Return (M, 3, 3) of a vector's values (6 M, 3) at `six_sides`: [:, j, k] is the change of component k along axis
    j."""
    ahead, behind = values.reshape(2, 3, -1, 3)
    return np.moveaxis((ahead - behind) / (2 * step), 0, 1)


def curl(gradients: np.ndarray) -> np.ndarray:
    """Return (M, 3) 1/s of velocity gradients (M, 3, 3) with [:, j, k] = d v_k / d x_j."""
    spin = gradients - gradients.transpose(0, 2, 1)
    return np.stack([spin[:, 1, 2], spin[:, 2, 0], spin[:, 0, 1]], -1)


def _squares(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return (5,) sums of squares: error and size of the vorticity, error and size of the divergence, size of the
    gradient."""
    rotation, expansion = curl(true), np.trace(true, axis1=1, axis2=2)
    parts = (
        curl(found) - rotation,
        rotation,
        np.trace(found, axis1=1, axis2=2) - expansion,
        expansion,
        true,
    )
    return np.array([np.square(part).sum() for part in parts])
