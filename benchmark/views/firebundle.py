"""The training bundle of the authors' code (`fire-bundle-v2`) in ``fire_bundle/``: their trainer runs on our scenes.

Nothing that a method may not see is in it: masks and flow of training frames come from training pictures, by our
optical flow and the paper's fusion, never from the true velocity or the true masks.

Their trainer holds out frames with ``frame % test_every == 0``. So the bundle begins at the dataset's first held-out
frame, and its frame r is the dataset's frame ``first + r``: what they score is what is held out here.

    transforms.json                   format, hf_scene, name, num_frames, num_cams, held_out_every; dt: median
                                      ms between frames; frames[]: file_path (images/RRRR_C.png), cam, frame, time (ms),
                                      camera_angle_x (radians), transform_matrix (camera to world, OpenGL axes, m)
    sync_mask/C.png                   255 on the LED board
    masks/strideS/RRRR_C.png          red: board; green: flame; blue: flame grown
    voxel_flow/grid.npz               coordinates, voxel_size, bbox: centres, size and bounds, m
    voxel_flow/strideS/RRRR.npz       flows (X, Y, Z, 3), m per frame, NaN where unknown
    masks/, voxel_flow/provenance.json  files: anchor, stride, sources (window_frames, video_frames), time_us,
                                      carved_voxels
    static_point_cloud.ply            the still scene as 3DGS, from true depth
    mono_depth/RRRR_C.png             16 bits, inverse depth of the plate
    window.json                       its dataset frames
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, path_in, write_json
from gof.core.ply import splat_columns
from gof.core.ply import write as write_ply
from gof.dataset import Dataset
from gof.footage.flame_mask import flame_mask
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.methods import PAPER
from gof.reconstruct.observation import Observation, observe
from gof.reconstruct.presets import PRESETS
from gof.reconstruct.shrink import shrink

from .dnerf import is_centred
from .source import ViewSource, link

FOLDER, FORMAT = "fire_bundle", "fire-bundle-v2"
# Their fusion, but our masks and our hull: theirs, of any two cameras, reaches far behind the flame.
MADE_BY = replace(PAPER, flow_masks=False, vetoes=True)
STRIDES = (1, 2)  # the same files under both: ours never come from a held-out frame, so the second is not needed
EFFORT = PRESETS["standard"]  # size of the pictures and voxels that masks and flow are found on
BACKGROUND_POINTS = 60_000  # of all cameras together
GROW_PX, GROW_TIMES = 5, 2  # the flame's mask for training is wider than the one for scores


@dataclass(frozen=True)
class FrameWindow:
    """The frames of the bundle, r = 0..count-1, are the dataset's from `first` on; every `test_every`-th is held out.

    `test_every` is 0 where none is.
    """

    first: int
    count: int
    test_every: int

    @classmethod
    def of(cls, dataset: Dataset) -> FrameWindow:
        """Build it. Raises DataFormatError: the held-out frames are not every n-th one, which is all their trainer
        knows."""
        test, frames = dataset.test_frames, len(dataset.times_s)
        if not test:
            return cls(0, frames, 0)
        every = test[1] - test[0] if len(test) > 1 else frames
        if test != list(range(test[0], frames, every)):
            raise DataFormatError(
                f"{dataset.path}: splits.test is {test}; the authors' trainer holds out every n-th frame"
            )
        return cls(test[0], frames - test[0], every)


@dataclass(frozen=True)
class Bundle:
    """One on its way.

    Attributes:
        source: of the dataset by all cameras; `numbers` are those for training, as the bundle counts them.
        dataset: the same by its training cameras.
        observation, field: what they saw, and how it moves in space; of training frames only.
        folder: of the bundle.
    """

    source: ViewSource
    numbers: tuple[int, ...]
    dataset: Dataset
    window: FrameWindow
    observation: Observation
    field: FlowField
    folder: Path

    @property
    def times_ms(self) -> np.ndarray:
        """(C, count) of the window's frames, ms on the dataset clock."""
        times = [self.dataset.camera_times_s(c) for c in range(len(self.numbers))]
        return 1e3 * np.stack(times)[:, self.window.first :]

    @property
    def dt_ms(self) -> float:
        """Median time between two frames of a camera."""
        return float(np.median(np.diff(self.times_ms)))

    def path(self, name: str) -> Path:
        return path_in(self.folder, name)

    def made_from(self, camera: int, frames: Iterable[int]) -> dict[str, Any]:
        """Return which dataset frames of a camera went into a file: as the window counts them, and as the dataset
        does."""
        numbers = sorted(int(k) for k in frames)
        return {
            "video": self.dataset.description.cameras[self.numbers[camera]].rgb,
            "window_frames": [k - self.window.first for k in numbers],
            "video_frames": numbers,
        }

    def write_provenance(self, stage: str, files: dict[str, Any]) -> None:
        write_json(self.path(f"{stage}/provenance.json"), {"hf_scene": self.dataset.description.name, "files": files})


