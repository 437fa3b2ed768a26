"""The whole way in: results into a submission, a check, a board; with small datasets in place of the suite's fires."""

import base64
import io
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from gof.commands.cli import main
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.core.records import read_record
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom
from gof.dataset.plates import save_plates
from gof.evaluate.scores import Scores
from gof.evaluate.submission import Submission
from gof.evaluate.suite_board import SuiteBoard
from gof_benchmark.commands import benchmark
from gof_benchmark.suite import pick, scenes_of
from gof_blender.pure.layout import Layout
from tests.evaluate.synthetic_flame import flame_dataset
from tests.evaluate.test_submission import METHOD

pytestmark = pytest.mark.long
SCENES = ("jet_two_cameras", "logs_landscape")


def disturbed(truth: TransientGaussians, by: float, seed: int) -> TransientGaussians:
    fields = {n: getattr(truth, n) for n in truth.__dataclass_fields__}
    noise = np.random.default_rng(seed).normal(0, by, truth.velocity.shape)
    return TransientGaussians(**fields | {"velocity": truth.velocity + noise})


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A suite of two test scenes, and results of a good method (two seeds) and a bad one."""
    work = tmp_path_factory.mktemp("bench")
    for scene in pick(scenes_of("preview"), SCENES):
        folder = work / "preview" / scene.name
        truth = flame_dataset(folder)
        Layout(folder).spec.write_text(json.dumps(scene.spec.to_dict()))
        for name, by, seed in (("good_0", 0.1, 0), ("good_1", 0.1, 1), ("bad", 1.0, 2)):
            result = work / "results" / name / scene.name
            result.mkdir(parents=True)
            disturbed(truth, by, seed).save(result / "result.npz")
            MadeFrom.of(["result.npz"], Dataset.open(folder).train_frames).write(result)
    for scene in SCENES:
        place = str(work / "preview" / scene)
        for run in (0, 1):
            result = str(work / f"results/good_{run}" / scene)
            assert benchmark.main(["add", result, str(work / "good"), "--dataset", place, "--run", f"seed_{run}"]) == 0
        result = str(work / "results/bad" / scene / "result.npz")
        assert benchmark.main(["add", result, str(work / "bad"), "--dataset", place]) == 0
    for name in ("good", "bad"):
        (work / name / "method.json").write_text(json.dumps(METHOD | {"name": name}))
    return work


def test_what_was_added_passes_the_check(work, capsys, tmp_path):
    found = tmp_path / "found.json"
    assert benchmark.main(["check", str(work / "good"), str(work / "preview"), "--json", str(found)]) == 0
    lines = json.loads(found.read_text())["findings"]
    assert {line["of"] for line in lines} >= {f"{scene}/seed_{run}" for scene in SCENES for run in (0, 1)}
    assert not [line for line in lines if line["verdict"] == "refused"]
    assert "passed" in capsys.readouterr().out


def test_a_cross_is_an_exit_status(work, capsys, tmp_path):
    made_from = work / "bad" / SCENES[0] / "made_from.json"
    before = made_from.read_bytes()
    MadeFrom.of(["result.npz"], range(9)).write(made_from.parent)
    assert benchmark.main(["check", str(work / "bad"), str(work / "preview")]) == 1
    made_from.write_bytes(before)
    out = " ".join(capsys.readouterr().out.split())
    assert "refused: 1 of" in out and "held-out frames [4]" in out


def test_one_page_comes_out(work, tmp_path, capsys):
    arguments = ["score", str(work / "good"), str(work / "bad"), str(work / "preview"), "--out", str(tmp_path)]
    assert benchmark.main(arguments) == 0
    found = read_record(SuiteBoard, tmp_path / "board.json")
    rows = {row.name: row for row in found.rows}
    assert found.title == f"GoF-Bench 2, preview, 2 of {len(scenes_of('preview', 'test'))} test scenes, pictures 48x80"
    assert (rows["good"].runs, rows["bad"].runs) == (4, 2)
    l2 = {name: rows[name].figures["l2"] for name in ("good", "bad")}
    assert l2["good"].mean < l2["bad"].mean and l2["good"].wins == 2 and l2["good"].seed_sd > 0
    assert "trivial: zero" in rows
    page = (tmp_path / "board.html").read_text()
    assert "GoF-Bench 2" in page
    assert page.count("cam_1, frame 4 at 0.040 s, held out") == len(SCENES), "the methods' pictures, scene by scene"
    last = {name: page.split(f"<figcaption>{name}</figcaption>")[-1] for name in ("good", "bad")}
    shown = {name: said.split("<figcaption>flame ")[1].split(" dB")[0] for name, said in last.items()}
    pictures = Scores.read(work / "good" / SCENES[-1] / "seed_0/scores.json").images.pictures
    (picture,) = [one for one in pictures if (one.camera, one.frame) == ("cam_1", 4)]
    assert shown["good"] == f"{picture.psnr_flame:.2f}" and float(shown["bad"]) < float(shown["good"])
    for picture in page.split('<img src="data:image/webp;base64,')[1:]:
        Image.open(io.BytesIO(base64.b64decode(picture.split('"')[0]))).load()

    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "scores").iterdir()}
    assert len(kept) == 6
    assert benchmark.main(arguments) == 0, "again: nothing is scored twice"
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "scores").iterdir()} == kept


def test_who_has_one_scene_of_two_is_shown_and_ranked_there_alone(work, tmp_path):
    """A copy of the good method without the second scene: its mean stands beside the others', its rank does not."""
    shutil.copytree(work / "good", tmp_path / "part", ignore=shutil.ignore_patterns(SCENES[1]))
    (tmp_path / "part/method.json").write_text(json.dumps(METHOD | {"name": "part"}))
    folders = [str(folder) for folder in (work / "good", work / "bad", tmp_path / "part", work / "preview")]
    assert benchmark.main(["score", *folders, "--out", str(tmp_path)]) == 0
    found = read_record(SuiteBoard, tmp_path / "board.json")
    rows = {row.name: row for row in found.rows}
    assert (rows["part"].scenes, rows["part"].runs, rows["part"].competes) == (1, 2, False)
    assert rows["good"].competes and rows["good"].figures["l2"].rank == 1 and rows["good"].figures["l2"].wins == 2
    assert rows["part"].figures["l2"].rank is None and rows["part"].figures["l2"].wins is None
    alone = {scene.name: scene.figures for scene in found.scenes}
    assert alone[SCENES[0]]["part"]["l2"].mean == alone[SCENES[0]]["good"]["l2"].mean == rows["part"].figures["l2"].mean
    assert alone[SCENES[0]]["part"]["l2"].rank == alone[SCENES[0]]["good"]["l2"].rank == 1
    assert "part" not in alone[SCENES[1]]
    assert "part<small>in 1 of 2 scenes</small>" in (tmp_path / "board.html").read_text()


