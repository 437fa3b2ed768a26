"""Passive smoke, baked by the solver and moved once more by the velocity that we export of it.

A puff of smoke is baked in a small domain whose motion per frame is below a cell. The density of frame k, advected by
the exported velocity (read back from the store, in m/s and world axes) with Mantaflow's own scheme, must give the
density of frame k + 1; the same velocity scaled by a wrong factor, or read half a cell off, must do worse. The scheme
matters: an ordinary trilinear trace, or a reacting flame, fits best at factors of 0.5 to 0.85 with correct velocities.

Scheme: MacCormack with the "soft" limiter, Selle et al. 2008, "An Unconditionally Stable MacCormack Method", as in
Mantaflow's `advectSemiLagrange(order=2, clampMode=2)` (source/plugin/advection.cpp), which Blender calls for smoke.
Mantaflow traces cell-centred quantities with the centred velocity (`getCentered`), the mean of two faces. That is what
the store holds, so for smoke and heat nothing is lost by centring; only the solver's advection of the velocity itself
uses face values.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
FACTORS = (0.0, 0.5, 0.8, 0.9, 0.97, 1.0, 1.03, 1.1, 1.25, 2.0)
SHIFTS = (-0.5, -0.25, 0.0, 0.25, 0.5)
BORDER = 3  # cells next to the walls are left out: boundary conditions act there after advection
FRAMES = 12
FIRST = 7  # index of the first frame compared; the emission ends long before, at frame 3


@dataclass(frozen=True)
class Case:
    """One toy bake: the solver's setting and the pose of its domain.

    The emitter, and with it the flow on the grid, stays the same relative to the domain.
    """

    fps: float = 25.0
    time_scale: float = 0.5
    size_m: tuple[float, float, float] = (1.0, 1.0, 1.5)
    object_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)  # unapplied, part of size_m
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    resolution: int = 32


CASES = {
    "plain": Case(),
    "posed": Case(object_scale=(2.0, 4.0, 0.5), rotation_deg=(20.0, -10.0, 65.0), translation_m=(3.0, -2.0, 1.5)),
    "slow_50fps_2m": Case(fps=50.0, time_scale=0.8, size_m=(2.0, 2.0, 3.0)),
}
EMITTER = (0.55, 0.52, 0.25)  # relative to the domain box
EMITTER_RADIUS = 0.12  # of the box's first side


# ---------------------------------------------------------------- Mantaflow's advection in numpy


def interpolate(grid: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Trilinear value of a cell-centred grid (X, Y, Z) at positions (..., 3) in cells (centre of cell i: i + 0.5).

    Outside the outer centres the border value is taken.
    """
    size = np.array(grid.shape)
    coordinate = np.clip(position - 0.5, 0, size - 1)
    low = np.minimum(coordinate.astype(int), size - 2)
    fraction = coordinate - low
    value = np.zeros(position.shape[:-1])
    for corner in product((0, 1), repeat=3):
        weight = np.prod(np.where(corner, fraction, 1 - fraction), axis=-1)
        value += weight * grid[tuple(np.moveaxis(low + corner, -1, 0))]
    return value


def advect(density: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """One clamped MacCormack step.

    Args:
        density: (X, Y, Z), at least 3 cells along each axis.
        displacement: (X, Y, Z, 3) velocity times time step at the cell centres, cells.
    Returns:
        (X, Y, Z) float64; the outermost cell layer is 0, as in Mantaflow.
    """
    density = density.astype(np.float64)
    size = np.array(density.shape)
    cell = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), -1)
    inside = np.zeros(density.shape, bool)
    inside[1:-1, 1:-1, 1:-1] = True
    forward = np.where(inside, interpolate(density, cell + 0.5 - displacement), 0)
    backward = np.where(inside, interpolate(forward, cell + 0.5 + displacement), 0)
    corrected = forward + 0.5 * (density - backward)
    # Limiter: where the result leaves the range of the 8 cells around the source, keep the first-order value.
    low = np.clip(np.trunc(cell - displacement).astype(int), 0, size - 2)
    around = np.stack([density[tuple(np.moveaxis(low + c, -1, 0))] for c in product((0, 1), repeat=3)])
    overshoot = (corrected < around.min(0)) | (corrected > around.max(0))
    return np.where(inside, np.where(overshoot, forward, corrected), 0)


