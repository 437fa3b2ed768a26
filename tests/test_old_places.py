"""Modules that moved are found at their old places for one version."""

import importlib
import sys

import pytest


@pytest.mark.parametrize("name, thing", [("gaussians", "TransientGaussians"), ("fields", "VelocityField")])
def test_an_old_place_is_the_new_one_and_says_so(name, thing):
    new = importlib.import_module(f"gof.core.{name}")
    sys.modules.pop(f"gof.{name}", None)
    with pytest.warns(DeprecationWarning, match=rf"gof\.{name} is now gof\.core\.{name}"):
        old = importlib.import_module(f"gof.{name}")
    assert getattr(old, thing) is getattr(new, thing)
    assert new.__spec__.name == new.__name__ == f"gof.core.{name}"


@pytest.mark.parametrize(
    "old, thing", [("gradients", "score_gradients"), ("statistics", "over_frames"), ("weighted", "weighted_quantile")]
)
def test_what_was_folded_is_found_by_its_old_name(old, thing):
    with pytest.warns(DeprecationWarning, match=rf"gof\.evaluate\.{old} is now gof\.evaluate\."):
        module = importlib.import_module(f"gof.evaluate.{old}")
    assert callable(getattr(module, thing))


def test_what_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("gof.nothing")
