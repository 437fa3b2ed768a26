"""What cameras see of light in a grid: rays that gather what shines and lose what stands before it, then 8 bits."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from scipy.sparse import csr_array

from gof.core.cameras import Camera
from gof.core.colour import linear_to_srgb

STEP = 0.8  # cells between two samples of a ray


def around(
    low: np.ndarray, high: np.ndarray, azimuth_deg: np.ndarray, height_deg: np.ndarray, away: float, longest_px: int
) -> list[Camera]:
    """Return cameras that look at the middle of a box, fill their pictures with it, and stand at the angles given.

    Args:
        low, high: (3,) corners, world m.    away: distance over the box's diagonal; > 0.6.
    """
    middle, corners = (low + high) / 2, np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    upright = high[2] - low[2] > max(high[:2] - low[:2])
    width, height = (longest_px * 9 // 16, longest_px) if upright else (longest_px, longest_px * 9 // 16)
    poses = []
    for turn, lift in zip(np.radians(azimuth_deg), np.radians(height_deg), strict=True):
        outward = np.array([np.cos(turn) * np.cos(lift), np.sin(turn) * np.cos(lift), np.sin(lift)])
        right = np.array([-np.sin(turn), np.cos(turn), 0])
        axes = np.stack([right, np.cross(-outward, right), -outward])  # x right, y down, z forward
        pose = np.eye(4)
        pose[:3, :3] = axes
        pose[:3, 3] = -axes @ (middle + away * np.linalg.norm(high - low) * outward)
        poses.append(pose)
    seen = [corners @ pose[:3, :3].T + pose[:3, 3] for pose in poses]
    reach = [np.abs(xyz[:, :2] / xyz[:, 2:]).max(0) for xyz in seen]
    focal = min(0.46 * width / max(r[0] for r in reach), 0.46 * height / max(r[1] for r in reach))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return [Camera(f"cam_{i}", width, height, K, pose) for i, pose in enumerate(poses)]


def gathered(camera: Camera, light: np.ndarray, index_to_world: np.ndarray, absorption: float = 0.0) -> np.ndarray:
    """Return what reaches the camera of light in every frame, (F, H, W), emission times m.

    Args:
        light: (F, X, Y, Z) >= 0 per m.    index_to_world: as of `VelocityField`, with cells that are cubes.
        absorption: 1/m for a unit of light; what shines stands in the way of what shines behind it.
    """
    frames, cells = light.shape[0], light.shape[1:]
    values = np.ascontiguousarray(light.reshape(frames, -1).T)
    cell = index_to_world[0, 0]
    origin, rays = _rays(camera, index_to_world)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(0.0 - origin) / rays, (np.array(cells) - 1 - origin) / rays])
    near, far = np.nanmax(ends.min(0), 1), np.nanmin(ends.max(0), 1)
    result = np.zeros((len(rays), frames), np.float32)
    depth = np.zeros_like(result)
    at = np.maximum(near, 0) + STEP / 2
    while (going := np.flatnonzero(at < far)).size:
        found = _between(origin + at[going, None] * rays[going], cells) @ values
        thick = found * np.float32(absorption * STEP * cell)
        result[going] += found * np.exp(-depth[going] - thick / 2) * np.float32(STEP * cell)
        depth[going] += thick
        at += STEP
    return result.T.reshape(frames, camera.height, camera.width)


def _rays(camera: Camera, index_to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's place (3,) in cells, 0 at the first centre, and its pixels' rays (H W, 3), one cell long."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    towards = camera.unproject(np.stack([column.ravel(), row.ravel()], -1), np.ones(column.size)) - camera.position
    rays = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    return (camera.position - index_to_world[:3, 3]) / index_to_world[0, 0] - 0.5, rays


def _between(places: np.ndarray, cells: tuple[int, ...]) -> csr_array:
    """Return the matrix (N, X Y Z) that interpolates at places (N, 3), in cells, 0 at the first centre."""
    low = np.clip(places.astype(np.int32), 0, np.array(cells) - 2)
    part = (places - low).astype(np.float32)
    columns, weights = [], []
    for corner in np.ndindex(2, 2, 2):
        columns.append(np.ravel_multi_index(tuple((low + corner).T), cells))
        weights.append(np.where(corner, part, 1 - part).prod(1))
    rows = np.arange(0, 8 * len(places) + 1, 8)
    return csr_array((np.stack(weights, 1).ravel(), np.stack(columns, 1).ravel(), rows), (len(places), np.prod(cells)))


def developed(
    light: np.ndarray, colour: np.ndarray, plate: np.ndarray, noise: float, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Yield display pictures (H, W, 3) float32 of 8 bits: linear light (F, H, W) of a colour (3,) above a plate.

    What is brighter than 0.8 bends towards white as film does. noise: std-dev, display values.
    """
    for frame in light:
        linear = plate + frame[..., None] * colour
        bent = np.where(linear < 0.8, linear, 1 - 0.2 * np.exp(-(linear - 0.8) / 0.2))
        display = linear_to_srgb(bent) + rng.normal(0, noise, linear.shape)
        yield (np.rint(np.clip(display, 0, 1) * 255) / 255).astype(np.float32)


def still_scene(camera: Camera, brightness: float, rng: np.random.Generator) -> np.ndarray:
    """Return a plate (H, W, 3), linear light: soft grey patches."""
    patches = cv2.GaussianBlur(rng.standard_normal((camera.height, camera.width)), (0, 0), 6)
    patches = 1 + 0.5 * patches / np.abs(patches).max()
    return brightness * patches[..., None] * np.array([1.0, 0.95, 0.9])
