"""The dataset reader: what it gives, and what it says when a folder is wrong."""

import json
from pathlib import Path

import numpy as np
import pytest

from gof.commands.capture_annotate import AnnotateConfig
from gof.commands.depth import DepthConfig
from gof.commands.read import read_options
from gof.commands.reconstruct import ReconstructConfig
from gof.core.errors import DataFormatError
from gof.dataset import Dataset, open_dataset
from gof.dataset.plates import background, save_plates


def change(folder, **fields):
    path = folder / "dataset.json"
    meta = json.loads(path.read_text()) | fields
    path.write_text(json.dumps({k: v for k, v in meta.items() if v is not None}))


def test_reading(tiny_dataset):
    d = Dataset.open(tiny_dataset)
    assert [c.name for c in d.cameras] == ["cam_0", "cam_1"]
    assert (d.train_frames, d.test_frames) == ([0, 1, 3], [2])
    assert d.frame_time_s == pytest.approx(0.01)
    image = d.image(1, 3)
    assert image.shape == (64, 36, 3) and image.dtype == np.float32 and 0 <= image.min() and image.max() <= 1
    expected = np.random.default_rng(0).random((4, 2, 64, 36, 3))
    np.testing.assert_allclose(image, expected[3, 1], atol=0.5 / 255 + 1e-6)
    assert set(np.unique(d.mask(0, 0))) == {0, 1}
    np.testing.assert_allclose(d.velocity.at(0.02).sample(np.array([[0, 0, 1.0]])), 1.0)


@pytest.mark.parametrize(
    "fields, error",
    [
        ({"schema": "else"}, "schema"),
        ({"version": 3}, "version 1"),
        ({"time_s": None}, "time_s"),
        ({"time_s": [0, 0, 1, 2]}, "increasing"),
        ({"splits": {"train": [0], "test": [9]}}, "splits.test"),
        ({"cameras": []}, "no camera"),
        ({"cameras": [{"name": "a"}]}, "width"),
    ],
)
def test_wrong_metadata_is_named(tiny_dataset, fields, error):
    change(tiny_dataset, **fields)
    with pytest.raises(DataFormatError, match=error):
        Dataset.open(tiny_dataset)


def _swap(change):
    """A change of the first camera's fields."""
    return lambda meta: meta["cameras"][0].update(change(meta["cameras"][0]))


CANNOT_BE = {
    "a frame in both splits": (lambda meta: meta["splits"].update(train=[0, 1, 2], test=[2]), "splits"),
    "a frame twice": (lambda meta: meta["splits"].update(train=[0, 1, 1]), "splits.train"),
    "frames out of order": (lambda meta: meta["splits"].update(train=[1, 0]), "splits.train"),
    "a frame there is not": (lambda meta: meta["splits"].update(test=[4]), "splits.test"),
    "K[1][0]": (_swap(lambda c: {"K": [c["K"][0], [7, *c["K"][1][1:]], c["K"][2]]}), "K"),
    "K[2][0]": (_swap(lambda c: {"K": [*c["K"][:2], [1, 0, 1]]}), "K"),
    "K[2][2]": (_swap(lambda c: {"K": [*c["K"][:2], [0, 0, 2]]}), "K"),
    "a pose's last row": (
        _swap(lambda c: {"world_to_camera": [*c["world_to_camera"][:3], [0, 0, 1, 1]]}),
        "world",
    ),
    "a bent lens": (_swap(lambda c: {"distortion": [0.1, 0, 0, 0]}), "'cam_0' has distortion.*undistort"),
    "another program's coefficient": (_swap(lambda c: {"k1": -0.2}), "has k1"),
    "a fisheye": (_swap(lambda c: {"camera_model": "OPENCV_FISHEYE"}), "camera_model OPENCV_FISHEYE"),
    "names of one file": (
        lambda meta: [c.update(name=n) for c, n in zip(meta["cameras"], ("caf\u00e9", "cafe\u0301"), strict=True)],
        "name",
    ),
    "names in two cases": (
        lambda meta: [c.update(name=n) for c, n in zip(meta["cameras"], ("Left", "left"), strict=True)],
        "name",
    ),
}


@pytest.mark.parametrize("name", CANNOT_BE)
def test_a_dataset_that_cannot_be_is_refused(tiny_dataset, name):
    path = tiny_dataset / "dataset.json"
    meta = json.loads(path.read_text())
    spoil, words = CANNOT_BE[name]
    spoil(meta)
    path.write_text(json.dumps(meta))
    with pytest.raises(DataFormatError, match=rf"dataset\.json.*{words}"):
        Dataset.open(tiny_dataset)


