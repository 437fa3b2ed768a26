"""Lines for the pace, on fires that obey one exactly, a clue that is tried, and a real fire of the factory."""

from pathlib import Path

import numpy as np
import pytest

from gof.core.files import read_json
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.pace import PaceClues
from gof_benchmark import fires
from gof_benchmark.training import pace_line
from gof_benchmark.training.factory.fire import PoorFireError
from gof_benchmark.training.pace_line import (
    LINES,
    SHIPPED,
    USUAL_UNSTEADY,
    Line,
    SeenFire,
    anew,
    keep,
    kind_of,
    learning_curve,
    left_out,
    moved,
    rms,
    unsteadiness,
    with_unsteadiness,
)
from tests.reconstruct.plumes import box_of_voxels, field_of
from tests.reconstruct.test_pace import STEP_S, column


def made_up(count: int, constant: float = 0.0, weight: float = 0.0) -> list[SeenFire]:
    """Fires of two kinds that obey the shipped line, a constant, and a weight of their unsteadiness over 0.14."""
    rng = np.random.default_rng(3)
    made = []
    for number in range(count):
        seen, law, carried, slenderness, texture = rng.uniform([0.1, 2, 0.2, 0.05, 0.3], [3, 8, 1, 0.3, 1.5])
        clues, unsteady = (
            PaceClues(seen, seen * law, seen * carried, slenderness, texture, 1.0),
            rng.uniform(0.08, 0.25),
        )
        pace = seen * np.exp(SHIPPED.metric @ [1, *clues.logs] + constant) * (unsteady / 0.14) ** weight
        kind = ("pool", "jet")[number % 2]
        made.append(SeenFire(str(number), "dev", kind, "sheets", (clues,), (unsteady,), (float(pace),)))
    return made


def off(line: Line, asked: list[SeenFire]) -> float:
    return rms(line.errors(fire) for fire in asked)


def test_unsteadiness_is_found_beside_the_shipped_line():
    made = made_up(60, 0.3, 0.8)
    line = with_unsteadiness(made[:40])
    assert (line.constant, line.weight) == pytest.approx((0.3, 0.8), abs=0.02)
    assert off(line, made[40:]) < 0.02
    assert off(moved(made[:40]), made[40:]) > 0.15, "without it its part is missed"


def test_a_constant_is_all_that_moves_without_it():
    made = made_up(12, -0.5)
    assert moved(made).constant == pytest.approx(-0.5)
    assert off(LINES["shipped"](made), made) == pytest.approx(0.5)
    assert off(anew(made_up(30, 0.2)), made_up(40, 0.2)[30:]) < 0.05


def test_buoyancy_alone_is_what_buoyancy_makes_of_a_flame():
    fire = made_up(1)[0]
    assert LINES["buoyancy"]([]).errors(fire)[0] == pytest.approx(np.log(fire.clues[0].buoyant / fire.paces[0]))


def test_flames_side_by_side_are_joined_as_the_product_does():
    a, b = (fire.clues[0] for fire in made_up(2))
    two = SeenFire("two", "dev", "pool", "sheets", (a, b), (0.14, 0.28), (2.0, 3.0))
    expected = np.log(np.array(SHIPPED.side_by_side([a, b])) / [2.0, 3.0])
    np.testing.assert_allclose(Line(SHIPPED).errors(two), expected, rtol=1e-9)
    np.testing.assert_allclose(Line(SHIPPED, 0.1, 0.6).errors(two), expected + 0.1 + 0.3 * np.log(2), rtol=1e-9)


def test_tables_name_what_was_left_out_and_the_clue_lowers_its_column():
    made = made_up(40, weight=0.8)
    rows = [line.split("|") for line in left_out(made, lambda fire: fire.kind).splitlines()]
    assert [row[1].strip() for row in rows[2:]] == ["jet", "pool", "all"]
    heads, last = [cell.strip() for cell in rows[0]], rows[-1]
    assert float(last[heads.index("and unsteadiness")]) < 0.05 < 0.15 < float(last[heads.index("shipped, moved")])
    assert [line.split("|")[1].strip() for line in learning_curve(made).splitlines()[2:]] == ["4", "8", "16", "32"]


def swaying(sideways: float) -> FlowField:
    """The column, whose light in four frames also goes right, left, right, left at a speed, m/s."""
    still = column()
    voxels, emission = still.voxels, still.frames[0].emission
    velocity = [np.broadcast_to([sideways * (-1) ** f, 0, 0.5], voxels.center.shape) for f in range(4)]
    return field_of(voxels, velocity, [emission] * 4)


