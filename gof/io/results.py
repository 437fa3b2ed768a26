"""Result files of a reconstruction: `.ply` (3DGS attributes plus time and velocity) and `.npz` (schema gof-linear/1).

The PLY keeps the field's raw conventions so that any splat viewer opens it: scale_* are natural logs, opacity is a
logit, f_dc/f_rest are SH coefficients (f_rest channel-major). Our additions are plain: t_mu, t_sigma (s), vx, vy, vz
(m/s), is_dynamic. The npz holds activated values. Neither ever contains a pickle.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement, PlyParseError

from gof.errors import DataFormatError
from gof.gaussians import TransientGaussians
from gof.io.files import atomic_path

SH_C0 = 0.28209479177387814  # Y_00: display colour = 0.5 + SH_C0 * f_dc
NPZ_SCHEMA = "gof-linear/1"
PLY_COMMENTS = [
    "gof-transient 1",
    "units: metres, seconds, m/s; world frame, Z up",
    "x(t) = (x,y,z) + (t - t_mu) (vx,vy,vz); opacity(t) = sigmoid(opacity) exp(-0.5 ((t - t_mu)/t_sigma)^2)",
    "scale_* = ln(std-dev); rot_* = wxyz; static Gaussians (is_dynamic 0) ignore time and velocity",
]
LOGIT_EPS = 2.0**-24  # opacities 0 and 1 have no finite logit; this is half a float32 step below 1


def save(gaussians: TransientGaussians, path: Path, source: str = "") -> Path:
    """Write by suffix, atomically. `source` (how it was made) goes into the file. Returns `path`."""
    writers = {".ply": _save_ply, ".npz": _save_npz}
    if path.suffix not in writers:
        raise DataFormatError(f"{path}: unknown suffix; use one of {sorted(writers)}")
    with atomic_path(path) as temporary:
        writers[path.suffix](gaussians, temporary, source)
    return path


def load(path: Path) -> TransientGaussians:
    """Read by suffix; see `TransientGaussians.load` for the errors."""
    readers = {".ply": _load_ply, ".npz": _load_npz}
    if path.suffix not in readers:
        raise DataFormatError(f"{path}: unknown suffix; use one of {sorted(readers)}")
    if not path.is_file():
        raise DataFormatError(f"{path}: no such file")
    try:
        return TransientGaussians(**readers[path.suffix](path))
    except DataFormatError as e:
        raise e if str(path) in str(e) else DataFormatError(f"{path}: {e}") from e


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


def _save_npz(g: TransientGaussians, path: Path, source: str) -> None:
    arrays = {key: getattr(g, name) for key, name in _NPZ_FIELDS.items()}
    arrays["rgb" if g.color.ndim == 2 else "sh"] = g.color
    np.savez(path, schema=np.array(NPZ_SCHEMA), source=np.array(source), **arrays)


def _load_npz(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as data:
            schema = str(data["schema"]) if "schema" in data else "none"
            if schema != NPZ_SCHEMA:
                raise DataFormatError(f"{path}: schema is '{schema}', this version reads '{NPZ_SCHEMA}'")
            color = "rgb" if "rgb" in data else "sh"
            missing = [key for key in (*_NPZ_FIELDS, color) if key not in data]
            if missing:
                raise DataFormatError(f"{path}: fields {missing} are missing")
            return {name: data[key] for key, name in _NPZ_FIELDS.items()} | {"color": data[color]}
    except (zipfile.BadZipFile, EOFError, ValueError, OSError) as e:
        raise DataFormatError(f"{path}: not a readable npz ({e}); truncated, or not an npz at all?") from e


# ---------------------------------------------------------------- PLY


def _save_ply(g: TransientGaussians, path: Path, source: str) -> None:
    n = len(g)
    sh = (g.color[:, None, :] - 0.5) / SH_C0 if g.color.ndim == 2 else g.color
    opacity = np.clip(g.opacity.astype(np.float64), LOGIT_EPS, 1 - LOGIT_EPS)
    columns = {
        "x": g.position[:, 0],
        "y": g.position[:, 1],
        "z": g.position[:, 2],
        "nx": np.zeros(n),
        "ny": np.zeros(n),
        "nz": np.zeros(n),
        **{f"f_dc_{c}": sh[:, 0, c] for c in range(3)},
        **{f"f_rest_{i}": row for i, row in enumerate(sh[:, 1:].transpose(2, 1, 0).reshape(3 * (sh.shape[1] - 1), n))},
        "opacity": np.log(opacity) - np.log1p(-opacity),
        **{f"scale_{i}": np.log(g.scale[:, i]) for i in range(3)},
        **{f"rot_{i}": g.rotation[:, i] for i in range(4)},
        "t_mu": g.t_mu,
        "t_sigma": g.t_sigma,
        **{f"v{axis}": g.velocity[:, i] for i, axis in enumerate("xyz")},
    }
    vertex = np.empty(n, [(name, "<f4") for name in columns] + [("is_dynamic", "u1")])
    for name, values in columns.items():
        vertex[name] = values
    vertex["is_dynamic"] = g.dynamic
    comments = PLY_COMMENTS + ([f"source: {source}"] if source else [])
    PlyData([PlyElement.describe(vertex, "vertex")], byte_order="<", comments=comments).write(str(path))


def _load_ply(path: Path) -> dict[str, np.ndarray]:
    _check_ply_size(path)
    try:
        ply = PlyData.read(str(path))
        vertex = ply["vertex"].data
    except (PlyParseError, KeyError, ValueError, UnicodeDecodeError, EOFError) as e:
        raise DataFormatError(f"{path}: not a readable PLY with a 'vertex' element ({e}); truncated?") from e
    version = [c for c in ply.comments if c.startswith("gof-transient")]
    if version and version[0] != PLY_COMMENTS[0]:
        raise DataFormatError(f"{path}: written as '{version[0]}', this version reads '{PLY_COMMENTS[0]}'")

    def read(names: list[str]) -> np.ndarray:
        missing = [name for name in names if name not in vertex.dtype.names]
        if missing:
            raise DataFormatError(
                f"{path}: PLY properties {missing} are missing; a plain 3DGS PLY has no time or velocity "
                "and cannot be read as transient Gaussians"
            )
        return np.stack([vertex[name] for name in names], -1)

    n = len(vertex)
    rest = sorted((name for name in vertex.dtype.names if name.startswith("f_rest_")), key=lambda s: int(s[7:]))
    dc = read([f"f_dc_{c}" for c in range(3)])
    if rest:
        if len(rest) % 3:
            raise DataFormatError(f"{path}: {len(rest)} f_rest properties are not a multiple of 3")
        color = np.concatenate([dc[:, None], read(rest).reshape(n, 3, len(rest) // 3).transpose(0, 2, 1)], 1)
    else:
        color = 0.5 + SH_C0 * dc
    log_scale, logit = read([f"scale_{i}" for i in range(3)]), read(["opacity"])[:, 0]
    return {
        "position": read(["x", "y", "z"]),
        "velocity": read(["vx", "vy", "vz"]),
        "t_mu": read(["t_mu"])[:, 0],
        "t_sigma": read(["t_sigma"])[:, 0],
        "scale": np.exp(np.clip(log_scale, -80, 80)),
        "rotation": read([f"rot_{i}" for i in range(4)]),
        "opacity": 1 / (1 + np.exp(-np.clip(logit, -80, 80))),
        "color": color,
        "dynamic": read(["is_dynamic"])[:, 0] != 0,
    }


def _check_ply_size(path: Path) -> None:
    """Refuse a header that announces more points than the file can hold, before anything is allocated."""
    with open(path, "rb") as f:
        head = f.read(65536)
    match = re.search(rb"^element\s+vertex\s+(\d+)", head, re.M)
    if head[:3] != b"ply" or b"end_header" not in head or not match:
        raise DataFormatError(f"{path}: not a PLY file with a 'vertex' element")
    if int(match[1]) > path.stat().st_size:
        raise DataFormatError(
            f"{path}: header announces {int(match[1])} points, the file has {path.stat().st_size} bytes; truncated?"
        )
