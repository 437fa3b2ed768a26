"""OpenFOAM's fields on our grids: its binary files, its one-block mesh, and the uniform grid that is handed over."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path
from gof.core.fire import FireDescription, Hearth
from gof.core.records import to_json
from gof_benchmark.solvers.grids import FireFrame, FireHistory, write_fire
from gof_benchmark.solvers.openfoam.case import edges, probe_points
from gof_benchmark.solvers.openfoam.chemistry import Hydrocarbon
from gof_benchmark.solvers.openfoam.foam_fire import FoamFire


def read_internal(path: Path, cells: int) -> np.ndarray:
    """Return the values at the cells of a volScalarField or volVectorField, binary (8-byte floats) or ascii.

    Args:
        cells: how many the mesh has.
    Returns:
        (cells,) or (cells, 3) float64, in OpenFOAM's order of cells.
    Raises:
        DataFormatError: absent, another kind of file, cut off, or of another mesh.
    """
    try:
        data = path.read_bytes()
    except OSError as e:
        raise DataFormatError(f"{path}: cannot be read ({e.strerror})") from e
    kind = re.search(rb"class\s+vol(Scalar|Vector)Field\s*;", data[:2000])
    start = re.search(rb"\binternalField\s+", data[:4000])
    if not kind or not start:
        raise DataFormatError(
            f"{path}: not a field of OpenFOAM (volScalarField or volVectorField with an internalField)"
        )
    width = 1 if kind.group(1) == b"Scalar" else 3
    if uniform := re.compile(rb"uniform\s+\(?([^;)]*)\)?\s*;").match(data, start.end()):
        value = _numbers(uniform.group(1), width, path)
        return np.broadcast_to(value if width == 3 else value[0], (cells, 3) if width == 3 else (cells,)).copy()
    listed = re.compile(rb"nonuniform\s+List<(?:scalar|vector)>\s*(\d+)\s*\(").match(data, start.end())
    if not listed or int(listed.group(1)) != cells:
        raise DataFormatError(
            f"{path}: expected a list of {cells} values, one a cell of the mesh; is it of another case?"
        )
    if re.search(rb"format\s+binary", data[:2000]):
        values = _binary(data, listed.end(), cells * width, path)
    else:
        text = data[listed.end() : data.find(b";", listed.end())]
        values = _numbers(re.sub(rb"[()]", b" ", text), cells * width, path)
    if not np.isfinite(values).all():
        raise DataFormatError(f"{path}: holds NaN or Inf; did the run diverge?")
    return values.reshape(cells, 3) if width == 3 else values


def _numbers(text: bytes, count: int, path: Path) -> np.ndarray:
    """Return (count,) finite numbers of text. Raises DataFormatError."""
    try:
        values = np.array(text.split(), float)
    except ValueError as e:
        raise DataFormatError(f"{path}: holds no numbers ({e}); the file is damaged") from e
    if len(values) != count or not np.isfinite(values).all():
        raise DataFormatError(f"{path}: {len(values)} numbers, expected {count} finite ones; is the file cut off?")
    return values


def _binary(data: bytes, start: int, count: int, path: Path) -> np.ndarray:
    architecture = re.search(rb'arch\s+"([^"]*)"', data[:2000])
    if architecture and b"scalar=64" not in architecture.group(1):
        raise DataFormatError(f"{path}: {architecture.group(1).decode()}; only 8-byte floats are read")
    order = ">" if architecture and architecture.group(1).startswith(b"MSB") else "<"
    if len(data) < start + 8 * count:
        raise DataFormatError(f"{path}: cut off: {len(data) - start} bytes of values, expected {8 * count}")
    return np.frombuffer(data, order + "f8", count, start).astype(float)


def add_to_internal(path: Path, change: np.ndarray) -> None:
    """Add to the values at the cells of a binary field, in place of its file; (cells, 3) or (cells,), OpenFOAM's order.

    Raises:
        DataFormatError: as `read_internal`, or the field is not a binary list.
    """
    values = read_internal(path, len(change)) + change
    data = path.read_bytes()
    start = re.search(rb"internalField\s+nonuniform\s+List<(?:scalar|vector)>\s*\d+\s*\(", data[:4000])
    if not start or not re.search(rb"format\s+binary", data[:2000]):
        raise DataFormatError(f"{path}: not a binary list of values")
    with atomic_path(path) as temporary:
        temporary.write_bytes(
            data[: start.end()] + values.astype("<f8").tobytes() + data[start.end() + 8 * values.size :]
        )


def on_mesh(values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Return cells in OpenFOAM's order (x fastest) as (X, Y, Z) or (X, Y, Z, 3)."""
    return np.moveaxis(values.reshape(*shape[::-1], *values.shape[1:]), (0, 1, 2), (2, 1, 0))


