"""`gof evaluate` on a synthetic flame: truth pictures drawn from known Gaussians in a known flow."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.commands.evaluate import main
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.core.trajectory import Trajectory
from gof.dataset import Dataset
from gof.evaluate import Scores, evaluate
from tests.evaluate.synthetic_flame import flame_dataset

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def flame(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flame")
    truth = flame_dataset(folder / "data")
    return folder, Dataset.open(folder / "data"), truth


def changed(g: TransientGaussians, **fields) -> TransientGaussians:
    return TransientGaussians(**{name: fields.get(name, getattr(g, name)) for name in g.__dataclass_fields__})


def test_the_truth_scores_perfectly(flame):
    _, dataset, truth = flame
    scores = evaluate(truth, dataset)
    assert scores.dve.l2 < 0.02 and scores.dve.cos_sim > 0.999  # what remains is the grid's interpolation
    assert scores.dve.frames_scored == len(dataset.times_s) and scores.dve.order == 3
    assert scores.psnr_flame > 45 and scores.ssim_flame > 0.99  # 8-bit rounding
    assert scores.psnr_flame_plate < 30 and scores.psnr_flame > scores.psnr_flame_plate + 15
    assert scores.psnr_plate > scores.psnr_flame_plate  # most of the picture has no flame
    assert scores.images.count == 2 * len(dataset.test_frames)
    assert set(scores.costs) == {"load", "dve", "quadrature", "render", "images"}
    assert [warning.partition(",")[0] for warning in scores.warnings] == ["the dataset has no grids/flame.zarr"]


def test_worse_results_score_worse_in_what_they_get_wrong(flame):
    _, dataset, truth = flame
    right = evaluate(truth, dataset)
    slow = evaluate(changed(truth, velocity=0.5 * truth.velocity), dataset, images=False)
    assert slow.dve.l2 == pytest.approx(0.5, abs=0.05) and slow.dve.speed_ratio == pytest.approx(0.5, abs=0.05)
    assert slow.dve.cos_sim > 0.99 and slow.images is None and slow.psnr is None and "render" not in slow.costs
    dim = evaluate(changed(truth, opacity=0.3 * truth.opacity), dataset)
    assert dim.psnr_flame < right.psnr_flame - 10
    assert dim.dve.l2 == pytest.approx(right.dve.l2, abs=1e-4)  # a common factor of the weights cancels


def test_a_gas_that_is_faster_than_its_light_is_scored_and_light_is_a_trivial_baseline(flame):
    """The light as it is, at half of the gas' speed: the result is right, its light half of the truth off."""
    _, dataset, truth = flame
    scores = evaluate(replace(truth, velocity=0.5 * truth.velocity, gas_velocity=truth.velocity), dataset, images=False)
    assert scores.dve.l2 < 0.05 and scores.trivial_baselines["light"].l2 == pytest.approx(0.5, abs=0.05)
    assert scores.dve.skill_over_light == pytest.approx(1 - (scores.dve.l2 / scores.trivial_baselines["light"].l2) ** 2)
    assert evaluate(truth, dataset, images=False).dve.skill_over_light is None


def test_own_static_background_replaces_the_plate(flame):
    _, dataset, truth = flame
    static = changed(truth[:1], dynamic=np.zeros(1, bool), opacity=np.full(1, 1e-3))
    scores = evaluate(TransientGaussians.concatenate([truth, static]), dataset)
    assert scores.psnr < evaluate(truth, dataset).psnr - 10  # drawn over black: the background is missing


def test_a_set_without_dynamic_gaussians_is_an_error(flame):
    _, dataset, truth = flame
    with pytest.raises(GofError, match="no dynamic"):
        evaluate(changed(truth, dynamic=np.zeros(len(truth), bool)), dataset)


