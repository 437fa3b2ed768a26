"""The similarity between a method's world and the dataset's, from the cameras that both know."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.cameras import FLIP, names_by_pictures
from gof.core.colmap import Poses, name_model, read_colmap, require_rigid_poses
from gof.core.datum import Datum
from gof.core.errors import DataFormatError, GofError
from gof.core.files import read_json
from gof.core.gaussians import MovingGaussians, TransientGaussians

SAME_WORLD = 0.02  # of the cameras' distances from each other; 100 times as many degrees
ANOTHER_RIG = 0.2  # as SAME_WORLD: what no similarity brings nearer is not the same rig


@dataclass(frozen=True)
class Alignment:
    """world_from_source (4, 4), and how well it maps one set of cameras onto the other; `reach_m`: how far those are
    from each other at most."""

    matrix: np.ndarray
    scale: float
    position_rms_m: float
    rotation_max_deg: float
    reach_m: float

    def in_words(self, source: Path) -> str:
        """Return the similarity by the cameras of `source`, and the rest that it leaves, in words."""
        apart = self.position_rms_m > SAME_WORLD * self.reach_m or self.rotation_max_deg > SAME_WORLD * 100
        return (
            f"moved by the similarity of {name_model(source)}: scale {self.scale:.4g}; cameras then "
            f"{self.position_rms_m * 1000:.2g} mm (rms) and at most {self.rotation_max_deg:.2g} degrees off"
            + (
                f"; that is much for cameras {self.reach_m:.2g} m apart: is the calibration poor, or a name wrong?"
                * apart
            )
        )


def align_result(gaussians: MovingGaussians, found: Alignment, datum: Datum) -> MovingGaussians:
    """Return a result in the world that `found` maps its own onto, whose places and times are measured from `datum`.

    Cameras state places in their whole world. Where the result counts from a datum of its own, that is added first.
    """
    own = gaussians.datum if isinstance(gaussians, TransientGaussians) else None
    if own is None:
        return gaussians.transformed(found.matrix).measured_from(datum)
    from_datum = np.eye(4)
    from_datum[:3, 3] = own.position
    moved = gaussians.transformed(found.matrix @ from_datum)
    return moved.measured_from(Datum(datum.position, own.time_s)).measured_from(datum)


def align_cameras(source: dict[str, np.ndarray], target: dict[str, np.ndarray]) -> Alignment:
    """Least-squares similarity of source cameras to target cameras of the same name (Umeyama 1991, with orientations).

    Centres alone do not fix the turn about their line, and three cameras on an arc are almost on one; so every camera
    also contributes three points one mean camera distance along its axes, in proportion to the scale that is being
    fitted.

    Args:
        source, target: name -> world_to_camera (4, 4), OpenCV; source may be in any unit.
    Raises:
        GofError: fewer than two cameras in common, all centres coincide, or the cameras stand otherwise in one set than
            in the other: after the fit, 20 % of their distances or 20 degrees are left.
    """
    names = sorted(set(source) & set(target))
    if len(names) < 2:
        raise GofError(
            f"alignment needs two cameras with the same name in both; found {names} of {sorted(source)[:5]} and "
            f"{sorted(target)[:5]}"
        )
    pose = [np.stack([np.linalg.inv(np.asarray(p[n], np.float64)) for n in names]) for p in (source, target)]
    centres = [p[:, :3, 3] for p in pose]
    with np.errstate(over="ignore"):
        spread = [np.sqrt(np.mean(np.sum((c - c.mean(0)) ** 2, 1))) for c in centres]
    if not 1e-9 < min(spread) <= max(spread) < 1e30:
        raise GofError(
            f"alignment: the camera centres spread {spread[0]:.2g} and {spread[1]:.2g} around their middle; no scale "
            "follows from that"
        )
    points = [
        np.concatenate([c] + [c + d * p[:, :3, k] for k in range(3)])
        for c, p, d in zip(centres, pose, spread, strict=True)
    ]
    mean = [p.mean(0) for p in points]
    a, b = points[0] - mean[0], points[1] - mean[1]
    u, d, vt = np.linalg.svd(b.T @ a / len(a))
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    R = u @ (sign[:, None] * vt)
    s = float((d * sign).sum() / np.mean(np.sum(a**2, 1)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = s * R, mean[1] - s * R @ mean[0]
    moved = centres[0] @ matrix[:3, :3].T + matrix[:3, 3]
    turn = np.einsum("nji,njk->nik", R @ pose[0][:, :3, :3], pose[1][:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    position_rms = float(np.sqrt(np.mean(np.sum((moved - centres[1]) ** 2, 1))))
    reach = float(np.linalg.norm(centres[1][:, None] - centres[1], axis=-1).max())
    if position_rms > ANOTHER_RIG * reach or angle.max() > ANOTHER_RIG * 100:
        worst = names[int(angle.argmax())]
        raise GofError(
            f"alignment: cameras of the same name stand otherwise in both worlds: the best fit leaves "
            f"{position_rms:.2g} m (rms, of {reach:.2g} m) and {angle.max():.2g} degrees ('{worst}'); are names "
            "swapped, or are poses camera-to-world or in OpenGL's axes?"
        )
    return Alignment(matrix, s, position_rms, float(angle.max()), reach)


def read_cameras(path: Path) -> dict[str, np.ndarray]:
    """World-to-camera matrices by camera name: a COLMAP folder, a dataset.json, a transforms.json, or name -> 4x4.

    A picture `cam_0.png` or `cam_0/000001.png` is of camera `cam_0`, and so is `static/cam_0.png` where all pictures
    lie in one folder. Folders may be written with backslashes.

    Raises:
        DataFormatError: no cameras there, one is no rotation and shift, or pictures of one camera stand apart.
    """
    path = Path(path)
    if path.is_dir():
        if (path / "dataset.json").is_file():
            return read_cameras(path / "dataset.json")
        return _of_pictures(read_colmap(path)[0], path)
    content = read_json(path)
    try:
        if "frames" in content and isinstance(content["frames"], list):
            frames = [(str(f["file_path"]), np.asarray(f["transform_matrix"], np.float64)) for f in content["frames"]]
            found = [(name, np.linalg.inv(pose.reshape(4, 4) @ FLIP)) for name, pose in frames]
        else:
            cameras = content.items()
            if "cameras" in content:
                cameras = [(c["name"], c["world_to_camera"]) for c in content["cameras"]]
            found = [(str(name), np.asarray(pose, np.float64).reshape(4, 4)) for name, pose in cameras]
    except (AttributeError, KeyError, TypeError, ValueError, np.linalg.LinAlgError) as e:
        raise DataFormatError(
            f"{path}: no cameras with a name and a 4x4 world_to_camera in it, and no 'frames' as of a transforms.json "
            f"({type(e).__name__}: {e})"
        ) from e
    for name, pose in found:
        require_rigid_poses({name: pose}, path)
    names = [name for name, _ in found]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DataFormatError(f"{path}: two cameras are called '{twice[:80]}'")
    return _of_pictures(dict(found), path) if "frames" in content else dict(found)


def _of_pictures(poses: Poses, path: Path) -> Poses:
    """Poses by camera of poses by picture: of several pictures of a camera the first by name.

    Raises:
        DataFormatError: they stand apart, so that they are of two cameras, or of one that moved.
    """
    names = sorted(poses)
    centres = {name: np.linalg.inv(pose)[:3, 3] for name, pose in poses.items()}
    reach = max(np.linalg.norm(c - centres[min(centres)]) for c in centres.values()) if centres else 0.0
    found: Poses = {}
    first: dict[str, str] = {}  # the first picture of each camera
    for name, camera in zip(names, names_by_pictures(names), strict=True):
        seen = first.setdefault(camera, name)
        turned = _degrees(poses[seen][:3, :3] @ poses[name][:3, :3].T)
        if np.linalg.norm(centres[seen] - centres[name]) > SAME_WORLD * reach or turned > SAME_WORLD * 100:
            raise DataFormatError(
                f"{path}: '{seen[:80]}' and '{name[:80]}' would both be camera '{camera[:80]}', but stand apart; name "
                "pictures CAMERA.png, or CAMERA/NUMBER.png"
            )
        found.setdefault(camera, poses[name])
    return found


def _degrees(turn: np.ndarray) -> float:
    """Return angle of a rotation (3, 3)."""
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def require_same_world(source: dict[str, np.ndarray], target: dict[str, np.ndarray], path: Path) -> str:
    """Return a sentence on whether cameras of the same name stand in the same place in both worlds.

    Args:
        source, target: name -> world_to_camera (4, 4).   path: where `source` was read.
    Raises:
        DataFormatError: they do not, by more than 2 % of the cameras' distances or 2 degrees.
    """
    names = sorted(set(source) & set(target))
    if len(names) < 2:
        return f"no two cameras of {path} are named as the dataset's, so nothing says that both have one world"
    centre = [np.stack([np.linalg.inv(poses[n])[:3, 3] for n in names]) for poses in (source, target)]
    reach = np.linalg.norm(centre[1][:, None] - centre[1], axis=-1).max()
    off = np.linalg.norm(centre[0] - centre[1], axis=1).max()
    turned = max(_degrees(source[n][:3, :3] @ target[n][:3, :3].T) for n in names)
    if off > SAME_WORLD * max(reach, 1e-12) or turned > SAME_WORLD * 100:
        raise DataFormatError(
            f"{path}: its cameras stand up to {off:.3g} m and {turned:.2g} degrees from the dataset's, so its world is "
            f"another one; bring it there: gof convert RESULT OUT.npz --align {path} --dataset DATASET"
        )
    return f"the training's cameras are the dataset's, to {off * 1000:.2g} mm and {turned:.2g} degrees"
