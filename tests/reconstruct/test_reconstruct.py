"""The whole reconstruction on a cloud of Gaussians whose motion we chose."""

import numpy as np
import pytest
from tests.conftest import arc, write_dataset

from gof.dataset import Dataset
from gof.errors import GofError, NonFiniteError
from gof.evaluate import dve
from gof.fields import VelocityField
from gof.gaussians import TransientGaussians
from gof.reconstruct.run import ReconstructConfig, reconstruct
from gof.render import render

RISE = np.array([0.1, 0.0, 1.2])  # m/s
DT = 0.02


@pytest.fixture(scope="module")
def rising_flame(tmp_path_factory):
    """A textured column rising at a constant velocity through three views: truth for position, speed and picture."""
    rng = np.random.default_rng(0)
    n, frames = 500, 10
    times = DT * np.arange(frames)
    cameras = arc(3, width=48, height=96, focal_px=110.0)
    position = np.stack([*rng.normal(0, 0.08, (2, n)), rng.uniform(-0.2, 1.8, n)], -1) - RISE * times.mean()
    flame = TransientGaussians(
        position=position, velocity=np.tile(RISE, (n, 1)), t_mu=np.full(n, 0.0), t_sigma=np.full(n, np.inf),
        scale=rng.uniform(0.015, 0.04, (n, 3)), rotation=rng.normal(size=(n, 4)), opacity=rng.uniform(0.05, 0.5, n),
        color=np.array([1.0, 0.6, 0.15]) * rng.uniform(0.5, 1, (n, 1)), dynamic=np.ones(n, bool))
    plates = np.full((3, 96, 48, 3), 0.15) + 0.1 * rng.random((3, 96, 48, 1))
    images = [[render(flame, cam, t, background=plates[c])["color"] for c, cam in enumerate(cameras)] for t in times]
    grid = VelocityField.from_array(np.broadcast_to(RISE, (8, 8, 24, 3)), (-0.6, -0.6, -0.8), 0.15)
    fields = [VelocityField(grid.velocity, grid.index_to_world, t) for t in times]
    return write_dataset(tmp_path_factory.mktemp("rising") / "flame", cameras, np.array(images), plates, times, fields, test_frames=[4])


def config(dataset, out, **changes):
    return ReconstructConfig(dataset, out, **{"gaussians": 1500, "iterations": 200, "voxels": 32} | changes)


@pytest.fixture(scope="module")
def result(rising_flame, tmp_path_factory):
    return reconstruct(config(rising_flame, tmp_path_factory.mktemp("out")))


def test_velocity_is_recovered(rising_flame, result):
    dataset, gaussians = Dataset.open(rising_flame), TransientGaussians.load(result)
    for t in dataset.times_s[[2, 4, 7]]:
        score = dve(gaussians, dataset.velocity.at(t), t)
        assert score.cos_sim > 0.9 and score.l2 < 0.5
    weight = gaussians.opacity * gaussians.scale.prod(-1)
    np.testing.assert_allclose((weight[:, None] * gaussians.velocity).sum(0) / weight.sum(), RISE, atol=0.35)


def test_held_out_picture_is_explained(rising_flame, result):
    dataset, gaussians = Dataset.open(rising_flame), TransientGaussians.load(result)
    for c, camera in enumerate(dataset.cameras):
        truth, plate = dataset.image(c, 4), dataset.static(c)
        ours = render(gaussians, camera, dataset.times_s[4], background=plate)["color"]
        assert ((ours - truth) ** 2).mean() < 0.1 * ((plate - truth) ** 2).mean()


def test_optimisation_improves_on_its_seeds(rising_flame, result):
    dataset = Dataset.open(rising_flame)

    def error(gaussians):
        return np.mean([((render(gaussians, cam, dataset.times_s[2], background=dataset.static(c))["color"] - dataset.image(c, 2)) ** 2).mean()
                        for c, cam in enumerate(dataset.cameras)])

    assert error(TransientGaussians.load(result)) < 0.3 * error(TransientGaussians.load(result.parent / "seeds.npz"))


def test_files_pictures_and_costs_are_left(result):
    out = result.parent
    names = {p.name for p in out.rglob("*") if p.is_file()}
    assert {"result.npz", "result.ply", "costs.json", "1_masks.png", "2_optical_flow.png", "3_flow_field.png"} <= names
    assert "checkpoint.npz" not in names
    a, b = TransientGaussians.load(out / "result.ply"), TransientGaussians.load(result)
    np.testing.assert_allclose(a.velocity, b.velocity)


def test_a_finished_result_is_kept_and_other_settings_are_refused(rising_flame, result):
    before = result.stat().st_mtime_ns
    assert reconstruct(config(rising_flame, result.parent)) == result
    assert result.stat().st_mtime_ns == before
    with pytest.raises(GofError, match=r"iterations differ"):
        reconstruct(config(rising_flame, result.parent, iterations=7))


def test_interrupted_optimisation_resumes_from_its_checkpoint(rising_flame, tmp_path, monkeypatch):
    from gof.reconstruct import optimize

    monkeypatch.setattr(optimize, "CHECKPOINT_EVERY", 20)
    steps = []
    real = optimize.render_splats

    def stop_after_50(*args, **kwargs):
        steps.append(1)
        if len(steps) == 50:
            raise KeyboardInterrupt
        return real(*args, **kwargs)

    monkeypatch.setattr(optimize, "render_splats", stop_after_50)
    with pytest.raises(KeyboardInterrupt):
        reconstruct(config(rising_flame, tmp_path, iterations=60))
    assert (tmp_path / "checkpoint.npz").exists() and not (tmp_path / "result.npz").exists()
    reconstruct(config(rising_flame, tmp_path, iterations=60))
    assert len(steps) == 50 + 20, "20 of 60 steps were left after the checkpoint at 40"


def test_nan_is_caught_and_named(rising_flame, tmp_path, monkeypatch):
    from gof.reconstruct import optimize

    monkeypatch.setattr(optimize, "CHECK_EVERY", 5)
    original = optimize.Schedule
    monkeypatch.setattr(optimize, "Schedule", lambda n: original(n, velocity=float("inf")))
    with pytest.raises(NonFiniteError, match="velocity"):
        reconstruct(config(rising_flame, tmp_path, iterations=10))
    assert not (tmp_path / "result.npz").exists()


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_scene_in_other_units_gives_the_same_scene(rising_flame, result, tmp_path, factor):
    """Cameras and truth in millimetres or kilometres: same pictures, so the same flame up to scale."""
    import json
    import shutil

    scaled = tmp_path / "scaled"
    shutil.copytree(rising_flame, scaled)
    meta = json.loads((scaled / "dataset.json").read_text())
    for camera in meta["cameras"]:
        for row in camera["world_to_camera"][:3]:
            row[3] *= factor
    (scaled / "dataset.json").write_text(json.dumps(meta))
    ours = TransientGaussians.load(reconstruct(config(scaled, tmp_path / "out", iterations=1)))
    base = TransientGaussians.load(result.parent / "seeds.npz")
    seeds = TransientGaussians.load(tmp_path / "out" / "seeds.npz")
    np.testing.assert_allclose(np.median(seeds.velocity, 0) / factor, np.median(base.velocity, 0), atol=0.02)
    np.testing.assert_allclose(np.median(seeds.position, 0) / factor, np.median(base.position, 0), atol=0.02)
    assert np.isfinite(ours.velocity).all()
