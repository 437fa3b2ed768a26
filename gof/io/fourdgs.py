"""The open format .4dgs: one small file of a moving splat scene, whose temporal model "gaussian-birth" is ours.

Written after its specification (github.com/avala-ai/4dgs, version 1 draft; numbers of sections below are its). Every
value is rounded to a grid whose pitch is twice the error that the file declares; integers are then coded in streams.
Arrays without a place in the format (the gas' own velocity and its uncertainty, which Gaussians stand still) go into
streams of the range that it leaves to applications: other readers skip them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import write_bytes
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.core.morton import morton_order

MAGIC = b"\x894DGS1\r\n"  # section 4.1
HEADER, FOOTER, QUANTIZATION, WINDOWS, CHUNK, SH_BAND, INDEX = 1, 2, 3, 4, 5, 7, 8
CAMERA, DELTA_CHUNK, FRAME, OBJECT_TRACK = 0x0A, 0x10, 0x20, 0x25
RECORD = struct.Struct("<BQ")  # opcode, length of the content
STREAM = struct.Struct("<BBBBBIQ")  # id, bytes of a symbol, mode, codec, channels, elements, length of the payload
RAW, DELTA, CONSTANT = 0, 1, 2  # modes
DEFLATE, ZSTD = 0, 1  # codecs
# Streams: those that every chunk has, with their channels, and ours of the private range.
POSITION, SCALE, ROTATION_INDEX, ROTATION, COLOR, OPACITY, MOTION, MU_T, SIGMA_T, FLAGS, WINDOW, OBJECT = *range(11), 14
REQUIRED = {POSITION: 3, SCALE: 3, ROTATION_INDEX: 1, ROTATION: 3, COLOR: 3, OPACITY: 1, MOTION: 3, MU_T: 1}
REQUIRED |= {SIGMA_T: 1, FLAGS: 1, WINDOW: 1}
GAS, SPREAD, MOVING = 64, 65, 66
OURS = {GAS: 3, SPREAD: 1, MOVING: 1}
UNKNOWN_SPREAD = 1 << 20  # bin of an infinite uncertainty
LEAST_SPREAD = 1e-6  # m/s; a smaller one is written as this
BAND_COLUMNS = {1: (1, 4), 2: (4, 9), 3: (9, 16)}  # coefficients of a band of harmonics
SH_REACH = 4.0  # coefficients are bytes over [-4, 4]
NEVER_FADES = 1  # bit of FLAGS
LIBRARY = "gaussians-on-fire"
POSITION_SHARE = 0.1  # pitch of places, of the median size
GAS_PITCH, SPREAD_PITCH = 0.05, 0.1  # m/s, and of the logarithm; the gas is known to some 0.5 m/s
CUTOFF = 1 / 255  # of the fade: what is fainter no 8-bit picture shows
START, DATUM, EMISSIVE, SOURCE = "gof_start_s", "gof_datum", "gof_emissive", "source"  # keys of the header's attributes


@dataclass(frozen=True)
class Grid:
    """Pitches of the grids (section 5.3), each twice the error that is allowed.

    Attributes:
        pos: m.   scale_log, sigma_log: of the natural logarithm.   rot: of a quaternion's component.
        rgb, alpha: of [0, 1].   motion: m/s, of a Gaussian that is seen for half a second.   time: s.   sh: of bytes.
    """

    pos: float
    scale_log: float = 2 * np.log1p(0.03)
    rot: float = 0.02
    rgb: float = 3 / 255
    alpha: float = 2 / 255
    motion: float = 0.008
    time: float = 0.0004
    sigma_log: float = 2 * np.log1p(0.01)
    sh: int = 1

    def bounds(self) -> dict[str, str]:
        """Return the greatest errors by the names that the format has for them."""
        found = {
            "pos": self.pos / 2,
            "scale_rel": np.expm1(self.scale_log / 2),
            "rot": self.rot / 2,
            "rgb": self.rgb / 2,
            "alpha": self.alpha / 2,
            "motion": self.motion / 2,
            "time": self.time / 2,
            "sigma_rel": np.expm1(self.sigma_log / 2),
        }
        return {name: repr(float(value)) for name, value in found.items()} | {"sh": str(self.sh // 2)}

    def motion_pitch(self, sigma_bins: np.ndarray, fades: np.ndarray, span_s: np.ndarray, cutoff: float) -> np.ndarray:
        """Return (N, 1) m/s: what is seen shortly may be faster by mistake, for it goes no farther (section 6.3)."""
        half = np.where(fades, np.sqrt(-2 * np.log(cutoff)) * np.exp(sigma_bins * self.sigma_log), span_s)
        life = np.clip(np.ceil(np.log2(np.clip(half, 0.02, 2.0) / 0.5)), -4, 2)
        return (self.motion * 2.0**-life)[:, None]

    def time_pitch(self, sigma_bins: np.ndarray, fades: np.ndarray) -> np.ndarray:
        """Return (N,) s: at most a twentieth of the Gaussian's own t_sigma (section 6.3)."""
        target = np.where(fades, np.minimum(self.time, 0.05 * np.exp(sigma_bins * self.sigma_log)), self.time)
        return self.time * 2.0 ** np.clip(np.floor(np.log2(target / self.time)), -10, 0)


