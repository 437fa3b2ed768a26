"""A look-alike result of every foreign method through `gof evaluate` itself, where its DVE is known in closed form.

The true velocity is linear in space, so a Gaussian's expectation is the value at its centre and the grid holds it
exactly; what remains to be known is each method's weight, centre and velocity at a time, which every test writes out
from the raw numbers of the file it made.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from gof.commands.cli import main
from gof.core.fields import VelocityField
from gof.core.motion import Motion, State
from gof.core.trajectory import Trajectory
from gof.dataset import Dataset
from gof.evaluate import evaluate as score_it
from tests.conftest import arc, random_gaussians, write_dataset
from tests.io import lookalikes, stages
from tests.io.lookalikes import logistic, yang_covariance

pytestmark = pytest.mark.long

TIMES, SAME = 0.02 * np.arange(9), np.eye(4)
A, B = np.array([[0.2, -0.5, 0.1], [0.4, 0.1, 0.0], [-0.1, 0.3, -0.3]]), np.array([0.3, -0.2, 1.0])


def flow(x, t):
    return (1 + 5 * t) * (x @ A.T + B)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """3 cameras, 9 frames 20 ms apart, a 48 m box of 2 m cells."""
    cameras = arc(3, width=18, height=32, focal_px=30.0)
    grid = VelocityField.from_array(np.zeros((24, 24, 24, 3)), (-24, -24, -24), 2.0)
    fields = [
        VelocityField.from_array(flow(grid.cell_centers(), t).astype(np.float32), (-24, -24, -24), 2.0, t)
        for t in TIMES
    ]
    pictures = np.random.default_rng(0).random((9, 3, 32, 18, 3))
    return write_dataset(
        tmp_path_factory.mktemp("linear") / "data",
        cameras,
        pictures,
        pictures[0],
        TIMES,
        fields,
        masks=pictures[..., 0] > 0.5,
        test_frames=[4],
    )


def say(result, *options) -> None:
    """What the result's files do not say, written down beside them."""
    assert main(["convert", str(result), *map(str, options)]) == 0


def evaluate(result, dataset, out, *options) -> dict:
    assert main(["evaluate", str(result), "--dataset", str(dataset), "--json", str(out), *map(str, options)]) == 0
    return json.loads(out.read_text())


def closed_form(state) -> tuple[float, float]:
    """L2 and CosSim over all frames of state(t) -> (weight (N,), position (N, 3), velocity (N, 3)), in float64."""
    error = power = cosine = total = 0.0
    for t in TIMES:
        w, x, v = state(t)
        truth = flow(x, t)
        error += float((w * ((v - truth) ** 2).sum(1)).sum())
        power += float((w * (truth**2).sum(1)).sum())
        cosine += float((w * (v * truth).sum(1) / np.linalg.norm(v, axis=1) / np.linalg.norm(truth, axis=1)).sum())
        total += float(w.sum())
    return np.sqrt(error / power), cosine / total


def check(scores, method, state):
    l2, cos_sim = closed_form(state)
    assert scores["import"]["method"] == method and scores["dve"]["frames_scored"] == len(TIMES)
    assert scores["dve"]["l2"] == pytest.approx(l2, rel=2e-5) and scores["dve"]["cos_sim"] == pytest.approx(
        cos_sim, abs=2e-5
    )
    assert scores["dve"]["weight_outside"] == 0 and scores["trivial_baselines"]["true_centre"]["l2"] == pytest.approx(
        0, abs=1e-5
    )
    assert (
        scores["trivial_baselines"]["zero"]["l2"] == pytest.approx(1, rel=1e-12)
        and scores["psnr"] > 0
        and scores["ssim_flame"] is not None
    )


