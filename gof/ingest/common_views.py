"""Whether cameras see the same things: what structure from motion lives on, counted before it is tried.

Cameras too far apart, or before a bare wall, share no more features than two pictures of different places, whose
matches also fit some epipolar geometry: eight clips' cameras 8 to 20 degrees apart share 104 to 570, 37 degrees apart
40 to 66, cameras of different places 10 to 25 (`notebook/ingest.md`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

MOST_FEATURES = 4000
RATIO = 0.8  # of the distances to a feature's nearest and next-nearest (Lowe)
EPIPOLAR_PX = 1.5
FEWEST_MATCHES = 8  # that a fundamental matrix needs


@dataclass(frozen=True)
class PlateFeatures:
    """A picture's SIFT features: places (N, 2) px and descriptors (N, 128)."""

    places: np.ndarray
    kinds: Any


@dataclass(frozen=True)
class Link:
    """Two cameras by their numbers, how many things both see, and the features of the one that has fewer."""

    cameras: tuple[int, int]
    shared: int
    features: int


def weakest_link(plates: list[np.ndarray]) -> Link:
    """Return the pair with fewest common features among those by which all cameras hang together best.

    Args:
        plates: of two cameras or more, (H, W, 3) uint8 without fire; sizes may differ.
    """
    found = [_features(plate) for plate in plates]
    counts = {pair: _shared(*(found[c] for c in pair)) for pair in combinations(range(len(plates)), 2)}
    joined, links = {0}, []
    while len(joined) < len(plates):  # Prim's tree, of most in common
        pair = max((p for p in counts if len(joined.intersection(p)) == 1), key=lambda p: counts[p])
        links.append(pair)
        joined.update(pair)
    weakest = min(links, key=lambda p: counts[p])
    return Link(weakest, counts[weakest], min(len(found[c].places) for c in weakest))


def _features(plate: np.ndarray) -> PlateFeatures:
    import cv2

    sift = cv2.SIFT.create(MOST_FEATURES, contrastThreshold=0.01)
    everywhere = np.full(plate.shape[:2], 255, np.uint8)
    points, kinds = sift.detectAndCompute(cv2.cvtColor(plate, cv2.COLOR_RGB2GRAY), everywhere)
    return PlateFeatures(np.array([point.pt for point in points]).reshape(-1, 2), kinds)


def _shared(one: PlateFeatures, other: PlateFeatures) -> int:
    """Return how many features are each other's nearest, far nearer than the next, and fit one epipolar geometry."""
    import cv2

    if min(len(one.places), len(other.places)) < FEWEST_MATCHES:
        return 0
    nearest = [pair for pair in cv2.BFMatcher().knnMatch(one.kinds, other.kinds, k=2) if len(pair) == 2]
    back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(other.kinds, one.kinds)}
    pairs = [
        (first.queryIdx, first.trainIdx)
        for first, second in nearest
        if first.distance < RATIO * second.distance and back.get(first.trainIdx) == first.queryIdx
    ]
    if len(pairs) < FEWEST_MATCHES:
        return len(pairs)
    own, over = np.array(pairs).T
    _, fits = cv2.findFundamentalMat(one.places[own], other.places[over], cv2.USAC_MAGSAC, EPIPOLAR_PX, 0.999, 5000)
    return 0 if fits is None else int(fits.sum())
