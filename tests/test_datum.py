"""Worlds and clocks far from zero are measured from a datum that is kept in float64; near zero nothing changes."""

from dataclasses import replace

import numpy as np
import pytest

from gof.commands.convert import main as convert_main
from gof.core.datum import Datum
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.io.importers import read_result
from gof.io.importers.alignment import align_cameras, align_result
from tests.conftest import arc, random_gaussians

UTM, UNIX = (498_000.0, 5_213_000.0, 431.0), 1_732_300_000.25
FAR = Datum(UTM, UNIX)
TIMES = 0.01 * np.arange(30)


def centres() -> np.ndarray:
    return np.array([camera.position for camera in arc(3)])


def test_near_zero_nothing_is_moved():
    assert not Datum.of(centres(), TIMES)
    assert not Datum.of(centres() + 100.0, TIMES + 100)
    assert not Datum.of(np.zeros((3, 3)), TIMES)  # cameras in one place: no length to compare with
    assert not Datum.of(centres(), np.array([UNIX]))  # one frame: nothing to tell apart
    assert not Datum.of(np.zeros((0, 3)), np.zeros(0))


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3], ids=["m", "km", "mm"])
def test_far_from_zero_float32_then_has_digits_to_spare(unit):
    """In whatever unit of length or time."""
    far, clock = unit * (centres() + UTM), unit * (TIMES + UNIX)
    datum = Datum.of(far, clock)
    assert np.spacing(np.float32(np.abs(far - datum.position).max())) < 1e-5 * np.ptp(unit * centres(), 0).max()
    assert datum.time_s == clock[0]
    assert Datum.of(far, TIMES).time_s == 0
    assert Datum.of(centres(), clock).position == (0, 0, 0)


def test_a_camera_sees_the_same_from_the_datum():
    camera = replace(arc(3)[1], row_time_s=1e-5)
    point = np.random.default_rng(0).normal(size=(20, 3)) * 0.3
    pose = camera.world_to_camera.copy()
    pose[:3, 3] -= pose[:3, :3] @ UTM
    seen = replace(camera, world_to_camera=pose).measured_from(FAR)
    np.testing.assert_allclose(seen.project(point)[0], camera.project(point)[0], atol=1e-6)
    assert seen.row_time_s == camera.row_time_s


def test_gaussians_are_measured_from_another_datum_in_float64():
    """From one datum to one 3 m and 0.5 s away: what is subtracted are the float64 numbers, not their roundings."""
    gaussians = replace(random_gaussians(50), datum=FAR)
    other = Datum((UTM[0] + 3, UTM[1] - 2, UTM[2]), UNIX + 0.5)
    moved = gaussians.measured_from(other)
    np.testing.assert_allclose(moved.position, gaussians.position - [3, -2, 0], atol=1e-6)
    np.testing.assert_allclose(moved.t_mu, gaussians.t_mu - 0.5, atol=1e-6)
    np.testing.assert_array_equal(moved.velocity, gaussians.velocity)
    assert moved.datum == other
    unsaid = random_gaussians(50).measured_from(FAR)
    np.testing.assert_array_equal(unsaid.position, random_gaussians(50).position)
    both = TransientGaussians.concatenate([gaussians[:10], moved[10:]])
    assert both.datum == FAR
    np.testing.assert_allclose(both.position, gaussians.position, atol=1e-6)


@pytest.mark.parametrize("suffix", [".npz", ".ply"])
def test_files_keep_the_datum_to_the_last_digit(tmp_path, suffix):
    path = replace(random_gaussians(40), datum=FAR).save(tmp_path / f"far{suffix}")
    back = read_result(path).gaussians
    assert back.datum == FAR
    np.testing.assert_allclose(back.position, random_gaussians(40).position, atol=1e-6)
    assert b"/2" in path.read_bytes() or b"gof-transient 2" in path.read_bytes() or suffix == ".npz"
    for datum in (None, Datum()):  # as files of before
        near = replace(random_gaussians(40), datum=datum).save(tmp_path / f"near{suffix}")
        assert TransientGaussians.load(near).datum is None
    assert near.read_bytes() == random_gaussians(40).save(tmp_path / f"old{suffix}").read_bytes()


