"""Cameras against OpenCV's own projection and against finite differences."""

import cv2
import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError, NonFiniteError
from tests.conftest import arc


def test_projection_equals_opencv():
    points = np.random.default_rng(0).normal(0, 0.4, (50, 3)) + [0, 0, 1]
    for camera in arc(3):
        rvec, _ = cv2.Rodrigues(camera.world_to_camera[:3, :3])
        expected, _ = cv2.projectPoints(points, rvec, camera.world_to_camera[:3, 3], camera.K, None)
        pixels, depth = camera.project(points)
        np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)
        np.testing.assert_allclose(depth, camera.to_camera(points)[:, 2])
        np.testing.assert_allclose(camera.to_camera(camera.position[None]), 0, atol=1e-12)


def test_unprojection_undoes_opencvs_projection():
    points = np.random.default_rng(2).normal(0, 0.4, (50, 3)) + [0, 0, 1]
    for camera in arc(3):
        rvec, _ = cv2.Rodrigues(camera.world_to_camera[:3, :3])
        pixels, _ = cv2.projectPoints(points, rvec, camera.world_to_camera[:3, 3], camera.K, None)
        depth = points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
        np.testing.assert_allclose(camera.unproject(pixels[:, 0], depth), points, atol=1e-9)


def test_jacobian_equals_finite_differences():
    points, h = np.random.default_rng(1).normal(0, 0.4, (20, 3)) + [0, 0, 1], 1e-6
    for camera in arc(3):
        jacobian = camera.projection_jacobian(points)
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = h
            numeric = (camera.project(points + step)[0] - camera.project(points - step)[0]) / (2 * h)
            np.testing.assert_allclose(jacobian[..., axis], numeric, rtol=1e-5, atol=1e-4)


def test_points_on_or_behind_the_camera_have_no_image():
    camera = arc(1)[0]
    behind = camera.position - camera.world_to_camera[2, :3]
    pixels, depth = camera.project(np.stack([camera.position, behind]))
    assert np.isnan(pixels).all() and depth[1] < 0
    assert np.isnan(camera.projection_jacobian(camera.position[None])).any()


def test_dict_round_trip_and_scaling():
    camera = Camera("a", 720, 1280, [[900, 0, 360], [0, 900, 640], [0, 0, 1]], np.eye(4), 3e-6, "left")
    again = Camera.from_dict(camera.to_dict())
    assert again.to_dict() == camera.to_dict()
    half = camera.scaled(360, 640)
    np.testing.assert_allclose(
        half.project(np.array([[0.1, 0.2, 2]]))[0], camera.project(np.array([[0.1, 0.2, 2]]))[0] / 2
    )
    assert half.row_time_s == pytest.approx(6e-6), "half as many lines take the same time"


@pytest.mark.parametrize(
    "change, error",
    [
        ({"K": np.eye(4)}, "K has shape"),
        ({"width": 0}, "not positive"),
        ({"readout": "sideways"}, "readout"),
        ({"world_to_camera": np.diag([1, 1, -1, 1])}, "rigid"),
        ({"world_to_camera": 2 * np.eye(4)}, "rigid"),
        ({"K": np.diag([0, 1, 1])}, "focal"),
        ({"K": "text"}, "cannot be read"),
    ],
)
def test_bad_cameras_are_refused(change, error):
    with pytest.raises(DataFormatError, match=error):
        Camera.from_dict({"name": "a", "width": 4, "height": 4, "K": np.eye(3), "world_to_camera": np.eye(4)} | change)


def test_missing_field_and_nan_are_named():
    with pytest.raises(DataFormatError, match="'K'"):
        Camera.from_dict({"name": "a", "width": 4, "height": 4, "world_to_camera": np.eye(4)}, "file.json")
    with pytest.raises(NonFiniteError, match="K"):
        Camera("a", 4, 4, np.full((3, 3), np.nan), np.eye(4))
