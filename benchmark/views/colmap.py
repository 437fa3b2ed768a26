"""COLMAP's text model in ``sparse/0``: the fire-free view of each camera, and points of its exact depth.

COLMAP's convention is ours: world to camera, OpenCV axes, pixel centres at integer + 0.5.
"""

from __future__ import annotations

import numpy as np

from gof.io.files import atomic_path
from gof.rotations import quaternions_wxyz

from .rig import Rig

POINTS_PER_CAMERA = 1500
SAME_DEPTH = 0.01  # relative; a point is seen by a camera whose depth agrees
FLAT = 0.004  # relative change of depth to the neighbouring pixels; corners and edges are left out


def write(rig: Rig) -> None:
    depths = [rig.plate_depth(camera) for camera in range(len(rig.cameras))]
    position, colour = _points(rig, depths)
    seen: list[list[tuple[float, float, int]]] = [[] for _ in rig.cameras]
    tracks: list[list[tuple[int, int]]] = [[] for _ in position]
    for index, camera in enumerate(rig.cameras):
        pixels, depth = camera.project(position)
        for point in np.nonzero(_is_seen(pixels, depth, depths[index]))[0]:
            tracks[point].append((index + 1, len(seen[index])))
            seen[index].append((*pixels[point], int(point) + 1))
    folder = rig.root / "sparse" / "0"
    with atomic_path(folder / "cameras.txt") as path:
        path.write_text(
            "".join(
                f"{index + 1} PINHOLE {c.width} {c.height} {' '.join(f'{v:.17g}' for v in c.K[[0, 1, 0, 1], [0, 1, 2, 2]])}\n"
                for index, c in enumerate(rig.cameras)
            )
        )
    with atomic_path(folder / "images.txt") as path:
        lines = []
        for index, camera in enumerate(rig.cameras):
            pose = [*quaternions_wxyz(camera.world_to_camera[:3, :3]), *camera.world_to_camera[:3, 3]]
            lines.append(f"{index + 1} {' '.join(f'{v:.17g}' for v in pose)} {index + 1} {rig.file(index, 'static')}")
            lines.append(" ".join(f"{x:.6f} {y:.6f} {point}" for x, y, point in seen[index]))
        path.write_text("\n".join(lines) + "\n")
    with atomic_path(folder / "points3D.txt") as path:
        path.write_text(
            "".join(
                f"{point + 1} {' '.join(f'{v:.9g}' for v in position[point])} {' '.join(map(str, colour[point]))} 0 "
                f"{' '.join(f'{image} {index}' for image, index in track)}\n"
                for point, track in enumerate(tracks)
                if len(track) >= 2
            )
        )


def _points(rig: Rig, depths: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of random pixels that lie on flat surfaces, and their colours (N, 3) uint8."""
    import cv2

    rng = np.random.default_rng(0)
    positions, colours = [], []
    for index, (camera, depth) in enumerate(zip(rig.cameras, depths, strict=True)):
        rows, columns = np.nonzero(is_flat(depth))
        chosen = rng.permutation(len(rows))[:POINTS_PER_CAMERA]
        rows, columns = rows[chosen], columns[chosen]
        positions.append(camera.unproject(np.column_stack([columns, rows]) + 0.5, depth[rows, columns]))
        picture = cv2.imread(str(rig.root / rig.file(index, "static")), cv2.IMREAD_COLOR)
        colours.append(picture[rows, columns, ::-1])
    return np.concatenate(positions), np.concatenate(colours)


def is_flat(depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: finite depth whose four neighbours lie on one plane with it (second differences of 1/depth)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / depth.astype(np.float64)  # linear across a plane
        bend = np.zeros(depth.shape)
        bend[1:-1] += np.abs(inverse[2:] + inverse[:-2] - 2 * inverse[1:-1])
        bend[:, 1:-1] += np.abs(inverse[:, 2:] + inverse[:, :-2] - 2 * inverse[:, 1:-1])
        flat = bend < FLAT * inverse
    flat[[0, -1]] = flat[:, [0, -1]] = False
    return flat & np.isfinite(depth)


def _is_seen(pixels: np.ndarray, depth: np.ndarray, surface: np.ndarray) -> np.ndarray:
    height, width = surface.shape
    with np.errstate(invalid="ignore"):
        x, y = (np.nan_to_num(np.floor(v), nan=-1).astype(int) for v in pixels.T)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (depth > 0)
    there = np.full(len(depth), np.inf)
    there[inside] = surface[y[inside], x[inside]]
    return np.abs(there - depth) < SAME_DEPTH * depth