def authors_state(raw, linear=SAME[:3, :3], shift=0.0):
    """Weights, centres and velocities of the paper's checkpoint at t s, in a world x -> linear x + shift."""
    d = raw["dynamic"]
    volume = (0.001 + 0.029 * logistic(raw["scaling"][d])).prod(1)

    def state(t):
        dt = 1000 * t - raw["t_mu"][d].astype(float)
        alpha = logistic(raw["opacity"][d]) * np.exp(-(dt**2) / (2 * raw["t_sigma"][d].astype(float) ** 2))
        return (
            volume * alpha[:, 0],
            (raw["xyz"][d] + dt * raw["velocity"][d]) @ linear.T + shift,
            1000 * raw["velocity"][d].astype(float) @ linear.T,
        )

    return state


def test_the_papers_checkpoint(dataset, tmp_path, capsys):
    _, raw = lookalikes.authors(tmp_path / "model")
    scores = evaluate(tmp_path / "model", dataset, tmp_path / "s.json")
    check(scores, "authors", authors_state(raw))
    assert scores["dynamic_gaussians"] == raw["dynamic"].sum()
    printed = " ".join(capsys.readouterr().out.split())
    assert "scale bounds from" in printed and "trivial: constant" in printed


def test_4dgs_of_yang(dataset, tmp_path):
    raw = lookalikes.yang(tmp_path / "chkpnt30000.pth")
    S = yang_covariance(raw)
    volume = np.exp(raw["scaling"].astype(float).sum(1) + raw["scaling_t"][:, 0]) / np.sqrt(S[:, 3, 3])
    velocity = S[:, :3, 3] / S[:, 3, 3, None]

    def state(t):
        dt = t - raw["t"].astype(float)
        return (
            volume * logistic(raw["opacity"][:, 0]) * np.exp(-(dt[:, 0] ** 2) / (2 * S[:, 3, 3])),
            raw["xyz"] + dt * velocity,
            velocity,
        )

    say(tmp_path / "chkpnt30000.pth", "--time-unit", 1)
    scores = evaluate(tmp_path / "chkpnt30000.pth", dataset, tmp_path / "s.json")
    check(scores, "yang", state)
    assert "as chkpnt30000.pth.gof.json says: time unit 1 s" in scores["import"]["notes"]
    (tmp_path / "chkpnt30000.pth.gof.json").unlink()
    asked = ["evaluate", str(tmp_path / "chkpnt30000.pth"), "--dataset", str(dataset)]
    assert main(asked) == 1  # 1 s in a clip of 0.16


def freetime_state(raw, to_world=SAME):
    """FreeTimeGS: times 0..1 over 61 frames, 1.2 s here; its world is the training's."""
    volume = np.exp(raw["scales"].astype(float)).prod(1)

    def state(t):
        dt = t / 1.2 - raw["times"].astype(float)
        window = np.exp(-0.5 * (dt / np.maximum(np.exp(raw["durations"].astype(float)), 0.02)) ** 2)[:, 0]
        return (
            volume * logistic(raw["opacities"]) * window,
            (raw["means"] + dt * raw["velocities"]) @ to_world[:3, :3].T + to_world[:3, 3],
            raw["velocities"] @ to_world[:3, :3].T / 1.2,
        )

    return state


@pytest.mark.parametrize("kind", ["checkpoint", "ftgs_ply"])
def test_freetimegs_with_its_normalisation_undone(dataset, tmp_path, kind):
    rng = np.random.default_rng(3)
    poses = {f"cam_{i}.png": c.world_to_camera for i, c in enumerate(arc(3))}
    points = rng.normal(size=(200, 3)) * [2, 1, 0.5] + [0, 0, 1]
    lookalikes.colmap_binary(tmp_path / "colmap/sparse/0", poses, points)
    if kind == "checkpoint":
        result, raw = tmp_path / "results", lookalikes.freetime(tmp_path / "results/ckpts/ckpt_29999.pt")
    else:
        result, raw = tmp_path / "a.ftgs.ply", lookalikes.ftgs_ply(tmp_path / "a.ftgs.ply")
    back = np.linalg.inv(lookalikes.freetime_world(poses, points))
    (tmp_path / "world.json").write_text(json.dumps({"training_to_world": back.tolist()}))
    say(result, "--world", tmp_path / "world.json", "--time-unit", 1.2)
    said = result.with_name(result.name + ".gof.json")
    assert json.loads(said.read_text())["world"] == "world.json", "it counts from its folder"
    scores = evaluate(result, dataset, tmp_path / "s.json")
    check(scores, "freetime", freetime_state(raw, back))
    said.unlink()
    left = evaluate(
        result, dataset, tmp_path / "t.json", "--no-images"
    )  # in the training's world it is another score, and a note says so
    assert left["dve"]["l2"] == pytest.approx(closed_form(freetime_state(raw))[0], rel=2e-5)
    assert any("normalises" in note for note in left["import"]["notes"])


