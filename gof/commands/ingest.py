"""`gof static`: videos of a fire by fixed cameras -> a dataset that `gof reconstruct` reads."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from gof.cameras import Camera
from gof.costs import StageLog
from gof.dataset import SCHEMA, VERSION, Dataset
from gof.errors import DataFormatError, GofError
from gof.footage import count_frames, first_frame
from gof.ingest import depth, place, plates
from gof.ingest.footage import read_clip
from gof.ingest.frame_times import Clock, read_clock
from gof.ingest.stereo import stereo_depth
from gof.io.files import atomic_path, write_json
from gof.lens import ROLL_DEG, Lens, Turn, prepare, read_cameras
from gof.reconstruct.motion import flame_mask


@dataclass
class StaticConfig:
    """Videos of a fire by fixed cameras -> a dataset folder: pictures, fire-free plates, camera poses, frame times.

    Poses come from the plates by structure from motion; where that fails or contradicts the board, from the sync board's
    marker or from points given with --points. Every video needs the same true frame rate.
    """

    videos: tyro.conf.Positional[list[Path]]
    """One video or folder of pictures per camera, of one fire, at least two."""
    out: Path
    """Folder of the dataset to write."""
    cameras: Path | None = None
    """JSON: {"cameras": [{"width", "height", "K", "distortion"?, "world_to_camera"?}, ...]} of the pictures as stored, in the
    videos' order, or one entry for all. With world_to_camera (of the upright picture, metres) for all, poses are not solved."""
    fov: float | None = None
    """Horizontal field of view of the stored pictures in degrees, for all cameras, when there is no --cameras."""
    turn: Turn = "none"
    """How to turn the stored pictures upright."""
    times: Path | None = None
    """times.json of `gof capture sync` for the same videos in the same order."""
    fps: float | None = None
    """True capture rate, when there is no --times."""
    plates: Path | None = None
    """Folder with fire-free pictures cam_0.png ... as stored; else they are made from the footage."""
    plate: Literal["steady", "minimum"] = "steady"
    """How a plate is made: "minimum" over time, or "steady": that where fire passed and the temporal median elsewhere."""
    points: Path | None = None
    """JSON of correspondences by hand, see docs/static.md; points with xyz also give the scale."""
    board: str = "paper_rig"
    """Sync board to look for (gof_board, paper_rig or a JSON file); "none" does not look."""
    marker_m: float | None = None
    """Side of the board's marker in metres: gives the scale."""
    baseline_m: float | None = None
    """Distance between the first and the last camera in metres: gives the scale."""
    poses: Literal["auto", "features", "points"] = "auto"
    """"features": structure from motion; "points": board or --points, refined with features; "auto": the first that holds."""
    width: int | None = None
    """Width of the dataset's pictures in pixels; poses are always solved at full size."""
    frames: int | None = None
    """Use only so many frames."""
    depth: bool = False
    """Also write depth/cam_0.npy ... (H, W, camera depth in metres) by stereo on the plates, completed, and points.ply."""
    depth_weights: Path | None = None
    """Folder of a Depth-Anything-V2 checkpoint that completes the stereo depth; without it edges of the plate do."""
    start: int = 0
    """First frame of the first camera to use."""
    json: Path | None = None
    """Also write the summary to this file."""


