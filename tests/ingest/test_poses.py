"""Camera poses against exact truth: by structure from motion, by known points, and what is said when neither works."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.dataset.poses import PoseReport, Poses
from gof.ingest import adjust, sfm
from gof.ingest.axes import upright_world
from gof.ingest.marked_points import MarkedPoint, read_points
from tests.ingest.scene import HEIGHT, WIDTH, cameras, draw, lens, pose_errors

pytestmark = pytest.mark.long

pytest.importorskip("pycolmap")
NAMES = ["cam_0", "cam_1", "cam_2"]


@pytest.fixture(scope="module")
def solved():
    rig = cameras()
    pictures = [draw(c)[0] for c in rig]
    masks = [np.ones(p.shape[:2], bool) for p in pictures]
    return rig, sfm.solve([(pictures, masks)], [lens(c) for c in rig], NAMES)


def test_a_wrong_lens_gives_a_warning_and_the_right_one_none(solved):
    """Nothing but the matches tells: no board, no points."""
    rig, right = solved
    assert right.warnings == ()
    pictures = [draw(c)[0] for c in rig]
    wide = [replace(lens(c), K=lens(c).K * np.array([[0.6, 1, 1], [1, 0.6, 1], [1, 1, 1]])) for c in rig]
    found = sfm.solve([(pictures, [np.ones(p.shape[:2], bool) for p in pictures])], wide, NAMES)
    assert "look too wide" in found.warnings[0]


def board(rig, side=0.3, noise=0.0, scale=1.0):
    """A square of `side` m and a few rough points around it, standing before the cameras."""
    xy = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0.5], [-1, 0.5], [0.5, 2.0]]) * side
    world = np.column_stack([xy[:, 0] - 0.1, np.full(len(xy), -0.8), 0.9 - xy[:, 1]])
    rng = np.random.default_rng(0)
    points = []
    for k, (flat, x) in enumerate(zip(xy, world, strict=True)):
        pixels = {c: rig[c].project(x[None] * scale)[0][0] + rng.normal(0, noise, 2) for c in range(len(rig))}
        points.append(MarkedPoint(pixels, np.append(flat * scale, 0.0), rough=k >= 4))
    return points


def test_structure_from_motion_finds_the_truth(solved):
    rig, solution = solved
    assert solution.figures.registered == tuple(NAMES) and solution.figures.reprojection_px < 0.6
    angle, shift = pose_errors(solution.model.world_to_camera, [c.world_to_camera for c in rig])
    assert angle < 0.3 and shift < 0.02
    share = sfm.consistent_share(solution.features, [lens(c) for c in rig], np.array([c.world_to_camera for c in rig]))
    assert min(share.values()) > 0.8


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_known_points_give_pose_and_scale(solved, scale):
    features = solved[1].features
    rig = cameras(scale)
    poses = adjust.from_known_points(board(rig, noise=0.1, scale=scale), features, [lens(c) for c in rig], NAMES)
    angle, shift = pose_errors(poses.world_to_camera, [c.world_to_camera for c in rig])
    assert angle < 0.5 and shift < 0.03
    centers = [-p[:3, :3].T @ p[:3, 3] for p in poses.world_to_camera]
    assert np.linalg.norm(centers[2] - centers[0]) == pytest.approx(scale * 6 * np.sin(np.deg2rad(12)), rel=0.03)


def test_clips_of_one_rig_are_solved_together(solved):
    """Keypoints of all clips count on, matches stay within a clip, and the mapper takes the pool as one picture."""
    rig, first = solved
    pictures = [np.uint8(np.clip(0.8 * draw(c)[0] + 5.0, 0, 255)) for c in rig]
    masks = [np.ones(p.shape[:2], bool) for p in pictures]
    second = sfm.solve([(pictures, masks)], [lens(c) for c in rig], NAMES, mapped=False)
    pool = sfm.pooled([first.features, second.features])
    for (i, j), matches in pool.matches.items():
        count = len(first.features.matches[i, j])
        assert len(matches) == count + len(second.features.matches[i, j])
        here, there = pool.pair(i, j)
        np.testing.assert_array_equal(here[count:], second.features.pair(i, j)[0])
        np.testing.assert_array_equal(there[:count], first.features.pair(i, j)[1])
    plain = [draw(c)[0] for c in rig]
    both = sfm.solve([(plain, masks), (pictures, masks)], [lens(c) for c in rig], NAMES)
    assert both.figures.keypoints["cam_0"] == len(pool.keypoints[0])
    angle, shift = pose_errors(both.model.world_to_camera, [c.world_to_camera for c in rig])
    assert angle < 0.3 and shift < 0.02


def test_a_touched_camera_is_seen():
    camera = cameras()[0]
    picture = draw(camera)[0]
    everywhere = np.ones(picture.shape[:2], bool)
    assert sfm.shift_between(picture, everywhere, picture[::1], None)[0] < 0.01
    moved = np.roll(picture, 3, axis=1)
    shift, count = sfm.shift_between(picture, everywhere, moved, everywhere)
    assert shift == pytest.approx(3, abs=0.2) and count > 30
    assert sfm.shift_between(picture, everywhere, np.zeros_like(picture), None)[1] == 0


def test_marked_points_tell_true_poses_from_wrong_ones(solved):
    rig, features = solved[0], solved[1].features
    lenses = [lens(c) for c in rig]
    truth = np.array([c.world_to_camera for c in rig])
    good = adjust.check_points(board(rig), lenses, truth)
    assert good.reprojection_px < 1e-6 and good.metres_per_unit == pytest.approx(1) and good.spread < 1e-6
    wrong = truth.copy()
    wrong[1, :3, 3] += [0.3, 0.1, 0.2]
    assert adjust.check_points(board(rig), lenses, wrong).reprojection_px > 3
    assert sfm.consistent_share(features, lenses, wrong)[0, 1] < 0.6
    assert adjust.check_points([], lenses, truth) is None


def test_a_camera_without_enough_points_is_named(solved):
    rig, features = solved[0], solved[1].features
    points = board(rig)
    for p in points[3:]:
        del p.pixels[1]
    with pytest.raises(sfm.PoseError, match=r"'cam_1' sees 3 points.*--points"):
        adjust.from_known_points(points, features, [lens(c) for c in rig], NAMES)
    line = [replace(p, xyz=np.array([k, 0.0, 0.0])) for k, p in enumerate(board(rig))]
    with pytest.raises(sfm.PoseError, match="one line"):
        adjust.from_known_points(line, features, [lens(c) for c in rig], NAMES)


def test_world_axes():
    rig = cameras()
    poses, transform = upright_world(np.array([c.world_to_camera for c in rig]))
    # The rig looks at (0, 0, 0.6) from 3 m, a little downwards: up leans by less than the pitch.
    np.testing.assert_allclose(transform @ [0, 0, 0.6, 1], [0, 0, 0, 1], atol=1e-6)
    assert transform[2, 2] > np.cos(np.deg2rad(6))
    centers = [-p[:3, :3].T @ p[:3, 3] for p in poses]
    assert (
        centers[2][0] > centers[0][0]
        and abs(centers[2][1] - centers[0][1]) < 1e-9
        and abs(centers[2][2] - centers[0][2]) < 1e-9
    )
    parallel = np.array([rig[1].world_to_camera] * 2)
    parallel[1, :3, 3] += [-0.5, 0, 0]
    assert np.isfinite(upright_world(parallel)[0]).all()


def test_points_file(tmp_path):
    path = tmp_path / "points.json"
    path.write_text(
        json.dumps(
            {
                "points": [
                    {"pixels": {"cam_0": [1, 2], "cam_2": [3, 4]}, "xyz": [0, 0, 1]},
                    {"pixels": {"cam_1": [5, 6]}},
                ]
            }
        )
    )
    points = read_points(path, NAMES)
    assert points[0].pixels[2].tolist() == [3, 4] and points[1].xyz is None
    for bad in (
        {"points": [{"pixels": {"left": [1, 2]}}]},
        {"points": [{"pixels": {"cam_0": [1]}}]},
        {"points": []},
        {},
    ):
        path.write_text(json.dumps(bad))
        with pytest.raises(DataFormatError, match=r"points\.json"):
            read_points(path, NAMES)


def test_rays_that_never_meet_are_said_to_be_parallel(tmp_path):
    """They once gave a miss of infinity, which JSON cannot hold: with known cameras the command ended in an error."""
    rig = cameras()
    ahead = MarkedPoint({c: np.array([WIDTH / 2, HEIGHT / 2]) for c in (0, 1)})
    poses = np.array([rig[0].world_to_camera] * 2)
    poses[1, 0, 3] += 0.5
    check = adjust.check_points([ahead], [lens(c) for c in rig[:2]], poses)
    assert check.reprojection_px is None
    Poses.of(PoseReport("--cameras", "metres", check=check), np.zeros((0, 3))).write(tmp_path)
    assert Poses.read(tmp_path).report.check == check
