"""The optimiser's parts: shutter, checkpoints on a full disk, ablations, held-out scores, presets."""

import itertools
import resource
from dataclasses import asdict, astuple, replace
from types import SimpleNamespace

import cv2
import drjit as dr
import numpy as np
import pytest

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.image import psnr
from gof.footage.flame_mask import flame_mask
from gof.reconstruct import ablations, optimize
from gof.reconstruct.batches import Batch, TrainingPictures
from gof.reconstruct.curve import Curve, HeldOutScores
from gof.reconstruct.heldout import HeldOut
from gof.reconstruct.methods import OURS, PAPER
from gof.reconstruct.observation import observe
from gof.reconstruct.parameters import splats, to_raw
from gof.reconstruct.presets import PRESETS, Effort, effort_of
from gof.reconstruct.shrink import enlarge, shrink
from gof.reconstruct.windows import Windows
from gof.render import render, render_splats
from gof.render.backend import Float
from tests.conftest import arc
from tests.reconstruct.rising_flame import DT, column, edit, held_out, reconstruct, write_flame


@pytest.fixture(scope="module")
def flame(tmp_path_factory):
    return write_flame(tmp_path_factory.mktemp("rising") / "flame")


@pytest.fixture(scope="module")
def with_novel_view(flame):
    """The middle camera is kept for novel views."""
    import shutil

    folder = shutil.copytree(flame, flame.parent / "novel")
    return edit(folder, lambda meta: meta["cameras"][1].update(role="eval"))


@pytest.mark.parametrize("row_time_s", [0.0, DT / 96])
def test_the_optimiser_sees_what_the_renderer_draws(row_time_s):
    gaussians = column(DT * np.arange(10))
    gaussians.t_sigma[:] = 0.05
    gaussians.scale = np.clip(gaussians.scale, 0.011, 0.2)
    camera = replace(arc(1, width=48, height=96, focal_px=110.0)[0], row_time_s=row_time_s)
    frame = render_splats(splats(to_raw(gaussians, 0.1, 0.01), 0.1, 0.06 - 0.01, camera), camera)
    drawn = np.stack([c.numpy() for c in frame.color], -1).reshape(96, 48, 3)
    np.testing.assert_allclose(drawn, render(gaussians, camera, 0.06)["color"], atol=2e-3)
    still = render(gaussians, replace(camera, row_time_s=0.0), 0.06)["color"]
    assert (np.abs(drawn - still).max() > 0.02) == (row_time_s > 0), "the shutter makes a difference that can be seen"


@pytest.mark.parametrize("row_time_s", [0.0, DT / 96])
def test_another_picture_compiles_nothing(row_time_s):
    """Before, every picture of a camera with a rolling shutter had a kernel of its own."""
    raw = to_raw(column(DT * np.arange(10)), 0.1, 0.0)
    dr.enable_grad(raw["x0"], raw["t_mu"])
    misses = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for k, camera in enumerate(arc(4, width=48, height=96, focal_px=110.0)):
            dr.kernel_history_clear()
            camera = replace(camera, row_time_s=row_time_s * (1 + 0.1 * k))
            frame = render_splats(splats(raw, 0.1, 0.0123 * (k + 1), camera), camera)
            dr.backward(sum(dr.sum(dr.square(c)) for c in frame.color))
            dr.eval(dr.grad(raw["x0"]), dr.grad(raw["t_mu"]))
            misses.append(sum(not x["cache_hit"] for x in dr.kernel_history() if x["type"] == dr.KernelType.JIT))
    assert misses[2:] == [0, 0]


@pytest.mark.long
def test_rolling_shutter_is_undone(tmp_path):
    """Pictures read over a whole frame time: fitting them as read explains held-out ones better than as snapshots."""
    folder = write_flame(tmp_path / "rolling", row_time_s=DT / 96)
    small = {"gaussians": 1000, "iterations": 150, "voxels": 24}
    rolling = TransientGaussians.load(reconstruct(folder, tmp_path / "rolling_out", **small))
    truth = Dataset.open(write_flame(tmp_path / "global"))
    edit(folder, lambda meta: [camera.update(row_time_s=0.0) for camera in meta["cameras"]])
    ignored = TransientGaussians.load(reconstruct(folder, tmp_path / "ignored_out", **small))

    def error(gaussians):  # against snapshots, which no rolling shutter has touched
        return np.mean(
            [
                (
                    (render(gaussians, cam, truth.times_s[4], background=truth.static(c))["color"] - truth.image(c, 4))
                    ** 2
                ).mean()
                for c, cam in enumerate(truth.cameras)
            ]
        )

    assert error(rolling) < 0.8 * error(ignored)


