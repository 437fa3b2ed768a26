"""Where the cameras stand: solvers, their checks against each other, the metric scale and the world's axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.capture.template import BoardTemplate
from gof.errors import DataFormatError, GofError
from gof.ingest import adjust, sfm
from gof.ingest.board import board_points, board_region
from gof.lens import Lens

STILL_RANGE = 60  # of 255: pixels that change more over the clip show fire or LEDs and get no features
MAX_POINT_PX = 1.5  # mean reprojection error of board or hand-marked points above which poses are not believed
MAX_SIDE_SPREAD = 0.08  # relative spread of the marker's distances; a wrong pose makes a square a trapezium


@dataclass
class Placed:
    """world_to_camera (C, 4, 4) in metres (or the unit the report names), points (N, 3), and what was measured."""

    world_to_camera: np.ndarray
    points: np.ndarray
    report: dict


def place_cameras(clips, low, lenses: list[Lens], names: list[str], known_poses, config) -> Placed:
    """Poses of all cameras in metric world axes (Z up).

    Args:
        clips: (T, H, W, 3) uint8 RGB per camera.   low: (H, W, 3) uint8 minimum plates.
        known_poses: (4, 4) per camera or None.   config: the command's settings (points, board, marker_m, baseline_m, poses).
    Raises:
        PoseError: no solver's poses hold; says what each found, per camera, and what to do.
    """
    template = None if config.board == "none" else BoardTemplate.load(config.board)
    unit = config.marker_m or 1.0
    for value, name in ((config.marker_m, "--marker-m"), (config.baseline_m, "--baseline-m")):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise GofError(f"{name} {value}: must be a positive length in metres")
    board, notes = board_points(clips, template, unit) if template else ([], [])
    points = board
    by_hand = sfm.read_points(config.points, names) if config.points else []
    if by_hand:
        # Two sets of coordinates have no common origin: those given by hand decide.
        decides = any(p["xyz"] is not None for p in by_hand)
        points = by_hand + [p | {"xyz": None} for p in board] if decides else by_hand + board
    metric = any(p["xyz"] is not None for p in by_hand) or (config.marker_m is not None)

    if known_poses is not None:
        return Placed(
            np.array(known_poses),
            np.zeros((0, 3)),
            {
                "method": "--cameras",
                "scale": "metres, from --cameras",
                "notes": notes,
                "check": _check(points, lenses, known_poses),
            },
        )

    masks = [_still(clip, base) for clip, base in zip(clips, low, strict=True)]
    if template:
        masks = [m & ~board_region(board, c, template, unit, m.shape) for c, m in enumerate(masks)]
    found, features, report = sfm.solve(low, masks, lenses, names)
    tried = {}
    if found is not None:
        if by_hand and config.poses != "points":
            found.world_to_camera, found.points, _ = _with_points(found, features, lenses, points)
        tried["features"] = _judge(found, features, lenses, points, names)
    else:
        missing = [n for n in names if n not in report["registered"]]
        tried["features"] = {"why": f"not registered: {', '.join(missing)} (matches {report['matches']})"}
    if config.poses == "points" or (config.poses == "auto" and "why" in tried["features"]):
        try:
            found = adjust.from_known_points(points, features, lenses, names)
            tried["points"] = _judge(found, features, lenses, points, names)
        except sfm.PoseError as e:
            tried["points"] = {"why": str(e)}
    method = next(
        (m for m in ("features", "points") if m in tried and "why" not in tried[m] and config.poses in ("auto", m)),
        None,
    )
    if method is None:
        raise sfm.PoseError(_advice(tried, report, names, notes))

    world_to_camera, cloud = found.world_to_camera, found.points
    factor, scale = _scale(world_to_camera, tried[method]["check"], metric, config)
    world_to_camera = world_to_camera.copy()
    world_to_camera[:, :3, 3] *= factor
    world_to_camera, transform = upright_world(world_to_camera)
    cloud = cloud * factor @ transform[:3, :3].T + transform[:3, 3]
    return Placed(
        world_to_camera,
        cloud,
        {"method": method, "scale": scale, "notes": notes, "sfm": report, **tried[method]},
    )


def _still(clip: np.ndarray, low: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that hardly change, shrunk by two pixels."""
    import cv2

    changes = clip.max(0).astype(np.int16) - clip.min(0)
    return cv2.erode((changes.max(-1) <= STILL_RANGE).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def _with_points(found: sfm.Poses, features, lenses, points):
    """Points marked by hand join the matches in one more robust adjustment, without their coordinates."""
    chains = adjust.tracks(features, lenses, found.world_to_camera, adjust.GATES_PX[-1])
    return adjust.bundle(found.world_to_camera, lenses, [p | {"xyz": None} for p in points], chains)


def _check(points, lenses, poses) -> dict | None:
    check = adjust.check_points(points, lenses, np.asarray(poses))
    return check and {k: v if v is None else round(v, 6) for k, v in check.items()}


def _judge(found: sfm.Poses, features, lenses, points, names) -> dict:
    """Two checks that need no truth: most raw matches obey the poses, and marked points are where the poses say."""
    share = sfm.consistent_share(features, lenses, found.world_to_camera)
    check = _check(points, lenses, found.world_to_camera)
    result = {
        "consistent": {f"{names[i]}-{names[j]}": round(v, 3) for (i, j), v in share.items() if np.isfinite(v)},
        "check": check,
    }
    weak = [pair for pair, v in result["consistent"].items() if v < sfm.MIN_CONSISTENT]
    if weak:
        result["why"] = f"fewer than {sfm.MIN_CONSISTENT:.0%} of the matches of {', '.join(weak)} fit the poses"
    elif check and check["reprojection_px"] > MAX_POINT_PX:
        result["why"] = f"marked points miss by {check['reprojection_px']:.1f} px on average"
    elif check and check["spread"] is not None and check["spread"] > MAX_SIDE_SPREAD:
        result["why"] = f"the marker's sides differ by {check['spread']:.0%} under these poses"
    return result


def _advice(tried: dict, report: dict, names, notes) -> str:
    """What failed, and what to do about it."""
    lines = ["camera poses could not be solved:"]
    lines += [
        f"  from {'image features' if m == 'features' else 'known points'}: {t['why']}"
        for m, t in tried.items()
        if "why" in t
    ]
    lines += [f"  {n}: {k} features" for n, k in report["keypoints"].items()]
    lines += [f"  {n}" for n in notes]
    lines.append(
        "what helps: texture that stands still in all views (bricks, gravel, printed paper); the sync board whole in every view; "
        "cameras closer together (about 10 degrees); the right --fov; plates without people; or 6 or more points by hand with "
        "--points (docs/static.md), four of them with xyz"
    )
    return "\n".join(lines)


def _scale(poses: np.ndarray, check: dict | None, metric: bool, config) -> tuple[float, str]:
    """Factor from the poses' unit to metres, and words on where it is from."""
    centers = np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])
    baseline = float(np.linalg.norm(centers[-1] - centers[0]))
    if baseline < 1e-12:
        raise sfm.PoseError(
            "the first and the last camera stand at the same place; depth cannot be seen from one place"
        )
    if config.baseline_m is not None:
        return (
            config.baseline_m / baseline,
            f"metres, from the distance of {config.baseline_m:g} m between first and last camera",
        )
    if metric and check and check["metres_per_unit"]:
        return check["metres_per_unit"], f"metres, from points of known size (spread {check['spread']:.1%})"
    if metric:
        raise DataFormatError(
            "the scale is to come from marked points, but fewer than two with xyz are in two views; use --baseline-m"
        )
    return (
        1 / baseline,
        "unknown: the unit is the distance between first and last camera (give --marker-m or --baseline-m)",
    )


