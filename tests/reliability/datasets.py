"""Datasets to damage: their description, pictures, grids and cameras, and what describes a scene or a board."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from gof.core.errors import GofError
from tests.reliability.format import Format
from tests.reliability.malice import impossible


def formats() -> dict[str, Format]:
    """By name."""
    from gof_blender.core.checked_json import SpecError

    grid = "velocity.zarr/**/*"
    return {
        "a rig, judged": Format(rig, _faults, "**/*.[jp][sn]*"),
        "a rig that cannot be": Format(rig, _believe, "dataset.json", injury=impossible, believed=False),
        "dataset.json": Format(dataset, read_dataset, "dataset.json", share=2),
        "pictures .png": Format(dataset, read_dataset, "*/cam_0*/**/*.png"),
        "pictures .exr": Format(_exr, _read_exr, refusals=(OSError,), share=2),
        "depth .npy": Format(_depth, _read_depth, "**/*.npy"),
        "velocity.zarr": Format(_velocity, _read_velocity, grid),
        "velocity.zarr, at points": Format(_velocity, _read_velocity_at_points, grid),
        "flame.zarr": Format(_flame, _read_flame, "flame.zarr/**/*"),
        "fire of another solver": Format(_fire, _read_fire, "**/*"),
        "cameras, COLMAP": Format(colmap, _read_colmap, named=False, share=2),
        "cameras .json": Format(_poses, _read_poses, named=False, share=2),
        "scene spec": Format(_spec, _read_spec, refusals=(SpecError,), share=4),
        "serial frames": Format(_frames, _read_frames, named=False, share=16),
    }


# ---------------------------------------------------------------- samples


def camera_entry(index: int) -> dict:
    turn = np.array([[1.0, 0, 0, 0.1 * index], [0, 0, -1, 1], [0, 1, 0, 3], [0, 0, 0, 1]])
    name = f"cam_{index}"
    return {
        "name": name,
        "role": "train",
        "width": 30,
        "height": 64,
        "K": [[80.0, 0, 15], [0, 80, 32], [0, 0, 1]],
        "world_to_camera": turn.tolist(),
        "row_time_s": 1e-5,
        "readout": "down",
        "time_s": [0.001, 0.011],
        "rgb": f"cameras/{name}/{{frame:06d}}.png",
        "mask": f"cameras/{name}/mask_{{frame:06d}}.png",
        "static": f"static/{name}.png",
        "board_mask": f"static/{name}.png",
    }


def dataset(folder: Path) -> None:
    import cv2

    pixels = np.random.default_rng(0).integers(0, 255, (64, 30, 3)) // 64 * 64
    cameras = [camera_entry(0), camera_entry(1)]
    for camera in cameras:
        for file in {camera[kind].format(frame=k) for kind in ("rgb", "mask", "static") for k in range(2)}:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / file), pixels)
    (folder / "dataset.json").write_text(
        json.dumps(
            {
                "schema": "gof-dataset",
                "version": 1,
                "name": "sample",
                "time_s": [0.0, 0.01],
                "cameras": cameras,
                "splits": {"train": [0], "test": [1]},
                "velocity": "velocity.zarr",
            }
        )
    )
    _velocity(folder)


def _velocity(folder: Path) -> None:
    from gof.core.grid_writer import GridWriter

    _store(
        GridWriter(folder / "velocity.zarr", (5, 6, 7), np.diag([0.1, 0.1, 0.1, 1]), np.array([0.0, 0.01]), 0.1),
        (5, 6, 7, 3),
    )


def _flame(folder: Path) -> None:
    from gof.core.grid_writer import GridWriter, scalar

    _store(
        GridWriter(
            folder / "flame.zarr",
            (5, 6, 7),
            np.diag([0.1, 0.1, 0.1, 1]),
            np.array([0.0, 0.01]),
            0.1,
            "float16",
            scalar("flame"),
        ),
        (5, 6, 7),
    )


def _store(writer, shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float16)
    for frame in range(2):
        writer.write_frame(frame, values.__getitem__)
    writer.finish()


def colmap(folder: Path) -> None:
    rows = [f"{i} 1 0.1 {0.1 * i} 0 {i} 0 3 1 cam_{i}.png\n1 2 -1\n" for i in (1, 2)]
    (folder / "images.txt").write_text("# images\n" + "".join(rows))
    (folder / "points3D.txt").write_text("".join(f"{i} {i} {i * i} {i**3} 1 2 3 0.5\n" for i in range(6)))


def _poses(folder: Path) -> None:
    (folder / "poses.json").write_text(json.dumps({f"cam_{i}": camera_entry(i)["world_to_camera"] for i in range(2)}))


def _depth(folder: Path) -> None:
    for camera in ("cam_0", "cam_1"):
        (folder / camera).mkdir()
        np.save(folder / camera / "000000.npy", np.random.default_rng(0).random((6, 5)).astype("f4"))


def _fire(folder: Path) -> None:
    """As the solvers write it: a description, velocities and light on one grid."""
    from gof.core.fire import FireDescription, Hearth
    from gof_benchmark.solvers.grids import FireFrame, FireHistory, write_fire

    hearth = Hearth(30.0, 0.3, (0.0, 0.0, 0.0), 0.1)
    about = FireDescription("sample", "a solver 1", (0.0, 0.01), "grey", hearths=(hearth,))
    rng = np.random.default_rng(0)
    velocity, light = rng.random((5, 6, 7, 3)).astype("f4"), rng.random((5, 6, 7, 3)).astype("f4")
    history = FireHistory((-0.1, 0.0, 0.01), (1.0, 2.0, 3.0), ((0.0, 0.0, 0.1),), ((0.1,), (0.2,), (0.3,)))
    write_fire(folder / "fire", about, np.diag([0.1, 0.1, 0.1, 1]), lambda k: FireFrame(velocity, light), history)


def _exr(folder: Path) -> None:
    from gof_blender.scene import images

    ramp = np.linspace(0, 1, 24 * 32, dtype=np.float32).reshape(24, 32)
    images.write_exr(folder / "000000.exr", np.dstack([ramp] * 4), ramp, np.dstack([ramp] * 3))


def _spec(folder: Path) -> None:
    from gof_blender.pure import effects, spec

    scene = spec.SceneSpec("sample", effects=tuple(effects.module(name).Settings() for name in effects.names()))
    spec.save(scene, folder / "spec.json")


def _frames(folder: Path) -> None:
    from gof.capture import protocol

    status = bytes([1, 7, protocol.Request.STATUS | 0x80, 0]) + bytes([2, 1]) + bytes(32)
    identity = bytes([1, 8, protocol.Request.IDENTIFY | 0x80, 0, 3, 10, 4, 8]) + b"\x07\0\0\0gof-board 1"
    (folder / "received.frames").write_bytes(
        b"noise\0" + protocol.encode_frame(status) + protocol.encode_frame(identity)
    )


def rig(folder: Path) -> None:
    """Three cameras around a glowing ball that grows, whose pictures agree: no fault."""
    import cv2

    from gof.core.cameras import Camera

    camera_entries, centre = [], np.array([0.0, 0.0, 0.5])
    for number, angle in enumerate(np.radians([0, 35, 70])):
        eye = centre + 2.5 * np.array([np.sin(angle), -np.cos(angle), 0])
        forward = (centre - eye) / np.linalg.norm(centre - eye)
        turn = np.stack([np.cross(forward, [0, 0, 1]), [0, 0, -1], forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, -turn @ eye
        entry = camera_entry(number) | {"world_to_camera": pose.tolist(), "time_s": [0.0, 0.01]}
        entry |= {
            "width": 48,
            "height": 64,
            "K": [[90.0, 0, 24], [0, 90, 32], [0, 0, 1]],
            "board_mask": None,
            "mask": None,
        }
        camera_entries.append(entry)
        seen = Camera(entry["name"], 48, 64, entry["K"], pose)
        (folder / "static").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / entry["static"]), np.full((64, 48, 3), 30, np.uint8))
        for frame in range(2):
            path = folder / entry["rgb"].format(frame=frame)
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), _ball(seen, centre, 0.2 + 0.04 * frame))
    about = {"schema": "gof-dataset", "version": 1, "name": "sample", "time_s": [0.0, 0.01], "cameras": camera_entries}
    (folder / "dataset.json").write_text(json.dumps(about | {"splits": {"train": [0, 1], "test": []}}))


def _ball(camera, centre: np.ndarray, radius: float) -> np.ndarray:
    """(H, W, 3) uint8 BGR: the way of every pixel's ray through a ball, brighter above, as light; over grey 30."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    ray = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.K).T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    middle = camera.world_to_camera[:3, :3] @ centre + camera.world_to_camera[:3, 3]
    along = ray @ middle
    way = 2 * np.sqrt(np.clip(radius**2 - (middle @ middle - along**2), 0, None)) / (2 * radius)
    light = way[..., None] * np.array([20.0, 110, 220]) * (1.5 - rows / camera.height)[..., None]
    return np.clip(30 + light, 0, 255).astype(np.uint8)


