"""Velocity export from a real bake, and everything that must be refused. Each run of bpy has its own process."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.blender

ROOT = Path(__file__).resolve().parents[2]
CHILD = """
import json, sys
from dataclasses import replace
from pathlib import Path
import bpy
import numpy as np
from gof_blender.scene import mantaflow
from gof_blender.scene import velocity
from tests.blender import smoke_transport

mantaflow.enable()
folder, data_format = Path(sys.argv[1]), sys.argv[2]
domain, emitter = smoke_transport.build_puff(replace(smoke_transport.CASES["plain"], resolution=16), folder / "cache")
settings = domain.modifiers["Fluid"].domain_settings
settings.cache_data_format = data_format
settings.cache_frame_end = bpy.context.scene.frame_end = 5
with bpy.context.temp_override(object=domain, active_object=domain, selected_objects=[domain]):
    bpy.ops.fluid.bake_all()

def attempt(**changes):
    arguments = dict(frames=[2, 3, 5], fps=25.0, time_scale=0.5, out_path=folder / "v.zarr") | changes
    try:
        return {"ok": velocity.export_velocity(domain, **arguments)}
    except Exception as error:
        return {"error": type(error).__name__, "text": str(error)}

answer = {}
if data_format == "OPENVDB":
    answer["clipped"] = attempt()
else:
    seen = []
    answer["done"] = attempt(progress=lambda done, total: seen.append([done, total]))
    answer["progress"] = seen
    answer["again"] = attempt()
    answer["other frames"] = attempt(frames=[1, 2])
    new = folder / "new.zarr"
    answer["not baked"] = attempt(frames=[2, 9], out_path=new)
    answer["no frames"] = attempt(frames=[], out_path=new)
    answer["fps"] = attempt(fps=0.0, out_path=new)
    answer["time scale"] = attempt(time_scale=1.0, out_path=new)
    answer["not a domain"] = None
    try:
        velocity.export_velocity(emitter, [2], 25.0, 0.5, new)
    except ValueError as error:
        answer["not a domain"] = str(error)
    raw = velocity.read_staggered(domain)
    np.save(folder / "raw.npy", raw)
    np.save(folder / "centred.npy", velocity.cell_centred(raw))
    part = (slice(3, 9), slice(0, 10), slice(10, None))
    answer["block"] = bool(np.array_equal(velocity.cell_centred(raw, part), velocity.cell_centred(raw)[part]))
    domain.keyframe_insert("location", frame=2)
    domain.location.x += 0.5
    domain.keyframe_insert("location", frame=3)
    answer["moving"] = attempt(out_path=folder / "moving.zarr")
(folder / "answer.json").write_text(json.dumps(answer))
mantaflow.leave()
"""


def run(folder: Path, data_format: str) -> dict:
    result = subprocess.run(
        [sys.executable, "-c", CHILD, str(folder), data_format], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert result.returncode == 0, result.stdout[-1500:] + result.stderr[-1500:]
    return json.loads((folder / "answer.json").read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("export")


@pytest.fixture(scope="module")
def answer(folder):
    return run(folder, "UNI")


def test_attributes_and_progress(answer, folder):
    attributes = answer["done"]["ok"]
    assert {k: attributes[k] for k in ("schema", "version", "units", "frame", "layout")} == {
        "schema": "gof-velocity",
        "version": 1,
        "units": "m/s",
        "frame": "world",
        "layout": "cell_centred",
    }
    assert attributes["time_s"] == pytest.approx([0, 1 / 25, 3 / 25])  # first frame is time 0
    assert answer["progress"] == [[1, 3], [2, 3], [3, 3]]
    assert answer["again"]["ok"] == attributes
    matrix = np.array(attributes["index_to_world"])
    assert attributes["voxel_size"] == pytest.approx(np.linalg.det(matrix[:3, :3]) ** (1 / 3))


def test_centring_is_the_mean_of_two_faces(answer, folder):
    raw, centred = np.load(folder / "raw.npy"), np.load(folder / "centred.npy")
    assert answer["block"]
    for axis in range(3):
        lower, value = (np.moveaxis(v[..., axis], axis, 0) for v in (raw, centred))
        assert np.array_equal(value[:-1], 0.5 * (lower[:-1] + lower[1:]))
        assert np.array_equal(value[-1], lower[-1])


@pytest.mark.parametrize(
    "what, word",
    [
        ("other frames", "shape"),
        ("not baked", "frame 9 is not baked"),
        ("no frames", "no frames"),
        ("fps", "must be > 0"),
        ("time scale", "time scale 0.5, not 1.0"),
        ("moving", "moves at frame 3"),
    ],
)
def test_refused(answer, what, word):
    assert word in answer[what]["text"]


def test_object_without_domain_is_refused(answer):
    assert "no fluid modifier of type domain" in answer["not a domain"]


def test_cache_clipped_to_the_smoke_is_refused(tmp_path):
    assert "OpenVDB cache keeps velocity only where there is smoke" in run(tmp_path, "OPENVDB")["clipped"]["text"]