@pytest.mark.long
def test_a_full_disk_costs_the_checkpoint_not_the_run(flame, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(optimize, "CHECKPOINT_EVERY", 20)
    small = {"gaussians": 3000, "iterations": 40, "voxels": 24}
    real = optimize.save_checkpoint

    def save_with_little_room(path, *args):
        """The operating system refuses to write more than 64 kB to a file, as a full disk does."""
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2**16, hard))
        try:
            real(path, *args)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    monkeypatch.setattr(optimize, "save_checkpoint", save_with_little_room)
    result = reconstruct(flame, tmp_path, **small)
    message = capsys.readouterr().err
    assert "checkpoint.npz: no checkpoint at step 20 (File too large)" in message and result.exists()
    assert not list(tmp_path.glob("*partial*")), "no half-written file stays"


def test_ablations_change_what_they_say(flame):
    rng = np.random.default_rng(0)
    times = np.zeros((3, 4))
    assert ablations.change_times("no-sync", times, DT)[:, 0].tolist() == [0, DT / 2, 0]
    seeds = column(DT * np.arange(10))
    shuffled = ablations.change_seeds("rand-flow", seeds, rng)
    np.testing.assert_allclose(
        np.linalg.norm(shuffled.velocity, axis=-1), np.linalg.norm(seeds.velocity, axis=-1), rtol=1e-5
    )
    assert np.linalg.norm(shuffled.velocity.mean(0)) < 0.15 * np.linalg.norm(seeds.velocity.mean(0))
    schedule = optimize.Schedule(10, PAPER.rates, gas_apart=False)
    assert ablations.change_schedule("no-mask", schedule).alpha_loss == 0
    assert ablations.change_schedule("joint-opt", schedule).rates.plate > 0
    for change, value in (
        (ablations.change_schedule, (schedule,)),
        (ablations.change_seeds, (seeds, rng)),
        (ablations.change_times, (times, DT)),
    ):
        assert change("none", *value) is value[0]


@pytest.mark.long
def test_plates_move_as_the_method_says_and_are_kept_beside_the_result(flame, tmp_path, monkeypatch):
    scored = {}

    def note_plates(self, gaussians, plates):
        scored[name] = plates[0]
        return HeldOutScores()

    monkeypatch.setattr(HeldOut, "score", note_plates)
    for name, change in {
        "paper": {"method": "paper", "scene": "plates"},
        "ours": {},
        "joint": {"ablation": "joint-opt"},
    }.items():
        reconstruct(flame, tmp_path / name, iterations=30, gaussians=500, voxels=24, **change)
        stored = background(Dataset.open(flame), 0, tmp_path / name)
        assert np.abs(stored - np.clip(scored[name], 0, 1)).max() < 1e-4
    seen = observe(Dataset.open(flame))
    assert np.abs(scored["paper"] - seen.static[0]).max() < 1e-6, "fixed"
    assert 0.002 < np.abs(scored["ours"] - seen.plate[0]).max() < 0.1, "moves a little"
    mean = seen.image[:, 0].mean(0)
    assert 0.005 < np.abs(scored["joint"] - mean).max() < 0.2, "starts from the mean picture"
    assert 0.2 < np.abs(scored["joint"] - seen.plate[0]).max()


@pytest.mark.long
def test_pictures_move_the_light_and_leave_the_gas(flame, tmp_path):
    """Wherever the pictures take a Gaussian, its gas moves as the field's did there: near what its seed was told."""
    small = {"iterations": 60, "gaussians": 500, "voxels": 24}
    for name, change in {"gof": {}, "paper": {"method": "paper"}, "random": {"ablation": "rand-flow"}}.items():
        out = tmp_path / name
        result = TransientGaussians.load(reconstruct(flame, out, scene="plates", **small, **change))
        seeds = TransientGaussians.load(out / "seeds.npz")
        assert not np.array_equal(result.velocity, seeds.velocity)
        if name == "paper":
            assert result.gas_velocity is None, "one velocity for both"
        elif name == "random":
            np.testing.assert_array_equal(result.gas_velocity, seeds.gas_velocity)
        else:
            away = np.linalg.norm(result.gas_velocity - seeds.gas_velocity, axis=1)
            speed = np.linalg.norm(seeds.gas_velocity, axis=1)
            assert 0 < np.median(away) < 0.2 * np.median(speed), "told again, a fraction of a voxel away"
            assert np.linalg.norm(result.gas_velocity, axis=1).max() < 1.5 * speed.max()


