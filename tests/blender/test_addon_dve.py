"""The add-on's own DVE against closed forms, and against gof's on Gaussians in and outside of a grid."""

import json
from pathlib import Path

import numpy as np
import pytest

from gof.core.datum import Datum
from gof.core.gaussians import TransientGaussians
from gof.core.grid_writer import GridWriter
from gof.core.rotations import rotation_matrices
from gof.dataset import CameraEntry, Dataset, DatasetDescription, Splits
from gof.evaluate.sequence import dve_sequence
from gof_blender.core.errors import DataFormatError
from gof_blender.core.fields import VelocitySequence
from gof_blender.pure import dve
from gof_blender.pure.io import cloud as clouds
from tests.conftest import arc, random_gaussians, write_dataset

TIMES = 0.01 * np.arange(6)
CELL, CELLS = 0.1, (20, 16, 24)
ORIGIN = np.array([-1.0, -0.8, 0.1])
A, B = np.array([[0.3, -2, 0.1], [2, 0.3, 0], [0.5, 0, -0.6]]), np.array([0.1, 0, 1.5])


def centres() -> np.ndarray:
    return ORIGIN + CELL * (np.stack(np.meshgrid(*map(np.arange, CELLS), indexing="ij"), -1) + 0.5)


def write_truth(path: Path, field, times=TIMES, origin=ORIGIN) -> None:
    """``field(points, time_s)`` at the centres of the cells, float32."""
    matrix = np.diag([CELL, CELL, CELL, 1.0])
    matrix[:3, 3] = origin
    writer = GridWriter(path, CELLS, matrix, times, CELL, "float32")
    for frame, time_s in enumerate(times):
        writer.write_frame(frame, field(centres() - ORIGIN + origin, time_s).__getitem__)
    writer.finish()


def still_dataset(path: Path, field, origin=ORIGIN, begin: float = 0.0) -> Path:
    """A dataset that has a true velocity and no pictures, its clock beginning at a time in seconds."""
    times = begin + TIMES
    entry = CameraEntry.of(arc(1)[0], rgb="rgb/{frame:06d}.png", static="static.png")
    splits = Splits(tuple(range(len(times))), ())
    path.mkdir()
    DatasetDescription("still", tuple(times.tolist()), (entry,), splits, velocity="v.zarr").write(path)
    write_truth(path / "v.zarr", field, times, origin)
    return path


def inner_gaussians(n: int) -> TransientGaussians:
    """Moving ones, always lit, in the middle of the box."""
    gaussians = random_gaussians(n)
    gaussians.dynamic[:], gaussians.t_mu[:], gaussians.t_sigma[:] = True, TIMES[2], np.inf
    gaussians.position[:] = np.random.default_rng(1).uniform([-0.3, -0.2, 0.9], [0.3, 0.2, 1.5], (n, 3))
    gaussians.scale[:] = np.minimum(gaussians.scale, 0.05)
    return gaussians


def linear(points, time_s):
    return points @ A.T + B + [0, 0, 10 * time_s]


