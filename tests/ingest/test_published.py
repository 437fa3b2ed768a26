"""A scene of the authors' public data set becomes a dataset without structure from motion."""

import json

import cv2
import numpy as np
import pytest

from gof.commands.ingest import IngestConfig, ingest
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.dataset.poses import Poses
from gof.io.importers.alignment import align_cameras, read_cameras
from tests.ingest import published_scene as published
from tests.ingest.scene import HEIGHT, WIDTH, pose_errors
from tests.ingest.test_clips import psnr

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fire_actioncam") / "scenes" / "011"
    return folder, published.write(folder)


@pytest.fixture(scope="module")
def made(scene, tmp_path_factory):
    return ingest(IngestConfig([scene[0]], tmp_path_factory.mktemp("set") / "fire", start=(2,), frames=9))


def test_cameras_are_the_true_ones_up_to_the_published_world(scene, made):
    dataset, truth = Dataset.open(made.folder), scene[1]
    angle, shift = pose_errors([c.world_to_camera for c in dataset.cameras], [c.world_to_camera for c in truth])
    assert angle < 1e-4 and shift < 1e-6
    apart = [np.linalg.norm(cameras[2].position - cameras[0].position) for cameras in (dataset.cameras, truth)]
    assert apart[0] == pytest.approx(published.UNIT * apart[1], rel=1e-9), "without a length the unit stays"
    assert made.poses.report.method == "published" and "units apart" in made.poses.report.scale
    up = -np.mean([c.world_to_camera[1, :3] for c in dataset.cameras], 0)
    np.testing.assert_allclose(up / np.linalg.norm(up), [0, 0, 1], atol=1e-9)


def test_pictures_are_straight(scene, made):
    dataset = Dataset.open(made.folder)
    for c, camera in enumerate(scene[1]):
        truth = published.straight_picture(camera, dataset.cameras[c].K[0, 0])
        found = 255 * dataset.image(c, 0)
        for part in (np.s_[8:140, 8:-8], np.s_[180:-8, 8:-8], np.s_[8:-8, 8:100], np.s_[8:-8, 140:-8]):  # off the patch
            a, b = (np.float32(picture[part].mean(-1)) for picture in (found, truth))
            window = cv2.createHanningWindow(a.shape[::-1], cv2.CV_32F)
            # OpenCV's own answer for no shift is not 0 at every size
            shift = np.subtract(cv2.phaseCorrelate(a, b, window)[0], cv2.phaseCorrelate(b, b, window)[0])
            assert np.abs(shift).max() < 0.2, "pixels: the half pixel between two ways of counting would show"
            assert psnr(found[part], truth[part]) > 25, "a codec that loses much, and resampled noise"
        lens = dataset.cameras[c].K
        assert lens[0, 2] == WIDTH / 2 and lens[1, 2] == HEIGHT / 2 and lens[0, 0] == lens[1, 1]


