"""The authors' training bundle, read by the published rules of its loader, written out here a second time."""

import json
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.dataset import Dataset
from gof_benchmark import views
from tests.plys import read_ply
from tests.reconstruct.rising_flame import DT, RISE, edit, write_flame

OpenEXR = pytest.importorskip("OpenEXR")
cv2 = pytest.importorskip("cv2")
pytestmark = pytest.mark.long
FRAMES, HELD_OUT, WALL = 14, (2, 6, 10), 3.0  # every 4th from the third on; a wall at y = 3 m behind the flame


def write_dataset(folder: Path, **options) -> Path:
    """The rising flame before a wall whose exact depth the plates know."""
    write_flame(folder, frames=FRAMES, test_frames=HELD_OUT, **options)
    dataset = Dataset.open(folder)
    for c, camera in enumerate(dataset.cameras):
        columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        rays = camera.unproject(np.column_stack([columns.ravel(), rows.ravel()]), np.ones(columns.size))
        along = (WALL - camera.position[1]) / (rays - camera.position)[:, 1]
        depth = along.reshape(columns.shape).astype(np.float32)
        with OpenEXR.File(
            {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Z": depth}
        ) as file:
            file.write(str(dataset.file(c, "static").with_suffix(".exr")))
    return folder


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = write_dataset(tmp_path_factory.mktemp("bundle") / "flame", late={1: 0.004})
    views.write("firebundle", folder)
    return folder, folder / "fire_bundle"


def load(bundle: Path, test_every: int):
    """Test and training pictures, and the flow files, as the published loader chooses them.

    Held out is every frame r with r % test_every == 0. A training frame takes its stride-1 files, or those of stride 2
    where the first have seen a held-out frame; where both have, loading fails.
    """
    transforms = json.loads((bundle / "transforms.json").read_text())
    held = {r for r in range(transforms["num_frames"]) if r % test_every == 0}
    made = {
        kind: json.loads((bundle / kind / "provenance.json").read_text())["files"] for kind in ("masks", "voxel_flow")
    }

    def chosen(kind: str, name: str) -> Path:
        for stride in (1, 2):
            sources = made[kind][f"stride{stride}/{name}"]["sources"].values()
            if not held & {r for source in sources for r in source["window_frames"]}:
                return bundle / kind / f"stride{stride}" / name
        raise AssertionError(f"{name} leaks")

    train = [f for f in transforms["frames"] if f["frame"] not in held]
    test = [f for f in transforms["frames"] if f["frame"] in held]
    masks = {(f["frame"], f["cam"]): chosen("masks", f"{f['frame']:04d}_{f['cam']}.png") for f in train}
    flows = {r: chosen("voxel_flow", f"{r:04d}.npz") for r in range(transforms["num_frames"]) if r not in held}
    return transforms, train, test, masks, flows


def test_the_loader_holds_out_what_the_dataset_holds_out(scene):
    dataset = Dataset.open(scene[0])
    transforms, train, test, masks, flows = load(scene[1], test_every=4)
    first = HELD_OUT[0]
    assert transforms["format"] == "fire-bundle-v2" and transforms["num_frames"] == FRAMES - first
    assert sorted({f["frame"] + first for f in test}) == list(HELD_OUT)
    assert len(train) == 3 * (FRAMES - first - 3) == len(masks) and len(flows) == FRAMES - first - 3
    assert transforms["held_out_every"] == 4, "what their trainer has to be told, where it is not 8"
    assert transforms["num_cams"] == 3 and transforms["dt"] == pytest.approx(1000 * DT)
    for f in (*train, *test):
        frame = f["frame"] + first
        theirs, ours = scene[1] / f["file_path"], dataset.file(f["cam"], "rgb", frame)
        assert theirs.read_bytes() == ours.read_bytes()
        assert f["time"] == pytest.approx(1000 * (DT * frame + (0.004 if f["cam"] == 1 else 0))), "ms"


def test_points_land_on_the_same_pixels(scene):
    """A camera is an angle and an OpenGL pose there: x right, y up, z backward, the principal point in the middle."""
    dataset = Dataset.open(scene[0])
    point = np.array([0.1, -0.2, 1.3])
    for f in json.loads((scene[1] / "transforms.json").read_text())["frames"][:: FRAMES - 2]:
        camera = dataset.cameras[f["cam"]]
        x, y, z = (np.linalg.inv(f["transform_matrix"]) @ [*point, 1])[:3]
        focal = camera.width / (2 * np.tan(f["camera_angle_x"] / 2))
        pixel = [camera.width / 2 + focal * x / -z, camera.height / 2 - focal * y / -z]
        np.testing.assert_allclose(pixel, camera.project(point[None])[0][0], atol=1e-9)


def test_flow_is_the_flames_in_metres_per_frame(scene):
    """The trainer divides by `dt` and starts Gaussians at the grid's places; the flame rises at a known speed."""
    transforms, _, _, _, flows = load(scene[1], test_every=4)
    grid = np.load(scene[1] / "voxel_flow" / "grid.npz")
    coordinates, size = grid["coordinates"], float(grid["voxel_size"])
    np.testing.assert_allclose(np.diff(coordinates, axis=0)[..., 0], size)
    np.testing.assert_allclose(np.diff(coordinates, axis=2)[..., 2], size)
    np.testing.assert_allclose(grid["bbox"][:, 1] - grid["bbox"][:, 0], size * np.array(coordinates.shape[:3]))
    speeds, places = [], []
    for path in flows.values():
        flow = np.load(path)["flows"]
        assert flow.shape == coordinates.shape and flow.dtype == np.float32
        known = np.isfinite(flow).all(-1)
        speeds.append(flow[known] / transforms["dt"] * 1000)
        places.append(coordinates[known])
    speeds, places = np.concatenate(speeds), np.concatenate(places)
    assert len(speeds) > 1000 and 0.65 < np.median(speeds[:, 2]) / RISE[2] < 1.1, "their ridge makes it slower"
    assert np.abs(np.median(speeds[:, :2], 0)).max() < 0.25
    assert np.abs(np.median(places[:, :2], 0)).max() < 0.1, "around the axis the flame was drawn around"


def test_masks_have_the_channels_their_code_reads(scene):
    _, _, test, masks, _ = load(scene[1], test_every=4)
    dataset = Dataset.open(scene[0])
    plate = dataset.static(0)
    for (r, c), path in masks.items():
        blue, green, red = cv2.split(cv2.imread(str(path)))
        assert set(np.unique(green)) <= {0, 255} and not red.any(), "no board in this scene"
        assert ((blue == 255) >= (green == 255)).all() and blue.sum() > green.sum()
        if c == 0:
            bright = (dataset.image(0, r + HELD_OUT[0]) - plate)[..., 0] > 0.4
            assert bright.any() and green[bright].mean() > 0.99 * 255, "the flame is in its mask"
    assert not cv2.imread(str(scene[1] / "sync_mask" / "0.png")).any()
    assert all((scene[1] / "mono_depth" / Path(f["file_path"]).name).is_file() for f in test)


@pytest.mark.slow
def test_a_board_is_red_and_no_flame(tmp_path):
    folder = write_dataset(tmp_path / "flame")
    views.write("firebundle", folder)  # and then over it
    board = np.zeros((96, 48), np.uint8)
    board[30:60, 15:30] = 255  # in front of the flame
    cv2.imwrite(str(folder / "board.png"), board)
    edit(folder, lambda meta: [camera.update(board_mask="board.png") for camera in meta["cameras"]])
    views.write("firebundle", folder)
    blue, green, red = cv2.split(cv2.imread(str(folder / "fire_bundle/masks/stride1/0001_0.png")))
    np.testing.assert_array_equal(red, board)
    assert not green[board > 0].any() and not blue[board > 0].any() and green.any()
    np.testing.assert_array_equal(cv2.imread(str(folder / "fire_bundle/sync_mask/0.png"), 0), board)


def test_the_background_is_the_wall(scene):
    vertex, _ = read_ply(scene[1] / "static_point_cloud.ply")
    assert not [name for name in vertex.dtype.names if name.startswith("f_rest")], "their trainer has degree 0"
    np.testing.assert_allclose(vertex["y"], WALL, atol=1e-4)
    dataset = Dataset.open(scene[0])
    # Colours: the constant harmonic, as 3DGS reads it, is the plate's pixel where the first camera's points are.
    points = np.stack([vertex["x"], vertex["y"], vertex["z"]], 1)[: len(vertex["x"]) // 3]
    shown = 0.5 + 0.28209479177387814 * np.stack([vertex[f"f_dc_{i}"] for i in range(3)], 1)[: len(points)]
    columns, rows = np.floor(dataset.cameras[0].project(points)[0]).astype(int).T
    np.testing.assert_allclose(shown, dataset.static(0)[rows, columns], atol=1e-3)
    np.testing.assert_allclose(1 / (1 + np.exp(-vertex["opacity"])), 0.9, atol=1e-3)


@pytest.mark.slow
def test_a_held_out_picture_changes_nothing_to_train_on(scene, tmp_path):
    """The same scene with another picture in every held-out frame: what is trained on stays as it is, bit by bit."""

    def ruined(images):
        images = images.copy()
        images[list(HELD_OUT)] = np.random.default_rng(3).random(images[list(HELD_OUT)].shape)
        return images

    folder = write_dataset(tmp_path / "flame", late={1: 0.004}, change=ruined)
    views.write("firebundle", folder)
    _, _, test, masks, flows = load(scene[1], test_every=4)
    _, _, _, other_masks, other_flows = load(folder / "fire_bundle", test_every=4)
    for one, two in zip([*masks.values()], [*other_masks.values()], strict=True):
        np.testing.assert_array_equal(cv2.imread(str(one)), cv2.imread(str(two)))
    for one, two in zip(flows.values(), other_flows.values(), strict=True):
        np.testing.assert_array_equal(np.load(one)["flows"], np.load(two)["flows"])
    for name in ("static_point_cloud.ply", "voxel_flow/grid.npz"):
        assert (scene[1] / name).read_bytes() == (folder / "fire_bundle" / name).read_bytes()
    different = [
        (scene[1] / f["file_path"]).read_bytes() != (folder / "fire_bundle" / f["file_path"]).read_bytes() for f in test
    ]
    assert all(different), "the test can fail: the held-out pictures do differ"


def test_what_the_bundle_cannot_say_is_refused(tmp_path):
    folder = write_dataset(tmp_path / "flame")
    edit(folder, lambda meta: meta["splits"].update(train=[0, 1, 3, 4, 5], test=[2, 6, 11]))
    with pytest.raises(DataFormatError, match=r"\[2, 6, 11\].*every n-th"):
        views.write("firebundle", folder)
    edit(folder, lambda meta: meta["splits"].update(train=[0, 1, 3, 4, 5], test=[2]))
    edit(folder, lambda meta: meta["cameras"][1]["K"][0].__setitem__(2, 25.0))
    with pytest.raises(DataFormatError, match="cam_1' is off centre"):
        views.write("firebundle", folder)
    assert not (folder / "fire_bundle" / "transforms.json").exists()
