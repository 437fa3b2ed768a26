"""`import gof`: the names of the front door, what they cost, and the programs of docs/examples."""

import ast
import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gof

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))


def test_editors_see_the_names_that_are_loaded():
    """The imports for type checkers and the names of `__all__` are one list, and each name can be had."""
    tree = ast.parse(Path(gof.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.asname: node.module for node in block.body for alias in node.names}
    assert set(seen) == set(gof.__all__)
    for name, module in seen.items():
        found = getattr(gof, name)
        assert found is not None and name in dir(gof)
        if name in gof._DOOR:
            assert gof._DOOR[name] == module
    with pytest.raises(AttributeError, match="no attribute 'open_datset'"):
        gof.open_datset


def test_importing_it_loads_nothing_heavy():
    code = "import sys, gof; print([m for m in ('numpy', 'cv2', 'drjit', 'torch', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_packages_that_are_called_say_what_they_take():
    assert list(inspect.signature(gof.reconstruct).parameters)[:3] == ["dataset", "out", "preset"]
    assert list(inspect.signature(gof.evaluate).parameters)[:2] == ["result", "dataset"]


def test_evaluate_opens_what_is_named(tmp_path):
    """Folders by their names are scored as what stands in them."""
    gof.unpack_sample(tmp_path)
    opened = gof.evaluate(tmp_path / "result", gof.open_dataset(tmp_path / "fire"), images=False)
    named = gof.evaluate(str(tmp_path / "result"), str(tmp_path / "fire"), images=False)
    assert named.dve == opened.dve and named.dve.l2 < named.trivial_baselines["zero"].l2


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"ablation": "nomask"}, "--ablation nomask: there are none, no-sync, rand-flow, joint-opt, no-mask"),
        ({"scene": "foo"}, "--scene foo: there are plates, gaussians"),
        ({"until": "seed"}, "--until seed: there are motion, flow-field, seeds, result"),
        ({"flow": "foo"}, "--flow foo: there are dis"),
        ({"method": "bar"}, "--method bar: there are gof, paper"),
        ({"gaussians": float("nan")}, "--gaussians nan: must be a whole number"),
        ({"steps": "5"}, "--steps '5': must be a whole number"),
        ({"steps": 5.5}, "--steps 5.5: must be a whole number"),
        ({"seed": 0.5}, "--seed 0.5: must be a whole number"),
        ({"seed": -1}, "--seed -1: must be 0 or more"),
    ],
)
def test_a_choice_that_there_is_not_is_refused_before_any_work(given, words, tiny_dataset, tmp_path):
    """Taken as if there were one, it would stand in settings.json and change nothing."""
    with pytest.raises(gof.GofError, match=re.escape(words)):
        gof.reconstruct(tiny_dataset, tmp_path / "out", "toy", **given)
    assert not (tmp_path / "out").exists()


def test_settings_on_the_disk_have_choices_that_there_are(tiny_dataset, tmp_path):
    """Written by a version that took them all; read, they are refused by name."""
    from gof.core.records import read_record, to_json
    from gof.reconstruct.presets import effort_of
    from gof.reconstruct.settings import ReconstructionSettings

    good = ReconstructionSettings.of(gof.open_dataset(tiny_dataset), effort_of("toy"))
    (tmp_path / "good.json").write_text(json.dumps(to_json(good)))
    assert read_record(ReconstructionSettings, tmp_path / "good.json") == good
    (tmp_path / "bad.json").write_text(json.dumps(to_json(good) | {"ablation": "nomask"}))
    with pytest.raises(gof.GofError, match=r"bad.json: ablation must be one of .*no-mask"):
        read_record(ReconstructionSettings, tmp_path / "bad.json")


def test_a_preset_that_does_not_exist_is_refused_before_any_work(tmp_path):
    gof.unpack_sample(tmp_path)
    with pytest.raises(gof.GofError, match="--preset fast: there are toy"):
        gof.reconstruct(tmp_path / "fire", tmp_path / "out", "fast")
    with pytest.raises(TypeError, match="gaussans"):
        gof.reconstruct(tmp_path / "fire", tmp_path / "out", gaussans=3)
    assert not (tmp_path / "out").exists()


@pytest.mark.long
@pytest.mark.checkout
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_draws_its_picture(example, tmp_path):
    for module in ("matplotlib", *(["torch"] if "torch" in example.stem else [])):
        pytest.importorskip(module)
    environment = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(example), str(tmp_path)], capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip(), "an example says what it found"
    picture = np.asarray(Image.open(tmp_path / f"{example.stem}.png").convert("RGB"), float)
    assert min(picture.shape[:2]) > 100 and picture.std() > 10, "an empty picture"
    assert example.stem in example.read_text(encoding="utf-8").split('"""')[1], "the way to run it stands on top"