def test_frames_are_paired_by_the_boards_clock(scene, made):
    dataset = Dataset.open(made.folder)
    assert len(dataset.times_s) == 9 and dataset.test_frames == [0, 8], "their split: every 8th from the first on"
    zero_us = published.times_us(0)[2]
    for c in range(3):
        nearest = int(np.abs(published.times_us(c) - zero_us).argmin())
        assert nearest != 2 or c == 0
        own = (published.times_us(c)[nearest : nearest + 9] - zero_us) * 1e-6
        np.testing.assert_allclose(dataset.camera_times_s(c), own, atol=1e-9)
        stored = cv2.imread(str(dataset.file(c, "rgb", 3)))
        patch = stored[HEIGHT // 2 - 4 : HEIGHT // 2 + 4, WIDTH // 2 - 4 : WIDTH // 2 + 4].mean()
        assert patch == pytest.approx(12 * (nearest + 3), abs=4)
    said = dataset.description.provenance["clock"]
    assert f"{zero_us * 1e-6:.6f} s of the board's clock" in said


def test_the_rest_of_the_scene_comes_with_it(scene, made):
    dataset = Dataset.open(made.folder)
    weight = dataset.board_weight(0)
    assert weight[230, 60] == 0 and weight[100, 160] == 1 and 0.02 < (weight == 0).mean() < 0.08
    points = Poses.read(made.folder).points_array()
    true = np.array([[0.0, 0.5, 0.5], [0.3, 0.1, 1.0]])
    for mine, theirs in zip(dataset.cameras, scene[1], strict=True):
        tangent = (mine.project(points)[0] - mine.K[:2, 2]) / mine.K[0, 0]
        expected = (theirs.project(true)[0] - theirs.K[:2, 2]) / theirs.K[0, 0]
        np.testing.assert_allclose(tangent, expected, atol=1e-5)


def test_a_result_in_their_world_is_moved_into_ours(scene, made):
    """published_cameras.json is what --align needs: it carries a published point to where our cameras see it."""
    dataset = Dataset.open(made.folder)
    found = align_cameras(
        read_cameras(made.folder / "published_cameras.json"), {c.name: c.world_to_camera for c in dataset.cameras}
    )
    assert found.scale == pytest.approx(1, abs=1e-6) and found.position_rms_m < 1e-6
    with np.load(scene[0] / "meta.npz") as meta:
        moved = meta["points3D"] @ found.matrix[:3, :3].T + found.matrix[:3, 3]
    np.testing.assert_allclose(moved, made.poses.points_array(), atol=1e-5)


def test_pictures_that_lie_on_their_side_are_turned_with_their_cameras(scene, tmp_path):
    turned = Dataset.open(
        ingest(IngestConfig([scene[0]], tmp_path / "set", turn=("clockwise",), frames=3, baseline_m=0.5)).folder
    )
    assert (turned.cameras[0].width, turned.cameras[0].height) == (HEIGHT, WIDTH)
    assert np.linalg.norm(turned.cameras[2].position - turned.cameras[0].position) == pytest.approx(0.5)
    point = np.array([0.1, 0.2, 0.9])
    for mine, theirs in zip(turned.cameras, scene[1], strict=True):
        # Up in the stored picture is right in the turned one: axes of the world aside, rays turn by 90 degrees.
        relative = mine.world_to_camera[:3, :3] @ turned.cameras[0].world_to_camera[:3, :3].T
        stored = theirs.world_to_camera[:3, :3] @ scene[1][0].world_to_camera[:3, :3].T
        quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
        np.testing.assert_allclose(relative, quarter @ stored @ quarter.T, atol=1e-9)
    assert np.isfinite(turned.cameras[0].project(point[None])[0]).all()
    upright = Dataset.open(ingest(IngestConfig([scene[0]], tmp_path / "b", frames=3)).folder)
    np.testing.assert_allclose(turned.image(1, 1), np.rot90(upright.image(1, 1), -1), atol=1 / 255)


def test_plates_come_from_training_frames_and_the_dataset_says_so(made):
    dataset = Dataset.open(made.folder)
    listed = dataset.description.made_from
    assert set(listed) == {f"static/cam_{c}.png" for c in range(3)}, "poses are published, not computed"
    assert all(list(frames) == [1, 2, 3, 4, 5, 6, 7] for frames in listed.values())
    # The patch of camera 0 grows from 24 by 12 a frame; frame 0, the darkest, is held out.
    plate = 255 * dataset.static(0)[HEIGHT // 2 - 4 : HEIGHT // 2 + 4, WIDTH // 2 - 4 : WIDTH // 2 + 4].mean()
    frames = [24 + 12 * k for k in range(9)]
    assert min(abs(plate - frames[1]), abs(plate - np.median(frames[1:8]))) < 4


def test_what_is_missing_or_wrong_is_named(scene, tmp_path):
    folder = tmp_path / "001"
    folder.mkdir()
    for file in scene[0].iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    with pytest.raises(GofError, match="brings its cameras"):
        ingest(IngestConfig([folder], tmp_path / "a", fov=40.0))
    with pytest.raises(GofError, match="brings its frame times"):
        ingest(IngestConfig([folder], tmp_path / "b", times=("400",)))
    for option, given in {"--marker-mm": {"marker_mm": 60.0}, "--poses": {"poses": "features"}}.items():
        with pytest.raises(GofError, match=f"{option}: poses are taken over, those that the scene brings"):
            ingest(IngestConfig([folder], tmp_path / "b", **given))
    (folder / "001.mask.png").unlink()
    with pytest.raises(DataFormatError, match=r"001\.mask\.png: must be a picture of 240x320"):
        ingest(IngestConfig([folder], tmp_path / "c", frames=3))
    (folder / "002.mp4").unlink()
    with pytest.raises(DataFormatError, match=r"002\.mp4: no such file.*3 cameras"):
        ingest(IngestConfig([folder], tmp_path / "d", frames=3))
    with np.load(folder / "meta.npz") as meta:
        content = dict(meta)
    for change, said in (
        ({"R": content["R"][:, :2]}, r"'R' has shape \(3, 2, 3\)"),
        ({"t": np.full((3, 3), np.nan)}, "'t' holds NaN"),
        ({"dist_coeffs": None}, "'dist_coeffs' is missing"),
    ):
        np.savez(folder / "meta.npz", **{k: v for k, v in (content | change).items() if v is not None})
        with pytest.raises(DataFormatError, match=said):
            ingest(IngestConfig([folder], tmp_path / "e", frames=3))
    assert not any((tmp_path / name / "dataset.json").exists() for name in "abcde")


def test_the_provenance_names_the_scene(made):
    content = json.loads((made.folder / "dataset.json").read_text())
    assert content["provenance"]["data_set"] == "jna-358/fire_actioncam" and content["provenance"]["scene"] == "011"
