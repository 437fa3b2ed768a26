"""The doors between the rooms: every record is written and read alike by everybody who writes or reads it.

`tests/golden/SCHEMA.json` are files as the commands write them (`tests/test_demo.py` holds what a real run writes
against the same records). A field that is renamed on one side only, that nobody writes or that nobody reads, fails.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import json
import re
import types
import typing
from pathlib import Path

import pytest

from gof.core.records import from_json, to_json
from tools.import_graph import FOLDERS, ROOT, modules

GOLDEN = Path(__file__).parent / "golden"
SHIPPED = {
    "gof-sensors": ROOT / "gof/capture/sensors.json",
    "gof-led-board": ROOT / "gof/capture/gof_board.json",
    "gof-ring-board": ROOT / "gof/capture/rocsync.json",
    "gof-suite": ROOT / "benchmark/suite/gof_bench_2.json",
    "gof-suite-truth": ROOT / "benchmark/suite/truth.json",
}
ANY = "*"  # in a tree of fields: whatever the name


def records() -> dict[str, dict[str, type]]:
    """Schema -> part (gof, gof_benchmark, gof_blender) -> class, of every class with a SCHEMA of its own."""
    found: dict[str, dict[str, type]] = {}
    for name, path in modules().items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = isinstance(node, ast.ClassDef) and [
                item.value.value
                for item in node.body
                if isinstance(item, ast.AnnAssign) and item.target.id == "SCHEMA" and item.value is not None
            ]
            if named:
                kind = getattr(importlib.import_module(name), node.name)
                found.setdefault(named[0], {})[name.split(".")[0]] = kind
    return found


RECORDS = records()
LIBRARY = {schema: kinds.get("gof") or kinds.get("gof_benchmark") for schema, kinds in RECORDS.items()}
OURS = {schema: kind for schema, kind in LIBRARY.items() if kind}
ADDON = {schema: kinds["gof_blender"] for schema, kinds in RECORDS.items() if "gof_blender" in kinds}


def nested(hint) -> list[type]:
    """The dataclasses inside a type."""
    if dataclasses.is_dataclass(hint):
        return [hint]
    return [kind for inner in typing.get_args(hint) for kind in nested(inner)]


def golden(schema: str) -> Path:
    return SHIPPED.get(schema, GOLDEN / f"{schema}.json")


def tree(kind: type) -> dict:
    """Field, by its name in the file -> tree of its own fields, for a record and the records inside it."""
    hints = typing.get_type_hints(kind)
    return {f.name.removesuffix("_"): _below(hints[f.name]) for f in dataclasses.fields(kind)}


def _below(hint) -> dict:
    if typing.get_origin(hint) is dict and nested(hint):
        return {ANY: _below(typing.get_args(hint)[1])}
    return {name: below for inner in nested(hint) for name, below in tree(inner).items()}


def strange(data, kind: type, at: str = "$") -> list[str]:
    """Where the fields of a JSON object are not exactly those of a record, all the way down."""
    hints = typing.get_type_hints(kind)
    names = {f.name.removesuffix("_") for f in dataclasses.fields(kind)}
    hints = {name.removesuffix("_"): hint for name, hint in hints.items()}
    found = [f"{at}.{name}: nobody writes it" for name in names - data.keys()]
    found += [f"{at}.{name}: no field of {kind.__name__}" for name in data.keys() - names - {"schema", "version"}]
    for name in names & data.keys():
        found += _strange_value(data[name], hints[name], f"{at}.{name}")
    return found


def _strange_value(value, hint, at: str) -> list[str]:
    if dataclasses.is_dataclass(hint):
        return strange(value, hint, at)
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        kinds = [a for a in arguments if dataclasses.is_dataclass(a)]
        return strange(value, kinds[0], at) if kinds and isinstance(value, dict) else []
    if isinstance(value, list) and arguments:
        return [x for item in value for x in _strange_value(item, arguments[0], f"{at}[]")]
    if isinstance(value, dict) and len(arguments) == 2:
        return [x for item in value.values() for x in _strange_value(item, arguments[1], f"{at}{{}}")]
    return []


@pytest.mark.parametrize("schema", OURS)
def test_golden_file(schema):
    """What the commands have written is read, has the record's fields and no others, and is written the same again."""
    path = golden(schema)
    data = json.loads(path.read_text(encoding="utf-8"))
    record = from_json(OURS[schema], data, path)
    if schema not in SHIPPED:  # those are written by hand, with notes, and leave out what has a default
        assert not strange(data, OURS[schema])
        assert json.loads(json.dumps(to_json(record))) == data


