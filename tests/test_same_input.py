"""A result belongs to its input: what is resumed was begun with the same dataset and options, or is refused."""

import json
import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.commands.background import main as background
from gof.commands.reconstruct import main as reconstruct
from gof.core.errors import GofError
from gof.core.files import read_json
from gof.dataset import Dataset
from gof.reconstruct.curve import CurveLog, HeldOutScores
from gof.reconstruct.presets import Effort
from gof.reconstruct.settings import ReconstructionSettings
from tests.conftest import arc, random_gaussians, write_dataset

EFFORT = Effort(10, 20, 30, 40)


@pytest.fixture
def dataset(tmp_path) -> Path:
    images = np.random.default_rng(0).random((4, 2, 64, 36, 3))
    return write_dataset(tmp_path / "d", arc(2), images, images[0], 0.01 * np.arange(4), test_frames=[2])


def change_description(dataset: Path):
    file = dataset / "dataset.json"
    data = json.loads(file.read_text())
    data["time_s"][-1] += 0.001
    file.write_text(json.dumps(data))


def change_picture(dataset: Path):
    cv2.imwrite(str(dataset / "cameras/cam_1/rgb/000003.png"), np.zeros((64, 36, 3)))


def touch_picture(dataset: Path):
    """Other pixels in as many bytes, as a renderer may write them."""
    os.utime(dataset / "static/cam_0.png", ns=(1, 1))


def lose_picture(dataset: Path):
    (dataset / "cameras/cam_0/rgb/000001.png").unlink()


@pytest.mark.parametrize("change", [change_description, change_picture, touch_picture, lose_picture])
def test_settings_know_the_dataset_by_its_content(dataset, tmp_path, change):
    before = ReconstructionSettings.of(Dataset.open(dataset), EFFORT)
    assert before == ReconstructionSettings.of(Dataset.open(dataset), EFFORT)
    before.claim(tmp_path / "out")
    change(dataset)
    after = ReconstructionSettings.of(Dataset.open(dataset), EFFORT)
    with pytest.raises(GofError, match=r"other settings \(dataset differ"):
        after.claim(tmp_path / "out")


def test_a_moved_dataset_is_the_same(dataset, tmp_path):
    before = ReconstructionSettings.of(Dataset.open(dataset), EFFORT)
    dataset.rename(tmp_path / "elsewhere")
    assert ReconstructionSettings.of(Dataset.open(tmp_path / "elsewhere"), EFFORT) == before


def test_a_finished_result_of_another_dataset_is_not_returned(dataset, tmp_path, capsys):
    """Two datasets of one folder name, as every `gof demo` makes: the second reconstruction is refused at once."""
    out, options = tmp_path / "out", ["--gaussians", "20", "--steps", "10", "--voxels", "30"]
    settings = ReconstructionSettings.of(Dataset.open(dataset), Effort(10, 20, 30, 320))
    out.mkdir()
    settings.claim(out)
    for name in ("result.npz", "result.ply"):
        random_gaussians(5).save(out / name)
    CurveLog(out, resumed_s=None).add(10, HeldOutScores)
    assert reconstruct([str(dataset), "--out", str(out), *options]) == 0, "its own result is found"
    change_picture(dataset)
    with pytest.raises(GofError, match="dataset differ"):
        reconstruct([str(dataset), "--out", str(out), *options])


def test_weights_belong_to_the_settings(dataset, tmp_path):
    weights = tmp_path / "memfof"
    weights.mkdir()
    (weights / "config.json").write_text("{}")
    opened = Dataset.open(dataset)
    before = ReconstructionSettings.of(opened, EFFORT, flow="memfof", flow_weights=weights)
    assert before != ReconstructionSettings.of(opened, EFFORT, flow="memfof")
    (weights / "model.safetensors").write_bytes(b"other")
    after = ReconstructionSettings.of(opened, EFFORT, flow="memfof", flow_weights=weights)
    before.claim(tmp_path / "out")
    with pytest.raises(GofError, match="--flow-weights differ"):
        after.claim(tmp_path / "out")
    assert str(tmp_path) not in (tmp_path / "out" / "settings.json").read_text()


def test_the_learned_prior_belongs_to_the_settings(dataset, tmp_path, monkeypatch):
    """A half-finished reconstruction does not go on with weights that another version of gof ships."""
    opened = Dataset.open(dataset)
    before = ReconstructionSettings.of(opened, EFFORT)
    other = tmp_path / "prior.npz"
    other.write_bytes(b"other weights")
    monkeypatch.setattr("gof.reconstruct.settings.WEIGHTS", other)
    before.claim(tmp_path / "out")
    with pytest.raises(GofError, match="flow_prior_weights differ"):
        ReconstructionSettings.of(opened, EFFORT).claim(tmp_path / "out")
    unused = ReconstructionSettings.of(opened, EFFORT, flow_prior=False)
    assert unused.flow_prior_weights is None


