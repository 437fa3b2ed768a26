"""Poses from a sketch of the rig and the flame alone, as in the dark.

Matches on the flame refine the sketch in a bundle adjustment. Where they hold little (for a flame that looks small, how
deep it is for its width) cameras stay near the sketch. Poses are believed only when both halves of the moments lead
to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.dataset.poses import FeatureFigures, SketchFit
from gof.footage.lens import Lens
from gof.ingest import adjust
from gof.ingest.bundle import Anchor
from gof.ingest.flame_features import FlameFeatures
from gof.ingest.rig_sketch import RigSketch
from gof.ingest.sfm import Features, Model, PoseError, epipolar_distance

STARTS_PX = ((60.0, 30.0, 15.0), (20.0, 10.0), (8.0,))  # first gates; where wrong matches win from one, another helps
SETTLED_PX = (5.0, 2.5, 2.5)  # gates of epipolar lines, each followed by a bundle adjustment
GATES_PX = (2.5,) * 6  # from the best start on: the valley is shallow
NEAR_PX = 1.5  # of its epipolar line, for a match that counts
LEAST_MATCHES = 40  # near their lines, of two cameras
MOST_CHANCE = 0.6  # of the matches near their lines, that chance would put there, too
MOST_HALVES_PX = 1.5  # between the halves' poses, root mean square on the flame, in pictures with a longer side of
LONGER_SIDE = 854  # px; of others in proportion
MORE = 1.0  # standard deviations of a count, by which the opposite order must be better to be believed
MOST_OFF = 3.5  # standard deviations from the sketch
MOST_NODES = 400  # points on the flame at which poses are compared
REMEDY = (
    "what helps: cameras nearer to each other (about 10 degrees), a clip with more fire and sharper wrinkles, a sketch "
    "measured by tape, the right --fov and --times; or something still and lit in all views, and no sketch"
)


@dataclass(frozen=True)
class ByFlame:
    """Cameras in the sketch's world: a model, the figures of its matches, and how well it fits."""

    model: Model
    figures: FeatureFigures
    fit: SketchFit


def place_by_flame(flame: FlameFeatures, sketch: RigSketch, names: list[str]) -> ByFlame:
    """Return the poses near a sketch that explain the flame, metres; z is up as far as the cameras were level.

    Raises:
        GofError: the sketch is for another number of cameras.
        PoseError: a camera shows no flame; the cameras stand in the opposite order; the flame does not hold the poses;
            with figures.
    """
    dark = [name for name, middle in zip(names, flame.middles, strict=True) if not np.isfinite(middle).all()]
    if dark:
        raise PoseError(f"--rig '{sketch.words}': {', '.join(dark)} shows no flame from which to find the cameras")
    lenses = flame.lenses
    start = sketch.poses(lenses, flame.middles)
    anchor = sketch.anchor(start)
    found = [_refined(start, flame.features, lenses, anchor, (*gates, *SETTLED_PX)) for gates in STARTS_PX]
    reached = [model for model in found if model is not None]
    figures = _figures(flame.features, names, max(reached, key=lambda m: len(m.points)) if reached else None)
    if not reached:
        raise PoseError(f"--rig '{sketch.words}': too few matches on the flame ({figures.matches}); {REMEDY}")
    best = max(reached, key=lambda model: _near(flame.features, lenses, model.world_to_camera))
    best = _refined(best.world_to_camera, flame.features, lenses, anchor, GATES_PX) or best
    _require_order(best, flame, sketch)
    fit = _judge(best, flame, anchor, names)
    objection = _objection(fit)
    if objection:
        raise PoseError(f"--rig '{sketch.words}': the flame does not hold the cameras: {objection}; {REMEDY}")
    return ByFlame(best, _figures(flame.features, names, best), fit)


def _require_order(best: Model, flame: FlameFeatures, sketch: RigSketch) -> None:
    """Raise PoseError: the cameras in the opposite order explain the flame better.

    A flame turned inside out, filmed from the opposite side, looks alike but for its perspective.
    """
    start = sketch.poses(flame.lenses, flame.middles, opposite=True)
    anchor = sketch.anchor(start)
    ours = _near(flame.features, flame.lenses, best.world_to_camera)
    for gates in STARTS_PX[:2]:
        other = _refined(start, flame.features, flame.lenses, anchor, (*gates, *SETTLED_PX))
        near = 0 if other is None else _near(flame.features, flame.lenses, other.world_to_camera)
        if near > ours + MORE * np.sqrt(ours):
            raise PoseError(
                f"--rig '{sketch.words}': cameras in the opposite order fit the flame better ({near} matches near "
                f"their lines, {ours} in this one); give the videos from left to right, as the cameras see the flame"
            )


def _refined(
    start: np.ndarray, features: Features, lenses: list[Lens], anchor: Anchor, gates: tuple[float, ...]
) -> Model | None:
    """Return the model that narrower and narrower gates lead to from poses (C, 4, 4); None where a camera is left
    without matches."""
    model = Model(start, np.zeros((0, 3)))
    for gate in gates:
        chains = adjust.tracks(features, lenses, model.world_to_camera, gate)
        if {camera for chain in chains for camera in chain} != set(range(len(lenses))):
            return None
        model = adjust.bundle(model.world_to_camera, lenses, [], chains, anchor)
    return model


