"""What a reconstruction is once read: transient Gaussians in activated values, checked."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from . import FileFormatError
from .ply_file import PlyVertices, columns

SH_C0 = 0.5 / np.sqrt(np.pi)  # the constant spherical harmonic; display colour = 0.5 + SH_C0 * coefficient

LARGEST_LN, SMALLEST_LN = 29, -80  # of a standard deviation in metres; flatter ones count as that
PLAIN = frozenset(
    "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 red green blue".split()
)
OURS = "units: metres"  # how a comment of the PLYs that gof writes begins


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


def splats(rows: np.ndarray, ply: PlyVertices, step: int = 1) -> dict[str, np.ndarray]:
    """The 3DGS properties, activated: position, scale, rotation, opacity, color.

    Args:
        rows: every step-th of the file's.
    Raises:
        FileFormatError: properties are missing, not finite, of absurd size, or activated already (names the rows).
            `gof.core.ply` decides the same.
    """
    path = ply.path
    try:
        raw = {
            "position": columns(rows, "x", "y", "z"),
            "scale": columns(rows, "scale_0", "scale_1", "scale_2"),
            "rotation": columns(rows, "rot_0", "rot_1", "rot_2", "rot_3"),
            "opacity": columns(rows, "opacity")[:, 0],
            "color": columns(rows, "f_dc_0", "f_dc_1", "f_dc_2"),
        }
    except KeyError as error:
        kind = name_kind(ply.names) or "export it again"
        raise FileFormatError(
            f"{path}: properties {error.args[0]} are missing, so not a Gaussian splat PLY: {kind}"
        ) from None
    rest = [name for name in ply.names if name.startswith("f_rest_")]
    for name, values in (("position", raw["position"]), ("color", raw["color"]), ("color", columns(rows, *rest))):
        _require(np.isfinite(values), name, "finite (NaN or Inf found)", path, step)
    _require(np.isfinite(raw["rotation"]), "rotation", "finite (NaN or Inf found)", path, step)
    _require((raw["rotation"] != 0).any(1), "rotation", "a quaternion that is not zero", path, step)
    _require(~np.isnan(raw["opacity"]), "opacity", "a number", path, step)
    _require(raw["scale"] <= LARGEST_LN, "scale", f"a natural logarithm of at most {LARGEST_LN}", path, step)
    if not any(comment.startswith(OURS) for comment in ply.comments):
        _refuse_activated(raw["scale"], raw["opacity"], path)
    with np.errstate(over="ignore"):  # an absurd logit is opacity 0 or 1
        return raw | {
            "scale": np.exp(np.maximum(raw["scale"].astype(np.float64), SMALLEST_LN)),
            "opacity": 1 / (1 + np.exp(-raw["opacity"].astype(np.float64))),
            "color": 0.5 + SH_C0 * raw["color"],
        }


def name_kind(names: Collection[str]) -> str | None:
    """What a PLY with these properties is where it is none of 3D Gaussians in full, and the way out; else None."""
    has = set(names).issuperset
    if has(("packed_position", "packed_scale")):
        return "SuperSplat's compressed PLY, packed values of one instant: open it there and export PLY uncompressed"
    gaussians = has(("opacity", "scale_0", "rot_0"))
    if gaussians and has(("scale_1",)) and not has(("scale_2",)):
        return "2D Gaussians (surfels, no scale_2): export it from its own code as 3D ones with a third size"
    if gaussians and has(("red", "green", "blue")) and not has(("f_dc_0",)):
        return "Gaussians with plain colours (red, green, blue, no f_dc_0): export it with spherical harmonics"
    if has(("x", "y", "z")) and not gaussians:
        return "points or a mesh, without Gaussians' sizes: give the PLY that a training of Gaussians saved"
    return None


def refuse_unread(ply: PlyVertices, *known: str) -> None:
    """Raises FileFormatError: there are properties beside those of 3DGS and `known` ones, which nobody reads.

    Some change what the others mean; one may be a misspelt name.
    """
    read = PLAIN.union(known)
    unread = [name for name in ply.names if name not in read and not name.startswith("f_rest_")]
    if unread:
        raise FileFormatError(
            f"{ply.path}: properties {unread[:6]} are not read, and may change what the others mean (as "
            "Mip-Splatting's filter_3D does sizes); export the PLY without them"
        )


def _refuse_activated(scale: np.ndarray, opacity: np.ndarray, path: Path) -> None:
    """Raises FileFormatError: raw sizes and opacities look like values, where PLYs hold logarithms and logits."""
    if not len(opacity) or not ((opacity >= 0) & (opacity <= 1)).all():
        return
    fill = len(opacity) >= 100 and opacity.min() < 0.1 and opacity.max() > 0.9
    if (scale > 0).all() or fill:
        sizes = " and all 'scale' are above 0" if (scale > 0).all() else ""
        raise FileFormatError(
            f"{path}: all 'opacity' lie in 0..1{sizes}: are they activated? A PLY of Gaussians holds logits and "
            "natural logarithms; export those"
        )


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


def _require(good: np.ndarray, name: str, rule: str, path: Path, step: int = 1) -> None:
    """Raises FileFormatError naming the Gaussians' rows in the file, from 0; `good` is of every step-th."""
    if good.all():
        return
    rows = step * np.unique(np.argwhere(~good)[:, 0])
    raise FileFormatError(f"{path}: '{name}' must be {rule}; rows {rows[:5].tolist()} (from 0) are not")
