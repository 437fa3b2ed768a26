"""The layouts that other methods' trainings read, told apart from the dataset by rules written here and by pycolmap."""

import json
import struct
import sys

import cv2
import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError
from gof.core.ply_file import read_vertices
from gof.dataset import Dataset
from gof_benchmark import views
from gof_benchmark.views import shrunk
from tests.on_cpu import made_up_fire as fire

pytest.importorskip("OpenEXR")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return fire.write(tmp_path_factory.mktemp("views") / "fire")


def test_starting_points_lie_on_surfaces_and_in_the_flame(root):
    rows, _ = read_vertices(root / "points3d.ply")
    place = np.stack([rows[axis] for axis in "xyz"], -1)
    colour = np.stack([rows[c] for c in ("red", "green", "blue")], -1).astype(int)
    assert rows.dtype.names == ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue")
    on_surface = (np.abs(place[:, 1] - 2) < 0.02) | (np.abs(place[:, 2]) < 0.02)
    track = np.stack([fire.blob(k) for k in range(fire.FRAMES)])
    from_flame = np.linalg.norm(place[~on_surface, None] - track, axis=-1).min(1)
    assert on_surface.sum() > 1000 and 1000 < (~on_surface).sum() <= 4000
    assert from_flame.max() < 0.5 and np.median(from_flame) < 0.25
    assert (colour[on_surface].max(1) - colour[on_surface].min(1)).max() == 0, "walls are grey"
    assert (colour[~on_surface, 0] > colour[~on_surface, 2] + 20).mean() > 0.9, "flame is red"


def test_multiple_views_of_wu(root):
    """What its reader does: pictures by number, names from the sixth letter on, one focal length of camera 1."""
    folder, dataset = root / "multipleview", Dataset.open(root)
    for number, camera in enumerate(dataset.cameras, start=1):
        assert len(list((folder / f"cam{number:02d}").iterdir())) == fire.FRAMES
        for frame in range(fire.FRAMES):
            picture = folder / f"cam{number:02d}" / f"frame_{frame + 1:05d}.jpg"
            assert picture.read_bytes() == dataset.file(number - 1, "rgb", frame).read_bytes(), camera.name
    content = (folder / "sparse_/cameras.bin").read_bytes()
    count, key, model, width, height, fx, fy, cx, cy = struct.unpack("<QiiQQ4d", content)
    assert (count, key, model, width, height, fx, fy, cx, cy) == (1, 1, 1, 48, 80, 100, 100, 24, 40)
    assert np.load(folder / "poses_bounds_multipleview.npy").shape == (3, 17)
    assert (folder / "points3D_multipleview.ply").read_bytes() == (root / "points3d.ply").read_bytes()
    names = [f"image{k}.png" for k in (1, 2, 3)]
    assert [name[5:-4].zfill(2) for name in names] == ["01", "02", "03"]
    pycolmap = pytest.importorskip("pycolmap")
    (folder / "sparse_/points3D.bin").write_bytes(struct.pack("<Q", 0))  # pycolmap wants one; its reader does not
    read = pycolmap.Reconstruction(str(folder / "sparse_"))
    (folder / "sparse_/points3D.bin").unlink()
    assert sorted(image.name for image in read.images.values()) == names
    for image in read.images.values():
        pose = dataset.cameras[int(image.name[5:-4]) - 1].world_to_camera
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose[:3], atol=1e-9)


def test_hypernerf_of_wu(root):
    """What its reader does: lenses of twice the picture, x = R (X - position), frames by number, a real split."""
    folder, dataset = root / "hypernerf", Dataset.open(root)
    split = json.loads((folder / "dataset.json").read_text())
    about = json.loads((folder / "metadata.json").read_text())
    assert sorted(split["train_ids"] + split["val_ids"]) == sorted(split["ids"]) == sorted(about)
    assert {about[name]["warp_id"] for name in split["val_ids"]} == set(fire.TEST)
    assert {about[name]["warp_id"] for name in split["train_ids"]} == set(range(fire.FRAMES)) - set(fire.TEST)
    point = np.array([0.1, -0.2, 0.6])
    for name, entry in about.items():
        camera = dataset.cameras[entry["camera_id"]]
        picture = folder / "rgb/2x" / f"{name}.png"
        assert picture.read_bytes() == dataset.file(entry["camera_id"], "rgb", entry["warp_id"]).read_bytes()
        lens = json.loads((folder / "camera" / f"{name}.json").read_text())
        seen = np.array(lens["orientation"]) @ (point - lens["position"])
        pixel = (lens["focal_length"] * seen[:2] / seen[2] + lens["principal_point"]) / 2
        np.testing.assert_allclose(pixel, camera.project(point[None])[0][0], atol=1e-9)
        assert lens["image_size"] == [2 * fire.WIDTH, 2 * fire.HEIGHT]
    assert (folder / "points3D_downsample2.ply").read_bytes() == (root / "points3d.ply").read_bytes()


