"""GoF-Bench: its list does not change, its test scenes differ in what they should, and its truths are compared."""

import hashlib
import json
import shutil
import subprocess

import pytest

from gof.core.errors import DataFormatError, GofError
from gof.core.records import read_record
from gof.dataset import Dataset
from gof.dataset.pack import VelocityFingerprint
from gof_benchmark import suite
from gof_benchmark.commands import benchmark, benchmark_list
from gof_benchmark.suite import SIZES, pick, scenes_of
from gof_benchmark.suite.made import FILE, SuiteTruths, compare, made_scenes, scene_of
from gof_blender.pure.layout import Layout
from tests.evaluate.synthetic_flame import flame_dataset

# Of the fields of every scene's spec in every size. If this test fails, GoF-Bench 2 is not GoF-Bench 2 any more: a
# change belongs into the next one, under another number.
FROZEN = "106cc1a35255bd329fe017c5f48570e12177457bdb8351775f96f88a98f45f76"


def test_the_list_is_as_it_was_sealed():
    subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"], cwd=suite.FOLDER, check=True)


def test_no_scene_changes():
    digests = [f"{size} {scene.name} {scene.digest}" for size in SIZES for scene in scenes_of(size)]
    assert hashlib.sha256("\n".join(digests).encode()).hexdigest() == FROZEN


def test_fires_shine_and_move_as_when_the_suite_was_sealed():
    """Whatever their own specs say, which are of version 1."""
    simulated = [scene for size in SIZES for scene in scenes_of(size) if scene.foam is None]
    assert {(scene.spec.fire.light, scene.spec.fire.intensity) for scene in simulated} == {("sheets", 1)}
    jets = {scene.fire for scene in simulated if scene.spec.fire.speeds == "solver"}
    assert jets == {"test/jet", "dev/jet_gasoline_8deg"}
    assert {scene.spec.fire.speeds for scene in simulated if scene.fire not in jets} == {"physical"}
    effects = [effect for size in SIZES for scene in scenes_of(size) for effect in scene.spec.effects]
    assert {effect.unit for effect in effects if hasattr(effect, "unit")} <= {"field"}


def test_a_changed_list_is_refused(tmp_path, monkeypatch):
    shutil.copytree(suite.FOLDER, tmp_path / "suite")
    path = tmp_path / "suite/gof_bench_2.json"
    path.write_text(path.read_text().replace('"arc_deg": 20', '"arc_deg": 30'))
    monkeypatch.setattr(suite, "FOLDER", tmp_path / "suite")
    with pytest.raises(DataFormatError, match=r"gof_bench_2.json is not as sealed"):
        scenes_of("standard")


def test_a_scene_for_development_says_so():
    for scene in scenes_of("standard"):
        assert (scene.split == "test") == scene.fire.startswith("test/"), "a fire is of one split, whoever looks at it"
    assert next(scene for scene in scenes_of("preview") if scene.name == "demo").split == "dev"
    assert {scene.split for scene in scenes_of("preview")} == {"dev", "test"}
    assert [scene.name for scene in scenes_of("full")] == [scene.name for scene in scenes_of("standard")]


def test_test_scenes_differ_in_all_that_a_method_may_depend_on():
    scenes = scenes_of("standard", "test")
    rigs = [scene.spec.cameras for scene in scenes]
    assert {rig.count for rig in rigs} >= {2, 3, 5}
    assert any(rig.arc_deg / (rig.count - 1) == 10 for rig in rigs), "10 degrees apart"
    assert {rig.portrait for rig in rigs} == {True, False}
    assert len({scene.spec.clip.fps for scene in scenes}) >= 3
    assert {scene.solver for scene in scenes} == {"Mantaflow", "OpenFOAM"}
    assert {scene.spec.background for scene in scenes} == {"workshop", "studio", "classroom", "cloister"}
    ours = [scene.spec.fire for scene in scenes if scene.foam is None]
    assert len({fire.fuel for fire in ours}) >= 4 and len({fire.shape for fire in ours}) >= 3