def test_not_a_dataset(tmp_path, tiny_dataset):
    with pytest.raises(DataFormatError, match="gof generate"):
        Dataset.open(tmp_path / "nothing")
    (tiny_dataset / "dataset.json").write_text('{"schema": "gof-')
    with pytest.raises(DataFormatError, match="not valid JSON"):
        Dataset.open(tiny_dataset)


def test_missing_truncated_and_resized_pictures(tiny_dataset):
    import cv2

    d = Dataset.open(tiny_dataset)
    path = d.file(0, "rgb", 1)
    cv2.imwrite(str(path), np.zeros((4, 4, 3)))
    with pytest.raises(DataFormatError, match="4x4"):
        d.image(0, 1)
    path.write_bytes(b"\x89PNG half a file")
    with pytest.raises(DataFormatError, match="cannot be decoded"):
        d.image(0, 1)
    path.unlink()
    with pytest.raises(DataFormatError, match="no such file"):
        d.image(0, 1)


def test_paths_may_not_leave_the_dataset(tiny_dataset):
    meta = json.loads((tiny_dataset / "dataset.json").read_text())
    meta["cameras"][0]["rgb"] = "../../etc/{frame}.png"
    change(tiny_dataset, cameras=meta["cameras"])
    with pytest.raises(DataFormatError, match="cannot be the name of a file in the dataset"):
        Dataset.open(tiny_dataset).image(0, 0)


def test_a_real_capture_has_no_velocity(tiny_dataset):
    change(tiny_dataset, velocity=None)
    with pytest.raises(DataFormatError, match="no ground-truth velocity"):
        _ = Dataset.open(tiny_dataset).velocity


@pytest.mark.parametrize(
    "scale, known",
    [
        (None, True),
        ("metres, from points of known size (spread 1.2%)", True),
        ("metres, from --cameras", True),
        ("unknown: the unit is the distance between first and last camera", False),
        ("that of the data set: first and last camera are 10 of its units apart", False),
    ],
)
def test_whether_lengths_are_metres(tiny_dataset, scale, known):
    """What `gof ingest` writes of each way to place cameras; a simulated scene says nothing and is in metres."""
    change(tiny_dataset, provenance={} if scale is None else {"scale": scale})
    assert Dataset.open(tiny_dataset).description.in_metres == known


def test_cameras_with_clocks_of_their_own(tiny_dataset):
    meta = json.loads((tiny_dataset / "dataset.json").read_text())
    own = [0.004 + 0.01 * k for k in range(4)]
    meta["cameras"][1]["time_s"] = own
    change(tiny_dataset, cameras=meta["cameras"])
    d = Dataset.open(tiny_dataset)
    np.testing.assert_array_equal(d.camera_times_s(0), d.times_s)
    np.testing.assert_array_equal(d.camera_times_s(1), own)
    for bad in (own[:3], own[::-1], [0, 1, 2, float("inf")], "soon"):
        meta["cameras"][1]["time_s"] = bad
        change(tiny_dataset, cameras=meta["cameras"])
        with pytest.raises(DataFormatError, match="(cam_1|cameras.1.).*time_s"):
            Dataset.open(tiny_dataset)


def test_plates_of_larger_pictures_are_refused_with_a_remedy(tiny_dataset, tmp_path):
    save_plates(tmp_path, ["cam_0"], [np.zeros((128, 72, 3))])
    with pytest.raises(DataFormatError, match="cam_0.png: is 72x128, .* are 36x64: score against .* or remove plates/"):
        background(Dataset.open(tiny_dataset), 0, tmp_path)


def test_a_datasets_file_means_its_folder(tiny_dataset, tmp_path):
    """For Python and every command; a folder around a dataset is told where it is."""
    assert open_dataset(tiny_dataset / "dataset.json").path == tiny_dataset
    around = tiny_dataset.parent
    with pytest.raises(DataFormatError, match=rf"it is in {tiny_dataset}: give that folder"):
        open_dataset(around)
    with pytest.raises(DataFormatError, match="'gof generate' or 'gof ingest'"):
        open_dataset(tiny_dataset / "nothing")
    frozen = read_options(AnnotateConfig, "capture annotate", [str(tiny_dataset / "dataset.json")])
    assert frozen.dataset == tiny_dataset
    seen = read_options(DepthConfig, "depth", [str(tiny_dataset / "dataset.json")])
    several = read_options(ReconstructConfig, "reconstruct", [str(tiny_dataset / "dataset.json"), "other"])
    assert seen.dataset == tiny_dataset and several.datasets == (tiny_dataset, Path("other"))
