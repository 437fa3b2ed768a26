"""From videos of a fire by fixed cameras to a dataset that `gof reconstruct` reads, stage by stage."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from gof.cameras import Camera
from gof.costs import StageLog
from gof.dataset import CameraEntry, DatasetDescription
from gof.dataset.poses import FILE as POSES
from gof.dataset.poses import Poses
from gof.errors import GofError
from gof.files import atomic_path, path_in
from gof.flame_mask import flame_mask
from gof.ingest import plates
from gof.ingest.depth import back_project, whole_depth, write_points
from gof.ingest.evidence import Evidence, PoseOptions
from gof.ingest.footage import Clip, Footage
from gof.ingest.frame_times import FrameTimes, Timing
from gof.ingest.over_time import MEDIAN_PASSES, darkest
from gof.ingest.place import Placed
from gof.ingest.stereo import stereo_depth
from gof.lens import ROLL_DEG
from gof.pictures import write_picture as save_picture
from gof.progress import progress_bar

PlateKind = Literal["steady", "minimum"]


@dataclass(frozen=True)
class Ingested:
    """The finished dataset's folder, what its poses.json says, the share of each plate that is still fire, and what
    else a user should know, in words."""

    folder: Path
    poses: Poses
    fire_left: dict[str, float]
    notes: tuple[str, ...] = ()


def make_dataset(
    out: Path,
    footage: Footage,
    timing: Timing,
    pose_options: PoseOptions,
    plate: PlateKind = "steady",
    plates_folder: Path | None = None,
    width: int | None = None,
    depth: bool = False,
    depth_weights: Path | None = None,
    others: tuple[Footage, ...] = (),
) -> Ingested:
    """Write a dataset. Plates, poses and depth are made from training frames only, and the dataset says so.

    Args:
        out: folder of the dataset.
        plate: how plates are made from the footage, when there is no `plates_folder`: "minimum" over time, or "steady",
            that where fire passed and the temporal median elsewhere.
        plates_folder: pictures cam_0.png ... as stored, filmed without fire.
        width: of the dataset's pictures in px, None for the footage's; poses are always solved at full size.
        depth: also write depth maps of the plates and their point cloud.
        depth_weights: folder of the checkpoint for `gof.ingest.depth.monocular`; None: see `complete` there.
        others: more clips of the same rig; their features and boards help to find the poses, and they may show what
            burns all the time in this one.
    Raises:
        GofError: `out` holds a dataset already, the width is not one of the footage; see the stages for what can be
            wrong with footage, times and poses.
    """
    if (out / "dataset.json").exists():
        raise GofError(f"{out}: already holds a dataset; choose another --out or remove it")
    for lens in footage.upright_lenses:
        if width is not None and not 1 <= width <= lens.width:
            raise GofError(f"--width {width}: the footage is {lens.width} pixels wide")

    log = StageLog(out / "costs.json")

    # ---- frame times, footage ----------------------------------------------------------------------------------------
    with log.measure("read") as figures:
        times = footage.frame_times(timing)
        clips = footage.clips(times.frames)
        splits = footage.splits(len(clips[0]))
        known = [clip.only(splits.train) for clip in clips]  # all that a method may learn from
        figures.update(cameras=len(clips), frames=len(clips[0]))

    # ---- plates ------------------------------------------------------------------------------------------------------
    with log.measure("plates") as figures:
        plate_source = "given" if plates_folder else plate
        figures["plate"] = plate_source
        passes = 2 if plates_folder or plate == "minimum" else 2 + MEDIAN_PASSES
        more = [evidence_of(other, pose_options) for other in others]
        with watched("plates", known, passes) as seen:
            lowest = [darkest(clip) for clip in seen]
            fire = [plates.fire_reached(clip, low) for clip, low in zip(seen, lowest, strict=True)]
            if plates_folder:
                without_fire = read_plates(plates_folder, footage)
            else:
                elsewhere = [[other.plates[c] for other in more] for c in range(len(seen))]
                without_fire = make_plates(seen, lowest, fire, elsewhere, plate)
        left = [round(plates.fire_left(*each), 4) for each in zip(without_fire, fire, strict=True)]
        figures["fire_left"] = left

    # ---- poses -------------------------------------------------------------------------------------------------------
    with log.measure("poses") as figures:
        with watched("poses: read", known, 1 + (pose_options.board is not None)) as seen:
            placed = footage.place([Evidence.of(out.name, seen, lowest, pose_options), *more], pose_options)
        figures.update(method=placed.report.method, points=len(placed.points))
    cameras = placed_cameras(footage, times, placed)
    stored = [stored_view(camera, picture, width) for camera, picture in zip(cameras, without_fire, strict=True)]

    # ---- depth -------------------------------------------------------------------------------------------------------
    scene = None
    if depth:
        with log.measure("depth") as figures:
            scene = scene_depth(without_fire, cameras, placed.points, stored, depth_weights)
            figures["stereo_share"] = list(scene.stereo_share)

    # ---- write -------------------------------------------------------------------------------------------------------
    poses = Poses.of(placed.report, placed.points)
    made_by = {
        "footage": [video.name for video in footage.videos],
        "plate": plate_source,
        "fire_left": dict(zip(footage.names, left, strict=True)),
        "clock": times.source,
        "notes": [*footage.notes, *times.notes],
        "mask": "estimated from the plates",
        "scale": placed.report.scale,
        **({"rig_clips": [other.videos[0].parent.name for other in others]} if others else {}),
        **footage.provenance,
    }
    boards = [footage.board_mask(c) for c in range(len(clips))]
    made_from = derived_files(stored, placed, plates_folder is None, depth)
    with log.measure("write"), watched("write", clips) as seen:
        for view, clip, board in zip(stored, seen, boards, strict=True):
            write_pictures(out, view, clip)
            if board is not None:
                write_picture(out / view.board_mask, resized(board, view.camera)[..., None])
        if scene is not None:
            write_depth(out, stored, scene)
        poses.write(out)
        footage.write_beside(out)
        entries = camera_entries(footage, times, stored, boards)
        DatasetDescription(
            out.name,
            entries[0].time_s,
            entries,
            splits,
            provenance=made_by,
            made_from=dict.fromkeys(made_from, splits.train),
        ).write(out)  # last: it says that the rest is there
    return Ingested(out, poses, made_by["fire_left"], (*footage.notes, *times.notes))


@contextmanager
def watched(title: str, clips: list[Clip], passes: int = 1) -> Iterator[list[Clip]]:
    """The clips, with a progress bar over all their frames, each of which is read `passes` times."""
    total, done = passes * sum(map(len, clips)), 0
    with progress_bar(title) as update:

        def count() -> None:
            nonlocal done
            done += 1
            update(done, max(done, total))

        yield [replace(clip, watch=count) for clip in clips]


def derived_files(stored: list[StoredView], placed: Placed, plates_of_clip: bool, depth: bool) -> list[str]:
    """Names of the dataset's files that are computed from the clip's training frames, masks of single frames aside."""
    files = [view.static for view in stored] if plates_of_clip else []
    files += [POSES] if placed.report.method in ("features", "points") else []
    files += [view.depth for view in stored] + ["points.ply"] if depth and plates_of_clip else []
    return files


# ---- plates ----------------------------------------------------------------------------------------------------------


def make_plates(
    clips: list[Clip],
    lowest: list[np.ndarray],
    fire: list[np.ndarray],
    elsewhere: list[list[np.ndarray]],
    kind: PlateKind,
) -> list[np.ndarray]:
    """(H, W, 3) uint8 per camera.

    Args:
        lowest: the clips' minimum plates.   fire: (H, W) bool, where fire was.
        elsewhere: minimum plates of the camera's other clips.
    """
    dark = [plates.uncovered(*each) for each in zip(lowest, fire, elsewhere, strict=True)]
    return dark if kind == "minimum" else [plates.steady(*each) for each in zip(clips, dark, fire, strict=True)]


def read_plates(folder: Path, footage: Footage) -> list[np.ndarray]:
    """(H, W, 3) uint8 per camera, filmed without fire."""
    return [
        footage.preparation(c)(plates.read_plate(folder, name, lens))
        for c, (name, lens) in enumerate(zip(footage.names, footage.lenses, strict=True))
    ]


def evidence_of(footage: Footage, options: PoseOptions) -> Evidence:
    """What another clip of the rig says of the poses. What stands still needs no times: all frames are used."""
    name = footage.videos[0].parent.name
    with watched(f"read {name}", footage.all_clips(), 2 + (options.board is not None)) as clips:
        return Evidence.of(name, clips, [darkest(clip) for clip in clips], options)


# ---- cameras ---------------------------------------------------------------------------------------------------------


def placed_cameras(footage: Footage, times: FrameTimes, placed: Placed) -> list[Camera]:
    """The cameras of the prepared pictures at full size."""
    return [
        Camera(name, lens.width, lens.height, lens.K, pose, row_time_s, readout)
        for name, lens, pose, row_time_s, readout in zip(
            footage.names,
            footage.upright_lenses,
            placed.world_to_camera,
            times.row_time_s,
            times.readout,
            strict=True,
        )
    ]


@dataclass(frozen=True)
class StoredView:
    """A camera and its plate (H, W, 3) uint8 RGB at the size of the dataset's pictures."""

    camera: Camera
    plate: np.ndarray

    @property
    def rgb(self) -> str:
        """Pattern of its pictures' names."""
        return f"cameras/{self.camera.name}/rgb/{{frame:06d}}.png"

    @property
    def mask(self) -> str:
        """Pattern of its flame masks' names."""
        return f"cameras/{self.camera.name}/mask/{{frame:06d}}.png"

    @property
    def static(self) -> str:
        """Name of its plate."""
        return f"static/{self.camera.name}.png"

    @property
    def depth(self) -> str:
        """Name of the plate's depth map."""
        return f"depth/{self.camera.name}.npy"

    @property
    def board_mask(self) -> str:
        """Name of the LED board's mask."""
        return f"cameras/{self.camera.name}/board_mask.png"


