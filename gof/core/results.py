"""Result files of a reconstruction: `.ply` (3DGS attributes plus time and velocity) and `.npz` (schema gof-linear/1).

The PLY keeps the field's raw conventions so that any splat viewer opens it: scale_* are natural logs, opacity is a
logit, f_dc/f_rest are SH coefficients (f_rest channel-major). Our additions are plain: t_mu, t_sigma (s), vx, vy, vz
(m/s), is_dynamic; where the gas has another velocity than its light, gas_vx, gas_vy, gas_vz (m/s); and v_sd (m/s) where
something is known of how sure the velocity is. The npz holds activated values.
Neither ever contains a pickle.

Where places and times are measured from a datum (`gof.core.datum`), the files name it and are of version 2, so that a
reader that knows none refuses them instead of misplacing a flame by kilometres.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .datum import Datum
from .errors import DataFormatError
from .files import atomic_path
from .harmonics import plain_color
from .npz import read_npz
from .ply import Ply, splat_columns, write

Arrays = dict[str, np.ndarray]  # the fields of `gof.core.gaussians.TransientGaussians` by name

NPZ_SCHEMA = "gof-linear/1"
NPZ_MEASURED = "gof-linear/2"  # from a datum
PLY_VERSION, PLY_MEASURED = "gof-transient 1", "gof-transient 2"
PLY_DATUM = "datum x y z t:"
PLY_SOURCE = "source: "
PLY_COMMENTS = [
    "units: metres, seconds, m/s; world frame, Z up",
    "x(t) = (x,y,z) + (t - t_mu) (vx,vy,vz); opacity(t) = sigmoid(opacity) exp(-0.5 ((t - t_mu)/t_sigma)^2)",
    "scale_* = ln(std-dev); rot_* = wxyz; static Gaussians (is_dynamic 0) ignore time and velocity",
]


def save(arrays: Arrays, path: Path, source: str = "", datum: Datum | None = None) -> Path:
    """Write by suffix, atomically. `source` (how it was made) goes into the file. Returns `path`.

    Args:
        datum: what places and times are measured from; None: unknown.

    Raises:
        DataFormatError: unknown suffix.
    """
    writers = {".ply": _save_ply, ".npz": _save_npz}
    if path.suffix not in writers:
        raise DataFormatError(f"{path}: unknown suffix; use one of {sorted(writers)}")
    with atomic_path(path) as temporary:
        writers[path.suffix](arrays, temporary, source, datum)
    return path


def load(path: Path, step: int = 1) -> tuple[Arrays, Datum | None]:
    """Read by suffix: the arrays of every step-th Gaussian, and what they are measured from, where the file says so.

    Raises:
        DataFormatError: unknown suffix, no such file, another version, a field missing, or a damaged file.
    """
    suffix = path.suffix.lower()
    if suffix not in (".ply", ".npz"):
        raise DataFormatError(f"{path}: unknown suffix; use .ply or .npz")
    if not path.is_file():
        raise DataFormatError(f"{path}: no such file")
    return of_ply(Ply.read(path, step)) if suffix == ".ply" else _load_npz(path, step)


# ---------------------------------------------------------------- npz

_NPZ_FIELDS = {
    "x0": "position",
    "v": "velocity",
    "t_mu_s": "t_mu",
    "t_sigma_s": "t_sigma",
    "scale": "scale",
    "rotation": "rotation",
    "alpha": "opacity",
    "dynamic": "dynamic",
}


def _save_npz(arrays: Arrays, path: Path, source: str, datum: Datum | None) -> None:
    stored = {key: arrays[name] for key, name in _NPZ_FIELDS.items()}
    if "gas_velocity" in arrays:
        stored["v_gas"] = arrays["gas_velocity"]
    stored |= _velocity_sd(arrays)
    stored["rgb" if arrays["color"].ndim == 2 else "sh"] = arrays["color"]
    if datum:
        stored["datum"] = datum.numbers()
    np.savez(path, schema=np.array(NPZ_MEASURED if datum else NPZ_SCHEMA), source=np.array(source), **stored)


def _load_npz(path: Path, step: int) -> tuple[Arrays, Datum | None]:
    data = read_npz(path)
    schema = str(data.get("schema", "none"))
    if schema not in (NPZ_SCHEMA, NPZ_MEASURED):
        raise DataFormatError(
            f"{path}: schema is '{schema[:40]}', this version reads '{NPZ_SCHEMA}' and '{NPZ_MEASURED}'"
        )
    color = "rgb" if "rgb" in data else "sh"
    needed = (*_NPZ_FIELDS, *(["datum"] if schema == NPZ_MEASURED else []))
    missing = [key for key in needed if key not in data] + ["rgb or sh"] * (color not in data)
    if missing:
        raise DataFormatError(f"{path}: fields {missing} are missing")
    unread = sorted(set(data) - {*_NPZ_FIELDS, "rgb", "sh", "datum", "v_gas", "v_sd", "schema", "source"})
    if unread or {"rgb", "sh"} <= set(data):
        raise DataFormatError(
            f"{path}: fields {unread or ['rgb', 'sh']} are not read"
            + ("; remove them (a misspelt name?)" if unread else " together; keep one of them")
        )
    if data[color].ndim != (2 if color == "rgb" else 3):
        raise DataFormatError(f"{path}: '{color}' has shape {data[color].shape}")
    known = {name: data[key] for key, name in (("v_gas", "gas_velocity"), ("v_sd", "velocity_sd")) if key in data}
    arrays = {name: data[key] for key, name in _NPZ_FIELDS.items()} | {"color": data[color]} | known
    arrays = {name: values[::step] if values.ndim else values for name, values in arrays.items()}
    return arrays, Datum.from_numbers(data["datum"], path) if schema == NPZ_MEASURED else None


def _velocity_sd(arrays: Arrays) -> Arrays:
    """Return both files' statements on it: none where nothing is known."""
    return {"v_sd": arrays["velocity_sd"]} if np.isfinite(arrays["velocity_sd"]).any() else {}