def write(source: ViewSource) -> None:
    """Write the view. Raises DataFormatError: lenses that are off centre, irregular splits, or no flame that can be
    placed in space."""
    dataset = Dataset.open(source.dataset.path)
    for camera in dataset.cameras:
        if not is_centred(camera):
            raise DataFormatError(f"{dataset.path}: camera '{camera.name}' is off centre; the bundle has only an angle")
    window = FrameWindow.of(dataset)
    observation = observe(shrink(dataset, EFFORT.longest_side), MADE_BY)
    field = seen_flow_field(observation, MADE_BY, EFFORT.voxels)
    numbers = tuple(number for number, trains in enumerate(source.trains) if trains)
    bundle = Bundle(source, numbers, dataset, window, observation, field, path_in(dataset.path, FOLDER))
    _write_pictures(bundle)
    _write_masks(bundle)
    _write_voxel_flow(bundle)
    _write_background(bundle)
    _write_window(bundle)
    _write_transforms(bundle)  # last: by it their code knows a bundle


def _write_transforms(bundle: Bundle) -> None:
    """transforms.json: pose, field of view and time of every picture; `held_out_every`, ours, is for their option."""
    frames = [
        {
            "file_path": f"images/{r:04d}_{c}.png",
            "cam": c,
            "frame": r,
            "time": float(bundle.times_ms[c, r]),
            "camera_angle_x": 2 * math.atan(camera.width / (2 * camera.K[0, 0])),
            "transform_matrix": bundle.source.opengl_pose(bundle.numbers[c]).tolist(),
        }
        for c, camera in enumerate(bundle.dataset.cameras)
        for r in range(bundle.window.count)
    ]
    name = bundle.dataset.description.name
    head = {"format": FORMAT, "hf_scene": name, "name": name, "num_frames": bundle.window.count}
    head |= {"num_cams": len(bundle.numbers), "dt": bundle.dt_ms, "held_out_every": bundle.window.test_every}
    write_json(bundle.path("transforms.json"), head | {"frames": frames})


def _write_window(bundle: Bundle) -> None:
    """window.json: which frame of which footage is which frame of the window, for people."""
    first, count = bundle.window.first, bundle.window.count
    cameras = {
        str(c): {
            "video": bundle.dataset.description.cameras[number].rgb,
            "video_frames": list(range(first, first + count)),
            "times_us": (1e3 * bundle.times_ms[c]).tolist(),
        }
        for c, number in enumerate(bundle.numbers)
    }
    name = bundle.dataset.description.name
    head = {"hf_scene": name, "name": name, "num_frames": count, "lead": 0}
    write_json(bundle.path("window.json"), head | {"cams": cameras})


# ---- pictures, and the depth of the still scene ----------------------------------------------------------------------


def _write_pictures(bundle: Bundle) -> None:
    """images/, and mono_depth/: their score of depth wants a map for every picture; the plate's is the same for all."""
    for c, number in enumerate(bundle.numbers):
        depth = bundle.path(f"mono_depth/{0:04d}_{c}.png")
        _write_image(depth, _relative_disparity(bundle.source.plate_depth(number)))
        for r in range(bundle.window.count):
            link(bundle.dataset.file(c, "rgb", bundle.window.first + r), bundle.path(f"images/{r:04d}_{c}.png"))
            if r:
                link(depth, bundle.path(f"mono_depth/{r:04d}_{c}.png"))


def _relative_disparity(depth: np.ndarray) -> np.ndarray:
    """Return (H, W) uint16: 1 / depth, 65535 at the nearest surface and 0 at the farthest, or where nothing is."""
    disparity = 1 / depth.astype(np.float64)  # of inf: 0
    span = disparity.max() - disparity.min()
    return np.uint16(65535 * (disparity - disparity.min()) / (span if span > 0 else 1))


def _write_background(bundle: Bundle) -> None:
    """static_point_cloud.ply: the plates at their true depth as Gaussians of a pixel's size, where theirs would be."""
    parts: dict[str, list[np.ndarray]] = {"position": [], "scale": [], "color": []}
    for c, (number, camera) in enumerate(zip(bundle.numbers, bundle.dataset.cameras, strict=True)):
        step = math.ceil(math.sqrt(camera.width * camera.height * len(bundle.numbers) / BACKGROUND_POINTS))
        depth = bundle.source.plate_depth(number)[::step, ::step]
        rows, columns = np.nonzero(np.isfinite(depth))
        z = depth[rows, columns].astype(np.float64)
        parts["position"].append(camera.unproject(np.column_stack([columns, rows]) * step + 0.5, z))
        parts["scale"].append(np.repeat(0.5 * step * z[:, None] / camera.K[0, 0], 3, axis=1))
        parts["color"].append(bundle.dataset.static(c)[::step, ::step][rows, columns])
    splats = {name: np.concatenate(values) for name, values in parts.items()}
    count = len(splats["position"])
    splats |= {"rotation": np.tile([1.0, 0, 0, 0], (count, 1)), "opacity": np.full(count, 0.9)}
    with atomic_path(bundle.path("static_point_cloud.ply")) as temporary:
        write_ply(temporary, splat_columns(splats), [])


