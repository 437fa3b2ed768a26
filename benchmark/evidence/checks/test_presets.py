"""The table of presets: a row for each, and costs as `gof generate` and `gof reconstruct` print them."""

import numpy as np
import pytest

from gof.commands.cli import main
from gof.core.ladder import LADDER
from gof.core.time_left import MachineLoad
from gof.dataset import Dataset
from gof.reconstruct import sanity
from gof.reconstruct.methods import METHODS
from gof.reconstruct.shrink import shrink
from gof_benchmark.evidence import presets
from gof_benchmark.generator import machine
from gof_benchmark.scenes import load_scene
from tests.conftest import arc, write_dataset

QUICK = MachineLoad(0.25, 1.0)
FIRE = 1.0, 0.6, 0.15


@pytest.fixture(autouse=True)
def a_machine_that_knows_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(machine, "this_machine", lambda: machine.REFERENCE)
    monkeypatch.setattr(MachineLoad, "measured_now", lambda: QUICK)


@pytest.fixture
def table(capsys):
    """The cells of each row by its preset, under their columns."""
    presets.main([])
    lines = [line.strip("|").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    rows = [dict(zip(presets.COLUMNS, map(str.strip, line), strict=True)) for line in lines if "---" not in line[0]]
    return {cells["preset"].strip("`"): cells for cells in rows[1:]}


def write_shape(folder, preset):
    """Write a dataset with the demo's frames, cameras and pictures at a preset: a block of light that rises."""
    spec = load_scene("demo", preset)
    height, width = spec.picture_px  # the sensor stands upright
    cameras = arc(3, width=width, height=height)
    frames = np.full((spec.clip.frames, 3, height, width, 3), 0.1, np.float32)
    for k, frame in enumerate(frames):
        top = height // 4 + k
        frame[:, top : top + height // 2, width // 4 : -width // 4] = FIRE
    times = np.arange(spec.clip.frames) / spec.clip.fps
    return write_dataset(folder, cameras, frames, np.full((3, height, width, 3), 0.1), times, test_frames=(4,))


def test_every_preset_has_a_row(table):
    assert tuple(table) == LADDER == tuple(presets.PURPOSES)
    assert [name for name, cells in table.items() if "(default)" in " ".join(cells.values())] == ["preview"]
    assert table["full"][presets.COLUMNS[3]] == "30 000, 300 000, 128, 1280"
    assert [cells["benchmark"] for cells in table.values()] == ["-", "3 scenes", "all scenes", "-", "all scenes"]


def test_a_reconstruction_costs_what_the_command_prints(table, tmp_path, monkeypatch, capsys):
    data, out = write_shape(tmp_path / "data", "preview"), tmp_path / "out"
    monkeypatch.setattr(sanity, "window_share", lambda dataset: 1.0)
    words = ["reconstruct", str(data), "--preset", "preview", "--until", "motion", "--out", str(out), "--anyway"]
    assert main(words) == 0
    printed = capsys.readouterr().err
    time = table["preview"]["`gof reconstruct`"]
    memory = table["preview"]["memory, generate; reconstruct"].split("; ")[1]
    assert f"2000 steps: about {time} in all" in printed and f", and {memory} of memory" in printed
    assert time != table["standard"]["`gof reconstruct`"], "otherwise nothing is tested"


def test_a_dataset_costs_what_the_command_prints(table, tmp_path, capsys):
    assert main(["generate", "demo", "--preset", "standard", "--estimate", "--out", str(tmp_path / "data")]) == 0
    printed = capsys.readouterr().out
    memory = table["standard"]["memory, generate; reconstruct"].split("; ")[0]
    assert f"predicted: {table['standard']['`gof generate demo`']} +-" in printed and f" {memory} of memory" in printed


@pytest.mark.parametrize("side", [100, 320])
def test_a_shape_is_that_of_the_dataset(side, tmp_path, monkeypatch):
    """Pictures that are shrunk, too, and a frame that is held out."""
    monkeypatch.setattr(sanity, "window_share", lambda dataset: 1.0)
    dataset = Dataset.open(write_shape(tmp_path / "data", "preview"))
    read = presets.ClipShape.of(shrink(dataset, side), METHODS["gof"])
    assert presets.shape_of(load_scene("demo", "preview"), side) == read
