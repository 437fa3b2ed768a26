"""`gof sample`: what it unpacks, and that a second call costs nothing and destroys nothing."""

import json
from importlib import resources

import cv2
import numpy as np
import pytest

from gof.commands.cli import main
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.submission import Submission


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample")
    assert main(["sample", str(folder / "here"), "--json", str(folder / "said.json")]) == 0
    assert set(json.loads((folder / "said.json").read_text())) == {"fire", "result", "submission", "clip"}
    return folder / "here"


def test_it_is_small():
    archive = resources.files("gof.sample") / "sample.zip"
    assert len(archive.read_bytes()) <= 7.5e6


def test_the_fire_has_three_cameras_held_out_frames_and_true_velocity(sample):
    fire = Dataset.open(sample / "fire")
    assert len(fire.cameras) == 3 and len(fire.times_s) >= 12 and fire.test_frames
    for camera in range(3):
        for frame in range(len(fire.times_s)):
            assert fire.image(camera, frame).shape == (256, 144, 3)
    field = fire.velocity.at(fire.times_s[3])
    above = field.sample(np.array([[0.0, 0.0, 0.4]]))[0]
    assert above[2] > 0.5, "hot gas rises above the burner"


def test_the_result_and_the_submission_are_read(sample):
    assert TransientGaussians.load(sample / "result/result.npz").dynamic.any()
    submission = Submission.open(sample / "submission")
    assert list(submission.runs) == ["fire"] and (sample / "submission/fire/pictures/cam_0").is_dir()


def test_the_films_are_what_opencv_reads(sample):
    for camera in range(3):
        film = cv2.VideoCapture(str(sample / f"clip/cam_{camera}.mp4"))
        assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 18 and film.get(cv2.CAP_PROP_FPS) == 60
        good, picture = film.read()
        assert good and picture.shape == (512, 288, 3)


def test_a_second_call_finishes_an_interrupted_one_and_touches_nothing_else(sample, tmp_path):
    assert main(["sample", str(tmp_path)]) == 0
    missing, kept = tmp_path / "clip/cam_1.mp4", tmp_path / "fire/dataset.json"
    content, before = missing.read_bytes(), kept.stat().st_mtime_ns
    missing.unlink()
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["sample", str(tmp_path)]) == 0
    assert missing.read_bytes() == content and kept.stat().st_mtime_ns == before
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_a_file_of_somebody_else_is_refused_before_anything_is_written(tmp_path, capsys):
    (tmp_path / "fire").mkdir()
    (tmp_path / "fire/dataset.json").write_text("{}")
    assert main(["sample", str(tmp_path)]) == 1
    assert "fire/dataset.json: is there already" in capsys.readouterr().err
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["dataset.json"]
    assert (tmp_path / "fire/dataset.json").read_text() == "{}"
