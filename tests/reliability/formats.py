"""Everything this software reads from outside, by name: small good samples, and their public readers."""

from __future__ import annotations

from tests.reliability import datasets, names, results, runs
from tests.reliability.format import Format


def formats() -> dict[str, Format]:
    """All of them."""
    return {**results.formats(), **datasets.formats(), **names.formats(), **runs.formats()}
