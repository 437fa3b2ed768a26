"""Reader of reconstructions, with numpy only.

- `result.npz` (schema gof-linear) and `result.ply` of this project, with the datum that their places and times are
  measured from, where they name one;
- FTGS-PLY version 1 (FreeTimeGS): time runs from 0 to 1 over the clip;
- a 3DGS PLY (a still), or numbered ones (one per frame; what deformation methods export).

PLY files hold 3DGS attributes raw (scale_* natural logs, opacity a logit, f_dc spherical-harmonics coefficients, rot
wxyz); a cloud holds activated values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import FileFormatError, ftgs_file, npz_file, ply_sequence
from .cloud import SH_C0, GaussianCloud, checked, refuse_unread, splats
from .ply_file import PlyVertices, columns

NPZ_SCHEMA, NPZ_MEASURED = "gof-linear/1", "gof-linear/2"  # around zero; from a datum
PLY_DATUM = "datum x y z t:"
NPZ_NAMES = {
    "position": "x0",
    "velocity": "v",
    "t_mu": "t_mu_s",
    "t_sigma": "t_sigma_s",
    "scale": "scale",
    "rotation": "rotation",
    "opacity": "alpha",
    "dynamic": "dynamic",
}
UNSURE = "v_sd"  # only in files that say how sure the velocity is
GAS = "v_gas", ("gas_vx", "gas_vy", "gas_vz")  # npz, PLY: only where the gas has another velocity than its light
SPLATS = {
    ".splat": "a file of antimatter15's web viewer",
    ".spz": "a file of Niantic's SPZ",
    ".ksplat": "a file of mkkellogg's web viewer",
    ".sog": "a file of PlayCanvas' SOG",
    ".glb": "a GLB",
    ".gltf": "a glTF",
    ".usdz": "a USDZ",
}
OWN_PROPERTIES = ("t_mu", "t_sigma", "vx", "vy", "vz", "is_dynamic")


@dataclass(frozen=True)
class Clock:
    """What the files of other methods do not say about time.

    Attributes:
        fps: numbers per second of a PLY sequence, frames per second of an FTGS-PLY's clip.
        clip_s: seconds from the first to the last frame of an FTGS-PLY; None = from its number of frames and fps.
    """

    fps: float = 24.0
    clip_s: float | None = None


def load(source: str | Path | Sequence[Path], clock: Clock | None = None, step: int = 1) -> GaussianCloud:
    """Read a result; what it is follows from its content.

    Args:
        source: a file, a folder of numbered PLYs, or a list of numbered PLYs.
        clock: see Clock.
        step: read every step-th Gaussian only.

    Raises:
        FileFormatError: no such file, wrong suffix, schema or layout, missing field, truncated, no points, NaN or Inf,
            a value outside its range, or a time without a unit.
    """
    clock = clock or Clock()
    paths = files_of(source)
    if len(paths) > 1:
        return ply_sequence.read(paths, clock.fps, step)
    if paths[0].suffix.lower() == ".npz":
        return checked(_read_npz(paths[0], step), paths[0])
    return checked(_read_ply(paths[0], clock, step), paths[0])


def count(source: str | Path | Sequence[Path]) -> int:
    """Number of Gaussians that `load` would make, from the files' headers alone. Raises: as `load`."""
    return sum(
        _count_npz(path) if path.suffix.lower() == ".npz" else PlyVertices(path).count for path in files_of(source)
    )


def files_of(source: str | Path | Sequence[Path]) -> list[Path]:
    """The files that a source stands for, numbered ones in order. Raises: FileFormatError."""
    if not isinstance(source, (str, Path)):
        return ply_sequence.numbered([Path(path) for path in source]) if len(source) > 1 else files_of(source[0])
    path = Path(source)
    if path.is_dir():
        found = ply_sequence.numbered([file for file in path.iterdir() if file.suffix.lower() == ".ply"])
        if not found:
            raise FileFormatError(f"{path}: no numbered .ply files in this folder; choose result.npz or result.ply")
        return found
    if path.suffix.lower() not in (".npz", ".ply"):
        if kind := SPLATS.get(path.suffix.lower()):
            raise FileFormatError(f"{path}: {kind}: open it in SuperSplat and export an uncompressed PLY")
        raise FileFormatError(
            f"{path}: unknown suffix '{path.suffix}'; a result is .npz or .ply. Checkpoints of other "
            "methods: `gof convert` makes a result of them"
        )
    if not path.is_file():
        raise FileFormatError(f"{path}: no such file")
    return [path]