def test_scores_are_those_of_the_result_not_of_its_authors_words(work, tmp_path):
    """A better number in scores.json changes nothing on the board."""
    path = work / "bad" / SCENES[0] / "scores.json"
    before = path.read_bytes()
    data = json.loads(before)
    for frame in data["dve"]["frames"]:
        frame["l2"] = 0.001
    path.write_text(json.dumps(data))
    benchmark.main(["score", str(work / "bad"), str(work / "preview"), "--out", str(tmp_path)])
    path.write_bytes(before)
    (row,) = [row for row in read_record(SuiteBoard, tmp_path / "board.json").rows if row.name == "bad"]
    assert row.figures["l2"].mean > 0.1


def test_another_result_is_scored_anew(work, tmp_path):
    arguments = ["score", str(work / "bad"), str(work / "preview"), "--out", str(tmp_path)]
    benchmark.main(arguments)
    before = read_record(SuiteBoard, tmp_path / "board.json").rows[0].figures["l2"].mean
    path = work / "bad" / SCENES[0] / "result.npz"
    content = path.read_bytes()
    path.write_bytes((work / "results/good_0" / SCENES[0] / "result.npz").read_bytes())
    benchmark.main(arguments)
    path.write_bytes(content)
    assert read_record(SuiteBoard, tmp_path / "board.json").rows[0].figures["l2"].mean < 0.8 * before


def test_frames_must_be_said(work, tmp_path):
    result = tmp_path / "result.npz"
    result.write_bytes((work / "results/bad" / SCENES[0] / "result.npz").read_bytes())
    place = str(work / "preview" / SCENES[0])
    with pytest.raises(GofError, match="give --trained-on"):
        benchmark.main(["add", str(result), str(tmp_path / "new"), "--dataset", place])
    with pytest.raises(GofError, match="leave out --trained-on"):
        folder = str(work / "results/bad" / SCENES[0])
        benchmark.main(["add", folder, str(tmp_path / "newer"), "--dataset", place, "--trained-on", "train"])
    assert (
        benchmark.main(["add", str(result), str(tmp_path / "newest"), "--dataset", place, "--trained-on", "all"]) == 0
    )
    assert MadeFrom.read(tmp_path / "newest" / SCENES[0]).files == {"result.npz": tuple(range(9))}