@pytest.mark.parametrize("sideways", [0.0, 0.25, 2.0])
def test_unsteadiness_of_a_column_that_sways(sideways):
    """Its mean is the rise; what is left is the sway."""
    assert unsteadiness(swaying(sideways), 1.0) == pytest.approx(sideways / np.hypot(sideways, 0.5), abs=1e-6)


def test_unsteadiness_twin():
    """The same, voxel by voxel, of motion and light without any order."""
    rng = np.random.default_rng(1)
    voxels = box_of_voxels((3, 2, 4), 0.1)
    velocity, emission = rng.normal(0.3, 1, (5, 24, 3)), rng.uniform(0, 1, (5, 24)) * (rng.random((5, 24)) > 0.3)
    left = whole = 0.0
    for v in range(24):
        if not emission[:, v].any():
            continue
        mean = sum(e * u for e, u in zip(emission[:, v], velocity[:, v], strict=True)) / sum(emission[:, v])
        for e, u in zip(emission[:, v], velocity[:, v], strict=True):
            left += e * sum((u - mean) ** 2)
            whole += e * sum(u**2)
    assert unsteadiness(field_of(voxels, velocity, emission), 1.0) == pytest.approx((left / whole) ** 0.5, rel=1e-9)


def test_a_window_forgets_what_is_past():
    """A column that goes right for six frames and left for six: in three frames it is steady, but about the turn."""
    still = column()
    voxels, emission = still.voxels, still.frames[0].emission
    turned = [np.broadcast_to([0.25 if f < 6 else -0.25, 0, 0.5], voxels.center.shape) for f in range(12)]
    field = field_of(voxels, turned, [emission] * 12)
    whole = 0.25**2 + 0.5**2
    assert unsteadiness(field, 1.0) == pytest.approx(0.25 / whole**0.5, rel=1e-6)
    about_the_turn = 2 * (1 - (1 / 3) ** 2) * 0.25**2 / (10 * whole)  # two of ten windows, mean a third of the speed
    assert unsteadiness(field, 2 * STEP_S) == pytest.approx(about_the_turn**0.5, rel=1e-6)


def test_two_frames_say_nothing_of_how_unsteady_a_motion_is():
    """Nor does a flame that is not seen to move; a steady one does."""
    field = swaying(0.25)
    assert unsteadiness(FlowField(field.voxels, field.frames[:2]), 1.0) == USUAL_UNSTEADY
    assert unsteadiness(field, 1.5 * STEP_S) == USUAL_UNSTEADY
    assert unsteadiness(column(seen=0.0), 1.0) == USUAL_UNSTEADY
    assert unsteadiness(column(), 1.0) == pytest.approx(0, abs=1e-6)


def test_kinds_of_the_dev_fires():
    specs = Path(fires.__file__).parent / "dev"
    named = {name: kind_of(read_json(specs / f"{name}.json")) for name in ("pool_small", "jet_slender", "ball_wood")}
    assert named == {"pool_small": "pool", "jet_slender": "jet", "ball_wood": "ball"}
    named = {name: kind_of(read_json(specs / f"{name}.json")) for name in ("wind_jet", "logs_paper", "foam_jet")}
    assert named == {"wind_jet": "wind", "logs_paper": "logs", "foam_jet": "openfoam"}


def test_a_fire_is_made_once_and_read_again(tmp_path, capsys):
    """The first of the factory, really baked: what is kept is sane, and the same command does not make it again."""
    path = tmp_path / "pace" / "fire_00000.json"
    pace_line.main([str(tmp_path), "--fires", "1"])
    fire = SeenFire.read(path)
    assert (fire.name, fire.source, fire.kind, fire.law) == ("fire_00000", "factory", "pool", "soot")
    clues, pace = fire.clues[0], fire.paces[0]
    assert 0.2 < pace / clues.buoyant < 3
    assert 0 < fire.unsteady[0] < 1
    before = path.read_bytes()
    pace_line.main([str(tmp_path), "--fires", "1"])
    assert path.read_bytes() == before
    assert capsys.readouterr().out.count("1 fires, 0 poor") == 2


def test_a_poor_fire_is_kept_as_such_and_left_away(tmp_path):
    def went_out():
        raise PoorFireError("it went out")

    path = tmp_path / "fire.json"
    traits = {"source": "factory", "kind": "pool", "law": "sheets"}
    assert "it went out" in keep(path, traits, went_out)
    assert SeenFire.read(path) is None
