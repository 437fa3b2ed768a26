"""Ground-truth velocity: from Mantaflow's cache to cell-centred metres per second in world axes.

Units. Mantaflow advects in cells per solver time unit, and Blender runs 0.1 * 25/fps * time_scale units per frame, so
one second is 2.5 * time_scale units and the stored value u means 2.5 * time_scale * u cells per second, at any fps.
`index_to_world` then turns cells into metres and grid axes into world axes; velocity is mapped by its linear part, so
a moved, turned or scaled domain needs no special case. `tests/blender/test_velocity_truth.py` measures that this is
right.

Time. The cache of frame k holds the velocity that carries the density of frame k to frame k + 1. With solver substeps
it is the velocity of the last substep of frame k.

Place. Mantaflow stores each component on the lower face of its cell (MAC grid). The value at the cell centre is the
mean of the two faces; Mantaflow moves density and heat by exactly this mean. The last cell along an axis has no upper
face in the cache and takes its lower one; it lies in the solver's closed boundary layer.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..core.grid_writer import Block, GridWriter

SOLVER_UNITS_PER_SECOND = 2.5


def export_velocity(
    domain_object: bpy.types.Object,
    frames: list[int],
    fps: float,
    time_scale: float,
    out_path: str | Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict:
    """Write the velocity of baked frames as a zarr v3 store; frames of an interrupted export are not written again.

    Args:
        domain_object: the baked gas domain; it must not move during the frames.
        frames: Blender frame numbers, increasing; the first one is time 0 of the dataset clock.
        fps: frames per second, > 0.
        time_scale: the domain's time scale during the bake.
        out_path: the new folder, by custom `velocity.zarr`; a finished one with the same content is left alone.
        progress: called with (frames done, frames in all) after each frame.
    Returns:
        The attributes of the store (schema `gof-velocity` 1: units, index_to_world, voxel_size, time_s ...), whose
        values are float16; `storage_max_abs_error` is their error, m/s.
    Raises:
        ValueError: no gas domain, adaptive domain, other time scale, frame outside the bake, moving domain, a cache
            that was clipped to the smoke, or NaN in the cache.
        DataFormatError: `out_path` holds something else.
    """
    _require_exportable(domain_object, frames, fps, time_scale)
    _go_to(frames[0], domain_object)
    matrix = index_to_world(domain_object)
    linear = matrix[:3, :3]
    to_metres_per_second = SOLVER_UNITS_PER_SECOND * time_scale * linear
    store = GridWriter(
        out_path,
        tuple(evaluated(domain_object).domain_resolution),
        matrix,
        (np.array(frames) - frames[0]) / fps,
        float(np.cbrt(abs(np.linalg.det(linear)))),
        "float16",
    )
    for index, frame in enumerate(frames):
        if not store.has_frame(index):
            _go_to(frame, domain_object)
            if not np.allclose(index_to_world(domain_object), matrix, rtol=0, atol=1e-6):
                raise ValueError(
                    f"{domain_object.name} moves at frame {frame}; one store holds one fixed grid, "
                    "so keep the domain still"
                )
            raw = read_staggered(domain_object)

            def in_world(where: Block, raw: np.ndarray = raw) -> np.ndarray:
                return cell_centred(raw, where).astype(np.float64) @ to_metres_per_second.T

            store.write_frame(index, in_world)
        progress(index + 1, len(frames))
    return store.finish()


def _require_exportable(domain_object: bpy.types.Object, frames: list[int], fps: float, time_scale: float) -> None:
    settings = _domain_settings(domain_object)
    if settings.use_adaptive_domain:
        raise ValueError(
            f"{domain_object.name}: the adaptive domain changes the grid from frame to frame; "
            "switch it off and bake again"
        )
    if abs(settings.time_scale - time_scale) > 1e-6:
        raise ValueError(f"{domain_object.name} was set up with time scale {settings.time_scale}, not {time_scale}")
    if not fps > 0:
        raise ValueError(f"fps {fps}: must be > 0")
    if not frames:
        raise ValueError("no frames to export")


def index_to_world(domain_object: bpy.types.Object) -> np.ndarray:
    """Return (4, 4) float64: continuous cell index (cell i spans [i, i + 1]) to world metres, at the current frame.

    Blender reports the cell size per axis in object space, unapplied scale included, so cells of a domain whose sides
    are not whole multiples of the cell come out slightly oblong (half a cell over the whole side at most).
    """
    settings = evaluated(domain_object)
    local = np.diag([*settings.cell_size, 1.0])
    local[:3, 3] = settings.start_point
    return np.array(domain_object.matrix_world, float) @ local


def read_staggered(domain_object: bpy.types.Object) -> np.ndarray:
    """Return the cached MAC velocity of the current frame as (X, Y, Z, 3) float32, solver units, on lower faces.

    Raises:
        ValueError: nothing cached, or an OpenVDB cache that was clipped to the smoke.
    """
    settings = evaluated(domain_object)
    where = f"{domain_object.name}, frame {bpy.context.scene.frame_current}"
    if settings.cache_data_format == "OPENVDB" and read_density(domain_object).any():
        # Blender saves VDB velocity only in voxels that hold smoke; elsewhere it would read as still air.
        raise ValueError(
            f"{where}: an OpenVDB cache keeps velocity only where there is smoke; set the domain's "
            "cache format to 'UNI' and bake again"
        )
    return _read_grid(settings, "velocity_grid", 3, where)


def read_density(domain_object: bpy.types.Object) -> np.ndarray:
    """Return the cached smoke density of the current frame as (X, Y, Z) float32.

    Raises:
        ValueError: nothing cached.
    """
    where = f"{domain_object.name}, frame {bpy.context.scene.frame_current}"
    return _read_grid(evaluated(domain_object), "density_grid", 1, where)[..., 0]


def cell_centred(staggered: np.ndarray, where: Block = (slice(None),) * 3) -> np.ndarray:
    """MAC values (X, Y, Z, 3) on lower faces to cell centres of the block `where`: the mean of faces i and i + 1.

    The last cell along an axis keeps its lower face.
    """
    centred = np.empty_like(staggered[where])
    for axis in range(3):
        size = staggered.shape[axis]
        start, stop, _ = where[axis].indices(size)
        upper_face = list(where)
        upper_face[axis] = np.minimum(np.arange(start, stop) + 1, size - 1)
        centred[..., axis] = 0.5 * (staggered[where][..., axis] + staggered[tuple(upper_face)][..., axis])
    return centred


def _domain_settings(domain_object: bpy.types.Object) -> bpy.types.FluidDomainSettings:
    for modifier in domain_object.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            if modifier.domain_settings.domain_type != "GAS":
                raise ValueError(f"{domain_object.name}: the domain is of liquid type, expected gas")
            return modifier.domain_settings
    raise ValueError(f"{domain_object.name}: no fluid modifier of type domain; pass the smoke domain object")


def evaluated(domain_object: bpy.types.Object) -> bpy.types.FluidDomainSettings:
    """Return settings of a fluid domain that hold its grids at the current frame."""
    return _domain_settings(domain_object.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def _go_to(frame: int, domain_object: bpy.types.Object) -> None:
    settings = _domain_settings(domain_object)
    # Outside its cache Blender silently keeps the grids of the frame shown before.
    cached = Path(bpy.path.abspath(settings.cache_directory)) / "data"
    suffix = {"UNI": "uni", "OPENVDB": "vdb"}[settings.cache_data_format]
    file = cached / (f"vel_{frame:04d}.uni" if suffix == "uni" else f"fluid_data_{frame:04d}.vdb")
    if not file.is_file():
        raise ValueError(
            f"{domain_object.name}: frame {frame} is not baked ({file} is absent); bake frames "
            f"up to {frame} first, or export fewer"
        )
    bpy.context.scene.frame_set(frame)


def _read_grid(settings: bpy.types.FluidDomainSettings, name: str, components: int, where: str) -> np.ndarray:
    grid = getattr(settings, name)
    resolution = tuple(settings.domain_resolution)
    if len(grid) != int(np.prod(resolution)) * components or not len(grid):
        raise ValueError(f"{where}: '{name}' holds {len(grid)} values for a grid of {resolution}; bake the frame first")
    values = np.empty(len(grid), np.float32)
    grid.foreach_get(values)
    return values.reshape(*resolution[::-1], components).transpose(2, 1, 0, 3)  # Blender runs x fastest