def test_held_out_scores_are_those_of_the_pictures(flame, with_novel_view):
    gaussians, data = column(DT * np.arange(10)), Dataset.open(with_novel_view)
    plates = [data.static(c) for c in range(2)]
    held_out_pictures = HeldOut(data, plates, near=0.01)
    perfect = held_out_pictures.score(gaussians, plates)
    assert perfect.psnr_flame > 45, "only 8-bit rounding is between them"
    assert perfect.psnr_flame_novel is None, "nobody is given a novel view's plate"
    nothing = held_out_pictures.score(gaussians[:1], plates)
    assert nothing.psnr_flame < 20
    novel = data.evaluation_view()
    alone = held_out_pictures.score(gaussians, [])
    drawn = render(gaussians, novel.cameras[0], data.times_s[4])["color"]
    expected = psnr(np.clip(drawn, 0, 1), novel.image(0, 4), flame_mask(novel.image(0, 4), novel.static(0)))
    assert alone.psnr_flame_novel == pytest.approx(expected, abs=1e-3)
    expected = np.mean(
        [
            psnr(render(gaussians[:1], cam, data.times_s[4], background=plates[c])["color"], data.image(c, 4))
            for c, cam in enumerate(data.cameras)
        ]
    )
    assert nothing.psnr == pytest.approx(expected, abs=1e-3)


@pytest.mark.long
def test_the_curve_follows_the_optimisation(with_novel_view, tmp_path, monkeypatch):
    monkeypatch.setattr(optimize, "EVALUATE_AT", (10, 40))
    result = reconstruct(with_novel_view, tmp_path, iterations=80, gaussians=1000, voxels=24)
    points = Curve.read(tmp_path).points
    assert [point.step for point in points] == [10, 40, 80]
    assert points[0].scores.psnr_flame < points[1].scores.psnr_flame < points[2].scores.psnr_flame
    assert points[0].seconds < points[1].seconds < points[2].seconds
    assert held_out(result).psnr_flame_novel is None, "with plates"


@pytest.mark.long
def test_a_scene_of_gaussians_is_a_result_by_itself(flame, with_novel_view, tmp_path):
    with pytest.raises(GofError, match="no pixel has stereo depth"):  # its plates are noise
        reconstruct(flame, tmp_path / "flat", scene="gaussians", iterations=10)
    (with_novel_view / "depth").mkdir()
    for name in ("cam_0", "cam_2"):
        np.save(with_novel_view / "depth" / f"{name}.npy", np.full((96, 48), 5.0, np.float32))
    small = {"iterations": 150, "gaussians": 1500, "voxels": 24}
    path = reconstruct(with_novel_view, tmp_path / "scene", scene="gaussians", **small)
    result = TransientGaussians.load(path)
    assert 0 < result.dynamic.sum() < len(result) and not (path.parent / "plates").exists()
    assert held_out(path).psnr_flame_novel > 15
    (path.parent / "result.npz").unlink()  # stopped before the end: the still scene is not made again
    made = (path.parent / "background.npz").stat().st_mtime_ns
    reconstruct(with_novel_view, tmp_path / "scene", scene="gaussians", **small)
    assert (path.parent / "background.npz").stat().st_mtime_ns == made
    with pytest.raises(GofError, match="--scene plates"):
        reconstruct(with_novel_view, tmp_path / "joint", scene="gaussians", ablation="joint-opt", **small)


def test_shrunk_datasets_see_the_same_scene(flame):
    full = Dataset.open(flame)
    assert shrink(full, 96) is full
    half = shrink(full, 48)
    assert half.image(0, 3).shape == (48, 24, 3) and half.static(1).shape == (48, 24, 3)
    assert half.image(0, 3).mean() == pytest.approx(full.image(0, 3).mean(), abs=1e-4)
    point = np.array([[0.1, 0.05, 1.2]])
    np.testing.assert_allclose(half.cameras[0].project(point)[0], full.cameras[0].project(point)[0] / 2)
    assert half.camera_times_s(0) is half.times_s and half.test_frames == [4]


def test_shrunk_datasets_shrink_the_views_kept_for_scores_too(with_novel_view):
    full = Dataset.open(with_novel_view)
    view = shrink(full, 48).evaluation_view()
    assert [camera.name for camera in view.cameras] == ["cam_1"] and view.image(0, 3).shape == (48, 24, 3)
    assert view.image(0, 3).mean() == pytest.approx(full.evaluation_view().image(0, 3).mean(), abs=1e-4)
    entries = full.description.cameras
    larger = replace(entries[1], width=96, height=192)
    only_novel_is_large = replace(full, description=replace(full.description, cameras=(entries[0], larger, entries[2])))
    assert shrink(only_novel_is_large, 96).evaluation_view().cameras[0].height == 96