@pytest.mark.parametrize("numbers", [[1.0, 2, 3], [1.0, 2, np.nan, 4], [np.inf, 0, 0, 0]])
def test_a_damaged_datum_is_named(tmp_path, numbers):
    path = replace(random_gaussians(5), datum=FAR).save(tmp_path / "a.npz")
    content = dict(np.load(path))
    np.savez(tmp_path / "b.npz", **content | {"datum": np.array(numbers)})
    with pytest.raises(GofError, match=r"b\.npz.*datum"):
        TransientGaussians.load(tmp_path / "b.npz")
    content.pop("datum")
    np.savez(tmp_path / "c.npz", **content)
    with pytest.raises(GofError, match=r"c\.npz.*datum"):
        TransientGaussians.load(tmp_path / "c.npz")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"gof-transient 2", b"gof-transient 1"),  # a datum that its version does not know
        (b"comment datum x y z t:", b"comment other x y z t:"),  # a version whose datum is missing
        (b"498000.0", b"49800x.0"),
    ],
)
def test_a_damaged_datum_of_a_ply_is_named(tmp_path, old, new):
    path = replace(random_gaussians(5), datum=FAR).save(tmp_path / "a.ply")
    content = path.read_bytes()
    assert content.count(old) == 1
    path.write_bytes(content.replace(old, new))
    with pytest.raises(DataFormatError, match=r"a\.ply.*datum"):
        TransientGaussians.load(path)


def test_a_dataset_is_opened_from_its_datum(tmp_path):
    from tests.moved_dataset import moved_copy
    from tests.reconstruct.rising_flame import RISE, write_flame

    near = write_flame(tmp_path / "near", frames=6)
    far = Dataset.open(moved_copy(near, tmp_path / "far", FAR))
    near = Dataset.open(near)
    assert far.description.time_s[0] == UNIX and not near.datum
    assert far.datum.time_s == UNIX
    shift = np.subtract(far.datum.position, UTM)  # the datum is a round number amid the cameras, they stood around 0
    assert np.abs(shift).max() < 10
    np.testing.assert_allclose(far.times_s, near.times_s, atol=5e-7)  # float64 knows Unix time to 0.24 us
    for a, b in zip(far.cameras, near.cameras, strict=True):
        np.testing.assert_allclose(a.position + shift, b.position, atol=1e-6)
    field = far.velocity.at(float(far.times_s[2]))
    np.testing.assert_allclose(field.sample(np.array([[0.0, 0.0, 0.5]]) - shift), [RISE], rtol=1e-3)


def test_a_result_is_aligned_in_the_whole_world():
    """Cameras state places in the whole world, a result from its datum: it lands where it is, by any cameras."""
    turn = np.array([[0.0, -2, 0, 30], [2, 0, 0, -7], [0, 0, 2, 5], [0, 0, 0, 1]])  # a quarter turn, twice as large
    target = {c.name: c.world_to_camera for c in arc(3)}  # of the dataset, from its datum
    source = {}
    for name, pose in target.items():  # the same ones in the result's own world, far away
        moved = pose @ turn
        moved[:3] /= 2
        moved[:3, 3] -= moved[:3, :3] @ UTM
        source[name] = moved
    found = align_cameras(source, target)
    gaussians, dataset_datum = replace(random_gaussians(50), datum=FAR), Datum((1.0, 2.0, 3.0), UNIX - 2)
    aligned = align_result(gaussians, found, dataset_datum)
    np.testing.assert_allclose(aligned.position, gaussians.position @ turn[:3, :3].T + turn[:3, 3], atol=1e-4)
    np.testing.assert_allclose(aligned.t_mu, gaussians.t_mu + 2, atol=1e-6)
    assert aligned.datum == dataset_datum
    unknown = align_result(replace(gaussians, datum=None), align_cameras(target, target), dataset_datum)
    np.testing.assert_allclose(unknown.position, gaussians.position, atol=1e-6)


def test_a_far_dataset_and_its_own_cameras_move_nothing(tmp_path):
    from tests.moved_dataset import moved_copy
    from tests.reconstruct.rising_flame import write_flame

    far = moved_copy(write_flame(tmp_path / "near", frames=6), tmp_path / "far", FAR)
    dataset = Dataset.open(far)
    g = replace(random_gaussians(20), datum=dataset.datum)
    g.save(tmp_path / "r.npz")
    options = ["--align", str(far / "dataset.json"), "--dataset", str(far)]
    assert convert_main([str(tmp_path / "r.npz"), str(tmp_path / "a.npz"), *options]) == 0
    back = TransientGaussians.load(tmp_path / "a.npz")
    np.testing.assert_allclose(back.measured_from(dataset.datum).position, g.position, atol=1e-5)
    assert back.datum == dataset.datum
