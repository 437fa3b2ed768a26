"""The add-on's own records: what it writes the library reads, and the other way round; files are whole or not there."""

import json
from dataclasses import fields

import pytest

import gof.core.costs
import gof.core.description as library
from gof.core.records import read_record, write_record
from gof_blender.pure import costs, description
from gof_blender.pure.io import FileFormatError
from gof_blender.pure.io.files import atomic_path, write_json

CAMERA = {"name": "cam_0", "width": 8, "height": 6, "K": [[9, 0, 4], [0, 9, 3], [0, 0, 1]]}
POSE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]


def test_a_dataset_goes_both_ways(tmp_path):
    camera = description.CameraEntry(
        **CAMERA, world_to_camera=POSE, roll_deg=90, rgb="a/{frame:06d}.png", time_s=(0.0,)
    )
    ours = description.DatasetDescription(
        "fire",
        (0.0,),
        (camera,),
        description.held_out(1),
        "velocity.zarr",
        {"name": "fire"},
        ("wind",),
        {"by": "a test"},
    )
    ours.write(tmp_path)
    theirs = library.DatasetDescription.read(tmp_path)
    assert (theirs.name, theirs.effects, theirs.velocity, theirs.spec) == (
        "fire",
        ("wind",),
        "velocity.zarr",
        ours.spec,
    )
    assert theirs.cameras[0].camera().K[0, 0] == 9 and theirs.cameras[0].rgb == camera.rgb
    theirs.write(tmp_path)
    again = description.DatasetDescription.read(tmp_path)
    for item in fields(ours):
        if item.name != "cameras":
            assert getattr(again, item.name) == getattr(ours, item.name), item.name
    assert again.cameras[0].time_s == (0.0,) and again.cameras[0].roll_deg == 90


@pytest.mark.parametrize("count", [1, 4, 5, 12, 13, 50])
def test_the_held_out_rule_is_the_librarys(count):
    ours, theirs = description.held_out(count), library.held_out(count)
    assert (ours.train, ours.test) == (tuple(theirs.train), tuple(theirs.test))


def test_costs_go_both_ways(tmp_path):
    path = tmp_path / "costs.json"
    write_record(path, gof.core.costs.Costs((gof.core.costs.StageCost("bake", 1.0, 2.0, {"wall_s": 1.0}),), 3.0))
    ours = costs.Costs.read(path)
    assert ours == costs.Costs((costs.StageCost("bake", 1.0, 2.0, {"wall_s": 1.0}),), 3.0)
    ours.write(path)
    assert read_record(gof.core.costs.Costs, path).stages[0].name == "bake"


@pytest.mark.parametrize(
    "change, message",
    [
        ({"version": 2}, "not schema 'gof-dataset' version 1"),
        ({"name": None}, "name must be a text, got None"),
        ({"time_s": [0.0, "late"]}, r"time_s\[1\] must be a finite number, got 'late'"),
        ({"splits": {"train": [0]}}, "splits.test is missing"),
    ],
)
def test_wrong_fields_are_named_with_file_and_remedy(tmp_path, change, message):
    description.DatasetDescription("fire", (0.0,), (), description.held_out(1)).write(tmp_path)
    file = tmp_path / "dataset.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(FileFormatError, match=rf"dataset\.json: {message}.*; choose the folder of a finished dataset"):
        description.DatasetDescription.read(tmp_path)


def test_fields_of_a_newer_writer_are_left_aside(tmp_path):
    description.DatasetDescription("fire", (0.0,), (), description.held_out(1)).write(tmp_path)
    file = tmp_path / "dataset.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"weather": "fine"}))
    assert description.DatasetDescription.read(tmp_path).name == "fire"


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "new folder" / "a.json"
    write_json(path, {"a": 1})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"a": float("nan")})
    with pytest.raises(RuntimeError), atomic_path(path) as draft:
        draft.write_text("half")
        raise RuntimeError
    assert json.loads(path.read_text()) == {"a": 1}
    assert [found.name for found in path.parent.iterdir()] == ["a.json"]
