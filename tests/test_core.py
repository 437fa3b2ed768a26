"""`gof/core` alone: installed as `gof_blender.core` it works in Blender's Python, which has numpy and little else."""

import dataclasses
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gof.core.checked_json import from_dict
from gof.core.description import DatasetDescription
from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, write_json
from gof.core.records import from_json
from gof.core.rotations import quaternions_wxyz
from gof.evaluate.scores import Scores
from tools import build_addon

GOLDEN = Path(__file__).parent / "golden"
ALONE = """
import importlib, json, pkgutil, sys
from pathlib import Path
for name in ("gof", "scipy", "cv2", "drjit", "zstandard", "PIL", "psutil", "bpy"):
    sys.modules[name] = None  # to import it raises ModuleNotFoundError
sys.path.insert(0, sys.argv[1])
core = importlib.import_module(sys.argv[2])
names = [module.name for module in pkgutil.iter_modules(core.__path__)]
modules = {name: importlib.import_module(f"{sys.argv[2]}.{name}") for name in names}
foreign = {name.split(".")[0] for name, module in sys.modules.items() if module} - sys.stdlib_module_names
print(json.dumps([names, sorted(name for name in foreign if not name.startswith("_"))]))

import numpy as np
golden, folder = Path(sys.argv[3]), Path(sys.argv[4])
for name, kind in (("gof-dataset", "description.DatasetDescription"), ("gof-costs", "costs.Costs")):
    module, kind = kind.split(".")
    record = modules["records"].read_record(getattr(modules[module], kind), golden / f"{name}.json")
    assert modules["records"].to_json(record) == json.loads((golden / f"{name}.json").read_text())

one = modules["gaussians"].TransientGaussians(
    position=np.array([[1, 2, 3]]), velocity=np.array([[0, 0, 4]]), t_mu=np.zeros(1), t_sigma=np.ones(1),
    scale=np.full((1, 3), 0.5), rotation=np.array([[1, 0, 0, 0]]), opacity=np.full(1, 0.5),
    color=np.full((1, 3), 0.25), dynamic=np.ones(1, bool),
)
for suffix in (".npz", ".ply"):
    again = type(one).load(one.save(folder / f"result{suffix}"))
    assert np.allclose(again.position, [[1, 2, 3]]) and np.allclose(again.velocity, [[0, 0, 4]])
    assert np.allclose(again.color, 0.25, atol=1e-6)

fields = modules["fields"]
cells = np.arange(24.0).reshape(2, 2, 2, 3)
fields.VelocitySequence.create(folder / "v.zarr", [fields.VelocityField.from_array(cells, (0, 0, 0), 1.0, 0.0)])
assert (fields.VelocitySequence.open(folder / "v.zarr").frame(0).velocity == cells).all()
turned = modules["rotations"].quaternions_wxyz(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]))
assert np.allclose(turned, [2**-0.5, 0, 0, 2**-0.5])
assert modules["costs"].peak_memory_mb() >= 0

described = json.loads((folder / "v.zarr/zarr.json").read_text())
described["codecs"][1] = {"name": "zstd", "configuration": {"level": 0}}
(folder / "v.zarr/zarr.json").write_text(json.dumps(described))
try:
    fields.VelocitySequence.open(folder / "v.zarr")
except modules["errors"].MissingDependencyError as error:
    print(error)
"""