def make_dataset(config: StaticConfig) -> Path:
    """Write the dataset; returns its folder.

    Raises:
        GofError: `out` already holds a dataset; see the stages for what can be wrong with footage, times and poses.
    """
    if (config.out / "dataset.json").exists():
        raise GofError(f"{config.out}: already holds a dataset; choose another --out or remove it")
    if len(config.videos) < 2:
        raise GofError("give the footage of at least two cameras")
    names = [f"cam_{c}" for c in range(len(config.videos))]
    log = StageLog(config.out / "costs.json")

    with log.measure("read") as figures:
        lenses, known_poses = read_lenses(config)
        clock = read_clock(
            config.times, config.fps, [count_frames(v) for v in config.videos], config.start, config.frames
        )
        clock = clock.turned(config.turn)
        clips = [
            read_clip(video, lens, config.turn, frames)
            for video, lens, frames in zip(config.videos, lenses, clock.frames, strict=True)
        ]
        upright = [lens.turned(config.turn) for lens in lenses]
        figures.update(cameras=len(names), frames=len(clips[0]))

    with log.measure("plates") as figures:
        low = [plates.rank(clip, 0.0) for clip in clips]
        made = (
            [given_plate(config, n, lens) for n, lens in zip(names, lenses, strict=True)]
            if config.plates
            else [
                plates.steady(clip, base) if config.plate == "steady" else base
                for clip, base in zip(clips, low, strict=True)
            ]
        )
        figures["plate"] = "given" if config.plates else config.plate

    with log.measure("poses") as figures:
        placed = place.place_cameras(clips, low, upright, names, known_poses, config)
        figures.update(placed.report)

    with log.measure("write"):
        cameras = [
            Camera(name, lens.width, lens.height, lens.K, pose, clock.row_time_s[c], clock.readout[c])
            for c, (name, lens, pose) in enumerate(zip(names, upright, placed.world_to_camera, strict=True))
        ]
        write_dataset(config, cameras, clips, made, clock, placed)
    if config.depth:
        with log.measure("depth") as figures:
            figures.update(write_depth(config.out, made, cameras, placed.points, config.depth_weights))
    return config.out


def write_depth(folder: Path, made, cameras: list[Camera], points: np.ndarray, weights: Path | None) -> dict:
    """Depth maps and the fused point cloud of a finished dataset, matched on the plates `made` at full size.

    Returns:
        each camera's share of pixels with stereo depth.
    """
    import cv2

    dataset, clouds, share = Dataset.open(folder), [], []
    for c, (camera, partial) in enumerate(zip(dataset.cameras, stereo_depth(made, cameras, points), strict=True)):
        partial = cv2.resize(partial, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
        picture = np.uint8(np.rint(255 * dataset.static(c)))
        whole = depth.whole_depth(partial, picture, weights)
        with atomic_path(folder / "depth" / f"{camera.name}.npy") as temporary:
            np.save(temporary, whole)
        clouds.append(depth.back_project(whole, picture, camera))
        share.append(round(float(np.isfinite(partial).mean()), 3))
    depth.write_points(folder / "points.ply", *(np.concatenate(x) for x in zip(*clouds, strict=True)))
    return {"stereo_share": share}


def read_lenses(config: StaticConfig) -> tuple[list[Lens], list[np.ndarray] | None]:
    """Intrinsics per video, and poses if the file has them."""
    if (config.cameras is None) == (config.fov is None):
        raise GofError("give the intrinsics with either --cameras FILE or --fov DEGREES")
    if config.fov is not None:
        sizes = [first_frame(v).shape[1::-1] for v in config.videos]
        return [Lens.from_fov(*size, config.fov) for size in sizes], None
    entries = read_cameras(config.cameras, len(config.videos))
    lenses = [Lens.from_dict(d, f"{config.cameras}: camera {c}") for c, d in enumerate(entries)]
    if not all("world_to_camera" in d for d in entries) or len({str(d["world_to_camera"]) for d in entries}) < len(
        entries
    ):
        return lenses, None
    return lenses, [np.asarray(d["world_to_camera"], np.float64) for d in entries]


def given_plate(config: StaticConfig, name: str, lens: Lens) -> np.ndarray:
    """A plate from --plates, prepared as the frames are."""
    files = sorted(config.plates.glob(f"{name}.*")) if config.plates.is_dir() else []
    if not files:
        raise DataFormatError(f"{config.plates}: no picture {name}.png there")
    import cv2

    picture = cv2.imread(str(files[0]), cv2.IMREAD_COLOR)
    if picture is None or picture.shape[:2] != (lens.height, lens.width):
        raise DataFormatError(f"{files[0]}: must be a picture of {lens.width}x{lens.height} pixels, as the footage")
    return prepare(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), lens, config.turn)