def curls(points, time_s):
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([np.sin(6 * z + time_s), np.cos(5 * x) + 0 * y, 2 + np.sin(4 * y + 30 * time_s)], -1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A dataset with eddies of a few cells."""
    folder = tmp_path_factory.mktemp("dve")
    images = np.zeros((len(TIMES), 2, 32, 18, 3))
    dataset = write_dataset(folder / "data", arc(2), images, images[0], TIMES, test_frames=[4])
    write_truth(dataset / "velocity.zarr", curls)
    text = (dataset / "dataset.json").read_text()
    (dataset / "dataset.json").write_text(text.replace('"velocity": null', '"velocity": "velocity.zarr"'))
    return dataset


def cloud_of(gaussians: TransientGaussians, path: Path) -> clouds.GaussianCloud:
    gaussians.save(path)
    return clouds.load(path)


def scored(cloud, dataset):
    *_, (done, total, scores) = dve.score(cloud, dataset)
    assert done == total
    return scores


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_it_is_gofs_own_score(folder, tmp_path, seed):
    """Wide and thin, turned, short-lived, static ones, half outside, faint and far ones."""
    gaussians = random_gaussians(400, seed=seed)
    gaussians.position[:] = np.random.default_rng(seed).uniform(ORIGIN - 0.3, ORIGIN + 2.5, (400, 3))
    gaussians.scale[::3] *= 5
    gaussians.t_mu[:] = np.linspace(-0.02, 0.07, 400)
    gaussians.t_sigma[::2] = 0.01
    gaussians.opacity[::7] *= 1e-12
    gaussians.velocity[5] = 0
    gaussians.gas_velocity = np.random.default_rng(9).normal(0, 1, (400, 3)).astype(np.float32) if seed else None
    ours = scored(cloud_of(gaussians, tmp_path / "result.npz"), folder)
    theirs = dve_sequence(gaussians, Dataset.open(folder).velocity)
    assert ours.dve.l2 == pytest.approx(theirs.l2, abs=1e-6)
    assert ours.dve.cos_sim == pytest.approx(theirs.cos_sim, abs=1e-6)
    assert ours.dve.weight_outside == pytest.approx(theirs.pooled.weight_outside, abs=1e-6)
    assert ours.trivial_baselines.constant.l2 == pytest.approx(theirs.trivial_baselines["constant"].l2, abs=1e-6)
    assert ours.dve.frames_scored == len(TIMES)


@pytest.mark.parametrize("name", ["result.npz", "result.ply"])
def test_the_gas_is_scored_and_not_the_light(tmp_path, name):
    """Gas 10 % too fast in a uniform flow, its light going the other way: L2 0.1 and CosSim 1, by the definition."""
    flow = np.array([0.5, 0.0, 2.0], np.float32)
    dataset = still_dataset(tmp_path / "data", lambda x, t: np.broadcast_to(flow, x.shape))
    gaussians = inner_gaussians(30)
    gaussians.velocity[:], gaussians.gas_velocity = -flow, np.tile(np.float32(1.1) * flow, (30, 1))
    found = scored(cloud_of(gaussians, tmp_path / name), dataset)
    assert (found.dve.l2, found.dve.cos_sim) == pytest.approx((0.1, 1.0), abs=1e-5)


@pytest.mark.parametrize("name", ["result.npz", "result.ply"])
def test_a_result_far_from_zero_is_scored_where_it_is(tmp_path, name):
    """A turning flow 4,500 km from the origin at a time of 2026: the velocity at the centres is right, so L2 is 0."""
    place, moment = np.array([4.5e6, -3.25e5, 120.0]), 1.79e9
    flow = lambda x, t: (x - place) @ A.T + B  # noqa: E731
    dataset = still_dataset(tmp_path / "data", flow, origin=ORIGIN + place, begin=moment)
    gaussians = inner_gaussians(30)
    gaussians.velocity[:] = 0
    gaussians.gas_velocity = (gaussians.position @ A.T + B).astype(np.float32)
    gaussians.datum = Datum(tuple(place.tolist()), moment)
    found = scored(cloud_of(gaussians, tmp_path / name), dataset)
    assert found.dve.frames_scored == len(TIMES)
    assert found.dve.l2 == pytest.approx(0, abs=1e-4) and found.dve.weight_outside == 0


def test_a_linear_flow_is_its_value_at_the_centre(tmp_path):
    """Whatever the Gaussian's shape: then L2 of velocities that are 1 % too fast is 0.01, and CosSim is 1."""
    write_truth(tmp_path / "v.zarr", linear, TIMES[:2])
    rng = np.random.default_rng(3)
    position = rng.uniform([-0.4, -0.3, 0.8], [0.4, 0.3, 1.6], (50, 3))
    scale, rotation = rng.uniform(0.01, 0.1, (50, 3)), rng.normal(size=(50, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    mean, inside = dve.expected_velocity(VelocitySequence.open(tmp_path / "v.zarr"), 1, position, scale, rotation)
    np.testing.assert_allclose(mean, linear(position, TIMES[1]), atol=1e-5)
    assert (inside == 1).all()
    wrong = dve.FrameSums.of(dve.ProbedFrame(rng.uniform(1, 2, 50), 1.01 * mean, mean, inside))
    assert wrong.l2 == pytest.approx(0.01) and wrong.cosine == pytest.approx(wrong.weight)


def test_a_plane_wave_is_damped_by_the_width_along_it(tmp_path):
    """E[sin k.x] = exp(-|k s|^2 / 2) sin k.m; three nodes are good to 2e-4 at k s = 0.5, the cells to 3 %."""
    k = np.array([3.0, 0.0, 4.0])  # per metre: 13 cells a wave
    write_truth(tmp_path / "v.zarr", lambda x, t: np.sin(x @ k)[..., None] * [1.0, 0.0, 2.0], TIMES[:1])
    turn = np.array([[np.cos(0.4), 0, -np.sin(0.4), 0]])
    scale = np.array([[0.1, 0.02, 0.03]])
    position = np.array([[0.05, 0.0, 1.2]])
    mean, _ = dve.expected_velocity(VelocitySequence.open(tmp_path / "v.zarr"), 0, position, scale, turn)
    width2 = ((k @ rotation_matrices(turn)[0] * scale[0]) ** 2).sum()
    expected = np.exp(-width2 / 2) * np.sin(position[0] @ k)
    np.testing.assert_allclose(mean[0], [expected, 0, 2 * expected], rtol=0.03)
    assert abs(expected) < 0.95 * abs(np.sin(position[0] @ k)), "the damping is what is tested"


def test_outside_the_box_the_truth_is_zero(tmp_path):
    """A ball on the face x = low: 18 of its 27 nodes are not outside; of their weight 5/6, and so of a uniform flow."""
    write_truth(tmp_path / "v.zarr", lambda x, t: np.broadcast_to([0.0, 0.0, 3.0], x.shape), TIMES[:1])
    position = np.array([ORIGIN + [0, 0.8, 1.2], ORIGIN + [-5.0, 0.8, 1.2]])
    turn = np.array([[1.0, 0, 0, 0]] * 2)
    truth = VelocitySequence.open(tmp_path / "v.zarr")
    mean, inside = dve.expected_velocity(truth, 0, position, np.full((2, 3), 0.1), turn)
    np.testing.assert_allclose(inside, [5 / 6, 0], atol=1e-12)
    np.testing.assert_allclose(mean, [[0, 0, 2.5], [0, 0, 0]], atol=1e-6)


def test_what_cannot_be_scored_is_said(folder, tmp_path):
    gaussians = random_gaussians(5)
    gaussians.dynamic[:] = False
    with pytest.raises(DataFormatError, match="no moving Gaussian"):
        scored(cloud_of(gaussians, tmp_path / "still.npz"), folder)
    gaussians.dynamic[:] = True
    gaussians.t_mu[:], gaussians.t_sigma[:] = 500.0, 0.01
    nothing = scored(cloud_of(gaussians, tmp_path / "late.npz"), folder)
    assert nothing.dve is None and "same clock" in nothing.rows()[0][1]


def test_a_true_velocity_of_zero_has_no_score(folder, tmp_path):
    still = tmp_path / "data"
    still.mkdir()
    (still / "dataset.json").write_text((folder / "dataset.json").read_text())
    write_truth(still / "velocity.zarr", lambda x, t: np.zeros(x.shape))
    gaussians = random_gaussians(5)
    gaussians.dynamic[:] = True
    gaussians.t_mu[:], gaussians.t_sigma[:] = 0.02, 1.0
    found = scored(cloud_of(gaussians, tmp_path / "result.npz"), still)
    assert found.dve.l2 is None and found.dve.frames_scored == 0 and "zero" in found.warnings[0]
    assert ("DVE L2", "undefined") in found.rows()


def test_a_dataset_without_true_velocity_is_named(folder, tmp_path):
    with pytest.raises(DataFormatError, match="gof generate"):
        dve.true_velocity(tmp_path)
    content = json.loads((folder / "dataset.json").read_text()) | {"velocity": None}
    (tmp_path / "dataset.json").write_text(json.dumps(content))
    with pytest.raises(DataFormatError, match="no true velocity"):
        dve.true_velocity(tmp_path)
