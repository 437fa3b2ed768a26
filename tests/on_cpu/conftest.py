"""Stand-ins are tested on both sets of kernels."""

import pytest


@pytest.fixture(params=["drjit", "native"])
def kernels(request, monkeypatch) -> str:
    """Draw with these."""
    if request.param == "native":
        pytest.importorskip("numba")
    monkeypatch.setenv("GOF_RENDER_KERNELS", request.param)
    return request.param
