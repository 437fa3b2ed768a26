"""Dynamic Gaussian Splats (.dgs), version 1.1: places, motion and times as float32, the rest as 8 or 16 bits.

Written after the format's own library (github.com/splatsdotcom/DGS), its renderer and what they agree on: time runs
from 0 to 1 over the clip, a Gaussian's place is that at time 0, sizes are logarithms, and Y is up. There is no place
for the gas' own velocity, its uncertainty, or the clock.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError, require_finite
from gof.core.files import write_bytes
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.core.morton import morton_order
from gof.core.similarity import Y_UP

SUFFIX = ".dgs"
MAGIC = b"glps"
VERSION = 1 << 22 | 1 << 12 | 1  # 1.1.1
FIRST_VERSION, END_VERSION = 1 << 22 | 1 << 12, 1 << 22 | 2 << 12  # 1.1.x
# magic, version, seconds of the clip, Gaussians, do they move, degree of harmonics, bounds of sizes, colours, harmonics
HEADER = struct.Struct("<4sIfI?I6f")
WORDS, BYTES = 65535, 255
FOREVER = 1e6  # width in clips that never fades; 0, which the renderer takes for that too, its sorting leaves out


def save(gaussians: TransientGaussians, path: Path, start_s: float, end_s: float, source: str) -> np.ndarray:
    """Write a .dgs; returns (N,) in which order the Gaussians are in it.

    Args:
        start_s, end_s: first and last second of the clip on the dataset clock: times 0 and 1 of the file.
        source: not written, for the format has no place for it.
    Raises:
        DataFormatError: no Gaussian, or an empty clip.   NonFiniteError: a value is beyond a float32.
    """
    if not 0 < len(gaussians) < 1 << 32 or not end_s > start_s:
        raise DataFormatError(f"{path}: {len(gaussians)} Gaussians from {start_s:g} s to {end_s:g} s make no .dgs")
    order = morton_order(gaussians.position)
    g, clip_s = gaussians[order].transformed(Y_UP), end_s - start_s
    always = ~(g.dynamic & np.isfinite(g.t_sigma))
    velocity = np.where(g.dynamic[:, None], g.velocity.astype(np.float64), 0) * clip_s
    middle = np.where(g.dynamic, (g.t_mu.astype(np.float64) - start_s) / clip_s, 0.5)
    width = np.where(always, FOREVER, g.t_sigma.astype(np.float64) / clip_s)
    place = g.position - velocity * middle[:, None]
    sh = ((g.color[:, None] - 0.5) / C0 if g.color.ndim == 2 else g.color).astype(np.float64)
    size, sizes = _steps(np.log(g.scale.astype(np.float64)), WORDS)
    colour, colours = _steps(sh[:, 0], WORDS)
    rest, harmonics = _steps(sh[:, 1:], BYTES) if sh.shape[1] > 1 else ((0.0, 0.0), None)
    with np.errstate(over="ignore"):
        means, moves = (
            np.column_stack(pair).astype("<f4") for pair in ((place, np.where(always, 0.5, middle)), (velocity, width))
        )
    require_finite("position", means, "a .dgs of float32")
    require_finite("velocity", moves, "a .dgs of float32")
    degree = round(sh.shape[1] ** 0.5) - 1
    parts = [
        HEADER.pack(MAGIC, VERSION, clip_s, len(g), True, degree, *size, *colour, *rest),
        means.tobytes(),
        sizes.astype("<u2").tobytes(),
        _rotations(g.rotation.astype(np.float64)).astype("<u2").tobytes(),
        np.rint(BYTES * g.opacity).astype("u1").tobytes(),
        colours.astype("<u2").tobytes(),
        b"" if harmonics is None else harmonics.astype("u1").tobytes(),
        moves.tobytes(),
    ]
    write_bytes(path, b"".join(parts))
    return order


def losses(g: TransientGaussians) -> list[str]:
    """Return what a .dgs of these cannot hold, in words."""
    notes = ["axes are the format's: x to the right, y up, z backwards; (x, y, z) of ours is (x, z, -y) there"]
    if g.gas_velocity is not None:
        notes.append("velocities are how the Gaussians move; what the gas does (v_gas) is left out")
    return notes


def _steps(values: np.ndarray, most: int) -> tuple[tuple[float, float], np.ndarray]:
    """Return the bounds of values, and their nearest of most + 1 even steps between them."""
    low, high = float(values.min()), float(values.max())
    return (low, high), np.rint((values - low) / (high - low if high > low else 1) * most)


def _rotations(wxyz: np.ndarray) -> np.ndarray:
    """Return (N, 3) steps of x, y, z where w is positive; rounded towards 0, as w is the root of what they leave."""
    xyz = wxyz[:, 1:] * np.where(wxyz[:, :1] < 0, -1, 1)
    exact = (xyz + 1) / 2 * WORDS
    return np.where(xyz < 0, np.ceil(exact), np.floor(exact))