def test_every_scene_has_held_out_frames_and_grids():
    for size in SIZES:
        for scene in scenes_of(size):
            assert scene.spec.clip.frames > 4 and scene.spec.ground_truth == ("grids",)


def test_clips_of_grids_end_before_the_grids_do():
    for size in SIZES:
        for scene in scenes_of(size):
            if scene.foam is not None:
                clip = scene.spec.timeline
                seen = scene.spec.fire.start_s + clip.simulated_s(clip.steps_needed[-1])
                assert seen <= (scene.foam.frames - 1) / scene.foam.frame_rate_hz + 1e-9, (size, scene.name)


def test_names_that_are_not_there():
    with pytest.raises(GofError, match="no scene 'nothing'"):
        pick(scenes_of("preview"), ("demo", "nothing"))
    assert benchmark.main(["nothing"]) == 2


def test_the_list_is_printed(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert benchmark.main(["--help"]) == 0 and "gof benchmark PART" in capsys.readouterr().out
    assert benchmark_list.main(["--size", "full", "--scenes", "test", "--json", str(tmp_path / "list.json")]) == 0
    lines = json.loads((tmp_path / "list.json").read_text())["scenes"]
    assert len(lines) == 10 and lines[0]["picture"] == "720x1280"
    printed = capsys.readouterr().out
    assert "GoF-Bench 2" in printed and max(map(len, printed.splitlines())) <= 80
    assert all(line[word] in printed for line in lines for word in ("scene", "picture", "spec")), "names stay whole"


# ---------------------------------------------------------------- what is made


@pytest.fixture
def made(tmp_path):
    """A folder as `gof benchmark make` leaves it, with one scene whose dataset is made here."""
    (scene,) = pick(scenes_of("preview"), ("demo",))
    folder = tmp_path / "preview/demo"
    flame_dataset(folder)
    Layout(folder).spec.write_text(json.dumps(scene.spec.to_dict()))
    return scene, folder


def test_what_is_made_is_found(made):
    scene, folder = made
    assert list(made_scenes(folder.parent)) == ["demo"]
    assert scene_of(folder).scene.digest == scene.digest


def test_a_dataset_of_another_spec_is_refused(made):
    scene, folder = made
    other = scene.spec.to_dict()
    other["cameras"]["arc_deg"] = 71.0
    Layout(folder).spec.write_text(json.dumps(other))
    with pytest.raises(DataFormatError, match=r"cameras differ"):
        made_scenes(folder.parent)


@pytest.mark.parametrize("text", ["{", "", "[]", '{"schema": "gof-scene", "version": 2}'])
def test_a_spec_that_is_none_is_named(made, text):
    _, folder = made
    Layout(folder).spec.write_text(text)
    with pytest.raises(DataFormatError, match=r"spec\.json"):
        made_scenes(folder.parent)


def test_what_is_no_suites_folder(made, tmp_path):
    for folder, why in ((tmp_path, "not the folder of a size"), (tmp_path / "full", "no finished scene")):
        with pytest.raises(DataFormatError, match=why):
            made_scenes(folder)
    with pytest.raises(DataFormatError, match="not a finished scene"):
        scene_of(tmp_path / "preview/jet_two_cameras")


def test_truths_are_compared_by_number(made):
    """The dataset here is no demo fire: that is named, and not fatal."""
    scene, folder = made
    verdict, said = compare(scene, "preview", Dataset.open(folder))
    assert verdict == "not to the bit" and "Mantaflow differs slightly between CPUs" in said
    assert compare(scene, "full", Dataset.open(folder))[0] == "unknown"


def test_recorded_truths():
    recorded = read_record(SuiteTruths, FILE)
    assert set(recorded.made_with) == {"Mantaflow", "OpenFOAM"}
    by_fire = {scene.fire: scene for scene in scenes_of("standard")}
    assert set(recorded.fires) == set(by_fire), "every fire has been made in the standard size"
    for fire, sizes in recorded.fires.items():
        assert len(sizes["standard"].rms_m_s) == by_fire[fire].spec.clip.frames
        assert isinstance(sizes["standard"], VelocityFingerprint) and min(sizes["standard"].rms_m_s) > 0
