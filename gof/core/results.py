"""Result files of a reconstruction: `.ply` (3DGS attributes plus time and velocity) and `.npz` (schema gof-linear/1).

The PLY keeps the field's raw conventions so that any splat viewer opens it: scale_* are natural logs, opacity is a
logit, f_dc/f_rest are SH coefficients (f_rest channel-major). Our additions are plain: t_mu, t_sigma (s), vx, vy, vz
(m/s), is_dynamic; where the gas has another velocity than its light, gas_vx, gas_vy, gas_vz (m/s); and v_sd (m/s) where
something is known of how sure the velocity is. The npz holds activated values.
Neither ever contains a pickle.

Where places and times are measured from a datum (`gof.core.datum`), the files name it and are of version 2, so that a
reader that knows none refuses them instead of misplacing a flame by kilometres. That Gaussians are emissive stands
in the npz's field "emissive" and the PLY's version 3: an older reader refuses them instead of drawing another flame.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

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
PLY_VERSION, PLY_MEASURED, PLY_EMISSIVE = "gof-transient 1", "gof-transient 2", "gof-transient 3"
PLY_DATUM = "datum x y z t:"
PLY_LIGHT = (
    "emissive: adds its light, in linear light, to what lies behind, and hides nothing that it does not outshine"
)
PLY_SOURCE = "source: "
PLY_COMMENTS = [
    "units: metres, seconds, m/s; world frame, Z up",
    "x(t) = (x,y,z) + (t - t_mu) (vx,vy,vz); opacity(t) = sigmoid(opacity) exp(-0.5 ((t - t_mu)/t_sigma)^2)",
    "scale_* = ln(std-dev); rot_* = wxyz; static Gaussians (is_dynamic 0) ignore time and velocity",
]


class Whole(NamedTuple):
    """Facts about all Gaussians of a file together; see `gof.core.gaussians.TransientGaussians`."""

    datum: Datum | None = None
    emissive: bool = False


NOTHING_SAID = Whole()


def save(arrays: Arrays, path: Path, source: str = "", whole: Whole = NOTHING_SAID) -> Path:
    """Write by suffix, atomically. `source` (how it was made) goes into the file. Returns `path`.

    Raises:
        DataFormatError: unknown suffix.
    """
    writers = {".ply": _save_ply, ".npz": _save_npz}
    if path.suffix not in writers:
        raise DataFormatError(f"{path}: unknown suffix; use one of {sorted(writers)}")
    with atomic_path(path) as temporary:
        writers[path.suffix](arrays, temporary, source, whole)
    return path


def load(path: Path, step: int = 1) -> tuple[Arrays, Whole]:
    """Read by suffix: the arrays of every step-th Gaussian, and what the file says of all of them.

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
_NPZ_OPTIONAL = ("rgb", "sh", "datum", "emissive", "v_gas", "v_sd", "schema", "source")


def _save_npz(arrays: Arrays, path: Path, source: str, whole: Whole) -> None:
    stored = {key: arrays[name] for key, name in _NPZ_FIELDS.items()}
    if "gas_velocity" in arrays:
        stored["v_gas"] = arrays["gas_velocity"]
    stored |= _velocity_sd(arrays)
    stored["rgb" if arrays["color"].ndim == 2 else "sh"] = arrays["color"]
    if whole.datum:
        stored["datum"] = whole.datum.numbers()
    if whole.emissive:
        stored["emissive"] = np.array(True)
    np.savez(path, schema=np.array(NPZ_MEASURED if whole.datum else NPZ_SCHEMA), source=np.array(source), **stored)


def _load_npz(path: Path, step: int) -> tuple[Arrays, Whole]:
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
    unread = sorted(set(data) - {*_NPZ_FIELDS, *_NPZ_OPTIONAL})
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
    emissive = data.get("emissive", np.array(False))
    if emissive.shape != () or emissive.dtype != bool:
        raise DataFormatError(f"{path}: 'emissive' has shape {emissive.shape} of {emissive.dtype}; it is one bool")
    return arrays, Whole(Datum.from_numbers(data["datum"], path) if schema == NPZ_MEASURED else None, bool(emissive))


def _velocity_sd(arrays: Arrays) -> Arrays:
    """Return both files' statements on it: none where nothing is known."""
    return {"v_sd": arrays["velocity_sd"]} if np.isfinite(arrays["velocity_sd"]).any() else {}


# ---------------------------------------------------------------- PLY


PROPERTIES = ("t_mu", "t_sigma", "vx", "vy", "vz", "is_dynamic")  # beside those of 3DGS; all are there
_GAS = ("gas_vx", "gas_vy", "gas_vz")


def _save_ply(arrays: Arrays, path: Path, source: str, whole: Whole) -> None:
    moving = {
        "t_mu": arrays["t_mu"],
        "t_sigma": arrays["t_sigma"],
        **{f"v{axis}": arrays["velocity"][:, i] for i, axis in enumerate("xyz")},
        "is_dynamic": arrays["dynamic"],
        **_velocity_sd(arrays),
    }
    if "gas_velocity" in arrays:
        moving |= {name: arrays["gas_velocity"][:, i] for i, name in enumerate(_GAS)}
    datum = whole.datum
    comments = [PLY_EMISSIVE if whole.emissive else PLY_MEASURED if datum else PLY_VERSION]
    comments += [" ".join([PLY_DATUM, *map(repr, datum.numbers().tolist())])] if datum else []
    comments += [*PLY_COMMENTS, *([PLY_LIGHT] if whole.emissive else [])]
    write(path, splat_columns(arrays) | moving, comments + ([f"{PLY_SOURCE}{source}"] if source else []))


def of_ply(ply: Ply) -> tuple[Arrays, Whole]:
    """As `load`, of a PLY that has been read."""
    path = ply.path
    version = [c for c in ply.comments if c.startswith("gof-transient")]
    readable = PLY_VERSION, PLY_MEASURED, PLY_EMISSIVE
    if version and version[0] not in readable:
        raise DataFormatError(f"{path}: written as '{version[0]}', this version reads {', '.join(map(repr, readable))}")
    measured = [c.removeprefix(PLY_DATUM).split() for c in ply.comments if c.startswith(PLY_DATUM)]
    emissive = PLY_EMISSIVE in version
    if len(measured) > 1 or (not emissive and (PLY_MEASURED in version) != bool(measured)):
        raise DataFormatError(
            f"{path}: the comment '{PLY_DATUM}' belongs to '{PLY_MEASURED}' and '{PLY_EMISSIVE}', once"
        )
    missing = [name for name in PROPERTIES if not ply.has(name)]
    if missing:
        raise DataFormatError(
            f"{path}: PLY properties {missing} are missing; a plain 3DGS PLY has no time or velocity and cannot be "
            "read as transient Gaussians"
        )
    ply.require_read(*PROPERTIES, "v_sd", *_GAS)
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
    return arrays, Whole(Datum.from_numbers(measured[0], path) if measured else None, emissive)
