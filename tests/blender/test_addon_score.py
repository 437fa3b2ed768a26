"""The panel Score in real Blender: DVE by `gof evaluate` or by the add-on, truth at the centres, error views."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof.core.grid_writer import GridWriter
from gof.dataset import Dataset
from gof.evaluate import scores as gof_scores
from gof.evaluate.sequence import dve_sequence
from gof_blender.pure.dve import MotionScores
from gof_blender.pure.score_process import Evaluation, EvaluationError
from tests.blender.runs import in_blender
from tests.conftest import arc, random_gaussians, write_dataset

TIMES = 0.01 * np.arange(4)
START = """
import os, sys, traceback
from pathlib import Path
import numpy as np
import gof_blender
from gof_blender.scene import point_cloud

def stop(*error):  # a Python process with bpy may hang at its end
    traceback.print_exception(*error)
    sys.stderr.flush()
    os._exit(1)

sys.excepthook = stop
folder, python = Path(sys.argv[1]), sys.argv[2]
bpy.ops.wm.read_factory_settings(use_empty=True)
gof_blender.register()
scene = bpy.context.scene
scene.render.fps = 100
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"))
thing, settings = bpy.context.object, scene.gof.score
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A dataset whose true velocity is (0, y, 1 + 10 t), and a result with others inside and outside of it."""
    folder = tmp_path_factory.mktemp("score")
    rng, cameras = np.random.default_rng(0), arc(2)
    images = rng.random((4, 2, 64, 36, 3))
    dataset = write_dataset(folder / "dataset", cameras, images, images[0] * 0.5, TIMES, test_frames=[2])
    matrix = np.diag([0.25, 0.25, 0.25, 1.0])
    matrix[:3, 3] = [-1, -1, 0]
    writer = GridWriter(dataset / "velocity.zarr", (8, 8, 8), matrix, TIMES, 0.25, "float32")
    for frame, time_s in enumerate(TIMES):
        velocity = np.zeros((8, 8, 8, 3))
        velocity[..., 1] = (-1 + 0.25 * (np.arange(8) + 0.5))[None, :, None]
        velocity[..., 2] = 1 + 10 * time_s
        writer.write_frame(frame, velocity.__getitem__)
    writer.finish()
    text = (dataset / "dataset.json").read_text()
    (dataset / "dataset.json").write_text(text.replace('"velocity": null', '"velocity": "velocity.zarr"'))
    result = random_gaussians(80)
    result.position[:10] += 50  # outside
    result.position[10:] = np.clip(result.position[10:], [-0.8, -0.8, 0.2], [0.8, 0.8, 1.8])
    result.t_mu[:] = np.linspace(-0.02, 0.05, 80)
    result.save(folder / "result.npz")
    return folder


@pytest.mark.blender
def test_score_is_that_of_the_library(folder):
    found = in_blender(
        START
        + """
result["poll before"] = bpy.ops.gof.score.poll()
settings.dataset, settings.python = str(folder / "dataset"), python
result["answer"] = list(bpy.ops.gof.score())
result["numbers"] = settings.numbers.splitlines()
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scored.blend"))
bpy.ops.wm.open_mainfile(filepath=str(folder / "scored.blend"))
result["kept"] = bpy.context.scene.gof.score.numbers.splitlines() == result["numbers"]
""",
        folder,
        sys.executable,
    )
    assert found["answer"] == ["FINISHED"] and not found["poll before"] and found["kept"]
    dataset = Dataset.open(folder / "dataset")
    gaussians = TransientGaussians.load(folder / "result.npz")
    wanted = dve_sequence(gaussians, dataset.velocity, dataset.velocity.times_s, 3, "temporal").pooled
    assert {f"DVE L2: {wanted.l2:.3f}", f"DVE CosSim: {wanted.cos_sim:.3f}"} <= set(found["numbers"])


@pytest.mark.blender
def test_without_a_python_the_addon_scores_by_itself(folder):
    """In another process of this Blender, without gof, torch or mitsuba; the numbers are gof's."""
    found = in_blender(
        START
        + """
settings.dataset = str(folder / "dataset")
result["answer"] = list(bpy.ops.gof.score())
result["numbers"] = settings.numbers.splitlines()
result["foreign"] = sorted({"gof", "torch", "mitsuba", "scipy"} & set(sys.modules))
""",
        folder,
        sys.executable,
    )
    wanted = dve_sequence(TransientGaussians.load(folder / "result.npz"), Dataset.open(folder / "dataset").velocity)
    assert found["answer"] == ["FINISHED"] and found["foreign"] == []
    assert set(found["numbers"]) >= {
        f"DVE L2: {wanted.l2:.3f}",
        f"DVE CosSim: {wanted.cos_sim:.3f}",
        f"L2 of one vector: {wanted.trivial_baselines['constant'].l2:.3f}",
        f"Weight outside: {100 * wanted.pooled.weight_outside:.0f} %",
        "Frames: 4",
        "Computed by: the add-on",
    }


