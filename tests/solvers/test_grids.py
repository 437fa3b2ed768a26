"""The contract of a flame's source: what is written is read, and what does not fit together is refused."""

import json
import shutil

import numpy as np
import pytest

from gof.core.errors import DataFormatError, NonFiniteError
from gof.core.fields import VelocitySequence
from gof.core.fire import FireDescription, Hearth
from gof.core.records import from_json, to_json
from gof_benchmark.fires.flames import of_grids
from gof_benchmark.solvers.grids import FireFrame, FireGrids, FireHistory, write_fire
from tests.solvers.conftest import write_small_fire


def test_a_fire_comes_back_as_it_was(tmp_path):
    written = write_small_fire(tmp_path / "fire", seed=7, wind_m_s=(1.5, 0.0), cpu_s={"fine": 12.5})
    fire = FireGrids.open(tmp_path / "fire")
    fire.check()
    assert fire.description == written.description and fire.history == written.history
    assert fire.voxel_m == pytest.approx(0.05) and fire.centers(2)[0] == pytest.approx(0.025)
    assert set(fire.grids) == {"emission", "temperature", "heat_release", "fuel"}
    np.testing.assert_allclose(fire.grids["emission"].cells(1)[2, 2, 0], [1, 0.5, 0.1], rtol=1e-6)
    assert fire.grids["temperature"].units == "K"
    # The house's own reader of velocities opens it: rendering and scores do not know which solver it was.
    assert VelocitySequence.open(tmp_path / "fire" / "velocity.zarr").at(0.005).resolution == (6, 6, 8)
    assert from_json(FireDescription, to_json(fire.description), "x") == fire.description


def test_a_solver_may_give_velocity_and_light_only(tmp_path):
    description = FireDescription("bare", "a VDB sequence", (0.0, 0.1), "as recorded")
    zeros = np.zeros((2, 2, 2, 3))
    fire = write_fire(tmp_path / "fire", description, np.eye(4), lambda k: FireFrame(zeros, zeros))
    assert set(fire.grids) == {"emission"} and fire.history is None


def change(path, **attributes):
    content = json.loads(path.read_text())
    content["attributes"].update(attributes)
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("store", "attributes", "says"),
    [
        ("emission", {"time_s": [0.0, 0.01, 0.03]}, "clock"),
        ("temperature", {"index_to_world": np.diag([0.05, 0.05, 0.06, 1]).tolist()}, "box"),
        ("fuel", {"quantity": "soot"}, "soot"),
        ("velocity", {"time_s": [0.0, 0.02, 0.03]}, "fire.json"),
    ],
)
def test_grids_that_do_not_belong_together_are_refused(tmp_path, store, attributes, says):
    write_small_fire(tmp_path / "fire")
    change(tmp_path / "fire" / f"{store}.zarr" / "zarr.json", **attributes)
    with pytest.raises(DataFormatError, match=says):
        FireGrids.open(tmp_path / "fire")


def test_an_unfinished_or_lightless_fire_is_refused(tmp_path):
    write_small_fire(tmp_path / "fire")
    shutil.rmtree(tmp_path / "fire" / "emission.zarr")
    with pytest.raises(DataFormatError, match="emission"):
        FireGrids.open(tmp_path / "fire")
    (tmp_path / "fire" / "fire.json").unlink()
    with pytest.raises(DataFormatError, match=r"fire\.json"):
        FireGrids.open(tmp_path / "fire")


def test_nothing_is_written_over_and_nothing_bad_is_written(tmp_path):
    write_small_fire(tmp_path / "fire")
    with pytest.raises(DataFormatError, match="exists already"):
        write_small_fire(tmp_path / "fire")
    with pytest.raises(NonFiniteError, match="velocity"):
        write_small_fire(tmp_path / "other", velocity=lambda z, k: np.nan if k == 1 else 0.0)
    assert not (tmp_path / "other").exists()
    zeros = np.zeros((2, 2, 2, 3))
    sizes = [zeros, np.zeros((3, 2, 2, 3))]
    with pytest.raises(DataFormatError, match="frame 1"):
        write_fire(
            tmp_path / "third",
            FireDescription("x", "x", (0.0, 0.1), "x"),
            np.eye(4),
            lambda k: FireFrame(sizes[k], sizes[k]),
        )


def test_grids_in_half_precision_are_stored_as_they_are(tmp_path):
    """What the solver rounded comes back to the bit, in half the bytes; precision may not change within a clip."""
    rng = np.random.default_rng(4)
    velocity = rng.normal(size=(2, 8, 8, 8, 3)).astype(np.float16)
    light = rng.uniform(size=(2, 8, 8, 8, 3))
    about = FireDescription("x", "x", (0.0, 0.1), "x")
    fire = write_fire(tmp_path / "half", about, np.eye(4), lambda k: FireFrame(velocity[k], light[k]))
    for k in range(2):
        assert fire.velocity.frame(k).velocity.dtype == np.float16
        np.testing.assert_array_equal(fire.velocity.frame(k).velocity, velocity[k])
        assert fire.grids["emission"].cells(k).dtype == np.float32
    fire.check()
    whole = write_fire(
        tmp_path / "whole", about, np.eye(4), lambda k: FireFrame(velocity[k].astype(np.float32), light[k])
    )
    sizes = [sum(p.stat().st_size for p in (f.path / "velocity.zarr/c").rglob("*")) for f in (fire, whole)]
    assert sizes[0] < sizes[1]
    mixed = [velocity[0], velocity[1].astype(np.float32)]
    with pytest.raises(DataFormatError, match="frame 1 has .* another precision"):
        write_fire(tmp_path / "mixed", about, np.eye(4), lambda k: FireFrame(mixed[k], light[k]))


def test_measures_of_a_half_precise_fire_are_those_of_a_whole_one(tmp_path):
    """Sums over a fire overflow half precision: they are not taken in it."""

    def frame(kind):
        light = np.zeros((40, 40, 8, 3), kind)
        light[4:36, 4:36, :6] = 30.0
        velocity = np.full((40, 40, 8, 3), 3.0, kind)
        return FireFrame(velocity, light, heat_release=np.full((40, 40, 8), 2e4, kind))

    box = np.diag([0.05, 0.05, 0.05, 1.0])
    box[:2, 3] = -1.0
    about = FireDescription("x", "x", (0.0, 0.1), "x", hearths=(Hearth(30.0, 0.2, (0.0, 0.0, 0.0), 0.02),))
    found = [
        of_grids(write_fire(tmp_path / kind, about, box, lambda k, kind=kind: frame(kind)))
        for kind in ("float16", "float32")
    ]
    assert found[0].truth.heat_burnt_kw == pytest.approx(2e4 * 40 * 40 * 8 * 0.05**3 / 1e3)
    for name, value in vars(found[1].truth).items():
        if isinstance(value, float):
            assert getattr(found[0].truth, name) == pytest.approx(value, rel=1e-3, nan_ok=True), name


def test_negative_light_is_found(tmp_path):
    zeros = np.zeros((2, 2, 2, 3))
    description = FireDescription("x", "x", (0.0,), "x")
    fire = write_fire(tmp_path / "f", description, np.eye(4), lambda k: FireFrame(zeros, zeros - 1))
    with pytest.raises(DataFormatError, match="negative emission"):
        fire.check()


def test_clocks_and_histories_are_checked():
    with pytest.raises(DataFormatError, match="start at 0"):
        FireDescription("x", "x", (0.1, 0.2), "x")
    with pytest.raises(DataFormatError, match="one row a time"):
        FireHistory((0.0, 1.0), (1.0,), (), ((), ()))