def _errors(features: Features, lenses: list[Lens], poses: np.ndarray, pair: tuple[int, int], roll: int) -> np.ndarray:
    """Return (M,) px of a pair's matches from their epipolar lines; rolled, of features matched with others' partners:
    by chance."""
    first, second = features.pair(*pair)
    return epipolar_distance(lenses, poses, *pair, first, np.roll(second, roll, 0))


def _near(features: Features, lenses: list[Lens], poses: np.ndarray) -> int:
    """Return how many matches are near their epipolar lines."""
    return sum(int((_errors(features, lenses, poses, pair, 0) < NEAR_PX).sum()) for pair in features.matches)


def _judge(model: Model, flame: FlameFeatures, anchor: Anchor, names: list[str]) -> SketchFit:
    """Return the figures by which the poses are judged."""
    features, lenses, poses = flame.features, flame.lenses, model.world_to_camera
    near, chance = {}, {}
    for i, j in features.matches:
        pair, count = f"{names[i]}-{names[j]}", len(features.matches[i, j])
        near[pair] = int((_errors(features, lenses, poses, (i, j), 0) < NEAR_PX).sum())
        rolled = [(_errors(features, lenses, poses, (i, j), count * k // 8) < NEAR_PX).sum() for k in range(1, 8)]
        chance[pair] = round(float(np.mean(rolled)), 1)
    halves = [_refined(poses, flame.of_moments(parity), lenses, anchor, (4.0, 2.5, 2.5, 2.5)) for parity in (0, 1)]
    apart = float("inf")
    if halves[0] is not None and halves[1] is not None:
        apart = apart_px(halves[0].world_to_camera, halves[1].world_to_camera, halves[0].points, lenses)
        apart *= LONGER_SIDE / max(max(lens.width, lens.height) for lens in lenses)
    off = float(np.abs(anchor.residual(poses)).max())
    return SketchFit(near, chance, round(apart, 2) if np.isfinite(apart) else None, round(off, 2))


def apart_px(these: np.ndarray, those: np.ndarray, points: np.ndarray, lenses: list[Lens]) -> float:
    """Return how far pixels of points lie from where they must be by other poses: root mean square over the cameras.

    Where the rays through the pixels of `these` poses meet best by `those`, the points are put; so only differences
    count that pixels show, and none of the whole rig's place, size and turn.

    Args:
        these, those: (C, 4, 4) world to camera.   points: (N, 3) in the world of `these`.
    Returns:
        px; inf where points lie behind a camera or rays do not meet.
    """
    points = points[:: max(1, len(points) // MOST_NODES)]
    ours = np.stack([lens.K @ pose[:3] for lens, pose in zip(lenses, these, strict=True)])
    others = np.stack([lens.K @ pose[:3] for lens, pose in zip(lenses, those, strict=True)])
    pixels = _projected(ours, points)
    met = np.array([adjust.triangulate(others, px) for px in np.swapaxes(pixels, 0, 1)]).reshape(-1, 3)
    if not len(met) or not np.isfinite(met).all():
        return float("inf")
    square = ((_projected(others, met) - pixels) ** 2).sum(-1).mean()
    return float(np.sqrt(square)) if np.isfinite(square) else float("inf")


def _projected(matrices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (C, N, 2) px by matrices (C, 3, 4); NaN behind a camera."""
    image = np.einsum("cij,nj->cni", matrices, np.column_stack([points, np.ones(len(points))]))
    depth = np.where(image[..., 2:] > 0, image[..., 2:], np.nan)
    return image[..., :2] / depth


def _objection(fit: SketchFit) -> str | None:
    """Return why the figures do not let the poses be believed, or None. Every camera needs a strong pair with
    another."""
    strong = [
        pair
        for pair, count in fit.near.items()
        if count >= LEAST_MATCHES and fit.by_chance[pair] <= MOST_CHANCE * count
    ]
    names = {name for pair in fit.near for name in pair.split("-")}
    weak = sorted(names - {name for pair in strong for name in pair.split("-")})
    if weak or len(strong) < len(names) - 1:
        return (
            f"matches within {NEAR_PX} px of their lines {fit.near}, by chance {fit.by_chance}; each camera needs "
            f"{LEAST_MATCHES} with another, and fewer than {MOST_CHANCE:.0%} of them by chance"
        )
    if fit.off_sketch > MOST_OFF:
        return f"the best fit is {fit.off_sketch:.1f} standard deviations from the sketch (at most {MOST_OFF})"
    if fit.halves_px is None or fit.halves_px > MOST_HALVES_PX:
        apart = "nowhere in common" if fit.halves_px is None else f"{fit.halves_px:.1f} px apart"
        return f"the even and the odd moments put it {apart} (at most {MOST_HALVES_PX} px)"
    return None


def _figures(features: Features, names: list[str], model: Model | None) -> FeatureFigures:
    return FeatureFigures(
        keypoints={n: len(k) for n, k in zip(names, features.keypoints, strict=True)},
        matches={f"{names[i]}-{names[j]}": len(m) for (i, j), m in features.matches.items()},
        registered=() if model is None else tuple(names),
        points=None if model is None else len(model.points),
    )