def test_core_needs_numpy_only(tmp_path):
    with zipfile.ZipFile(build_addon.build(tmp_path)) as archive:
        archive.extractall(tmp_path)
    command = [sys.executable, "-c", ALONE, str(tmp_path), f"{build_addon.NAME}.core", str(GOLDEN), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    first, last = done.stdout.splitlines()
    names, foreign = json.loads(first)
    assert set(names) == {path.stem for path in build_addon.CORE.glob("*.py")} - {"__init__"} and len(names) > 20
    assert set(foreign) <= {build_addon.NAME, "numpy", "cython_runtime", "sitecustomize"}
    assert "v.zarr: its chunks are packed with zstd" in last and "GzipCodec" in last


def test_quaternions_are_scipys():
    """Also of half turns and of nearly none, where one way to compute them loses all digits."""
    axes = np.random.default_rng(5).normal(size=(2000, 3))
    axes = np.concatenate([axes, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [-1, 1, 0], [0, 1, 1]]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for angle in (0, 1e-9, 1e-3, 1.0, 2.0, 3.1, np.pi - 1e-9, np.pi, 4.0):
        turn = Rotation.from_rotvec(angle * axes)
        found = quaternions_wxyz(turn.as_matrix())
        np.testing.assert_allclose(Rotation.from_quat(np.roll(found, -1, -1)).as_matrix(), turn.as_matrix(), atol=1e-14)
        if abs(angle - np.pi) > 1e-6:  # there both signs are as good
            np.testing.assert_allclose(found, np.roll(turn.as_quat(canonical=True), 1, -1), atol=1e-14)
    assert quaternions_wxyz(np.eye(3)).tolist() == [1, 0, 0, 0]
    assert quaternions_wxyz(np.tile(np.diag([-1.0, -1, 1]), (2, 3, 1, 1))).tolist() == [[[0, 0, 0, 1]] * 3] * 2


@pytest.mark.parametrize(
    "place, value, words",
    [
        (("dve", "frames", 0, "l2"), "low", r"dve\.frames\[0\]\.l2 must be a finite number, got 'low'"),
        (("dve", "frames"), {}, r"dve\.frames must be a list, got \{\}"),
        (("dve", "l2"), True, r"dve\.l2 must be a finite number, got True"),
        (("dve", "frames_scored"), 1.5, r"dve\.frames_scored must be a whole number, got 1\.5"),
        (("dve", "opacity"), "half", r"dve\.opacity must be one of \['temporal', 'base'\], got 'half'"),
        (("trivial_baselines", "zero"), None, r"trivial_baselines\.zero must be an object, got None"),
        (("costs", "fit"), "1 h", r"costs\.fit must be a finite number, got '1 h'"),
        (("import",), [], r"import must be an object, got \[\]"),
        (("warnings",), ["a", 2], r"warnings\[1\] must be a text, got 2"),
        (("dve", "l2"), 10**400, r"dve\.l2 must be a finite number, got 1000"),
    ],
)
def test_a_wrong_field_is_named_with_file_and_value(place, value, words):
    data = json.loads((GOLDEN / "gof-scores.json").read_text())
    inner = data
    for part in place[:-1]:
        inner = inner[part]
    inner[place[-1]] = value
    with pytest.raises(DataFormatError, match=rf"^scores\.json: {words}"):
        from_json(Scores, data, "scores.json")


def test_a_field_named_like_a_keyword_has_its_plain_key():
    data = json.loads((GOLDEN / "gof-scores.json").read_text())
    assert from_json(Scores, data, "x").import_.method == data["import"]["method"]
    data["import_"] = data.pop("import")
    with pytest.raises(DataFormatError, match="import is missing"):
        from_json(Scores, data, "x")


def test_fields_of_a_newer_writer_are_left_aside():
    data = json.loads((GOLDEN / "gof-dataset.json").read_text())
    assert from_json(DatasetDescription, data | {"weather": "fine"}, "x") == from_json(DatasetDescription, data, "x")
    with pytest.raises(DataFormatError, match="weather is not a field; known: "):
        from_json(DatasetDescription, data | {"weather": "fine"}, "x", ignore_unknown=False)
    data["cameras"][0]["role"] = "below"
    with pytest.raises(DataFormatError, match="role"):  # a value that says something unknown is refused
        from_json(DatasetDescription, data, "x")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "new folder" / "a.json"
    write_json(path, {"a": 1})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"a": float("nan")})
    with pytest.raises(RuntimeError), atomic_path(path) as draft:
        draft.write_text("half")
        raise RuntimeError
    assert json.loads(path.read_text()) == {"a": 1}
    assert [found.name for found in path.parent.iterdir()] == ["a.json"]


def test_types_are_told_apart():
    kind = dataclasses.make_dataclass("Kind", [("pair", tuple[int, float]), ("table", dict[str, tuple[int, ...]])])
    found = from_dict(kind, {"pair": [2.0, 3], "table": {"a": [1, 2]}}, "")
    assert (type(found.pair[0]), type(found.pair[1]), found.table) == (int, float, {"a": (1, 2)})
