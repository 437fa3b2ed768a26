"""The whole reconstruction on a cloud of Gaussians whose motion we chose."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.commands.reconstruct import main
from gof.core.costs import StageLog
from gof.core.errors import DataFormatError, GofError, NonFiniteError
from gof.core.gaussians import TransientGaussians
from gof.core.records import read_record
from gof.dataset import Dataset
from gof.evaluate import dve
from gof.footage.pictures import read_picture
from gof.reconstruct import pipeline, stages
from gof.reconstruct.curve import Curve
from gof.reconstruct.settings import ReconstructionSettings
from gof.render import render
from tests.reconstruct.rising_flame import RISE, edit, mean_velocity, reconstruct, write_flame

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def rising_flame(tmp_path_factory):
    return write_flame(tmp_path_factory.mktemp("rising") / "flame")


@pytest.fixture(scope="module")
def result(rising_flame, tmp_path_factory):
    return reconstruct(rising_flame, tmp_path_factory.mktemp("out"))


def test_velocity_is_recovered(rising_flame, result):
    dataset, gaussians = Dataset.open(rising_flame), TransientGaussians.load(result)
    for t in dataset.times_s[[2, 4, 7]]:
        score = dve(gaussians, dataset.velocity.at(t), t)
        assert score.cos_sim > 0.9 and score.l2 < 0.5
    np.testing.assert_allclose(mean_velocity(gaussians), RISE, atol=0.35)


def test_held_out_picture_is_explained(rising_flame, result):
    dataset, gaussians = Dataset.open(rising_flame), TransientGaussians.load(result)
    for c, camera in enumerate(dataset.cameras):
        truth, plate = dataset.image(c, 4), dataset.static(c)
        ours = render(gaussians, camera, dataset.times_s[4], background=plate)["color"]
        assert ((ours - truth) ** 2).mean() < 0.1 * ((plate - truth) ** 2).mean()


def test_two_kinds_of_phones(rising_flame, result, tmp_path):
    """A camera with a smaller picture, whose right edge cuts the flame: as good, and its plate in its own size."""
    folder = shutil.copytree(rising_flame, tmp_path / "flame")
    for path in (folder / "static/cam_0.png", *(folder / "cameras/cam_0/rgb").iterdir()):
        cv2.imwrite(str(path), cv2.imread(str(path))[:88, :30])
    edit(folder, lambda meta: meta["cameras"][0].update(width=30, height=88))
    found = reconstruct(folder, tmp_path / "out")
    assert read_picture(found.parent / "plates/cam_0.png", unchanged=True).shape == (88, 30, 3)
    np.testing.assert_allclose(mean_velocity(TransientGaussians.load(found)), RISE, atol=0.35)
    scores = [Curve.read(path.parent).points[-1].scores.psnr_flame for path in (found, result)]
    assert scores[0] == pytest.approx(scores[1], abs=1.5)
    with pytest.raises(GofError, match=r"differ in size \(30x88, 48x96 px\).*--scene plates"):
        main([str(folder), "--scene", "gaussians", "--out", str(tmp_path / "still")])


def test_optimisation_improves_on_its_seeds(rising_flame, result):
    dataset = Dataset.open(rising_flame)

    def error(gaussians):
        return np.mean(
            [
                (
                    (
                        render(gaussians, cam, dataset.times_s[2], background=dataset.static(c))["color"]
                        - dataset.image(c, 2)
                    )
                    ** 2
                ).mean()
                for c, cam in enumerate(dataset.cameras)
            ]
        )

    assert error(TransientGaussians.load(result)) < 0.3 * error(TransientGaussians.load(result.parent / "seeds.npz"))


def test_files_pictures_and_costs_are_left(result):
    out = result.parent
    names = {p.name for p in out.rglob("*") if p.is_file()}
    assert {
        "result.npz",
        "result.ply",
        "costs.json",
        "1_masks.png",
        "2_optical_flow.png",
        "3_flow_field.png",
        "4_seeds.png",
        "5_result.png",
    } <= names
    assert "checkpoint.npz" not in names
    a, b = TransientGaussians.load(out / "result.ply"), TransientGaussians.load(result)
    np.testing.assert_allclose(a.velocity, b.velocity)


def test_a_finished_result_is_kept_and_other_settings_are_refused(rising_flame, result):
    before = result.stat().st_mtime_ns
    assert reconstruct(rising_flame, result.parent) == result
    assert result.stat().st_mtime_ns == before
    with pytest.raises(GofError, match=r"--steps differ"):
        reconstruct(rising_flame, result.parent, iterations=7)


def test_a_run_that_cannot_be_leaves_its_folder_free(rising_flame, tmp_path, capsys):
    """Its error says which options need less; with these the command goes on in the same folder."""
    out = tmp_path / "o"
    words = [str(rising_flame), "--out", str(out), "--steps", "5", "--gaussians", "100", "--until", "motion"]
    assert gof(["reconstruct", *words, "--voxels", "5000"]) == 1
    assert "need less" in capsys.readouterr().err and not (out / "settings.json").exists()
    assert gof(["reconstruct", *words, "--voxels", "24"]) == 0


def test_overwrite_replaces_a_reconstruction_and_nothing_else_in_its_folder(rising_flame, tmp_path, capsys):
    out = tmp_path / "o"
    words = ["reconstruct", str(rising_flame), "--out", str(out), "--gaussians", "300", "--voxels", "24"]
    words += ["--no-flow-prior", "--until", "seeds"]
    assert gof([*words, "--steps", "5"]) == 0
    (out / "notes.txt").write_text("windy")
    (out / "stages/mine.png").write_bytes(b"mine")
    (out / "snapshot.npz").write_bytes(b"of the run before")
    (out / "curve.json").write_bytes(b"of the run before")
    assert gof([*words, "--steps", "6"]) == 1
    assert "--steps differ" in capsys.readouterr().err and (out / "snapshot.npz").exists()
    assert gof([*words, "--steps", "6", "--voxels", "5000", "--overwrite"]) == 1
    assert (out / "snapshot.npz").exists(), "what cannot be made replaces nothing"
    assert gof([*words, "--steps", "6", "--until", "motion", "--overwrite"]) == 0
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == {
        *(".lock", "notes.txt", "stages/mine.png", "settings.json", "costs.json", "made_from.json"),
        *("stages/1_masks.png", "stages/2_optical_flow.png", "stages/captions.json"),
    }
    assert read_record(ReconstructionSettings, out / "settings.json").iterations == 6


def test_what_is_returned_is_what_is_on_disk(rising_flame, result):
    """Also when everything was finished before."""
    settings = read_record(ReconstructionSettings, result.parent / "settings.json")
    again = pipeline.reconstruct(Dataset.open(rising_flame), settings, result.parent)
    assert again.path == result and again.count == len(TransientGaussians.load(result))
    assert [stage.name for stage in again.stages] == ["motion", "flow_field", "light", "seeds", "optimize"]
    assert again.held_out == Curve.read(result.parent).points[-1] and again.held_out.step == 200


def test_a_finished_run_returns_what_it_would_find(rising_flame, tmp_path):
    settings = ReconstructionSettings("flame", iterations=5, gaussians=300, voxels=24, longest_side=96)
    made = pipeline.reconstruct(Dataset.open(rising_flame), settings, tmp_path)
    assert made == stages.Reconstruction.find(tmp_path)


def test_stages_one_by_one(rising_flame, tmp_path, capsys):
    options = ["--gaussians", "300", "--voxels", "24", "--no-flow-prior"]
    options = [str(rising_flame), "--out", str(tmp_path / "o"), "--steps", "5", *options]
    made = {"motion": "2_optical_flow", "flow-field": "3_flow_field", "seeds": "4_seeds"}
    for stage, picture in made.items():
        assert main([*options, "--until", stage]) == 0
        assert f"stopped after {stage}" in capsys.readouterr().out
        assert max(p.stem for p in (tmp_path / "o/stages").glob("*.png")) == picture
    assert len(TransientGaussians.load(tmp_path / "o/seeds.npz")) > 250
    assert main(options) == 0 and (tmp_path / "o/result.npz").exists()


def test_interrupted_optimisation_resumes_from_its_checkpoint(rising_flame, tmp_path, monkeypatch):
    from gof.reconstruct import optimize, surroundings

    monkeypatch.setattr(optimize, "CHECKPOINT_EVERY", 20)
    steps = []
    real = surroundings.render_splats

    def stop_after_50(*args, **kwargs):
        steps.append(args[1].name)
        if len(steps) == 50:
            raise KeyboardInterrupt
        return real(*args, **kwargs)

    monkeypatch.setattr(surroundings, "render_splats", stop_after_50)
    with pytest.raises(KeyboardInterrupt):
        reconstruct(rising_flame, tmp_path, iterations=60)
    assert (tmp_path / "checkpoint.npz").exists() and not (tmp_path / "result.npz").exists()
    reconstruct(rising_flame, tmp_path, iterations=60)
    assert len(steps) == 50 + 20, "20 of 60 steps were left after the checkpoint at 40"
    assert steps[40:50] == steps[50:60], "and they draw the same pictures"


def test_training_seconds_survive_a_kill(rising_flame, tmp_path, monkeypatch):
    """A clock that is 1000 s later at every step: what the checkpoint had cost is counted, what was lost is not."""
    from gof.reconstruct import curve, optimize, stages, surroundings

    now, steps = [0.0], []
    for module in (stages, curve):
        monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(optimize, "CHECKPOINT_EVERY", 20)
    monkeypatch.setattr(optimize, "EVALUATE_AT", ())
    real = surroundings.render_splats

    def slow(*args, **kwargs):
        now[0] += 1000
        steps.append(now[0])
        if len(steps) == 50:
            raise KeyboardInterrupt
        return real(*args, **kwargs)

    monkeypatch.setattr(surroundings, "render_splats", slow)
    with pytest.raises(KeyboardInterrupt):
        reconstruct(rising_flame, tmp_path, iterations=60)
    reconstruct(rising_flame, tmp_path, iterations=60)
    costs = {stage.name: stage.seconds for stage in StageLog(tmp_path / "costs.json").stages()}
    assert costs["optimize"] == pytest.approx(60_000, abs=60), "40 steps of the first run, 20 of the second"
    assert Curve.read(tmp_path).points[-1].seconds == pytest.approx(60_000, abs=60)


def test_a_damaged_checkpoint_is_named(rising_flame, tmp_path, monkeypatch):
    from gof.reconstruct import optimize

    monkeypatch.setattr(optimize, "CHECKPOINT_EVERY", 5)
    small = {"iterations": 5, "gaussians": 300}
    done = reconstruct(rising_flame, tmp_path, **small)
    for name in ("result.npz", "result.ply"):
        (tmp_path / name).unlink()
    checkpoint = tmp_path / "checkpoint.npz"
    with np.load(done.parent / "seeds.npz") as seeds:
        arrays = {"step": np.array(3), "spent": np.zeros(2), "x0.value": np.full((3, len(seeds["x0"])), np.nan)}
    np.savez(checkpoint, **arrays)
    whole = checkpoint.read_bytes()
    for content in (b"", b"PK\3\4 not really", whole[: len(whole) // 2], whole):
        checkpoint.write_bytes(content)
        with pytest.raises(DataFormatError, match=r"checkpoint\.npz.*remove it, and the optimisation begins anew"):
            reconstruct(rising_flame, tmp_path, **small)


def test_nan_is_caught_and_named(rising_flame, tmp_path, monkeypatch):
    from gof.reconstruct import methods, optimize

    monkeypatch.setattr(optimize, "CHECK_EVERY", 5)
    faulty = replace(methods.OURS, rates=replace(methods.OURS.rates, velocity=float("inf")))
    monkeypatch.setitem(methods.METHODS, "gof", faulty)
    with pytest.raises(NonFiniteError, match="velocity"):
        reconstruct(rising_flame, tmp_path, iterations=10)
    assert not (tmp_path / "result.npz").exists()