# ---------------------------------------------------------------- PLY


PROPERTIES = ("t_mu", "t_sigma", "vx", "vy", "vz", "is_dynamic")  # beside those of 3DGS; all are there
_GAS = ("gas_vx", "gas_vy", "gas_vz")


def _save_ply(arrays: Arrays, path: Path, source: str, datum: Datum | None) -> None:
    moving = {
        "t_mu": arrays["t_mu"],
        "t_sigma": arrays["t_sigma"],
        **{f"v{axis}": arrays["velocity"][:, i] for i, axis in enumerate("xyz")},
        "is_dynamic": arrays["dynamic"],
        **_velocity_sd(arrays),
    }
    if "gas_velocity" in arrays:
        moving |= {name: arrays["gas_velocity"][:, i] for i, name in enumerate(_GAS)}
    comments = [PLY_VERSION, *PLY_COMMENTS]
    if datum:
        comments = [PLY_MEASURED, " ".join([PLY_DATUM, *map(repr, datum.numbers().tolist())]), *PLY_COMMENTS]
    write(path, splat_columns(arrays) | moving, comments + ([f"{PLY_SOURCE}{source}"] if source else []))


def of_ply(ply: Ply) -> tuple[Arrays, Datum | None]:
    """As `load`, of a PLY that has been read."""
    path = ply.path
    version = [c for c in ply.comments if c.startswith("gof-transient")]
    if version and version[0] not in (PLY_VERSION, PLY_MEASURED):
        raise DataFormatError(
            f"{path}: written as '{version[0]}', this version reads '{PLY_VERSION}' and '{PLY_MEASURED}'"
        )
    measured = [c.removeprefix(PLY_DATUM).split() for c in ply.comments if c.startswith(PLY_DATUM)]
    if (PLY_MEASURED in version) != (len(measured) == 1):
        raise DataFormatError(f"{path}: the comment '{PLY_DATUM}' belongs to '{PLY_MEASURED}', once")
    missing = [name for name in PROPERTIES if not ply.has(name)]
    if missing:
        raise DataFormatError(
            f"{path}: PLY properties {missing} are missing; a plain 3DGS PLY has no time or velocity and cannot be "
            "read as transient Gaussians"
        )
    ply.refuse_unread(*PROPERTIES, "v_sd", *_GAS)
    if any(map(ply.has, _GAS)) and not ply.has(*_GAS):
        raise DataFormatError(f"{path}: of the PLY properties {list(_GAS)} some are missing; export the file again")
    splats = ply.splats()
    if splats["color"].shape[1] == 1:
        splats["color"] = plain_color(splats["color"])
    known = {"velocity_sd": ply.columns("v_sd")[:, 0]} if ply.has("v_sd") else {}
    if ply.has(*_GAS):
        known["gas_velocity"] = ply.columns(*_GAS)
    arrays = (
        splats
        | known
        | {
            "velocity": ply.columns("vx", "vy", "vz"),
            "t_mu": ply.columns("t_mu")[:, 0],
            "t_sigma": ply.columns("t_sigma")[:, 0],
            "dynamic": ply.columns("is_dynamic")[:, 0] != 0,
        }
    )
    return arrays, Datum.from_numbers(measured[0], path) if measured else None
