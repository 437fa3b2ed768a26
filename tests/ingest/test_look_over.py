"""`gof capture check-footage` on films whose faults were put into them."""

import json

import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.footage.videos import read_info
from gof.ingest import look_over
from gof.ingest.look_over import _angle, _flame, _speed, of_camera
from gof.ingest.over_time import darkest
from tests.conftest import look_at
from tests.ingest.scene import FOCAL, HEIGHT, WIDTH, draw
from tests.ingest.test_moving_cameras import COUNT, drift, filmed, shaken
from tests.videos import write_video


@pytest.fixture(autouse=True)
def few_pairs(monkeypatch):
    monkeypatch.setattr(look_over, "PAIRS", 12)


def verdicts(path) -> dict:
    return {finding.about: finding.verdict for finding in of_camera(read_info(path))[0]}


def speed(path) -> float:
    return next(f.figure for f in of_camera(read_info(path))[0] if f.about == "rate")


def test_a_camera_that_shakes_or_drifts_is_told_from_one_that_stands(tmp_path):
    still = verdicts(write_video(tmp_path / "still.mp4", filmed()))
    assert still["shake"] == still["light"] == still["times"] == "good" and "repeats" not in still
    moved = verdicts(write_video(tmp_path / "moved.mp4", filmed(shaken("shifts", 0.7))))
    assert moved["shake"] in ("look", "bad") and moved["light"] == "good"
    as_filmed, in_hands = (speed(path) for path in (tmp_path / "still.mp4", tmp_path / "moved.mp4"))
    assert in_hands == pytest.approx(as_filmed, abs=0.03), "a hand's moves are not the flame's"
    far = np.tile(np.eye(3), (COUNT, 1, 1))
    far[8:, 0, 2] = 12
    found = {f.about: f for f in of_camera(read_info(write_video(tmp_path / "far.mp4", filmed(far))))[0]}
    assert found["shake"].verdict == "bad" and "tripod" in found["shake"].remedy
    drifting = verdicts(write_video(tmp_path / "drift.mp4", filmed(gains=drift(0.2))))
    assert drifting["light"] == "look" and drifting["shake"] == "good"


def test_a_film_without_fire_and_one_that_repeats(tmp_path):
    plate = darkest(filmed())
    noisy = [plate + np.random.default_rng(k).integers(0, 4, plate.shape, np.uint8) for k in range(12)]
    none = {f.about: f for f in of_camera(read_info(write_video(tmp_path / "none.mp4", noisy)))[0]}
    assert none["flame"].verdict == "bad" and "no flame is seen" in none["flame"].words
    clip = list(filmed())
    clip.insert(7, clip[6])
    assert verdicts(write_video(tmp_path / "twice.mp4", clip))["repeats"] == "look"


def square(count: int, step: int, level=(255, 140, 30), width: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """(N, 100, 200, 3) uint8: a patterned orange square that goes right by `step` px a frame, and where it is."""
    pattern = np.random.default_rng(0).uniform(0.3, 1, (40, width))
    frames, masks = np.zeros((count, 100, 200, 3), np.uint8) + 20, np.zeros((count, 100, 200), bool)
    for k in range(count):
        x = (k * step) % (200 - width)
        frames[k, 30:70, x : x + width] = np.rint(pattern[..., None] * level)
        masks[k, 30:70, x : x + width] = True
    return frames, masks


def test_a_flame_that_moves_too_far_between_frames():
    numbers = np.arange(12)
    for step, verdict in ((0, "good"), (30, "bad")):
        frames, masks = square(12, step)
        assert _speed(frames, masks, frames[0] * 0 + 20, numbers, "a").verdict == verdict, step


def test_exposure_size_edge_and_plate():
    frames, masks = square(12, 12)
    plate = np.zeros_like(frames[0]) + np.uint8(20)
    found = {f.about: f for f in _flame(frames, masks, plate, "a")}
    assert found["exposure"].figure == 0 and found["plate"].verdict == "good"
    assert found["frame"].figure == pytest.approx(1 / 12, abs=1e-4), "its first frame touches the left side"
    assert found["size"].figure == pytest.approx(-148 / 200), "columns 12 to 159 have it in two frames or more"
    white = np.where(masks[..., None], np.uint8(255), frames)
    assert next(f for f in _flame(white, masks, plate, "a") if f.about == "exposure").figure == 1
    held, mask = square(12, 0)
    hides = {f.about: f for f in _flame(held, mask, darkest(held), "a")}
    assert hides["plate"].verdict == "good", "what never changes is not known to be fire"


def seen_from(*degrees: float) -> list[np.ndarray]:
    """Plates of the drawn scene, by cameras at these angles around it."""
    places = [(3 * np.sin(a), -3 * np.cos(a), 0.9) for a in np.deg2rad(degrees)]
    return [draw(look_at("a", place, (0, 0, 0.6), WIDTH, HEIGHT, FOCAL))[0] for place in places]


def test_cameras_too_far_apart_and_a_bare_wall_are_told_apart():
    names = ["a", "b", "c"]
    near = _angle(seen_from(-12, 0, 12), names)
    far = _angle(seen_from(-12, 0, 90), names)
    assert near.verdict == "good" and near.figure < 10 * far.figure < 0
    assert far.verdict != "good" and "and c see" in far.words and "10 degrees apart" in far.remedy
    bare = [np.full((HEIGHT, WIDTH, 3), 90, np.uint8), *seen_from(0)]
    wall = _angle(bare, names[:2])
    assert wall.verdict == "bad" and "hardly any pattern" in wall.words and "all over the picture" in wall.remedy


def test_the_command_prints_remedies_writes_figures_and_fails(tmp_path, capsys):
    moved = np.tile(np.eye(3), (30, 1, 1))
    moved[8:, 0, 2] = 12
    videos = [
        write_video(tmp_path / "a.mp4", filmed(count=30)),
        write_video(tmp_path / "b.mp4", filmed(moved, count=30)),
    ]
    status = gof(["capture", "check-footage", *map(str, videos), "--json", str(tmp_path / "found.json")])
    said = capsys.readouterr().out
    assert status == 1 and "a.mp4" in said and "tripod" in said and "together" in said
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["verdict"] == "bad"
    by = {(f["camera"], f["about"]): f for f in found["findings"]}
    assert by["b.mp4", "shake"]["verdict"] == "bad" and by["a.mp4", "shake"]["verdict"] == "good"
    assert by["", "sync"]["verdict"] in ("good", "look"), "one flame, seen by two"
    assert gof(["capture", "check-footage", str(tmp_path / "none.mp4")]) == 1
    assert "no such video" in capsys.readouterr().err