class Resampler:
    """Tri-linear interpolation from the centres of a rectangular mesh to those of a uniform grid.

    Args:
        edges: per axis the positions of the cells' faces, m.
        low, high: corners of the uniform grid, m; its cubes of `voxel` m start at `low` and cover `high`.
    """

    def __init__(self, edges: list[np.ndarray], low, high, voxel: float):
        self._centers = [(e[1:] + e[:-1]) / 2 for e in edges]
        self.shape = tuple(max(1, round(float(b - a) / voxel)) for a, b in zip(low, high, strict=True))
        self.index_to_world = np.diag([voxel, voxel, voxel, 1.0])
        self.index_to_world[:3, 3] = low
        points = [a + voxel * (np.arange(n) + 0.5) for a, n in zip(low, self.shape, strict=True)]
        # At the floor half a cell lies below the first centre: there the first value holds.
        inside = [np.clip(p, c[0], c[-1]) for p, c in zip(points, self._centers, strict=True)]
        self._points = np.stack(np.meshgrid(*inside, indexing="ij"), -1)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Turn (X, Y, Z, ...) of the mesh into (x, y, z, ...) of the grid."""
        return RegularGridInterpolator(self._centers, values)(self._points)


def grids_of(fire: FoamFire, out: Path, solver: str, cpu_s: dict[str, float]) -> None:
    """Write `<out>/grids` from the clip in `<out>/fine` and the records of both meshes.

    Raises:
        DataFormatError: frames are missing or do not fit the mesh.
    """
    fine = out / "fine"
    mesh = edges(fire, "fine")
    shape = fire.cells("fine")
    voxel = fire.voxel_m or fire.cell_m[0]
    resample = Resampler(mesh, fire.core_low_m, fire.core_high_m, voxel)
    gas = fire.gas

    def frame(number: int) -> FireFrame:
        folder = frame_folder(fire, fine, number)

        def field(name: str) -> np.ndarray:
            return resample(on_mesh(read_internal(folder / name, int(np.prod(shape))), shape))

        temperature, fuel = field("T"), field(gas.species)
        mixture = gas.mixture_fraction(fuel, field("CO2"))
        return FireFrame(
            velocity=field("U"),
            emission=luminous_emission(temperature, mixture, gas, fire.emission),
            temperature=temperature,
            heat_release=field("Qdot"),
            fuel=fuel,
        )

    description = FireDescription(
        name=fire.name,
        solver=solver,
        time_s=tuple(round(k / fire.frame_rate_hz, 9) for k in range(fire.frames)),
        emission_law=LAWS[fire.emission],
        fuel=fire.fuel,
        hearths=tuple(Hearth(b.heat_release_kw, b.diameter_m, (*b.center_m, 0.0), b.speed(gas)) for b in fire.burners),
        wind_m_s=fire.wind_m_s,
        seed=fire.seed,
        parameters=to_json(fire),
        cpu_s=cpu_s,
    )
    write_fire(out / "grids", description, resample.index_to_world, frame, history_of(fire, out))


def frame_folder(fire: FoamFire, case: Path, number: int) -> Path:
    """Time folder of a frame of the clip. Raises DataFormatError when the solver has not written it."""
    wanted = fire.start_s + number / fire.frame_rate_hz
    for folder in case.iterdir():
        if folder.is_dir() and re.fullmatch(r"\d+(\.\d+)?", folder.name) and abs(float(folder.name) - wanted) < 2e-6:
            return folder
    raise DataFormatError(f"{case}: no time {wanted:g} s (frame {number}); bake on with the same command")


def history_of(fire: FoamFire, out: Path) -> FireHistory:
    """Return the record of every second step on the fine mesh, from a third of its settling on: before, the
    flame is what the mapping left of it.

    Raises:
        DataFormatError: the solver wrote no tables.
    """
    speeds = _table(out / "fine", "risePoints/*/U")
    heat = _table(out / "fine", "heatRelease/*/volFieldValue.dat")
    times = [t for t in sorted(speeds) if t >= fire.warm_up_s + fire.settle_s / 3]
    if not times or not heat:
        raise DataFormatError(f"{out}: no postProcessing tables of the solver; bake on with the same command")
    heat_times = sorted(heat)
    # The two tables are written at the same steps, but their times are rounded differently.
    watts = np.interp(times, heat_times, [heat[t][0] for t in heat_times])
    return FireHistory(
        time_s=tuple(t - fire.start_s for t in times),
        heat_release_kw=tuple((watts / 1e3).tolist()),
        probe_position_m=tuple(probe_points(fire)),
        rise_m_s=tuple(tuple(speeds[t][2::3]) for t in times),
    )


def _table(case: Path, pattern: str) -> dict[float, list[float]]:
    """Return rows of OpenFOAM's tables by time; where a killed run's rows overlap with the next one's, the later ones
    hold."""
    rows = {}
    for file in sorted(case.glob(f"postProcessing/{pattern}"), key=lambda f: float(f.parent.name)):
        for line in file.read_text(errors="replace").splitlines(keepends=True):
            numbers = line.replace("(", " ").replace(")", " ").split()
            if numbers and not line.startswith("#") and line.endswith("\n"):  # a kill may cut the last line off
                rows[float(numbers[0])] = [float(x) for x in numbers[1:]]
    return rows


# ----------------------------------------------------------------
# The light of a solved flame: glowing soot, as three wavelengths see it.
#
# A diffusion flame's yellow light is thermal radiation of soot. Soot forms where there is more fuel than its oxygen can
# burn and burns out on the lean side, so its amount is taken as a smooth step of the mixture fraction about the
# stoichiometric one. Its particles are far smaller than light's waves, hence absorb as 6 pi E(m) f_v / wavelength
# (Rayleigh; E(m) = 0.26, Modest, *Radiative Heat Transfer*, ch. 12) and emit that share of Planck's radiance
# (Kirchhoff). The volume fraction f_v of soot is taken as one part in a million where it is richest: the one factor
# that is not known.
#
# The meaning of "T" is the question. A large-eddy simulation's temperature is a mean over cells of a centimetre, in
# which the hot sheet, a millimetre thick, is mixed with cold gas. Two laws:
#
# `planck`      the mean temperature itself. Exact for a resolved flame; here it lights the few hottest cells only.
# `polynomial`  the hot sheet's share of the cell, as the square of (T - 900 K) / 900 K, times the radiance of soot at
#              1800 K, in the colour of T. The square is a choice that no measurement fixes.

WAVELENGTH_M = np.array([610e-9, 550e-9, 465e-9])  # R, G, B
C1, C2 = 1.191042972e-16, 1.438776877e-2  # W m2/sr, m K (CODATA 2018)
SOOT_PPM, SOOT_ABSORPTION = 1.0, 0.26
DARK_K, SHEET_K = 900.0, 1800.0

LAWS = {
    "polynomial": "soot share x ((T - 900 K) / 900 K)^2 x Planck(1800 K) in the colour of T, 610, 550, 465 nm; 1 ppm",
    "planck": "soot share x Planck(T) at 610, 550, 465 nm; 1 ppm",
}


def planck(temperature_k: np.ndarray) -> np.ndarray:
    """Convert (...) K to (..., 3) W m^-2 sr^-1 nm^-1 at the three wavelengths; below 300 K as at 300 K (nothing)."""
    t = np.maximum(temperature_k, 300.0)[..., None]
    return 1e-9 * C1 / WAVELENGTH_M**5 / np.expm1(C2 / (WAVELENGTH_M * t))


def soot_share(mixture_fraction: np.ndarray, fuel: Hydrocarbon) -> np.ndarray:
    """0 (leaner than half of stoichiometric) to 1 (richer than one and a half times)."""
    s = np.clip(mixture_fraction / fuel.stoichiometric_mixture_fraction - 0.5, 0, 1)
    return s * s * (3 - 2 * s)


def luminous_emission(
    temperature_k: np.ndarray,
    mixture_fraction: np.ndarray,
    fuel: Hydrocarbon,
    law: Literal["polynomial", "planck"] = "polynomial",
) -> np.ndarray:
    """Return radiance per metre of path.

    Args:
        temperature_k, mixture_fraction: (...) of the gas.
    Returns:
        (..., 3) W m^-3 sr^-1 nm^-1, at least 0; grows with temperature, 0 where there is no fuel.
    """
    absorption = 6 * np.pi * SOOT_ABSORPTION * SOOT_PPM * 1e-6 / WAVELENGTH_M  # 1/m
    radiance = planck(temperature_k)
    if law == "polynomial":
        share = (np.maximum(temperature_k - DARK_K, 0) / (SHEET_K - DARK_K)) ** 2
        colour = radiance / np.maximum(radiance[..., :1], 1e-300)
        radiance = share[..., None] * colour * planck(np.array(SHEET_K))[0]
    return soot_share(mixture_fraction, fuel)[..., None] * absorption * radiance
