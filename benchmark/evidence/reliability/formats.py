"""Everything this software reads from outside: a small good sample of each format, and the public reader of it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gof.errors import GofError
from gof_benchmark.evidence.reliability.damage import Injury, renamed


@dataclasses.dataclass(frozen=True)
class Format:
    """A format to damage.

    Attributes:
        write: puts a good sample into an empty folder.
        read: reads that folder as its users would; returns all that it gives.
        damage: the files that get damaged, as a pattern.
        refusals: what the reader may raise.
        named: whether every refusal must name the file; not where two sources are compared, or there is no file.
        share: relative number of inputs; the fast ones get more.
        injury: the only kind of damage to do; None: any.
    """

    write: Callable[[Path], Any]
    read: Callable[[Path], Any]
    damage: str = "*"
    refusals: tuple[type[Exception], ...] = (GofError,)
    named: bool = True
    share: float = 1.0
    injury: Injury | None = None


def finite(value: Any, name: str = "") -> bool:
    """Whether there is no NaN or Inf anywhere inside; an infinite t_sigma means always on, velocity_sd unknown."""
    if dataclasses.is_dataclass(value):
        return all(finite(getattr(value, f.name), f.name) for f in dataclasses.fields(value))
    if isinstance(value, dict):
        return all(finite(v, str(k)) for k, v in value.items())
    if isinstance(value, (list, tuple)):
        return all(map(finite, value))
    if isinstance(value, (float, np.ndarray, np.number)) and np.asarray(value).dtype.kind in "fc":
        return bool((np.isfinite(value) | (np.isposinf(value) if name in ("t_sigma", "velocity_sd") else False)).all())
    return True


# ---------------------------------------------------------------- samples


def _gaussians(n: int = 12, harmonics: int = 0):
    from gof.gaussians import TransientGaussians

    rng = np.random.default_rng(0)
    return TransientGaussians(
        position=rng.normal(size=(n, 3)),
        velocity=rng.normal(size=(n, 3)),
        t_mu=rng.random(n),
        t_sigma=np.where(rng.random(n) < 0.2, np.inf, 0.1),
        scale=rng.uniform(0.01, 0.1, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.random(n),
        color=rng.random((n, harmonics, 3) if harmonics else (n, 3)),
        dynamic=rng.random(n) < 0.8,
    )


def _free_time_npz(folder: Path) -> None:
    rng, shapes = (
        np.random.default_rng(0),
        {"means": 3, "scales": 3, "quats": 4, "times": 1, "durations": 1, "velocities": 3},
    )
    arrays = {name: rng.normal(size=(9, k)).astype("f4") for name, k in shapes.items()}
    np.savez(
        folder / "canonical_4d.npz",
        **arrays,
        opacities=np.zeros(9, "f4"),
        sh0=np.zeros((9, 1, 3), "f4"),
        shN=np.zeros((9, 3, 3), "f4"),
        n_frames=np.array(9),
    )


def _free_time_world(folder: Path) -> None:
    """FreeTimeGS beside the COLMAP model that its world was normalised from."""
    _free_time_npz(folder)
    (folder / "colmap").mkdir()
    _colmap(folder / "colmap")


def _spacetime(folder: Path) -> None:
    from gof.ply import splat_columns, write

    rng = np.random.default_rng(0)
    columns = splat_columns(_gaussians(9).arrays())
    names = ["trbf_center", "trbf_scale", *(f"motion_{i}" for i in range(9)), *(f"omega_{i}" for i in range(4))]
    write(folder / "point_cloud.ply", columns | {name: rng.normal(size=9) for name in names}, [])


def _yang(folder: Path) -> None:
    import torch

    n, zeros = 8, torch.zeros
    turns = torch.randn(n, 4), torch.randn(n, 4)
    shared = (1, torch.randn(n, 3), zeros(n, 1, 3), zeros(n, 15, 3), zeros(n, 3), turns[0], zeros(n, 1), zeros(n))
    learned = (zeros(n, 1), zeros(n, 1), zeros(n, 1), {"state": {}, "param_groups": []}, 1.0)
    state = (*shared, *learned, torch.rand(n, 1), zeros(n, 1), turns[1], True, zeros(0), 2)
    torch.save((state, 7), folder / "chkpnt7.pth")
    (folder / "cfg_args").write_text("Namespace(sh_degree=3, source_path='a', prefilter_var=0.02, gaussian_dim=4)")


def _rig(folder: Path) -> None:
    """The sample dataset with something that burns, so that its cameras can be doubted."""
    import cv2

    _dataset(folder)
    for camera in (0, 1):
        for frame in range(2):
            path = folder / f"cameras/cam_{camera}/{frame:06d}.png"
            picture = cv2.imread(str(path))
            picture[20 + 2 * frame : 40, 8:20] = (20, 120, 255)
            cv2.imwrite(str(path), picture)
    file = folder / "dataset.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"splits": {"train": [0, 1], "test": []}}))


def _trajectory(folder: Path) -> None:
    from gof.trajectory import Trajectory

    rng = np.random.default_rng(0)
    Trajectory(
        np.arange(6) * 0.1,
        rng.normal(size=(6, 5, 3)),
        rng.random((6, 5)),
        rng.uniform(0.1, 1, (5, 3)),
        rng.normal(size=(6, 5, 4)),
    ).save(folder / "t.npz")


def _still_plys(folder: Path) -> None:
    from gof.ply import splat_columns, write

    for number in range(3):
        write(folder / f"{number:03d}.ply", splat_columns(_gaussians(5).arrays()), [])


def _checkpoint(folder: Path) -> None:
    import torch

    n, zeros = 8, torch.zeros
    state = (
        1,
        torch.randn(n, 3),
        torch.randn(n, 3),
        zeros(n, 1, 3),
        zeros(n, 3, 3),
        zeros(n, 3),
        torch.randn(n, 4),
        zeros(n, 1),
        zeros(n, 1),
        torch.ones(n, 1),
        torch.ones(n, dtype=torch.bool),
        zeros(n),
        zeros(n, 1),
        zeros(n, 1),
        {"state": {}, "param_groups": []},
        1.0,
    )
    torch.save((state, 7), folder / "chkpnt7.pth")
    (folder / "scale_bounds.json").write_text('{"dynamic_scale_min": 0.001, "dynamic_scale_max": 0.03}')


def _camera(index: int) -> dict:
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


def _dataset(folder: Path) -> None:
    import cv2

    pixels = np.random.default_rng(0).integers(0, 255, (64, 30, 3)) // 64 * 64
    cameras = [_camera(0), _camera(1)]
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
    from gof_blender.pure.io.velocity_store import VelocityWriter

    _store(
        VelocityWriter(folder / "velocity.zarr", (5, 6, 7), np.diag([0.1, 0.1, 0.1, 1]), np.array([0.0, 0.01]), 0.1),
        (5, 6, 7, 3),
    )


def _flame(folder: Path) -> None:
    from gof_blender.pure.io.velocity_store import VelocityWriter, scalar

    _store(
        VelocityWriter(
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


def _colmap(folder: Path) -> None:
    rows = [f"{i} 1 0.1 {0.1 * i} 0 {i} 0 3 1 cam_{i}.png\n1 2 -1\n" for i in (1, 2)]
    (folder / "images.txt").write_text("# images\n" + "".join(rows))
    (folder / "points3D.txt").write_text("".join(f"{i} {i} {i * i} {i**3} 1 2 3 0.5\n" for i in range(6)))


def _poses(folder: Path) -> None:
    (folder / "poses.json").write_text(json.dumps({f"cam_{i}": _camera(i)["world_to_camera"] for i in range(2)}))


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


# ---------------------------------------------------------------- names

ESCAPED = Path("/tmp/gof-escaped")


def _beside_secrets(folder: Path) -> Path:
    """The empty folder/dataset, with links in it, beside what nothing in it may reach: folder/outside."""
    import cv2

    dataset, outside = folder / "dataset", folder / "outside"
    for path in (dataset, outside):
        path.mkdir()
    cv2.imwrite(str(outside / "secret.png"), np.full((64, 30, 3), 123, np.uint8))
    (dataset / "link").symlink_to(outside)
    (dataset / "secret.png").symlink_to(outside / "secret.png")
    return dataset


def _names(folder: Path) -> None:
    from gof_blender.pure.spec import BlendFile, SceneSpec

    dataset = _beside_secrets(folder)
    _dataset(dataset)
    file = dataset / "dataset.json"
    (dataset / "background.blend").write_bytes(b"")
    spec = SceneSpec("sample", background="blend_file", blend_file=BlendFile("background.blend"))
    file.write_text(json.dumps(json.loads(file.read_text()) | {"spec": spec.to_dict()}))


def _captions(folder: Path) -> None:
    import cv2

    from gof.reconstruct.captions import Caption, Captions
    from gof.report.preview import Preview

    dataset = _beside_secrets(folder)
    for name in ("1.png", "preview.png"):
        cv2.imwrite(str(dataset / name), np.zeros((8, 8, 3), np.uint8))
    Captions((Caption("1.png", "what it shows"), Caption("1.png", "again"))).write(dataset)
    Preview("preview.png", 0, 0).write(dataset / "preview.json")


def _use_names(folder: Path):
    """Everything that reads and writes files by the names in a dataset.json."""
    from gof.dataset import Dataset
    from gof.dataset.plates import background, save_plates
    from gof.files import path_in
    from gof_benchmark.views import dnerf, dynerf, nerfstudio
    from gof_benchmark.views.source import ViewSource
    from gof_blender.pure.description import DatasetDescription
    from gof_blender.pure.io import FileFormatError, velocity_reader
    from gof_blender.worker.import_result import read_spec

    dataset = folder / "dataset"
    try:
        found = _read_dataset(dataset)
        d = Dataset.open(dataset)
        save_plates(dataset / "out", [camera.name for camera in d.cameras], [d.static(c) for c in range(2)])
        plates = [background(d, c, dataset / "out") for c in range(2)]
        for camera in d.cameras:
            path_in(dataset, f"cameras/{camera.name}/board_mask.png").parent.mkdir(parents=True, exist_ok=True)
        source = ViewSource.open(dataset)
        nerfstudio.write(source)
        dnerf.write(source)
        for number in range(2):
            dynerf.link_pictures(source, number, number)
        for what in ("transforms.json", "transforms_train.json"):
            for frame in json.loads((dataset / what).read_text())["frames"]:
                path_in(dataset, frame["file_path"].removeprefix("./"))
        files = [read_spec(dataset).blend_file.path, velocity_reader.of_dataset(dataset).time_s]
        files += [camera.name for camera in DatasetDescription.read(dataset).cameras]
    except FileFormatError as e:
        raise GofError(str(e)) from e
    finally:
        _require_apart(folder)
    return found, plates, files


def _use_captions(folder: Path):
    """The pictures that a report takes from files beside it."""
    from gof.dataset import Dataset
    from gof.report.page import _preview, _stage_pictures
    from gof.report.preview import Preview

    dataset = folder / "dataset"
    if not (dataset / "dataset.json").exists():
        _dataset(dataset)
    pages = _stage_pictures(dataset), _preview(Preview.read(dataset / "preview.json"), dataset, Dataset.open(dataset))
    _require_apart(folder)
    return pages


def _evaluated(folder: Path) -> None:
    from gof.costs import StageLog
    from gof.evaluate.scores import Origin, Scores

    origin = Origin("a method", ("a note", "another"))
    Scores(gaussians=3, dynamic_gaussians=2, import_=origin, warnings=("a warning",)).write(folder / "scores.json")
    (folder / "method.json").write_text(json.dumps({"name": "ours", "train_seconds": 3.0}))
    StageLog(folder / "costs.json").record("stage", 1.0, 2.0)


def _show_texts(folder: Path):
    """The texts of an evaluated result in every table and on every page."""
    import csv
    import io

    from gof.costs import StageLog
    from gof.evaluate.leaderboard import collect, rows_of, to_csv, to_markdown
    from gof.evaluate.leaderboard_page import to_html
    from gof.terminal import console

    rows = rows_of(collect([folder]))
    costs = StageLog(folder / "costs.json").costs()
    for cells in csv.reader(io.StringIO(to_csv(rows))):
        assert not any(cell.lstrip().startswith(("=", "+", "@")) for cell in cells), "a cell is a formula"
    table = to_markdown(rows)
    assert len(table.splitlines()) == len(rows) + 2 and not {"<", "\x1b", "\0"} & set(table), "a name acts in a table"
    page = to_html(rows, [], rows[0].name)
    assert "<script>alert" not in page, "a name acts on a page"
    screen = console()
    with screen.capture() as said:
        screen.print(rows[0].name, *rows[0].notes)
    assert not {"\x1b", "\x07", "\x9b", "\r", "\0"} & set(said.get()), "a name acts on a terminal"
    return rows, costs


def _require_apart(folder: Path) -> None:
    """What lies outside the dataset is as it was, and nothing has come there."""
    import cv2

    secret = folder / "outside" / "secret.png"
    assert {p.name for p in folder.iterdir()} == {"dataset", "outside"}, "something was written outside"
    assert [p.name for p in secret.parent.iterdir()] == ["secret.png"], "something was written through a link"
    assert secret.stat().st_nlink == 1, "a file outside was linked"
    assert (cv2.imread(str(secret)) == 123).all(), "a file outside was changed"
    assert not list(ESCAPED.parent.glob(ESCAPED.name + "*")), "something was written at an absolute path"


# ---------------------------------------------------------------- readers


def _read_transient(name: str) -> Callable[[Path], Any]:
    def read(folder: Path):
        from gof.gaussians import TransientGaussians

        return TransientGaussians.load(folder / name)

    return read


def _read_in_blender(name: str) -> Callable[[Path], Any]:
    def read(folder: Path):
        from gof_blender.pure.io import gaussians_file

        gaussians_file.count(folder / name)
        return gaussians_file.load(folder / name)

    return read


def _read_foreign(name: str = "", time_unit_s: float | None = 0.5) -> Callable[[Path], Any]:
    def read(folder: Path):
        from gof.io.importers import ImportOptions, read_result

        return read_result(folder / name, ImportOptions(time_unit_s=time_unit_s)).gaussians

    return read


def _read_in_colmap_world(folder: Path):
    from gof.io.importers import ImportOptions, read_result

    options = ImportOptions(time_unit_s=0.5, world=folder / "colmap", world_by="freetime")
    return read_result(folder / "canonical_4d.npz", options).gaussians


def _read_spacetime(folder: Path):
    motion = _read_foreign("point_cloud.ply")(folder)
    return [motion.state_at(time_s) for time_s in (0.0, 0.3)]


def _doubt(folder: Path):
    from gof.dataset import Dataset
    from gof.reconstruct.sanity import doubts

    return [doubt.text for doubt in doubts(Dataset.open(folder))]


def _read_dataset(folder: Path):
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
    from gof.fields import VelocitySequence

    v = VelocitySequence.open(folder / "velocity.zarr")
    middle = (v.times_s[0] + v.times_s[-1]) / 2
    return v.times_s, v.frame(0), v.chunk(len(v) - 1, (0, 0, 0)), v.at(middle), v.frame(0).sample(np.full((2, 3), 0.3))


def _read_velocity_in_blender(folder: Path):
    from gof_blender.pure.io.velocity_reader import TrueVelocity

    return TrueVelocity(folder / "velocity.zarr").sample(np.full((3, 3), 0.3), np.array([0.0, 0.004, 0.01]))


def _read_flame(folder: Path):
    from gof.evaluate.emission import FlameGrid

    grid = FlameGrid(folder / "flame.zarr")
    return grid.places(0.01, 20, np.random.default_rng(0))


def _read_colmap(folder: Path):
    from gof.io.importers.alignment import read_cameras
    from gof.io.importers.normalisation import world_from_training
    from gof.similarity import decompose

    places = np.random.default_rng(0).normal(size=(9, 3))
    return read_cameras(folder), decompose(world_from_training(folder, "gsplat", places)[0])


def _read_poses(folder: Path):
    from gof.io.importers.alignment import align_cameras, read_cameras

    found = read_cameras(folder / "poses.json")
    return found, align_cameras(
        found, {name: np.array(_camera(i)["world_to_camera"]) for i, name in enumerate(("cam_0", "cam_1"))}
    )


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


def formats() -> dict[str, Format]:
    """All of them by name."""
    from gof.io.importers import freetime
    from gof_blender.pure.checked_json import SpecError
    from gof_blender.pure.io import FileFormatError

    own = (FileFormatError,)
    return {
        "result .ply": Format(
            lambda f: _gaussians(harmonics=4).save(f / "result.ply"), _read_transient("result.ply"), share=2
        ),
        "result .npz": Format(lambda f: _gaussians().save(f / "result.npz"), _read_transient("result.npz"), share=2),
        "result .ply, add-on": Format(
            lambda f: _gaussians().save(f / "result.ply"), _read_in_blender("result.ply"), refusals=own, share=2
        ),
        "result .npz, add-on": Format(
            lambda f: _gaussians().save(f / "result.npz"), _read_in_blender("result.npz"), refusals=own, share=2
        ),
        "FTGS .ply": Format(
            lambda f: freetime.save(_gaussians(), f / "r.ftgs.ply", 0, 1), _read_foreign("r.ftgs.ply"), share=2
        ),
        "FreeTimeGS .npz": Format(_free_time_npz, _read_foreign("canonical_4d.npz"), share=2),
        "FreeTimeGS in a COLMAP world": Format(_free_time_world, _read_in_colmap_world, "**/*.[nt][px]*", named=False),
        "SpacetimeGaussians .ply": Format(_spacetime, _read_spacetime),
        "4DGS of Yang, cfg_args": Format(_yang, _read_foreign("chkpnt7.pth")),
        "a rig, doubted": Format(_rig, _doubt, "**/*.[jp][sn]*"),
        "trajectory .npz": Format(_trajectory, _read_foreign("t.npz", None), share=2),
        "sequence of .ply": Format(_still_plys, _read_foreign()),
        "checkpoint .pth": Format(_checkpoint, _read_foreign("chkpnt7.pth"), share=2),
        "dataset.json": Format(_dataset, _read_dataset, "dataset.json", share=2),
        "pictures .png": Format(_dataset, _read_dataset, "*/cam_0*/**/*.png"),
        "pictures .exr": Format(_exr, _read_exr, refusals=(OSError,), share=2),
        "velocity.zarr": Format(_velocity, _read_velocity, "velocity.zarr/**/*"),
        "velocity.zarr, add-on": Format(_velocity, _read_velocity_in_blender, "velocity.zarr/**/*", refusals=own),
        "flame.zarr": Format(_flame, _read_flame, "flame.zarr/**/*"),
        "cameras, COLMAP": Format(_colmap, _read_colmap, named=False, share=2),
        "cameras .json": Format(_poses, _read_poses, named=False, share=2),
        "names in dataset.json": Format(_names, _use_names, "dataset/dataset.json", injury=renamed),
        "names of pictures": Format(_captions, _use_captions, "dataset/[cp]*.json", injury=renamed),
        "texts of a result": Format(_evaluated, _show_texts, injury=renamed, named=False),
        "scores, costs, method": Format(_evaluated, _show_texts, named=False),
        "scene spec": Format(_spec, _read_spec, refusals=(SpecError,), share=4),
        "serial frames": Format(_frames, _read_frames, named=False, share=16),
    }
