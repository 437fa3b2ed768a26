"""Shared test material, all made here: small Gaussians, a small camera arc, and a dataset folder by the contract."""

import os
import shutil
import sys
import tempfile
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

# Before numpy comes: threads of workers side by side, one a core, would spin on small matrices and wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # some hundred processes start: each would compile the package again

import cv2
import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.fields import VelocityField, VelocitySequence
from gof.core.gaussians import TransientGaussians
from gof.dataset import CameraEntry, DatasetDescription, Splits
from gof.host.threads import core_count

# Dr.Jit's threads look for work for milliseconds after each of its kernels: of pictures as small as tests', two take no
# less time than one, and half as much CPU again. Tests of the kernels themselves draw on all (`threads_of_kernels`).
if find_spec("drjit"):
    import drjit

    drjit.set_thread_count(1)
sys.dont_write_bytecode = False
os.environ.setdefault("GOF_DEBUG", "faults")  # a fault of ours shows where it is; tests of its words take this away


EACH_ALONE = ("tests/test_printed_commands.py", "tests/test_examples.py", "tests/test_site.py")  # pages take long
TESTS_OF_KERNELS = ("render", "on_cpu")  # folders
SECONDS = {"blender": 4, "long": 3}  # of a test with this mark, about; one without takes none


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file's tests, which share fixtures, on one worker; pages on any. Long ones first, as collected."""
    from xdist.scheduler import LoadScopeScheduling

    config.option.loadscopereorder = False

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return nodeid if file in EACH_ALONE else file

    return ByFile(config, log)


@pytest.hookimpl(trylast=True)  # after those that do not run are left out
def pytest_collection_modifyitems(config, items):
    """Side by side, files that take long come first: no worker is left with one when the others are done."""
    if not hasattr(config, "workerinput"):
        return
    seconds = Counter()
    for item in items:
        seconds[item.path] += max((SECONDS.get(mark.name, 0) for mark in item.iter_markers()), default=0)
    items.sort(key=lambda item: -seconds[item.path])


def look_at(name: str, position, target, width=36, height=64, focal_px=80.0) -> Camera:
    """An upright OpenCV camera at `position` looking at `target` (world Z up)."""
    position, target = np.asarray(position, float), np.asarray(target, float)
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = R, -R @ position
    K = [[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]]
    return Camera(name, width, height, K, world_to_camera)


def arc(n=3, radius=3.0, target=(0, 0, 1.0), **kwargs) -> list[Camera]:
    """n cameras on a 70-degree arc around `target` at its height."""
    angles = np.deg2rad(np.linspace(-35, 35, n)) if n > 1 else [0.0]
    return [
        look_at(f"cam_{i}", np.add(target, [radius * np.sin(a), -radius * np.cos(a), 0]), target, **kwargs)
        for i, a in enumerate(angles)
    ]


def random_gaussians(n=40, seed=0, sh_coefficients=0) -> TransientGaussians:
    rng = np.random.default_rng(seed)
    return TransientGaussians(
        position=rng.normal(0, 0.3, (n, 3)) + [0, 0, 1],
        velocity=rng.normal(0, 1, (n, 3)),
        t_mu=rng.uniform(0, 1, n),
        t_sigma=np.where(rng.random(n) < 0.2, np.inf, rng.uniform(0.02, 0.5, n)),
        scale=rng.uniform(0.01, 0.1, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0, 1, n),
        color=rng.random((n, sh_coefficients, 3) if sh_coefficients else (n, 3)),
        dynamic=rng.random(n) < 0.8,
    )


@pytest.fixture(scope="session", autouse=True)
def _own_temporary_folder(tmp_path_factory):
    """Take away what programs that tests start leave with other temporary files."""
    folder = tmp_path_factory.mktemp("tmp")
    with pytest.MonkeyPatch.context() as environment:
        environment.setattr(tempfile, "tempdir", str(folder))
        for name in ("TMPDIR", "TEMP", "TMP"):
            environment.setenv(name, str(folder))
        yield
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def gaussians() -> TransientGaussians:
    return random_gaussians()


def write_dataset(folder: Path, cameras, images, statics, times_s, fields=None, masks=None, test_frames=()) -> Path:
    """A dataset folder. images (T, C, H, W, 3) and statics (C, H, W, 3) are display values, masks (T, C, H, W)."""

    def write(path: Path, image):
        path.parent.mkdir(parents=True, exist_ok=True)
        values = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
        assert cv2.imwrite(str(path), values[..., ::-1] if values.ndim == 3 else values)

    entries = []
    for c, camera in enumerate(cameras):
        files = f"cameras/{camera.name}"
        entry = CameraEntry.of(
            camera,
            rgb=f"{files}/rgb/{{frame:06d}}.png",
            static=f"static/{camera.name}.png",
            mask=None if masks is None else f"{files}/mask/{{frame:06d}}.png",
        )
        entries.append(entry)
        write(folder / entry.static, statics[c])
        for k in range(len(times_s)):
            write(folder / entry.rgb.format(frame=k), images[k][c])
            if masks is not None:
                write(folder / entry.mask.format(frame=k), masks[k][c].astype(float))
    if fields is not None:
        VelocitySequence.create(folder / "velocity.zarr", fields)
    train = [k for k in range(len(times_s)) if k not in test_frames]
    DatasetDescription(
        name=folder.name,
        time_s=tuple(map(float, times_s)),
        cameras=tuple(entries),
        splits=Splits(tuple(train), tuple(test_frames)),
        velocity="velocity.zarr" if fields is not None else None,
    ).write(folder)
    return folder


@pytest.fixture
def tiny_dataset(tmp_path) -> Path:
    """2 cameras, 4 frames of random pictures, a constant velocity field."""
    rng = np.random.default_rng(0)
    cameras = arc(2)
    images = rng.random((4, 2, 64, 36, 3))
    fields = [VelocityField.from_array(np.full((4, 5, 6, 3), 0.5 * k), (-1, -1, 0), 0.5, 0.01 * k) for k in range(4)]
    return write_dataset(
        tmp_path / "tiny",
        cameras,
        images,
        images[0] * 0.5,
        0.01 * np.arange(4),
        fields,
        masks=rng.random((4, 2, 64, 36)) > 0.5,
        test_frames=[2],
    )


@pytest.fixture(scope="module", autouse=True)
def threads_of_kernels(request):
    """In tests of kernels, as many of Dr.Jit's threads as the renderer takes by itself, and never one alone."""
    if request.path.parent.name not in TESTS_OF_KERNELS or not find_spec("drjit"):
        yield
        return
    before = drjit.thread_count()
    drjit.set_thread_count(max(2, min(core_count(), 8)))
    yield
    drjit.set_thread_count(before)


@pytest.fixture(params=["drjit", "native"])
def kernels(request, monkeypatch) -> str:
    """Draw with both sets of kernels, in turns; skips where one cannot run."""
    if request.param == "native":
        pytest.importorskip("numba")
        from gof.render.backend import BACKEND

        if BACKEND == "cuda":
            pytest.skip("native kernels are for CPUs")
    monkeypatch.setenv("GOF_RENDER_KERNELS", request.param)
    return request.param
