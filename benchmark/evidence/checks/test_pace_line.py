"""Lines for the pace, on fires that obey one exactly, and a real fire of the factory."""

from pathlib import Path

import numpy as np
import pytest

from gof.core.files import read_json
from gof.reconstruct.pace import Pace, PaceClues
from gof_benchmark import fires
from gof_benchmark.training import pace_line
from gof_benchmark.training.factory.fire import PoorFireError
from gof_benchmark.training.pace_line import (
    LINES,
    SHIPPED,
    SeenFire,
    anew,
    errors,
    keep,
    kind_of,
    learning_curve,
    left_out,
    moved,
    rms,
)


def made_up(count: int, constant: float = 0.0) -> list[SeenFire]:
    """Fires of two kinds that obey the shipped line and a constant."""
    rng = np.random.default_rng(3)
    made = []
    for number in range(count):
        seen, law, carried, slenderness, texture = rng.uniform([0.1, 2, 0.2, 0.05, 0.3], [3, 8, 1, 0.3, 1.5])
        clues = PaceClues(seen, seen * law, seen * carried, slenderness, texture, 1.0, rng.uniform(0.08, 0.4))
        pace = seen * np.exp(SHIPPED.metric @ [1, *clues.logs] + constant)
        kind = ("pool", "jet")[number % 2]
        made.append(SeenFire(str(number), "dev", kind, "sheets", (clues,), (float(pace),)))
    return made


def off(line: Pace, asked: list[SeenFire]) -> float:
    return rms(errors(line, fire) for fire in asked)


def test_a_constant_is_all_that_moves_without_it():
    made = made_up(12, -0.5)
    assert moved(made).metric - SHIPPED.metric == pytest.approx([-0.5, 0, 0, 0, 0, 0])
    assert off(LINES["shipped"](made), made) == pytest.approx(0.5)
    assert off(anew(made_up(30, 0.2)), made_up(40, 0.2)[30:]) < 0.05


def test_without_unsteadiness_its_part_is_missed():
    """It is what the gas of every unsteady fire is faster by."""
    made = made_up(60)
    assert off(SHIPPED, made) < 1e-9
    missed = np.concatenate([errors(LINES["without unsteadiness"](made), fire) for fire in made])
    assert (missed <= 1e-9).all() and off(LINES["without unsteadiness"](made), made) > 0.15


def test_buoyancy_alone_is_what_buoyancy_makes_of_a_flame():
    fire = made_up(1)[0]
    assert errors(LINES["buoyancy"]([]), fire)[0] == pytest.approx(np.log(fire.clues[0].buoyant / fire.paces[0]))


def test_flames_side_by_side_are_joined_as_the_product_does():
    a, b = (fire.clues[0] for fire in made_up(2))
    two = SeenFire("two", "dev", "pool", "sheets", (a, b), (2.0, 3.0))
    expected = np.log(np.array(SHIPPED.side_by_side([a, b])) / [2.0, 3.0])
    np.testing.assert_allclose(errors(SHIPPED, two), expected, rtol=1e-9)


def test_tables_name_what_was_left_out_and_the_clue_lowers_its_column():
    made = made_up(40)
    rows = [line.split("|") for line in left_out(made, lambda fire: fire.kind).splitlines()]
    assert [row[1].strip() for row in rows[2:]] == ["jet", "pool", "all"]
    heads, last = [cell.strip() for cell in rows[0]], rows[-1]
    assert float(last[heads.index("shipped")]) < 0.05 < 0.15 < float(last[heads.index("without unsteadiness")])
    assert [line.split("|")[1].strip() for line in learning_curve(made).splitlines()[2:]] == ["4", "8", "16", "32"]


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
    assert 0 < clues.unsteady < 1
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
