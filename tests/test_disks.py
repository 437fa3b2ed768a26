"""Full disks, read-only folders, two runs in one folder: a named error, and nothing lost."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gof.core.errors import GofError
from gof.core.files import only_run_in, write_json
from gof.core.gaussians import TransientGaussians
from gof_benchmark.scenes import claimed
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.layout import Layout
from tests.blender.runs import TOY
from tests.reconstruct.rising_flame import reconstruct, write_flame

pytestmark = pytest.mark.long

OPTIONS = ("--gaussians", "800", "--steps", "20", "--voxels", "24", "--no-flow-prior")


class Disk:
    """A small file system in memory, which can be grown and made read-only."""

    def __init__(self, path: Path):
        self.path = path
        path.mkdir()
        if subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(path)], capture_output=True
        ).returncode:
            pytest.skip("mounting a file system takes root")

    def remount(self, options: str) -> None:
        subprocess.run(["mount", "-o", f"remount,{options}", str(self.path)], check=True)


@pytest.fixture
def disk(tmp_path):
    found = Disk(tmp_path / "disk")
    yield found
    subprocess.run(["umount", "-l", str(found.path)], check=True)


def gof(*arguments) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", "gof", *map(str, arguments)], capture_output=True, text=True)


def files(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.rglob("*") if p.is_file())


@pytest.fixture(scope="module")
def flame(tmp_path_factory):
    return write_flame(tmp_path_factory.mktemp("flame") / "flame", frames=5)


def test_reconstruct_on_a_full_disk_ends_with_a_named_error_and_goes_on_when_there_is_room(disk, flame):
    out = disk.path / "out"
    run = gof("reconstruct", flame, "--out", out, *OPTIONS)
    assert run.returncode == 1 and "Traceback" not in run.stderr, run.stderr
    assert "No space left on device; finished work is kept" in run.stderr and str(disk.path) in run.stderr
    assert not (out / "result.npz").exists() and not [name for name in files(out) if "partial" in name]
    disk.remount("size=64m")
    assert gof("reconstruct", flame, "--out", out, *OPTIONS).returncode == 0
    assert len(TransientGaussians.load(out / "result.npz"))


def test_results_cannot_be_spoilt_by_a_full_disk(disk, gaussians):
    path = gaussians.save(disk.path / "result.npz")
    before = path.read_bytes()
    (disk.path / "rest").write_bytes(bytes(4096 * (os.statvfs(disk.path).f_bavail - 1)))
    with pytest.raises(OSError, match="No space left") as caught:
        TransientGaussians.concatenate([gaussians] * 20).save(path)
    assert caught.value.filename and path.read_bytes() == before and len(files(disk.path)) == 2


def test_read_only_folders_are_named(disk, flame):
    disk.remount("ro")
    for command in (
        ("reconstruct", flame, "--out", disk.path / "out"),
        ("generate", "demo", "--preset", "toy", "--out", disk.path / "data"),
        ("evaluate", disk.path / "none.npz", "--dataset", flame, "--json", disk.path / "x.json"),
    ):
        run = gof(*command)
        assert run.returncode == 1 and "Traceback" not in run.stderr, run.stderr
        assert str(disk.path) in run.stderr


@pytest.mark.blender
def test_generate_on_a_full_disk_keeps_its_folder_and_goes_on(disk, tmp_path):
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    scene_spec.save(TOY, tmp_path / "spec.json")
    disk.remount("size=300k")
    command = ("generate", tmp_path / "spec.json", "--out", disk.path / "data")
    run = gof(*command)
    assert run.returncode == 1 and 'Traceback (most recent call last):\n  File "<frozen' not in run.stderr, run.stderr
    assert str(disk.path) in run.stderr and not (disk.path / "data" / "dataset.json").exists()
    disk.remount("size=200m")
    run = gof(*command)
    assert run.returncode == 0, run.stderr[-2000:]
    assert (disk.path / "data" / "dataset.json").exists()


def test_two_runs_in_one_folder(flame, tmp_path):
    with only_run_in(tmp_path / "out"):
        with pytest.raises(GofError, match=rf"another run is at work there \(process {os.getpid()}\)"):
            reconstruct(flame, tmp_path / "out", iterations=5)
        assert files(tmp_path / "out") == [".lock"]
    reconstruct(flame, tmp_path / "out", iterations=5)


def test_two_generators_in_one_folder(tmp_path):
    scene_spec.save(TOY, tmp_path / "spec.json")
    with only_run_in(tmp_path / "data" / ".cache"):
        scene_spec.save(TOY, tmp_path / "data" / "spec.json")
        run = gof("generate", tmp_path / "spec.json", "--out", tmp_path / "data")
    assert run.returncode == 1 and "another run is at work there" in run.stderr, run.stderr


def test_the_second_of_two_first_generators_claims_nothing(tmp_path):
    """The first holds the folder and has written nothing yet; it was stopped there, and the next run may begin."""
    scene_spec.save(TOY, tmp_path / "spec.json")
    with only_run_in(tmp_path / "data" / ".cache"):
        run = gof("generate", tmp_path / "spec.json", "--out", tmp_path / "data")
        assert run.returncode == 1 and "another run is at work there" in run.stderr, run.stderr
        assert files(tmp_path / "data") == [".lock"]
    with claimed(Layout(tmp_path / "data"), TOY):
        assert (tmp_path / "data" / "spec.json").is_file()


def test_no_lock_is_left_in_a_folder_of_others(tmp_path):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(GofError, match="not empty"), claimed(Layout(tmp_path), TOY):
        pass
    assert files(tmp_path) == ["note.txt"]


def test_the_folder_is_free_again_after_kill_9(tmp_path):
    code = (
        "import os\nfrom pathlib import Path\nfrom gof.core.files import only_run_in\n"
        f"with only_run_in(Path({str(tmp_path)!r})):\n os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -9
    with only_run_in(tmp_path):
        write_json(tmp_path / "a.json", 1)
