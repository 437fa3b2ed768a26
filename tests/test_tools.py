"""Tools that compare: each is shown to fail, and to pass, on numbers by hand."""

import pytest

from tools import bench, type_errors

pytestmark = pytest.mark.checkout


def test_type_errors_may_only_fall():
    lines = ["gof/io/gltf.py:1: error: a  [x]", "gof/io/gltf.py:2: error: b  [x]"]
    assert type_errors.by_room(lines) == {"gof/io": 2}
    assert type_errors.complaints(lines, {"gof/io": 2, "gof/core": 5}) == []
    assert type_errors.complaints(lines, {"gof/io": 1})[-1].startswith("gof/io: 2 type errors, 1 are allowed")
    assert type_errors.complaints(lines, {}) != []


def test_a_strict_file_has_none():
    line = "gof/evaluate/scoring.py:3: error: c  [x]"
    assert type_errors.complaints([line], {"gof/evaluate": 9}) == [line]


def test_the_strict_files_are_there():
    found = [
        path for path in (type_errors.ROOT / "gof").rglob("*.py") if type_errors.STRICT.match(f"gof/{_inner(path)}")
    ]
    assert len(found) == 17


def _inner(path) -> str:
    return path.relative_to(type_errors.ROOT / "gof").as_posix()


def test_a_ratio_is_of_medians_and_absent_functions_are_named():
    ours = [{"a": 0.2, "b": 0.1}, {"a": 0.4, "b": 0.1}, {"a": 9.0, "b": 0.1}]
    theirs = [{"a": 0.2, "b": None}] * 3
    head, a, b = bench.table(ours, theirs, "0123456789abcdef").splitlines()
    assert "0123456789ab" in head and a.split() == ["a", "400.00", "ms", "200.00", "ms", "2.00"]
    assert b.split() == ["b", "100.00", "ms", "absent"]


def test_eight_functions_are_timed():
    assert len(bench.FUNCTIONS) == 8 and all(function.__doc__ for function in bench.FUNCTIONS)