def test_bad_input_is_named(work, tmp_path):
    place, result = str(work / "preview" / SCENES[0]), str(work / "results/bad" / SCENES[0])
    for arguments, named in (
        (["add", result, str(work / "bad"), "--dataset", place], "holds a run already"),
        (["add", result, str(tmp_path / "x"), "--dataset", place, "--run", "../y"], "must be a plain name"),
        (["add", str(tmp_path / "none"), str(tmp_path / "x"), "--dataset", place], "no such file"),
        (["score", str(work / "good")], "give one submission or more"),
        (["score", str(work / "good"), str(work / "good"), str(work / "preview")], "have one name"),
        (["score", str(work / "good"), str(work / "preview"), "--scenes", "dev"], "no finished scene"),
        (["check", str(tmp_path), str(work / "preview")], "no method.json"),
    ):
        with pytest.raises((GofError, DataFormatError), match=named):
            benchmark.main(arguments)


def test_plates_of_larger_pictures_are_refused_with_a_remedy(work, tmp_path):
    """A result of the whole sensor's pictures, entered for a scene of smaller ones."""
    result, place = tmp_path / "result", work / "preview" / SCENES[0]
    shutil.copytree(work / "results/bad" / SCENES[0], result)
    camera = Dataset.open(place).cameras[0]
    save_plates(result, [camera.name], [np.zeros((2 * camera.height, 2 * camera.width, 3))])
    entering = ["add", str(result), str(tmp_path / "entered"), "--dataset", str(place)]
    with pytest.raises(DataFormatError, match=f"{camera.name}.png: is .* or remove plates/ beside the result"):
        benchmark.main(entering)
    shutil.rmtree(result / "plates")
    assert benchmark.main(entering) == 0, "nothing is left of what failed"
    entered = tmp_path / "entered" / SCENES[0]
    with pytest.raises(DataFormatError, match="is inside the submission already"):
        (entered / "scores.json").unlink()
        benchmark.main(["add", str(entered), str(tmp_path / "entered"), "--dataset", str(place)])
    assert (entered / "result.npz").is_file()


def content(folder) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_reconstruction_where_the_run_would_go_is_left_alone(work, tmp_path, capsys):
    """`--out out/jet` is what one calls a reconstruction; its pictures, costs and result stay, whatever is added."""
    place, other = str(work / "preview" / SCENES[0]), str(work / "results/bad" / SCENES[0])
    mine = tmp_path / "out" / SCENES[0]
    (mine / "plates").mkdir(parents=True)
    for name in ("result.npz", "costs.json", "settings.json", "plates/cam_0.png", "made_from.json"):
        (mine / name).write_text(f"my {name}")
    before = content(mine)
    assert main(["benchmark", "add", other, str(tmp_path / "out"), "--dataset", place]) == 1
    assert f"{mine}: already holds other files" in capsys.readouterr().err
    assert content(mine) == before
    assert main(["benchmark", "add", other, str(tmp_path / "out"), "--dataset", place, "--run", "seed_0"]) == 0
    assert {name: data for name, data in content(mine).items() if not name.startswith("seed_0/")} == before
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / SCENES[0]).symlink_to(mine, target_is_directory=True)
    assert main(["benchmark", "add", other, str(tmp_path / "link"), "--dataset", place]) == 1


def test_pictures_that_are_not_there_are_named_before_any_work(work, tmp_path, capsys):
    place, other = str(work / "preview" / SCENES[0]), str(work / "results/bad" / SCENES[0])
    adding = ["benchmark", "add", other, str(tmp_path / "new"), "--dataset", place]
    assert main([*adding, "--pictures", str(tmp_path / "none")]) == 1
    assert "none: has no cam_0/000004.png and" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    assert main(adding) == 0, "the same command is not refused"
    pictures = tmp_path / "new" / SCENES[0] / "pictures"
    newer = [*adding[:3], str(tmp_path / "newer"), *adding[4:]]
    assert main([*newer, "--pictures", str(pictures)]) == 0
    assert content(tmp_path / "newer" / SCENES[0] / "pictures") == content(pictures)


