"""OpenVDB files of one frame: velocity, flame, heat and density at their place in the world.

OpenVDB puts the value of index (i, j, k) at the transform of (i, j, k); ours sits at the cell's centre, index + 0.5.
The half cell goes into the transform, so that other programs have the grids where they are. Cycles differs: it renders
the value of index i in the middle between the transforms of i and i + 1 (measured: `tests/blender/test_grid_fire.py`).
Needs the ``openvdb`` module that Blender ships, or Debian's ``pyopenvdb``; never bpy.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np

from ...core.files import atomic_path


def library() -> ModuleType:
    """OpenVDB's Python module, whatever it is called. Raises ImportError: this Python has none."""
    try:
        import openvdb
    except ImportError:
        import pyopenvdb as openvdb  # its name until OpenVDB 10
    return openvdb


def write(path: Path, grids: dict[str, np.ndarray], index_to_world: np.ndarray, for_cycles: bool = False) -> None:
    """Write grids (X, Y, Z) or (X, Y, Z, 3) float32 under their names, atomically; zeros are not stored.

    Args:
        path: the .vdb file.
        grids: values at cell centres; "velocity" in m/s, world axes.
        index_to_world: (4, 4) continuous cell index (cell i spans [i, i + 1]) to world metres.
        for_cycles: to be rendered by Cycles, and read by nothing else.
    Raises:
        ValueError: a grid of another shape or with NaN.
    """
    openvdb = library()
    to_world = np.array(index_to_world, np.float64)
    if not for_cycles:
        to_world[:3, 3] += to_world[:3, :3] @ [0.5, 0.5, 0.5]
    stored = []
    for name, values in grids.items():
        values = np.ascontiguousarray(values, np.float32)
        if values.ndim not in (3, 4) or not np.isfinite(values).all():
            raise ValueError(f"{path}: grid '{name}' must be finite and (X, Y, Z) or (X, Y, Z, 3), got {values.shape}")
        grid = openvdb.FloatGrid() if values.ndim == 3 else openvdb.Vec3SGrid()
        grid.copyFromArray(values)
        grid.name = name
        grid.gridClass = openvdb.GridClass.FOG_VOLUME if values.ndim == 3 else openvdb.GridClass.UNKNOWN
        grid.transform = openvdb.createLinearTransform(to_world.T.tolist())  # OpenVDB multiplies row vectors
        stored.append(grid)
    with atomic_path(path) as draft:
        openvdb.write(str(draft), stored)
