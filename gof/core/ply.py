"""PLYs of 3D Gaussian splats: the attributes that every splat tool shares, raw on disk and activated in memory.

scale_* are natural logs, opacity is a logit, rot_* is wxyz and may be un-normalised, f_dc/f_rest are SH coefficients
(f_rest channel-major).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import DataFormatError, require_finite
from .harmonics import C0
from .ply_file import read_vertices, write_vertices

LARGEST_LN = 29  # of a standard deviation in metres; its cube is finite in float32
PLAIN = frozenset(
    "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 red green blue".split()
)
OURS = "units: metres"  # how a comment of the PLYs that gof writes begins
UNBOUNDED = ("t_sigma", "v_sd")  # where inf says "always" and "unknown"
# Opacities 0 and 1 have no finite logit: half a float32 step below 1; and so near 0 that no size makes up for it.
OPACITIES = 1e-35, 1 - 2.0**-24


@dataclass(frozen=True)
class Ply:
    """The vertices of a PLY by property name, and its header comments."""

    path: Path
    vertex: np.ndarray
    comments: list[str]

    @classmethod
    def read(cls, path: Path, step: int = 1) -> Ply:
        """Return every step-th vertex. Raises DataFormatError: see `read_vertices`."""
        return cls(path, *read_vertices(path, step))

    def has(self, *names: str) -> bool:
        return all(name in self.vertex.dtype.names for name in names)

    def columns(self, *names: str) -> np.ndarray:
        """Return (N, len(names)) float32."""
        missing = [name for name in names if not self.has(name)]
        if missing:
            kind = name_kind(self.vertex.dtype.names)
            raise DataFormatError(f"{self.path}: PLY properties {missing} are missing" + (f": {kind}" if kind else ""))
        with np.errstate(over="ignore"):  # the checks for finite values name what is too large
            return np.stack([self.vertex[name] for name in names], -1).astype(np.float32)

    def splats(self) -> dict[str, np.ndarray]:
        """Return the 3DGS properties, activated: position, scale, rotation, opacity, and color as harmonics (N, K, 3).

        Raises:
            DataFormatError: properties are missing, not finite, of absurd size, or activated already (names the rows).
        """
        sizes, opacity = self.columns("scale_0", "scale_1", "scale_2"), self.columns("opacity")[:, 0]
        if not any(comment.startswith(OURS) for comment in self.comments):
            require_raw(sizes, opacity, self.path)
        return self.without_scale() | {"scale": activate_scale(sizes, self.path)}

    def require_read(self, *known: str) -> None:
        """Raise DataFormatError: there are properties beside those of 3DGS and `known` ones, which no reader knows.

        Some change what the others mean; one may be a misspelt name.
        """
        read = PLAIN.union(known)
        unread = [n for n in self.vertex.dtype.names if n not in read and not re.fullmatch(r"f_rest_[0-9]{1,4}", n)]
        if unread:
            raise DataFormatError(
                f"{self.path}: properties {unread[:6]} are not read, and may change the meaning of the others (as "
                "Mip-Splatting's filter_3D does sizes); export the PLY without them"
            )

    def without_scale(self) -> dict[str, np.ndarray]:
        """As `splats`, for methods whose sizes are no logarithms."""
        rest = sorted(
            (n for n in self.vertex.dtype.names if re.fullmatch(r"f_rest_[0-9]{1,4}", n)), key=lambda n: int(n[7:])
        )
        dc = self.columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
        if len(rest) % 3:
            raise DataFormatError(f"{self.path}: {len(rest)} f_rest properties are not a multiple of 3")
        higher = self.columns(*rest).reshape(len(dc), 3, len(rest) // 3).transpose(0, 2, 1) if rest else dc[:, :0]
        values = {
            "position": self.columns("x", "y", "z"),
            "rotation": self.columns("rot_0", "rot_1", "rot_2", "rot_3"),
            "color": np.concatenate([dc, higher], 1),
        }
        for name, value in values.items():
            require_rows(np.isfinite(value), name, "finite", self.path)
        opacity = self.columns("opacity")[:, 0]  # infinite ones are 0 and 1
        require_rows(~np.isnan(opacity), "opacity", "a number", self.path)
        return values | {
            "rotation": quaternions(values["rotation"], self.path),
            "opacity": sigmoid(opacity),
        }


def name_kind(names: Collection[str]) -> str | None:
    """Return the kind of a PLY with these properties that holds no 3D Gaussians in full, and the way out; else
    None."""
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


def require_rows(good: np.ndarray, name: str, rule: str, path: Path) -> None:
    """Raise DataFormatError: `good` (N, ...) is not true everywhere; names the Gaussians' rows, from 0."""
    if not good.all():
        rows = np.unique(np.argwhere(~good)[:, 0])
        raise DataFormatError(f"{path}: '{name}' must be {rule}; rows {rows[:5].tolist()} (from 0) are not")