def test_command_line(flame, capsys):
    folder, _, truth = flame
    truth.save(folder / "result.npz")
    out, extra = folder / "scores", folder / "copy.json"
    assert (
        main([str(folder / "result.npz"), "--dataset", str(folder / "data"), "--out", str(out), "--json", str(extra)])
        == 0
    )
    printed = capsys.readouterr().out
    assert "CosSim" in printed and "trivial: constant" in printed and "background alone" in printed
    scores = Scores.read(out / "scores.json")
    assert "two frames around" in printed and scores.psnr_flame_plate < scores.psnr_flame_between < 100
    assert scores == Scores.read(extra)
    assert {"zero", "random", "constant"} <= set(scores.trivial_baselines) and scores.dve.l2 < 0.02
    with pytest.raises(DataFormatError):
        main([str(folder / "nothing.npz"), "--dataset", str(folder / "data")])


def test_without_velocity_truth_or_masks(tmp_path):
    truth = flame_dataset(tmp_path / "real", velocity=False, masks=False)
    scores = evaluate(truth, Dataset.open(tmp_path / "real"))
    assert scores.dve is None and scores.trivial_baselines == {} and "no true velocity" in scores.warnings[0]
    assert scores.psnr > 45 and scores.psnr_flame is None and scores.psnr_flame_plate is None


def test_other_methods_through_the_whole_path(flame, tmp_path):
    """FTGS-PLY, a trajectory at half steps, a result in another world with its cameras: all score as the original."""
    from gof.core.ftgs import save
    from gof.io.importers import ImportOptions

    _, dataset, truth = flame
    original = evaluate(truth, dataset)
    times = dataset.times_s
    ftgs = evaluate(save(truth, tmp_path / "a.ftgs.ply", times[0], times[-1], len(times)), dataset, flame_only=True)
    assert ftgs.import_.method == "freetime" and ftgs.dve.l2 == pytest.approx(original.dve.l2, abs=1e-4)
    assert ftgs.psnr == pytest.approx(original.psnr, abs=0.2)

    steps = np.arange(times[0], times[-1] + 1e-9, (times[1] - times[0]) / 2)
    states = [truth.at(t) for t in steps]
    Trajectory(
        steps,
        np.stack([p for p, _ in states]),
        np.stack([o for _, o in states]),
        truth.scale,
        truth.rotation,
        color=truth.color,
    ).save(tmp_path / "t.npz")
    sampled = evaluate(tmp_path / "t.npz", dataset, flame_only=True)
    assert sampled.dve.l2 == pytest.approx(original.dve.l2, abs=2e-3) and sampled.psnr == pytest.approx(
        original.psnr, abs=0.1
    )
    assert set(sampled.trivial_baselines) == set(original.trivial_baselines)
    for name in ("zero", "constant", "height_mean", "true_centre", "shuffled"):
        assert sampled.trivial_baselines[name].l2 == pytest.approx(original.trivial_baselines[name].l2, abs=2e-2)

    own_world = np.eye(4)
    own_world[:3, :3] = 0.4 * np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0.0]])
    own_world[:3, 3] = 5
    inverse = np.linalg.inv(own_world)
    cameras = {}
    for c in dataset.cameras:
        pose = own_world @ np.linalg.inv(c.world_to_camera)
        pose[:3, :3] /= 0.4
        cameras[c.name] = np.linalg.inv(pose).tolist()
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    truth.transformed(own_world).save(tmp_path / "elsewhere.npz")
    lost = evaluate(tmp_path / "elsewhere.npz", dataset, images=False)
    assert lost.dve.weight_outside == pytest.approx(1) and any("world" in warning for warning in lost.warnings)
    aligned = evaluate(tmp_path / "elsewhere.npz", dataset, align=tmp_path / "cameras.json")
    np.testing.assert_allclose(aligned.import_.alignment.matrix, inverse, atol=1e-6)
    assert aligned.import_.alignment.position_rms_m < 1e-6
    assert aligned.dve.l2 == pytest.approx(original.dve.l2, abs=1e-3) and aligned.psnr == pytest.approx(
        original.psnr, abs=0.1
    )
    theirs = (tmp_path / "a.ftgs.ply").read_bytes().replace(b"gof_clip_s", b"other_word")
    (tmp_path / "a.ftgs.ply").write_bytes(theirs)
    with pytest.raises(DataFormatError, match="--time-unit"):
        evaluate(
            tmp_path / "a.ftgs.ply",
            replace(dataset, times_s=dataset.times_s[:1]),
            foreign=ImportOptions(),
        )


