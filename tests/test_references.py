"""The reference pages that the site makes from the code: every option, every field, each with a text."""

import dataclasses
import importlib
import json
import re
from pathlib import Path

import pytest

import gof
from gof.commands.cli import commands
from gof.commands.completion import leaves
from gof.commands.declared import config_of, options_of
from gof_blender.pure import effects
from gof_blender.pure.spec import SceneSpec
from tools import references, site

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.checkout


def rows(page: str, title: str, level: int) -> dict[str, list[str]]:
    """Cells of the tables under a heading, by the first word of their first cell."""
    (text,) = re.findall(rf"^{'#' * level} {re.escape(title)}\n(.*?)(?=^#{{1,{level}}} |\Z)", page, re.M | re.S)
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    cells = [[c.replace("\\|", "|") for c in re.split(r"(?<!\\) \| ", line.strip("| "))] for line in lines]
    return {re.split(r"[ `]", line[0].strip("`"))[0]: line for line in cells}


@pytest.fixture(scope="module")
def command_page() -> str:
    return references.of_commands()


@pytest.fixture(scope="module")
def spec_page() -> str:
    return references.of_spec()


@pytest.mark.parametrize("words", leaves())
def test_every_option_of_a_command_is_there_with_a_text(words, command_page):
    options = options_of(config_of(leaves()[words]))
    found = rows(command_page, f"gof {words}", 3)
    for option in options:
        assert option.text, f"gof {words} {option.name} has no text"
    assert {option.name.split()[0] for option in options} <= set(found)
    assert all(len(cells[1]) > 8 for cells in found.values())


def test_every_command_is_there(command_page):
    for name, command in commands().items():
        assert re.search(rf"^### gof {name}\b", command_page, re.M), name
        assert re.search(rf"^## {command.group.capitalize()}$", command_page, re.M)
    assert "--trajectory FILE" in command_page, "options of gof baseline, whose words are another program's"


def test_an_option_has_its_value_default_and_text(command_page):
    assert rows(command_page, "gof capture calibrate", 3)["--square-mm"] == [
        "`--square-mm`",
        "Side of a square, as measured on the print.",
        "`MM`",
        "`40`",
    ]
    assert rows(command_page, "gof generate", 3)["SCENE"][2:] == ["", "required"]
    assert rows(command_page, "gof capture sync", 3)["--clock"][2] == "`steady`, `free`"


def all_classes() -> dict[str, type]:
    """Every class of settings: heading of the page, class."""
    found = {title: kind for title, kind in sections().items()}
    return found | {name: effects.module(name).Settings for name in effects.names()}


def sections() -> dict[str, type]:
    by_name = {kind.__name__: kind for kind in references.classes_in(SceneSpec)}
    return {title: by_name[name] for title, name in references.SECTIONS.items()}


@pytest.mark.parametrize("title", all_classes())
def test_every_field_of_a_scene_is_there_with_a_text(title, spec_page):
    found = rows(spec_page, title, 2 if title in references.SECTIONS else 3)
    for field in dataclasses.fields(all_classes()[title]):
        assert len(found[field.name][1]) > 6, f"{title}.{field.name} has no text"


def test_a_key_of_a_scene_file_is_a_field_of_the_page(spec_page):
    """Of a whole one, as it is written; so nothing that a user finds in a file is missing."""
    data = SceneSpec.from_dict({"schema": "gof-scene", "version": 3, "name": "all"}).to_dict()
    for section, value in data.items():
        if isinstance(value, dict):
            assert set(value) <= set(rows(spec_page, section, 2)), section
    assert set(data) - {"schema", "version"} <= set(rows(spec_page, "A scene", 2))


def test_a_field_has_type_unit_range_and_default(spec_page):
    assert rows(spec_page, "cameras", 2)["arc_deg"][2:] == ["number", "°", "in [0, 360)", "`70`"]
    assert rows(spec_page, "domain", 2)["resolution"][4] == "between 8 and 2048"
    assert rows(spec_page, "domain", 2)["size"][2:] == [
        "3 numbers",
        "m",
        "in [0.001, 1000] m on every side",
        "`[0.8, 0.8, 1.6]`",
    ]
    assert rows(spec_page, "smoke", 3)["density"][3:5] == ["1/m", "in [0, 10000] per metre"]
    assert "`null`" in rows(spec_page, "A scene", 2)["blend_file"][2]


def test_the_example_of_the_page_is_a_scene():
    page = (ROOT / "docs/spec.md").read_text(encoding="utf-8")
    spec = SceneSpec.from_dict(json.loads(re.search(r"```json\n(.*?)```", page, re.S)[1]))
    assert spec.effect_names == ["vorticity", "wind"]


def test_a_mark_is_filled_and_links_to_the_notebook_are_plain_text():
    text = "see [what was tried](../notebook/motion.md#tried) and [scenes](scenes.md)\n"
    assert site.page_of_site(text) == "see what was tried and [scenes](scenes.md)\n"
    assert "| `--square-mm` | Side of a square" in site.page_of_site("<!-- generated: commands -->\n")
    stub = "# Title\n\n> Elsewhere: see x.\n\n<!-- generated: commands -->\n"
    assert "Elsewhere" not in site.page_of_site(stub) and "# Title" in site.page_of_site(stub)
    with pytest.raises(KeyError):
        references.filled("<!-- generated: nothing -->\n")


def test_no_page_of_the_notebook_is_staged(tmp_path):
    site.stage(tmp_path)
    assert (tmp_path / "README.md").is_file() and (tmp_path / "docs/commands.md").is_file()
    assert not (tmp_path / "notebook").exists()
    left = [path for path in tmp_path.rglob("*.md") if "](../notebook" in path.read_text(encoding="utf-8")]
    assert left == []


def test_the_python_page_has_every_name_of_the_front_door():
    page = (ROOT / "docs/reference.md").read_text(encoding="utf-8")
    shown = {place.rpartition(".")[2]: place for place in re.findall(r"^::: (\S+)$", page, re.MULTILINE)}
    assert len(gof.__all__) > 10 and set(gof.__all__) - shown.keys() == set()
    for name, place in shown.items():
        assert callable(getattr(importlib.import_module(place.rpartition(".")[0]), name)), place