def write_dataset(config: StaticConfig, cameras: list[Camera], clips, made, clock: Clock, placed) -> None:
    """Pictures at the asked width, then dataset.json last."""
    import cv2

    out, entries = config.out, []
    for c, camera in enumerate(cameras):
        width = config.width or camera.width
        if not 1 <= width <= camera.width:
            raise GofError(f"--width {width}: the footage is {camera.width} pixels wide")
        small = camera.scaled(width, round(camera.height * width / camera.width))

        pattern = f"cameras/{camera.name}/rgb/{{frame:06d}}.png"
        masks = pattern.replace("rgb", "mask")
        fits = (small.width, small.height)
        plate = made[c] if made[c].shape[1::-1] == fits else cv2.resize(made[c], fits, interpolation=cv2.INTER_AREA)
        write(out / "static" / f"{camera.name}.png", plate)
        for k, frame in enumerate(clips[c]):
            frame = frame if frame.shape[1::-1] == fits else cv2.resize(frame, fits, interpolation=cv2.INTER_AREA)
            write(out / pattern.format(frame=k), frame)
            # Where fire is, for the scores: an estimate, as no truth exists.
            flame = flame_mask(frame.astype(np.float32) / 255, plate.astype(np.float32) / 255)
            write(out / masks.format(frame=k), flame[..., None].astype(np.uint8) * 255)
        entries.append(
            small.to_dict()
            | {
                "role": "train",
                "roll_deg": ROLL_DEG[config.turn],
                "rgb": pattern,
                "mask": masks,
                "static": f"static/{camera.name}.png",
            }
            | {"time_s": clock.time_s[c].tolist()}
        )
    count = len(clock.time_s[0])
    write_json(
        out / "poses.json",
        {
            "schema": "gof-poses",
            "version": 1,
            "report": placed.report,
            "points": np.round(placed.points, 6).tolist(),
        },
    )
    meta = {
        "schema": SCHEMA,
        "version": VERSION,
        "name": out.name,
        "spec": {},
        "effects": [],
        "time_s": clock.time_s[0].tolist(),
        "cameras": entries,
        "splits": {
            "train": [k for k in range(count) if k % 8 != 4],
            "test": [k for k in range(count) if k % 8 == 4],
        },
        "velocity": None,
        "scale": placed.report["scale"],
        "provenance": {
            "footage": [v.name for v in config.videos],
            "plate": "given" if config.plates else config.plate,
            "clock": clock.source,
            "mask": "estimated from the plates",
        },
    }
    write_json(out / "dataset.json", meta)


def write(path: Path, picture: np.ndarray) -> None:
    """Write an (H, W, 3) RGB or (H, W, 1) picture."""
    import cv2

    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), picture[..., ::-1]):
            raise GofError(f"{path}: cannot be written; is the disk full?")


def main(argv: list[str]) -> int:
    """`gof static VIDEO... --out DATASET`; see --help."""
    config = tyro.cli(StaticConfig, prog="gof static", args=argv)
    out = make_dataset(config)
    stages = [asdict(s) for s in StageLog(out / "costs.json").stages()]
    report = next(s["settings"] for s in stages if s["name"] == "poses")
    for stage in stages:
        print(f"{stage['name']:<8} {stage['seconds']:7.1f} s {stage['peak_mb']:6.0f} MB")
    print(f"poses from {report['method']}; scale: {report['scale']}")
    for note in report["notes"]:
        print(f"note: {note}")
    print(f"dataset -> {out}; next: gof reconstruct {out} --out out/{out.name}")
    if config.json:
        write_json(config.json, {"dataset": str(out), "stages": stages})
    return 0
