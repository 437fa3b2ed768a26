"""Where the cameras stand: solvers, and their checks against each other."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from gof.core.description import METRES
from gof.core.errors import GofError
from gof.dataset.poses import FeatureFigures, PointCheck, PoseReport
from gof.footage.flame_mask import flame_mask
from gof.footage.lens import Lens
from gof.ingest import adjust, sfm
from gof.ingest.axes import find_up, metric_scale, require_one_scale, upright_world
from gof.ingest.by_flame import place_by_flame
from gof.ingest.flame_features import FlameFeatures
from gof.ingest.focal import ChosenLenses, LensSearch, choose_lenses
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.pose_clues import MIN_JUDGED, PoseClues, PoseOptions, require_still

MIN_CONSISTENT = 0.6  # share of a pair's raw matches that must obey the poses
MAX_POINT_PX = 1.5  # mean reprojection error of board or hand-marked points above which poses are not believed
LEAST_APART = 0.01  # of the largest distance between two cameras; nearer ones tell no depth
MAX_SIDE_SPREAD = 0.08  # relative spread of the marker's distances; a wrong pose makes a square a trapezium

Method = Literal["features", "points", "rig"]


@dataclass(frozen=True)
class Placed:
    """world_to_camera (C, 4, 4) in metres (or the unit the report names), sparse points (N, 3), what was measured, and
    the upright pictures' lenses, where they were looked for."""

    world_to_camera: np.ndarray
    points: np.ndarray
    report: PoseReport
    lenses: ChosenLenses | None = None


def place_cameras(
    clips: list[PoseClues],
    lenses: list[Lens],
    names: list[str],
    given: np.ndarray | None,
    options: PoseOptions,
    search: LensSearch | None = None,
) -> Placed:
    """Poses of all cameras in metric world axes (Z up).

    Args:
        clips: the clip, then others of the same rig, whose features and boards help.
        lenses: of the upright pictures.
        given: (C, 4, 4) poses that are known already and only checked, or None.
        search: how to find the lenses, where they are not known.
    Raises:
        GofError: the lenses cannot be found.
        PoseError: no solver's poses hold; says what each found, per camera, and what to do. A camera has moved between
            the clips.
    """
    points = _all_points(clips, options)
    notes = tuple(clips[0].notes)
    moved = {}
    for other in clips[1:]:
        moved[other.name] = require_still(names, clips[0], other.name, other.plates, other.masks)
    if given is not None:
        check = adjust.check_points(points, lenses, given)
        require_one_scale(check, 1.0, options, f"the poses of --cameras ({METRES})")
        near = tuple(f"{pair} stand in one place: they tell no depth" for pair in _together(given, names))
        scale = f"{METRES}, from --cameras"
        report = PoseReport("--cameras", scale, notes + near, check=check, moved=moved or None)
        return Placed(given, np.zeros((0, 3)), report)

    if options.rig is not None:
        moved[options.rig.folder.name] = require_still(names, clips[0], options.rig.folder.name, options.rig.plates)

    # ---- solvers, and what the checks say of each --------------------------------------------------------------------
    with sfm.matched([(clip.plates, clip.masks) for clip in clips], lenses) as matches:
        seen_through = None if search is None else choose_lenses(matches, lenses, names, search)
        lenses = lenses if seen_through is None else seen_through.lenses
        solved = matches.solve(lenses, names, options.rig is None)
    if options.rig is not None:
        rig = options.rig
        chosen = _judged(
            "rig", sfm.Model(rig.world_to_camera, np.zeros((0, 3))), solved.features, points, lenses, names
        )
        if chosen.refused:
            raise sfm.PoseError(_advice([chosen], solved.figures, clips[0].notes))
        require_one_scale(chosen.check, 1.0, options, f"the rig of {rig.folder.name} ({rig.scale})")
        chains = adjust.tracks(solved.features, lenses, rig.world_to_camera, sfm.GATE_PX)
        cloud = adjust.triangulated(rig.world_to_camera, lenses, chains)
        scale = f"{rig.scale}, by the rig of {rig.folder.name}"
        figures = PoseReport("rig", scale, notes, solved.figures, chosen.consistent, chosen.check, moved)
        return Placed(rig.world_to_camera, cloud, figures)
    attempts = [_from_features(solved, points, lenses, names, options)]
    if options.solver == "points" or (options.solver == "auto" and attempts[0].refused):
        attempts.append(_from_points(solved.features, points, lenses, names))
    chosen = attempts[-1]
    if chosen.model is None or chosen.refused:
        raise sfm.PoseError(_advice(attempts, solved.figures, clips[0].notes))

    # ---- metres, and the world's axes --------------------------------------------------------------------------------
    factor, scale = metric_scale(chosen.model.world_to_camera, chosen.check, options)
    metric = chosen.model.world_to_camera.copy()
    metric[:, :3, 3] *= factor
    up, how, warnings = find_up(metric, clips[0], points, lenses, options)
    world_to_camera, transform = upright_world(metric, up)
    cloud = chosen.model.points * factor @ transform[:3, :3].T + transform[:3, 3]
    judged = (solved.figures, chosen.consistent, chosen.check)
    warnings += solved.warnings if chosen.method == "features" else ()
    report = PoseReport(chosen.method, scale, notes + warnings, *judged, moved or None, how)
    return Placed(world_to_camera, cloud, report, seen_through)


