"""A slice of the fuzz campaign, the injuries themselves, and files made to harm."""

import json
import multiprocessing
import re
import resource
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.io.importers import read_result
from gof.io.importers.alignment import align_cameras, read_cameras
from gof.io.importers.normalisation import world_from_training
from gof_blender.core.checked_json import SpecError
from gof_blender.core.errors import GofError as ErrorOfTheAddOn
from gof_blender.pure.io import cloud as clouds
from gof_blender.pure.spec import SceneSpec
from tests.conftest import arc, random_gaussians
from tests.reliability import damage, fuzz, kill
from tests.reliability.format import finite
from tests.reliability.fuzz import formats

NEED_BLENDER_OR_TORCH = ("pictures .exr", "checkpoint .pth", "4DGS of Yang, cfg_args")


@pytest.mark.long
def test_a_slice_of_the_campaign_has_no_failure():
    names = tuple(name for name in formats() if name not in NEED_BLENDER_OR_TORCH)
    tallies = fuzz.campaign(25 * len(names), seed=2024, only=names)  # `python -m tests.reliability` is the whole one
    assert sum(t.verdicts.total() for t in tallies) > 24 * len(names)
    assert not [(t.format, *failure) for t in tallies for failure in t.failures]
    assert all(t.verdicts["refused"] for t in tallies), "the damage is too small"


@pytest.mark.parametrize("name", ["result .npz", "velocity.zarr", "scene spec"])
def test_an_input_is_the_same_again(tmp_path, name):
    formats()[name].write(tmp_path)
    files = formats()[name].files(tmp_path)
    file = fuzz.injury(name, files, 1, 17)
    assert file == fuzz.injury(name, files, 1, 17) != fuzz.injury(name, files, 1, 18)
    assert file[1] != file[0].read_bytes()


def test_a_campaign_that_was_ended_goes_on_and_counts_the_same(tmp_path, monkeypatch):
    """Verdicts of a stand-in for the reader: even numbers pass, the seventh fails."""
    done = []

    def work(format_name, seed, numbers, connection):
        connection.send("ready")
        for number in numbers:
            done.append(number)
            connection.send(("exception", "said") if number == 7 else ("accepted" if number % 2 else "refused", ""))

    monkeypatch.setattr(fuzz, "work", work)
    monkeypatch.setattr(fuzz, "STEP", 4)
    fork = multiprocessing.get_context("fork")
    monkeypatch.setattr(fuzz.multiprocessing, "get_context", lambda kind: fork)
    at_once = fuzz.examine("scene spec", 0, range(20))
    progress = tmp_path / "progress.json"
    fuzz.examine("scene spec", 0, range(10), progress)
    assert fuzz.examine("scene spec", 0, range(20), progress) == at_once
    assert fuzz.examine("scene spec", 0, range(20), progress) == at_once, "nothing is left to do"
    assert at_once.verdicts == {"accepted": 9, "refused": 10, "exception": 1} and at_once.failures[0][0] == 7
    with pytest.raises(RuntimeError, match="another campaign"):
        fuzz.examine("scene spec", 1, range(20), progress)


def test_a_pipe_or_a_link_stands_in_place_of_a_file_and_goes_again(tmp_path):
    victim, file = tmp_path / "victim", tmp_path / "a.png"
    victim.write_bytes(b"precious")
    file.write_bytes(b"good")
    for content, seen in (
        (damage.Instead("link", "victim"), Path.is_symlink),
        (damage.Instead("pipe"), Path.is_fifo),
        (damage.Instead("folder"), Path.is_dir),
        (damage.Instead("nothing"), lambda path: not path.exists()),
    ):
        damage.put(file, content, tmp_path)
        assert seen(file)
        damage.put(file, b"good", tmp_path)
        assert file.read_bytes() == b"good" and not file.is_symlink() and victim.read_bytes() == b"precious"


@pytest.mark.long
def test_rigs_that_cannot_be_have_faults_and_the_good_one_has_none(tmp_path):
    """Thirty of `malice.impossible`; accepting one is the campaign's failure "believed"."""
    form = formats()["a rig that cannot be"]
    form.write(tmp_path)
    assert fuzz.verdict("a rig that cannot be", tmp_path) == ("accepted", "") and not form.believed
    for number in range(30):
        file, content = fuzz.injury("a rig that cannot be", form.files(tmp_path), 0, number)
        good = file.read_bytes()
        file.write_bytes(content)
        assert fuzz.verdict("a rig that cannot be", tmp_path)[0] == "refused", (number, content[:300])
        file.write_bytes(good)


