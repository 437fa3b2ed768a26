"""Make Blender's fluid solver usable from the ``bpy`` wheel, and leave such a process safely."""

from __future__ import annotations

import atexit
import ctypes
import importlib.abc
import importlib.machinery
import os
import shutil
import sys
from pathlib import Path

import bpy


class _MantaFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Initialises the ``manta`` module inside the loaded bpy library when the first bake imports it."""

    def __init__(self, library: Path):
        self._init = ctypes.PyDLL(str(library)).PyInit_manta_main
        self._init.restype = ctypes.py_object

    def find_spec(self, name, path=None, target=None):
        return importlib.machinery.ModuleSpec(name, self) if name == "manta" else None

    def create_module(self, spec):
        return self._init()

    def exec_module(self, module):
        pass


def enable() -> None:
    """Prepare Mantaflow; call once after ``import bpy`` and before a fluid domain is evaluated.

    Mantaflow copies base-class methods into its Python types when the first solver is set up. The wheel
    imports ``manta`` earlier, at ``import bpy``, so its types lack those methods and every bake fails. Forgetting
    that early module lets the first bake initialise it again, at the right moment. A Blender application
    registers ``manta`` differently and needs nothing; there, and on a second call, this does nothing.

    Raises RuntimeError if the loaded bpy library cannot be found.
    """
    if not getattr(bpy.app, "module", False) or any(isinstance(finder, _MantaFinder) for finder in sys.meta_path):
        return
    package = Path(bpy.__file__).resolve().parents[4]  # <package>/<version>/scripts/modules/bpy/__init__.py
    libraries = [package / f"__init__{suffix}" for suffix in (".so", ".pyd")]
    library = next((path for path in libraries if path.is_file()), None)
    if library is None:
        raise RuntimeError(f"no bpy library in {package}; reinstall it with: pip install --force-reinstall bpy")
    sys.modules.pop("manta", None)
    sys.meta_path.insert(0, _MantaFinder(library))
    atexit.register(_forget_fires)


def _forget_fires() -> None:
    """Let go of every solver while Python still runs: the wheel aborts where one outlives it (return code 134)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


def wait_for_keys(item: bpy.types.Object) -> None:
    """Let the solver take a step only after the keyed values of an object that it reads: a burner, a force field.

    Call once all values are keyed. Blender's graph orders the solver after such an object's place and shape, and not
    after its other keyed values (a field's strength, the offset of the fuel's texture): with those alone it is chance
    whether a step sees its own key or the one of the step before, and two bakes of one spec part there. One action is
    evaluated as a whole, so a key of the place, which need not change, brings the others into that order. It is of the
    delta, which is added to the location: that stays free, to be moved by hand.
    """
    item.keyframe_insert("delta_location", frame=1)


def leave(status: int = 0) -> None:
    """End this process at once, with its output flushed.

    Workers leave here, in the wheel and in a Blender application without a window: whatever a bake has left behind,
    Blender's own end cannot abort then and lose what was printed.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # Blender's own exit would have removed it
    os._exit(status)
