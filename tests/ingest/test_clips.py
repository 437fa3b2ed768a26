"""Plates, footage, and the whole command on a small drawn fire."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.commands.ingest import IngestConfig, fire_left_in_words, ingest
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.dataset.poses import PointCheck, Poses
from gof.footage.lens import Lens, prepare
from gof.footage.videos import stated_info
from gof.ingest import plates
from gof.ingest.axes import metric_scale
from gof.ingest.fire_free import around, read_plates
from gof.ingest.footage import Footage, PreparedClip
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.over_time import LUMA, darkest, largest_change, median
from gof.ingest.pose_clues import PoseOptions
from gof.ingest.sfm import PoseError
from tests.ingest.scene import FOCAL, HEIGHT, WIDTH, cameras, draw, pose_errors
from tests.videos import tag_rotation, write_video

pytestmark = pytest.mark.long


def by_hand(camera) -> dict:
    """A camera as people write it into cameras.json."""
    return {key: camera.to_dict()[key] for key in ("name", "width", "height", "K", "world_to_camera")}


def burning(picture: np.ndarray, frames: int, centre, seed=0, noise=0.0) -> np.ndarray:
    """(T, H, W, 3) uint8: an orange spot that wanders around `centre`; every pixel is free of it in some frame."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    clip = []
    for k in range(frames):
        cx, cy = centre[0] + 8 * np.sin(2 * np.pi * k / frames), centre[1] - 20 * (k / frames - 0.5) * 2
        glow = np.exp(-0.5 * (((x - cx) / 5) ** 2 + ((y - cy) / 7) ** 2))[..., None]
        clip.append(np.clip(picture + glow * [230, 140, 20] + rng.normal(0, noise, picture.shape), 0, 255))
    return np.uint8(np.rint(clip))


def psnr(a, b):
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2))


def test_a_plate_that_is_brought_is_the_picture_not_what_lies_beside_it(tmp_path):
    """The benchmark's scenes have cam_0.exr, in linear light, beside cam_0.png."""
    picture = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    (tmp_path / "cam_0.exr").write_bytes(b"no picture of OpenCV's")
    lens = Lens.from_fov(32, 24, 60)
    with pytest.raises(DataFormatError, match=r"no picture cam_0\.png there, but cam_0\.exr; --plates wants"):
        plates.find_plates(tmp_path, ["cam_0"])
    cv2.imwrite(str(tmp_path / "cam_0.png"), picture[..., ::-1])
    (tmp_path / "._cam_0.png").write_bytes(b"AppleDouble")
    assert plates.find_plates(tmp_path, ["cam_0"]) == [tmp_path / "cam_0.png"]
    np.testing.assert_array_equal(plates.read_plate(tmp_path / "cam_0.png", lens), picture)
    (tmp_path / "cam_0.JPG").write_bytes(b"another one")
    with pytest.raises(DataFormatError, match=r"cam_0\.JPG: and cam_0\.png are both plates of cam_0"):
        plates.find_plates(tmp_path, ["cam_0"])


def test_a_film_without_fire_is_a_plate(tmp_path):
    """The median of its frames: sparks and passers-by of single frames are not in it."""
    still = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (64, 96, 3), np.uint8), (0, 0), 4)
    frames = [still.copy() for _ in range(9)]
    frames[4][20:30, 20:30] = 255
    path = write_video(tmp_path / "cam_0.mp4", frames)
    assert plates.find_plates(tmp_path, ["cam_0"]) == [path]
    found = plates.read_plate(path, Lens.from_fov(96, 64, 60))
    assert np.abs(found.astype(int) - still).mean() < 4 and np.abs(found.astype(int) - still).max() < 40
    with pytest.raises(DataFormatError, match=r"cam_0\.mp4: frame 0 is 96x64, the lens is given for 90x64"):
        plates.read_plate(path, Lens.from_fov(90, 64, 60))
    with pytest.raises(DataFormatError, match="turned by 90 degrees, its camera's footage by 0"):
        plates.read_plate(tag_rotation(path, 90), Lens.from_fov(96, 64, 60))


