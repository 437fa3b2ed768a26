"""That a flame is emissive, through every format that is read again: it shines over a bright wall as it did before."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gof.commands.convert import main
from gof.core.errors import DataFormatError
from gof.core.trajectory import Trajectory
from gof.evaluate.image import psnr
from gof.evaluate.scores import UsedOptions
from gof.io.convert import HAZIER
from gof.io.importers import ImportOptions, read_result
from gof.io.into_room import read_room
from gof.render import render
from tests.conftest import arc, random_gaussians
from tests.io import stages

STEP_S, END_S = 0.05, 0.5
WALL = np.array([0.7, 0.6, 0.5])
KEPT_DB = 45.0  # beside what a method misses of the truth, 35 dB at best, this costs 0.4 dB
SAID = ("a.dgs", "a.ftgs.ply", "a")  # which OUT.gof.json says it of
FILES = ("a.npz", "a.ply", "a.4dgs", "a.tsog", *SAID, "a.usdc")


def flame(**changes):
    """150 Gaussians in the colours of fire that come and go within the clip; nothing but a flame is in it."""
    g, rng = random_gaussians(150), np.random.default_rng(0)
    color = rng.uniform(0.4, 1, (150, 1)) * [1.0, 0.6, 0.2]
    life = {"t_mu": rng.uniform(0.1, 0.4, 150), "t_sigma": rng.uniform(0.03, 0.1, 150)}
    values = {"color": color, "opacity": rng.uniform(0.2, 0.7, 150), "dynamic": np.ones(150, bool), "emissive": True}
    return replace(g, **life | values | changes)


def pictures(gaussians, emissive=True):
    """Two times that are frames of the folder too, from two cameras, over the wall, one below the other."""
    found = []
    for time_s in (0.2, 0.35):
        state = replace(gaussians.state_at(time_s), emissive=emissive and gaussians.emissive)
        found += [render(state, camera, time_s, background=WALL)["color"] for camera in arc(2)]
    return np.clip(np.concatenate(found), 0, 1)


def converted(folder, name, *words, **changes):
    """Notes of `gof convert`, and the file."""
    flame(**changes).save(folder / "result.npz", "gof reconstruct made up")
    times = [] if name in ("a.npz", "a.ply") else ["--clip", "0", str(END_S), "--frame-time", str(STEP_S)]
    out = folder / name
    assert main([str(folder / "result.npz"), str(out), "--json", str(folder / "j"), *times, *words]) == 0
    return json.loads((folder / "j").read_text())["notes"], out


@pytest.mark.parametrize("name", FILES)
def test_it_shines_as_before(tmp_path, name):
    if name.endswith("usdc"):
        stages.openusd()
    notes, out = converted(tmp_path, name)
    back = read_result(out)  # with no word on its clock: that stands in the file or beside it
    before = pictures(flame())
    assert psnr(pictures(flame(), emissive=False), before) < 30, "blended it is another flame"
    assert psnr(pictures(back.gaussians), before) > KEPT_DB
    assert (HAZIER in notes) == (name != "a.npz")
    beside = tmp_path / f"{name}.gof.json"
    assert beside.exists() == (name in SAID)
    assert back.method == "gof" or back.flame_only, "drawn over plates"
    if beside.exists():
        beside.unlink()
        clock = ImportOptions(time_unit_s=STEP_S if name == "a" else None)
        assert not read_result(out, clock).gaussians.emissive, "the file itself does not say it"


@pytest.mark.parametrize("name", FILES)
def test_what_blends_goes_on_blending(tmp_path, name):
    if name.endswith("usdc"):
        stages.openusd()
    notes, out = converted(tmp_path, name, emissive=False)
    assert HAZIER not in notes and not (tmp_path / f"{name}.gof.json").exists()
    back = read_result(out, ImportOptions(time_unit_s=STEP_S if name == "a" else None)).gaussians
    assert not back.emissive and psnr(pictures(back), pictures(flame(emissive=False))) > KEPT_DB


def test_what_stands_beside_an_older_file_is_not_taken_for_the_new_ones(tmp_path):
    _, out = converted(tmp_path, "a.dgs")
    with pytest.raises(DataFormatError, match=r"a\.dgs\.gof\.json: exists already"):
        converted(tmp_path, "a.dgs", emissive=False)
    converted(tmp_path, "a.dgs", "--overwrite", emissive=False)
    assert not read_result(out).gaussians.emissive


def test_options_that_are_written_down_leave_it(tmp_path):
    """Another clock is said of a file of ours; that it is emissive no option says, and stays."""
    _, out = converted(tmp_path, "a.dgs")
    assert main([str(out), "--time-zero", "3"]) == 0
    back = read_result(out).gaussians
    assert back.emissive and back.t_mu.min() > 3


def test_a_score_says_how_the_result_was_read():
    assert UsedOptions.of(ImportOptions(emissive=True)).options().emissive
    assert not UsedOptions.of(ImportOptions()).options().emissive


def test_positions_sampled_in_time_may_be_a_flame(tmp_path):
    state = {"position": np.zeros((2, 3, 3)), "opacity": np.ones((2, 3))}
    still = Trajectory(np.arange(2.0), scale=np.ones((3, 3)), rotation=np.ones((3, 4)), emissive=True, **state)
    still.save(tmp_path / "t.npz")
    back = read_result(tmp_path / "t.npz").gaussians
    assert back.emissive and back.state_at(0.5).emissive and back.transformed(np.eye(4)).emissive
    replace(still, emissive=False).save(tmp_path / "u.npz")
    with np.load(tmp_path / "u.npz") as plain, np.load(tmp_path / "t.npz") as whole:
        assert "emissive" not in plain, "which older versions read"
        np.savez(tmp_path / "bad.npz", **{**whole, "emissive": np.ones(3, bool)})
    assert not read_result(tmp_path / "u.npz").gaussians.emissive
    with pytest.raises(DataFormatError, match=r"bad\.npz.*'emissive' is not one bool"):
        read_result(tmp_path / "bad.npz")


def test_a_room_hides_what_is_behind_it(tmp_path):
    """A room's Gaussians are no light, whatever file they stand in; so a flame in a room is blended everywhere."""
    flame(dynamic=np.arange(150) < 100).save(tmp_path / "room.npz", "gof reconstruct made up")
    assert len(read_room(tmp_path / "room.npz")) == 50 and not read_room(tmp_path / "room.npz").emissive
    notes, out = converted(tmp_path, "a.dgs", "--into", str(tmp_path / "room.npz"))
    assert HAZIER not in notes and not (tmp_path / "a.dgs.gof.json").exists()
    assert not read_result(out).gaussians.emissive
