"""What was computed from a held-out frame is refused before anything learns from it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gof.dataset import Dataset, Splits
from gof.dataset.leaks import LeakError, MadeFrom, leaks, require_no_leaks
from gof.evaluate import evaluate
from gof.reconstruct.background import BackgroundOptions, make_background
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.settings import ReconstructionSettings
from tests.conftest import random_gaussians
from tests.reconstruct.rising_flame import write_flame


def test_which_files_leak():
    files = {"static/cam_0.png": (0, 1, 2, 4), "poses.json": (0, 2), "points.ply": ()}
    assert leaks(files, [1, 4, 9]) == {"static/cam_0.png": [1, 4]} and leaks(files, []) == {}


pytestmark = pytest.mark.long


@pytest.fixture
def flame(tmp_path):
    """A small dataset of a drawn flame, as it might have been made from videos."""
    return Dataset.open(write_flame(tmp_path / "data", frames=6))


def changed(dataset: Dataset, **fields) -> Dataset:
    replace(dataset.description, **fields).write(dataset.path)
    return Dataset.open(dataset.path)


def settings(dataset: Dataset) -> ReconstructionSettings:
    return ReconstructionSettings(dataset.path.name, 1, 50, 12, 64)


def test_training_refuses_a_plate_that_saw_a_held_out_frame(flame, tmp_path):
    plate = flame.description.cameras[0].static
    every, some = tuple(range(6)), tuple(flame.train_frames)
    assert flame.test_frames, "something is held out"
    fair = changed(flame, made_from={plate: some}, provenance={"plate": "steady"})
    require_no_leaks(fair)
    leaking = changed(flame, made_from={plate: every}, provenance={"plate": "steady"})
    with pytest.raises(LeakError, match=rf"{plate}.*frames \[4\].*held out"):
        reconstruct(leaking, settings(leaking), tmp_path / "out", until="motion")
    with pytest.raises(LeakError, match="held out"):
        make_background(leaking.path, tmp_path / "background", BackgroundOptions(steps=1))
    assert not (tmp_path / "out" / "settings.json").exists(), "nothing was begun"
    # The same files under another split, as an edited dataset.json has them.
    moved = changed(fair, splits=Splits(tuple(k for k in range(6) if k != 1), (1,)))
    with pytest.raises(LeakError, match=r"frames \[1\]"):
        require_no_leaks(moved)


def test_plates_that_do_not_say_what_they_are_from(flame):
    before = changed(flame, provenance={"plate": "minimum"})
    with pytest.raises(LeakError, match="do not say"):
        require_no_leaks(before)
    for honest in ({"plate": "given"}, {"blender": "5.1"}):  # filmed or rendered without fire
        require_no_leaks(changed(flame, provenance=honest))
    require_no_leaks(changed(flame, provenance={"plate": "minimum"}, splits=Splits(tuple(range(6)), ())))


def test_a_reconstruction_says_what_it_learned_from(flame, tmp_path):
    out = tmp_path / "out"
    reconstruct(flame, settings(flame), out, until="seeds")
    made_from = MadeFrom.read(out)
    names = [f"plates/{c.name}.png" for c in flame.cameras]
    assert made_from.files == dict.fromkeys(
        ["seeds.npz", *names, "result.npz", "result.ply"], tuple(flame.train_frames)
    )
    other = changed(flame, splits=Splits((0, 1, 3, 4, 5), (2,)))
    with pytest.raises(LeakError, match=r"seeds\.npz: was made from frames \[2\]"):
        reconstruct(other, settings(other), out, until="seeds")


def test_a_score_says_that_a_result_has_seen_the_frame(flame, tmp_path):
    g = random_gaussians(5)
    g.save(tmp_path / "result.npz")
    MadeFrom.of(["result.npz", "result.ply"], np.arange(6)).write(tmp_path)
    (warning,) = [w for w in evaluate(tmp_path / "result.npz", flame, images=False).warnings if "held out" in w]
    assert "frames [4]" in warning
    MadeFrom.of(["result.npz"], flame.train_frames).write(tmp_path)
    assert not [w for w in evaluate(tmp_path / "result.npz", flame, images=False).warnings if "held out" in w]
    assert json.loads((tmp_path / "made_from.json").read_text())["schema"] == "gof-made-from"