def test_plates_remove_fire_and_steady_has_no_noise_bias():
    truth = draw(cameras()[0])[0]
    clip = burning(truth, 40, (110, 170), noise=3)
    low = darkest(clip)
    steady = plates.steady(clip, low, plates.fire_reached(clip, low))
    burnt = plates.fire_reached(clip, low)
    assert burnt[170, 110] and burnt.mean() < 0.2
    assert psnr(np.median(clip, 0)[burnt], truth[burnt]) < psnr(low[burnt], truth[burnt])
    np.testing.assert_array_equal(low[160:180, 105:115], steady[160:180, 105:115])
    assert (low.astype(float) - truth)[~burnt].mean() < -2 and abs((steady.astype(float) - truth)[~burnt].mean()) < 0.8
    assert psnr(steady, truth) > psnr(low, truth) + 3


def test_steady_keeps_the_minimum_in_a_flame_that_saturates():
    """Red at its limit in every frame: colour does not rise, and the median once put a bright spot into the plate."""
    rng = np.random.default_rng(0)
    clip = np.full((30, 40, 40, 3), 90.0)
    clip[:, 10:30, 10:30] = [255, 130, 30]
    clip[5:, 15:25, 15:25] = [255, 235, 160]  # brighter, and less warm, in most frames
    clip = np.uint8(np.clip(clip + rng.normal(0, 2, clip.shape), 0, 255))
    low = darkest(clip)
    plate = plates.steady(clip, low, plates.fire_reached(clip, low))
    rise = (plate.astype(float) - low) @ LUMA
    assert np.abs(rise[16:24, 16:24]).max() < 1 and rise.max() < plates.MOST_RISE
    clip[:, 5:35, 5:35] = clip[:, 5:35, 5:35] // 2 + 60  # fire that comes and goes around it
    clip[0, 5:35, 5:35] = [200, 120, 20]
    clip[:, 12:28, 12:28] = [255, 130, 30]
    assert plates.fire_reached(clip, darkest(clip))[20, 20], "what fire surrounds"
    left = plates.fire_left(plate, np.ones(low.shape[:2], bool))
    assert left == pytest.approx(400 / 1600, abs=0.01), "the flame never leaves, and that is said"
    assert plates.fire_left(plate, np.zeros(low.shape[:2], bool)) == 0


def test_another_clip_uncovers_what_burns_in_this_one():
    truth = draw(cameras()[0])[0]
    low, other = truth.copy(), np.uint8(np.rint(0.7 * truth))  # the other clip is darker all over
    low[100:140, 80:120] = [255, 160, 40]
    other[10:40, 10:40] = [255, 160, 40]
    reached = np.zeros(low.shape[:2], bool)
    reached[95:145, 75:125] = True
    plate = plates.uncovered(low, reached, [other])
    assert np.abs(plate[100:140, 80:120].astype(float) - truth[100:140, 80:120]).mean() < 2
    np.testing.assert_array_equal(plate[~reached], low[~reached])
    np.testing.assert_array_equal(plates.uncovered(low, reached, []), low)


