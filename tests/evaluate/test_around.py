"""Scores of pictures from all around the flame: their definitions, and a dataset that has such cameras."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.description import DatasetDescription
from gof.core.errors import DataFormatError, NonFiniteError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.around import angles_deg, false_colour, gradient_ratio, hue_deg, meeting_point
from gof.render import render
from tests.conftest import arc, look_at, write_dataset


def test_hues_are_those_of_the_colour_wheel():
    colours = np.array([[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1], [0.4, 0.4, 0.4]], float)
    assert hue_deg(colours)[:6] % 360 == pytest.approx([0, 60, 120, 180, 240, 300])
    assert np.isnan(hue_deg(colours)[6]), "grey has no hue"
    with pytest.raises(NonFiniteError):
        hue_deg(np.array([[np.nan, 0, 0]]))


def test_false_colour_counts_pixels_that_no_fire_has():
    truth = np.zeros((10, 10, 3))
    truth[:] = np.linspace([0.9, 0.1, 0.0], [1.0, 0.8, 0.1], 10)[None]  # red to yellow
    mask = np.ones((10, 10), bool)
    green = truth.copy()
    green[0, :5] = [0.1, 0.9, 0.2]
    assert false_colour(truth, truth, mask) == 0
    assert false_colour(green, truth, mask) == pytest.approx(0.05), "5 of 100 pixels"
    grey = np.full_like(truth, 0.5)
    assert false_colour(grey, truth, mask) == 0 and false_colour(truth, grey, mask) is None


def test_sharpness_is_a_ratio_of_gradients():
    x = np.linspace(0, 1, 33)[None, :, None] * np.ones((8, 1, 3))
    mask = np.ones((8, 33), bool)
    assert gradient_ratio(0.5 * x, x, mask) == pytest.approx(0.5)
    assert gradient_ratio(x, np.ones_like(x), mask) is None


def test_angles_are_seen_from_where_the_cameras_look():
    def at(angle, height=0.0):
        a, middle = np.radians(angle), np.array([1.0, 2.0, 3.0])
        place = middle + 4 * np.array([np.cos(a), np.sin(a), height])
        z = (middle - place) / np.linalg.norm(middle - place)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3] = [x, np.cross(z, x), z]
        pose[:3, 3] = -pose[:3, :3] @ place
        return Camera("c", 8, 8, np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]), pose)

    given = [at(-35), at(0), at(35)]
    assert meeting_point(given) == pytest.approx([1, 2, 3], abs=1e-9)
    assert angles_deg([at(0), at(45), at(90), at(180), at(270)], given) == pytest.approx([0, 10, 55, 145, 55], abs=0.01)
    assert angles_deg([at(90), at(180)], given[1:2]) == pytest.approx([90, 180], abs=0.01), "also from one camera"
    turned = at(0).world_to_camera.copy()
    turned[:3, 3] = -turned[:3, :3] @ [1, 2, 3]
    inside = replace(at(0), world_to_camera=turned)
    assert angles_deg([inside], given) == pytest.approx([0], abs=0.01), "in the flame: where its back is turned to"


@pytest.fixture(scope="module")
def seen_around(tmp_path_factory):
    """A sheet of flame, filmed along it and scored across it: three given cameras, three around with two frames."""
    folder = tmp_path_factory.mktemp("around")
    rng = np.random.default_rng(2)
    n, middle = 60, (0, 0, 1.0)
    flame = TransientGaussians(
        position=rng.normal(middle, [0.02, 0.25, 0.25], (n, 3)),
        velocity=np.zeros((n, 3)),
        t_mu=np.full(n, 0.1),
        t_sigma=np.full(n, 10.0),
        scale=np.full((n, 3), 0.05),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.5),
        color=np.tile([1.0, 0.5, 0.1], (n, 1)),
        dynamic=np.ones(n, bool),
    )
    given = arc(3, target=middle)
    angles = np.radians([0, 90, 180])
    around = [
        look_at(f"around_{k}", np.add(middle, [3 * np.sin(a), -3 * np.cos(a), 0]), middle) for k, a in enumerate(angles)
    ]
    cameras, times_s = [*given, *around], 0.05 * np.arange(5)
    drawn = [[render(flame, camera, time_s) for camera in cameras] for time_s in times_s]
    images = np.array([[np.clip(one["color"], 0, 1) for one in frame] for frame in drawn])
    masks = np.array([[one["alpha"] > 0.02 for one in frame] for frame in drawn])
    path = write_dataset(folder / "fire", cameras, images, np.zeros_like(images[0]), times_s, None, masks, [2])
    about = DatasetDescription.read(path)
    entries = [
        replace(entry, role="around", frames=(1, 3)) if entry.name.startswith("around") else entry
        for entry in about.cameras
    ]
    replace(about, cameras=tuple(entries)).write(path)
    for entry in entries[3:]:  # what is not listed is not looked for
        (path / entry.rgb.format(frame=0)).unlink()
    return Dataset.open(path), flame


def test_cameras_around_are_no_cameras_to_train_on(seen_around):
    dataset, _ = seen_around
    assert [camera.name for camera in dataset.cameras] == ["cam_0", "cam_1", "cam_2"]
    around = dataset.around_view()
    assert [camera.name for camera in around.cameras] == ["around_0", "around_1", "around_2"]
    assert around.frames(0) == [1, 3] and dataset.frames(0) == [0, 1, 2, 3, 4] and dataset.evaluation_view() is None


def test_the_truth_scores_full_marks_from_every_side(seen_around):
    dataset, flame = seen_around
    scores = evaluate(flame, dataset).around
    assert [(score.angle_deg, score.pictures) for score in scores] == [(0, 2), (55, 2), (145, 2)]
    for score in scores:
        assert score.psnr_flame > 45 and score.ssim_flame > 0.99, "but for the rounding to eight bits"
        assert score.gradient_ratio == pytest.approx(1, abs=0.02) and score.false_colour == 0


def test_what_is_wrong_along_the_rays_shows_from_the_side(seen_around):
    """Each Gaussian pushed along the middle camera's ray: the same picture there, another one from the side."""
    dataset, flame = seen_around
    middle = dataset.cameras[1].position
    pushed = middle + (flame.position - middle) * np.random.default_rng(0).uniform(0.8, 1.2, (len(flame), 1))
    size = flame.scale * np.linalg.norm(pushed - middle, axis=1, keepdims=True)
    smeared = replace(flame, position=pushed, scale=size / np.linalg.norm(flame.position - middle, axis=1)[:, None])
    front, side, _ = evaluate(smeared, dataset).around
    assert front.psnr_flame > 30 and side.psnr_flame < front.psnr_flame - 8
    green = replace(flame, color=np.tile([0.1, 1.0, 0.2], (len(flame), 1)))
    assert min(score.false_colour for score in evaluate(green, dataset).around) > 0.9


def test_a_camera_to_train_on_has_all_frames(seen_around):
    dataset, _ = seen_around
    about = dataset.description
    with pytest.raises(DataFormatError, match="camera 'cam_0': frames must list numbers below 5"):
        replace(about, cameras=(replace(about.cameras[0], frames=(1,)), *about.cameras[1:]))
    with pytest.raises(DataFormatError, match="camera 'around_0': frames must list numbers below 5"):
        replace(about, cameras=(*about.cameras[:3], replace(about.cameras[3], frames=(1, 5)), *about.cameras[4:]))


def test_a_dataset_stays_the_same_when_it_is_seen_from_all_around(seen_around):
    dataset, _ = seen_around
    given = replace(dataset, description=replace(dataset.description, cameras=dataset.description.cameras[:3]))
    assert dataset.identity() == given.identity()
    moved = replace(dataset.description, cameras=dataset.description.cameras[:2])
    assert replace(dataset, description=moved).identity() != given.identity()