def test_freetimegs_with_its_colmap_model(dataset, tmp_path):
    """Gaussians on the points, normalised by the method's own rule; and cameras that are the dataset's, or not."""
    rng = np.random.default_rng(3)
    poses = {f"cam_{i}.png": c.world_to_camera for i, c in enumerate(arc(3))}
    points = rng.normal(size=(200, 3)) * [2, 1, 0.5] + [0, 0, 1]
    T = lookalikes.freetime_world(poses, points, (-1, 1))
    raw = lookalikes.freetime(tmp_path / "ckpt_1.pt", means=(points + 0.01) @ T[:3, :3].T + T[:3, 3])
    lookalikes.colmap_binary(tmp_path / "colmap/sparse/0", poses, points)
    say(tmp_path / "ckpt_1.pt", "--world", tmp_path / "colmap", "--time-unit", 1.2)
    scores = evaluate(tmp_path / "ckpt_1.pt", dataset, tmp_path / "s.json")
    check(scores, "freetime", freetime_state(raw, np.linalg.inv(T)))
    assert any("cameras are the dataset's" in note for note in scores["import"]["notes"])
    turned = {k: p @ np.diag([-1.0, -1, 1, 1]) for k, p in poses.items()}
    lookalikes.colmap_binary(tmp_path / "turned/sparse/0", turned, points * [-1, -1, 1])
    say(tmp_path / "ckpt_1.pt", "--world", tmp_path / "turned", "--time-unit", 1.2, "--overwrite")
    assert main(["evaluate", str(tmp_path / "ckpt_1.pt"), "--dataset", str(dataset), "--no-images"]) == 1


def test_a_sequence_of_plys_at_half_steps(dataset, tmp_path):
    """Deformation methods: accelerated motion (three-point differences are exact), changing sizes and opacities."""
    rng = np.random.default_rng(5)
    x0, v0, a = rng.normal(size=(3, 40, 3)) * np.array([1, 1, 4])[:, None, None]
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(rng, 40).items()}

    def values(t):
        return (
            x0 + v0 * t + 0.5 * a * t**2,
            raw["scaling"] + t * np.array([1, -1, 2.0]),
            raw["opacity"] + 3 * t * np.sign(raw["opacity"]),
        )

    for number in range(17):
        x, scaling, opacity = values(0.01 * number)
        lookalikes.splat_ply(
            tmp_path / f"gaussian_pertimestamp/time_{number:05d}.ply",
            raw | {"xyz": x, "scaling": scaling, "opacity": opacity},
        )

    def state(t):
        x, scaling, opacity = values(t)
        return np.exp(scaling.sum(1)) * logistic(opacity[:, 0]), x, v0 + a * t

    say(tmp_path / "gaussian_pertimestamp", "--time-unit", 0.01)
    scores = evaluate(tmp_path / "gaussian_pertimestamp", dataset, tmp_path / "s.json")
    check(scores, "ply-sequence", state)
    assert any("differences" in note for note in scores["import"]["notes"])


