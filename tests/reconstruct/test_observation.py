"""Masks and optical flow on pictures whose motion is known, and the rule that held-out frames are never touched."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.footage.flame_mask import flame_mask
from gof.reconstruct.observation import consistency, light_above, observe, own_part
from gof.reconstruct.optical_flow import flow_method
from tests.conftest import arc, write_dataset


def moving_texture(n, shift, shape=(64, 36), seed=0):
    """n frames of a smooth flame-coloured texture that moves by `shift` (x, y) px a frame over a grey plate."""
    rng = np.random.default_rng(seed)
    big = cv2.GaussianBlur(rng.random((200, 200)).astype(np.float32), (0, 0), 2)
    big = (big - big.min()) / np.ptp(big)
    plate = np.full((*shape, 3), 0.2, np.float32)
    frames = []
    for k in range(n):
        move = np.float32([[1, 0, -60 + k * shift[0]], [0, 1, -60 + k * shift[1]]])
        texture = cv2.warpAffine(big, move, shape[::-1])
        frames.append(np.clip(plate + texture[..., None] * [0.8, 0.4, 0.05], 0, 1))
    return np.array(frames), plate


def make(tmp_path, frames, plate, test_frames=(), dt=0.01):
    cameras = arc(2)
    images = np.repeat(frames[:, None], 2, 1)
    return Dataset.open(
        write_dataset(
            tmp_path / "d", cameras, images, [plate, plate], dt * np.arange(len(frames)), test_frames=test_frames
        )
    )


@pytest.mark.parametrize(
    ("method", "off"), [("dis", 0.03), ("tvl1", 0.03), ("deepflow", 0.35)]
)  # DeepFlow smooths small motion away
@pytest.mark.long
def test_flow_is_in_pixels_per_second_of_the_dataset_clock(tmp_path, method, off):
    frames, plate = moving_texture(4, (0.5, -2.0))
    seen = observe(make(tmp_path, frames, plate, dt=0.02), flow=flow_method(method))
    inner = seen.flow[1, 0, 12:-12, 8:-8]
    np.testing.assert_allclose(np.nanmedian(inner, (0, 1)), [0.5 / 0.02, -2.0 / 0.02], atol=2 * off / 0.02)
    assert seen.mask[1, 0].mean() > 0.8


def test_a_learned_flow_without_its_weights_or_package_says_what_is_missing(tmp_path):
    with pytest.raises(GofError, match="--flow-weights"):
        flow_method("memfof")
    with pytest.raises(GofError, match=r"memfof|config\.json"):
        flow_method("memfof", tmp_path)


def test_held_out_frames_are_never_read(tmp_path):
    frames, plate = moving_texture(5, (0, -1.5))
    dataset = make(tmp_path, frames, plate, test_frames=[2])
    for c in range(2):
        dataset.file(c, "rgb", 2).unlink()
    seen = observe(dataset)
    assert seen.frames.tolist() == [0, 1, 3, 4]
    assert np.isfinite(seen.flow).all(-1).mean() > 0.5, "neighbours of a held-out frame use their other side"


def test_lonely_frame_has_no_flow(tmp_path):
    frames, plate = moving_texture(4, (0, -1))
    seen = observe(make(tmp_path, frames, plate, test_frames=[0, 2]))
    assert np.isnan(seen.flow).all()


def test_still_black_and_saturated_pictures(tmp_path):
    plate = np.zeros((64, 36, 3), np.float32)
    with pytest.raises(DataFormatError, match="no flame found"):
        observe(make(tmp_path, np.zeros((3, 64, 36, 3)), plate))
    saturated = np.ones((64, 36, 3)) * [1, 1, 0.3]
    seen = observe(make(tmp_path / "s", np.repeat(saturated[None], 3, 0), plate))
    assert seen.mask.all() and np.nanmax(np.abs(seen.flow)) < 1, "no texture, no motion"


def test_cameras_may_differ_in_size(tmp_path):
    """The smaller's pictures are known in their corner and nowhere else, its lines at the times they were read at."""
    frames, plate = moving_texture(3, (0, -1.5))
    large, small = arc(2)
    small = replace(small.cropped(0, 0, 30, 50), row_time_s=1e-4, readout="up")
    images = [[picture, picture[:50, :30]] for picture in frames]
    data = write_dataset(tmp_path / "d", [large, small], images, [plate, plate[:50, :30]], 0.01 * np.arange(3))
    same = observe(make(tmp_path / "same", frames, plate))
    seen = observe(Dataset.open(data))
    np.testing.assert_array_equal(seen.image[:, 1, :50, :30], same.image[:, 1, :50, :30])
    beyond = np.ones((64, 36), bool)
    beyond[:50, :30] = False
    assert seen.blocked[1][beyond].all() and not seen.blocked[1][~beyond].any() and not seen.blocked[0].any()
    assert not seen.mask[:, 1, beyond].any() and np.isnan(seen.flow[:, 1, beyond]).all()
    # Fourteen lines below are read before the picture's own last one, which is its first.
    np.testing.assert_allclose(seen.camera_time_s[1] - seen.camera_time_s[0], -14e-4)
    assert [own_part(picture, small).shape for picture in seen.plate] == [(50, 30, 3)] * 2


def test_light_thrown_on_a_wall_is_not_flame():
    plate = np.full((40, 40, 3), 0.3, np.float32)
    picture = plate + 0.1
    picture[10:20, 10:20] = [1, 0.7, 0.2]
    mask = flame_mask(picture, plate, grow_px=1)
    assert mask[12:18, 12:18].all() and not mask[25:].any()
    assert light_above(plate - 0.1, plate).max() == 0, "darker than the plate is not light"


def test_consistency_of_exact_and_wrong_flow():
    there = np.zeros((20, 20, 2), np.float32) + np.float32([3, 0])
    error = consistency(there, -there)
    assert error[:, :16].max() == 0 and np.isinf(error[:, 18:]).all(), "leaves the picture"
    assert consistency(there, there)[10, 5] == 6
