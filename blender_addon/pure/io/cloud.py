"""What a reconstruction is once read: transient Gaussians in activated values, checked."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from . import FileFormatError
from .ply_file import columns

SH_C0 = 0.5 / np.sqrt(np.pi)  # the constant spherical harmonic; display colour = 0.5 + SH_C0 * coefficient


@dataclass(frozen=True)
class GaussianCloud:
    """N transient Gaussians, activated, float32; world frame of the dataset (Z up, metres, seconds), from the datum.

    x(t) = position + (t - t_mu) velocity and alpha(t) = opacity exp(-0.5 ((t - t_mu) / t_sigma)^2); rows that are not
    dynamic ignore time. Where begin and end are given, a row is seen while begin <= t < end only.
    """

    position: np.ndarray  # (N, 3) m, at t_mu
    velocity: np.ndarray  # (N, 3) m/s, of the light: how the row moves
    t_mu: np.ndarray  # (N,) s on the dataset clock
    t_sigma: np.ndarray  # (N,) s, > 0, inf = always on
    scale: np.ndarray  # (N, 3) m, standard deviations, > 0
    rotation: np.ndarray  # (N, 4) unit quaternion wxyz
    opacity: np.ndarray  # (N,) in [0, 1]
    color: np.ndarray  # (N, 3) display values, as seen from all sides (the constant term of spherical harmonics)
    dynamic: np.ndarray  # (N,) bool
    gas_velocity: np.ndarray | None = None  # (N, 3) m/s, of the gas that shines there; None: `velocity`
    velocity_sd: np.ndarray | None = None  # (N,) m/s of each component, inf = nobody says; None: nobody says of any
    begin: np.ndarray | None = None  # (N,) s
    end: np.ndarray | None = None  # (N,) s
    datum: tuple[float, float, float, float] = (
        0.0,
        0.0,
        0.0,
        0.0,
    )  # x, y, z (m), t (s): what places and t_mu count from

    def __len__(self) -> int:
        return len(self.position)

    @property
    def moving_gas(self) -> np.ndarray:
        """(N, 3) m/s of the gas, 0 where a row is static."""
        velocity = self.velocity if self.gas_velocity is None else self.gas_velocity
        return velocity * self.dynamic[:, None]


def splats(rows: np.ndarray, path: Path) -> dict[str, np.ndarray]:
    """The 3DGS properties, activated: position, scale, rotation, opacity, color."""
    try:
        raw = {
            "position": columns(rows, "x", "y", "z"),
            "scale": columns(rows, "scale_0", "scale_1", "scale_2"),
            "rotation": columns(rows, "rot_0", "rot_1", "rot_2", "rot_3"),
            "opacity": columns(rows, "opacity")[:, 0],
            "color": columns(rows, "f_dc_0", "f_dc_1", "f_dc_2"),
        }
    except KeyError as error:
        raise FileFormatError(
            f"{path}: properties {error.args[0]} are missing, so not a Gaussian splat PLY; a mesh or plain points?"
        ) from None
    with np.errstate(over="ignore"):  # an absurd logit is opacity 0 or 1, an absurd log-scale fails the finite check
        return raw | {
            "scale": np.exp(raw["scale"].astype(np.float64)),
            "opacity": 1 / (1 + np.exp(-raw["opacity"].astype(np.float64))),
            "color": 0.5 + SH_C0 * raw["color"],
        }


def checked(values: dict[str, np.ndarray], path: Path) -> GaussianCloud:
    """A cloud of arrays that are complete, finite and in range. Raises: FileFormatError naming path, field and rows."""
    n = len(values["position"]) if values["position"].ndim else 0
    if not n:
        raise FileFormatError(f"{path}: holds 0 points; did the reconstruction end well?")
    vectors = dict.fromkeys(("position", "velocity", "gas_velocity"), (3,))
    widths = vectors | {"scale": (3,), "rotation": (4,), "color": (3,)}
    for field in fields(GaussianCloud):
        if field.name not in values or field.name == "datum":
            continue
        array = values[field.name]
        if array.shape != (n, *widths.get(field.name, ())):
            raise FileFormatError(f"{path}: '{field.name}' has shape {array.shape} for {n} points")
        if array.dtype.kind not in "fiub":
            raise FileFormatError(f"{path}: '{field.name}' holds {array.dtype}, expected numbers")
        with np.errstate(over="ignore"):
            values[field.name] = array = array.astype(bool if field.name == "dynamic" else np.float32)
        unbounded = field.name in ("t_sigma", "velocity_sd")
        _require(np.isfinite(array) | (unbounded & np.isposinf(array)), field.name, "finite (NaN or Inf found)", path)
    _require(values["t_sigma"] > 0, "t_sigma", "> 0", path)
    _require(values.get("velocity_sd", np.zeros(n)) >= 0, "velocity_sd", ">= 0", path)
    _require(values["scale"] > 0, "scale", "> 0", path)
    _require((values["opacity"] >= 0) & (values["opacity"] <= 1), "opacity", "in [0, 1]", path)
    length = np.sqrt((values["rotation"].astype(np.float64) ** 2).sum(1, keepdims=True))
    _require(length > 1e-12, "rotation", "a quaternion that is not zero", path)
    values["rotation"] = (values["rotation"] / length).astype(np.float32)
    return GaussianCloud(**values)


def _require(good: np.ndarray, name: str, rule: str, path: Path) -> None:
    if good.all():
        return
    rows = np.unique(np.argwhere(~good)[:, 0])
    raise FileFormatError(f"{path}: '{name}' must be {rule}; rows {rows[:5].tolist()} of {len(good)} are not")