def test_the_published_form_of_neural_3d_video(root):
    """Pictures of 4:3, lenses for a width of 2704: a point is where a reader that resizes to 1352x1014 looks for it."""
    folder, dataset = root / "n3v", Dataset.open(root)
    rows = np.load(folder / "poses_bounds.npy")
    videos = sorted(folder.glob("cam*.mp4"))
    assert rows.shape == (4, 17) and [path.name for path in videos] == [f"cam{k:02d}.mp4" for k in range(4)]
    np.testing.assert_array_equal(rows[0], rows[1], "without an evaluation camera the held-out one is a copy")
    for number, camera in enumerate(dataset.cameras):
        matrix = rows[number + 1][:15].reshape(3, 5)
        assert matrix[:2, 4].tolist() == [2028, 2704]
        down, right, back, centre = matrix[:, :4].T
        to_camera = np.stack([right, down, -back])
        point = fire.blob(2)
        seen = to_camera @ (point - centre)
        focal = matrix[2, 4] / 2
        pixel = focal * seen[:2] / seen[2] + (676, 507)
        clip = cv2.VideoCapture(str(videos[number + 1]))
        pictures = [clip.read()[1] for _ in range(fire.FRAMES)]
        assert not clip.read()[0] and pictures[0].shape[1] * 3 == pictures[0].shape[0] * 4
        height, width = pictures[0].shape[:2]
        top, left = height // 2 - fire.HEIGHT, width // 2 - fire.WIDTH
        shown = pictures[2][top : top + 2 * fire.HEIGHT : 2, left : left + 2 * fire.WIDTH : 2]
        own = cv2.imread(str(dataset.file(number, "rgb", 2))).astype(float)
        assert np.abs(shown - own).mean() < 4 and pictures[2][:, : left - 4].max() < 12
        in_video = (left, top) + 2 * camera.project(point[None])[0][0]
        np.testing.assert_allclose(pixel, in_video * 1352 / width, atol=1e-6)


def test_layout_of_freetimegs(root):
    """The first camera by name is held out by its trainer; frames held out here are absent from the others."""
    folder, dataset = root / "freetimegs", Dataset.open(root)
    cameras = sorted(path.name for path in (folder / "images").iterdir())
    assert cameras == ["00_validation", "cam_0", "cam_1", "cam_2"]
    for name in cameras:
        frames = {int(path.stem) for path in (folder / "images" / name).iterdir()}
        assert frames == set(range(fire.FRAMES)) - (set() if name == cameras[0] else set(fire.TEST))
    pycolmap = pytest.importorskip("pycolmap")
    read = pycolmap.Reconstruction(str(folder / "sparse/0"))
    poses = {image.name.split("/")[0]: image.cam_from_world().matrix() for image in read.images.values()}
    assert sorted(poses) == cameras
    np.testing.assert_allclose(poses["00_validation"], poses["cam_0"])
    for camera in dataset.cameras:
        np.testing.assert_allclose(poses[camera.name], camera.world_to_camera[:3], atol=1e-9)
    assert len(read.points3D) > 1000
    for frame in dataset.train_frames:
        place = np.load(folder / f"triangulation/points3d_frame{frame:06d}.npy")
        colour = np.load(folder / f"triangulation/colors_frame{frame:06d}.npy")
        assert place.shape == colour.shape and place.dtype == np.float32 and 1 < colour.max() <= 255
        flame = place[(np.abs(place[:, 1] - 2) > 0.02) & (np.abs(place[:, 2]) > 0.02)]
        assert np.linalg.norm(flame.mean(0) - fire.blob(frame)) < 0.1
    assert not list(folder.glob(f"triangulation/*frame{fire.TEST[0]:06d}.npy")), "nothing of a held-out frame"


def test_what_a_layout_cannot_hold_is_named(tmp_path):
    root = fire.dataset(tmp_path / "fire")
    text = (root / "dataset.json").read_text()
    (root / "dataset.json").write_text(text.replace('"cam_0"', '"000"'))
    with pytest.raises(DataFormatError, match="must sort after '00_validation'"):
        views.write("freetimegs", root)
    (root / "dataset.json").write_text(text.replace("100.0", "101.0", 1))
    with pytest.raises(DataFormatError, match="one centred field of view"):
        views.write("multipleview", root)
    (root / "dataset.json").write_text(text.replace("0.03", "0.035"))
    with pytest.raises(DataFormatError, match="not evenly spaced"):
        views.write("hypernerf", root)
    held_out = json.loads(text)
    held_out["splits"] = {"train": list(range(fire.FRAMES)), "test": []}
    (root / "dataset.json").write_text(json.dumps(held_out))
    with pytest.raises(DataFormatError, match="holds out nothing"):
        views.write("hypernerf", root)