def activate_scale(raw: np.ndarray, path: Path) -> np.ndarray:
    """Return standard deviations of logarithms (N, 3), those of flat Gaussians (-inf) above 0.

    Raises:
        DataFormatError: NaN, or a logarithm above LARGEST_LN, which no scene holds.
    """
    require_rows(raw <= LARGEST_LN, "scale", f"a natural logarithm of at most {LARGEST_LN}", path)
    return exp(raw)


def require_raw(scale: np.ndarray, opacity: np.ndarray, path: Path) -> None:
    """Raise DataFormatError: raw sizes and opacities look like values, where PLYs hold logarithms and logits.

    All opacities in 0..1 and all sizes above 0 would be Gaussians of more than a metre, all half transparent; so many
    opacities that fill 0..1 and never leave it are no logits.
    """
    if not len(opacity) or not ((opacity >= 0) & (opacity <= 1)).all():
        return
    fill = len(opacity) >= 100 and opacity.min() < 0.1 and opacity.max() > 0.9
    if (scale > 0).all() or fill:
        sizes = " and all 'scale' are above 0" if (scale > 0).all() else ""
        raise DataFormatError(
            f"{path}: all 'opacity' lie in 0..1{sizes}: are they activated? A PLY of Gaussians holds logits and "
            "natural logarithms; export those"
        )


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(np.asarray(x, np.float64), -80, 80)))


def exp(x: np.ndarray) -> np.ndarray:
    """exp in float64, clipped so that the result and its cube stay finite and above zero in float32."""
    return np.exp(np.clip(np.asarray(x, np.float64), -80, 80))


def quaternions(q: np.ndarray, path: Path) -> np.ndarray:
    """Foreign files store them un-normalised; a zero one has no meaning."""
    bad = np.flatnonzero(np.linalg.norm(q, axis=-1) <= 1e-12)
    if len(bad):
        raise DataFormatError(f"{path}: quaternions of rows {bad[:5].tolist()} are zero")
    return q


def splat_columns(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the shared properties of a splat PLY, raw; display colours become their constant harmonic.

    Args:
        arrays: position (N, 3), scale (N, 3), rotation (N, 4), opacity (N,), color (N, 3) or (N, K, 3), as of
            `gof.core.gaussians.TransientGaussians`; others are left aside.
    """
    position, scale, color = (arrays[name] for name in ("position", "scale", "color"))
    n = len(position)
    sh = (color[:, None, :] - 0.5) / C0 if color.ndim == 2 else color
    opacity = np.clip(arrays["opacity"].astype(np.float64), *OPACITIES)
    return {
        **{axis: position[:, i] for i, axis in enumerate("xyz")},
        **{f"n{axis}": np.zeros(n) for axis in "xyz"},
        **{f"f_dc_{c}": sh[:, 0, c] for c in range(3)},
        **{f"f_rest_{i}": row for i, row in enumerate(sh[:, 1:].transpose(2, 1, 0).reshape(3 * (sh.shape[1] - 1), n))},
        "opacity": np.log(opacity) - np.log1p(-opacity),
        **{f"scale_{i}": np.log(scale[:, i]) for i in range(3)},
        **{f"rot_{i}": arrays["rotation"][:, i] for i in range(4)},
    }


def write(path: Path, columns: dict[str, np.ndarray], comments: list[str]) -> None:
    """Write a binary little-endian PLY: float properties, and uchar ones for columns of bool or uint8.

    Raises:
        NonFiniteError: a value is NaN, or beyond what a float32 can hold (names property and rows).
    """
    vertex = np.empty(
        len(columns["x"]), [(name, "u1" if np.asarray(v).itemsize == 1 else "<f4") for name, v in columns.items()]
    )
    for name, values in columns.items():
        with np.errstate(over="ignore"):
            vertex[name] = values
        endless = np.isposinf(values) if name in UNBOUNDED else False
        require_finite(name, np.where(endless, 0, vertex[name]), "a PLY of float32")
    write_vertices(path, vertex, comments)
