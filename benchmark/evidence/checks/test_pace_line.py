"""Lines for the pace, on fires that obey one exactly, and a real fire of the factory."""

import numpy as np
import pytest

from gof.core.files import read_json
from gof.reconstruct.pace import Pace, PaceClues
from gof_benchmark.training import pace_line
from gof_benchmark.training.pace_line import BurntFire, errors, fitted, learning_curve, left_out, rms

WEIGHTS = np.array([0.6, 0.9, -0.4, 0.3, -0.5])


def made_up(count: int, of_fluct: float) -> list[BurntFire]:
    """Fires of two kinds whose pace follows WEIGHTS, and of_fluct times the fluctuation; `unknown` means nothing."""
    rng = np.random.default_rng(3)
    fires = []
    for number in range(count):
        seen, law, carried, slenderness, texture = rng.uniform([0.1, 2, 0.2, 0.05, 0.3], [3, 8, 1, 0.3, 1.5])
        fluct, unknown = rng.uniform([0.05, 0.0], [0.5, 0.2])
        clues = PaceClues(seen, seen * law, seen * carried, slenderness, texture, 1.0, fluct, unknown)
        pace = seen * np.exp(WEIGHTS @ [1, *clues.logs] + of_fluct * fluct)
        fires.append(BurntFire(number, ("pool", "jet")[number % 2], "sheets", (clues,), (float(pace),)))
    return fires


@pytest.mark.parametrize(("more", "most"), [((), np.inf), (("seen_fluct",), 0.03), (("seen_fluct", "unknown"), 0.03)])
def test_a_line_finds_the_clue_that_counts(more, most):
    fires = made_up(60, of_fluct=2.0)
    line = fitted(fires[:40], more)
    off = rms(errors(line, fire) for fire in fires[40:])
    assert off < most
    assert more or off > 0.15, "without the clue its part is missed: 2 x a spread of 0.13"


def test_four_clues_give_the_products_own_line():
    fires = made_up(30, of_fluct=0.5)
    own = Pace.fit([f.clues[0] for f in fires], [f.paces[0] for f in fires])
    line = fitted(fires, ())
    for fire in fires[:5]:
        c = fire.clues[0]
        assert c.seen * np.exp(line(c)) == pytest.approx(own.of(c), rel=1e-9)


def test_flames_side_by_side_are_joined_as_the_product_does():
    a, b = (fire.clues[0] for fire in made_up(2, 0.0))
    pace = Pace(WEIGHTS, WEIGHTS)
    expected = np.log(np.array(pace.side_by_side([a, b])) / [2.0, 3.0])
    fire = BurntFire(0, "two", "sheets", (a, b), (2.0, 3.0))
    np.testing.assert_allclose(errors(lambda c: float(WEIGHTS @ [1, *c.logs]), fire), expected, rtol=1e-9)


def test_tables_name_what_was_left_out_and_the_clue_lowers_its_column():
    fires = made_up(40, of_fluct=2.0)
    rows = [line.split("|") for line in left_out(fires, lambda fire: fire.kind).splitlines()]
    assert [row[1].strip() for row in rows[2:]] == ["jet", "pool", "all"]
    heads, last = [cell.strip() for cell in rows[0]], rows[-1]
    assert float(last[heads.index("+ seen_fluct")]) < 0.5 * float(last[heads.index("four")])
    counts = [line.split("|")[1].strip() for line in learning_curve(fires).splitlines()[2:]]
    assert counts == ["10", "20"]


def test_a_fire_is_made_once_and_read_again(tmp_path, capsys):
    """The first of the factory: what it holds is sane, and the same command does not make it again."""
    path = tmp_path / "00000.json"
    pace_line.keep(0, path)
    fire = BurntFire.read(path)
    assert (fire.number, fire.kind, fire.law) == (0, "pool", "reaction")
    clues, pace = fire.clues[0], fire.paces[0]
    assert 0.2 < pace / clues.buoyant < 3
    assert 0 < clues.seen_fluct < 1 and 0 <= clues.unknown < 0.5
    assert read_json(path)["scores"]["seen"]["cos_sim"] > 0.4
    before = path.read_bytes()
    pace_line.main([str(tmp_path), "--fires", "1"])
    assert path.read_bytes() == before
    assert "1 fires" in capsys.readouterr().out


def test_a_poor_fire_is_left_away(tmp_path):
    path = tmp_path / "00000.json"
    path.write_text('{"number": 0, "kind": "pool", "law": "sheets", "poor": "it went out", "cpu_s": 1.0}')
    assert BurntFire.read(path) is None
