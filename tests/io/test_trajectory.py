"""Positions sampled in time, sequences of PLYs and functions, against motions in closed form."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gof.core.errors import DataFormatError, GofError  # noqa: E402
from gof.core.motion import Motion, State  # noqa: E402
from gof.core.trajectory import Trajectory  # noqa: E402
from gof.io.importers import ImportOptions, read_result  # noqa: E402
from tests.io import lookalikes  # noqa: E402
from tests.io.lookalikes import logistic  # noqa: E402
from tests.io.motions import make_trajectory, similarity, swirl  # noqa: E402


def test_half_steps_and_ends_of_a_swirl():
    """A 1.5 Hz swirl at 25 frames per second: velocities of half steps are right to 0.6 %, of whole steps to 2.4 %."""
    rate = 2 * np.pi * 1.5
    errors = {}
    for name, times in (("whole", np.arange(0, 1.001, 0.04)), ("half", np.arange(0, 1.001, 0.02))):
        trajectory, start = make_trajectory(times, rate=rate)
        h = 1e-6
        for label, t in (("inside", 0.4), ("end", 1.0)):
            truth = (swirl(t + h, start, rate) - swirl(t - h, start, rate)) / (2 * h)
            v = trajectory.state_at(t).velocity
            errors[name, label] = np.linalg.norm(v - truth) / np.linalg.norm(truth)
    assert errors["half", "inside"] < 0.006 and 0.02 < errors["whole", "inside"] < 0.027
    assert errors["half", "end"] < 0.02 and errors["half", "end"] < errors["whole", "end"] / 3
    # changing by 3x its own error when the step doubles (differences of second order)
    assert make_trajectory(np.arange(0, 1.001, 0.04), rate=rate)[0].difference_change() == pytest.approx(
        3 * errors["whole", "inside"], rel=0.3
    )


def test_quadratic_motion_is_exact_on_uneven_times_and_linear_between_samples():
    times = np.array([0.0, 0.1, 0.25, 0.3, 0.7])
    x0 = np.random.default_rng(0).normal(size=(6, 3)) + 1000  # far from the origin
    position = np.stack([x0 + 2 * t + 3 * t**2 * np.array([1, 0, -1]) for t in times])
    trajectory = Trajectory(
        times, position, np.ones((5, 6)) * times[:, None], np.full((6, 3), 0.1), np.tile([1.0, 0, 0, 0], (6, 1))
    )
    for t in times:
        np.testing.assert_allclose(
            trajectory.state_at(t).velocity, np.broadcast_to(2 + 6 * t * np.array([1, 0, -1]), (6, 3)), atol=5e-3
        )
    between = trajectory.state_at(0.2)
    np.testing.assert_allclose(between.opacity, 0.2, atol=1e-6)
    np.testing.assert_allclose(between.velocity[0], [2 + 3 * 0.35, 2, 2 - 3 * 0.35], atol=5e-3)
    with pytest.raises(DataFormatError, match="outside"):
        trajectory.state_at(0.8)


def test_trajectory_file(tmp_path):
    trajectory, _ = make_trajectory(np.arange(5) * 0.1)
    got = read_result(trajectory.save(tmp_path / "t.npz", "by hand"))
    assert got.method == "trajectory" and isinstance(got.gaussians, Trajectory) and "differences" in got.notes[0]
    np.testing.assert_array_equal(got.gaussians.position, trajectory.position)
    np.savez(tmp_path / "bad.npz", schema="gof-trajectory/1", time_s=np.arange(3))
    with pytest.raises(DataFormatError, match="position"):
        read_result(tmp_path / "bad.npz")
    np.savez(
        tmp_path / "worse.npz",
        schema="gof-trajectory/1",
        time_s=np.array([0, 0.2, 0.1]),
        position=np.zeros((3, 2, 3)),
        opacity=np.zeros((3, 2)),
        scale=np.ones((2, 3)),
        rotation=np.ones((2, 4)),
    )
    with pytest.raises(DataFormatError, match="increasing"):
        read_result(tmp_path / "worse.npz")


def test_ply_sequence(tmp_path):
    rng = np.random.default_rng(1)
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(rng, 12).items()}
    start = raw["xyz"].astype(float)
    for k in range(6):
        raw["xyz"] = swirl(0.02 * k, start, 5.0).astype(np.float32)
        lookalikes.splat_ply(tmp_path / "seq" / f"time_{k:05d}.ply", raw)
    got = read_result(tmp_path / "seq", ImportOptions(time_unit_s=0.02, time_zero_s=1.0))
    assert got.method == "ply-sequence" and len(got.gaussians.time_s) == 6
    v = got.gaussians.state_at(1.06).velocity
    truth = (swirl(0.06 + 1e-6, start, 5.0) - swirl(0.06 - 1e-6, start, 5.0)) / 2e-6
    assert np.linalg.norm(v - truth) / np.linalg.norm(truth) < 0.005
    np.testing.assert_allclose(got.gaussians.opacity[0], logistic(raw["opacity"][:, 0]), rtol=1e-5)
    with pytest.raises(DataFormatError, match="--time-unit"):
        read_result(tmp_path / "seq")
    lookalikes.splat_ply(tmp_path / "seq/time_00006.ply", {k: v[:5] for k, v in raw.items()})
    with pytest.raises(DataFormatError, match="same Gaussians"):
        read_result(tmp_path / "seq", ImportOptions(time_unit_s=0.02))


def test_a_sequence_of_the_wrong_clock_or_kind_is_asked_about(tmp_path):
    """Half steps taken for frames, numbers of training steps, a file per picture, numbers with a point."""
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(np.random.default_rng(1), 5).items()}

    def write(folder, names, places):
        for name, place in zip(names, places, strict=True):
            lookalikes.splat_ply(tmp_path / folder / name, raw | {"xyz": raw["xyz"] + place})

    clip = ImportOptions(frame_time_s=0.01, clip_s=(0.0, 0.35))
    write("half", [f"{k:03d}.ply" for k in range(71)], np.linspace(0, 1, 71))
    with pytest.raises(DataFormatError, match="--time-unit"):
        read_result(tmp_path / "half", clip)
    assert read_result(tmp_path / "half", replace(clip, time_unit_s=0.005)).gaussians.covered_s[1] == pytest.approx(
        0.35
    )
    write("4dgs", [f"4dgs_{k:05d}.ply" for k in range(36)], np.linspace(0, 1, 36))
    assert len(read_result(tmp_path / "4dgs", clip).gaussians.time_s) == 36
    write("steps", ["point_cloud_7000.ply", "point_cloud_30000.ply"], [0, 1])
    with pytest.raises(DataFormatError, match="steps of a training"):
        read_result(tmp_path / "steps", ImportOptions(time_unit_s=0.01))
    write("cameras", [f"time_{k:05d}.ply" for k in range(9)], np.repeat([0, 1, 2], 3))
    with pytest.raises(DataFormatError, match="same positions"):
        read_result(tmp_path / "cameras", ImportOptions(time_unit_s=0.01))
    for name, files, said in (
        ("point", ["a_0.25.ply", "a_0.5.ply"], "or decimals"),
        ("two", ["a0.ply", "a1.ply", "b0.ply"], r"a0\.ply.*b0\.ply|b0\.ply.*a0\.ply"),
        ("more", ["a0.ply", "a1.ply", "still.ply"], r"still\.ply: its name has no frame number"),
        ("sizes", ["a0_64x64.ply", "a1_64x64.ply", "a1_32x32.ply"], "a1_64x64.ply"),
    ):
        write(name, files, range(len(files)))
        with pytest.raises(DataFormatError, match=said):
            read_result(tmp_path / name, ImportOptions(time_unit_s=0.01))


def test_a_sequence_of_plys_has_the_clock_of_its_numbers(tmp_path):
    """Not padded, one lost, hidden copies beside them, a size behind the number: 0.1 s to 1.2 s without 0.3 s."""
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(np.random.default_rng(1), 5).items()}
    numbers = [k for k in range(1, 13) if k != 3]
    for k in numbers:
        path = tmp_path / f"v2_{k}_64x64.PLY"
        lookalikes.splat_ply(path, raw | {"xyz": raw["xyz"] + np.float32(k)})
        (tmp_path / f"._{path.name}").write_bytes(bytes.fromhex("0005160700020000") + bytes(60))
    (tmp_path / ".DS_Store").write_bytes(b"\0\0\0\1Bud1")
    read = read_result(tmp_path, ImportOptions(time_unit_s=0.1))
    assert any("1 numbers are missing (3)" in note for note in read.notes)
    got = read.gaussians
    assert got.time_s == pytest.approx([0.1 * k for k in numbers])
    moved = np.asarray(got.position)[:, 0] - raw["xyz"][0]
    assert moved == pytest.approx(np.array(numbers)[:, None] * np.ones(3), abs=1e-5)


def test_ranges_of_a_trajectory(tmp_path):
    """Logarithms and logits are no sizes and opacities; seconds are no shares of the clip."""
    trajectory, _ = make_trajectory(np.linspace(0, 1, 5))
    for wrong, rule in (
        ({"scale": np.log(trajectory.scale)}, "not its log"),
        ({"opacity": trajectory.opacity * 9}, "logit"),
    ):
        with pytest.raises(DataFormatError, match=rule):
            replace(trajectory, **wrong)
    replace(trajectory, opacity=np.full_like(trajectory.opacity, 1 + 1e-7))
    path = trajectory.save(tmp_path / "t.npz")
    assert len(read_result(path, ImportOptions(clip_s=(0.0, 1.0))).notes) == 1
    assert "are they seconds" in read_result(path, ImportOptions(clip_s=(0.0, 0.35))).notes[1]


def test_a_function_of_time_is_a_result(tmp_path):
    """Velocities of a function that has none are differences of it; worlds, ends, files and wrong states."""
    _, start = make_trajectory(np.linspace(0, 1, 5))
    n = len(start)

    def state(t, **changes):
        fields = {"position": swirl(t, start), "opacity": np.full(n, 0.5), "scale": np.full((n, 3), 0.1)}
        return State(**fields | {"rotation": np.tile([1.0, 0, 0, 0], (n, 1))} | changes)

    motion = Motion(state, (0.0, 1.0), times_s=np.linspace(0, 1, 9))
    assert len(motion) == n and motion.life() == (0, 1)
    for t in (0.0, 0.4, 1.0):
        truth = (swirl(t + 1e-6, start) - swirl(t - 1e-6, start)) / 2e-6
        np.testing.assert_allclose(motion.state_at(t).velocity, truth, atol=0.05 if t in (0, 1) else 1e-4)
    T = similarity()
    np.testing.assert_allclose(
        motion.transformed(T).transformed(np.linalg.inv(T)).state_at(0.4).position, swirl(0.4, start), atol=1e-5
    )
    saved = read_result(motion.save(tmp_path / "m.npz")).gaussians
    np.testing.assert_allclose(saved.state_at(0.5).velocity, motion.state_at(0.5).velocity, atol=1e-6)
    with pytest.raises(DataFormatError, match="outside"):
        motion.state_at(1.1)
    with pytest.raises(GofError, match="times_s"):
        Motion(state).save(tmp_path / "n.npz")
    for wrong in (
        {"scale": np.full((n, 3), -2.0)},
        {"opacity": np.full(n, 3.0)},
        {"position": np.full((n, 3), np.nan)},
    ):
        with pytest.raises(GofError, match="the function: state at 0.5 s"):
            Motion(lambda t, wrong=wrong: state(t, velocity=np.zeros((n, 3)), **wrong)).state_at(0.5)