def read_dataset(folder: Path):
    from gof.dataset import Dataset

    d = Dataset.open(folder)
    pictures = [
        (d.image(c, k), d.mask(c, k), d.static(c), d.board_weight(c))
        for c in range(len(d.cameras))
        for k in d.train_frames[:2] + d.test_frames[:2]
    ]
    times = [d.camera_times_s(c) for c in range(len(d.cameras))]
    return d.cameras, d.times_s, d.frame_time_s, pictures, times, d.velocity.times_s if d.has_velocity else None


def _read_velocity(folder: Path):
    from gof.core.fields import VelocitySequence

    v = VelocitySequence.open(folder / "velocity.zarr")
    middle = (v.times_s[0] + v.times_s[-1]) / 2
    return v.times_s, v.frame(0), v.chunk(len(v) - 1, (0, 0, 0)), v.at(middle), v.frame(0).sample(np.full((2, 3), 0.3))


def _read_velocity_at_points(folder: Path):
    from gof.core.fields import VelocitySequence

    v = VelocitySequence.open(folder / "velocity.zarr")
    return v.sample(np.full((3, 3), 0.3), np.array([0.0, 0.004, 0.01]))


def _read_flame(folder: Path):
    from gof.evaluate.emission import FlameGrid

    grid = FlameGrid(folder / "flame.zarr")
    return grid.places(0.01, 20, np.random.default_rng(0))


