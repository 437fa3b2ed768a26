"""Points to start a training from, where a layout has room for them: still surfaces, and the flame's hull.

Still points are those of the COLMAP view. Flame points lie where every training camera sees flame in a training frame;
their colour is the mean of what the cameras saw there. Nothing is taken from the true velocity, masks or emission.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, path_in
from gof.footage.flame_mask import flame_mask
from gof.reconstruct.voxels import carve

from .colmap import surface_points
from .source import ViewSource

VOXELS = 64  # along the longest side of the flame's box
FLAME_POINTS = 4000  # of all frames together
PER_FRAME = 4000
COLOURS = ("red", "green", "blue")


@dataclass(frozen=True)
class ColouredPoints:
    """position (N, 3) m, colour (N, 3) uint8."""

    position: np.ndarray
    colour: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    def some(self, count: int, seed: int) -> ColouredPoints:
        """Return at most `count` of them, drawn at random."""
        chosen = np.random.default_rng(seed).permutation(len(self))[:count]
        return ColouredPoints(self.position[chosen], self.colour[chosen])

    def and_also(self, other: ColouredPoints) -> ColouredPoints:
        return ColouredPoints(
            np.concatenate([self.position, other.position]), np.concatenate([self.colour, other.colour])
        )


@dataclass(frozen=True)
class StartingPoints:
    """Attributes: still; flame, by training frame."""

    still: ColouredPoints
    flame: dict[int, ColouredPoints]

    @classmethod
    def of(cls, source: ViewSource) -> StartingPoints:
        """Build it. Raises DataFormatError: no plates to tell a flame from, or no flame that two cameras see."""
        numbers = [number for number, trains in enumerate(source.trains) if trains]
        return cls(ColouredPoints(*surface_points(source, numbers)), _hulls(source, numbers))

    def all(self) -> ColouredPoints:
        """Still ones, and those of all frames together."""
        flame = list(self.flame.values())
        together = flame[0]
        for points in flame[1:]:
            together = together.and_also(points)
        return self.still.and_also(together.some(FLAME_POINTS, seed=0))


def _hulls(source: ViewSource, numbers: list[int]) -> dict[int, ColouredPoints]:
    dataset = replace(source.dataset, cameras=[source.dataset.cameras[number] for number in numbers])
    cameras = range(len(numbers))
    plates = [dataset.static(camera) for camera in cameras]
    frames = dataset.train_frames
    images = np.stack([[dataset.image(camera, frame) for camera in cameras] for frame in frames])
    masks = np.stack([[flame_mask(image[c], plates[c]) for c in cameras] for image in images])
    voxels = carve(dataset.cameras, masks, VOXELS)
    rng = np.random.default_rng(0)
    found = {}
    for frame, image, mask in zip(frames, images, masks, strict=True):
        seen = voxels.sample(mask.astype(np.int8), outside=-1)
        inside = np.nonzero((seen != 0).all(0) & (seen == 1).any(0))[0]
        chosen = rng.permutation(inside)[:PER_FRAME]
        jitter = voxels.voxel_size * rng.uniform(-0.5, 0.5, (len(chosen), 3))
        colour = np.nanmean(np.where(seen[:, chosen, None] == 1, voxels.sample(image)[:, chosen], np.nan), 0)
        found[frame] = ColouredPoints(voxels.center[chosen] + jitter, np.uint8(255 * colour + 0.5))
    if not any(map(len, found.values())):
        raise DataFormatError(f"{dataset.path}: no point lies in the flame masks of all cameras; check the poses")
    return found


def write_ply(path: Path, points: ColouredPoints) -> None:
    """x, y, z, nx, ny, nz (zero), red, green, blue, as readers of 3D Gaussian Splatting want them."""
    rows = np.zeros(
        len(points), [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [(c, "u1") for c in COLOURS]
    )
    for axis, values in zip("xyz", points.position.T, strict=True):
        rows[axis] = values
    for name, values in zip(COLOURS, points.colour.T, strict=True):
        rows[name] = values
    kinds = {"<f4": "float", "|u1": "uchar"}
    properties = [f"property {kinds[rows.dtype[name].str]} {name}" for name in rows.dtype.names]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *properties, "end_header", ""]
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join(lines).encode() + rows.tobytes())


def write(source: ViewSource) -> None:
    """``points3d.ply`` beside the D-NeRF files: their readers start from it instead of random points."""
    write_ply(path_in(source.dataset.path, "points3d.ply"), StartingPoints.of(source).all())
