"""A folder laid out as one scene of the authors' public data set, of the drawn scene, through bent lenses.

Made by ray casting from the camera model alone: what a straight picture must look like is drawn a second time without
any lens, so neither OpenCV's rectification nor gof's reader is the truth of its own test.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from gof.core.cameras import Camera
from tests.ingest.scene import FOCAL, HEIGHT, WIDTH, _cast, cameras

DISTORTION = np.array([-0.18, 0.05, 0.002, -0.001, 0.0])
FRAME_US, ORIGIN_US = 2500.0, 13_000_000.0
FRAMES = (14, 16, 13)  # how many the three videos have; their times begin apart, see `times_us`
FIRST_US = (0.0, -4000.0, 4300.0)
UNIT = 3.7  # published units per metre
TURN = Rotation.from_euler("xyz", [160, 25, 70], degrees=True).as_matrix()  # the published world is not level
PATCH = np.s_[
    HEIGHT // 2 - 10 : HEIGHT // 2 + 10, WIDTH // 2 - 10 : WIDTH // 2 + 10
]  # its grey is 12 x the frame's number


def matrix() -> np.ndarray:
    """OpenCV's camera matrix: pixel centres at integers."""
    return np.array([[FOCAL, 0, WIDTH / 2 - 3.5], [0, FOCAL * 1.01, HEIGHT / 2 + 2.5], [0, 0, 1]])


def rays(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(..., 2): where OpenCV pixels (x, y) of the bent picture look, at depth 1, by fixed-point iteration."""
    k1, k2, p1, p2, k3 = DISTORTION
    K = matrix()
    bent = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]], -1)
    straight = bent.copy()
    for _ in range(60):
        a, b = straight[..., 0], straight[..., 1]
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        shift = np.stack([2 * p1 * a * b + p2 * (r2 + 2 * a * a), p1 * (r2 + 2 * b * b) + 2 * p2 * a * b], -1)
        straight = (bent - shift) / radial[..., None]
    return straight


def look(camera: Camera, direction: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: what the scene shows along directions (H, W, 2) of a camera's axes, at depth 1."""
    x, y = (camera.K[i, i] * direction[..., i] + camera.K[i, 2] for i in range(2))
    return np.uint8(np.rint(_cast(camera, x, y, 1.0)[0]))


def bent_picture(camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8 RGB through the lens."""
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    return look(camera, rays(x, y))


def straight_picture(camera: Camera, focal: float) -> np.ndarray:
    """(H, W, 3) uint8 RGB of a pinhole whose principal point, in OpenCV's count, is the published (W/2, H/2)."""
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    return look(camera, np.stack([(x - WIDTH / 2) / focal, (y - HEIGHT / 2) / focal], -1))


def times_us(camera: int) -> np.ndarray:
    """Of all frames of a video, on the board's clock."""
    return ORIGIN_US + FIRST_US[camera] + FRAME_US * np.arange(FRAMES[camera])


def write(folder: Path) -> list[Camera]:
    """Write the scene's folder; returns its cameras in our world, in metres."""
    folder.mkdir(parents=True)
    rig = cameras()
    R, t = [], []
    for c, camera in enumerate(rig):
        # A point is X in our world and UNIT * TURN X + shift in theirs.
        shift = np.array([2.0, -1.0, 4.0])
        R.append(camera.world_to_camera[:3, :3] @ TURN.T)
        t.append(UNIT * camera.world_to_camera[:3, 3] - R[-1] @ shift)
        still = bent_picture(camera)
        video = cv2.VideoWriter(str(folder / f"{c:03d}.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, (WIDTH, HEIGHT))
        for k in range(FRAMES[c]):
            frame = still.copy()
            frame[PATCH] = 12 * k
            video.write(frame[..., ::-1])
        video.release()
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[200:260, 30:90] = 255
        cv2.imwrite(str(folder / f"{c:03d}.mask.png"), mask)
    longest = max(FRAMES)
    published = np.stack([FIRST_US[c] + FRAME_US * np.arange(longest) for c in range(3)])  # (C, N): N of the longest
    np.savez(
        folder / "meta.npz",
        times=published,
        led_time_origin_us=np.float64(ORIGIN_US),
        camera_matrix=np.stack([matrix()] * 3),
        dist_coeffs=np.stack([DISTORTION] * 3),
        image_size=np.array([[WIDTH, HEIGHT]] * 3),
        R=np.stack(R),
        t=np.stack(t),
        points3D=UNIT * np.array([[0.0, 0.5, 0.5], [0.3, 0.1, 1.0]]) @ TURN.T + [2.0, -1.0, 4.0],
        points3D_rgb=np.zeros((2, 3), np.uint8),
    )
    return rig