@pytest.mark.long
def test_hangs_crashes_and_greed_are_failures(monkeypatch):
    """Readers that go wrong on purpose, in place of one that does not."""
    monkeypatch.setattr(fuzz, "LIMIT_S", 0.5)
    for word, state in (
        ("hang", "hang"),
        ("crash", "crash"),
        ("greed", "memory"),
        ("nan", "not finite"),
        ("value", "exception"),
        ("mute", "unnamed"),
    ):
        monkeypatch.setattr(fuzz, "work", Misbehaving(word))
        tally = fuzz.examine("scene spec", 0, range(1))
        assert tally.verdicts == {state: 1}, word


class Misbehaving:
    """Like fuzz.work, but with a reader that misbehaves; picklable for a new process."""

    def __init__(self, word):
        self.word = word

    def __call__(self, format_name, seed, numbers, connection):
        import os
        import signal
        import time

        def read(folder):
            match self.word:
                case "hang":
                    time.sleep(60)
                case "crash":
                    os.kill(os.getpid(), signal.SIGSEGV)
                case "greed":
                    return np.zeros(10**12)
                case "nan":
                    return {"x": np.array([1.0, np.nan])}
                case "value":
                    raise ValueError("x")
                case "mute":
                    raise GofError("no")

        form = fuzz.formats()["scene spec"]
        fuzz.formats = lambda: {"scene spec": type(form)(form.write, read)}
        connection.send("ready")
        for _ in numbers:
            connection.send(fuzz.verdict("scene spec", fuzz.Path("/nowhere")))


def test_an_infinite_lifetime_or_uncertainty_is_finite_and_nothing_else_is():
    g = random_gaussians(4)
    g.t_sigma[:] = np.inf
    assert np.isinf(g.velocity_sd).all()
    assert finite(g)
    g.velocity[0, 0] = np.inf
    assert not finite(g) and not finite([{"a": (1.0, float("nan"))}])


# ---------------------------------------------------------------- made to harm


def allocated(action) -> int:
    """Peak bytes that Python and numpy ask for meanwhile."""
    tracemalloc.start()
    try:
        action()
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return peak


def npz_with(path, name: str, header: dict, body: bytes, compression=zipfile.ZIP_STORED):
    """A result whose array `name` has this header and content."""
    with np.load(random_gaussians(3).save(path)) as good:
        arrays = dict(good)
    arrays.pop(name)
    np.savez(path, **arrays)
    with zipfile.ZipFile(path, "a", compression) as archive, archive.open(f"{name}.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"fortran_order": False} | header)
        for _ in range(0, max(len(body), 1), 2**20):
            file.write(body)
    return path


def readers(path):
    """Both readers of a result, and the error that each names."""
    return (
        (lambda: TransientGaussians.load(path), GofError),
        (lambda: read_result(path), GofError),
        (lambda: clouds.load(path), ErrorOfTheAddOn),
    )


@pytest.mark.parametrize("shape", [(10**18, 3), (2**28, 3), (2**63, 2**63)])
def test_an_npz_that_announces_too_much_is_refused_unread(tmp_path, shape):
    path = npz_with(tmp_path / "r.npz", "x0", {"descr": "<f4", "shape": shape}, bytes(36))
    for read, error in readers(path):

        def refused(read=read, error=error):
            with pytest.raises(error, match=r"r\.npz"):
                read()

        assert allocated(refused) < 2**24


@pytest.mark.long
def test_a_zip_bomb_is_refused_unread(tmp_path):
    path = tmp_path / "r.npz"
    with np.load(random_gaussians(3).save(path)) as good:
        arrays = dict(good)
    np.savez(path, **arrays)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("bomb.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": (2**26,)})
        for _ in range(256):
            file.write(bytes(2**20))
    assert path.stat().st_size < 2**20
    for read, error in readers(path):

        def refused(read=read, error=error):
            with pytest.raises(error, match="unpacks to|packed more tightly"):
                read()

        assert allocated(refused) < 2**24