def save(gaussians: TransientGaussians, path: Path, start_s: float, end_s: float, source: str) -> np.ndarray:
    """Write a .4dgs; returns (N,) in which order the Gaussians are in it.

    Args:
        start_s, end_s: first and last second of the clip on the dataset clock; the file's clock starts at the first.
            Light of another time is in the file, but no other program shows it.
        source: what the result was made from, in words; `gof.io.importers` reads it again.
    Raises:
        DataFormatError: no Gaussian, an empty clip, or values so far apart that the grids have no integers for them.
    """
    if not len(gaussians) or not end_s > start_s:
        raise DataFormatError(f"{path}: {len(gaussians)} Gaussians from {start_s:g} s to {end_s:g} s make no .4dgs")
    order = morton_order(gaussians.position)
    g, duration_s = gaussians[order], end_s - start_s
    grid = Grid(pos=POSITION_SHARE * float(np.median(g.scale)))
    origin = g.position.min(0).astype(np.float64)
    streams, bands = _bins(g, grid, origin, start_s, duration_s)
    facts = {START: repr(float(start_s)), SOURCE: source, "color_space": "srgb-rec709-display", "application": LIBRARY}
    if g.datum:
        facts[DATUM] = " ".join(repr(float(number)) for number in g.datum.numbers())
    if g.emissive:
        facts[EMISSIVE] = "true"
    low, high = origin.tolist(), g.position.max(0).tolist()
    windows = struct.pack("<Idd", 1, 0.0, duration_s)
    try:
        coded = b"".join(encode_stream(name, values) for name, values in streams.items())
        band_records = {band: record(SH_BAND, bytes([band]) + encode_stream(SH_BAND, v)) for band, v in bands.items()}
    except OverflowError as e:
        raise DataFormatError(f"{path}: {e}; move the result near zero, or leave out what lies far away") from e
    head = b"".join([
        MAGIC,
        record(HEADER, b"".join([
            text("baked"), text(LIBRARY), struct.pack("<dQd", duration_s, len(g), CUTOFF),
            text("gaussian-birth"), struct.pack("<6dBB", *low, *high, max(bands, default=0), 0), texts(facts),
        ])),
        record(QUANTIZATION, b"".join([
            text("uniform-v1"),
            struct.pack("<3d8dB", *origin, grid.pos, grid.scale_log, grid.rot, grid.rgb, grid.alpha, grid.motion,
                        grid.time, grid.sigma_log, grid.sh),
            texts(grid.bounds()),
        ])),
        record(WINDOWS, windows),
        record(FRAME, text("") + struct.pack("<4Bd", 1, 2, 1, 1, 1.0)),  # right-handed, +z up, +y ahead, metres
    ])  # fmt: skip
    chunk = record(CHUNK, struct.pack("<ddII", 0.0, duration_s, 0, len(g)) + text("")
                   + struct.pack("<QQ", len(coded), len(coded)) + coded)  # fmt: skip
    places, at = [], len(head) + len(chunk)
    for band, content in band_records.items():
        places.append(struct.pack("<BQQ", band, at, len(content)))
        at += len(content)
    index = record(INDEX, struct.pack("<ddQQII", 0.0, duration_s, len(head), len(chunk), len(g), len(places))
                   + b"".join(places))  # fmt: skip
    footer = record(FOOTER, struct.pack("<QQI", at, 0, zlib.crc32(index)))
    write_bytes(path, b"".join([head, chunk, *band_records.values(), index, footer, MAGIC]))
    return order


def losses(g: TransientGaussians) -> list[str]:
    """Return what a .4dgs of these cannot hold, in words."""
    colour = 0.5 + C0 * g.color[:, 0] if g.color.ndim == 3 else g.color
    outside = ((colour < 0) | (colour > 1)).any(-1)
    notes = []
    if outside.any():
        notes.append(f"colours of {outside.sum():,} of {len(g):,} Gaussians are clipped to [0, 1]")
    if g.color.ndim == 3 and (clipped := (np.abs(g.color[:, 1:]) > SH_REACH).any((1, 2))).any():
        notes.append(f"colours that change with the direction are clipped for {clipped.sum():,} Gaussians")
    return notes


