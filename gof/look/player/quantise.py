"""Transient Gaussians as the page of `gof share` carries them, in 27 bytes each, and back.

They are 33 bytes where gas and light have a velocity each. The loss is measured in dB, pixels and m/s.

Every quantity is a column of whole numbers on a grid between its least and its greatest value; t_sigma, scale, opacity
and v_sd on a grid of their logarithms. The page unpacks by the same description (`player/unpack.js`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import VISIBLE, TransientGaussians
from gof.core.harmonics import plain_color

LONGEST_SIDE = 720  # px of the pictures in which the cost is measured
ROTATION_BITS = 10  # of each of the three smaller parts of a quaternion
LEAST_OPACITY = 1e-4  # fainter is not drawn (1/255) whatever it is multiplied with; 0 has no logarithm


@dataclass(frozen=True)
class PackedColumn:
    """One quantity of all Gaussians, part after part, little-endian.

    Attributes:
        name: of the quantity.   parts: numbers of each Gaussian.   bytes: of each number.
        low, high: what 0 and the greatest whole number mean, by part; of its logarithm where `log`.
        infinite: the greatest whole number is infinity instead, and the one below it `high`.
    """

    name: str
    parts: int
    bytes: int
    low: list[float]
    high: list[float]
    log: bool = False
    infinite: bool = False

    @property
    def steps(self) -> int:
        """Return the whole number that means `high`."""
        return 2 ** (8 * self.bytes) - 1 - self.infinite


@dataclass(frozen=True)
class Packed:
    """N quantised Gaussians: their columns' descriptions, the columns' bytes one after another, and what they are."""

    count: int
    columns: list[PackedColumn]
    data: bytes
    emissive: bool

    def header(self) -> dict[str, Any]:
        """JSON-ready description of `data`."""
        columns = [asdict(column) | {"steps": column.steps} for column in self.columns]
        return {"count": self.count, "columns": columns, "emissive": self.emissive}


def pack(gaussians: TransientGaussians, true_velocity: np.ndarray | None = None) -> Packed:
    """Quantise.

    Args:
        gaussians: N. Only the part of harmonics without direction is kept; static ones get velocity 0 and t_sigma inf.
        true_velocity: (N, 3) m/s of the gas at each one's centre and time, where it is known.
    """
    g = gaussians
    velocity = np.where(g.dynamic[:, None], g.velocity, 0)
    always = np.where(g.dynamic, g.t_sigma, np.inf)
    unsure = np.where(g.dynamic, g.velocity_sd, np.inf)
    gas = [] if g.gas_velocity is None else [_linear("v_gas", g.moving_gas, 2)]
    truth = [] if true_velocity is None else [_linear("v_true", true_velocity, 2)]
    made = [
        _rotation(g.rotation),
        _linear("x0", g.position, 2),
        _linear("v", velocity, 2),
        *gas,
        *truth,
        _linear("t_mu", g.t_mu[:, None], 2),
        _linear("rgb", plain_color(g.color), 1),
        _log("t_sigma", always[:, None]),
        _log("scale", g.scale),
        _log("opacity", np.maximum(g.opacity, LEAST_OPACITY)[:, None]),
        _log("v_sd", unsure[:, None]),
    ]
    return Packed(len(g), [column for column, _ in made], b"".join(data for _, data in made), g.emissive)


def unpack(packed: Packed) -> TransientGaussians:
    """Return the Gaussians that the page draws, as `unpack.js` has it. Always-on ones without velocity are static."""
    values, start = {}, 0
    for column in packed.columns:
        length = packed.count * column.parts * column.bytes
        code = np.frombuffer(packed.data, f"<u{column.bytes}", packed.count * column.parts, start)
        start += length
        code = code.reshape(column.parts, packed.count).T
        values[column.name] = _quaternions(code[:, 0]) if column.name == "rotation" else _values(column, code)
    return TransientGaussians(
        position=values["x0"],
        velocity=values["v"],
        t_mu=values["t_mu"][:, 0],
        t_sigma=values["t_sigma"][:, 0],
        scale=values["scale"],
        rotation=values["rotation"],
        opacity=np.minimum(values["opacity"][:, 0], 1),
        color=values["rgb"],
        dynamic=np.isfinite(values["t_sigma"][:, 0]) | (np.abs(values["v"]).max(-1, initial=0) > 0),
        gas_velocity=values.get("v_gas"),
        velocity_sd=values["v_sd"][:, 0],
        emissive=packed.emissive,
    )


@dataclass(frozen=True)
class PackedFidelity:
    """The worst over some cameras and times.

    Attributes:
        psnr_db: of the pictures over black, clipped to what a screen shows; inf = equal.
        moved_px: how far a visible Gaussian's centre moved, in pixels of the camera.
        velocity_m_s: of all Gaussians, the largest difference of a component.
    """

    psnr_db: float
    moved_px: float
    velocity_m_s: float


def measure(
    own: TransientGaussians, drawn: TransientGaussians, cameras: list[Camera], times_s: list[float]
) -> PackedFidelity:
    """Compare row by row the same Gaussians before and after."""
    from gof.render import render

    psnr, moved = [], [0.0]
    for camera in cameras:
        share = min(1.0, LONGEST_SIDE / max(camera.width, camera.height))
        small = camera.scaled(max(1, round(camera.width * share)), max(1, round(camera.height * share)))
        for time_s in times_s:
            first, second = (np.clip(render(g, small, time_s, shutter="global")["color"], 0, 1) for g in (own, drawn))
            error = float(np.mean((first - second) ** 2))
            psnr.append(-10 * np.log10(error) if error > 0 else np.inf)
            (before, opacity), (after, _) = own.at(time_s), drawn.at(time_s)
            seen = opacity >= VISIBLE
            shift = np.linalg.norm(camera.project(before[seen])[0] - camera.project(after[seen])[0], axis=-1)
            moved.append(float(np.nanmax(shift, initial=0.0)))
    speed = own.moving_gas - drawn.moving_gas
    return PackedFidelity(min(psnr), max(moved), float(np.abs(speed).max(initial=0.0)))


# ---------------------------------------------------------------- grids


def _linear(name: str, values: np.ndarray, size: int) -> tuple[PackedColumn, bytes]:
    """Return a grid that has 0 on it where the values lie on both sides of it: what stands still must not creep."""
    values = np.asarray(values, np.float64)
    low, high = values.min(0, initial=np.inf), values.max(0, initial=-np.inf)
    if not len(values):
        low = high = np.zeros(values.shape[1])
    steps = 2 ** (8 * size) - 1
    astride = (low < 0) & (high > 0)
    step = np.where(astride, (high - low) / (steps - 1), (high - low) / steps)
    low = np.where(astride, np.floor(low / np.where(astride, step, 1)) * step, low)
    column = PackedColumn(name, values.shape[1], size, low.tolist(), (low + steps * step).tolist())
    return column, _codes(column, values)


def _log(name: str, values: np.ndarray) -> tuple[PackedColumn, bytes]:
    """Return one byte each; all parts share a grid, and infinity has a number of its own."""
    values = np.asarray(values, np.float64)
    finite = np.log(values[np.isfinite(values) & (values > 0)])
    low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    parts = values.shape[1]
    column = PackedColumn(name, parts, 1, [float(low)] * parts, [float(high)] * parts, log=True, infinite=True)
    with np.errstate(divide="ignore"):
        return column, _codes(column, np.log(values))


def _codes(column: PackedColumn, values: np.ndarray) -> bytes:
    low, span = np.array(column.low), np.array(column.high) - column.low
    share = np.where(span > 0, (values - low) / np.where(span > 0, span, 1), 0)
    code = np.rint(np.clip(np.nan_to_num(share, posinf=0, neginf=0), 0, 1) * column.steps)
    code = np.where(np.isposinf(values), column.steps + column.infinite, code)
    return np.ascontiguousarray(code.T).astype(f"<u{column.bytes}").tobytes()


def _values(column: PackedColumn, code: np.ndarray) -> np.ndarray:
    low, high = np.array(column.low), np.array(column.high)
    values = low + code * ((high - low) / column.steps)
    values = np.exp(values) if column.log else values
    return np.where(code > column.steps, np.inf, values) if column.infinite else values


def _rotation(quaternions: np.ndarray) -> tuple[PackedColumn, bytes]:
    """Return the three smaller parts of a unit quaternion, each at most sqrt(1/2), and which part is the largest: 32
    bits."""
    q = np.asarray(quaternions, np.float64)
    largest = np.abs(q).argmax(-1)
    q = q * np.where(np.take_along_axis(q, largest[:, None], -1) < 0, -1, 1)
    smaller = np.take_along_axis(q, (largest[:, None] + [1, 2, 3]) % 4, -1)
    most = 2**ROTATION_BITS - 1
    code = np.rint((np.clip(smaller * np.sqrt(0.5) + 0.5, 0, 1)) * most).astype(np.uint32)
    word = largest.astype(np.uint32) << 30 | code[:, 0] << 20 | code[:, 1] << 10 | code[:, 2]
    return PackedColumn("rotation", 1, 4, [0.0], [0.0]), word.astype("<u4").tobytes()


def _quaternions(word: np.ndarray) -> np.ndarray:
    most = 2**ROTATION_BITS - 1
    code = np.stack([word >> 20 & most, word >> 10 & most, word & most], -1)
    smaller = (code / most - 0.5) / np.sqrt(0.5)
    q = np.empty((len(word), 4))
    largest = (word >> 30).astype(np.int64)[:, None]
    np.put_along_axis(q, largest, np.sqrt(np.maximum(1 - (smaller**2).sum(-1, keepdims=True), 0)), -1)
    np.put_along_axis(q, (largest + [1, 2, 3]) % 4, smaller, -1)
    return q