def stored_view(camera: Camera, plate: np.ndarray, width: int | None) -> StoredView:
    """The camera and its plate at `width`; None keeps the size."""
    width = width or camera.width
    small = camera.scaled(width, round(camera.height * width / camera.width))
    return StoredView(small, resized(plate, small))


def resized(picture: np.ndarray, camera: Camera) -> np.ndarray:
    """The picture at the camera's size; every new pixel is the mean of the old ones it covers."""
    import cv2

    size = (camera.width, camera.height)
    return picture if picture.shape[1::-1] == size else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


# ---- depth -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SceneDepth:
    """Depth of the scene without fire.

    Attributes:
        maps: (H, W) float32 camera depth in m per stored view, everywhere.
        points, colors: (N, 3) world m and (N, 3) uint8, all pixels of all maps.
        stereo_share: of each view's pixels, the others are filled.
    """

    maps: list[np.ndarray]
    points: np.ndarray
    colors: np.ndarray
    stereo_share: tuple[float, ...]


def scene_depth(
    full_plates: list[np.ndarray],
    cameras: list[Camera],
    points: np.ndarray,
    stored: list[StoredView],
    weights: Path | None,
) -> SceneDepth:
    """Stereo between the plates at full size, completed at the stored size.

    Args:
        cameras: of the plates at full size.   points: (N, 3) sparse, for the range of depths.
    """
    import cv2

    maps, clouds, share = [], [], []
    for view, partial in zip(stored, stereo_depth(full_plates, cameras, points), strict=True):
        # Nearest: a mean of two surfaces is a place where nothing is.
        partial = cv2.resize(partial, view.plate.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        whole = whole_depth(partial, view.plate, weights)
        maps.append(whole)
        clouds.append(back_project(whole, view.plate, view.camera))
        share.append(round(float(np.isfinite(partial).mean()), 3))
    cloud, colors = (np.concatenate(parts) for parts in zip(*clouds, strict=True))
    return SceneDepth(maps, cloud, colors, tuple(share))


# ---- write -----------------------------------------------------------------------------------------------------------


def write_depth(out: Path, stored: list[StoredView], scene: SceneDepth) -> None:
    """depth/CAMERA.npy and points.ply."""
    for view, depth in zip(stored, scene.maps, strict=True):
        with atomic_path(path_in(out, view.depth)) as temporary:
            np.save(temporary, depth)
    write_points(out / "points.ply", scene.points, scene.colors)


def write_pictures(out: Path, view: StoredView, clip: Clip) -> None:
    """A camera's plate, its clip, and where fire is in it: an estimate, as no truth exists."""
    write_picture(path_in(out, view.static), view.plate)
    plate = view.plate.astype(np.float32) / 255
    for k, frame in enumerate(clip):
        picture = resized(frame, view.camera)
        write_picture(path_in(out, view.rgb.format(frame=k)), picture)
        flame = flame_mask(picture.astype(np.float32) / 255, plate)
        write_picture(path_in(out, view.mask.format(frame=k)), flame[..., None].astype(np.uint8) * 255)


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an (H, W, 3) RGB or (H, W, 1) uint8 picture."""
    save_picture(path, picture[..., ::-1])


def camera_entries(
    footage: Footage, times: FrameTimes, stored: list[StoredView], boards: list[np.ndarray | None]
) -> tuple[CameraEntry, ...]:
    """What dataset.json says of the cameras."""
    return tuple(
        CameraEntry.of(
            view.camera,
            role="train",
            roll_deg=ROLL_DEG[footage.turn],
            rgb=view.rgb,
            mask=view.mask,
            static=view.static,
            board_mask=None if board is None else view.board_mask,
            time_s=tuple(time_s.tolist()),
        )
        for view, time_s, board in zip(stored, times.time_s, boards, strict=True)
    )