def test_a_dataset_with_smaller_pictures(tmp_path):
    root = fire.dataset(tmp_path / "fire")
    out = tmp_path / "small"
    shrunk.main([str(root), str(out), "--max-size", "40", "--views", "dnerf", "points"])
    large, small = Dataset.open(root), Dataset.open(out)
    picture = cv2.imread(str(large.file(1, "rgb", 3))).astype(float)
    means = picture.reshape(40, 2, 24, 2, 3).mean((1, 3))
    assert np.abs(cv2.imread(str(small.file(1, "rgb", 3))) - means).max() <= 0.5
    point = np.array([[0.1, 0.2, 0.6]])
    np.testing.assert_allclose(2 * small.cameras[2].project(point)[0], large.cameras[2].project(point)[0])
    assert not (out / "spec.json").exists() and "pictures" in small.description.provenance
    assert small.test_frames == large.test_frames and (out / "transforms_train.json").is_file()
    with pytest.raises(GofError, match="is there already"):
        shrunk.shrink(root, out, 40)
    with pytest.raises(GofError, match="not larger than 80"):
        shrunk.shrink(root, tmp_path / "same", 80)


def test_the_old_name_of_the_pictures_size_works_and_says_so(tmp_path, capsys):
    root = fire.dataset(tmp_path / "fire")
    words = [str(root), str(tmp_path / "small"), "--views", "dnerf"]
    assert shrunk.main([*words, "--longest-side=40"]) == 0
    assert "--longest-side is now --max-size" in capsys.readouterr().err
    assert Dataset.open(tmp_path / "small").cameras[0].height == 40


def test_smaller_pictures_without_openexr_leave_nothing(tmp_path, monkeypatch, capsys):
    """A layout that reads the plates' depth needs it, and one that does not can be had without."""
    root = fire.dataset(tmp_path / "fire")
    assert list(root.rglob("*.exr"))
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "OpenEXR", None)
        words = [str(root), str(tmp_path / "small"), "--max-size", "40", "--views", "dnerf"]
        assert shrunk.main([*words, "points"]) == 1
        captured = capsys.readouterr()
        said = captured.out + captured.err
        assert "OpenEXR" in said and "Traceback" not in said
        assert [path.name for path in tmp_path.iterdir()] == ["fire"]
        assert shrunk.main(words) == 0
    small = tmp_path / "small"
    assert (small / "transforms_train.json").is_file() and not list(small.rglob("*.exr"))
    assert shrunk.main([*words[:1], str(tmp_path / "full"), *words[2:], "points"]) == 0, "the same command with it"
    assert len(list((tmp_path / "full").rglob("*.exr"))) == 3


def test_smaller_pictures_for_a_layout_that_cannot_be_leave_nothing(tmp_path, capsys):
    """A dataset that holds out nothing has no such layout: the whole folder is not made."""
    root = fire.dataset(tmp_path / "fire")
    description = json.loads((root / "dataset.json").read_text())
    description["splits"] = {"train": list(range(fire.FRAMES)), "test": []}
    (root / "dataset.json").write_text(json.dumps(description))
    assert shrunk.main([str(root), str(tmp_path / "small"), "--max-size", "40", "--views", "hypernerf"]) == 1
    assert "holds out nothing" in capsys.readouterr().out.replace("\n", " ")
    assert [path.name for path in tmp_path.iterdir()] == ["fire"]


def test_nerfds_of_grid4d_and_deformable(root, tmp_path):
    """What their readers do: lenses and pictures of one size, frames by `time_id` over the last one's, a real split."""
    folder, dataset = root / "NeRF/nerfds", Dataset.open(root)
    assert folder.parent.name.startswith("NeRF") and "nerf" in str(folder)
    split = json.loads((folder / "dataset.json").read_text())
    about = json.loads((folder / "metadata.json").read_text())
    assert {about[name]["time_id"] for name in split["val_ids"]} == set(fire.TEST)
    assert {about[name]["time_id"] for name in split["train_ids"]} == set(range(fire.FRAMES)) - set(fire.TEST)
    point = np.array([0.1, -0.2, 0.6])
    for name, entry in about.items():
        camera = dataset.cameras[entry["camera_id"]]
        picture = folder / "rgb/1x" / f"{name}.png"
        assert picture.read_bytes() == dataset.file(entry["camera_id"], "rgb", entry["time_id"]).read_bytes()
        lens = json.loads((folder / "camera" / f"{name}.json").read_text())
        seen = np.array(lens["orientation"]) @ (point - lens["position"])
        pixel = lens["focal_length"] * seen[:2] / seen[2] + [fire.WIDTH / 2, fire.HEIGHT / 2]  # they take the centre
        np.testing.assert_allclose(pixel, camera.project(point[None])[0][0], atol=1e-9)
    assert (folder / "points3d.ply").read_bytes() == (root / "points3d.ply").read_bytes()
    mistaken = fire.dataset(tmp_path / "vrig_fire")
    with pytest.raises(DataFormatError, match="'vrig' for another; rename it"):
        views.write("nerfds", mistaken)
