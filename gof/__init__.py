"""Gaussians on Fire: a flame from videos as moving 3D Gaussians with velocities in m/s.

The front door; every name is loaded when it is first used, so that importing `gof` is cheap:

    dataset = gof.open_dataset("sample/fire")
    gaussians = gof.read_result("sample/result").gaussians
    scores = gof.evaluate("sample/result", dataset)
    reconstruction = gof.reconstruct(dataset, "out", preset="preview")
    picture = gof.render.rasterize(...)

`docs/examples` has a program for each. `gof.evaluate` and `gof.reconstruct` are packages that can be called.
"""

import sys as _sys
from importlib import import_module as _import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for editors and type checkers; tests/test_front_door.py holds it to the table below
    from gof import render as render
    from gof.core.cameras import Camera as Camera
    from gof.core.errors import GofError as GofError
    from gof.core.gaussians import TransientGaussians as TransientGaussians
    from gof.core.motion import Motion as Motion
    from gof.core.motion import State as State
    from gof.dataset import Dataset as Dataset
    from gof.dataset import open_dataset as open_dataset
    from gof.evaluate import evaluate as evaluate
    from gof.io.importers import ImportOptions as ImportOptions
    from gof.io.importers import read_result as read_result
    from gof.reconstruct import reconstruct as reconstruct
    from gof.sample import unpack_sample as unpack_sample

__version__ = "0.3.0"

_DOOR = {
    "Camera": "gof.core.cameras",
    "Dataset": "gof.dataset",
    "GofError": "gof.core.errors",
    "ImportOptions": "gof.io.importers",
    "Motion": "gof.core.motion",
    "State": "gof.core.motion",
    "TransientGaussians": "gof.core.gaussians",
    "open_dataset": "gof.dataset",
    "read_result": "gof.io.importers",
    "unpack_sample": "gof.sample",
}
_CALLED = ("evaluate", "reconstruct")  # packages with a function of their own name
__all__ = [*sorted(_DOOR), *_CALLED, "render"]


def __getattr__(name: str):
    if name in _DOOR:
        return getattr(_import_module(_DOOR[name]), name)
    if name in (*_CALLED, "render"):
        return _import_module(f"gof.{name}")
    raise AttributeError(f"module 'gof' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


# The old places of the names that others rely on work for one version, and say so.
_MOVED = {
    f"gof.{name}": f"gof.core.{name}"
    for name in ("cameras", "errors", "fields", "gaussians", "harmonics", "ply", "results", "rotations", "trajectory")
} | {
    "gof.evaluate.controls": "gof.evaluate.trivial_baselines",
    "gof.evaluate.gradients": "gof.evaluate.eve",
    "gof.evaluate.perceptual": "gof.evaluate.image",
    "gof.evaluate.published": "gof.evaluate.authors_figures",
    "gof.evaluate.statistics": "gof.evaluate.intervals",
    "gof.evaluate.weighted": "gof.evaluate.intervals",
    "gof.io.importers.authors": "gof.io.importers.paper_code",
}


class _OldPlace:
    """Finder and loader of modules that moved."""

    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name not in _MOVED:
            return None
        from importlib.machinery import ModuleSpec

        return ModuleSpec(name, cls)

    @staticmethod
    def create_module(spec):
        import importlib
        import warnings

        new = _MOVED[spec.name]
        warnings.warn(f"{spec.name} is now {new}; the old name goes with the next version", DeprecationWarning, 2)
        module = importlib.import_module(new)
        spec.loader_state = module.__spec__  # the import system puts the old one in its place
        return module

    @staticmethod
    def exec_module(module):
        module.__spec__ = module.__spec__.loader_state


_sys.meta_path.append(_OldPlace)