def upright_world(world_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World axes for poses in any frame: Z along the cameras' mean up, X from the first to the last camera (level), origin
    where the optical axes come nearest to each other.

    Up is as true as the cameras are level on average. Cameras that look along parallel lines put the origin at their mean
    distance apart in front of them.

    Returns:
        the new world_to_camera (C, 4, 4), and the (4, 4) map from old to new world.
    """
    R = world_to_camera[:, :3, :3]
    centers = -np.einsum("cij,ci->cj", R, world_to_camera[:, :3, 3])
    z = -R[:, 1].mean(0)
    z /= np.linalg.norm(z)
    x = centers[-1] - centers[0]
    x = x - z * (x @ z)
    if np.linalg.norm(x) < 1e-9 * max(np.linalg.norm(centers[-1] - centers[0]), 1e-300):
        x = R[0, 0] - z * (R[0, 0] @ z)  # cameras above each other
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    rays = R[:, 2]
    A = sum(np.eye(3) - np.outer(r, r) for r in rays)
    if np.linalg.cond(A) < 1e6:
        origin = np.linalg.solve(A, sum((np.eye(3) - np.outer(r, r)) @ c for r, c in zip(rays, centers, strict=True)))
    else:
        origin = centers.mean(0) + rays.mean(0) * np.linalg.norm(centers[-1] - centers[0])
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = axes, -axes @ origin
    return world_to_camera @ np.linalg.inv(transform), transform
