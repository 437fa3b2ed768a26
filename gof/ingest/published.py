"""A scene of the authors' public data set of fires (jna-358/fire_actioncam), which brings its own times and poses.

Layout of `scenes/<id>/`, as their preprocessing reads it:

    000.mp4 001.mp4 002.mp4           one video per camera
    000.mask.png ...                  bright where the LED board is, of the stored picture
    meta.npz                          times (C, N) us of every video frame, from the scene's start on the board's clock;
                                      led_time_origin_us () us, the board's clock at that start;
                                      camera_matrix (C, 3, 3) px and dist_coeffs (C, K), OpenCV, of the stored picture;
                                      image_size (C, 2) px, width and height; R (C, 3, 3) and t (C, 3), world to camera
                                      in OpenCV axes; points3D (P, 3) of the still scene

Their world has no metres: the outer cameras stand 10 units apart. Nothing in it is level; axes are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.description import METRES
from gof.core.errors import DataFormatError, GofError
from gof.core.files import write_json
from gof.core.npz import read_npz
from gof.dataset import Splits, held_out
from gof.dataset.poses import PoseReport
from gof.footage.lens import CAMERA_AXES, Lens, Turn, straightening
from gof.ingest.axes import upright_world
from gof.ingest.footage import Footage
from gof.ingest.frame_times import FrameTimes, Timing
from gof.ingest.pairing import pair
from gof.ingest.place import Placed
from gof.ingest.pose_clues import OPTIONS, PoseClues, PoseOptions

META = "meta.npz"
ZOOM = 1.03  # of their undistorted camera, so that no black borders are left
DISTORTIONS = 4, 5, 8, 12, 14  # numbers that OpenCV's models of a lens have
MOST_PIXELS = 100_000  # of a picture's side: more is no picture
CAMERAS_FILE = "published_cameras.json"


@dataclass(frozen=True)
class Meta:
    """meta.npz of a scene with C cameras, checked; shapes and units as in the head of this module."""

    path: Path
    times: np.ndarray
    led_time_origin_us: float
    camera_matrix: np.ndarray
    dist_coeffs: np.ndarray
    image_size: np.ndarray
    R: np.ndarray
    t: np.ndarray
    points3D: np.ndarray

    @classmethod
    def read(cls, folder: Path) -> Meta:
        """Read it. Raises DataFormatError: absent, damaged, a field is missing, of another shape, or not finite."""
        path = folder / META
        arrays = read_npz(path)
        cameras = len(np.atleast_1d(arrays.get("times", ())))

        def field(name: str, *shape: int) -> np.ndarray:
            if name not in arrays:
                raise DataFormatError(f"{path}: field '{name}' is missing; is this a scene of fire_actioncam?")
            found = arrays[name]
            try:
                value = found.astype(np.float64).reshape(shape)
            except ValueError as e:
                expected = tuple("N" if n < 0 else n for n in shape)
                raise DataFormatError(f"{path}: '{name}' has shape {found.shape}, expected {expected}") from e
            if not np.isfinite(value).all():
                raise DataFormatError(f"{path}: '{name}' holds NaN or Inf")
            return value

        size = field("image_size", cameras, 2)
        if (size < 1).any() or (size > MOST_PIXELS).any():
            raise DataFormatError(f"{path}: 'image_size' is {size.tolist()}, expected 1 to {MOST_PIXELS} pixels a side")
        distortion = field("dist_coeffs", cameras, -1)
        if distortion.shape[1] not in DISTORTIONS:
            raise DataFormatError(
                f"{path}: 'dist_coeffs' has {distortion.shape[1]} numbers, OpenCV's have {DISTORTIONS}"
            )
        return cls(
            path,
            field("times", cameras, -1),
            float(field("led_time_origin_us", 1)[0]),
            field("camera_matrix", cameras, 3, 3),
            distortion,
            size.astype(int),
            field("R", cameras, 3, 3),
            field("t", cameras, 3),
            field("points3D", -1, 3) if "points3D" in arrays else np.zeros((0, 3)),
        )

    def world_to_camera(self) -> np.ndarray:
        """Return (C, 4, 4) of the stored pictures, in the published world."""
        pose = np.tile(np.eye(4), (len(self.R), 1, 1))
        pose[:, :3, :3], pose[:, :3, 3] = self.R, self.t
        return pose

    def rectified(self, camera: int) -> Lens:
        """Return their undistorted camera: centred, square pixels, ZOOM times the focal length that shows no border.

        Their code gives (width / 2, height / 2) as principal point both to OpenCV, which puts pixel centres at
        integers, and to renderers that put them at halves. The poses were found with it and hold the half pixel;
        so pictures are made as theirs, and the camera is theirs.
        """
        import cv2

        width, height = (int(n) for n in self.image_size[camera])
        K, distortion = self.camera_matrix[camera], self.dist_coeffs[camera]
        tight, _ = cv2.getOptimalNewCameraMatrix(K, distortion, (width, height), 0)
        focal = ZOOM * max(tight[0, 0], tight[1, 1])
        if not (np.isfinite(focal) and focal > 0):
            raise DataFormatError(f"{self.path}: no camera without distortion fits 'camera_matrix' of camera {camera}")
        return Lens(width, height, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]))


@dataclass(frozen=True, kw_only=True)
class PublishedFootage(Footage):
    """A published scene. `lenses` are of the undistorted pictures; `world_to_camera` in our axes (Z up).

    Attributes:
        meta: what the scene says of itself.
        transform: (4, 4) from the published world to ours, a similarity.
        scale: how the unit of length is known, in words.
    """

    world_to_camera: np.ndarray  # always known
    meta: Meta
    transform: np.ndarray
    scale: str

    @classmethod
    def read(cls, folder: Path, turn: Turn = "none", baseline_m: float | None = None) -> PublishedFootage:
        """Open `scenes/<id>`.

        Args:
            turn: how stored pictures are turned upright.
            baseline_m: distance between the first and the last camera in m; None keeps the published unit.
        Raises:
            DataFormatError: a file is missing or damaged, see `Meta.read`.
        """
        meta = Meta.read(folder)
        count = len(meta.times)
        videos = tuple(folder / f"{c:03d}.mp4" for c in range(count))
        for video in videos:
            if not video.is_file():
                raise DataFormatError(f"{video}: no such file; {meta.path} describes {count} cameras")
        published = _turned(meta.world_to_camera(), turn)
        centre = -np.einsum("cij,ci->cj", published[:, :3, :3], published[:, :3, 3])
        apart = float(np.linalg.norm(centre[-1] - centre[0]))
        factor, scale = 1.0, f"that of the data set: first and last camera are {apart:.4g} of its units apart"
        if baseline_m is not None:
            factor, scale = baseline_m / apart, f"{METRES}, from --baseline-m {baseline_m:g}"
        published[:, :3, 3] *= factor
        world_to_camera, axes = upright_world(published)
        return cls(
            videos=videos,
            lenses=tuple(meta.rectified(c) for c in range(count)),
            turns=(turn,) * count,
            world_to_camera=world_to_camera,
            meta=meta,
            transform=axes @ np.diag([factor, factor, factor, 1.0]),
            scale=scale,
        )

    @property
    def frame_counts(self) -> list[int]:
        return [len(times) for times in self.meta.times]

    def frame_times(self, timing: Timing) -> FrameTimes:
        """By the board's clock, as published: cameras keep their own times, paired by the nearest frame."""
        if timing.times is not None or timing.fps or timing.stamps:
            raise GofError(f"{self.meta.path}: the scene brings its frame times; leave out --times")
        seconds = list(self.meta.times * 1e-6)
        pairing = pair(self.names, seconds, timing.start[0], timing.limit, str(self.meta.path))
        zero = seconds[0][pairing.frames[0][0]]
        source = f"published; 0 is {self.meta.led_time_origin_us * 1e-6 + zero:.6f} s of the board's clock"
        cameras = len(seconds)
        # Row times are not published.
        return FrameTimes.of(pairing, seconds, [0.0] * cameras, ["down"] * cameras, source)

    def preparation(self, camera: int) -> Callable[[np.ndarray], np.ndarray]:
        """Undistorted as theirs, then turned."""
        meta = self.meta
        return straightening(
            meta.camera_matrix[camera], meta.dist_coeffs[camera], self.lenses[camera], self.turns[camera]
        )

    def require_fitting(self, options: PoseOptions) -> None:
        """Raise GofError: an option would choose other poses, or a scale in another way than --baseline-m."""
        options.require_no_choice("those that the scene brings", OPTIONS.keys() - {"baseline_m"})

    def place(self, clips: list[PoseClues], options: PoseOptions) -> Placed:
        """As published."""
        points = self.meta.points3D @ self.transform[:3, :3].T + self.transform[:3, 3]
        return Placed(self.world_to_camera, points, PoseReport("published", self.scale))

    def splits(self, count: int) -> Splits:
        """Theirs: every 8th frame from the first on, so that scores are of the same pictures."""
        return held_out(count, first=0)

    def board_mask(self, camera: int, stored: np.ndarray | None) -> np.ndarray:
        """Return (H, W) uint8, 255 on the LED board, of the upright picture, as published."""
        import cv2

        path = self.videos[camera].with_suffix(".mask.png")
        published = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        lens = self.lenses[camera]
        if published is None or published.shape != (lens.height, lens.width):
            raise DataFormatError(f"{path}: must be a picture of {lens.width}x{lens.height} pixels, as the video")
        return (255 * (self.preparation(camera)(published) > 127)).astype(np.uint8)

    def write_beside(self, out: Path) -> None:
        """out/published_cameras.json: the cameras in the published world, to move a result of theirs into ours."""
        poses = _turned(self.meta.world_to_camera(), self.turns[0])
        write_json(out / CAMERAS_FILE, {name: pose.tolist() for name, pose in zip(self.names, poses, strict=True)})

    @property
    def provenance(self) -> dict[str, Any]:
        return {"data_set": "jna-358/fire_actioncam", "scene": self.meta.path.parent.name}


def is_published(videos: list[Path]) -> bool:
    """Return whether what was given as footage is one folder of a published scene."""
    return len(videos) == 1 and (videos[0] / META).is_file()


def _turned(world_to_camera: np.ndarray, turn: Turn) -> np.ndarray:
    """Poses (C, 4, 4) of the turned pictures."""
    axes = np.eye(4)
    axes[:3, :3] = CAMERA_AXES[turn]
    return axes @ world_to_camera