# ---- masks -----------------------------------------------------------------------------------------------------------


def _write_masks(bundle: Bundle) -> None:
    """sync_mask/, and masks/: red the board, green the flame, blue the flame grown.

    A training frame's flame is what rises above its plate; a held-out frame's, for scores, is the dataset's own mask.
    """
    import cv2

    files: dict[str, Any] = {}
    row = {int(k): f for f, k in enumerate(bundle.observation.frames)}
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (GROW_PX, GROW_PX))
    for c, camera in enumerate(bundle.dataset.cameras):
        weight = bundle.dataset.board_weight(c)
        board = np.zeros((camera.height, camera.width), bool) if weight is None else weight < 0.5
        _write_image(bundle.path(f"sync_mask/{c}.png"), 255 * board.astype(np.uint8))
        plate_from = bundle.dataset.description.made_from.get(bundle.dataset.name(c, "static"), ())
        for r in range(bundle.window.count):
            frame = bundle.window.first + r
            seen = bundle.observation.mask[row[frame], c] if frame in row else _true_mask(bundle.dataset, c, frame)
            size = (camera.width, camera.height)
            flame = cv2.resize(seen.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
            grown = cv2.dilate(flame, kernel, iterations=GROW_TIMES)
            red_green_blue = 255 * np.stack([board, flame * ~board, grown * ~board], -1).astype(np.uint8)
            _write_image(bundle.path(f"masks/stride1/{r:04d}_{c}.png"), red_green_blue[..., ::-1])
            for stride in STRIDES:
                name = f"stride{stride}/{r:04d}_{c}.png"
                if stride != 1:
                    link(bundle.path(f"masks/stride1/{r:04d}_{c}.png"), bundle.path(f"masks/{name}"))
                sources = {str(c): bundle.made_from(c, {frame, *plate_from})}
                files[name] = {"anchor": r, "stride": stride, "cam": c, "sources": sources}
    bundle.write_provenance("masks", files)


def _true_mask(dataset: Dataset, camera: int, frame: int) -> np.ndarray:
    """Return (H, W) bool: where flame is in a held-out picture; estimated where the dataset does not know."""
    mask = dataset.mask(camera, frame)
    return flame_mask(dataset.image(camera, frame), dataset.static(camera)) if mask is None else mask > 0


# ---- flow in space ---------------------------------------------------------------------------------------------------


def _write_voxel_flow(bundle: Bundle) -> None:
    """voxel_flow/: the grid, and per training frame the flow of its flame's voxels, in metres per frame."""
    voxels = bundle.field.voxels
    size, count = voxels.voxel_size, voxels.resolution
    origin = voxels.center[0] - size * voxels.index[0]
    coordinates = origin + size * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1)
    box = np.stack([origin - size / 2, origin + size * (count - 0.5)], 1)
    _write_npz(bundle.path("voxel_flow/grid.npz"), coordinates=coordinates, voxel_size=size, bbox=box)
    learned = [int(k) for k in bundle.observation.frames]
    every = {str(c): bundle.made_from(c, learned) for c in range(len(bundle.numbers))}
    files: dict[str, Any] = {"grid.npz": {"sources": every}}
    for frame, seen in zip(learned, bundle.field.frames, strict=True):
        r = frame - bundle.window.first
        if r < 0:
            continue
        flows = np.full((*count, 3), np.nan, np.float32)
        flows[tuple(voxels.index[seen.known].T)] = seen.velocity[seen.known] * (1e-3 * bundle.dt_ms)
        _write_npz(bundle.path(f"voxel_flow/stride1/{r:04d}.npz"), flows=flows)
        used = {frame, frame - 1, frame + 1} & set(learned)
        sources = {str(c): bundle.made_from(c, used) for c in range(len(bundle.numbers))}
        for stride in STRIDES:
            name = f"stride{stride}/{r:04d}.npz"
            if stride != 1:
                link(bundle.path(f"voxel_flow/stride1/{r:04d}.npz"), bundle.path(f"voxel_flow/{name}"))
            files[name] = {
                "anchor": r,
                "stride": stride,
                "time_us": 1e3 * float(bundle.times_ms[0, r]),
                "carved_voxels": int(seen.known.sum()),
                "sources": sources,
            }
    bundle.write_provenance("voxel_flow", files)


def _write_npz(path: Path, **arrays: Any) -> None:
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def _write_image(path: Path, image: np.ndarray) -> None:
    """Write a grey (H, W) or a blue, green, red (H, W, 3) picture of 8 or 16 bits."""
    import cv2

    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), image):
            raise DataFormatError(f"{path}: cannot be written; is the disk full?")