def _read_colmap(folder: Path):
    from gof.core.similarity import decompose
    from gof.io.importers.alignment import read_cameras
    from gof.io.importers.normalisation import world_from_training

    places = np.random.default_rng(0).normal(size=(9, 3))
    return read_cameras(folder), decompose(world_from_training(folder, "gsplat", places)[0])


def _read_poses(folder: Path):
    from gof.io.importers.alignment import align_cameras, read_cameras

    found = read_cameras(folder / "poses.json")
    return found, align_cameras(
        found, {name: np.array(camera_entry(i)["world_to_camera"]) for i, name in enumerate(("cam_0", "cam_1"))}
    )


def _read_depth(folder: Path):
    from gof.evaluate.depth import read_depth, rmse_to_map

    first = read_depth(folder, "cam_0", 0)
    return first, rmse_to_map(first, folder, "cam_1", 0)


def _read_fire(folder: Path):
    from gof_benchmark.solvers.grids import FireGrids

    fire = FireGrids.open(folder / "fire")
    fire.check()
    return fire.description, fire.history, fire.velocity.frame(0), fire.velocity.at(0.004)


def _read_exr(folder: Path):
    from gof_blender.scene import images

    if not images.opens(folder / "000000.exr"):  # what the generator asks before it makes a picture again
        raise OSError(f"{folder}: would be made again")
    return images.read_exr(folder / "000000.exr")


def _read_spec(folder: Path):
    from gof_blender.pure import spec

    return spec.load(folder / "spec.json").to_dict()


def _read_frames(folder: Path):
    from gof.capture import protocol

    reader, found = protocol.FrameReader(), []
    for payload in reader.push((folder / "received.frames").read_bytes()):
        reply = protocol.decode_reply(payload)
        if reply and reply.request == protocol.Request.STATUS:
            found.append(protocol.Status.decode(reply.body))
        elif reply and reply.request == protocol.Request.IDENTIFY:
            found.append(protocol.Identity.decode(reply.body))
    return found


def _faults(folder: Path):
    from gof.dataset import Dataset
    from gof.reconstruct.sanity import find_faults

    return [fault.text for fault in find_faults(Dataset.open(folder))]


def _believe(folder: Path) -> None:
    if said := _faults(folder):
        raise GofError(f"{folder}: {said[0]}")
