"""What cameras, clocks and flames do in practice: each case on a small flame whose truth is known."""

import shutil

import cv2
import numpy as np
import pytest

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.reconstruct.observation import observe
from tests.reconstruct.rising_flame import DT, RISE, edit, held_out, mean_velocity, reconstruct, write_flame

pytestmark = pytest.mark.long

SMALL = {"gaussians": 1000, "iterations": 120, "voxels": 24}


def run(dataset, out, **changes):
    result = reconstruct(dataset, out, **SMALL | changes)
    return held_out(result), TransientGaussians.load(result)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The flame as it should be filmed, and its scores."""
    folder = write_flame(tmp_path_factory.mktemp("plain") / "flame")
    return folder, *run(folder, folder.parent / "out")


def test_camera_clock_off_by_half_a_frame(tmp_path):
    dt = 0.05  # 2 px a frame
    late = write_flame(tmp_path / "late", dt=dt, late={1: dt / 2})
    known, gaussians = run(late, tmp_path / "out")
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.4)
    together, _ = run(write_flame(tmp_path / "together", dt=dt), tmp_path / "together_out")
    assert known.psnr_flame > together.psnr_flame - 0.5, "known clocks cost nothing"
    wrong, _ = run(late, tmp_path / "wrong", ablation="no-sync")
    assert wrong.psnr_flame < known.psnr_flame - 0.15, "wrong clocks do"


def test_flow_uses_the_cameras_own_frame_times(tmp_path, plain):
    """A camera whose clock runs at half speed sees half the speed in px/s."""
    slow = shutil.copytree(plain[0], tmp_path / "slow")
    edit(slow, lambda meta: meta["cameras"][1].update(time_s=[2 * t for t in meta["time_s"]]))
    flow, base = (observe(Dataset.open(folder)).flow[:, 1] for folder in (slow, plain[0]))
    np.testing.assert_allclose(flow, base / 2, rtol=1e-5)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_scene_in_other_units_is_the_same_scene(tmp_path, plain, factor):
    scaled = shutil.copytree(plain[0], tmp_path / "scaled")

    def change(meta):
        for camera in meta["cameras"]:
            for row in camera["world_to_camera"][:3]:
                row[3] *= factor

    scores, gaussians = run(edit(scaled, change), tmp_path / "out")
    assert scores.psnr_flame == pytest.approx(plain[1].psnr_flame, abs=0.3)
    # Voxels on the very edge of a mask may fall to either side, and then seeds are other ones.
    np.testing.assert_allclose(mean_velocity(gaussians) / factor, mean_velocity(plain[2]), atol=0.05)


def test_time_in_milliseconds_is_the_same_flame(tmp_path, plain):
    scaled = shutil.copytree(plain[0], tmp_path / "scaled")
    scores, gaussians = run(
        edit(scaled, lambda meta: meta.update(time_s=[1e3 * t for t in meta["time_s"]])), tmp_path / "out"
    )
    assert scores.psnr_flame == pytest.approx(plain[1].psnr_flame, abs=0.3)
    np.testing.assert_allclose(mean_velocity(gaussians) * 1e3, mean_velocity(plain[2]), atol=0.03)


def test_camera_lost_for_some_frames(tmp_path, plain):
    def lose(images):
        images[2:4, 0] = 0
        images[6, 2] = 0
        return images

    folder = write_flame(tmp_path / "lost", change=lose)
    missing = np.argwhere(~observe(Dataset.open(folder)).delivered)
    assert missing.tolist() == [[2, 0], [3, 0], [5, 2]], "training frame 5 is frame 6, frame 4 is held out"
    scores, gaussians = run(folder, tmp_path / "out")
    assert scores.psnr_flame > plain[1].psnr_flame - 1.5
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.4)


def test_frames_without_fire(tmp_path):
    """The flame goes out for the last frames: empty masks, and nothing is seen there."""

    def put_out(images):
        images[6:] = np.median(images, axis=0) * 0 + 0.2
        return images

    folder = write_flame(tmp_path / "out_of_fuel", change=put_out)
    shutil.rmtree(folder / "static")
    for c in range(3):  # the same plain wall everywhere, so that the last frames equal the plates
        (folder / "static").mkdir(exist_ok=True)
        shutil.copy(folder / f"cameras/cam_{c}/rgb/000009.png", folder / f"static/cam_{c}.png")
    motion = observe(Dataset.open(folder))
    assert not motion.mask[-3:].any() and motion.mask[:4].any()
    scores, gaussians = run(folder, tmp_path / "out")
    assert np.isfinite(scores.psnr_flame)
    _, late = gaussians.at(9 * DT)
    _, early = gaussians.at(2 * DT)
    assert late.sum() < 0.5 * early.sum()


def test_saturated_frames(tmp_path):
    def overexpose(images):
        images[3:6] = np.clip(images[3:6] * 4, 0, 1)
        return images

    scores, gaussians = run(write_flame(tmp_path / "bright", change=overexpose), tmp_path / "out")
    assert np.isfinite(scores.psnr_flame) and np.isfinite(gaussians.velocity).all()


def test_background_brighter_than_the_flame(tmp_path):
    """A window behind the left half of the picture: only where light is not clipped can the fire be seen."""

    def window(images):
        images[..., :24, :] = np.clip(images[..., :24, :] + 0.7, 0, 1)
        return images

    folder = write_flame(tmp_path / "window", change=window)
    for path in (folder / "static").glob("*.png"):
        plate = cv2.imread(str(path)).astype(np.float32)
        plate[:, :24] = np.minimum(plate[:, :24] + 0.7 * 255, 255)
        cv2.imwrite(str(path), plate.round().astype(np.uint8))
    scores, gaussians = run(folder, tmp_path / "out")
    assert scores.psnr_flame > 20
    assert mean_velocity(gaussians)[2] == pytest.approx(RISE[2], abs=0.4)


def test_moving_foliage_is_not_flame(tmp_path, plain):
    rng = np.random.default_rng(0)

    def sway(images):
        leaves = rng.uniform(0, 1, (images.shape[2], 20, 1)) ** 2 * [0.25, 0.5, 0.1]
        for frame in images:
            for picture in frame:
                shift = rng.integers(0, 8)
                picture[:, 40:] = np.where(picture[:, 40:, :1] > 0.35, picture[:, 40:], leaves[:, shift : shift + 8])
        return images

    folder = write_flame(tmp_path / "bush", change=sway)
    masks, without = (observe(Dataset.open(f)).mask for f in (folder, plain[0]))
    assert masks[..., 42:].mean() < 0.02 + without[..., 42:].mean(), "leaves do not burn"
    _, gaussians = run(folder, tmp_path / "out")
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.4)


def test_the_sync_boards_leds_are_no_flame(tmp_path, plain):
    """Blinking orange LEDs beside the flame, in every camera: with the board's mask it is as if they were not there."""

    def blink(images):
        images[::2, :, 70:90, 4:12] = [1.0, 0.6, 0.1]
        return images

    folder = write_flame(tmp_path / "board", change=blink)
    believed = observe(Dataset.open(folder)).mask[:, :, 72:88, 5:11]
    assert believed.mean() > 0.4, "otherwise the test says nothing"
    board = np.zeros((96, 48), np.uint8)
    board[66:94, 2:14] = 255
    for c in range(3):
        cv2.imwrite(str(folder / f"cameras/cam_{c}/board_mask.png"), board)
    edit(
        folder,
        lambda meta: [
            camera.update(board_mask=f"cameras/{camera['name']}/board_mask.png") for camera in meta["cameras"]
        ],
    )
    assert not observe(Dataset.open(folder)).mask[:, :, 72:88, 5:11].any()
    scores, gaussians = run(folder, tmp_path / "out")
    assert scores.psnr > plain[1].psnr - 1.5
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.4)


