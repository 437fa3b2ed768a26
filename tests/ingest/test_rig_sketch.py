"""Poses from a sketch of the rig and the flame alone, against exact cameras and against a real rig's."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from gof.commands.ingest import IngestConfig, ingest
from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.footage.lens import Lens
from gof.ingest.by_flame import place_by_flame
from gof.ingest.flame_features import FlameFeatures, Moments, match_flames
from gof.ingest.rig_sketch import RigSketch
from gof.ingest.sfm import Features, PoseError

NAMES = ["cam_0", "cam_1", "cam_2"]
WIDTH, HEIGHT, FOCAL = 480, 854, 750.0
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
SKETCH = "three in a row, 0.35 m apart, 2 m away"  # the rig below is 0.38 and 0.42 m apart, and 2.2 m away


def looking(centre, roll_deg, off):
    """A camera that looks `off` (2,) px beside the origin, rolled."""
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    roll, (pan, tilt) = np.deg2rad(roll_deg), np.array(off) / FOCAL
    rolled = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    panned = np.array([[np.cos(pan), 0, np.sin(pan)], [0, 1, 0], [-np.sin(pan), 0, np.cos(pan)]])
    tilted = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    pose = np.eye(4)
    pose[:3, :3] = rolled @ panned @ tilted @ level
    pose[:3, 3] = -pose[:3, :3] @ centre
    return pose


def rig():
    """The true cameras: neither level, nor evenly apart, nor looking at one point."""
    centres = np.array([[-0.38, -2.2, 0.02], [0.0, -2.16, 0.05], [0.42, -2.22, -0.03]])
    looks = [(1.5, (20, -30)), (-2.0, (-15, 10)), (3.0, (5, 40))]
    poses = [looking(c, roll, off) for c, (roll, off) in zip(centres, looks, strict=True)]
    return [Camera(n, WIDTH, HEIGHT, K, pose) for n, pose in zip(NAMES, poses, strict=True)]


def flame(cameras, wrong=0.4, noise=0.3, seed=0, count=900):
    """Matches as a flame of 0.6 m gives them: a share of them wrong, the others a third of a pixel off."""
    rng = np.random.default_rng(seed)
    points = rng.normal(0, [0.12, 0.12, 0.25], (count, 3))
    keypoints = [c.project(points)[0] + rng.normal(0, noise, (count, 2)) for c in cameras]
    matches = {}
    for pair in combinations(range(3), 2):
        partner = np.arange(count)
        lost = rng.random(count) < (wrong if pair != (0, 2) else (1 + wrong) / 2)
        partner[lost] = rng.permutation(partner[lost])
        matches[pair] = np.stack([np.arange(count), partner], 1)
    frame = [np.arange(count) // 30 for _ in cameras]
    lenses = [Lens(WIDTH, HEIGHT, K) for _ in cameras]
    return FlameFeatures(Features(keypoints, matches), lenses, frame, np.array([k.mean(0) for k in keypoints]))


def miss_px(found, cameras, points):
    """By how much pixels of true points miss their best meeting, root mean square: by search, not by gof's solver."""
    seen = np.stack([c.project(points)[0] for c in cameras])
    matrices = np.stack([c.K @ pose[:3] for c, pose in zip(cameras, found, strict=True)])
    square = []
    for pixels in np.swapaxes(seen, 0, 1):
        rows = np.concatenate([px[:, None] * m[2] - m[:2] for px, m in zip(pixels, matrices, strict=True)])
        x = np.linalg.lstsq(rows[:, :3], -rows[:, 3], rcond=None)[0]
        image = matrices @ np.append(x, 1)
        square.append(((image[:, :2] / image[:, 2:] - pixels) ** 2).sum(1).mean())
    return float(np.sqrt(np.mean(square)))


def turned_deg(found, cameras):
    """Largest difference of the turns between neighbours."""
    turns = []
    for a, b in ((0, 1), (1, 2)):
        ours = found[b][:3, :3] @ found[a][:3, :3].T
        true = cameras[b].world_to_camera[:3, :3] @ cameras[a].world_to_camera[:3, :3].T
        turns.append(np.rad2deg(np.arccos(np.clip((np.trace(ours @ true.T) - 1) / 2, -1, 1))))
    return max(turns)


