"""Stand-ins are tested on both sets of kernels."""

import pytest

from tests.sets_of_kernels import all_threads, draw_with

__all__ = ["all_threads"]  # of every test here


@pytest.fixture(params=["drjit", "native"])
def kernels(request, monkeypatch) -> str:
    """Draw with these."""
    draw_with(request.param, monkeypatch)
    return request.param