def _bins(
    g: TransientGaussians, grid: Grid, origin: np.ndarray, start_s: float, duration_s: float
) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]]:
    """Return the integers of each stream, and those of the bands of harmonics."""
    fades = g.dynamic & np.isfinite(g.t_sigma)
    velocity = np.where(g.dynamic[:, None], g.velocity, 0).astype(np.float64)
    sigma = _rounded(np.log(np.where(fades, g.t_sigma, 1.0).astype(np.float64)), grid.sigma_log)
    born = np.where(g.dynamic, g.t_mu.astype(np.float64) - start_s, 0.0)
    pitch = grid.motion_pitch(sigma, fades, np.full(len(g), duration_s), CUTOFF)
    largest, rest = _smallest_three(g.rotation[:, [1, 2, 3, 0]])
    colour = 0.5 + C0 * g.color[:, 0] if g.color.ndim == 3 else g.color
    red, green, blue = _rounded(np.clip(colour, 0, 1), grid.rgb).T
    streams = {
        POSITION: _rounded(g.position - origin, grid.pos),
        SCALE: _rounded(np.log(g.scale.astype(np.float64)), grid.scale_log),
        ROTATION_INDEX: largest,
        ROTATION: _rounded(rest, grid.rot),
        COLOR: np.stack([green, red - green, blue - green], 1),
        OPACITY: _rounded(g.opacity, grid.alpha),
        MOTION: _rounded(velocity, pitch),
        MU_T: _rounded(born, grid.time_pitch(sigma, fades)),
        SIGMA_T: sigma,
        FLAGS: np.where(fades, 0, NEVER_FADES),
        WINDOW: np.zeros(len(g), np.int64),
    }
    if g.gas_velocity is not None:
        streams[GAS] = _rounded(g.gas_velocity.astype(np.float64), GAS_PITCH)
    if np.isfinite(g.velocity_sd).any():
        known = np.isfinite(g.velocity_sd)
        spread = np.log(np.maximum(np.where(known, g.velocity_sd, 1), LEAST_SPREAD).astype(np.float64))
        streams[SPREAD] = np.where(known, _rounded(spread, SPREAD_PITCH), UNKNOWN_SPREAD)
    seen_to_move = fades | streams[MOTION].any(1)  # what a reader takes to be dynamic
    if not np.array_equal(g.dynamic, seen_to_move):
        streams[MOVING] = g.dynamic.astype(np.int64)
    bands = {}
    for band, (first, end) in BAND_COLUMNS.items():
        if g.color.ndim == 3 and g.color.shape[1] >= end:
            values = np.clip((g.color[:, first:end] + SH_REACH) * (255 / (2 * SH_REACH)), 0, 255)
            bands[band] = np.rint(values).astype(np.int64).transpose(0, 2, 1).reshape(len(g), -1)
    return streams, bands


def _rounded(values: np.ndarray, pitch: float | np.ndarray) -> np.ndarray:
    return np.rint(np.asarray(values, np.float64) / pitch).astype(np.int64)


REST = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # components that are kept, by the one left out


def _smallest_three(xyzw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of each quaternion's greatest component, and the three others where that one is positive."""
    largest = np.abs(xyzw).argmax(1)
    sign = np.sign(np.take_along_axis(xyzw, largest[:, None], 1))
    return largest, np.take_along_axis(xyzw * np.where(sign == 0, 1, sign), REST[largest], 1)


# ----------------------------------------------------------------
# Records and streams


def text(value: str) -> bytes:
    """Return a string as the format has it."""
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def texts(values: Mapping[str, str]) -> bytes:
    """Return a map of strings as the format has it."""
    body = b"".join(text(name) + text(value) for name, value in sorted(values.items()))
    return struct.pack("<I", len(body)) + body


def record(opcode: int, content: bytes) -> bytes:
    """Return a record with its frame (section 4.2)."""
    return RECORD.pack(opcode, len(content)) + content


def encode_stream(name: int, values: np.ndarray) -> bytes:
    """Return an attribute stream (section 5.6) of integers (N,) or (N, channels), in the smallest of its modes.

    Raises:
        OverflowError: an integer or a step to the next one needs more than 32 bits.
    """
    values = np.asarray(values, np.int64).reshape(len(values), -1)
    count, channels = values.shape
    if (values == values[:1]).all():
        width, body = _packed(values[0])
        return STREAM.pack(name, width, CONSTANT, DEFLATE, channels, count, len(body)) + body
    coded = {RAW: _packed(values), DELTA: _packed(np.diff(values, axis=0, prepend=0 * values[:1]))}
    mode = min(coded, key=lambda kind: len(coded[kind][1]))
    width, body = coded[mode]
    return STREAM.pack(name, width, mode, DEFLATE, channels, count, len(body)) + body


def _packed(values: np.ndarray) -> tuple[int, bytes]:
    """Return bytes of a symbol, and the symbols: without sign, plane by plane, deflated."""
    flat = values.reshape(-1)
    symbols = ((flat << 1) ^ (flat >> 63)).astype(np.uint64)
    most = int(symbols.max(initial=0))
    width = next((w for w in (1, 2, 4) if most < 256**w), 0)
    if not width:
        raise OverflowError("values span more than 32 bits of their grids")
    planes = symbols.astype(f"<u{width}").view(np.uint8).reshape(-1, width).T
    return width, zlib.compress(np.ascontiguousarray(planes).tobytes(), 6)
