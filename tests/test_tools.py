"""Tools that compare: each is shown to fail, and to pass, on numbers by hand."""

import pytest

from tools import bench

pytestmark = pytest.mark.checkout


def test_a_ratio_is_of_medians_and_absent_functions_are_named():
    ours = [{"a": 0.2, "b": 0.1}, {"a": 0.4, "b": 0.1}, {"a": 9.0, "b": 0.1}]
    theirs = [{"a": 0.2, "b": None}] * 3
    head, a, b = bench.table(ours, theirs, "0123456789abcdef").splitlines()
    assert "0123456789ab" in head and a.split() == ["a", "400.00", "ms", "200.00", "ms", "2.00"]
    assert b.split() == ["b", "100.00", "ms", "absent"]


def test_eight_functions_are_timed():
    assert len(bench.FUNCTIONS) == 8 and all(function.__doc__ for function in bench.FUNCTIONS)