def test_a_usd_of_another_program(dataset, tmp_path):
    """Accelerated motion, y up and in centimetres, with changing sizes, at half steps; its clock begins at 1."""
    rng = np.random.default_rng(6)
    x0, v0, a = rng.normal(size=(3, 40, 3)) * np.array([1, 1, 4])[:, None, None]
    size, opacity = rng.uniform(0.1, 0.3, (40, 3)), rng.uniform(0.1, 0.9, 40)
    stage = stages.new(tmp_path / "fire.usdc", up="Y", metres=0.01, rate=100.0, start=1)
    samples = {}
    for k in range(17):
        x = x0 + v0 * 0.01 * k + 0.5 * a * (0.01 * k) ** 2
        theirs = 100 * np.stack([x[:, 0], x[:, 2], -x[:, 1]], 1)
        samples[1 + k] = {"positions": theirs, "scales": 100 * size * (1 + 0.02 * k)}
    stages.splats(stage, "/fire", samples, opacities=opacity)
    stage.Save()

    def state(t):
        return opacity * ((1 + 2 * t) * size).prod(1), x0 + v0 * t + 0.5 * a * t**2, v0 + a * t

    scores = evaluate(tmp_path / "fire.usdc", dataset, tmp_path / "s.json")
    check(scores, "usd", state)
    assert any("y up, 0.01 m" in note for note in scores["import"]["notes"])


def test_a_trajectory_with_its_own_velocities(dataset, tmp_path):
    rng = np.random.default_rng(6)
    centre, radius, phase, rate = (
        rng.normal(size=(50, 3)),
        rng.uniform(0.1, 1, 50),
        rng.uniform(0, 6, 50),
        rng.uniform(5, 20, 50),
    )
    scale, alpha = rng.uniform(0.02, 0.2, (50, 3)), rng.uniform(0.1, 1, 50)

    def state(t):
        angle = rate * t + phase
        x = centre + radius[:, None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
        v = (radius * rate)[:, None] * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], 1)
        return scale.prod(1) * alpha * np.exp(-5 * t), x, v

    states = [state(t) for t in TIMES]
    Trajectory(
        TIMES,
        np.stack([x for _, x, _ in states]),
        np.stack([w for w, _, _ in states]) / scale.prod(1),
        scale,
        rng.normal(size=(50, 4)),
        velocity=np.stack([v for _, _, v in states]),
    ).save(tmp_path / "t.npz")
    scores = evaluate(tmp_path / "t.npz", dataset, tmp_path / "s.json")
    check(scores, "trajectory", state)
    assert "velocities as stored" in scores["import"]["notes"]


@pytest.fixture
def own_world(dataset, tmp_path):
    """A world 0.4 times as large and turned, and the dataset's cameras in it, as its COLMAP model would hold them."""
    s, R, shift = 0.4, np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), np.array([5.0, -2, 1])
    meta = json.loads((dataset / "dataset.json").read_text())
    poses = {}
    for c in meta["cameras"]:
        pose = np.linalg.inv(c["world_to_camera"])
        pose[:3, :3], pose[:3, 3] = R @ pose[:3, :3], s * R @ pose[:3, 3] + shift
        poses[f"{c['name']}/000001.png"] = np.linalg.inv(pose)
    return s * R, shift, poses


def test_alignment_from_cameras(dataset, tmp_path, own_world, capsys):
    """Trained in its own COLMAP world: the similarity from the cameras brings it back, and what is left is reported."""
    linear, shift, poses = own_world
    _, raw = lookalikes.authors(tmp_path / "model")
    lookalikes.colmap_binary(tmp_path / "colmap", poses, np.zeros((3, 3)))
    scores = evaluate(tmp_path / "model", dataset, tmp_path / "s.json", "--align", tmp_path / "colmap")
    back = np.linalg.inv(linear)
    check(scores, "authors", authors_state(raw, back, -back @ shift))
    found = scores["import"]["alignment"]
    assert found["scale"] == pytest.approx(2.5) and found["position_rms_m"] < 1e-6 and found["rotation_max_deg"] < 1e-3
    assert "moved by the similarity" in " ".join(capsys.readouterr().out.split())