SKETCHED = (
    "poses are from a sketch and the flame: pixels agree, but the flame's depth and the scale are as good as the "
    "sketch. A wrong --fov goes unseen, and times that are off by a millisecond shift the poses by a pixel"
)


def place_from_sketch(
    flame: FlameFeatures, lenses: list[Lens], names: list[str], clip: PoseClues, options: PoseOptions
) -> Placed:
    """Poses from the sketch of `options`, refined by the flame, in world axes as `place_cameras`.

    Args:
        lenses: of the upright pictures.   clip: its board's points check the poses, as those by hand do.
    Raises:
        GofError: the sketch is for another number of cameras.
        PoseError: the flame or marked points contradict the poses.
    """
    if options.sketch is None:
        raise ValueError("place_from_sketch: needs a sketch")
    found = place_by_flame(flame, options.sketch, names)
    metric = found.model.world_to_camera.copy()
    points = _all_points([clip], options)
    check = adjust.check_points(points, lenses, metric)
    objection = _objection([], [], [], check)
    if objection:
        raise sfm.PoseError(f"--rig '{options.sketch.words}': cameras found by the flame do not hold: {objection}")
    factor, scale = 1.0, f"{METRES}, from the sketch: {options.sketch.words}"
    if options.baseline_m is not None or options.has_length:
        factor, scale = metric_scale(metric, check, options)
    metric[:, :3, 3] *= factor
    up, how, warnings = find_up(metric, clip, points, lenses, options)
    world_to_camera, transform = upright_world(metric, up)
    notes = (SKETCHED, *clip.notes, *warnings)
    report = PoseReport("sketch", scale, notes, found.figures, check=check, up=how, sketch=found.fit)
    cloud = found.model.points * factor @ transform[:3, :3].T + transform[:3, 3]
    return Placed(world_to_camera, cloud, report)


def _all_points(clips: list[PoseClues], options: PoseOptions) -> list[MarkedPoint]:
    """Return points by hand, then every clip's board. Coordinates of points by hand have no origin in common with the
    board's: those given by hand decide."""
    points = [replace(p, board=number) for number, clip in enumerate(clips) for p in clip.board]
    if any(p.xyz is not None for p in options.by_hand):
        points = [p.without_xyz() for p in points]
    return [*options.by_hand, *points]


# ---- solvers and checks ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Attempt:
    """One solver's poses and what the checks say of them; `refused` is why they are not believed."""

    method: Method
    model: sfm.Model | None = None
    consistent: dict[str, float] | None = None
    check: PointCheck | None = None
    refused: str | None = None