def test_a_checkpoint_of_the_papers_code_through_the_whole_path(flame, tmp_path):
    """The known Gaussians in its layout and units (ms, bounded scales, un-normalised quaternions) score as they are."""
    torch = pytest.importorskip("torch")
    _, dataset, truth = flame
    n, (low, high) = len(truth), (0.005, 0.08)
    logit = lambda x: np.log(x / (1 - x))  # noqa: E731
    rest = np.zeros((n, 15, 3))
    arrays = [
        truth.position,
        truth.velocity / 1000,
        ((truth.color - 0.5) / 0.28209479177387814)[:, None],
        rest,
        logit((truth.scale - low) / (high - low)),
        3 * truth.rotation,
        logit(truth.opacity)[:, None],
        1000 * truth.t_mu[:, None],
        1000 * truth.t_sigma[:, None],
    ]
    tensors = [torch.nn.Parameter(torch.tensor(np.asarray(a, np.float32))) for a in arrays]
    torch.save(
        (
            (
                3,
                *tensors,
                torch.ones(n, dtype=torch.bool),
                torch.zeros(n),
                torch.zeros(n, 1),
                torch.zeros(n, 1),
                {},
                np.float64(3.0),
            ),
            7000,
        ),
        tmp_path / "chkpnt7000.pth",
    )
    (tmp_path / "scale_bounds.json").write_text(json.dumps({"dynamic_scale_min": low, "dynamic_scale_max": high}))
    original, got = evaluate(truth, dataset), evaluate(tmp_path, dataset, flame_only=True)
    assert got.import_.method == "authors" and got.dve.l2 == pytest.approx(original.dve.l2, abs=1e-4)
    assert got.dve.cos_sim == pytest.approx(original.dve.cos_sim, abs=1e-5) and got.psnr == pytest.approx(
        original.psnr, abs=0.05
    )
    as_it_is = evaluate(tmp_path, dataset)
    assert as_it_is.psnr < got.psnr - 3 and any("over black" in note for note in as_it_is.import_.notes)


def test_nobodys_empty_scene_is_given_our_plates(flame, tmp_path):
    """A foreign result that shows nothing scores what a black picture scores, not what our true plate scores."""
    _, dataset, truth = flame
    times = dataset.times_s
    position = np.repeat(truth.position[None], len(times), 0)
    nothing = Trajectory(times, position, np.full((len(times), len(truth)), 1e-6), truth.scale, truth.rotation)
    nothing.save(tmp_path / "method.npz")
    scores = evaluate(tmp_path / "method.npz", dataset)
    black = [
        -10 * np.log10(np.mean(dataset.image(c, k) ** 2.0))
        for c in range(len(dataset.cameras))
        for k in dataset.test_frames
    ]
    assert scores.import_.method == "trajectory" and scores.psnr == pytest.approx(np.mean(black), abs=0.01)
    drawn_over = evaluate(tmp_path / "method.npz", dataset, flame_only=True)
    assert drawn_over.psnr == pytest.approx(scores.psnr_plate, abs=0.01) and drawn_over.psnr > scores.psnr + 1


