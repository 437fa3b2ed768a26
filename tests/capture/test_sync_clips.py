"""The real three-camera clips: figures measured on them before, by other means, and the wiring fault of one capture.

Skipped where the clips are absent (GOF_CAPTURES names their folder)."""

import numpy as np
import pytest

from gof.capture.board_points import points_on
from gof.capture.decode import DecodeOptions
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from tests.capture.marked_views import MARKED

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def sync(clips):
    done = {}

    def run(scene, cameras=(0, 1, 2)):
        key = (scene, cameras)
        if key not in done:
            videos = [clips / scene / f"cam_{k}.mp4" for k in cameras]
            done[key] = synchronise(videos, BoardTemplate.load("paper_rig"), [DecodeOptions()] * len(videos))
        return done[key]

    return run


@pytest.mark.parametrize(
    "scene, readout",
    [("capture_04/scene_0010", "left"), ("capture_05/scene_0006", "left"), ("capture_03/scene_0004", "right")],
)
def test_slope_residual_and_row_direction(sync, scene, readout):
    for camera in sync(scene).cameras:
        times = camera.times
        assert times.frame_interval_us == pytest.approx(2500.0, abs=0.1)
        assert times.rms_us <= 9 and times.max_residual_us < 25
        # Tied strips leave some frames without an edge in view; they are marked, the clock carries on.
        assert times.outliers <= (10 if times.faults else 2)
        assert times.readout == readout and times.row_time_us == pytest.approx(4.08, abs=0.08)
        assert times.count.agreement > 0.995


def test_well_wired_captures_have_no_fault_and_capture_03_names_its_own(sync):
    for scene in ("capture_04/scene_0010", "capture_05/scene_0006"):
        assert all(camera.times.faults == () for camera in sync(scene).cameras)
    for camera in sync("capture_03/scene_0004").cameras:
        assert camera.times.faults == ("strips 1, 2, 3 are tied together: all are lit in slots 1..3",)


def test_counts_and_offsets_between_cameras(sync):
    """Counts were read off the LEDs before, offsets measured with another decoder (top row; up to 30 us systematic)."""
    result = sync("capture_05/scene_0006")
    starts = [camera.times.frames[0].time_s for camera in result.cameras]
    assert [int(t / 0.004) for t in starts] == [6544, 6544, 6544]
    offsets = [nearest.offset_us for nearest in result.nearest_frames.values()]
    np.testing.assert_allclose(offsets, [0, -646, 635], atol=30)
    assert result.cameras[1].times.count.candidates > 1  # its lower LEDs are cut off; the count is cam_0's
    c10 = [nearest.offset_us for nearest in sync("capture_04/scene_0010").nearest_frames.values()]
    assert c10[2] - c10[0] == pytest.approx(904, abs=30)


def test_half_a_marker_is_an_error_for_that_camera_only(sync):
    whole, cut = sync("capture_04/scene_0005", (0, 1)).cameras
    assert whole.times.rms_us <= 9 and whole.error is None
    assert cut.times is None and "marker 0" in cut.error


@pytest.mark.parametrize("scene", ["capture_04/scene_0005", "capture_04/scene_0007"])
def test_half_markers_are_read_by_marked_points(clips, scene):
    """Views whose marker the picture's edge cuts off; the marks are moved by a pixel, as other hands would."""
    board = BoardTemplate.load("paper_rig")
    off = np.random.default_rng(5)
    marked = {
        name: points_on(
            board, *({k: np.add(xy, off.normal(0, 1, 2)) for k, xy in kind.items()} for kind in marks), name
        )
        for name, marks in MARKED[scene].items()
    }
    videos = [clips / scene / f"cam_{k}.mp4" for k in range(3)]
    cameras = synchronise(videos, board, [DecodeOptions()] * 3, points=marked).cameras
    first = cameras[0].times
    for camera in cameras:
        times = camera.times
        assert times.clock == first.clock and times.rms_us < 5 and times.readout == first.readout
        assert times.row_time_us == pytest.approx(first.row_time_us, abs=0.08)
        assert abs(times.frames[0].time_s - first.frames[0].time_s) < 0.00125, "as near as in the rig's other clips"
