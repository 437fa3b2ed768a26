"""One ladder of presets: the same five names everywhere, and one table of what they mean, which is true."""

import re
from dataclasses import astuple
from pathlib import Path
from typing import get_args

import pytest

from gof.core.ladder import FORMER, LADDER
from gof.reconstruct.presets import PRESETS as EFFORT
from gof_benchmark.suite import SIZES, Size
from gof_benchmark.suite.made import size_of
from gof_blender.pure import presets

PAGE = Path(__file__).parents[1] / "docs/presets.md"


def rows() -> dict[str, list[str]]:
    """Cells of the table by the preset's name."""
    table = PAGE.read_text(encoding="utf-8").partition("\n## Presets")[2].partition("\n\n|")[2].partition("\n\n")[0]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    return {cells[0].strip("`"): cells[1:] for cells in lines[2:]}


def numbers(cell: str) -> list[int]:
    return [int(word.replace(" ", "")) for word in re.findall(r"\d[\d ]*", cell.partition("(")[0])]


def test_everything_that_has_presets_has_the_ladder():
    assert tuple(EFFORT) == LADDER and tuple(presets.PRESETS) == LADDER == tuple(rows())
    assert set(get_args(Size)) <= set(LADDER) and presets.NEW_NAMES == FORMER


@pytest.mark.parametrize("name", LADDER)
def test_the_table_says_what_a_preset_is(name):
    made, _, reconstructed, *_ = rows()[name]
    spec = presets.PRESETS[name]
    render = spec["render"]
    wanted = [spec["clip"]["frames"], spec["domain"]["resolution"], render["percentage"], render["samples"]]
    assert numbers(made) == wanted
    assert numbers(reconstructed) == list(astuple(EFFORT[name]))


def test_sizes_of_the_benchmark_are_folders_of_their_names(tmp_path):
    assert {size: size_of(tmp_path / size) for size in SIZES} == {size: size for size in SIZES}
    assert size_of(tmp_path / "else") is None