# ---------------------------------------------------------------- measurement


def displacement_in_cells(velocity: np.ndarray, index_to_world: np.ndarray, step_s: float) -> np.ndarray:
    """World velocity (..., 3) m/s to motion in one step along the grid axes, in cells."""
    return np.asarray(velocity, np.float64) @ np.linalg.inv(index_to_world[:3, :3]).T * step_s


def residual(density: np.ndarray, following: np.ndarray, displacement: np.ndarray) -> float:
    """Squared difference between the advected density and the following frame, summed over the inner cells."""
    inner = (slice(BORDER, -BORDER),) * 3
    return float(((advect(density, displacement) - following)[inner] ** 2).sum())


@dataclass(frozen=True)
class Figures:
    """What one bake says.

    Attributes:
        factors, shifts: {value: relative residual}, 1 = as bad as no motion at all, over all frames together.
        fitted_factor, fitted_per_frame: the scale of the velocity with the smallest residual.
        largest_motion_cells: of one frame.
        emitter_offset_cells: density centroid of frame 1 against the emitter's place in the world.
        cells_with_velocity: share of the inner cells.
        storage_max_abs_error, fastest_m_s: m/s.
    """

    factors: dict[float, float]
    shifts: dict[float, float]
    fitted_factor: float
    fitted_per_frame: list[float]
    largest_motion_cells: float
    emitter_offset_cells: list[float]
    cells_with_velocity: float
    storage_max_abs_error: float
    fastest_m_s: float


def measure(folder: Path) -> Figures:
    """Evaluate one finished bake (see `bake`)."""
    from scipy.optimize import minimize_scalar

    from gof.core.fields import VelocitySequence

    sequence = VelocitySequence.open(folder / "velocity.zarr")
    info = json.loads((folder / "bake.json").read_text())
    density = np.load(folder / "density.npy")
    to_world = sequence.index_to_world
    step_s = 1 / info["fps"]
    pairs = range(FIRST, len(sequence) - 1)
    moves = {k: displacement_in_cells(sequence.frame(k).velocity, to_world, step_s) for k in pairs}

    def error(moved: Callable[[int], np.ndarray], frames: Iterable[int] = pairs) -> float:
        return sum(residual(density[k], density[k + 1], moved(k)) for k in frames)

    still = error(lambda k: 0 * moves[k])

    def relative(moved: Callable[[int], np.ndarray]) -> float:
        return (error(moved) / still) ** 0.5

    def shifted(k: int, axis: int, cells: float) -> np.ndarray:
        offset = to_world[:3, axis] * cells
        field = sequence.frame(k)
        sampled = field.sample((field.cell_centers() + offset).reshape(-1, 3)).reshape(field.velocity.shape)
        return displacement_in_cells(sampled, to_world, step_s)

    def along_axes(cells: float) -> float:
        return float(np.mean([relative(lambda k, axis=axis: shifted(k, axis, cells)) for axis in range(3)]))

    def fit(frames: Iterable[int]) -> float:
        def loss(factor: float) -> float:
            return error(lambda k: factor * moves[k], frames)

        return float(minimize_scalar(loss, bounds=(0.7, 1.4), method="bounded", options={"xatol": 1e-3}).x)

    speed = np.linalg.norm(sequence.frame(len(sequence) - 1).velocity.astype(float), axis=-1)
    return Figures(
        factors={factor: relative(lambda k, factor=factor: factor * moves[k]) for factor in FACTORS},
        shifts={cells: along_axes(cells) for cells in SHIFTS},
        fitted_factor=fit(pairs),
        fitted_per_frame=[fit([k]) for k in pairs],
        largest_motion_cells=max(float(np.abs(m).max()) for m in moves.values()),
        emitter_offset_cells=(_centroid(density[0]) - _to_index(to_world, info["emitter_world"])).tolist(),
        cells_with_velocity=float((speed[1:-1, 1:-1, 1:-1] > 0).mean()),
        storage_max_abs_error=info["storage_max_abs_error"],
        fastest_m_s=float(speed.max()),
    )


def _centroid(density: np.ndarray) -> np.ndarray:
    """(3,) in cells."""
    index = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in density.shape), indexing="ij"), -1)
    return (density[..., None] * index).sum((0, 1, 2)) / density.sum()


