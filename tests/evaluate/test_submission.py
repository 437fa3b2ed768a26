"""Submissions: an honest one passes, and a leaked, a wrong and an incomplete one are refused by name."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom
from gof.evaluate.scores import Scores
from gof.evaluate.scoring import evaluate
from gof.evaluate.submission import Run, Submission, check, picture_file, write_pictures
from tests.evaluate.synthetic_flame import flame_dataset
from tests.evaluate.test_emission import with_a_flame_grid

pytestmark = pytest.mark.long
METHOD = {
    "name": "A method",
    "authors": ["A. Author"],
    "code": "https://example.org/code",
    "commit": "0123abc",
    "licence": "MIT",
    "hardware": "2 cores",
    "train_seconds": 100,
    "given": ["poses", "plates"],
    "prior": [],
    "random": False,
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A dataset, and an honest submission of one run: the flame with its places and velocities disturbed."""
    folder = tmp_path_factory.mktemp("submission")
    truth = flame_dataset(folder / "data")
    dataset = Dataset.open(with_a_flame_grid(folder / "data"))
    run = folder / "mine/plume"
    run.mkdir(parents=True)
    rng = np.random.default_rng(0)
    fields = {n: getattr(truth, n) for n in truth.__dataclass_fields__}
    fields["velocity"] = truth.velocity + rng.normal(0, 0.1, truth.velocity.shape)
    TransientGaussians(**fields).save(run / "result.npz")
    MadeFrom.of(["result.npz"], dataset.train_frames).write(run)
    evaluate(run / "result.npz", dataset).write(run / "scores.json")
    write_pictures(Run.open(run, "plume"), dataset)
    (folder / "mine/method.json").write_text(json.dumps(METHOD))
    return folder


@pytest.fixture
def mine(scene, tmp_path):
    """A copy of the honest submission, to spoil."""
    shutil.copytree(scene / "mine", tmp_path / "mine")
    return tmp_path / "mine"


def findings(folder, scene):
    """What the check finds, by what it looks at."""
    found = check(Submission.open(folder), {"plume": Dataset.open(scene / "data")})
    return {(finding.of, finding.what): finding for finding in found}


def refused(folder, scene) -> list[str]:
    return [str(finding) for finding in findings(folder, scene).values() if finding.verdict == "refused"]


def rewrite(folder, change):
    path = folder / "method.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


def test_an_honest_submission_passes(mine, scene):
    found = findings(mine, scene)
    assert not refused(mine, scene)
    assert {what for (of, what), finding in found.items() if of == "plume" and finding.verdict == "ok"} >= {
        "files",
        "clock",
        "held-out frames",
        "checkpoint reproduces its pictures",
        "scores reproduce",
    }


def test_a_leaked_one_is_refused_with_its_frames(mine, scene):
    MadeFrom.of(["result.npz"], range(9)).write(mine / "plume")
    (said,) = refused(mine, scene)
    assert "plume: held-out frames: result.npz made from held-out frames [4]" in said


def test_plates_that_nobody_names_are_refused(mine, scene):
    """The run is drawn over the dataset's true plates, and its row would say that it had nothing but poses."""
    rewrite(mine, lambda about: about | {"given": ["poses"]})
    (said,) = refused(mine, scene)
    assert "plume: plates: it is drawn over the dataset's plates" in said


def test_another_checkpoint_is_refused_twice(mine, scene):
    """Pictures and scores are of another training than the file that came."""
    result = TransientGaussians.load(mine / "plume/result.npz")
    other = replace(result, velocity=0.7 * result.velocity, color=np.clip(result.color + 0.3, 0, 1))
    (mine / "plume/result.npz").unlink()
    other.save(mine / "plume/result.npz")
    said = " ".join(refused(mine, scene))
    assert "checkpoint reproduces its pictures" in said and "scores reproduce: l2 is" in said


