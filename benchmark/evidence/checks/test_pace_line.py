"""Lines for the pace, on fires that obey one exactly, and a real fire of the factory."""

from pathlib import Path

import numpy as np
import pytest

from gof.core.files import read_json
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.pace import PaceClues
from gof_benchmark import fires
from gof_benchmark.training import pace_line
from gof_benchmark.training.factory.fire import PoorFireError
from gof_benchmark.training.pace_line import (
    LINES,
    TAUGHT,
    SeenFire,
    errors,
    keep,
    kind_of,
    learning_curve,
    left_out,
    moved,
    rms,
    with_new_clue,
)


def made_up(count: int, weights: np.ndarray) -> list[SeenFire]:
    """Fires of two kinds whose pace follows a line of all clues."""
    rng = np.random.default_rng(3)
    fires = []
    for number in range(count):
        seen, law, carried, slenderness, texture = rng.uniform([0.1, 2, 0.2, 0.05, 0.3], [3, 8, 1, 0.3, 1.5])
        clues = PaceClues(seen, seen * law, seen * carried, slenderness, texture, 1.0, rng.uniform(0.08, 0.25))
        pace = seen * np.exp(weights @ [1, *clues.logs])
        fires.append(SeenFire(str(number), "dev", ("pool", "jet")[number % 2], "sheets", (clues,), (float(pace),)))
    return fires


def test_the_new_clue_is_found_beside_what_was_taught():
    """The four old clues obey the taught line but for a factor; of the new one the fires' own weight comes back."""
    fires = made_up(60, TAUGHT.metric + [0.3, 0, 0, 0, 0, 0.8])
    pace = with_new_clue(fires[:40])
    np.testing.assert_allclose(pace.metric, TAUGHT.metric + [0.3, 0, 0, 0, 0, 0.8], atol=0.02)
    assert rms(errors(pace, fire) for fire in fires[40:]) < 0.02
    assert rms(errors(moved(fires[:40]), fire) for fire in fires[40:]) > 0.15, "without the clue its part is missed"
    assert pace.unitless[[1, 5]].tolist() == [0, 0], "without metres neither buoyancy nor the new clue counts"


def test_a_constant_is_all_that_moves_without_the_clue():
    fires = made_up(12, TAUGHT.metric - [0.5, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(moved(fires).metric, TAUGHT.metric - [0.5, 0, 0, 0, 0, 0], atol=1e-6)


def test_buoyancy_alone_is_what_buoyancy_makes_of_a_flame():
    fire = made_up(1, TAUGHT.metric)[0]
    assert LINES["buoyancy"]([]).of(fire.clues[0]) == pytest.approx(fire.clues[0].buoyant)


def test_tables_name_what_was_left_out_and_the_clue_lowers_its_column():
    fires = made_up(40, TAUGHT.metric + [0, 0, 0, 0, 0, 0.8])
    rows = [line.split("|") for line in left_out(fires, lambda fire: fire.kind).splitlines()]
    assert [row[1].strip() for row in rows[2:]] == ["jet", "pool", "all"]
    heads, last = [cell.strip() for cell in rows[0]], rows[-1]
    assert float(last[heads.index("with the new clue")]) < 0.05 < 0.15 < float(last[heads.index("moved")])
    curve = learning_curve(fires)
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
    assert 0 < clues.unsteady < 1
    before = path.read_bytes()
    weights = tmp_path / "prior.npz"
    pace_line.main([str(tmp_path), "--fires", "1", "--out", str(weights)])
    assert path.read_bytes() == before
    assert FlowPrior.load(weights).pace.of(clues) == pytest.approx(pace, rel=1e-3), "one flame says its factor"
    assert capsys.readouterr().out.count("1 fires, 0 poor") == 2


def test_a_poor_fire_is_kept_as_such_and_left_away(tmp_path):
    def went_out():
        raise PoorFireError("it went out")

    path = tmp_path / "fire.json"
    traits = {"source": "factory", "kind": "pool", "law": "sheets"}
    assert "it went out" in keep(path, traits, went_out)
    assert SeenFire.read(path) is None
