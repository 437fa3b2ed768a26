"""Videos as phones, cheap cameras and broken copies leave them: read rightly, or refused by name."""

import numpy as np
import pytest

from gof.commands.ingest import IngestConfig, ingest
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.footage.videos import chosen_frames, read_info, stated_fps, stated_frames, stated_info, stored_frames
from gof.ingest.footage import Footage
from gof.ingest.frame_times import Timing
from tests.ingest.scene import FOCAL, HEIGHT, WIDTH, cameras, draw
from tests.videos import cut_off, number_of, numbered, set_steps, tag_matrix, tag_rotation, write_video

pytestmark = pytest.mark.long


def files(folder, *changes, count=30, fps=30.0):
    """One video of `numbered` pictures per change, which is a function of its path."""
    paths = [write_video(folder / f"cam_{c}.mp4", numbered(count), fps) for c in range(len(changes))]
    for path, change in zip(paths, changes, strict=True):
        change(path)
    return paths


def as_it_is(path):
    return path


def test_what_a_file_says_is_read(tmp_path):
    path = write_video(tmp_path / "a.mp4", numbered(30), 25.0)
    info = read_info(path)
    assert (info.width, info.height, info.stated_fps, info.stated_frames, info.frames) == (96, 64, 25.0, 30, 30)
    assert (info.rotation_deg, info.bits, info.breaks_off) == (0, 8, False)
    np.testing.assert_allclose(info.stamps_s, np.arange(30) / 25, atol=1e-6)
    assert stated_fps(path) == 25 and stated_frames(path) == 30
    assert [number_of(frame) for frame in chosen_frames(path, [0, 3, 4, 29])] == [0, 3, 4, 29]
    with pytest.raises(DataFormatError, match="has 30 frames, 31 are wanted"):
        list(chosen_frames(path, [2, 30]))
    uneven = read_info(set_steps(path, [1] * 9 + [3] + [1] * 20))
    assert np.diff(uneven.stamps_s)[9] == pytest.approx(3 / 25) and uneven.usual_step_s == pytest.approx(1 / 25)
    noise = tmp_path / "noise.mp4"
    noise.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(DataFormatError, match=r"noise.mp4: OpenCV reads no frame"):
        read_info(noise)


@pytest.mark.parametrize("degrees, corner", [(0, (0, 0)), (90, (0, -1)), (180, (-1, -1)), (270, (-1, 0))])
def test_the_rotation_tag_makes_pictures_upright(tmp_path, degrees, corner):
    """The white corner, above on the left as stored, goes where a player puts it."""
    videos = files(tmp_path, *[lambda path: tag_rotation(path, degrees)] * 2)
    with videos[1].open("ab") as video:
        video.write(b"\0\0\0\x08free")  # an empty box: pictures alike, and yet another file
    assert all(read_info(video).rotation_deg == degrees for video in videos)
    assert next(iter(stored_frames(videos[0]))).shape == (64, 96, 3), "stored pictures are not turned"
    footage = Footage.open(videos, "auto", None, 50.0)
    picture = next(iter(footage.clips(footage.frame_times(Timing(fps=(100.0,))).frames)[0]))
    lens = footage.upright_lenses[0]
    assert picture.shape == (lens.height, lens.width, 3)
    assert picture.shape[:2] == ((96, 64) if degrees in (90, 270) else (64, 96))
    corners = {(y, x): float(picture[y, x].mean()) for y in (0, -1) for x in (0, -1)}
    assert max(corners, key=corners.get) == corner and corners[corner] > 200
    as_stored = Footage.open(videos, "none", None, 50.0)
    assert as_stored.turns == ("none", "none"), "--turn overrides the tag"


def test_each_file_is_turned_by_its_own_tag(tmp_path):
    """One phone hung upside down; and one that stood, its picture stored lying, beside one that stores it standing."""
    videos = files(tmp_path, lambda path: tag_rotation(path, 180), as_it_is)
    footage = Footage.open(videos, "auto", None, 50.0)
    assert footage.turns == ("half", "none") and "each is turned by its own" in " ".join(footage.notes)
    clips = footage.clips(footage.frame_times(Timing(fps=(100.0,))).frames)
    corners = [[float(next(iter(clip))[y, x].mean()) for y, x in ((0, 0), (-1, -1))] for clip in clips]
    assert corners[0][1] > 200 > 100 > corners[0][0] and corners[1][0] > 200 > 100 > corners[1][1]
    standing = write_video(tmp_path / "standing.mp4", numbered(30, (64, 96)))
    lying = tag_rotation(videos[0], 90)
    footage = Footage.open([lying, standing], "auto", None, 50.0)
    assert footage.turns == ("clockwise", "none")
    assert [next(iter(clip)).shape for clip in footage.all_clips()] == [(96, 64, 3)] * 2


def test_a_lost_tag_is_named_and_every_camera_can_be_turned_by_hand(tmp_path):
    videos = files(tmp_path, lambda path: tag_rotation(path, 90), as_it_is)
    said = r"cam_0.mp4: tag 90, so its picture stands; cam_1.mp4: tag none, so its picture lies.*--turn clockwise none"
    with pytest.raises(GofError, match=said):
        Footage.open(videos, "auto", None, 50.0)
    assert Footage.open(videos, "clockwise", None, 50.0).upright_lenses[0].width == 64
    assert Footage.open(videos, ["auto", "clockwise"], None, 50.0).turns == ("clockwise", "clockwise")
    with pytest.raises(GofError, match="one for each of the 2"):
        Footage.open(videos, ["none"] * 3, None, 50.0)