def test_pickles_are_never_run_by_any_reader(tmp_path):
    class Evil:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    np.savez(tmp_path / "evil.npz", schema=np.array("gof-linear/1"), x0=np.array([Evil()], dtype=object))
    for read, error in readers(tmp_path / "evil.npz"):
        with pytest.raises(error):
            read()
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "element",
    [
        b"element vertex 1000000000000000000",
        b"element vertex -1",
        b"element vertex x",
        b"element face 1000000000000000000\nproperty list uchar int i\nelement vertex 3",
    ],
)
def test_a_ply_header_that_announces_too_much_is_refused_unread(tmp_path, element):
    path = random_gaussians(3).save(tmp_path / "r.ply")
    path.write_bytes(path.read_bytes().replace(b"element vertex 3", element))

    def refused():
        with pytest.raises(DataFormatError, match="announces|is no line of a PLY header"):
            TransientGaussians.load(path)

    assert allocated(refused) < 2**24


@pytest.mark.parametrize(
    "name",
    [
        "../../etc/{frame:06d}.png",
        "/etc/passwd",
        "a\0b",
        "x" * 5000,
        "{frame:0999999999d}.png",
        "{other}",
        "{frame.real}",
    ],
)
def test_picture_names_from_strangers(tiny_dataset, name):
    meta = json.loads((tiny_dataset / "dataset.json").read_text())
    meta["cameras"][0]["rgb"] = name
    (tiny_dataset / "dataset.json").write_text(json.dumps(meta))
    with pytest.raises(DataFormatError, match=r"dataset\.json.*cannot be the name of a file"):
        Dataset.open(tiny_dataset)


def test_the_velocity_store_may_not_leave_the_dataset(tiny_dataset):
    meta = json.loads((tiny_dataset / "dataset.json").read_text())
    (tiny_dataset / "dataset.json").write_text(json.dumps(meta | {"velocity": "../other.zarr"}))
    with pytest.raises(DataFormatError, match="velocity"):
        Dataset.open(tiny_dataset)


@pytest.mark.parametrize(
    "fields",
    [
        {"time_s": ["a"]},
        {"time_s": [0.0, float("nan"), 1, 2]},
        {"cameras": ["x"]},
        {"splits": 3},
        {"splits": {"train": ["a"], "test": []}},
        {"velocity": 7},
        {"cameras": "twice"},
    ],
)
def test_wrong_types_in_dataset_json_are_named(tiny_dataset, fields):
    meta = json.loads((tiny_dataset / "dataset.json").read_text())
    if fields == {"cameras": "twice"}:
        fields = {"cameras": meta["cameras"][:1] * 2}
    (tiny_dataset / "dataset.json").write_text(json.dumps(meta | fields))
    with pytest.raises(DataFormatError, match=re.escape(str(tiny_dataset))):
        _ = Dataset.open(tiny_dataset).velocity


@pytest.mark.parametrize(
    "change",
    [
        {"shape": [4, 10**18, 5, 6, 3]},
        {"shape": [10**400, 4, 5, 6, 3]},
        {"data_type": "int32"},
        {"attributes": []},
        {  # two kilobytes of JSON that name 27 million chunks a frame
            "shape": [4, 300, 300, 300, 3],
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1, 1, 1, 1, 3]}},
        },
    ],
)
def test_absurd_velocity_stores_are_refused_unread(tiny_dataset, change):
    file = tiny_dataset / "velocity.zarr" / "zarr.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))

    def refused():
        with pytest.raises(DataFormatError, match=r"velocity\.zarr"):
            Dataset.open(tiny_dataset).velocity.frame(0)

    allocated(refused)
    assert allocated(refused) < 2**24


def test_numbers_of_thousands_of_digits_and_brackets_without_end(tiny_dataset):
    for text in ("9" * 5000, "[" * 100_000):
        (tiny_dataset / "dataset.json").write_text(text)
        with pytest.raises(DataFormatError, match="not valid JSON"):
            Dataset.open(tiny_dataset)


def test_cameras_that_are_none(tmp_path):
    target = {c.name: c.world_to_camera for c in arc(2)}
    for bad in (np.zeros((4, 4)), np.diag([1.0, 1, -1, 1])):
        (tmp_path / "poses.json").write_text(json.dumps({name: bad.tolist() for name in target}))
        with pytest.raises(DataFormatError, match="not a rotation"):
            read_cameras(tmp_path / "poses.json")
    far = {
        name: pose + np.array([[0, 0, 0, 1e300 * k]] * 3 + [[0, 0, 0, 0]])
        for k, (name, pose) in enumerate(target.items())
    }
    with pytest.raises(GofError, match="alignment"):
        align_cameras(far, target)
    (tmp_path / "world.json").write_text('{"training_to_world": [[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}')
    with pytest.raises(DataFormatError, match="NaN"):
        world_from_training(tmp_path / "world.json", None, np.zeros((3, 3)))


