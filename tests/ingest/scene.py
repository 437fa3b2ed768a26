"""A small still scene with exact truth: textured planes seen by known cameras, drawn by ray casting."""

from functools import cache

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.footage.lens import Lens
from tests.conftest import look_at

WIDTH, HEIGHT, FOCAL = 240, 320, 260.0


@cache
def texture(seed: int, size: int = 1024) -> np.ndarray:
    """(size, size, 3) uint8: noise in several octaves, so that there are features at every distance."""
    rng = np.random.default_rng(seed)
    image = np.zeros((size, size, 3))
    for cells in (16, 48, 128, 320):
        image += cv2.resize(rng.random((cells, cells, 3)), (size, size), interpolation=cv2.INTER_CUBIC)
    return np.uint8(np.clip(40 + 140 * (image / 4 - 0.5) * 1.8 + 50, 0, 255))


# centre, half-axis u, half-axis v (metres), texture seed
PLANES = [
    ((0, 2.5, 1.2), (4, 0, 0), (0, 0.5, 3), 1),  # back wall, leaning
    ((0, 0.5, -0.6), (4, 0, 0), (0, 3.5, 0.2), 2),  # ground
    ((-0.7, 0.4, 0.6), (0.35, 0.2, 0), (0, 0, 0.5), 3),
    ((0.6, -0.2, 0.4), (0.3, -0.15, 0), (0, 0, 0.35), 4),
]


def cameras(scale: float = 1.0):
    """Three cameras 12 degrees apart, 3 m away (times `scale`)."""
    angles = np.deg2rad([-12, 0, 12])
    result = [
        look_at(f"cam_{i}", (3 * np.sin(a), -3 * np.cos(a), 0.9), (0, 0, 0.6), WIDTH, HEIGHT, FOCAL)
        for i, a in enumerate(angles)
    ]
    moved = []
    for c in result:
        pose = c.world_to_camera.copy()
        pose[:3, 3] *= scale
        moved.append(Camera(c.name, c.width, c.height, c.K, pose))
    return moved


def lens(camera) -> Lens:
    return Lens(camera.width, camera.height, camera.K)


def draw(camera, scale: float = 1.0, supersample: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 RGB and (H, W) camera depth (at pixel centres) of the planes."""
    n = supersample
    x, y = np.meshgrid((np.arange(n * WIDTH) + 0.5) / n, (np.arange(n * HEIGHT) + 0.5) / n)
    image, _ = _cast(camera, x, y, scale)
    image = image.reshape(HEIGHT, n, WIDTH, n, 3).mean((1, 3))
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return np.uint8(np.rint(image)), _cast(camera, x, y, scale)[1]


def _cast(camera, x, y, scale):
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T @ camera.world_to_camera[:3, :3]
    origin = camera.position
    depth = np.full(x.shape, np.inf)
    image = np.full((*x.shape, 3), 90.0)
    for centre, u, v, seed in PLANES:
        centre, u, v = (scale * np.array(p, float) for p in (centre, u, v))
        normal = np.cross(u, v)
        along = rays @ normal
        z = ((centre - origin) @ normal) / np.where(np.abs(along) < 1e-12, np.nan, along)
        hit = origin + z[..., None] * rays - centre
        a, b = hit @ u / (u @ u), hit @ v / (v @ v)
        seen = (z > 0) & (z < depth) & (np.abs(a) <= 1) & (np.abs(b) <= 1)
        picture = texture(seed)
        size = len(picture)
        # Texels of one size on every plane.
        reach = np.array([np.linalg.norm(u), np.linalg.norm(v)]) / scale
        tx = ((a + 1) * reach[0] * 110).astype(np.float32) % (size - 1)
        ty = ((b + 1) * reach[1] * 110).astype(np.float32) % (size - 1)
        colours = cv2.remap(picture, np.nan_to_num(tx), np.nan_to_num(ty), cv2.INTER_LINEAR)
        image[seen] = colours[seen]
        depth[seen] = z[seen]
    return image, depth


def relative(poses) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation and translation of every camera relative to the first."""
    first = np.linalg.inv(poses[0])
    return [((p @ first)[:3, :3], (p @ first)[:3, 3]) for p in poses[1:]]


def pose_errors(poses, truth) -> tuple[float, float]:
    """Largest rotation error in degrees, largest translation error as a share of the longest baseline, at any scale."""
    angles, a, b = [], [], []
    for (R, t), (R_true, t_true) in zip(relative(poses), relative(truth), strict=True):
        angles.append(np.rad2deg(np.arccos(np.clip((np.trace(R @ R_true.T) - 1) / 2, -1, 1))))
        a.append(t)
        b.append(t_true)
    a, b = np.array(a), np.array(b)
    a *= (a * b).sum() / (a * a).sum()
    return max(angles), float(np.linalg.norm(a - b, axis=1).max() / np.linalg.norm(b, axis=1).max())
