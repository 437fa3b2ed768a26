"""The task graph: rendering beside the bake, killed renderers and workers, and everything still there."""

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from gof.dataset import Dataset
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.layout import Layout
from tests.blender.runs import TOY

pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
pytestmark = pytest.mark.blender
SPEC = replace(
    TOY, name="graph", clip=replace(TOY.clip, frames=16, warm_up_frames=8), domain=replace(TOY.domain, resolution=64)
)


def start(folder: Path, *options) -> tuple[subprocess.Popen, Layout]:
    scene_spec.save(SPEC, folder / "spec.json")
    command = [
        sys.executable,
        "-m",
        "gof",
        "generate",
        str(folder / "spec.json"),
        "--out",
        str(folder / "data"),
        *options,
    ]
    log = open(folder / "log.txt", "w")
    return subprocess.Popen(command, stdout=log, stderr=log), Layout(folder / "data")


def pictures(layout: Layout) -> dict[Path, int]:
    """Finished pictures and when: the EXR is written last."""
    return {path: path.stat().st_mtime_ns for path in layout.root.glob("cameras/*/exr/0*.exr")}


def wait_until(condition, process: subprocess.Popen, seconds: float = 180) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None and time.monotonic() < deadline, "the run ended, or took too long"
        time.sleep(0.02)


def renderers(process: subprocess.Popen) -> list[psutil.Process]:
    return [
        p for p in psutil.Process(process.pid).children(recursive=True) if p.is_running() and "serve" in p.cmdline()
    ]


def check_complete(layout: Layout, before: dict[Path, int]) -> None:
    dataset = Dataset.open(layout.root)
    assert len(pictures(layout)) == SPEC.clip.frames * SPEC.cameras.count == 48
    assert all(dataset.image(camera, frame).any() for camera in range(3) for frame in (0, 15))
    assert len(dataset.velocity) == 16
    assert {path: when for path, when in pictures(layout).items() if path in before} == before, "made twice"
    assert not [path for path in layout.root.rglob(".*.partial*") if "passes" not in path.name]


def test_pictures_follow_the_bake_and_survive_kill_9_of_the_renderer(tmp_path):
    process, layout = start(tmp_path)
    wait_until(lambda: len(pictures(layout)) >= 3, process)
    before = pictures(layout)
    killed = renderers(process)
    assert killed
    for renderer in killed:
        renderer.send_signal(signal.SIGKILL)
    assert process.wait(timeout=240) == 0, (tmp_path / "log.txt").read_text()[-2000:]
    check_complete(layout, before)
    first, baked = min(pictures(layout).values()), layout.bake_marker.stat().st_mtime_ns
    assert first < baked, "the first picture was there before the last solver step"


@pytest.mark.slow
def test_dask_workers_of_their_own_and_kill_9_of_one(tmp_path):
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        address = next(m.group() for line in scheduler.stderr if (m := re.search(r"tcp://[\d.]+:\d+", line)))
        worker = [
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            address,
            "--nthreads",
            "1",
            "--no-nanny",
            "--no-dashboard",
        ]
        workers = [subprocess.Popen(worker, stderr=subprocess.DEVNULL, cwd=os.getcwd()) for _ in range(2)]
        try:
            process, layout = start(tmp_path, "--scheduler", address)
            wait_until(lambda: layout.bake_marker.exists() and len(pictures(layout)) >= 5, process)
            before = pictures(layout)
            workers[0].kill()
            assert process.wait(timeout=300) == 0, (tmp_path / "log.txt").read_text()[-2000:]
            check_complete(layout, before)
        finally:
            for worker in workers:
                worker.kill()
    finally:
        scheduler.kill()