def test_perfect_pictures_count_in_the_mean(flame, tmp_path, capsys):
    """A camera that saw no fire, and a result that draws nothing: 100 dB there, and the mean is of all pictures."""
    folder, _, truth = flame
    shutil.copytree(folder / "data", tmp_path / "data")
    dataset = Dataset.open(tmp_path / "data")
    for frame in dataset.test_frames:
        shutil.copy(dataset.file(0, "static"), dataset.file(0, "rgb", frame))
    changed(truth, opacity=0 * truth.opacity + 1e-6).save(tmp_path / "nothing.npz")
    out = tmp_path / "scores.json"
    assert main([str(tmp_path / "nothing.npz"), "--dataset", str(tmp_path / "data"), "--json", str(out)]) == 0
    scores = Scores.read(out)
    psnr = [picture.psnr for picture in scores.images.pictures]
    assert [p for p, picture in zip(psnr, scores.images.pictures, strict=True) if picture.camera == "cam_0"] == [100.0]
    assert scores.psnr == pytest.approx(np.mean(psnr)) and None not in psnr and len(psnr) == scores.images.count


def test_scores_land_beside_the_result_and_the_page_finds_them(flame, tmp_path, capsys):
    """README's rows in their order: evaluate, then report; and what report says when they are missing works."""
    folder, _, truth = flame
    data, out = str(folder / "data"), tmp_path / "out"
    truth.save(out / "result.npz")
    assert gof(["report", str(out), "--dataset", data]) == 1
    said = capsys.readouterr().err
    assert f"gof evaluate RESULT --dataset DATASET --out {out}" in said
    words = (
        said.split("to write it: gof ")[1].replace("RESULT", str(out / "result.npz")).replace("DATASET", data).split()
    )
    assert gof(words) == 0 and (out / "scores.json").is_file()
    (out / "scores.json").unlink()
    assert gof(["evaluate", str(out / "result.npz"), "--dataset", data]) == 0
    assert f"{out / 'scores.json'}" in capsys.readouterr().out.replace("\n", "")
    assert gof(["report", str(out), "--dataset", data]) == 0 and (out / "report.html").is_file()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert ">two frames around</td>" in page and "2D baseline" in page
    assert gof(["evaluate", str(out), "--dataset", data, "--no-images"]) == 0, "the folder of a result, and again"
    assert Scores.read(out / "scores.json").images is None


def test_scores_of_another_result_are_not_replaced_unasked(flame, tmp_path, capsys):
    folder, _, truth = flame
    truth.save(tmp_path / "a.npz")
    truth[:50].save(tmp_path / "b.npz")
    asking = ["--dataset", str(folder / "data"), "--no-images"]
    assert gof(["evaluate", str(tmp_path / "a.npz"), *asking]) == 0
    before = (tmp_path / "scores.json").read_bytes()
    assert gof(["evaluate", str(tmp_path / "b.npz"), *asking]) == 1
    assert "holds the scores of another result" in capsys.readouterr().err
    (tmp_path / "scores.json").write_text("mine")
    assert gof(["evaluate", str(tmp_path / "b.npz"), *asking]) == 1
    assert (tmp_path / "scores.json").read_text() == "mine"
    assert gof(["evaluate", str(tmp_path / "b.npz"), *asking, "--json", str(tmp_path / "b.json")]) == 0
    assert (tmp_path / "scores.json").read_text() == "mine" and before


def test_without_held_out_frames_it_is_said(flame, tmp_path, capsys):
    folder, _, truth = flame
    shutil.copytree(folder / "data", tmp_path / "data")
    about = json.loads((tmp_path / "data/dataset.json").read_text())
    about["splits"] = {"train": sorted(about["splits"]["train"] + about["splits"]["test"]), "test": []}
    (tmp_path / "data/dataset.json").write_text(json.dumps(about))
    truth.save(tmp_path / "r/result.npz")
    assert gof(["evaluate", str(tmp_path / "r"), "--dataset", str(tmp_path / "data")]) == 0
    assert "holds no frame out" in " ".join(capsys.readouterr().out.split())
    assert gof(["leaderboard", str(tmp_path / "r"), "--out", str(tmp_path / "b")]) == 0
    assert "holds no frame out" in " ".join(capsys.readouterr().out.split())