def test_gaussians_of_small_pictures_look_as_blurred_at_full_size(flame):
    """Thin ones: between full-size pixels there are no gaps, where drawn small there are none."""
    full = Dataset.open(flame)
    quarter = shrink(full, 24)
    thin = replace(column(full.times_s), scale=np.full((500, 3), 1e-3, np.float32))
    wide = enlarge(thin, quarter)
    time_s = float(full.times_s[4])

    def drawn(gaussians, dataset):
        return render(gaussians, dataset.cameras[1], time_s)["alpha"]

    wanted = cv2.resize(drawn(thin, quarter), (48, 96), interpolation=cv2.INTER_CUBIC)
    far, near = (np.linalg.norm(drawn(g, full) - wanted) / np.linalg.norm(wanted) for g in (thin, wide))
    assert near < 0.25 < 0.6 < far
    assert enlarge(thin, full) is thin
    still = replace(thin, dynamic=np.zeros(500, bool))
    assert (enlarge(still, quarter).scale == thin.scale).all(), "what is no flame was not fitted to these pictures"


def test_light_beyond_white_is_free_where_a_camera_shows_white_and_nowhere_else(flame):
    """Target: left half white. Drawn: 1.3 everywhere. Only the right half is pushed."""
    dataset = shrink(Dataset.open(flame), 32)
    seen = observe(dataset)
    image = np.full_like(seen.image, 0.5)
    image[..., : image.shape[3] // 2, :] = 1.0
    seen = replace(seen, image=image)
    pictures = TrainingPictures(seen, Windows.whole(seen.cameras))
    height, width = image.shape[2:4]
    gradients, schedule = {}, optimize.Schedule(10, OURS.rates, gas_apart=True)
    for clipped in (True, False):
        drawn = [dr.full(Float, 1.3, height * width) for _ in range(3)]
        for plane in drawn:
            dr.enable_grad(plane)
        nothing = dr.zeros(Float, height * width)
        view = SimpleNamespace(color=drawn, share=nothing)
        dr.backward(optimize._loss(view, pictures, Batch(0, (0,), 0), schedule, clipped=clipped))
        gradients[clipped] = np.abs([dr.grad(plane).numpy() for plane in drawn]).reshape(3, height, width)
    inner = width // 2 - 6  # SSIM's window reaches over the border
    assert not gradients[True][..., :inner].any() and gradients[False][..., :inner].all()
    assert gradients[True][..., width // 2 :].all()


def test_presets_fill_what_is_not_given():
    assert asdict(effort_of("standard", steps=7)) == asdict(PRESETS["standard"]) | {"iterations": 7}


def test_a_long_clip_gets_as_much_for_each_picture_as_a_short_one():
    """The demo and the benchmark's fires (at most 50 frames, three cameras) have the preset's own figures."""
    for clip in ((32, 3), (44, 3), (14, 3), (44, 1)):
        assert effort_of("preview", clip=clip) == PRESETS["preview"]
    filmed, long = effort_of("preview", clip=(88, 3)), effort_of("preview", clip=(880, 3))
    assert 1.9 < filmed.iterations / PRESETS["preview"].iterations < 2.1
    assert 1.9 < filmed.gaussians / PRESETS["preview"].gaussians < 2.1
    assert (long.iterations, long.gaussians) == (10 * filmed.iterations, 10 * filmed.gaussians)
    assert (long.voxels, long.longest_side) == (filmed.voxels, filmed.longest_side)
    assert effort_of("standard", clip=(88, 3)) == PRESETS["standard"], "six thousand steps are enough for 264 pictures"
    assert effort_of("preview", steps=300, clip=(880, 3)).iterations == 300, "a given figure holds"
    assert effort_of("toy", clip=(880, 3)) == PRESETS["toy"]


def does_at_least_as_much(more: Effort, less: Effort) -> bool:
    return all(a >= b for a, b in zip(astuple(more), astuple(less), strict=True))


def test_every_preset_does_at_least_as_much_as_the_one_before():
    for less, more in itertools.pairwise(PRESETS.values()):
        assert does_at_least_as_much(more, less)
    preview = PRESETS["preview"]
    for name, value in asdict(PRESETS["preview"]).items():  # one field too small is noticed, whichever it is
        assert not does_at_least_as_much(replace(preview, **{name: value - 1}), preview)
