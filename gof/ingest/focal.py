"""Focal lengths that nothing states, found by the matches of three or more cameras.

Two views fit almost any lens; a third one does not. Each start maps the cameras through a lens of its own, and a bundle
adjustment then frees the focal lengths, with wider gates than it ends with: a wrong lens leaves out the matches that
speak against it. The start whose poses the raw matches obey best is kept. An end that no second start reaches is not
believed: it has no rival that could contradict it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gof.core.errors import GofError
from gof.footage.lens import Lens
from gof.ingest import adjust, sfm
from gof.ingest.adjust import ZoomedModel

FEWEST_CAMERAS = 3
STARTS_DEG = (42.0, 95.0, 27.0)  # along the longer side, far from each other and from a phone's main camera
BESIDE = (1 / 1.15, 1.15)  # focal lengths beside an end that one start alone reaches, which is then begun from again
GATES_PX = (8.0, 3.0, 2.0)  # epipolar gates, each followed by an adjustment
ENOUGH, SAME = 3, 0.01  # starts that end within this share of each other: two may share a wrong end
NEARLY = 1.1  # of the best start's miss: another start that ends so well is a rival
PROBE = 1.1  # a focal length so many times as long, or as short, must fit worse
LEAST_RISE = 0.03  # by this share: what bends pictures a little makes as much
MOST_SIGMA = 0.02  # relative, of a focal length
BETWEEN_CLIPS = 0.016  # relative, standard deviation over six clips of one rig: lenses bend pictures a little
MOST_SPREAD = 0.05  # relative, of the focal lengths in which rivals end
SEPARATE = (
    0.72  # of the misfit (the square of 0.85 of an error): cameras of one kind that differ so much are told apart
)
FILM_MM = 36.0  # long side of 35 mm film

# Focal lengths for 35 mm film by the makers' data sheets (Apple: iPhone 12 to 15; Google's and Samsung's main cameras
# have 23 to 25 mm). Stabilised video is cut by up to a fifth of each side (Android's camera reference,
# CONTROL_VIDEO_STABILIZATION_MODE).
PHONES_MM = {"main camera": 26.0, "0.5x": 13.0, "2x": 52.0}
MOST_CUT = 0.2
WIDE = 16 / 9  # sides of a video


def phones_in_words() -> str:
    """Return the fields of view of phones, for people."""
    each = (
        f"{name} {_long_fov(mm):.0f} ({_long_fov(mm / (1 - MOST_CUT)):.0f} stabilised), stored upright "
        f"{_long_fov(mm * WIDE):.0f} ({_long_fov(mm * WIDE / (1 - MOST_CUT)):.0f})"
        for name, mm in PHONES_MM.items()
    )
    return f"Phones see, in degrees along the width of video stored lying: {'; '.join(each)}"


def _long_fov(mm: float) -> float:
    """Return degrees along the long side of 35 mm film."""
    return float(2 * np.rad2deg(np.arctan(FILM_MM / 2 / mm)))


def lens_unknown(why: str) -> GofError:
    """Return the error that names what phones see."""
    return GofError(
        f"no file says the lens, and {why}; give the intrinsics with either --cameras FILE or --fov DEGREES. "
        f"{phones_in_words()}"
    )


def is_findable(stated_mm: Sequence[float | None]) -> bool:
    """Return whether lenses may be found: by enough cameras, or by what every file states.

    Args:
        stated_mm: focal length for 35 mm film by each file, or None.
    """
    return len(stated_mm) >= FEWEST_CAMERAS or all(stated_mm)


def require_findable(stated_mm: Sequence[float | None]) -> None:
    """Raise GofError: see `is_findable`."""
    if not is_findable(stated_mm):
        raise lens_unknown("two views or one fit almost any; three cameras or more can find it")


@dataclass(frozen=True)
class LensSearch:
    """Facts from which lenses are found.

    Attributes:
        kinds: per camera, numbers from 0 on: cameras of one size and stated lens share a focal length.
        stated: what the files state, in words; empty where some do not.
    """

    kinds: tuple[int, ...]
    stated: str


def start_search(pictures: Sequence[tuple[int, int, float | None]]) -> tuple[list[Lens], LensSearch]:
    """Return lenses as the files state them, a typical phone's where they do not, and how to find better ones.

    Args:
        pictures: per camera width and height as stored, px, and the focal length for 35 mm film by its file, mm, or
            None.
    """
    stated = [mm for _, _, mm in pictures if mm]
    lenses = []
    for width, height, mm in pictures:
        focal = max(width, height) * (mm or PHONES_MM["main camera"]) / FILM_MM
        lenses.append(Lens(width, height, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])))
    looks = [(max(width, height), min(width, height), mm) for width, height, mm in pictures]
    kinds = tuple(list(dict.fromkeys(looks)).index(look) for look in looks)
    each = ", ".join(f"{mm:g} mm" for mm in dict.fromkeys(stated))
    words = (
        f"as the files state: {each} for 35 mm film; stabilised video is narrower"
        if all(mm for _, _, mm in pictures)
        else ""
    )
    return lenses, LensSearch(kinds, words)


@dataclass(frozen=True)
class ChosenLenses:
    """Lenses of the upright pictures, where they are from, in words, and what a user should know of them."""

    lenses: list[Lens]
    words: str
    notes: tuple[str, ...] = ()


def choose_lenses(clips: sfm.MatchedClips, lenses: list[Lens], names: list[str], search: LensSearch) -> ChosenLenses:
    """Return the lenses that the matches fit, where these are sure, else those that the files state.

    Args:
        lenses: of the upright pictures, to start from.
    Raises:
        GofError: the matches do not say, and the files do not either.
    """
    found = find_lenses(clips, lenses, np.array(search.kinds), names)
    if found is not None and found.objection is None:
        return ChosenLenses(found.lenses, found.words)
    why = "no start places all cameras" if found is None else found.objection
    if search.stated:
        return ChosenLenses(lenses, search.stated, (f"the matches do not check the lens: {why}",))
    raise lens_unknown(f"the matches do not either: {why}")


@dataclass(frozen=True)
class LensSolution:
    """Lenses of the upright pictures that were found, and how sure they are.

    Attributes:
        lenses: one per camera.   world_to_camera: (C, 4, 4).
        rise: by which share the misfit grows where the focal lengths are a tenth longer or shorter, at least.
        sigma: standard deviation of a focal length, relative, by that rise.
        spread: relative, between the focal lengths in which rival starts ended.   starts: how many ended there.
    """

    lenses: list[Lens]
    world_to_camera: np.ndarray
    rise: float
    sigma: float
    spread: float
    starts: int

    @property
    def objection(self) -> str | None:
        """Why the lenses are not believed, in words, or None."""
        if self.rise < LEAST_RISE:
            return f"a focal length a tenth longer or shorter fits but {max(self.rise, 0):.1%} worse"
        if self.sigma > MOST_SIGMA:
            return f"they show a focal length to {self.sigma:.1%} only"
        if self.starts < 2:
            return "one start alone leads to it, so nothing could contradict it"
        if self.spread > MOST_SPREAD:
            return f"focal lengths that differ by {self.spread:.0%} fit alike"
        return None

    @property
    def uncertainty(self) -> float:
        """Return the standard deviation of a focal length, relative, with what the matches do not know."""
        return float(np.hypot(self.sigma, BETWEEN_CLIPS))

    @property
    def words(self) -> str:
        """Return what was found, for people."""
        fovs = dict.fromkeys(f"{lens.fov_deg:.1f}" for lens in self.lenses)
        long = dict.fromkeys(f"{lens.long_fov_deg:.1f}" for lens in self.lenses)
        return (
            f"found by the matches: {', '.join(fovs)} degrees across the upright picture, {', '.join(long)} along its "
            f"longer side, to {self.uncertainty:.0%} ({PROBE - 1:.0%} off fits {self.rise:.0%} worse; {self.starts} "
            f"starts end within {self.spread:.1%})"
        )


def find_lenses(
    clips: sfm.MatchedClips, lenses: list[Lens], kinds: np.ndarray, names: list[str]
) -> LensSolution | None:
    """Return the lenses that the matches fit best; None where no start places all cameras.

    Args:
        lenses: of the upright pictures, to start from; other starts have other focal lengths.
        kinds: (C,) numbers from 0 on: cameras of one number share a focal length.
    """
    ended: list[tuple[float, ZoomedModel]] = []
    for start in (lenses, *([lens.seeing(start) for lens in lenses] for start in STARTS_DEG)):
        ended += _end_of(start, clips, kinds, names)
        if ended and _agree(ended):
            break
    if not ended:
        return None
    if _spread(ended)[1] == 1:
        lone = min(ended, key=_first)[1].lenses
        for factor in BESIDE:
            ended += _end_of([lens.magnified(factor) for lens in lone], clips, kinds, names)
    spread, rivals = _spread(ended)
    best, kinds = _told_apart(clips.features, min(ended, key=_first)[1], kinds)
    rise = _rise(clips.features, best, kinds)
    return LensSolution(
        best.lenses,
        best.world_to_camera,
        rise,
        (PROBE - 1) / float(np.sqrt(max(rise, 1e-9) * max(best.freedom, 1))),
        spread,
        rivals,
    )


def _end_of(
    start: list[Lens], clips: sfm.MatchedClips, kinds: np.ndarray, names: list[str]
) -> list[tuple[float, ZoomedModel]]:
    """Return the end to which these lenses lead, with its miss in px; empty where they do not place all cameras."""
    solved = clips.solve(start, names, judged=False)
    if solved.model is None:
        return []
    try:
        found = _refined(clips.features, solved.model.world_to_camera, start, kinds)
    except sfm.PoseError:
        return []
    return [(_miss_px(clips.features, found), found)]


def _agree(ended: list[tuple[float, ZoomedModel]]) -> bool:
    """Return whether enough starts ended at the same place."""
    spread, rivals = _spread(ended)
    return rivals >= ENOUGH and spread < SAME


def _first(end: tuple[float, ZoomedModel]) -> float:
    return end[0]


def _spread(ended: list[tuple[float, ZoomedModel]]) -> tuple[float, int]:
    """Return the largest difference between focal lengths of the starts that end nearly as well as the best, relative,
    and how many these are."""
    least = min(map(_first, ended))
    rivals = [np.log([lens.K[0, 0] for lens in found.lenses]) for miss, found in ended if miss <= NEARLY * least]
    return float(np.ptp(rivals, axis=0).max()), len(rivals)


def _refined(features: sfm.Features, poses: np.ndarray, lenses: list[Lens], kinds: np.ndarray) -> ZoomedModel:
    """Return poses and focal lengths, adjusted to what lies within narrower and narrower gates."""
    for gate in GATES_PX:
        found = adjust.zoomed(poses, lenses, adjust.tracks(features, lenses, poses, gate), kinds)
        poses, lenses = found.world_to_camera, found.lenses
    return found


def _told_apart(features: sfm.Features, shared: ZoomedModel, kinds: np.ndarray) -> tuple[ZoomedModel, np.ndarray]:
    """Return a model with a focal length for every camera, and their kinds, where that fits much better: phones of two
    makers may store one size."""
    each = np.arange(len(kinds))
    chains = adjust.tracks(features, shared.lenses, shared.world_to_camera, GATES_PX[0])
    together, apart = (adjust.zoomed(shared.world_to_camera, shared.lenses, chains, k) for k in (kinds, each))
    if apart.misfit > SEPARATE * together.misfit:
        return shared, kinds
    return _refined(features, apart.world_to_camera, apart.lenses, each), each


def _miss_px(features: sfm.Features, found: ZoomedModel) -> float:
    """Return the raw matches' mean distance from their epipolar lines, none counted beyond `sfm.GATE_PX`."""
    misses = [
        sfm.epipolar_distance(found.lenses, found.world_to_camera, i, j, *features.pair(i, j))
        for i, j in features.matches
    ]
    return float(np.minimum(np.concatenate(misses), sfm.GATE_PX).mean())


def _rise(features: sfm.Features, best: ZoomedModel, kinds: np.ndarray) -> float:
    """Return by which share the misfit grows, at least, where a kind's focal length is held a tenth off."""
    chains = adjust.tracks(features, best.lenses, best.world_to_camera, GATES_PX[-1])
    least = adjust.zoomed(best.world_to_camera, best.lenses, chains, kinds).misfit
    rises = []
    for kind in range(kinds.max() + 1):
        for factor in (PROBE, 1 / PROBE):
            held = [lens.magnified(factor) if k == kind else lens for lens, k in zip(best.lenses, kinds, strict=True)]
            free = np.where(kinds == kind, -1, kinds - (kinds > kind))
            rises.append(adjust.zoomed(best.world_to_camera, held, chains, free).misfit / least - 1)
    return min(rises)
