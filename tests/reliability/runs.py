"""What a run leaves in its folder to damage: checkpoints, records, frame times; and published footage's arrays."""

from __future__ import annotations

import dataclasses
import types
import typing
from pathlib import Path
from typing import Any

import numpy as np

from tests.reliability.format import Format


def formats() -> dict[str, Format]:
    """By name."""
    return {
        "checkpoint of ours": Format(_checkpoint, _read_checkpoint),
        "records of a run": Format(_records, _read_records, share=2),
        "frame times": Format(_times, _read_times),
        "calibrated cameras": Format(_cameras, _read_cameras),
        "published meta.npz": Format(_published, _read_published),
    }


def _parameters() -> dict[str, Any]:
    import drjit as dr

    from gof.render.backend import Float

    return {"opacity": dr.zeros(Float, 6) + 0.5, "scale": dr.arange(Float, 18)}


def _optimizer():
    from gof.render.adam import Adam

    return Adam(lr=1.0, params=_parameters())


def _checkpoint(folder: Path) -> None:
    from gof.reconstruct.checkpoint import Spent, save_checkpoint

    save_checkpoint(folder / "checkpoint.npz", _optimizer(), 500, Spent(10.0, 8.0))


def _read_checkpoint(folder: Path):
    from gof.reconstruct.checkpoint import load_checkpoint, read_spent

    optimizer, path = _optimizer(), folder / "checkpoint.npz"
    done = load_checkpoint(path, optimizer)
    return done, dataclasses.astuple(read_spent(path)), [np.array(optimizer[name]) for name in optimizer.keys()]


def _kinds() -> list[type]:
    """The records that a folder of work has in it."""
    from gof.core.costs import Costs
    from gof.dataset.leaks import MadeFrom
    from gof.dataset.poses import Poses
    from gof.look.report import Preview
    from gof.reconstruct.background import BackgroundSettings
    from gof.reconstruct.captions import Captions
    from gof.reconstruct.curve import Curve
    from gof.reconstruct.settings import ReconstructionSettings
    from gof_benchmark.commands.demo import DemoSettings

    ours = [ReconstructionSettings, BackgroundSettings, DemoSettings, Curve, Captions, MadeFrom, Preview, Costs]
    return [*ours, Poses]


def _records(folder: Path) -> None:
    from gof.core.records import write_record

    for kind in _kinds():
        write_record(folder / f"{kind.SCHEMA}.json", _sample(kind))


def _read_records(folder: Path):
    from gof.core.records import read_record

    return [read_record(kind, folder / f"{kind.SCHEMA}.json") for kind in _kinds()]


def _sample(hint: Any) -> Any:
    """A value of a type: of a record one with every field filled."""
    if dataclasses.is_dataclass(hint):
        hints = typing.get_type_hints(hint)
        return hint(**{field.name: _sample(hints[field.name]) for field in dataclasses.fields(hint)})
    inner = typing.get_args(hint)
    match typing.get_origin(hint):
        case typing.Literal:
            return inner[0]
        case typing.Union | types.UnionType:
            return _sample(inner[0])
        case origin if origin is dict:
            return {"a name": _sample(inner[1])}
        case origin if origin is tuple:
            return (_sample(inner[0]),) * 2 if inner[-1] is Ellipsis else tuple(map(_sample, inner))
    return {int: 16, float: 1.5, str: "a name", bool: True}.get(hint)


def _cameras(folder: Path) -> None:
    from gof.core.records import write_record
    from gof.footage.lens import CalibratedCamera, CamerasFile

    K, pose = ((80.0, 0.0, 24.0), (0.0, 80.0, 42.0), (0.0, 0.0, 1.0)), tuple(map(tuple, np.eye(4).tolist()))
    cameras = [CalibratedCamera(48, 85, K, (0.1, 0.01, 0.0, 0.0), f"cam_{c}", pose, 0.3, 1.0, 0.5, 9) for c in (0, 1)]
    write_record(folder / "cameras.json", CamerasFile(tuple(cameras)))


def _read_cameras(folder: Path):
    from gof.footage.lens import read_cameras

    videos = [Path("a.mp4"), Path("b.mp4")]
    return [(camera, camera.lens.turned("clockwise")) for camera in read_cameras(folder / "cameras.json", videos)]


def _video(number: int):
    from gof.footage.videos import VideoInfo

    return VideoInfo(Path(f"cam_{number}.mp4"), 48, 85, 30.0, 6, stamps_s=np.arange(6) / 30, frames=6)


def _times(folder: Path) -> None:
    from gof.capture.times import (
        CounterReading,
        DecodingCost,
        FrameTime,
        FrameTimesFile,
        NearestFrame,
        SyncedVideo,
        VideoTimes,
    )
    from gof.core.records import write_record

    def times(begin: float) -> VideoTimes:
        frames = tuple(FrameTime(t, 1.0, t + 1e-6, True) for t in [begin + 0.0025 * k for k in range(6)])
        shape = {"width": 48, "height": 85, "fps": 400.0, "frame_interval_us": 2500.0, "row_time_us": 4.0}
        errors = {"rms_us": 4.0, "max_residual_us": 8.0, "systematic_us": 0.9, "outliers": 0}
        seen = {"exposure_us": 1000.0, "saturation": 3.0, "container_fps": 30.0, "marker_px": 43.0}
        said = {"repeated_frames": (), "dropped_before": {"3": 1}, "faults": (), "warnings": ("one",)}
        found = {"count": CounterReading(1, 1.0, 9), "cost": DecodingCost(1.0, 2.0, 3.0), "readout": "left"}
        return VideoTimes(frames=frames, **shape, **errors, **seen, **said, **found)

    cameras = tuple(SyncedVideo(f"cam_{c}", f"cam_{c}.mp4", times(26.0 + 0.001 * c)) for c in range(2))
    nearest = {f"cam_{c}": NearestFrame(0, 1000.0 * c) for c in range(2)}
    write_record(folder / "times.json", FrameTimesFile("paper_rig", 4000.0, cameras, nearest, ("one",)))


def _read_times(folder: Path):
    from gof.ingest.frame_times import Timing, read_frame_times

    return read_frame_times(Timing(folder / "times.json"), [_video(0), _video(1)])


def _published(folder: Path) -> None:
    rng = np.random.default_rng(0)
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    np.savez(
        folder / "meta.npz",
        times=np.tile(np.arange(5) * 2500.0, (2, 1)),
        led_time_origin_us=np.array([100.0]),
        camera_matrix=np.tile([[80.0, 0, 24], [0, 80, 42], [0, 0, 1]], (2, 1, 1)),
        dist_coeffs=np.full((2, 5), 0.01),
        image_size=np.array([[48, 85], [48, 85]]),
        R=np.stack([turn, turn]),
        t=rng.normal(size=(2, 3)),
        points3D=rng.normal(size=(7, 3)),
    )


def _read_published(folder: Path):
    from gof.ingest.published import Meta

    meta = Meta.read(folder)
    lenses = [meta.rectified(camera) for camera in range(len(meta.camera_matrix))]
    return meta.world_to_camera(), meta.times, meta.points3D, lenses
