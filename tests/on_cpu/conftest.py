"""Stand-ins are tested on both sets of kernels."""

import pytest

from tests.sets_of_kernels import draw_with


@pytest.fixture(params=["drjit", "native"])
def kernels(request, monkeypatch) -> str:
    """Draw with these."""
    draw_with(request.param, monkeypatch)
    return request.param
