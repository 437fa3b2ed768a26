"""Undistorting, turning and row delays against pictures whose content says where each pixel came from."""

import cv2
import numpy as np
import pytest

from gof.errors import DataFormatError
from gof.io.files import write_json
from gof.lens import Lens, prepare, read_cameras, row_delay

LENS = Lens(
    320, 180, np.array([[280.0, 0, 163], [0, 280.5, 88], [0, 0, 1]]), np.array([-0.25, 0.06, 0.0005, -0.0005, 0.0])
)
# A sensor reads its rows downwards; where later rows lie after the picture is turned.
TURNS = [
    ("none", "down", None),
    ("clockwise", "left", cv2.ROTATE_90_CLOCKWISE),
    ("counterclockwise", "right", cv2.ROTATE_90_COUNTERCLOCKWISE),
]


@pytest.mark.parametrize("turn, readout, code", TURNS)
def test_row_delay_is_that_of_the_line_a_pixel_came_from(turn, readout, code):
    """A picture of its own row numbers, prepared like footage, holds the line of every pixel."""
    rows = np.repeat(np.arange(180, dtype=np.float32)[:, None], 320, 1)
    prepared = prepare(rows, LENS, turn)
    delay = row_delay(LENS, turn, readout, 2e-6)
    assert delay.shape == prepared.shape
    inside = prepare(np.ones_like(rows), LENS, turn) == 1
    inside &= (delay > 2e-6) & (delay < 2e-6 * 178)  # OpenCV blends border pixels with black
    assert inside.mean() > 0.9
    np.testing.assert_allclose(delay[inside], 2e-6 * prepared[inside], atol=0.05 * 2e-6)


@pytest.mark.parametrize("turn, readout, code", TURNS)
def test_without_distortion_rows_stay_lines(turn, readout, code):
    plain = Lens(320, 180, LENS.K)
    picture = np.random.default_rng(0).integers(0, 255, (180, 320), dtype=np.uint8)
    np.testing.assert_array_equal(prepare(picture, plain, turn), picture if code is None else cv2.rotate(picture, code))
    line = 1e-6 * np.arange(180)
    expected = {"none": line[:, None], "clockwise": line[None, ::-1], "counterclockwise": line[None]}[turn]
    delay = row_delay(plain, turn, readout, 1e-6)
    np.testing.assert_allclose(delay, np.broadcast_to(expected, delay.shape), atol=1e-15)


def test_barrel_distortion_matters_to_the_row_delay():
    """Bent lines: tens of microseconds at the corners, at the sensor's row time of 2.85 us for 720 rows."""
    bent = row_delay(LENS, "clockwise", "left", 4 * 2.85e-6)
    straight = row_delay(Lens(320, 180, LENS.K), "clockwise", "left", 4 * 2.85e-6)
    assert 30e-6 < np.abs(bent - straight).max() < 300e-6
    centre = np.abs(bent - straight)[140:180, 80:100]
    assert centre.max() < 1e-6


def test_turned_intrinsics_see_the_same_rays():
    for turn in ("clockwise", "counterclockwise"):
        pinhole = LENS.turned(turn)
        at = Lens(320, 180, LENS.K).before_undistortion(turn)
        assert at.shape == (pinhole.height, pinhole.width, 2)
        y, x = np.mgrid[: pinhole.height, : pinhole.width] + 0.5
        np.testing.assert_allclose(at, np.stack([x, y], -1), atol=1e-12)
    # The direction to the right in the stored picture points down after a clockwise turn.
    assert LENS.turned("clockwise").K[1, 2] == LENS.K[0, 2] and LENS.turned("clockwise").K[0, 2] == 180 - LENS.K[1, 2]


def test_lens_files(tmp_path):
    write_json(tmp_path / "c.json", {"cameras": [LENS.to_dict()]})
    entries = read_cameras(tmp_path / "c.json", 3)
    assert len(entries) == 3
    back = Lens.from_dict(entries[2], "c.json: camera 2")
    np.testing.assert_array_equal(back.K, LENS.K)
    np.testing.assert_array_equal(back.distortion, LENS.distortion)
    write_json(tmp_path / "two.json", {"cameras": [LENS.to_dict()] * 2})
    with pytest.raises(DataFormatError, match=r"two\.json: 'cameras' must list one entry, or one per video \(3\)"):
        read_cameras(tmp_path / "two.json", 3)
    with pytest.raises(DataFormatError, match=r"none\.json: no such file"):
        read_cameras(tmp_path / "none.json", 3)