@pytest.mark.parametrize(
    ("words", "first", "last"),
    [
        ("3 in a row, 0.5 m apart, 2 m away", [-0.5, -2, 0], [0.5, -2, 0]),
        ("Three in a row,50 cm apart, 200 cm away.", [-0.5, -2, 0], [0.5, -2, 0]),
        ("row, 0.5 m apart, 2 m away", [-0.5, -2, 0], [0.5, -2, 0]),
        ("three phones in an arc, 30 degrees apart, 2 m away", [-1, -np.sqrt(3), 0], [1, -np.sqrt(3), 0]),
        ("arc, 30 degrees apart, 2 m away", [-1, -np.sqrt(3), 0], [1, -np.sqrt(3), 0]),
    ],
)
def test_a_sketch_in_words(words, first, last):
    centres = RigSketch.parse(words).centres(3)
    assert np.allclose(centres[[0, 2]], [first, last]) and np.allclose(centres[1], [0, -2, 0])


@pytest.mark.parametrize(
    "words",
    [
        "4 in a row, 0.5 m apart, 2 m away",
        "3 in a row, 0 m apart, 2 m away",
        "3 in a row, 5 degrees apart, 2 m away",
        "arc, 90 degrees apart, 2 m away",
        "some in a row, 0.5 m apart, 2 m away",
    ],
)
def test_a_sketch_of_no_rig_is_refused(words):
    with pytest.raises(GofError, match="--rig"):
        RigSketch.parse(words).centres(3)


def test_a_path_is_no_sketch(tmp_path):
    assert RigSketch.parse("data/three in a row") is None
    with pytest.raises(GofError, match="no such dataset, and no sketch"):
        ingest(IngestConfig([tmp_path / "a.mp4", tmp_path / "b.mp4"], tmp_path / "out", ("60",), rig=tmp_path / "none"))


def test_a_sketch_is_turned_to_see_the_flame():
    lenses = [Lens(WIDTH, HEIGHT, K)] * 3
    middles = np.array([[100.0, 700.0], [240.0, 427.0], [400.0, 30.0]])
    for pose, px in zip(RigSketch.parse(SKETCH).poses(lenses, middles), middles, strict=True):
        assert np.allclose(Camera("a", WIDTH, HEIGHT, K, pose).project(np.zeros((1, 3)))[0], px, atol=1e-6)


@pytest.mark.parametrize("words", [SKETCH, "3 in a row, 0.48 m apart, 2.6 m away", "arc, 9 degrees apart, 2.3 m away"])
def test_the_flame_refines_a_sketch_to_the_true_cameras(words):
    cameras, points = rig(), np.random.default_rng(5).normal(0, [0.12, 0.12, 0.25], (200, 3))
    seen = flame(cameras)
    start = RigSketch.parse(words).poses(seen.lenses, seen.middles)
    found = place_by_flame(seen, RigSketch.parse(words), NAMES)
    assert miss_px(start, cameras, points) > 3
    assert miss_px(found.model.world_to_camera, cameras, points) < 0.3
    assert turned_deg(found.model.world_to_camera, cameras) < 1.5
    assert found.fit.halves_px < 0.5 and found.fit.off_sketch < 2.5


@pytest.mark.parametrize("seed", range(3))
def test_matches_by_chance_are_refused(seed):
    with pytest.raises(PoseError, match="by chance|apart|standard deviations"):
        place_by_flame(flame(rig(), wrong=1.0, seed=seed), RigSketch.parse(SKETCH), NAMES)


def test_few_matches_that_fit_several_rigs_are_refused():
    with pytest.raises(PoseError, match="matches"):
        place_by_flame(flame(rig(), count=40), RigSketch.parse(SKETCH), NAMES)