def test_what_is_found_frame_by_frame_is_what_numpy_finds_in_the_whole_clip():
    rng = np.random.default_rng(3)
    for count in (1, 2, 7, 12):
        clip = rng.integers(0, 256, (count, 9, 11, 3), np.uint8)
        np.testing.assert_array_equal(median(clip), np.sort(clip, 0)[(count - 1) // 2])
        luma = clip @ np.array([0.2126, 0.7152, 0.0722])
        chosen = np.take_along_axis(clip, luma.argmin(0)[None, ..., None], 0)[0]
        np.testing.assert_array_equal(darkest(clip), chosen)
        np.testing.assert_array_equal(largest_change(clip), np.ptp(clip, 0).max(-1))
    extreme = np.array([0, 255, 255], np.uint8)[:, None, None, None] * np.ones((1, 2, 2, 3), np.uint8)
    assert (median(extreme) == 255).all() and (median(extreme[:2]) == 0).all()
    hours = np.repeat(np.array([10, 200], np.uint8), [66_000, 4000])[:, None, None, None]  # more than 16 bits of frames
    assert median(hours).item() == 10


@pytest.mark.parametrize("turn", ["none", "clockwise", "counterclockwise", "half"])
def test_turning_keeps_points_on_their_rays(turn):
    """A spot in the stored picture, undistorted and turned, lies where the turned pinhole projects its ray."""
    lens = Lens(
        200,
        120,
        np.array([[150, 0, 96.0], [0, 152, 63], [0, 0, 1]]),
        np.array([-0.25, 0.05, 0.001, -0.001, 0]),
    )
    ray = np.array([0.32, -0.21, 1.0])
    K = lens.K.copy()
    K[:2, 2] -= 0.5
    pixel = cv2.projectPoints(ray[None], np.zeros(3), np.zeros(3), K, lens.distortion)[0][0, 0]
    y, x = np.mgrid[:120, :200]
    spot = np.exp(-0.5 * ((x - pixel[0]) ** 2 + (y - pixel[1]) ** 2) / 4)
    out = prepare(np.uint8(255 * spot)[..., None].repeat(3, -1), lens, turn)[..., 0].astype(float)
    upright = lens.turned(turn)
    assert out.shape == (upright.height, upright.width)
    x, y, _ = ray
    turned_ray = {"none": ray, "clockwise": [-y, x, 1], "counterclockwise": [y, -x, 1], "half": [-x, -y, 1]}[turn]
    expected = (upright.K @ turned_ray)[:2]
    rows, columns = np.mgrid[: out.shape[0], : out.shape[1]] + 0.5
    found = [(out * columns).sum() / out.sum(), (out * rows).sum() / out.sum()]
    np.testing.assert_allclose(found, expected, atol=0.15)


def footage(folder, rig, frames=10):
    centres = [c.project(np.array([[0.0, 0.0, 0.7]]))[0][0] for c in rig]
    for c, camera in enumerate(rig):
        (folder / f"view{c}").mkdir(parents=True)
        for k, frame in enumerate(burning(draw(camera)[0], frames, centres[c])):
            cv2.imwrite(str(folder / f"view{c}" / f"{k:03d}.png"), frame[..., ::-1])
    return [folder / f"view{c}" for c in range(len(rig))]


def test_command_makes_a_dataset_with_true_poses(tmp_path):
    pytest.importorskip("pycolmap")
    rig = cameras()
    videos = footage(tmp_path, rig)
    fov = float(np.rad2deg(2 * np.arctan(WIDTH / 2 / FOCAL)))
    baseline = float(np.linalg.norm(rig[2].position - rig[0].position))
    known = {"fov": fov, "times": ("100",), "baseline_m": baseline, "board": "none"}
    config = IngestConfig(videos, tmp_path / "set", max_size=160, **known)
    made = ingest(config)
    dataset = Dataset.open(made.folder)
    assert (dataset.cameras[0].width, dataset.cameras[0].height) == (120, 160) and dataset.test_frames == [4]
    assert dataset.times_s[3] == pytest.approx(0.03) and dataset.cameras[0].K[0, 0] == pytest.approx(FOCAL / 2)
    angle, shift = pose_errors([c.world_to_camera for c in dataset.cameras], [c.world_to_camera for c in rig])
    assert angle < 0.4 and shift < 0.03
    assert np.linalg.norm(dataset.cameras[2].position - dataset.cameras[0].position) == pytest.approx(baseline)
    plate = cv2.resize(draw(rig[1])[0], (120, 160), interpolation=cv2.INTER_AREA)
    assert psnr(255 * dataset.static(1), plate) > 30
    assert 0.001 < dataset.mask(0, 2).mean() < 0.2
    assert Poses.read(made.folder) == made.poses
    camera, truth = dataset.cameras[1], draw(rig[1])[1]
    pixels, depth = camera.project(made.poses.points_array())
    columns, rows = np.floor(2 * pixels).astype(int).T
    seen = (columns >= 0) & (columns < WIDTH) & (rows >= 0) & (rows < HEIGHT)
    miss = np.abs(depth[seen] / truth[rows[seen], columns[seen]] - 1)
    assert seen.sum() > 100 and np.median(miss) < 0.01, "points of poses.json lie on the scene, in the dataset's metres"
    with pytest.raises(GofError, match="already holds"):
        ingest(config)
    with pytest.raises(GofError, match="--max-size 15"):
        ingest(replace(config, out=tmp_path / "tiny", max_size=15))


def test_poses_that_cannot_be_solved_say_so_per_camera(tmp_path):
    pytest.importorskip("pycolmap")
    rig = cameras()
    videos = footage(tmp_path, rig, frames=3)
    blank = np.full((HEIGHT, WIDTH, 3), 80, np.uint8)
    for file in videos[2].iterdir():
        cv2.imwrite(str(file), blank)
    with pytest.raises(PoseError, match=r"(?s)not registered: .*cam_2.*cam_2: 0 features.*--points"):
        ingest(IngestConfig(videos, tmp_path / "set", fov=50.0, times=("100",)))
    assert not (tmp_path / "set" / "dataset.json").exists()


def test_poses_of_a_rig_are_taken_over_and_judged(tmp_path):
    pytest.importorskip("pycolmap")
    rig = cameras()
    first, second = footage(tmp_path / "a", rig), footage(tmp_path / "b", rig, frames=4)
    fov = float(np.rad2deg(2 * np.arctan(WIDTH / 2 / FOCAL)))
    config = IngestConfig(first, tmp_path / "set", fov=fov, times=("100",), baseline_m=1.25, board="none")
    known = Dataset.open(ingest(config).folder)
    again = replace(config, videos=second, out=tmp_path / "again", rig=known.path, baseline_m=None)
    made = ingest(again)
    assert made.poses.report.method == "rig" and max(made.poses.report.moved["set"].values()) < 0.5
    for got, camera in zip(Dataset.open(made.folder).cameras, known.cameras, strict=True):
        np.testing.assert_array_equal(got.world_to_camera, camera.world_to_camera)
    assert Dataset.open(made.folder).description.in_metres

    with pytest.raises(DataFormatError, match="same --fov"):
        ingest(replace(again, out=tmp_path / "lens", fov=fov - 5))
    touched = footage(tmp_path / "c", [rig[0], rig[1], rig[1]], frames=3)
    other = cv2.imread(str(touched[2] / "000.png"))
    other[0, 0] ^= 1  # or it would be the same footage
    cv2.imwrite(str(touched[2] / "000.png"), other)
    with pytest.raises(PoseError, match=r"cam_2: .*moved by|cam_2: only"):
        ingest(replace(again, videos=touched, out=tmp_path / "moved"))
    with pytest.raises(GofError, match="no view0 there"):
        ingest(replace(config, out=tmp_path / "none", with_clip=[tmp_path / "set"]))
    together = ingest(replace(config, out=tmp_path / "both", with_clip=[tmp_path / "b"]))
    assert list(together.poses.report.moved) == ["b"]


def test_known_cameras_are_taken_as_they_are(tmp_path):
    rig = cameras()
    videos = footage(tmp_path, rig, frames=3)
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": list(map(by_hand, rig))}))
    config = IngestConfig(videos, tmp_path / "set", cameras=path, times=("50",), board="none")
    dataset = Dataset.open(ingest(config).folder)
    assert gof(["depth", str(dataset.path), "--plates"]) == 0
    for c, camera in enumerate(rig):
        found, truth = np.load(tmp_path / "set" / "depth" / f"cam_{c}.npy"), draw(camera)[1]
        seen = np.isfinite(truth)
        assert np.isfinite(found).all() and (np.abs(found - truth)[seen] < 0.05 * truth[seen]).mean() > 0.75
    assert (tmp_path / "set" / "points.ply").stat().st_size > 3 * HEIGHT * WIDTH * 15
    assert gof(["depth", str(dataset.path), "--plates"]) == 1, "they are kept"
    for got, camera in zip(dataset.cameras, rig, strict=True):
        np.testing.assert_allclose(got.world_to_camera, camera.world_to_camera)


def test_footage_errors(tmp_path):
    with pytest.raises(DataFormatError, match="no such video"):
        stated_info(tmp_path / "none.mp4")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataFormatError, match="no pictures"):
        stated_info(tmp_path / "empty")
    cv2.imwrite(str(tmp_path / "empty" / "0.png"), np.zeros((4, 6, 3), np.uint8))
    with pytest.raises(DataFormatError, match="has 1 frames, 2"):
        list(PreparedClip(tmp_path / "empty", (6, 4), (0, 1), np.copy))
    with pytest.raises(DataFormatError, match="6x4, the lens is given for 5x4"):
        list(PreparedClip(tmp_path / "empty", (5, 4), (0,), np.copy))
    with pytest.raises(DataFormatError, match="between 0 and 180"):
        Lens.from_fov(6, 4, 180)
    with pytest.raises(GofError, match="at least one camera"):
        Footage((), (), ())
    with pytest.raises(GofError, match=r"--cameras FILE or --fov"):
        Footage.open([tmp_path / "empty"] * 2, "none", None, None)


# ---- plates of more frames than the clip -----------------------------------------------------------------------------


def test_frames_around_a_clip():
    """Those outside it only, as many as were asked for, from the other side where one side has too few."""
    used = np.array([10, 12, 14, 16])  # paired with a slower camera: 11 lies beside frames that may be held out
    assert around(used, 11, 100).tolist() == [8, 9, 17, 18]
    assert around(used, 7, 100).tolist() == []
    assert around(used, 27, 100).tolist() == [*range(10), *range(17, 27)]
    assert around(used, 37, 20).tolist() == [*range(10), 17, 18, 19]
    assert around(used, 15, 18).tolist() == [*range(3, 10), 17]


def standing_fire(folder, rig, burns, frames=30):
    """Videos whose fire stands in one place in the frames that `burns(k)`, and is out in the others."""
    for c, camera in enumerate(rig):
        (folder / f"view{c}").mkdir(parents=True)
        picture = draw(camera)[0].astype(float)
        x, y = camera.project(np.array([[0.0, 0.0, 0.7]]))[0][0]
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        shape = np.exp(-0.5 * (((columns - x) / 9) ** 2 + ((rows - y) / 14) ** 2))[..., None]
        for k in range(frames):
            light = (1 + 0.3 * np.sin(k)) * shape * [230, 140, 10] if burns(k) else 0
            frame = np.uint8(np.clip(0.8 * picture + light, 0, 255))
            cv2.imwrite(str(folder / f"view{c}" / f"{k:03d}.png"), frame[..., ::-1])
    return [folder / f"view{c}" for c in range(len(rig))]


def standing_config(folder, rig, videos, **more):
    path = folder / "cameras.json"
    path.write_text(json.dumps({"cameras": list(map(by_hand, rig))}))
    return IngestConfig(videos, cameras=path, times=("50",), board="none", start=(8,), frames=12, **more)


def test_a_longer_window_shows_what_burns_all_through_the_clip(tmp_path):
    rig = cameras()
    videos = standing_fire(tmp_path, rig, burns=lambda k: 5 <= k < 25)
    alone = ingest(standing_config(tmp_path, rig, videos, out=tmp_path / "alone"))
    config = standing_config(tmp_path, rig, videos, out=tmp_path / "window", plates="steady:30")
    made = ingest(config)
    assert made.fire_left_by_clip == alone.fire_left and alone.fire_left_by_clip is None
    for c, camera in enumerate(rig):
        truth = 0.8 * draw(camera)[0]
        burnt, cleared = (255 * Dataset.open(m.folder).static(c) for m in (alone, made))
        assert alone.fire_left[f"cam_{c}"] > 0.002 and made.fire_left[f"cam_{c}"] == 0
        assert psnr(cleared, truth) > psnr(burnt, truth) + 10 and psnr(cleared, truth) > 38
    assert Dataset.open(made.folder).description.provenance["plate_frames"] == dict.fromkeys(made.fire_left, 29)
    assert "from the clip alone 0." in fire_left_in_words(made.fire_left, made.fire_left_by_clip)
    with pytest.raises(GofError, match="has 12 frames; give more"):
        ingest(replace(config, out=tmp_path / "no", plates="steady:12"))
    with pytest.raises(GofError, match="no frames outside"):
        ingest(replace(config, out=tmp_path / "no", start=(0,), frames=None, plates="steady:99"))
    with pytest.raises(GofError, match="is this clip itself"):
        ingest(replace(config, out=tmp_path / "no", plates="steady", with_clip=[tmp_path]))


def test_no_held_out_frame_gets_into_a_plate(tmp_path):
    """Fire is out in the held-out frame alone: a plate that shows what is behind it has seen that frame."""
    rig = cameras()
    videos = standing_fire(tmp_path, rig, burns=lambda k: k != 12)  # the clip is 8 to 19: its fifth is held out
    made = ingest(standing_config(tmp_path, rig, videos, out=tmp_path / "set", plates="steady:30"))
    assert Dataset.open(made.folder).test_frames == [4]
    assert min(made.fire_left.values()) > 0.002


def test_plates_that_are_named_as_other_films_are_refused(tmp_path):
    """They go to the cameras by name, cameras are named by place, and films may be called the same in another order."""
    rig, folder = cameras()[:2], tmp_path / "plates"
    folder.mkdir()
    for c, camera in enumerate(rig):
        cv2.imwrite(str(folder / f"cam_{c}.png"), draw(camera)[0][..., ::-1])
    views = footage(tmp_path, rig, frames=2)
    films = [views[c].rename(tmp_path / f"cam_{c}") for c in (0, 1)]
    opened = [Footage.open(order, "none", None, 50.0) for order in (films, films[::-1])]
    assert len(read_plates(folder, opened[0])) == 2
    with pytest.raises(DataFormatError, match="camera cam_0 is the film cam_1, whose name there is another camera's"):
        read_plates(folder, opened[1])


def test_known_poses_leave_no_choice_of_scale_and_are_those_of_the_other_clips(tmp_path):
    rig = cameras()
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": list(map(by_hand, rig))}))
    known = {"cameras": path, "times": ("50",), "board": "none"}
    videos = footage(tmp_path / "a", rig, frames=3)
    made = ingest(IngestConfig(videos, tmp_path / "rig", **known)).folder
    for option, given in {
        "--baseline-m": {"baseline_m": 1.2},
        "--poses": {"poses": "points"},
        "--up": {"up": "edges"},
        "--rig": {"rig": made},
    }.items():
        with pytest.raises(GofError, match=f"{option}: poses are taken over, those of --cameras.*leave out {option}"):
            ingest(IngestConfig(videos, tmp_path / "set", **given, **known))
    with pytest.raises(GofError, match=r"--baseline-m, --poses: poses are taken over, those of --rig"):
        lens = {"fov": float(np.degrees(2 * np.arctan(WIDTH / 2 / FOCAL))), "times": ("50",), "board": "none"}
        ingest(IngestConfig(videos, tmp_path / "set", rig=made, poses="features", baseline_m=1.2, **lens))
    turned = rig[0].world_to_camera.copy()
    turned[:3] = cv2.Rodrigues(np.array([0, 0.05, 0]))[0] @ turned[:3]
    other = footage(tmp_path / "b", [replace(rig[0], world_to_camera=turned), *rig[1:]], frames=3)
    with pytest.raises(PoseError, match="cam_0"):
        ingest(IngestConfig(videos, tmp_path / "set", with_clip=[other[0].parent], **known))


def test_known_poses_and_points_of_known_size_have_one_scale(tmp_path):
    """Points 30 % further apart than the poses' metres say, and poses for two of three cameras."""
    rig = cameras()
    places = np.array([[0.1, 0, 0.2], [-0.2, 0.1, 0], [0, 0.2, -0.1], [0.2, -0.1, 0.1]])
    pixels = {camera.name: camera.project(places)[0] for camera in rig}
    videos, path, marked = footage(tmp_path, rig, frames=3), tmp_path / "cameras.json", tmp_path / "points.json"
    path.write_text(json.dumps({"cameras": list(map(by_hand, rig))}))
    config = IngestConfig(videos, tmp_path / "a", cameras=path, times=("50",), board="none", points=marked)
    for stretch in (1.0, 1.3):
        points = [
            {"pixels": {n: at[k].tolist() for n, at in pixels.items()}, "xyz": (stretch * place).tolist()}
            for k, place in enumerate(places)
        ]
        marked.write_text(json.dumps({"points": points}))
        if stretch == 1:
            assert Poses.read(ingest(config).folder).report.check.metres_per_unit == pytest.approx(1, abs=1e-3)
    with pytest.raises(PoseError, match=r"poses of --cameras .metres. contradict.*1\.3 times as large"):
        ingest(replace(config, out=tmp_path / "b"))
    some = [by_hand(camera) for camera in rig]
    del some[1]["world_to_camera"]
    path.write_text(json.dumps({"cameras": some}))
    with pytest.raises(DataFormatError, match="2 poses .* for 3 cameras; give each its own, or none"):
        ingest(replace(config, out=tmp_path / "c", points=None))


@pytest.mark.parametrize("baseline_m", [1.0, 0.8])
def test_two_lengths_of_one_world_agree(baseline_m):
    """Two cameras 0.5 units apart, points that say 2 m a unit, and a tape measure."""
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[1, 0, 3] = -0.5
    marked = (MarkedPoint({}, np.zeros(3)), MarkedPoint({}, np.ones(3)))
    check, options = PointCheck(0.1, 2.0, 0.01), PoseOptions(by_hand=marked, baseline_m=baseline_m)
    if baseline_m == 1:
        assert metric_scale(poses, check, options)[0] == 2
        return
    with pytest.raises(PoseError, match=r"--baseline-m contradict each other.*1\.25 times as large"):
        metric_scale(poses, check, options)
