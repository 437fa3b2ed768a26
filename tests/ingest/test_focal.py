"""The focal length that nothing states: found where the rig tells it, refused where it does not."""

import json
import struct
from itertools import combinations

import cv2
import numpy as np
import pytest

from gof.commands.ingest import IngestConfig, ingest
from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.footage.containers import focal_35mm
from gof.footage.lens import Lens
from gof.ingest import focal, sfm
from gof.ingest.bundle import BundleParameters, adjust
from gof.ingest.footage import Footage
from tests.conftest import look_at
from tests.ingest.scene import FOCAL, HEIGHT, WIDTH, cameras, pose_errors
from tests.ingest.test_bundle import seen_points, start_away
from tests.ingest.test_clips import footage
from tests.videos import numbered, tag_focal, write_video

NAMES = ["cam_0", "cam_1", "cam_2"]


def test_one_shared_zoom_and_one_each_are_found_exactly():
    rig = cameras()
    seen, points = seen_points(rig)
    K = np.stack([c.K for c in rig])
    start = start_away(rig, points, 1.0)
    for zoom, factors in (([0, 0, 0], [0.8, 0.8, 0.8]), ([0, 1, -1], [0.8, 1.25, 1.0])):
        wrong = K.copy()
        wrong[:, :2, :2] *= np.array(factors)[:, None, None]
        zooms = np.zeros(max(zoom) + 1)
        found = adjust(BundleParameters(start.cameras, start.bodies, start.points, zooms), seen, wrong, np.array(zoom))
        truth = [-np.log(factors[zoom.index(z)]) for z in range(len(zooms))]
        np.testing.assert_allclose(found.zooms, truth, atol=1e-4)
        np.testing.assert_allclose(found.cameras @ found.bodies[0], [c.world_to_camera for c in rig], atol=1e-4)


class GivenPoses:
    """Matches of made-up points, and a mapper whose cameras stand where they stand, whatever the lens."""

    def __init__(self, rig, points, noise=0.1, seed=0):
        rng = np.random.default_rng(seed)
        pixels = [camera.project(points)[0] + rng.normal(0, noise, (len(points), 2)) for camera in rig]
        every = np.column_stack([np.arange(len(points))] * 2)
        self.features = sfm.Features(pixels, dict.fromkeys(combinations(range(len(rig)), 2), every))
        self.poses = np.array([camera.world_to_camera for camera in rig])

    def solve(self, lenses, names, judged=True):
        return sfm.Solution(sfm.Model(self.poses, np.zeros((0, 3))), self.features, None)


def points_of(count=120):
    return np.random.default_rng(1).uniform([-0.9, -0.6, -0.1], [0.9, 1.5, 1.3], (count, 3))


def searched(rig, points):
    lenses, search = focal.start_search([(c.width, c.height, None) for c in rig])
    return focal.find_lenses(GivenPoses(rig, points), lenses, np.array(search.kinds), NAMES)


def test_three_cameras_before_a_deep_scene_find_their_lens():
    found = searched(cameras(), points_of())
    assert found.objection is None and found.starts >= 3
    assert [lens.K[0, 0] for lens in found.lenses] == pytest.approx([FOCAL] * 3, rel=0.02)


def test_cameras_of_one_size_and_two_lenses_are_told_apart():
    rig = cameras()
    longer = look_at("cam_1", tuple(rig[1].position), (0, 0, 0.6), WIDTH, HEIGHT, 1.3 * FOCAL)
    found = searched([rig[0], longer, rig[2]], points_of())
    assert found.objection is None
    assert [lens.K[0, 0] for lens in found.lenses] == pytest.approx([FOCAL, 1.3 * FOCAL, FOCAL], rel=0.03)


def turned_in_place(camera, degrees):
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.array([0.0, np.deg2rad(degrees), 0.0]))[0]
    return Camera(camera.name, camera.width, camera.height, camera.K, turn @ camera.world_to_camera)


@pytest.mark.parametrize("case", ["two cameras", "a flat wall", "all at one place"])
def test_a_rig_that_does_not_tell_its_lens_is_not_believed(case):
    rig, points = cameras(), points_of()
    if case == "two cameras":
        rig = [rig[0], rig[2]]
    elif case == "a flat wall":
        points[:, 1] = 1.0
    else:
        rig = [turned_in_place(rig[1], degrees) for degrees in (-8, 0, 8)]
    found = searched(rig, points)
    said = None if found is None else found.objection
    true = found is not None and abs(np.log(found.lenses[0].K[0, 0] / FOCAL)) < 0.03
    assert found is None or said is not None or true, found


