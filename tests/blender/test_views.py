"""Datasets in other people's layouts: read back with pycolmap, and by the rules their readers follow."""

import json

import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError
from gof_benchmark import views
from gof_benchmark.views.colmap import is_flat
from gof_benchmark.views.source import ViewSource

OpenEXR = pytest.importorskip("OpenEXR")
cv2 = pytest.importorskip("cv2")
WIDTH, HEIGHT, FRAMES = 90, 160, 9


def look_at(position, target) -> np.ndarray:
    forward = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ position
    return pose


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Without Blender: a wall at y = 2 and a floor at z = 0, three training cameras and one for evaluation."""
    root = tmp_path_factory.mktemp("views")
    cameras = []
    for index, (x, role) in enumerate(((-1.0, "train"), (0.1, "train"), (1.2, "train"), (0.5, "eval"))):
        name = f"cam_{index}"
        pose = look_at([x, -2.5, 1.1], [0, 0, 0.7])
        K = np.array([[150.0, 0, WIDTH / 2], [0, 150.0, HEIGHT / 2], [0, 0, 1]])
        camera = Camera(name, WIDTH, HEIGHT, K, pose)
        columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        rays = camera.unproject(pixels, np.ones(len(pixels))) - camera.position
        with np.errstate(divide="ignore"):
            wall, floor = (2.0 - camera.position[1]) / rays[:, 1], -camera.position[2] / rays[:, 2]
        depth = np.minimum(np.where(wall > 0, wall, 1e10), np.where(floor > 0, floor, 1e10)).reshape(HEIGHT, WIDTH)
        (root / "static").mkdir(exist_ok=True)
        with OpenEXR.File(
            {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Z": depth.astype(np.float32)}
        ) as file:
            file.write(str(root / "static" / f"{name}.exr"))
        picture = np.random.default_rng(index).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        cv2.imwrite(str(root / "static" / f"{name}.png"), picture)
        (root / "cameras" / name / "rgb").mkdir(parents=True)
        for frame in range(FRAMES):
            cv2.imwrite(str(root / f"cameras/{name}/rgb/{frame:06d}.png"), picture)
        cameras.append(
            camera.to_dict()
            | {
                "role": role,
                "roll_deg": 90,
                "static": f"static/{name}.png",
                "rgb": f"cameras/{name}/rgb/{{frame:06d}}.png",
                "mask": f"cameras/{name}/mask/{{frame:06d}}.png",
            }
        )
    meta = {
        "schema": "gof-dataset",
        "version": 1,
        "name": "views",
        "time_s": [k / 50 for k in range(FRAMES)],
        "cameras": cameras,
        "splits": {"train": [0, 1, 2, 3, 5, 6, 7, 8], "test": [4]},
    }
    (root / "dataset.json").write_text(json.dumps(meta))
    for name in ("nerfstudio", "dnerf", "colmap", "dynerf"):
        views.write(name, root)
        views.write(name, root)  # over an older one
    return root


def bilinear(grid: np.ndarray, x: float, y: float) -> np.ndarray:
    return cv2.remap(
        grid.astype(np.float32), np.float32([[x]]), np.float32([[y]]), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )[0, 0]


@pytest.mark.long
def test_pycolmap_reads_the_model_and_depth_lands_on_the_same_pixels(dataset):
    pycolmap = pytest.importorskip("pycolmap", reason="the extra 'views' installs pycolmap")
    model = pycolmap.Reconstruction(str(dataset / "sparse" / "0"))
    source = ViewSource.open(dataset)
    assert model.num_cameras() == model.num_images() == 4
    assert model.num_points3D() > 1000
    assert model.compute_mean_reprojection_error() < 0.01
    images = {image.name: image for image in model.images.values()}
    checked = 0
    for a in range(4):
        depth = source.plate_depth(a)
        rows, columns = np.nonzero(is_flat(depth))
        points = source.dataset.cameras[a].unproject(np.column_stack([columns, rows]) + 0.5, depth[rows, columns])
        # The same picture: the unprojected pixel centre comes back.
        image = images[f"static/cam_{a}.png"]
        seen = np.array([image.project_point(p) for p in points[::37]])
        assert np.abs(seen - np.stack([columns + 0.5, rows + 0.5], -1)[::37]).max() < 0.01
        for b in range(4):
            # Another picture: its own depth there is that of the point, or it is hidden or outside.
            image, other = images[f"static/cam_{b}.png"], source.plate_depth(b)
            for point in points[:: max(len(points) // 60, 1)]:
                pixel = image.project_point(point)
                if pixel is None or not (0 <= pixel[0] < WIDTH and 0 <= pixel[1] < HEIGHT):
                    continue
                if not is_flat(other)[int(pixel[1]), int(pixel[0])]:
                    continue
                back = source.dataset.cameras[b].unproject(pixel[None], 1 / bilinear(1 / other, *(pixel - 0.5))[None])
                depth_there = (source.dataset.cameras[b].world_to_camera @ [*point, 1])[2]
                if depth_there > 1.02 * bilinear(other, *(pixel - 0.5)):
                    continue  # hidden
                shift = np.abs(
                    source.dataset.cameras[a].project(back)[0] - source.dataset.cameras[a].project(point[None])[0]
                ).max()
                assert shift < 0.5
                checked += 1
    assert checked > 200


def test_colmap_text_is_complete(dataset):
    lines = (dataset / "sparse/0/images.txt").read_text().splitlines()
    assert len(lines) == 8 and lines[0].split()[-1] == "static/cam_0.png"
    for line in (dataset / "sparse/0/points3D.txt").read_text().splitlines()[:50]:
        words = line.split()
        assert len(words) >= 8 + 4 and len(words) % 2 == 0, "at least two observations"


def projection_by_nerf_rules(frame: dict, point: np.ndarray, focal: float) -> np.ndarray:
    """Pixel of a world point from an OpenGL pose, as Nerfstudio and D-NeRF readers compute rays."""
    x, y, z = (np.linalg.inv(np.array(frame["transform_matrix"])) @ [*point, 1])[:3]
    return np.array([WIDTH / 2 + focal * x / -z, HEIGHT / 2 - focal * y / -z])


def test_nerfstudio_fields_and_poses(dataset):
    data, source = json.loads((dataset / "transforms.json").read_text()), ViewSource.open(dataset)
    assert len(data["frames"]) == 4 * FRAMES and data["camera_model"] == "OPENCV"
    files = {frame["file_path"] for frame in data["frames"]}
    assert set(data["train_filenames"]) | set(data["test_filenames"]) == files
    assert not set(data["train_filenames"]) & set(data["test_filenames"])
    assert len(data["train_filenames"]) == 3 * 8
    assert all((dataset / file).is_file() for file in files)
    point = np.array([0.1, 0.2, 0.6])
    for camera, frame in enumerate(data["frames"][:4]):
        expected = source.dataset.cameras[camera].project(point[None])[0][0]
        np.testing.assert_allclose(projection_by_nerf_rules(frame, point, frame["fl_x"]), expected, atol=1e-9)
    last = data["frames"][-1]
    assert (last["time"], last["time_s"]) == (1.0, pytest.approx(8 / 50))


def test_dnerf_splits_and_field_of_view(dataset):
    train, test, source = (
        json.loads((dataset / "transforms_train.json").read_text()),
        json.loads((dataset / "transforms_test.json").read_text()),
        ViewSource.open(dataset),
    )
    assert (len(train["frames"]), len(test["frames"])) == (3 * 8, 3 + FRAMES)
    assert {frame["time"] for frame in test["frames"]} >= {0.0, 0.5, 1.0}
    assert all((dataset / (frame["file_path"] + ".png")).is_file() for frame in train["frames"] + test["frames"])
    focal = 0.5 * WIDTH / np.tan(0.5 * train["camera_angle_x"])
    point = np.array([0.1, 0.2, 0.6])
    expected = source.dataset.cameras[0].project(point[None])[0][0]
    np.testing.assert_allclose(projection_by_nerf_rules(train["frames"][0], point, focal), expected, atol=1e-9)


def test_dynerf_follows_llff(dataset):
    rows, source = np.load(dataset / "dynerf" / "poses_bounds.npy"), ViewSource.open(dataset)
    assert rows.shape == (4, 17)
    pose = rows[0, :15].reshape(3, 5)  # the evaluation camera comes first
    np.testing.assert_allclose(pose[:, 4], [HEIGHT, WIDTH, 150.0])
    np.testing.assert_allclose(pose[:, 3], source.dataset.cameras[3].position)
    # What readers do: [down, right, back] to [right, up, back].
    to_world = np.concatenate([pose[:, 1:2], -pose[:, 0:1], pose[:, 2:4]], axis=1)
    np.testing.assert_allclose(to_world, source.opengl_pose(3)[:3], atol=1e-12)
    assert 0 < rows[0, 15] < source.plate_depth(3).min() < rows[0, 16]
    linked = dataset / "dynerf/cam00/images/0003.png"
    assert linked.read_bytes() == (dataset / "cameras/cam_3/rgb/000003.png").read_bytes()


def test_what_a_layout_cannot_say_is_refused(dataset, tmp_path):
    meta = json.loads((dataset / "dataset.json").read_text())
    meta["cameras"][1]["K"][0][0] = 155.0
    (tmp_path / "dataset.json").write_text(json.dumps(meta))
    with pytest.raises(DataFormatError, match="cam_1"):
        views.write("dnerf", tmp_path)
    with pytest.raises(DataFormatError, match=r"no dataset\.json"):
        views.write("colmap", tmp_path / "nowhere")
