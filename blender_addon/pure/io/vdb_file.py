"""OpenVDB files of one frame: velocity, flame, heat and density at their place in the world.

OpenVDB puts the value of index (i, j, k) at the transform of (i, j, k); ours sits at the cell's centre, index + 0.5.
The half cell goes into the transform, so that Blender and Houdini show the grids where they are. Needs the ``openvdb``
module that Blender ships, never bpy.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .files import atomic_path


def write(path: Path, grids: dict[str, np.ndarray], index_to_world: np.ndarray) -> None:
    """Write grids (X, Y, Z) or (X, Y, Z, 3) float32 under their names, atomically; zeros are not stored.

    Args:
        path: the .vdb file.
        grids: values at cell centres; "velocity" in m/s, world axes.
        index_to_world: (4, 4) continuous cell index (cell i spans [i, i + 1]) to world metres.
    Raises:
        ValueError: a grid of another shape or with NaN.
    """
    import openvdb

    centre_to_world = np.array(index_to_world, np.float64)
    centre_to_world[:3, 3] += centre_to_world[:3, :3] @ [0.5, 0.5, 0.5]
    stored = []
    for name, values in grids.items():
        values = np.ascontiguousarray(values, np.float32)
        if values.ndim not in (3, 4) or not np.isfinite(values).all():
            raise ValueError(f"{path}: grid '{name}' must be finite and (X, Y, Z) or (X, Y, Z, 3), got {values.shape}")
        grid = openvdb.FloatGrid() if values.ndim == 3 else openvdb.Vec3SGrid()
        grid.copyFromArray(values)
        grid.name = name
        grid.gridClass = openvdb.GridClass.FOG_VOLUME if values.ndim == 3 else openvdb.GridClass.UNKNOWN
        grid.transform = openvdb.createLinearTransform(centre_to_world.T.tolist())  # OpenVDB multiplies row vectors
        stored.append(grid)
    with atomic_path(path) as draft:
        openvdb.write(str(draft), stored)