def _to_index(index_to_world: np.ndarray, point: list[float]) -> np.ndarray:
    return np.linalg.solve(index_to_world, [*point, 1.0])[:3]


# ---------------------------------------------------------------- bake, in a process of its own


def bake(name: str, case_folder: str) -> None:
    """Bake one of `CASES` and export it: velocity.zarr, density.npy (T, X, Y, Z), bake.json. Needs bpy."""
    import bpy

    from gof_blender.scene import mantaflow, velocity

    case = CASES[name]
    folder = Path(case_folder)
    mantaflow.enable()
    domain, emitter = build_puff(case, folder / "cache")
    with bpy.context.temp_override(object=domain, active_object=domain, selected_objects=[domain]):
        bpy.ops.fluid.bake_all()
    frames = list(range(1, FRAMES + 1))
    attributes = velocity.export_velocity(domain, frames, case.fps, case.time_scale, folder / "velocity.zarr")
    density = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        density.append(velocity.read_density(domain))
    np.save(folder / "density.npy", np.stack(density))
    info = {
        "fps": case.fps,
        "emitter_world": list(emitter.matrix_world.translation),
        "storage_max_abs_error": attributes["storage_max_abs_error"],
    }
    (folder / "bake.json").write_text(json.dumps(info))
    mantaflow.leave()


def build_puff(case: Case, cache: Path):
    """An empty scene with the domain and a warm emitter that stops after three frames. Returns both objects."""
    import bpy
    from mathutils import Euler, Matrix

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.render.fps = round(case.fps)
    if abs(case.fps - scene.render.fps) > 1e-9:
        raise ValueError(f"fps {case.fps}: this toy takes whole frame rates")
    pose = Matrix.Translation(case.translation_m) @ Euler(np.radians(case.rotation_deg).tolist()).to_matrix().to_4x4()

    bpy.ops.mesh.primitive_cube_add(size=1)
    domain = bpy.context.object
    local_size = np.divide(case.size_m, case.object_scale)
    for vertex in domain.data.vertices:
        vertex.co = [float(a * b) for a, b in zip(vertex.co, local_size, strict=True)]
    domain.matrix_world = pose @ Matrix.Diagonal((*case.object_scale, 1.0))
    domain.modifiers.new("Fluid", "FLUID").fluid_type = "DOMAIN"
    settings = domain.modifiers["Fluid"].domain_settings
    settings.domain_type = "GAS"
    settings.resolution_max = case.resolution
    settings.time_scale = case.time_scale
    settings.use_adaptive_timesteps = False
    settings.use_adaptive_domain = False
    settings.alpha, settings.beta = 0.0, 1.0  # heat alone drives the flow, so the smoke is passive
    settings.cache_directory = str(cache)
    settings.cache_type = "ALL"
    settings.cache_data_format = "UNI"
    settings.cache_frame_start, settings.cache_frame_end = 1, FRAMES

    bpy.ops.mesh.primitive_uv_sphere_add(radius=EMITTER_RADIUS * case.size_m[0])
    emitter = bpy.context.object
    emitter.matrix_world = pose @ Matrix.Translation((np.array(EMITTER) - 0.5) * case.size_m)
    emitter.modifiers.new("Fluid", "FLUID").fluid_type = "FLOW"
    flow = emitter.modifiers["Fluid"].flow_settings
    flow.flow_type, flow.flow_behavior = "SMOKE", "INFLOW"
    flow.density, flow.temperature = 1.0, 1.0
    for frame, on in ((1, True), (3, True), (4, False)):
        flow.use_inflow = on
        flow.keyframe_insert("use_inflow", frame=frame)
    return domain, emitter


# ---------------------------------------------------------------- what tests call


def run_case(name: str, folder: Path) -> Path:
    """Bake a case in a child process, unless `folder` holds it already. Returns the folder of the case."""
    case_folder = folder / name
    if not (case_folder / "bake.json").is_file():
        case_folder.mkdir(parents=True, exist_ok=True)
        code = f"from tests.blender.smoke_transport import bake; bake({name!r}, {str(case_folder)!r})"
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        done = subprocess.run(  # Mantaflow leaves files where it runs
            [sys.executable, "-c", code], cwd=case_folder, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return case_folder