@pytest.mark.parametrize("schema", sorted(OURS.keys() & ADDON.keys()))
def test_the_add_ons_record_is_the_librarys(schema):
    """The add-on may leave fields aside when it only reads, but has none of its own."""
    from gof_blender.core.records import read_record

    read_record(ADDON[schema], GOLDEN / f"{schema}.json")
    mine, theirs = tree(ADDON[schema]), tree(OURS[schema])
    assert ADDON[schema].VERSION == OURS[schema].VERSION
    assert not _beyond(mine, theirs)
    if hasattr(ADDON[schema], "write"):
        assert mine == theirs, "what the add-on writes has every field"


def _beyond(mine: dict, theirs: dict, at: str = "$") -> list[str]:
    if ANY in theirs:
        return [x for name, below in mine.items() for x in _beyond(below, theirs[ANY], f"{at}.{name}")]
    own = [f"{at}.{name}" for name in mine.keys() - theirs.keys()]
    return own + [x for name in mine.keys() & theirs.keys() for x in _beyond(mine[name], theirs[name], f"{at}.{name}")]


@pytest.fixture(scope="module")
def read() -> set[str]:
    return names_read()


@pytest.mark.parametrize("schema", RECORDS)
def test_every_field_is_read(schema, read):
    kind = OURS.get(schema) or ADDON[schema]
    unread = sorted(f"{kind.__name__}.{name}" for name in _all_names(tree(kind)) if not _is_read(name, read))
    assert not unread, f"nobody reads {unread}: neither code nor, by a page of docs, people"


def _all_names(fields: dict) -> set[str]:
    return {name for name in fields} | {n for inner in fields.values() for n in _all_names(inner)}


def _is_read(name: str, read: set[str]) -> bool:
    """Families of names (docs/formats.md, "Scores") count with the name they are made of."""
    family = re.fullmatch(r"skill_over_(\w+)|(\w+?)(?:_flame)?(?:_plate|_between)?(?:_std)?", name)
    return name in read or (family[1] or family[2]) in read


def names_read() -> set[str]:
    """Every name that code of ours takes from an object or looks up by a string, and what pages explain to people."""
    found: set[str] = {ANY}
    for path in modules().values():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                found.add(node.attr.removesuffix("_"))
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(node.value)
    for page in [
        *(ROOT / "docs").glob("*.md"),
        *(path for f in FOLDERS.values() for path in (ROOT / f).rglob("*.html")),
    ]:
        found |= set(re.findall(r"\w+", page.read_text(encoding="utf-8")))
    return found


def test_a_renamed_field_is_found():
    """The checks can fail: one field under another name, on one side only."""
    schema = "gof-dataset"
    data = json.loads((GOLDEN / f"{schema}.json").read_text(encoding="utf-8"))
    data["cameras"][0]["world_from_camera"] = data["cameras"][0].pop("world_to_camera")
    assert len(strange(data, OURS[schema])) == 2
    renamed = dataclasses.make_dataclass("Renamed", [("title", str), ("time_s", tuple[float, ...])])
    assert _beyond(tree(renamed), tree(OURS[schema])) == ["$.title"]


def test_every_eighth_frame_is_held_out():
    from gof.dataset import held_out

    assert held_out(21).test == (4, 12, 20)  # paper, "Results"
    for count in (1, 4, 5, 12, 13, 50):
        splits = held_out(count)
        assert sorted(splits.train + splits.test) == list(range(count)) and len(splits.test) == (count + 3) // 8