@pytest.mark.parametrize(("reach", "starts"), [(0.25, 3), (0.0, 1)])
def test_a_lens_that_one_start_alone_reaches_needs_a_second_beside_it(reach, starts):
    """Of the four starts the first alone places the cameras: lenses beside its end are tried, or it is refused."""
    rig = cameras()
    clips = GivenPoses(rig, points_of())
    lenses, search = focal.start_search([(c.width, c.height, None) for c in rig])
    first, every = lenses[0].K[0, 0], clips.solve
    near = {True: (first, FOCAL * (1 + reach), FOCAL * (1 - reach)), False: (first,)}[reach > 0]

    def solve(tried, names, judged=True):
        placed = min(near) - 1e-9 <= tried[0].K[0, 0] <= max(near) + 1e-9
        return every(tried, names) if placed else sfm.Solution(None, clips.features, None)

    clips.solve = solve
    found = focal.find_lenses(clips, lenses, np.array(search.kinds), NAMES)
    assert found.starts == starts
    assert [lens.K[0, 0] for lens in found.lenses] == pytest.approx([FOCAL] * 3, rel=0.02)
    assert found.objection == (None if starts > 1 else "one start alone leads to it, so nothing could contradict it")


# ---- what files state ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "value", "stated"),
    [
        (1, b"26.00mm", 26.0),  # text, as Apple documents it
        (1, b"27", 27.0),
        (21, struct.pack(">H", 26), 26.0),
        (23, struct.pack(">f", 13.5), 13.5),
        (1, b"wide", None),
        (21, b"\0\0", None),
    ],
)
def test_a_phones_focal_length_is_read_from_its_film(tmp_path, kind, value, stated):
    path = write_video(tmp_path / "a.mp4", numbered(3))
    assert focal_35mm(path) is None
    assert focal_35mm(tag_focal(path, kind, value)) == stated
    assert focal_35mm(tag_focal(write_video(tmp_path / "b.mp4", numbered(3)), 1, b"26", b"camera.lens_model")) is None


def test_what_files_state_is_used_where_no_three_cameras_are(tmp_path):
    videos = [tag_focal(write_video(tmp_path / f"{c}.mp4", list(numbered(8))[c:]), 1, b"26.00mm") for c in range(2)]
    opened = Footage.open(videos, "auto", None, None)
    assert opened.search is None and opened.lens == (
        "as the files state: 26 mm for 35 mm film; stabilised video is narrower"
    )
    assert opened.lenses[0].fov_deg == pytest.approx(2 * np.rad2deg(np.arctan(18 / 26)))
    plain = [write_video(tmp_path / f"plain_{c}.mp4", list(numbered(8))[c:]) for c in range(2)]
    with pytest.raises(GofError, match=r"no file says the lens.*three cameras or more.*--fov.*main camera 69 \(58 st"):
        Footage.open([videos[0], plain[1]], "auto", None, None)


def test_unsure_matches_leave_what_files_state_and_say_so():
    nowhere = GivenPoses(cameras(), points_of())
    nowhere.solve = lambda lenses, names, judged=True: sfm.Solution(None, nowhere.features, None)
    stated, search = focal.start_search([(WIDTH, HEIGHT, 26.0)] * 3)
    chosen = focal.choose_lenses(nowhere, stated, NAMES, search)
    assert chosen.lenses == stated and chosen.words == search.stated
    assert chosen.notes == ("the matches do not check the lens: no start places all cameras",)
    lenses, search = focal.start_search([(WIDTH, HEIGHT, None)] * 3)
    with pytest.raises(GofError, match="no file says the lens, and the matches do not either: no start"):
        focal.choose_lenses(nowhere, lenses, NAMES, search)


# ---- the whole command -----------------------------------------------------------------------------------------------


@pytest.mark.long
def test_ingest_finds_the_lens_of_drawn_films_and_writes_it(tmp_path):
    pytest.importorskip("pycolmap")
    rig = cameras()
    videos = footage(tmp_path, rig, frames=4)
    made = ingest(IngestConfig(videos, tmp_path / "set", times=("100",), baseline_m=1.25, board="none"))
    dataset = Dataset.open(made.folder)
    assert [c.K[0, 0] for c in dataset.cameras] == pytest.approx([FOCAL] * 3, rel=0.03)
    angle, shift = pose_errors([c.world_to_camera for c in dataset.cameras], [c.world_to_camera for c in rig])
    assert angle < 0.6 and shift < 0.05
    assert made.lens.startswith("found by the matches: ") and dataset.description.provenance["lens"] == made.lens
    true = Lens(WIDTH, HEIGHT, rig[0].K).fov_deg
    assert dataset.description.provenance["fov_deg"] == pytest.approx([true] * 3, rel=0.03)
    json.dumps(dataset.description.provenance)
    with pytest.raises(
        GofError, match=r"--rig .*its poses hold for its lenses; give them with --fov.*field of view of"
    ):
        ingest(IngestConfig(videos, tmp_path / "again", times=("100",), board="none", rig=made.folder))