@pytest.mark.parametrize("stopped_in", ["evaluate", "write_pictures", "os.replace"])
def test_an_addition_that_was_stopped_is_finished_by_the_same_command(work, tmp_path, stopped_in):
    """As kill -9 leaves it: nothing is cleaned up. No half run is found; the next attempt is whole."""
    place, other = str(work / "preview" / SCENES[0]), str(work / "results/bad" / SCENES[0])
    (tmp_path / "new").mkdir()
    (tmp_path / "new/method.json").write_text(json.dumps(METHOD))
    adding = ["benchmark", "add", other, str(tmp_path / "new"), "--dataset", place]
    code = (
        "import os, sys\nfrom gof.commands.cli import main\nfrom gof_benchmark.commands import benchmark_add\n"
        f"benchmark_add.{stopped_in} = lambda *a, **k: os._exit(9)\nmain({adding!r})\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 9
    assert not (tmp_path / "new" / SCENES[0]).exists()
    assert not Submission.open(tmp_path / "new").runs, "what was put together is no run"
    assert main(adding) == 0
    there = content(tmp_path / "new" / SCENES[0]).keys()
    assert there == content(work / "bad" / SCENES[0]).keys() | {"made_from.json"}


def test_a_run_beside_a_scenes_only_run_would_not_be_found(work, tmp_path, capsys):
    shutil.copytree(work / "bad", tmp_path / "bad")
    place, other = str(work / "preview" / SCENES[0]), str(work / "results/good_0" / SCENES[0])
    assert main(["benchmark", "add", other, str(tmp_path / "bad"), "--dataset", place, "--run", "seed_1"]) == 1
    assert "is a run itself" in capsys.readouterr().err


def test_a_run_says_how_it_was_drawn(work):
    assert Scores.read(work / "bad" / SCENES[0] / "scores.json").import_.over_plates


def scored(*words) -> dict:
    """The board's rows by name."""
    out = words[-1]
    assert main(["benchmark", "score", *map(str, words[:-1]), "--out", str(out)]) == 0
    return {row.name: row for row in read_record(SuiteBoard, out / "board.json").rows}


def test_what_the_check_refuses_is_shown_and_not_ranked(work, tmp_path):
    """A held-out frame went in, by its own word."""
    shutil.copytree(work / "good", tmp_path / "leaky")
    (tmp_path / "leaky/method.json").write_text(json.dumps(METHOD | {"name": "leaky"}))
    MadeFrom.of(["result.npz"], range(9)).write(tmp_path / "leaky" / SCENES[0] / "seed_0")
    rows = scored(tmp_path / "leaky", work / "good", work / "bad", work / "preview", tmp_path / "board")
    assert not rows["leaky"].competes and any("held-out frames [4]" in cross for cross in rows["leaky"].refused)
    assert rows["leaky"].figures["l2"].rank is None
    assert rows["good"].figures["l2"].rank == 1 and rows["bad"].figures["l2"].rank is not None
    assert not rows["good"].refused and not rows["bad"].refused
    for name in ("board.html", "board.md"):
        assert "refused by the check, not ranked" in (tmp_path / "board" / name).read_text()


def test_a_submission_does_not_choose_how_it_is_scored(work, tmp_path):
    """Neither a figure nor an order of its own changes its row, and what was kept of one is not taken for another."""
    honest = scored(work / "bad", work / "preview", tmp_path / "honest")["bad"]
    shutil.copytree(work / "bad", tmp_path / "bad")
    for scene in SCENES:
        path = tmp_path / "bad" / scene / "scores.json"
        words = json.loads(path.read_text())
        words["dve"] |= {"order": 7, "opacity": "base"}
        path.write_text(json.dumps(words))
    row = scored(tmp_path / "bad", work / "preview", tmp_path / "board")["bad"]
    assert row.figures["l2"].mean == honest.figures["l2"].mean
    assert any("order 7 and base opacity" in cross for cross in row.refused)


def test_one_damaged_submission_does_not_take_the_board_from_the_others(work, tmp_path, capsys):
    """Losses of 1e308, velocities whose squares are no numbers, a result that is gone."""
    spoiled = {name: tmp_path / name for name in ("curve", "fast", "gone")}
    for name, folder in spoiled.items():
        shutil.copytree(work / "bad", folder)
        (folder / "method.json").write_text(json.dumps(METHOD | {"name": name}))
    losses = "".join(f"{k},{k},1e308\n" for k in range(1, 61))
    (spoiled["curve"] / SCENES[0] / "curve.csv").write_text("step,cpu_seconds,loss\n" + losses)
    path = spoiled["fast"] / SCENES[0] / "result.npz"
    fast = TransientGaussians.load(path)
    fields = {n: getattr(fast, n) for n in fast.__dataclass_fields__}
    TransientGaussians(**fields | {"velocity": fast.velocity * 0 + 1e30}).save(path)
    (spoiled["gone"] / SCENES[0] / "result.npz").unlink()
    rows = scored(*spoiled.values(), work / "good", work / "bad", work / "preview", tmp_path / "board")
    assert all(rows[name].refused and not rows[name].competes for name in spoiled)
    assert rows["good"].competes and rows["bad"].competes and rows["good"].figures["l2"].rank == 1


def test_a_method_is_not_called_as_a_trivial_baseline(work, tmp_path, capsys):
    for name in ("trivial: zero", "CONTROL: mine", "\u202etxt.exe"):
        (tmp_path / "method.json").write_text(json.dumps(METHOD | {"name": name}))
        assert main(["benchmark", "score", str(tmp_path), str(work / "preview"), "--out", str(tmp_path / "b")]) == 1
        assert "give it another name in method.json" in capsys.readouterr().err
