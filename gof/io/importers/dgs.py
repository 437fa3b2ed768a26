"""Files of Dynamic Gaussian Splats (`gof.io.dgs`), version 1.1, by anybody's encoder."""

from __future__ import annotations

import struct

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.core.similarity import Y_UP
from gof.io import dgs as d
from gof.io.importers.source import Imported, ImportOptions, Source

OPTIONS = ("time_unit_s", "time_zero_s")
MOST_DEGREE = 3


def matches(source: Source) -> bool:
    return source.path.is_file() and source.path.suffix.lower() == d.SUFFIX


def read(source: Source, options: ImportOptions) -> Imported:
    data = source.path.read_bytes()
    try:
        magic, version, said_s, count, moves, degree, *bounds = d.HEADER.unpack_from(data)
    except struct.error as e:
        raise DataFormatError(f"is no .dgs file, or cut off ({e})") from e
    if magic != d.MAGIC:
        raise DataFormatError("is no .dgs file (its first bytes differ)")
    if not d.FIRST_VERSION <= version < d.END_VERSION:
        raise DataFormatError(f"is a .dgs of version {version >> 22}.{version >> 12 & 1023}; gof reads 1.1")
    if not moves:
        raise DataFormatError("stands still, and so has no velocities")
    clip_s = said_s if options.time_unit_s is None else options.time_unit_s
    if not 0 < clip_s < np.inf:
        raise DataFormatError("does not say how long it lasts: gof convert RESULT --time-unit, the seconds of its clip")
    if degree > MOST_DEGREE or not np.isfinite(bounds).all() or any(low > high for low, high in _pairs(bounds, degree)):
        raise DataFormatError("has a header that makes no sense: damaged")
    coefficients = (degree + 1) ** 2 - 1
    layout = [("mean", "<f4", 4), ("size", "<u2", 3), ("turn", "<u2", 3), ("alpha", "u1", 1), ("colour", "<u2", 3)]
    layout += [("rest", "u1", 3 * coefficients)] * (degree > 0) + [("moves", "<f4", 4)]
    if not count or len(data) != d.HEADER.size + count * sum(np.dtype(k).itemsize * n for _, k, n in layout):
        raise DataFormatError(f"announces {count} Gaussians and is {len(data)} bytes long: damaged or cut off")
    columns, at = {}, d.HEADER.size
    for name, kind, width in layout:
        columns[name] = np.frombuffer(data, kind, count * width, at).reshape(count, width).astype(np.float64)
        at += columns[name].size * np.dtype(kind).itemsize
    start_s = options.time_zero_s
    notes = [
        f"its times 0..1 taken as {start_s:g} to {start_s + clip_s:g} s"
        " (else gof convert RESULT --time-zero, --time-unit)",
        "its world taken as y up, in metres, and turned to Z up (else gof convert RESULT --align)",
    ]
    return Imported(_gaussians(columns, bounds, start_s, clip_s), "dgs", source.path, notes)


def _pairs(bounds: list[float], degree: int) -> list[tuple[float, float]]:
    """Return the least and the greatest of sizes, colours and, where there are any, harmonics."""
    return list(zip(bounds[::2], bounds[1::2], strict=True))[: 3 if degree else 2]


def _gaussians(
    columns: dict[str, np.ndarray], bounds: list[float], start_s: float, clip_s: float
) -> TransientGaussians:
    size = _between(columns["size"], d.WORDS, *bounds[:2])
    colour = 0.5 + C0 * (base := _between(columns["colour"], d.WORDS, *bounds[2:4]))
    if "rest" in columns:
        rest = _between(columns["rest"], d.BYTES, *bounds[4:])
        colour = np.concatenate([base[:, None], rest.reshape(len(rest), -1, 3)], 1)
    xyz = 2 * columns["turn"] / d.WORDS - 1
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(1), 0))
    middle, width = columns["mean"][:, 3], columns["moves"][:, 3]
    velocity = columns["moves"][:, :3]
    always = (width <= 0) | (width >= 0.1 * d.FOREVER)  # 0: of still ones that were put together with moving ones
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is named later
        g = TransientGaussians(
            position=columns["mean"][:, :3] + velocity * middle[:, None],
            velocity=velocity / clip_s,
            t_mu=middle * clip_s + start_s,
            t_sigma=np.where(always, np.inf, width * clip_s),
            scale=np.exp(size),
            rotation=np.column_stack([w, xyz]),
            opacity=columns["alpha"][:, 0] / d.BYTES,
            color=colour,
            dynamic=~always | velocity.any(1),
        )
    return g.transformed(np.linalg.inv(Y_UP))


def _between(codes: np.ndarray, most: int, low: float, high: float) -> np.ndarray:
    return low + (high - low) * codes / most