def test_cameras_in_another_order_are_refused():
    cameras = rig()
    with pytest.raises(PoseError, match="opposite order"):
        place_by_flame(flame([cameras[2], cameras[1], cameras[0]]), RigSketch.parse(SKETCH), NAMES)


def test_a_camera_without_flame_is_named():
    seen = flame(rig())
    dark = replace(seen, middles=np.array([[1.0, 1.0], [np.nan, np.nan], [1.0, 1.0]]))
    with pytest.raises(PoseError, match="cam_1 shows no flame"):
        place_by_flame(dark, RigSketch.parse(SKETCH), NAMES)


def test_features_are_moved_to_one_moment():
    """A texture that rises by 4 px a frame, filmed by one camera half a frame late, which reads its lines upwards."""
    rng = np.random.default_rng(0)
    size, rise, step_s, row_s = 240, 4, 0.01, 1e-5
    fine = np.kron(rng.random((60, 60)), np.ones((8, 8)))
    clips = []
    for late in (0, rise // 2):
        clip = []
        for k in range(4):
            picture = np.zeros((size, size, 3), np.uint8)
            part = fine[k * rise + late :][:120, :120]
            picture[60:180, 60:180] = (part[..., None] * [220, 140, 20] + [30, 0, 0]).astype(np.uint8)
            clip.append(picture)
        clips.append(clip)
    lens = np.array([[300.0, 0, 120], [0, 300, 120], [0, 0, 1]])
    cameras = [
        Camera("a", size, size, lens, np.eye(4)),
        Camera("b", size, size, lens, np.eye(4), row_time_s=row_s, readout="up"),
    ]
    times = [step_s * np.arange(4), step_s * (np.arange(4) + 0.5)]
    plates = [np.zeros((size, size, 3), np.uint8)] * 2
    found = match_flames(clips, plates, cameras, Moments.of(np.arange(4), times, cameras))
    first, second = found.features.pair(0, 1)
    apart = second - first
    inside = (np.abs(first - 120) < 40).all(1) & (np.abs(apart) < 5).all(1)
    assert inside.sum() > 20
    # Pictures are drawn as by a global shutter, so a line that counts as read later shows what should not be risen yet.
    line_s = (size - second[inside, 1]) * row_s
    assert np.abs(np.median(apart[inside], 0) - [0, np.median(rise * line_s / step_s)]).max() < 0.1


CAPTURE = Path(__file__).parents[3] / "shared/captures/capture_04/scene_0010"


@pytest.mark.long
@pytest.mark.skipif(not CAPTURE.is_dir(), reason="needs ../shared/captures")
def test_a_real_flame_finds_its_cameras(tmp_path):
    """The rig's poses, from features of its surroundings, are the truth; the flame's ways use none of these."""
    pytest.importorskip("pycolmap")
    videos = [CAPTURE / f"cam_{c}.mp4" for c in range(3)]
    config = IngestConfig(videos, tmp_path / "true", ("sync",), fov=35.53, baseline_m=0.78)
    truth = Dataset.open(ingest(config).folder)
    words = Path("3 in a row, 0.4 m apart, 1.8 m away")
    times = (str(tmp_path / "true/sync/times.json"),)
    made = ingest(replace(config, out=tmp_path / "sketch", times=times, rig=words, baseline_m=None, board="none"))
    assert made.poses.report.method == "sketch" and "sketch and the flame" in made.poses.report.notes[0]
    found = np.array([camera.world_to_camera for camera in Dataset.open(made.folder).cameras])
    # Points about the flame's middle, of a third of its distance.
    middle = np.median(np.array([t for t in made.poses.points]), 0)
    across = np.random.default_rng(0).normal(0, 0.15, (200, 3)) + middle
    ours = [replace(c, world_to_camera=pose) for c, pose in zip(truth.cameras, found, strict=True)]
    assert miss_px([c.world_to_camera for c in truth.cameras], ours, across) < 1.5
    with pytest.raises(GofError, match="opposite order|the flame does not hold"):
        order = [videos[k] for k in (2, 1, 0)]
        ingest(replace(config, videos=order, out=tmp_path / "no", times=("400",), rig=words, baseline_m=None))