def test_what_an_alignment_leaves_is_reported(dataset, tmp_path, own_world):
    """One camera of three measured 20 mm (of the dataset) beside its place: the fit cannot hide it."""
    linear, _, poses = own_world
    lookalikes.authors(tmp_path / "model")
    moved = np.linalg.inv(poses["cam_1/000001.png"])
    moved[:3, 3] += linear @ [0, 0, 0.02]
    lookalikes.colmap_binary(tmp_path / "colmap", poses | {"cam_1/000001.png": np.linalg.inv(moved)}, np.zeros((3, 3)))
    scores = evaluate(tmp_path / "model", dataset, tmp_path / "s.json", "--align", tmp_path / "colmap", "--no-images")
    left = scores["import"]["alignment"]["position_rms_m"]
    # if all cameras share the blame evenly, sqrt(2) / 3 of the error is left; orientations hold the rest in place
    assert 0.02 * np.sqrt(2) / 3 * 0.9 < left < 0.02 / np.sqrt(3) * 1.01
    assert f"{left * 1000:.2g} mm" in " ".join(scores["import"]["notes"])
    asked = ["evaluate", str(tmp_path / "model"), "--dataset", str(dataset)]
    assert main([*asked, "--align", str(tmp_path / "nothing")]) == 1


def test_a_part_of_the_clip_is_scored_with_a_warning(dataset, tmp_path):
    """Frames 3 to 6 of 9: with pictures too, and never as the clip's score; a function of time is scored the same."""
    rng = np.random.default_rng(6)
    x0, rotation = rng.normal(size=(20, 3)), rng.normal(size=(20, 4))

    def state(t):
        return State(x0 + t * A[0], np.full(20, 0.5), np.full((20, 3), 0.1), rotation)

    part = Motion(state, (TIMES[3], TIMES[6]), times_s=TIMES[3:7])
    scores = evaluate(part.save(tmp_path / "t.npz"), dataset, tmp_path / "s.json")
    assert scores["dve"]["frames_scored"] == 4 and scores["psnr"] > 0 and scores["images"]["count"] == 3
    assert "4 of the clip's 9 frames and 1 of its 1 held-out" in scores["warnings"][0]
    direct = score_it(part, Dataset.open(dataset))
    assert direct.dve.l2 == pytest.approx(scores["dve"]["l2"], rel=1e-5) and direct.warnings == tuple(
        scores["warnings"]
    )
    none = evaluate(Motion(state, times_s=TIMES[6:]).save(tmp_path / "u.npz"), dataset, tmp_path / "u.json")
    assert none["psnr"] is None and "0 of its 1 held-out" in none["warnings"][0]


WHOLE_SCENES = {  # a look-alike's file, and the options that it is read with
    "yang": (lambda folder: lookalikes.yang(folder / "chkpnt30000.pth"), "chkpnt30000.pth", ["--time-unit", 1]),
    "freetime": (lambda folder: lookalikes.freetime(folder / "ckpt_1.pt"), "ckpt_1.pt", ["--time-unit", 0.16]),
    "freetime, PLY": (lambda folder: lookalikes.ftgs_ply(folder / "a.ftgs.ply"), "a.ftgs.ply", ["--time-unit", 0.16]),
    "spacetime": (lambda folder: lookalikes.spacetime(folder / "p.ply"), "p.ply", ["--time-unit", 0.16]),
}


