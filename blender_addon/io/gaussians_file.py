"""Reader of reconstruction results, with numpy only: `result.npz` (schema gof-linear/1) and `result.ply`.

The PLY holds 3DGS attributes raw (scale_* natural logs, opacity a logit, f_dc spherical-harmonics coefficients, rot
wxyz) plus t_mu, t_sigma (s), vx, vy, vz (m/s) and is_dynamic; the npz holds the same values activated.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from . import FileFormatError

NPZ_SCHEMA = "gof-linear/1"
SH_C0 = 0.5 / np.sqrt(np.pi)  # the constant spherical harmonic; display colour = 0.5 + SH_C0 * coefficient
PLY_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
             "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
             "double": "f8", "float64": "f8"}
PLY_FORMATS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class GaussianCloud:
    """N transient Gaussians, activated, float32; world frame of the dataset (Z up, metres, seconds).

    x(t) = position + (t - t_mu) velocity and alpha(t) = opacity exp(-0.5 ((t - t_mu) / t_sigma)^2); rows that are not
    dynamic ignore time.
    """

    position: np.ndarray  # (N, 3) m, at t_mu
    velocity: np.ndarray  # (N, 3) m/s
    t_mu: np.ndarray  # (N,) s on the dataset clock
    t_sigma: np.ndarray  # (N,) s, > 0, inf = always on
    scale: np.ndarray  # (N, 3) m, standard deviations, > 0
    rotation: np.ndarray  # (N, 4) unit quaternion wxyz
    opacity: np.ndarray  # (N,) in [0, 1]
    color: np.ndarray  # (N, 3) display values, as seen from all sides (the constant term of spherical harmonics)
    dynamic: np.ndarray  # (N,) bool

    def __len__(self) -> int:
        return len(self.position)


def load(path: str | Path) -> GaussianCloud:
    """Read a result by its suffix.

    Raises:
        FileFormatError: no such file, wrong suffix, schema or layout, missing field, truncated, no points, NaN or Inf,
            or a value outside its range.
    """
    path = Path(path)
    readers = {".npz": _read_npz, ".ply": _read_ply}
    if path.suffix not in readers:
        raise FileFormatError(f"{path}: unknown suffix '{path.suffix}'; a result is .npz or .ply")
    if not path.is_file():
        raise FileFormatError(f"{path}: no such file")
    return _checked(readers[path.suffix](path), path)


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    names = {"position": "x0", "velocity": "v", "t_mu": "t_mu_s", "t_sigma": "t_sigma_s", "scale": "scale",
             "rotation": "rotation", "opacity": "alpha", "dynamic": "dynamic"}
    try:
        with np.load(path, allow_pickle=False) as data:
            found = {key: data[key] for key in data.files}
    except (zipfile.BadZipFile, ValueError, EOFError, OSError, AttributeError, TypeError) as error:
        raise FileFormatError(f"{path}: not a readable npz ({error}); truncated, or another kind of file?") from None
    schema = str(found.get("schema", "none"))
    if schema != NPZ_SCHEMA:
        raise FileFormatError(f"{path}: schema is '{schema}', expected '{NPZ_SCHEMA}'; write it with `gof convert`")
    missing = [key for key in names.values() if key not in found]
    if not {"rgb", "sh"} & set(found):
        missing.append("rgb or sh")
    if missing:
        raise FileFormatError(f"{path}: fields {missing} are missing")
    values = {field: found[key] for field, key in names.items()}
    if "rgb" in found:
        return values | {"color": found["rgb"]}
    sh = found["sh"]
    if sh.ndim != 3 or not sh.shape[1]:
        raise FileFormatError(f"{path}: 'sh' has shape {sh.shape}, expected (N, K, 3)")
    return values | {"color": 0.5 + SH_C0 * sh[:, 0]}


def _read_ply(path: Path) -> dict[str, np.ndarray]:
    data = path.read_bytes()
    vertex = _ply_vertices(data, path)

    def columns(*names: str) -> np.ndarray:
        missing = [name for name in names if name not in vertex.dtype.names]
        if missing:
            raise FileFormatError(f"{path}: properties {missing} are missing; a plain 3DGS PLY has no time and velocity, "
                                  "use the result of a transient reconstruction")
        return np.stack([vertex[name].astype(np.float64) for name in names], -1)

    with np.errstate(over="ignore"):  # an absurd logit is opacity 0 or 1, an absurd log-scale fails the finite check
        return {
            "position": columns("x", "y", "z"), "velocity": columns("vx", "vy", "vz"),
            "t_mu": columns("t_mu")[:, 0], "t_sigma": columns("t_sigma")[:, 0],
            "scale": np.exp(columns("scale_0", "scale_1", "scale_2")),
            "rotation": columns("rot_0", "rot_1", "rot_2", "rot_3"),
            "opacity": 1 / (1 + np.exp(-columns("opacity")[:, 0])),
            "color": 0.5 + SH_C0 * columns("f_dc_0", "f_dc_1", "f_dc_2"),
            "dynamic": columns("is_dynamic")[:, 0] != 0,
        }


def _ply_vertices(data: bytes, path: Path) -> np.ndarray:
    """The vertex element as a structured array; it must be the first element of a binary file."""
    head, end, body = data.partition(b"end_header\n")
    try:
        lines = [line.split() for line in head.decode("ascii").splitlines()]
    except UnicodeDecodeError:
        lines = []
    if not end or not lines or lines[0] != ["ply"]:
        raise FileFormatError(f"{path}: not a PLY file (no complete header)")
    formats = [PLY_FORMATS.get(line[1]) for line in lines if line[:1] == ["format"] and len(line) > 1]
    if formats not in (["<"], [">"]):
        raise FileFormatError(f"{path}: not a binary PLY; convert it to binary_little_endian")
    elements = [line for line in lines if line[:1] in (["element"], ["property"])]
    if not elements or elements[0][:2] != ["element", "vertex"] or not elements[0][-1].isdigit():
        raise FileFormatError(f"{path}: the first element of the PLY is not 'vertex' with a count")
    count, names = int(elements[0][2]), []
    for line in elements[1:]:
        if line[0] == "element":
            break
        if len(line) != 3 or line[1] not in PLY_TYPES:
            raise FileFormatError(f"{path}: vertex property '{' '.join(line[1:])}' is not a plain number")
        names.append((line[2], formats[0] + PLY_TYPES[line[1]]))
    try:
        dtype = np.dtype(names)
    except ValueError as error:
        raise FileFormatError(f"{path}: vertex properties are broken ({error})") from None
    if len(body) < count * dtype.itemsize:
        raise FileFormatError(f"{path}: truncated: {count} points need {count * dtype.itemsize} bytes, "
                              f"{len(body)} are left after the header")
    return np.frombuffer(body, dtype, count)


def _checked(values: dict[str, np.ndarray], path: Path) -> GaussianCloud:
    n = len(values["position"]) if values["position"].ndim else 0
    if not n:
        raise FileFormatError(f"{path}: holds 0 points; did the reconstruction end well?")
    widths = {"position": (3,), "velocity": (3,), "scale": (3,), "rotation": (4,), "color": (3,)}
    for field in fields(GaussianCloud):
        array = values[field.name]
        if array.shape != (n, *widths.get(field.name, ())):
            raise FileFormatError(f"{path}: '{field.name}' has shape {array.shape} for {n} points")
        if array.dtype.kind not in "fiub":
            raise FileFormatError(f"{path}: '{field.name}' holds {array.dtype}, expected numbers")
        with np.errstate(over="ignore"):
            values[field.name] = array = array.astype(bool if field.name == "dynamic" else np.float32)
        unbounded = field.name == "t_sigma"
        _require(np.isfinite(array) | (unbounded & np.isposinf(array)), field.name, "finite (NaN or Inf found)", path)
    _require(values["t_sigma"] > 0, "t_sigma", "> 0", path)
    _require(values["scale"] > 0, "scale", "> 0", path)
    _require((values["opacity"] >= 0) & (values["opacity"] <= 1), "opacity", "in [0, 1]", path)
    length = np.linalg.norm(values["rotation"].astype(np.float64), axis=1, keepdims=True)
    _require(length > 1e-12, "rotation", "a quaternion that is not zero", path)
    values["rotation"] = (values["rotation"] / length).astype(np.float32)
    return GaussianCloud(**values)


def _require(good: np.ndarray, name: str, rule: str, path: Path) -> None:
    rows = np.unique(np.argwhere(~good)[:, 0])
    if len(rows):
        raise FileFormatError(f"{path}: '{name}' must be {rule}; rows {rows[:5].tolist()} of {len(good)} are not")