def test_a_file_that_breaks_off_is_refused_with_its_counts(tmp_path, capfd):
    videos = files(tmp_path, as_it_is, lambda path: cut_off(path, 0.5))
    info = read_info(videos[1])
    assert info.stated_frames == 30 and 5 < info.frames < 25 and info.breaks_off
    footage = Footage.open(videos, "auto", None, 50.0)
    with pytest.raises(DataFormatError, match=rf"cam_1.mp4: breaks off: {info.frames} of the 30 frames.*--frames"):
        footage.frame_times(Timing(fps=(400.0,)))
    times = footage.frame_times(Timing(fps=(400.0,), limit=5))
    assert len(times.frames[0]) == 5 and any("of the 30 frames that it states" in note for note in times.notes)
    avi = write_video(tmp_path / "b.avi", numbered(30))
    avi.write_bytes(avi.read_bytes()[: avi.stat().st_size // 2])
    assert read_info(avi).breaks_off


def test_lengths_rates_and_stamps_of_real_files(tmp_path):
    whole, short = files(tmp_path, as_it_is, as_it_is)
    write_video(short, numbered(20))
    with pytest.raises(GofError, match=r"differ in length \(frames: cam_0.mp4 30, cam_1.mp4 20\)"):
        Footage.open([whole, short], "auto", None, 50.0).frame_times(Timing(fps=(400.0,)))
    half = write_video(tmp_path / "half.mp4", list(numbered(30))[::2], 15.0)
    footage = Footage.open([whole, half], "auto", None, 50.0)
    with pytest.raises(GofError, match=r"cam_0.mp4 30, half.mp4 15 frames per second"):
        footage.frame_times(Timing(fps=(400.0,)))
    for timing in (Timing(fps=(400.0, 200.0)), Timing(stamps=True)):
        clips = footage.clips(footage.frame_times(timing).frames)
        assert [[number_of(f) for f in clip] for clip in clips] == [list(range(0, 30, 2))] * 2
    kept = [k for k in range(30) if k not in (10, 11, 20)]
    lacking = write_video(tmp_path / "vfr.mp4", [p for k, p in enumerate(numbered(30)) if k in kept])
    set_steps(lacking, [*np.diff(kept).tolist(), 1])
    footage = Footage.open([whole, lacking], "auto", None, 50.0)
    times = footage.frame_times(Timing(fps=(400.0,), start=(0, 0)))
    assert [[number_of(f) for f in clip] for clip in footage.clips(times.frames)] == [kept] * 2
    np.testing.assert_allclose(times.time_s[0], np.array(kept) / 400, atol=1e-9)
    assert "vfr.mp4: 3 frames are missing, first after frame 9; left out for all" in times.notes
    # Without a start for each camera the same works: both last as long.
    assert footage.frame_times(Timing(fps=(400.0,))).frames[0].tolist() == kept


def test_sizes_may_differ_and_it_is_said(tmp_path):
    large = write_video(tmp_path / "a.mp4", numbered(5))
    small = write_video(tmp_path / "b.mp4", numbered(5, (48, 32)))
    assert Footage.open([large, small], "auto", None, 50.0).notes == (
        "the videos differ in size (96x64, 48x32) and --fov is taken for each of them",
    )


def test_phones_that_film_upright_make_a_dataset_that_stands(tmp_path):
    """Drawn pictures laid on their side and tagged 90, as a phone stores them, give the dataset of the upright ones."""
    pytest.importorskip("pycolmap")
    rig = cameras()
    videos = []
    for c, camera in enumerate(rig):
        lying = np.rot90(draw(camera)[0])  # counterclockwise: a player turns it clockwise
        videos.append(tag_rotation(write_video(tmp_path / f"phone_{c}.mp4", [lying] * 4), 90))
    fov = float(np.rad2deg(2 * np.arctan(HEIGHT / 2 / FOCAL)))  # along the stored, lying picture
    made = ingest(IngestConfig(videos, tmp_path / "set", fov=fov, times=("30",), board="none"))
    dataset = Dataset.open(made.folder)
    assert (dataset.cameras[0].width, dataset.cameras[0].height) == (WIDTH, HEIGHT)
    assert dataset.cameras[0].K[0, 0] == pytest.approx(FOCAL, rel=1e-6)
    assert all(camera.world_to_camera[1, 2] < -0.9 for camera in dataset.cameras), "pictures' down is the world's -Z"
    said = dataset.description.provenance["videos"][0]
    assert (said["rotation_deg"], said["width"], said["frames"], said["stated_fps"]) == (90, HEIGHT, 4, 30.0)
    assert dataset.description.cameras[0].roll_deg == 90


@pytest.mark.parametrize(
    "matrix", [(-1, 0, 0, 1), (1, 0, 0, -1), (0, 1, 1, 0)], ids=["sideways", "upside down", "turned"]
)
def test_mirrored_films_are_refused(tmp_path, matrix):
    (path,) = files(tmp_path, lambda path: tag_matrix(path, *matrix))
    with pytest.raises(DataFormatError, match=r"cam_0.mp4: its matrix says mirrored"):
        stated_info(path)