@pytest.mark.parametrize("name", WHOLE_SCENES)
def test_a_converted_whole_scene_is_still_not_drawn_over_our_plates(dataset, tmp_path, name):
    """In our formats, once and twice converted, it is the other method's, and scores what its own file scores."""
    write, file, options = WHOLE_SCENES[name]
    write(tmp_path)
    say(tmp_path / file, *options)
    original = evaluate(tmp_path / file, dataset, tmp_path / "s.json")
    (tmp_path / f"{file}.gof.json").unlink()
    method = original["import"]["method"]
    assert name.startswith(method) and original["import"]["over_plates"] is False
    steps = [(file, "a.npz", options), ("a.npz", "b.ply", []), ("b.ply", "c.npz", [])]
    if name == "spacetime":  # positions along a polynomial have no closed form: a trajectory, which is never ours
        steps = steps[:1]
    for before, after, said in steps:
        assert main(["convert", *map(str, (tmp_path / before, tmp_path / after, *said))]) == 0
        scores = evaluate(tmp_path / after, dataset, tmp_path / "t.json")
        assert scores["import"]["method"] == ("trajectory" if name == "spacetime" else method)
        assert scores["import"]["over_plates"] is False, after
        assert scores["psnr"] == pytest.approx(original["psnr"], abs=0.02), after
    say(tmp_path / after, "--flame-only")
    asked = evaluate(tmp_path / after, dataset, tmp_path / "t.json")
    assert asked["import"]["over_plates"] and abs(asked["psnr"] - original["psnr"]) > 0.1


@pytest.mark.parametrize("suffix", ["npz", "ply"])
def test_a_converted_flame_of_ours_is_still_drawn_over_its_plates(dataset, tmp_path, suffix):
    g = random_gaussians(30)
    g[g.dynamic].save(tmp_path / "result.npz", source="gof reconstruct linear")
    assert main(["convert", str(tmp_path / "result.npz"), str(tmp_path / f"a.{suffix}")]) == 0
    found = [evaluate(tmp_path / file, dataset, tmp_path / "s.json") for file in ("result.npz", f"a.{suffix}")]
    assert [scores["import"]["over_plates"] for scores in found] == [True, True]
    assert found[0]["psnr"] == pytest.approx(found[1]["psnr"], abs=0.02)
    assert not found[0]["import"]["notes"] and not found[1]["import"]["notes"]


def test_a_file_that_does_not_say_what_it_was_made_from_is_named(dataset, tmp_path):
    g = random_gaussians(30)
    g[g.dynamic].save(tmp_path / "mine.npz")
    (note,) = evaluate(tmp_path / "mine.npz", dataset, tmp_path / "s.json")["import"]["notes"]
    assert "does not say what it was made from" in note


def test_a_function_of_time_is_not_ours(dataset):
    """In memory, too, another method's Gaussians are drawn as they are."""
    motion = Motion(
        lambda t: State(np.zeros((5, 3)), np.full(5, 0.5), np.full((5, 3), 0.1), np.tile([1.0, 0, 0, 0], (5, 1))),
        times_s=TIMES,
    )
    assert not score_it(motion, Dataset.open(dataset)).import_.over_plates


def test_the_scripts_of_this_page_run(dataset, tmp_path, monkeypatch):
    """docs/importers.md, "My own method": every script and command as it stands; all three score the same motion."""
    page = (Path(__file__).parents[2] / "docs/importers.md").read_text()
    page = page.partition("## My own method")[2].partition("\n## ")[0]
    (tmp_path / "data").mkdir()
    (tmp_path / "data/fire").symlink_to(dataset)
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(python)?\n(.*?)```", page, re.S)
    assert [kind for kind, _ in blocks] == ["python", "", "python", "", "python"]
    found = []
    for kind, text in blocks:
        # this dataset lasts 0.16 s, the page's 0.35 s
        text = text.replace("range(71)", "range(33)")
        if kind:
            exec(compile(text, "docs/importers.md", "exec"), {"__name__": "page"})
        else:
            for line in text.strip().splitlines():
                assert main(line.partition("#")[0].split()[1:]) == 0
        for scores in sorted(tmp_path.glob("out/*/scores.json")):
            found.append(json.loads(scores.read_text())["dve"])
            scores.unlink()
    assert len(found) == 3 and found[0]["frames_scored"] == len(TIMES)
    for other in found[1:]:
        assert other["l2"] == pytest.approx(found[0]["l2"], rel=1e-3)
