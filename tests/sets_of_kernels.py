"""Tests that run with both sets of kernels choose one here."""

import pytest


def draw_with(name: str, monkeypatch) -> None:
    """Draw with these kernels, or skip where they cannot run."""
    if name == "native":
        pytest.importorskip("numba")
        from gof.render.backend import BACKEND

        if BACKEND == "cuda":
            pytest.skip("native kernels are for CPUs")
    monkeypatch.setenv("GOF_RENDER_KERNELS", name)