@pytest.mark.long
def test_weight_outside_is_a_percentage_of_the_weight(folder, tmp_path):
    """Nothing but two Gaussians of the same size and light at the same time: one in the domain, one far from it."""
    gaussians = random_gaussians(2)
    gaussians.position[:] = [[0.0, 0.0, 1.0], [50.0, 50.0, 50.0]]
    for values in (gaussians.velocity, gaussians.t_mu, gaussians.t_sigma, gaussians.scale, gaussians.opacity):
        values[:] = values[0]
    gaussians.t_mu[:] = 0.015
    gaussians.dynamic[:] = True
    gaussians.save(tmp_path / "result.npz")
    out = tmp_path / "scores.json"
    evaluate = [sys.executable, "-m", "gof", "evaluate", tmp_path / "result.npz", "--dataset", folder / "dataset"]
    subprocess.run([*map(str, evaluate), "--no-images", "--json", str(out)], check=True, capture_output=True)
    rows = dict(MotionScores.read(out).rows())
    assert rows["Weight outside"] == "50 %"
    read = gof_scores.Scores.read(out)
    assert rows["DVE L2"] == f"{read.dve.l2:.3f}" and rows["Frames"] == str(read.dve.frames_scored)
    assert rows["L2 of no motion"] == f"{read.trivial_baselines['zero'].l2:.3f}"


@pytest.mark.blender
def test_errors_at_the_centres_and_their_views(folder):
    found = in_blender(
        START
        + """
settings.dataset = str(folder / "dataset")
thing.location = (5, 0, 0)  # the cloud's own coordinates count
thing.rotation_euler.z = 0.3
for _ in range(2):
    bpy.ops.gof.show_errors()
result["true"] = point_cloud.column(thing.data, "gs_true_velocity", 3).tolist()
result["text"] = settings.centres
views = {thing.name: thing for thing in bpy.data.objects if point_cloud.inputs(thing)}
keys = "Mode", "Color By", "Arrows Show", "Color Max"
result["views"] = {name: [point_cloud.inputs(view)[key] for key in keys] for name, view in views.items()}
result["shared"] = len({view.data.name for view in views.values()}), len(bpy.data.meshes)
bpy.context.view_layer.update()
result["apart"] = [list(thing.matrix_world.inverted() @ views[name].matrix_world.translation) for name in
                   ("result Error", "result True Velocity", "result Error Arrows")]
bpy.context.view_layer.objects.active = views["result Error"]
result["poll of a view"] = bpy.ops.gof.show_errors.poll()
""",
        folder,
        sys.executable,
    )
    result = TransientGaussians.load(folder / "result.npz")
    inside = (np.arange(80) >= 10) & result.dynamic
    true = np.column_stack([np.zeros(80), result.position[:, 1], 1 + 10 * np.clip(result.t_mu, 0, 0.03)])
    assert np.allclose(np.array(found["true"])[inside], true[inside], atol=1e-5)
    own = np.where(result.dynamic[:, None], result.velocity, 0)
    assert np.allclose(np.array(found["true"])[~inside], own[~inside])  # nothing to compare with: no error
    error = np.linalg.norm(result.velocity - true, axis=1)[inside]
    assert (
        f"of {inside.sum()} Gaussians" in found["text"] and f"median error {np.median(error):.2f} m/s" in found["text"]
    )
    fastest = found["views"]["result Error"][3]
    assert found["views"] == {
        "result": [0, 0, 0, 1.0],
        "result Error": [0, 4, 0, fastest],
        "result True Velocity": [2, 1, 1, fastest],
        "result Error Arrows": [2, 4, 2, fastest],
    }
    assert found["shared"] == [1, 1] and found["poll of a view"]
    steps = np.array(found["apart"])
    assert (
        np.allclose(steps[:, 1:], 0, atol=1e-5)
        and np.allclose(steps[:, 0] / steps[0, 0], [1, 2, 3])
        and steps[0, 0] > 1
    )


@pytest.mark.blender
@pytest.mark.parametrize(
    "setup, message",
    [
        ("settings.python, settings.dataset = '', str(folder)", "dataset.json"),
        ("settings.python = '/nowhere/python'", "cannot be run"),
        ("settings.python = str(folder / 'bare' / 'bin' / 'python')", "this Python has no gof; install it there"),
        ("settings.dataset = str(folder)", "dataset.json"),
        ("del thing['gof_source']", "import the reconstruction again"),
    ],
)
def test_what_is_missing_is_said(folder, bare_python, setup, message):
    found = in_blender(
        START
        + f"""
settings.dataset, settings.python = str(folder / "dataset"), python
{setup}
try:
    result["answer"] = list(bpy.ops.gof.score())
except RuntimeError as error:
    result["error"] = str(error)
result["numbers"] = settings.numbers
""",
        folder,
        sys.executable,
    )
    assert message in found["error"] and found["numbers"] == ""


@pytest.fixture(scope="module")
def bare_python(folder) -> Path:
    """A Python without gof."""
    import venv

    venv.create(folder / "bare", symlinks=True)
    return folder / "bare" / "bin" / "python"


def test_evaluation_can_be_stopped(folder):
    run = Evaluation.by_gof(Path(sys.executable), folder / "result.npz", folder / "dataset")
    assert run.poll()
    scratch = run._folder
    run.stop()
    assert not scratch.exists() and run._process.returncode != 0


@pytest.mark.long
def test_a_failing_evaluation_says_what_gof_said(folder):
    with pytest.raises(EvaluationError, match=r"gof evaluate: .*nothing\.npz"):
        Evaluation.by_gof(Path(sys.executable), folder / "nothing.npz", folder / "dataset").run()