def _from_features(
    solved: sfm.Solution, points: list[MarkedPoint], lenses: list[Lens], names: list[str], options: PoseOptions
) -> _Attempt:
    """Structure from motion; points by hand join its matches in one more adjustment, without their coordinates."""
    model = solved.model
    if model is None:
        missing = [n for n in names if n not in solved.figures.registered]
        why = f"not registered: {', '.join(missing)} (matches {solved.figures.matches})"
        return _Attempt("features", refused=why)
    if options.by_hand and options.solver != "points":
        chains = adjust.tracks(solved.features, lenses, model.world_to_camera, adjust.GATES_PX[-1])
        model = adjust.bundle(model.world_to_camera, lenses, [p.without_xyz() for p in points], chains)
    return _judged("features", model, solved.features, points, lenses, names)


def _from_points(features: sfm.Features, points: list[MarkedPoint], lenses: list[Lens], names: list[str]) -> _Attempt:
    """Poses from points of known coordinates."""
    try:
        model = adjust.from_known_points(points, features, lenses, names)
    except sfm.PoseError as e:
        return _Attempt("points", refused=str(e))
    return _judged("points", model, features, points, lenses, names)


def _judged(
    method: Method,
    model: sfm.Model,
    features: sfm.Features,
    points: list[MarkedPoint],
    lenses: list[Lens],
    names: list[str],
) -> _Attempt:
    """Return two checks that need no truth: most raw matches obey the poses, and marked points are where the poses
    say."""
    share = sfm.consistent_share(features, lenses, model.world_to_camera)
    consistent = {f"{names[i]}-{names[j]}": round(v, 3) for (i, j), v in share.items() if np.isfinite(v)}
    judged = [pair for pair, m in features.matches.items() if len(m) >= MIN_JUDGED]
    weak = [f"{names[i]}-{names[j]}" for i, j in judged if share[i, j] < MIN_CONSISTENT]
    # The cameras of a rig are known to stand where they stood, whatever this clip's own matches tell.
    lonely = [] if method == "rig" else [n for c, n in enumerate(names) if not any(c in pair for pair in judged)]
    check = adjust.check_points(points, lenses, model.world_to_camera)
    together = _together(model.world_to_camera, names)
    return _Attempt(method, model, consistent, check, _objection(together, weak, lonely, check))


def _together(world_to_camera: np.ndarray, names: list[str]) -> list[str]:
    """Return pairs of cameras that stand in one place, as "A and B"."""
    centres = -np.einsum("cji,cj->ci", world_to_camera[:, :3, :3], world_to_camera[:, :3, 3])
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
    pairs = np.argwhere(np.triu(apart < LEAST_APART * apart.max(), 1))
    return [f"{names[i]} and {names[j]}" for i, j in pairs]


def _objection(together: list[str], weak: list[str], lonely: list[str], check: PointCheck | None) -> str | None:
    """Why these figures do not let the poses be believed, or None."""
    if together:
        return (
            f"{', '.join(together)} stand in one place (within {LEAST_APART:.0%} of the rig's width): are these two "
            "clips of one camera?"
        )
    if lonely:
        return f"{', '.join(lonely)}: fewer than {MIN_JUDGED} matches with any other camera; too few to judge poses by"
    if weak:
        return f"fewer than {MIN_CONSISTENT:.0%} of the matches of {', '.join(weak)} fit the poses"
    if check is None:
        return None
    if check.reprojection_px is None:
        return "the rays to a marked point are parallel"
    if check.reprojection_px > MAX_POINT_PX:
        return f"marked points miss by {check.reprojection_px:.1f} px on average"
    if check.spread is not None and check.spread > MAX_SIDE_SPREAD:
        return f"the marker's sides differ by {check.spread:.0%} under these poses"
    return None


def _advice(attempts: list[_Attempt], figures: FeatureFigures, notes: list[str]) -> str:
    """Return the failure and its remedy, in words."""
    source = {"features": "image features", "points": "known points", "rig": "the other clip's poses"}
    lines = ["camera poses could not be solved:"]
    lines += [f"  from {source[a.method]}: {a.refused}" for a in attempts if a.refused]
    lines += [f"  {name}: {count} features" for name, count in figures.keypoints.items()]
    lines += [f"  {note}" for note in notes]
    lines.append(
        "what helps: another clip of the same rig, if no camera was touched in between: --rig DATASET takes its poses, "
        "--with-clip FOLDER solves both together; texture that stands still in all views (bricks, gravel, printed "
        "paper); the sync board whole in every view; cameras closer together (about 10 degrees); the right --fov; "
        "plates without people; or 6 or more points by hand with --points (docs/ingest.md), four of them with xyz"
    )
    return "\n".join(lines)