@pytest.mark.parametrize("clip", [{"frames": 10**18}, {"warm_up_frames": 10**18}])
def test_a_scene_without_end_is_refused_at_once(clip):
    with pytest.raises(SpecError, match=f"clip.{next(iter(clip))}"):
        SceneSpec.from_dict(
            {"schema": "gof-scene", "version": 1, "name": "x", "clip": clip, "effects": [{"name": "motion_blur"}]}
        )


def test_kill_sees_what_was_rewritten_lost_or_spoilt(tmp_path):
    command, outcome = kill.ResumableCommand("x", (), ("*.json",)), kill.Outcome("x")
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.json").write_text("{}")
    truth = command.files(tmp_path)
    (tmp_path / "a.json").unlink()
    (tmp_path / "b.json").write_text("{} ")
    kill.compare(command, tmp_path, truth, truth, outcome)
    assert [len(x) for x in (outcome.lost, outcome.rewritten, outcome.spoilt)] == [1, 1, 1] and outcome.kept == 3


def test_every_injury_changes_something():
    rng = np.random.default_rng(0)
    data = bytes(range(256)) * 4
    assert sum(damage.raw(data, rng) != data for _ in range(200)) > 190
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY, "limits stay in the workers"


@pytest.mark.parametrize("text", ["[" * 100_000, "9" * 5000, '{"schema": "\\udcff"}', '{"name": "\\ud800x"}'])
def test_specs_of_endless_brackets_numbers_and_halves_of_characters_are_refused(tmp_path, text):
    from gof.core.files import read_json
    from gof_blender.pure import spec

    path = tmp_path / "spec.json"
    path.write_text(text)
    with pytest.raises(SpecError, match=r"spec\.json"):
        spec.load(path)
    with pytest.raises(DataFormatError, match=r"spec\.json"):
        read_json(path)


def test_whole_characters_in_two_halves_are_text(tmp_path):
    from gof.core.files import read_json

    (tmp_path / "a.json").write_text('["\\ud83d\\udd25"]')
    assert read_json(tmp_path / "a.json") == ["\U0001f525"]


def test_the_campaign_sees_a_name_that_escapes(tmp_path, monkeypatch):
    """With the checks taken out, the first of the reports' attacks is a failure of the campaign."""
    form = formats()["names in dataset.json"]
    form.write(tmp_path)
    file = tmp_path / "dataset" / "dataset.json"
    file.write_text(file.read_text().replace('"cam_0"', '"../../../gof-escaped"'))
    with pytest.raises(GofError, match="plain name"):
        form.read(tmp_path)
    monkeypatch.setattr("gof.core.cameras.is_name", lambda name: True)
    monkeypatch.setattr("gof.dataset.plates.path_in", lambda folder, name: folder / name)
    with pytest.raises(AssertionError, match="outside"):
        form.read(tmp_path)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_records_hold_finite_numbers(tmp_path, number):
    from gof.core.costs import StageLog

    log = StageLog(tmp_path / "costs.json")
    log.record("stage", 1.5, 2.0, {"cells": [3.0]})
    good = (tmp_path / "costs.json").read_text()
    assert "1.5" in good and "3.0" in good
    for before in ("1.5", "3.0"):
        (tmp_path / "costs.json").write_text(good.replace(before, number))
        with pytest.raises(DataFormatError, match=r"costs\.json: .*is NaN, Inf"):
            log.costs()


@pytest.mark.parametrize("encoding", ["x", 1.5, {"configuration": 3}, []])
def test_a_store_with_other_chunk_keys_is_named(tmp_path, encoding):
    from gof.core.fields import VelocitySequence

    formats()["velocity.zarr, at points"].write(tmp_path)
    file = tmp_path / "velocity.zarr" / "zarr.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"chunk_key_encoding": encoding}))
    with pytest.raises(DataFormatError, match=r"velocity\.zarr"):
        VelocitySequence.open(tmp_path / "velocity.zarr")