def test_texture_in_one_camera_only(tmp_path):
    """Two cameras see a featureless glow: there is nothing to follow in them, and nothing breaks."""

    def glow(images):
        images[:, 1:] = np.where(images[:, 1:, ..., :1] > 0.45, [1.0, 0.7, 0.2], images[:, 1:])
        return images

    _, gaussians = run(write_flame(tmp_path / "glow", change=glow), tmp_path / "out")
    assert np.isfinite(gaussians.velocity).all() and np.linalg.norm(mean_velocity(gaussians)) < 2 * np.linalg.norm(RISE)


def test_flame_across_the_border(tmp_path):
    folder = write_flame(tmp_path / "near", focal_px=260.0)
    dataset = Dataset.open(folder)
    masks = observe(dataset).mask
    assert masks[:, :, 0].any() and masks[:, :, -1].any(), "the flame leaves the picture at the top and at the bottom"
    scores, gaussians = run(folder, tmp_path / "out")
    assert scores.psnr_flame > 20
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.5)


def test_two_cameras(tmp_path):
    scores, gaussians = run(write_flame(tmp_path / "two", cameras=2), tmp_path / "out")
    assert scores.psnr_flame > 20
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.5)


def test_one_camera_says_that_depth_is_a_guess(tmp_path, capsys):
    scores, gaussians = run(write_flame(tmp_path / "one", cameras=1), tmp_path / "out")
    assert "one camera: depth is a guess" in capsys.readouterr().err
    assert scores.psnr_flame > 20
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.5)


def test_one_frame_is_refused(tmp_path):
    with pytest.raises(GofError, match="single frame has no motion"):
        run(write_flame(tmp_path / "still", frames=1, test_frames=()), tmp_path / "out2")
