"""Gaussians on Fire: three videos of a flame to transient 3D Gaussians with real velocities.

Importing `gof` is cheap: heavy libraries (Dr.Jit, torch, OpenCV) are loaded by the module that uses them.
"""

import sys as _sys

__version__ = "0.2.0"


# The old places of the names that others rely on work for one version, and say so.
_MOVED = {
    f"gof.{name}": f"gof.core.{name}"
    for name in ("cameras", "errors", "fields", "gaussians", "harmonics", "ply", "results", "rotations", "trajectory")
} | {
    "gof.evaluate.gradients": "gof.evaluate.emission",
    "gof.evaluate.statistics": "gof.evaluate.intervals",
    "gof.evaluate.weighted": "gof.evaluate.intervals",
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
