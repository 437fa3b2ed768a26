"""COLMAP's text model in ``sparse/0``: the fire-free view of each camera, and points of its exact depth.

COLMAP's convention is ours: world to camera, OpenCV axes, pixel centres at integer + 0.5.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gof.core.cameras import Camera
from gof.core.files import atomic_path, path_in
from gof.core.rotations import quaternions_wxyz

from .source import ViewSource

POINTS_PER_CAMERA = 1500
SAME_DEPTH = 0.01  # relative; a point is seen by a camera whose depth agrees
FLAT = 0.004  # relative change of depth to the neighbouring pixels; corners and edges are left out


def write(source: ViewSource) -> None:
    cameras = range(len(source.dataset.cameras))
    names = [source.dataset.name(camera, "static") for camera in cameras]
    write_model(source, path_in(source.dataset.path, "sparse/0"), list(cameras), names)


def write_model(source: ViewSource, folder: Path, numbers: list[int], names: list[str]) -> None:
    """Write cameras.txt, images.txt and points3D.txt.

    Args:
        numbers: of the dataset's cameras, one per picture of the model.   names: of the pictures.
    """
    cameras = [source.dataset.cameras[number] for number in numbers]
    depths = [source.plate_depth(number) for number in numbers]
    position, colour = surface_points(source, sorted(set(numbers)))
    seen: list[list[tuple[float, float, int]]] = [[] for _ in cameras]  # per picture: x, y, number of the point
    tracks: list[list[tuple[int, int]]] = [[] for _ in position]  # per point: picture, index in `seen`
    for index, camera in enumerate(cameras):
        pixels, depth = camera.project(position)
        for point in np.nonzero(_is_seen(pixels, depth, depths[index]))[0]:
            tracks[point].append((index + 1, len(seen[index])))
            seen[index].append((*pixels[point], int(point) + 1))
    _write_lines(folder / "cameras.txt", _camera_lines(cameras))
    _write_lines(folder / "images.txt", _image_lines(cameras, names, seen))
    _write_lines(folder / "points3D.txt", _point_lines(position, colour, tracks))


def _camera_lines(cameras: list[Camera]) -> Iterator[str]:
    for index, c in enumerate(cameras):
        lens = _words([c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2]], ".17g")
        yield f"{index + 1} PINHOLE {c.width} {c.height} {lens}"


def _image_lines(cameras: list[Camera], names: list[str], seen: list[list[tuple[float, float, int]]]) -> Iterator[str]:
    for index, (camera, name) in enumerate(zip(cameras, names, strict=True)):
        turn, shift = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
        pose = _words([*quaternions_wxyz(turn), *shift], ".17g")
        yield f"{index + 1} {pose} {index + 1} {name}"
        yield " ".join(f"{x:.6f} {y:.6f} {point}" for x, y, point in seen[index])


def _point_lines(position: np.ndarray, colour: np.ndarray, tracks: list[list[tuple[int, int]]]) -> Iterator[str]:
    """Yield points that two cameras or more see; the reprojection error is that of exact depth, 0."""
    for point, track in enumerate(tracks):
        if len(track) >= 2:
            observations = " ".join(f"{image} {index}" for image, index in track)
            yield f"{point + 1} {_words(position[point], '.9g')} {_words(colour[point], 'd')} 0 {observations}"


def _words(numbers, form: str) -> str:
    return " ".join(format(number, form) for number in numbers)


def _write_lines(path: Path, lines: Iterator[str]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("".join(f"{line}\n" for line in lines))


def surface_points(source: ViewSource, numbers: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) of random pixels of some cameras that lie on flat surfaces, and their colours (N, 3)
    uint8."""
    import cv2

    rng = np.random.default_rng(0)
    positions, colours = [], []
    for index in numbers:
        camera, depth = source.dataset.cameras[index], source.plate_depth(index)
        rows, columns = np.nonzero(is_flat(depth))
        chosen = rng.permutation(len(rows))[:POINTS_PER_CAMERA]
        rows, columns = rows[chosen], columns[chosen]
        positions.append(camera.unproject(np.column_stack([columns, rows]) + 0.5, depth[rows, columns]))
        picture = cv2.imread(str(source.dataset.file(index, "static")), cv2.IMREAD_COLOR)
        colours.append(picture[rows, columns, ::-1])
    return np.concatenate(positions), np.concatenate(colours)


def is_flat(depth: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: finite depth whose four neighbours lie on one plane with it (second differences of
    1/depth)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / depth.astype(np.float64)  # linear across a plane
        bend = np.zeros(depth.shape)
        bend[1:-1] += np.abs(inverse[2:] + inverse[:-2] - 2 * inverse[1:-1])
        bend[:, 1:-1] += np.abs(inverse[:, 2:] + inverse[:, :-2] - 2 * inverse[:, 1:-1])
        flat = bend < FLAT * inverse
    flat[[0, -1]] = flat[:, [0, -1]] = False
    return flat & np.isfinite(depth)


def _is_seen(pixels: np.ndarray, depth: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Return (N,) bool: the pixel lies in the picture, and the surface there is as deep as the point."""
    height, width = surface.shape
    with np.errstate(invalid="ignore"):
        x, y = (np.nan_to_num(np.floor(v), nan=-1).astype(int) for v in pixels.T)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (depth > 0)
    surface_depth = np.full(len(depth), np.inf)
    surface_depth[inside] = surface[y[inside], x[inside]]
    return np.abs(surface_depth - depth) < SAME_DEPTH * depth