def test_a_background_of_another_dataset_or_with_other_options_is_not_returned(dataset, tmp_path):
    from gof.reconstruct.background import BackgroundOptions, BackgroundSettings

    out = tmp_path / "out"
    options = BackgroundOptions(steps=7)
    BackgroundSettings.of(Dataset.open(dataset), options).claim(out)
    random_gaussians(5).save(out / "background.npz")
    assert background([str(dataset), "--out", str(out), "--steps", "7"]) == 0, "its own result is found"
    with pytest.raises(GofError, match="steps differ"):
        background([str(dataset), "--out", str(out), "--steps", "8"])
    change_picture(dataset)
    with pytest.raises(GofError, match="dataset differ"):
        background([str(dataset), "--out", str(out), "--steps", "7"])


def test_overwrite_replaces_a_background_of_other_options(dataset, tmp_path):
    out = tmp_path / "out"
    (dataset / "depth").mkdir()
    for camera in Dataset.open(dataset).cameras:
        np.save(dataset / f"depth/{camera.name}.npy", np.full((camera.height, camera.width), 2.0))
    words = [str(dataset), "--out", str(out), "--gaussians", "40"]
    background([*words, "--steps", "7"])
    (out / "notes.txt").write_text("mine")
    with pytest.raises(GofError, match="--steps differ.*--overwrite"):
        background([*words, "--steps", "8"])
    background([*words, "--steps", "8", "--overwrite"])
    assert read_json(out / "background.json")["steps"] == 8 and (out / "notes.txt").exists()
    (out / "background.npz").unlink()  # as a run leaves it that was stopped
    background([*words, "--steps", "7"])
    assert read_json(out / "background.json")["steps"] == 7


def test_a_background_of_an_older_version_is_not_returned(dataset, tmp_path):
    random_gaussians(5).save(tmp_path / "out" / "background.npz")
    with pytest.raises(GofError, match="choose another --out"):
        background([str(dataset), "--out", str(tmp_path / "out")])


def test_the_row_of_a_study_belongs_to_its_settings(dataset, tmp_path, monkeypatch):
    """A study that is run again with another preset does not show the rows of the first."""
    from gof_benchmark.studies import variants

    started = []

    def no_worker(command, title, log=None, after_s=0.0):
        started.append(command)
        raise GofError("stopped here")

    monkeypatch.setattr(variants, "run_worker", no_worker)
    study = variants.VariantStudy(dataset, tmp_path / "study")
    row = {"name": "full", "seconds": 1.0}
    variants.write_row(study, Dataset.open(dataset), "full", {"iterations": 5}, row)
    assert variants.run_one(study, Dataset.open(dataset), "full", {"iterations": 5}) == row and not started
    for change in (lambda: None, lambda: change_picture(dataset)):
        change()
        with pytest.raises(GofError, match="stopped here"):
            variants.run_one(study, Dataset.open(dataset), "full", {"iterations": 6})
    assert len(started) == 2


@pytest.mark.parametrize(
    ("option", "value"),
    [("gaussians", 0), ("gaussians", -1), ("steps", 0), ("voxels", 0), ("max-size", 0), ("seed", -1)],
)
def test_options_out_of_range_are_named(dataset, tmp_path, option, value):
    with pytest.raises(GofError, match=f"--{option}"):
        reconstruct([str(dataset), "--out", str(tmp_path / "out"), f"--{option}", str(value)])
    assert not (tmp_path / "out").exists()


def test_settings_are_equal_field_by_field(tmp_path):
    settings = ReconstructionSettings("x", 10, 20, 30, 40)
    settings.claim(tmp_path)
    with pytest.raises(GofError, match="seed differ"):
        replace(settings, seed=1).claim(tmp_path)


# ---------------------------------------------------------------- the demo


def test_a_demo_belongs_to_its_scene_and_its_options(tmp_path, monkeypatch):
    from gof_benchmark.commands import demo

    def no_worker(command, title, log=None, after_s=0.0):
        raise GofError("stopped here")

    monkeypatch.setattr(demo, "run_worker", no_worker)
    options = ["--out", str(tmp_path), "--preset", "toy"]
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "spec.json").write_text("{}")
    with pytest.raises(GofError, match="older version"):
        demo.main(options)
    (tmp_path / "dataset" / "spec.json").unlink()
    with pytest.raises(GofError, match="stopped here"):
        demo.main(options)
    for other, words in ((["--gaussians", "7"], "gaussians differ"), (["--preset", "preview"], "scene differ")):
        with pytest.raises(GofError, match=words):
            demo.main([*options, *other])
    with pytest.raises(GofError, match="stopped here"):
        demo.main(options)


def test_a_stage_is_finished_when_it_is_younger_than_what_it_is_made_from(tmp_path):
    from gof_benchmark.commands.demo import Stage

    source, result, picture = (tmp_path / name for name in ("a", "b", "c"))
    stage = Stage("x", [], [source], [result, picture])
    for path, time_ns in ((source, 1000), (result, 2000), (picture, 1000)):
        assert not stage.finished
        path.write_text("")
        os.utime(path, ns=(time_ns, time_ns))
    assert stage.finished
    os.utime(source, ns=(1500, 1500))
    assert not stage.finished
