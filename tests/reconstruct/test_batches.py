"""Batches: every picture once an epoch, frames far apart, and steps that do what theirs would do one by one."""

from collections import Counter
from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from gof.dataset import Dataset
from gof.reconstruct import optimize
from gof.reconstruct.batches import (
    LIFE,
    MOST,
    PIXELS,
    Batch,
    TrainingPictures,
    count_together,
    expect_together,
    sort_by_picture,
)
from gof.reconstruct.methods import OURS
from gof.reconstruct.observation import observe
from gof.reconstruct.surroundings import Plates, StillScene
from gof.reconstruct.unseen import FlameEmission, imagine_views
from gof.reconstruct.voxels import carve
from gof.reconstruct.windows import Windows
from tests.reconstruct.rising_flame import DT, column, write_flame


@pytest.fixture(scope="module")
def observed(tmp_path_factory):
    """Three cameras; some of their pictures were not delivered."""
    seen = observe(Dataset.open(write_flame(tmp_path_factory.mktemp("batches") / "flame")))
    delivered = seen.delivered.copy()
    delivered[2, 1] = delivered[3, 0] = False
    return replace(seen, delivered=delivered)


def epochs(pictures: TrainingPictures, count: int, seed: int = 0):
    """All batches of so many epochs; each begins where the last ended."""
    done, total, batches = 0, count * pictures._pictures, []
    while done < total:
        batches.append(pictures.choose(seed, done, total - done))
        done += len(batches[-1].frames)
    return batches


