"""The Dr.Jit types of the active backend, and the few backend settings the kernels rely on.

`GOF_RENDER_BACKEND=cuda` selects Dr.Jit's CUDA types; the default is the LLVM backend (CPU).
"""

from __future__ import annotations

import ctypes
import os
from importlib import import_module
from pathlib import Path

import drjit as dr
import numpy as np

from gof.errors import GofError

BACKEND = os.environ.get("GOF_RENDER_BACKEND", "llvm")
if BACKEND not in ("llvm", "cuda"):
    raise GofError(f"GOF_RENDER_BACKEND is '{BACKEND}'; use 'llvm' or 'cuda'")
_types = import_module(f"drjit.{BACKEND}.ad")
Array2f, Array3f, Array4f, Bool = _types.Array2f, _types.Array3f, _types.Array4f, _types.Bool
Float, Int, UInt = _types.Float, _types.Int, _types.UInt


def _use_small_work_units(lanes: int) -> None:
    """Let the LLVM backend hand `lanes` lanes to a thread at a time (default 16384).

    One lane of the blend kernels is a 4x4 pixel block, so a 640x360 image has 14400 lanes, which Dr.Jit would run on one
    thread. There is no Python call for it; the C++ function is exported. Without it results are the same, only slower.
    """
    try:
        core = ctypes.CDLL(str(Path(next(iter(dr.__path__))) / "libdrjit-core.so"))
        core._Z23jit_llvm_set_block_sizej(ctypes.c_uint32(lanes))
    except (OSError, AttributeError):
        pass


if BACKEND == "llvm":
    _use_small_work_units(256)


def opaque(value: float) -> Float:
    """A scalar that the kernels read from memory, so that a new value does not compile a new kernel."""
    return dr.opaque(Float, float(value))


def floats(array) -> Float:
    """Any numpy array, flattened to a float32 array in Dr.Jit's own memory.

    Dr.Jit would share numpy's memory, which may be unaligned, and compiles the alignment into every kernel that reads it.
    """
    flat = np.ascontiguousarray(array, np.float32).reshape(-1)
    if BACKEND == "cuda" or flat.size == 0:
        return Float(flat)
    out = dr.empty(Float, flat.size)
    out.numpy()[:] = flat
    return out
