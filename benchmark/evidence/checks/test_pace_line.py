"""Lines for the pace, on fires that obey one exactly, and a real fire of the factory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.core.files import read_json
from gof.reconstruct.pace import STIFFNESS, Pace, PaceClues
from gof_benchmark import fires
from gof_benchmark.training import pace_line
from gof_benchmark.training.factory.fire import PoorFireError
from gof_benchmark.training.pace_line import (
    Recipe,
    SeenFire,
    errors,
    fitted,
    keep,
    kind_of,
    learning_curve,
    left_out,
    rms,
)

WEIGHTS = np.array([0.6, 0.9, -0.4, 0.3, -0.5])


def made_up(count: int, of_fluct: float) -> list[SeenFire]:
    """Fires of two kinds whose pace follows WEIGHTS, and of_fluct times the fluctuation; `unknown` means nothing."""
    rng = np.random.default_rng(3)
    fires = []
    for number in range(count):
        seen, law, carried, slenderness, texture = rng.uniform([0.1, 2, 0.2, 0.05, 0.3], [3, 8, 1, 0.3, 1.5])
        fluct, unknown = rng.uniform([0.05, 0.0], [0.5, 0.2])
        clues = PaceClues(seen, seen * law, seen * carried, slenderness, texture, 1.0, fluct, unknown)
        pace = seen * np.exp(WEIGHTS @ [1, *clues.logs] + of_fluct * fluct)
        fires.append(SeenFire(str(number), "dev", ("pool", "jet")[number % 2], "sheets", (clues,), (float(pace),)))
    return fires


ANEW = Recipe(stiffness=STIFFNESS, near=False)
FAR = Pace(np.zeros(5), np.zeros(5))


@pytest.mark.parametrize(("more", "most"), [((), np.inf), (("seen_fluct",), 0.03), (("seen_fluct", "unknown"), 0.03)])
def test_a_line_finds_the_clue_that_counts(more, most):
    fires = made_up(60, of_fluct=2.0)
    line = fitted(fires[:40], replace(ANEW, more=more), FAR)
    off = rms(errors(line, fire) for fire in fires[40:])
    assert off < most
    assert more or off > 0.15, "without the clue its part is missed: 2 x a spread of 0.13"


def test_four_clues_anew_give_the_products_own_line():
    fires = made_up(30, of_fluct=0.5)
    own = Pace.fit([f.clues[0] for f in fires], [f.paces[0] for f in fires])
    line = fitted(fires, ANEW, FAR)
    for fire in fires[:5]:
        c = fire.clues[0]
        assert c.seen * np.exp(line(c)) == pytest.approx(own.of(c), rel=1e-9)


def test_a_line_held_near_the_shipped_one_moves_as_far_as_it_may():
    """The shipped line is the truth but for its constant: a stiff fit finds that alone, and nothing else moves."""
    fires = made_up(12, of_fluct=0.0)
    slow = Pace(WEIGHTS - np.array([0.5, 0, 0, 0, 0]), WEIGHTS)
    c = fires[0].clues[0]
    line = fitted(fires, Recipe(stiffness=1e6), slow)
    assert line(c) == pytest.approx(WEIGHTS @ [1, *c.logs], abs=1e-4)
    wrong = Pace(WEIGHTS + np.array([0, 1.0, 0, 0, 0]), WEIGHTS)
    held, free = (rms(errors(fitted(fires, Recipe(stiffness=s), wrong), f) for f in fires) for s in (1e6, 1e-6))
    assert free < 1e-3 < held


def test_flames_side_by_side_are_joined_as_the_product_does():
    a, b = (fire.clues[0] for fire in made_up(2, 0.0))
    pace = Pace(WEIGHTS, WEIGHTS)
    expected = np.log(np.array(pace.side_by_side([a, b])) / [2.0, 3.0])
    fire = SeenFire("two", "dev", "pool", "sheets", (a, b), (2.0, 3.0))
    np.testing.assert_allclose(errors(lambda c: float(WEIGHTS @ [1, *c.logs]), fire), expected, rtol=1e-9)


def test_tables_name_what_was_left_out_and_the_clue_lowers_its_column():
    fires = made_up(40, of_fluct=2.0)
    rows = [line.split("|") for line in left_out(fires, lambda fire: fire.kind, Pace(WEIGHTS, WEIGHTS)).splitlines()]
    assert [row[1].strip() for row in rows[2:]] == ["jet", "pool", "all"]
    heads, last = [cell.strip() for cell in rows[0]], rows[-1]
    assert float(last[heads.index("+ seen_fluct")]) < 0.6 * float(last[heads.index("near shipped")])
    curve = learning_curve(fires, Pace(WEIGHTS, WEIGHTS))
    assert [line.split("|")[1].strip() for line in curve.splitlines()[2:]] == ["6", "12", "24"]


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
    assert 0 < clues.seen_fluct < 1 and 0 <= clues.unknown < 0.5
    assert read_json(path)["scores"]["seen"]["cos_sim"] > 0.4
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
