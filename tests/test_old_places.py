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


def test_what_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("gof.nothing")