@pytest.mark.parametrize("together", [1, 2, 3, 50])
def test_an_epoch_has_every_delivered_picture_once(observed, together):
    pictures = TrainingPictures(observed, Windows.whole(observed.cameras), together=together)
    batches = epochs(pictures, 2)
    found = Counter((f, batch.c) for batch in batches for f in batch.frames)
    assert found == {tuple(place): 2 for place in np.argwhere(observed.delivered).tolist()}
    assert [batch.number for batch in batches] == list(range(len(batches)))
    assert max(len(batch.frames) for batch in batches) == min(together, observed.delivered.sum(0).max())
    orders = [[(b.c, b.frames) for b in part] for part in (batches[: len(batches) // 2], batches[len(batches) // 2 :])]
    assert sorted(orders[0]) == sorted(orders[1])
    assert orders[0] != orders[1] or together == 50, "each epoch has an order of its own"


def test_frames_of_a_batch_are_as_far_apart_as_can_be(observed):
    frames = len(observed.delivered)
    for batch in epochs(TrainingPictures(observed, Windows.whole(observed.cameras), together=3), 1):
        assert (np.diff(batch.frames) >= (frames - 1) // 3).all()


def test_frames_with_and_without_a_view_from_around_are_never_together(observed):
    class Imagined:
        frames = np.array([0, 1, 4, 5])

    pictures = TrainingPictures(observed, Windows.whole(observed.cameras), Imagined(), together=3)
    kinds = [np.isin(batch.frames, Imagined.frames) for batch in epochs(pictures, 1)]
    assert all(kind.all() or not kind.any() for kind in kinds) and len({bool(kind[0]) for kind in kinds}) == 2


def test_a_run_goes_on_where_it_was_and_ends_in_time(observed):
    """Within a batch, too, as a run of another number together may have left it."""
    pictures = TrainingPictures(observed, Windows.whole(observed.cameras), together=3)
    whole = epochs(pictures, 1)
    assert pictures.choose(0, 0, 1).frames == whole[0].frames[:1]
    rest = pictures.choose(0, 1, 100)
    assert (rest.c, rest.frames, rest.number) == (whole[0].c, whole[0].frames[1:], 0)
    again = TrainingPictures(observed, Windows.whole(observed.cameras), together=3)
    assert again.choose(0, len(whole[0].frames), 100) == whole[1]


def test_as_many_frames_are_together_as_lives_fit_into_the_clip():
    times = np.arange(41) * 0.01
    assert count_together(np.full(9, 0.4 / LIFE / 2.5), times, 100) == 2
    assert count_together(np.full(9, 1e-4), times, 100) == MOST
    assert count_together(np.full(9, 10.0), times, 100) == count_together(np.zeros(0), times, 100) == 1
    assert count_together(np.full(9, 1.0), times[:1], 100) == 1
    assert [count_together(np.full(9, 1e-4), times, PIXELS // k) for k in (3, 2, 1)] == [3, 2, 1]
    assert count_together(np.full(9, 1e-4), times, 10 * PIXELS) == 1


def test_a_forecast_counts_on_as_many_as_the_demo_has():
    assert [expect_together(*clip) for clip in ((32, 52_560), (88, 30_000), (50, 10 * PIXELS), (1, 9), (0, 0))] == [
        *(3, MOST, 1, 1, 1)
    ]


def make_flame(observed, surroundings, lives):
    windows = Windows.whole(observed.cameras)
    seeds = column(observed.time_s, 400)
    seeds = replace(seeds, t_sigma=np.full(400, lives * DT, np.float32), scale=np.clip(seeds.scale, 0.011, 0.29))
    schedule = optimize.Schedule(100, OURS.rates, gas_apart=True)
    return optimize.Flame(seeds, observed, windows, surroundings, schedule, optimize.Units(0.1, DT)), schedule


def find_gradients(flame, schedule, pictures, batch, monkeypatch):
    """Loss of a batch, and its gradient to every raw parameter of every Gaussian, (N,) a column."""
    sort, taken = sort_by_picture, []

    def noted(alight):
        taken.append(sort(alight))
        return taken[-1]

    monkeypatch.setattr(optimize, "sort_by_picture", noted)
    unseen = pictures.unseen.view(batch.frames, 3)
    shown = flame.shown(batch, unseen)
    drawn = flame.drawn(shown, batch)
    loss = optimize._loss(drawn, pictures, batch, schedule, clipped=flame.surroundings.emissive)
    loss += 0.3 * flame.loss_unseen(shown, unseen, np.array([0.1, 0.2, 0.3]))
    dr.backward(loss)
    rows, again, _ = taken[-1]
    places, found = np.concatenate([rows, rows[again]]), {}
    for name, value in shown.raw.items():
        planes = dr.grad(value) if dr.depth_v(value) > 1 else [dr.grad(value)]
        for k, plane in enumerate(planes):
            found[name, k] = np.zeros(400)
            np.add.at(found[name, k], places, np.broadcast_to(plane.numpy(), len(places)))
    for name in flame.surroundings.unknowns():
        found |= {(name, k): np.array(plane.numpy()) for k, plane in enumerate(dr.grad(flame.optimizer[name]))}
    return float(loss.array[0]), found, len(again)


@pytest.mark.usefixtures("kernels")
@pytest.mark.parametrize("lives, shutter", [(0.3, 0.0), (6.0, 0.0), (6.0, DT / 96)])
@pytest.mark.parametrize("kind", ["plates", "emissive", "still"])
def test_a_batch_teaches_the_mean_of_its_pictures(observed, kind, lives, shutter, monkeypatch):
    """Its loss and every gradient, whether Gaussians shine in one of its frames or in all."""
    cameras = [replace(camera, row_time_s=shutter) for camera in observed.cameras]
    observed = replace(observed, cameras=cameras)
    blocked = observed.blocked.copy()
    blocked[:, 40:50, :20] = True
    if kind == "still":
        still = replace(column(observed.time_s, 60), dynamic=np.zeros(60, bool))
        surroundings = StillScene(still, cameras, carve(cameras, observed.mask, 24))
    else:
        surroundings = Plates(cameras, observed.plate, blocked, move=True, emissive=kind == "emissive")
    voxels = carve(cameras, observed.mask, 24)
    light = np.random.default_rng(0).random((len(observed.time_s), len(voxels.center))).astype(np.float32)
    unseen = imagine_views(FlameEmission(voxels, light), observed)
    pictures = TrainingPictures(observed, Windows.whole(cameras), unseen)
    flame, schedule = make_flame(observed, surroundings, lives)
    together = find_gradients(flame, schedule, pictures, Batch(2, (0, 4, 7), 0), monkeypatch)
    alone = []
    for f in (0, 4, 7):
        flame, schedule = make_flame(observed, surroundings, lives)
        alone.append(find_gradients(flame, schedule, pictures, Batch(2, (f,), 0), monkeypatch))
    assert (together[2] > 0) == (lives > 1), "Gaussians in two frames"
    assert together[0] == pytest.approx(np.mean([loss for loss, _, _ in alone]), rel=1e-5)
    for name, gradient in together[1].items():
        wanted = np.mean([found[name] for _, found, _ in alone], axis=0)
        # A pair within rounding of 1/255 may flip, and then is a Gaussian's whole gradient.
        scale = np.abs(wanted).max() + 1e-12
        assert (np.abs(gradient - wanted) < 2e-3 * scale).mean() > 0.99, name
        assert np.linalg.norm(gradient - wanted) < 1e-2 * np.linalg.norm(wanted) + 1e-12, name