GUESS = "one camera: depth is a guess; the flame is taken to stand upright over the world's origin"
GROWN_PX = 2  # so far apart, parts of a flame are one
STEEPEST_DEG = 60.0  # a camera that looks up or down more than this hardly sees how high a flame is


def place_alone(
    clip: Collection[np.ndarray], plate: np.ndarray, lens: Lens, clues: PoseClues, options: PoseOptions
) -> Placed:
    """Return the pose of the only camera; the world's y axis is its view, made level, and z is up.

    Args:
        clip: (H, W, 3) uint8 RGB upright pictures.   plate: the same without fire.   lens: of these.
        options: `flame_height_m` gives the scale; else the flame is one unit high.
    Raises:
        GofError: an option needs several cameras; no picture shows flame; the camera looks too steeply
            up or down.
    """
    rig = options.rig or options.sketch
    require_no_more(options.by_hand, options.marker_m, options.baseline_m, rig, options.solver)
    up, how, warnings = find_up(np.eye(4)[None], clues, [], [lens], options)
    tip, foot = flame_ends(clip, plate)
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    if abs(up[2]) > np.sin(np.deg2rad(STEEPEST_DEG)):
        raise GofError("the only camera looks too steeply up or down to determine the distance of its flame")
    forward /= np.linalg.norm(forward)
    ray_of_foot, ray_of_tip = (np.linalg.solve(lens.K, [*end, 1.0]) for end in (foot, tip))
    height = options.flame_height_m or 1.0
    # The foot at `far` along its ray, and `height` above it what is seen in the tip's row.
    rows = ray_of_foot[1] - ray_of_tip[1] * ray_of_foot[2], up[1] - ray_of_tip[1] * up[2]
    far = -height * rows[1] / rows[0] if rows[0] > 0 else -1.0
    if far <= 0:
        raise GofError("the flame's foot is not below its tip, as the camera says where up is; give --up cameras")
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(forward, up), forward, up], axis=1)
    pose[:3, 3] = far * ray_of_foot
    scale = (
        f"{METRES}, from the flame's height of {height:g} m"
        if options.flame_height_m
        else "unknown: the unit is the flame's height (give --flame-height-m)"
    )
    return Placed(pose[None], np.zeros((0, 3)), PoseReport("one camera", scale, (GUESS, *warnings), up=how))


def flame_ends(clip: Collection[np.ndarray], plate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tip and foot (2,) px of the largest flame of a clip, all its frames together.

    Raises:
        GofError: no picture shows flame.
    """
    fire_free, ever = (plate / 255).astype(np.float32), np.zeros(plate.shape[:2], bool)
    for picture in clip:
        ever |= flame_mask((picture / 255).astype(np.float32), fire_free, grow_px=GROWN_PX)
    _, label, stats, _ = cv2.connectedComponentsWithStats(ever.astype(np.uint8))
    if len(stats) < 2:
        raise GofError("the only camera shows no flame: nothing in its pictures rises above the plate as fire does")
    largest = (label == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])).astype(np.uint8)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * GROWN_PX + 1,) * 2)
    rows, columns = np.nonzero(cv2.erode(largest, disc, borderValue=(0,)))
    low = columns[rows > rows.max() - max(np.ptp(rows) / 10, 1)].mean() + 0.5
    return np.array([low, rows.min()]), np.array([low, rows.max() + 1.0])


def require_no_more(points: object, marker: object, baseline: object, rig: object, solver: str) -> None:
    """Raise GofError: a single camera, and an option that needs several is given, not None or empty."""
    several = {
        "--points": points,
        "--marker-mm": marker,
        "--baseline-m": baseline,
        "--rig": rig,
        "--poses": solver != "auto",
    }
    asked = [name for name, value in several.items() if value]
    if asked:
        raise GofError(f"{', '.join(asked)}: for two cameras or more; the scale of one is --flame-height-m")