def _read_npz(path: Path, step: int) -> dict[str, np.ndarray]:
    found = npz_file.arrays(path)
    schema = str(found.get("schema", "none"))
    if schema not in (NPZ_SCHEMA, NPZ_MEASURED):
        raise FileFormatError(f"{path}: schema is '{schema}', expected '{NPZ_SCHEMA}'; write it with `gof convert`")
    missing = [key for key in NPZ_NAMES.values() if key not in found]
    if not {"rgb", "sh"} & set(found):
        missing.append("rgb or sh")
    if missing:
        raise FileFormatError(f"{path}: fields {missing} are missing")
    unread = sorted(set(found) - {*NPZ_NAMES.values(), "rgb", "sh", "datum", GAS[0], UNSURE, "schema", "source"})
    if unread or {"rgb", "sh"} <= set(found):
        raise FileFormatError(
            f"{path}: fields {unread or ['rgb', 'sh']} are not read"
            + ("; remove them (a misspelt name?)" if unread else " together; keep one of them")
        )
    if "rgb" in found:
        color = found["rgb"]
    elif found["sh"].ndim == 3 and found["sh"].shape[1]:
        color = 0.5 + SH_C0 * found["sh"][:, 0]
    else:
        raise FileFormatError(f"{path}: 'sh' has shape {found['sh'].shape}, expected (N, K, 3)")
    values = {field: found[key] for field, key in NPZ_NAMES.items()} | {"color": color}
    if UNSURE in found:
        values["velocity_sd"] = found[UNSURE]
    if GAS[0] in found:
        values["gas_velocity"] = found[GAS[0]]
    measured = {"datum": _datum(found.get("datum"), path)} if schema == NPZ_MEASURED else {}
    return measured | {field: array[::step] if array.ndim else array for field, array in values.items()}


def _datum(numbers: object, path: Path) -> tuple[float, float, float, float]:
    """x, y, z (m) and t (s), float64. Raises FileFormatError: they are not four finite numbers."""
    try:
        x, y, z, t = np.asarray(numbers, np.float64).reshape(4).tolist()
    except (TypeError, ValueError):
        raise FileFormatError(f"{path}: 'datum' must be four numbers: x, y, z (m) and t (s)") from None
    if not np.isfinite([x, y, z, t]).all():
        raise FileFormatError(f"{path}: 'datum' holds NaN or Inf")
    return x, y, z, t


def _count_npz(path: Path) -> int:
    try:
        return next(iter(npz_file.shapes(path)["x0"]), 0)
    except npz_file.DAMAGE:
        return 0  # `load` says what is wrong


def _read_ply(path: Path, clock: Clock, step: int) -> dict[str, np.ndarray]:
    ply = PlyVertices(path)
    if ftgs_file.matches(ply):
        return ftgs_file.read(ply, clock.clip_s, clock.fps, step)
    rows = ply.rows(step)
    values = splats(rows, ply, step)
    if not any(ply.has(name) for name in OWN_PROPERTIES):  # a plain 3DGS PLY is a still
        refuse_unread(ply)
        n = len(rows)
        return values | {
            "velocity": np.zeros((n, 3)),
            "t_mu": np.zeros(n),
            "t_sigma": np.full(n, np.inf),
            "dynamic": np.zeros(n, bool),
        }
    if ply.has(UNSURE):
        values["velocity_sd"] = columns(rows, UNSURE)[:, 0]
    if ply.has(*GAS[1]):
        values["gas_velocity"] = columns(rows, *GAS[1])
    said = [comment.removeprefix(PLY_DATUM).split() for comment in ply.comments if comment.startswith(PLY_DATUM)]
    if said:
        values["datum"] = _datum(said[0], path)
    try:
        values |= {
            "velocity": columns(rows, "vx", "vy", "vz"),
            "t_mu": columns(rows, "t_mu")[:, 0],
            "t_sigma": columns(rows, "t_sigma")[:, 0],
            "dynamic": columns(rows, "is_dynamic")[:, 0] != 0,
        }
    except KeyError as error:
        raise FileFormatError(
            f"{path}: properties {error.args[0]} are missing; the other properties of a transient "
            "reconstruction are there, so write the file again"
        ) from None
    refuse_unread(ply, *OWN_PROPERTIES, UNSURE, *GAS[1])
    if any(map(ply.has, GAS[1])) and not ply.has(*GAS[1]):
        raise FileFormatError(f"{path}: of the properties {list(GAS[1])} some are missing; export the file again")
    return values