@pytest.mark.parametrize(
    ("changed", "named"), [("dve", "cos_sim is"), ("eve", "eve_cos_sim is"), ("no eve", "eve_l2 is")]
)
def test_a_better_number_is_refused(mine, scene, changed, named):
    """A stated DVE and EVE are compared with ours; an EVE that is left out is asked for."""
    path = mine / "plume/scores.json"
    data = json.loads(path.read_text())
    if changed == "no eve":
        data["dve"]["eve"] = None
    else:
        (data["dve"]["eve"] if changed == "eve" else data["dve"])["cos_sim"] += 0.01
    path.write_text(json.dumps(data))
    (said,) = refused(mine, scene)
    assert f"scores reproduce: {named}" in said


def test_a_painted_picture_is_refused(mine, scene):
    path = picture_file(mine / "plume", "cam_1", 4)
    picture = cv2.imread(str(path))
    cv2.imwrite(str(path), np.clip(picture.astype(int) + 12, 0, 255).astype(np.uint8))
    (said,) = refused(mine, scene)
    assert "dB from its Gaussians drawn here (camera 1, frame 4" in said


def test_another_clock_is_refused(mine, scene):
    result = TransientGaussians.load(mine / "plume/result.npz")
    (mine / "plume/result.npz").unlink()
    replace(result, t_mu=result.t_mu + 5).save(mine / "plume/result.npz")
    assert any("clock: its Gaussians live from" in said for said in refused(mine, scene))


@pytest.mark.parametrize(
    ("gone", "named"),
    [("made_from.json", "made_from.json"), ("pictures/cam_0/000004.png", "000004.png"), ("result.npz", "result.npz")],
)
def test_what_is_missing_is_named(mine, scene, gone, named):
    (mine / "plume" / gone).unlink()
    assert any(named in said for said in refused(mine, scene))


def test_knowledge_that_is_not_said(mine, scene):
    MadeFrom.of(["result.npz"], Dataset.open(scene / "data").train_frames, ["flow_prior"]).write(mine / "plume")
    (said,) = refused(mine, scene)
    assert "flow_prior went in; method.json names no prior" in said
    rewrite(mine, lambda about: about | {"prior": ["a flow prior learned on the dev fires"]})
    assert not refused(mine, scene)


def test_method_json_says_everything(mine, scene):
    rewrite(mine, lambda about: {k: v for k, v in about.items() if k not in ("licence", "prior")})
    (said,) = refused(mine, scene)
    assert "does not say licence, prior" in said


def test_too_few_seeds_are_for_people_to_judge(mine, scene):
    rewrite(mine, lambda about: about | {"random": True})
    assert not refused(mine, scene)
    assert findings(mine, scene)["runs", "seeds"].verdict == "hint"


def test_a_result_elsewhere_is_refused(mine, scene):
    path = mine / "plume/scores.json"
    data = json.loads(path.read_text())
    data["import"]["path"] = "../../../../etc/passwd"
    path.write_text(json.dumps(data))
    (said,) = refused(mine, scene)
    assert "cannot be the name of a file there" in said


def test_runs_of_several_seeds_are_found(mine):
    for name in ("seed_0", "seed_1"):
        shutil.copytree(mine / "plume", mine / "other" / name)
    runs = Submission.open(mine).runs
    assert [path.name for path in runs["other"]] == ["seed_0", "seed_1"] and len(runs["plume"]) == 1
    assert Run.open(runs["other"][1], "other").result.name == "result.npz"


def test_what_is_no_submission(tmp_path):
    with pytest.raises(DataFormatError, match="no method.json"):
        Submission.open(tmp_path)


def test_a_method_that_saw_the_held_out_frames_gives_itself_away(scene, mine):
    """The pictures were drawn from these Gaussians: held-out frames are as good as all others."""
    truth = flame_dataset(mine.parent / "again")
    run = mine / "plume"
    shutil.rmtree(run)
    run.mkdir()
    truth.save(run / "result.npz")
    dataset = Dataset.open(scene / "data")
    MadeFrom.of(["result.npz"], dataset.train_frames).write(run)  # a lie
    evaluate(run / "result.npz", dataset).write(run / "scores.json")
    write_pictures(Run.open(run, "plume"), dataset)
    hint = findings(mine, scene)["plume", "unseen frames"]
    assert hint.verdict == "hint"


def test_scores_are_read_as_they_were_written(mine):
    assert isinstance(Run.open(mine / "plume", "plume").scores, Scores)
