"""Files of the open format .4dgs (`gof.io.fourdgs`) with its temporal model "gaussian-birth", by anybody's encoder."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gof.core.datum import Datum
from gof.core.errors import DataFormatError
from gof.core.gaussians import FILLED_IN, TransientGaussians
from gof.core.harmonics import C0
from gof.io import fourdgs as f
from gof.io.importers.source import Imported, ImportOptions, Source

OPTIONS = ("time_zero_s",)
MOST_BYTES = 1 << 29  # of a stream: a header that says more is damaged
FADE_SIGMAS = 3.0  # a fade is over so far from its middle
ENOUGH = 0.5  # of a share: more Gaussians cut off by their windows than this are no clip of ours


def matches(source: Source) -> bool:
    return source.path.is_file() and source.path.suffix.lower() == ".4dgs"


def read(source: Source, options: ImportOptions) -> Imported:
    scene = _Scene.read(source.path)
    own = scene.library.startswith(f.LIBRARY)
    start_s = options.time_zero_s + (_number(scene.attributes.get(f.START, "0")) if own else 0.0)
    gaussians, notes = scene.gaussians(start_s)
    if not own:
        notes.append(f"its time 0 taken as {start_s:g} s; its world as the dataset's (else gof convert RESULT --align)")
    method = scene.attributes.get(f.SOURCE, "").partition(": ")[0] if own else ""
    return Imported(gaussians, method or "4dgs", source.path, notes)


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError as e:
        raise DataFormatError(f"'{word[:40]}' is no number of seconds") from e


@dataclass
class _Scene:
    """Contents of a file's records, before they become Gaussians."""

    library: str = ""
    count: int = 0
    cutoff: float = 0.05
    duration_s: float = 0.0
    attributes: dict[str, str] = field(default_factory=dict)
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    grid: f.Grid | None = None
    windows: np.ndarray = field(default_factory=lambda: np.zeros((1, 2)))
    to_metres: np.ndarray | None = None  # (4, 4), from the file's frame to ours
    chunks: list[dict[int, np.ndarray]] = field(default_factory=list)
    bands: list[dict[int, np.ndarray]] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> _Scene:
        """Read a file front to back. Raises DataFormatError: damaged, or what `gof` has no Gaussians for."""
        scene, data = cls(), path.read_bytes()
        if data[:8] != f.MAGIC:
            same = data[:5] == f.MAGIC[:5] and data[6:8] == f.MAGIC[6:]
            raise DataFormatError("a .4dgs of another version" if same else "is no .4dgs file (its first bytes differ)")
        seen: set[int] = set()
        try:
            for opcode, content in _records(data):
                if opcode in seen and opcode in (f.HEADER, f.QUANTIZATION, f.WINDOWS, f.FRAME):
                    raise DataFormatError(f"has two records of kind {opcode}, which the format forbids")
                if not seen and opcode != f.HEADER:
                    raise DataFormatError(f"begins with a record of kind {opcode} instead of a header")
                seen.add(opcode)
                scene._take(opcode, content)
        except (struct.error, IndexError, UnicodeDecodeError, zlib.error) as e:
            raise DataFormatError(f"is damaged or cut off ({type(e).__name__}: {e})") from e
        if missing := {f.HEADER, f.QUANTIZATION, f.FOOTER} - seen:
            raise DataFormatError(f"lacks its records of kind {sorted(missing)}: damaged or cut off")
        return scene

    def _take(self, opcode: int, content: bytes) -> None:
        take = _Taker(content)
        if opcode == f.HEADER:
            take.text()
            self.library = take.text()
            self.duration_s, self.count, self.cutoff = take("<dQd")
            model = take.text()
            if model != "gaussian-birth":
                raise DataFormatError(f"has the temporal model '{model}'; only gaussian-birth has velocities")
            if not 0 < self.cutoff <= 1:
                raise DataFormatError(f"has the cutoff {self.cutoff}, which is not in (0, 1]")
            take("<6dBB")
            self.attributes = take.texts()
        elif opcode == f.QUANTIZATION:
            scheme = take.text()
            if scheme != "uniform-v1":
                raise DataFormatError(f"has the quantisation '{scheme}'; only uniform-v1 is known")
            *origin, pos, scale, rot, rgb, alpha, motion, time, sigma, sh = take("<3d8dB")
            self.origin = np.array(origin)
            self.grid = f.Grid(pos, scale, rot, rgb, alpha, motion, time, sigma, sh)
            steps = [*origin, pos, scale, rot, rgb, alpha, motion, time, sigma]
            if not np.isfinite(steps).all() or min(steps[3:]) <= 0:
                raise DataFormatError("has grids that are no positive numbers")
        elif opcode == f.WINDOWS:
            (count,) = take("<I")
            if count:
                self.windows = np.array(take(f"<{2 * count}d")).reshape(count, 2)
        elif opcode == f.FRAME:
            take.text()
            self.to_metres = _to_our_frame(*take("<4Bd"))
        elif opcode == f.CHUNK:
            self._take_chunk(take)
        elif opcode == f.SH_BAND:
            if not self.bands:
                raise DataFormatError("has harmonics before its first chunk")
            (band,) = take("<B")
            if band not in f.BAND_COLUMNS:
                raise DataFormatError(f"has a band {band} of harmonics; there are 1, 2 and 3")
            _, harmonics = take.stream()
            assert harmonics is not None, "all streams are known where none is named"
            self.bands[-1][band] = harmonics
        elif opcode == f.DELTA_CHUNK:
            raise DataFormatError("has chunks of differences, which belong to the model keyframe-delta")
        elif opcode == f.OBJECT_TRACK:
            raise DataFormatError("moves objects along tracks, which are no velocities of Gaussians; they are not read")

    def _take_chunk(self, take: _Taker) -> None:
        *_, count = take("<ddII")
        codec = take.text()
        size, length = take("<QQ")
        body = take.bytes(length)
        if codec:
            codecs = {"deflate": f.DEFLATE, "zstd": f.ZSTD}
            if codec not in codecs:
                raise DataFormatError(f"has a chunk of codec '{codec}'; deflate and zstd are read")
            body = _unpacked(body, codecs[codec], size)
        streams, inner = {}, _Taker(body)
        while inner.at < len(body):
            name, values = inner.stream(f.REQUIRED | f.OURS | {f.OBJECT: 1})
            if values is None:
                continue
            if len(values) != count:
                raise DataFormatError(f"has a stream {name} of {len(values)} elements in a chunk of {count}")
            streams[name] = values
        if count and (missing := sorted(set(f.REQUIRED) - set(streams))):
            raise DataFormatError(f"has a chunk without the streams {missing}")
        if count:
            self.chunks.append(streams)
            self.bands.append({})

    def gaussians(self, start_s: float) -> tuple[TransientGaussians, list[str]]:
        """Return them in our frame and on our clock, and what was assumed."""
        if not self.chunks:
            raise DataFormatError("holds no Gaussian")
        names = set(self.chunks[0])
        if any(set(chunk) - {f.OBJECT} != names - {f.OBJECT} for chunk in self.chunks):
            raise DataFormatError("has chunks with different streams")
        bins = {name: np.concatenate([chunk[name] for chunk in self.chunks]) for name in names - {f.OBJECT}}
        if len(bins[f.POSITION]) != self.count:
            raise DataFormatError(f"announces {self.count} Gaussians and holds {len(bins[f.POSITION])}")
        assert self.grid is not None, "`read` requires its record"
        grid, fades = self.grid, (bins[f.FLAGS][:, 0] & f.NEVER_FADES) == 0
        sigma_bins = bins[f.SIGMA_T][:, 0]
        window = self._windows(bins[f.WINDOW][:, 0])
        span_s = window[:, 1] - window[:, 0]
        with np.errstate(over="ignore"):
            velocity = bins[f.MOTION] * grid.motion_pitch(sigma_bins, fades, span_s, self.cutoff)
            t_sigma = np.where(fades, np.exp(sigma_bins * grid.sigma_log), np.inf)
            t_mu = bins[f.MU_T][:, 0] * grid.time_pitch(sigma_bins, fades)
            scale = np.exp(bins[f.SCALE] * grid.scale_log)
        green, red, blue = bins[f.COLOR].T
        dynamic = fades | (bins[f.MOTION] != 0).any(1)
        if f.MOVING in bins:
            dynamic = bins[f.MOVING][:, 0] != 0
        g = TransientGaussians(
            position=self.origin + bins[f.POSITION] * grid.pos,
            velocity=velocity,
            t_mu=t_mu + start_s,
            t_sigma=t_sigma,
            scale=scale,
            rotation=_quaternions(bins[f.ROTATION_INDEX][:, 0], bins[f.ROTATION] * grid.rot),
            opacity=np.clip(bins[f.OPACITY][:, 0] * grid.alpha, 0, 1),
            color=self._with_harmonics(np.clip(np.stack([red + green, green, blue + green], 1) * grid.rgb, 0, 1)),
            dynamic=dynamic,
            gas_velocity=bins[f.GAS] * f.GAS_PITCH if f.GAS in bins else None,
            velocity_sd=_spread(bins[f.SPREAD][:, 0]) if f.SPREAD in bins else FILLED_IN,
            emissive=self.attributes.get(f.EMISSIVE) == "true",
        )
        notes = self._gates(g, window, start_s)
        if self.to_metres is None:
            notes.append("it says neither its unit nor its axes: taken as metres and Z up")
        elif not np.array_equal(self.to_metres, np.eye(4)):
            g = g.transformed(self.to_metres)
            notes.append("turned to Z up, in metres, from the frame that it declares")
        if f.DATUM in self.attributes:
            words = [_number(word) for word in self.attributes[f.DATUM].split()]
            g = replace(g, datum=Datum.from_numbers(np.array(words), "its attributes"))
        return g, notes

    def _windows(self, index: np.ndarray) -> np.ndarray:
        if len(index) and not (0 <= index.min() and index.max() < len(self.windows)):
            raise DataFormatError(f"has a window number outside its table of {len(self.windows)}")
        return self.windows[index]

    def _gates(self, g: TransientGaussians, window: np.ndarray, start_s: float) -> list[str]:
        """Return a note on Gaussians that windows switch off. Raises DataFormatError: they are most, or never fade.

        Ours fade and have no such switch, so what a window cuts off inside the scene would shine on.
        """
        reach = np.minimum(FADE_SIGMAS, np.sqrt(-2 * np.log(self.cutoff))) * g.t_sigma.astype(np.float64)
        mu = g.t_mu.astype(np.float64) - start_s
        begins = (window[:, 0] > 1e-6) & (window[:, 0] > mu - reach)
        ends = (window[:, 1] < self.duration_s - 1e-6) & (window[:, 1] < mu + reach)
        cut = begins | ends
        if cut.mean() > ENOUGH or (cut & ~np.isfinite(g.t_sigma)).any():
            raise DataFormatError(
                f"switches {cut.sum():,} of {len(g):,} Gaussians on or off by windows inside the scene; ours can only "
                "fade. Write it as a folder of PLYs, one a frame, and give that"
            )
        notes = [f"{cut.sum():,} Gaussians are switched off by windows; here they fade out"] if cut.any() else []
        if self.cutoff > 0.01:
            notes.append(f"it switches off what has faded below {self.cutoff:g}; here that fades out")
        return notes

    def _with_harmonics(self, colour: np.ndarray) -> np.ndarray:
        """Return (N, 3), or coefficients (N, K, 3) where every chunk has the bands of a whole degree."""
        degree = max((max(bands, default=0) for bands in self.bands), default=0)
        if not degree:
            return colour
        if any(set(bands) != set(range(1, degree + 1)) for bands in self.bands):
            raise DataFormatError("has chunks with different bands of harmonics")
        n = len(colour)
        parts = [((colour - 0.5) / C0)[:, None]]
        for band in range(1, degree + 1):
            values = np.concatenate([bands[band] for bands in self.bands])
            if values.shape != (n, 3 * (2 * band + 1)):
                raise DataFormatError(f"has a band {band} of harmonics of shape {values.shape}")
            coefficients = values * (2 * f.SH_REACH / 255) - f.SH_REACH
            parts.append(coefficients.reshape(n, 3, -1).transpose(0, 2, 1))
        return np.concatenate(parts, 1)


def _spread(bins: np.ndarray) -> np.ndarray:
    """Return (N,) m/s, the uncertainty of our own streams."""
    known = bins < f.UNKNOWN_SPREAD
    return np.where(known, np.exp(np.where(known, bins, 0) * f.SPREAD_PITCH), np.inf)


def _quaternions(largest: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return (N, 4) wxyz of the three kept components of xyzw (section 6.4)."""
    if len(largest) and not (0 <= largest.min() and largest.max() <= 3):
        raise DataFormatError("leaves out a component of a rotation that there is not")
    xyzw = np.zeros((len(largest), 4))
    rest = np.clip(rest, -1, 1)
    np.put_along_axis(xyzw, f.REST[largest], rest, 1)
    np.put_along_axis(xyzw, largest[:, None], np.sqrt(np.maximum(1 - (rest**2).sum(1), 0))[:, None], 1)
    return xyzw[:, [3, 0, 1, 2]]


def _to_our_frame(handedness: int, up: int, ahead: int, unit: int, metres: float) -> np.ndarray:
    """Return (4, 4) from a declared frame (section 5.15.2) to Z up, +y ahead, in metres.

    Raises:
        DataFormatError: no basis, mirrored, or of unknown length.
    """
    if max(up, ahead) > 5 or up % 3 == ahead % 3:
        raise DataFormatError(f"declares axes {up} (up) and {ahead} (ahead), which make no frame")
    if handedness == 2:
        raise DataFormatError("has a left-handed world, which a turn does not make ours; mirror it before")
    if not 0 <= metres < np.inf:
        raise DataFormatError(f"declares {metres} metres a unit")
    axis = [np.eye(3)[k % 3] * (1 if k < 3 else -1) for k in range(6)]
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([np.cross(axis[ahead], axis[up]), axis[ahead], axis[up]]) * (metres or 1.0)
    return matrix


# ----------------------------------------------------------------
# Records and streams


class _Taker:
    """Takes values off the front of bytes. Raises struct.error where there are too few."""

    def __init__(self, data: bytes):
        self.data, self.at = data, 0

    def __call__(self, layout: str) -> tuple:
        found = struct.unpack_from(layout, self.data, self.at)
        self.at += struct.calcsize(layout)
        return found

    def bytes(self, count: int) -> bytes:
        """Return the next bytes."""
        if count > len(self.data) - self.at:
            raise struct.error(f"{count} bytes announced, {len(self.data) - self.at} are there")
        self.at += count
        return self.data[self.at - count : self.at]

    def text(self) -> str:
        """Return the next string."""
        return self.bytes(*self("<I")).decode()

    def texts(self) -> dict[str, str]:
        """Return the next map of strings."""
        inner, found = _Taker(self.bytes(*self("<I"))), {}
        while inner.at < len(inner.data):
            name = inner.text()
            found[name] = inner.text()
        return found

    def stream(self, known: dict[int, int] | None = None) -> tuple[int, np.ndarray | None]:
        """Return id and integers (N, channels) of the next attribute stream; None for one that is not known."""
        name, width, mode, codec, channels, count, length = self("<BBBBBIQ")
        body = self.bytes(length)
        if known is not None and known.get(name, 0) == 0:
            return name, None
        if width not in (1, 2, 4) or mode not in (f.RAW, f.DELTA, f.CONSTANT) or not channels:
            raise DataFormatError(f"has a stream {name} of {channels} channels, width {width} and mode {mode}")
        if known is not None and known[name] != channels:
            raise DataFormatError(f"has a stream {name} of {channels} channels, expected {known[name]}")
        symbols = channels if mode == f.CONSTANT else count * channels
        if 8 * count * channels > MOST_BYTES:
            raise DataFormatError(f"has a stream {name} of {count} elements, more than can be")
        if not count:
            return name, np.zeros((0, channels), np.int64)
        planes = np.frombuffer(_unpacked(body, codec, symbols * width), np.uint8).reshape(width, symbols)
        flat = np.ascontiguousarray(planes.T).view(f"<u{width}").reshape(-1).astype(np.int64)
        values = ((flat >> 1) ^ -(flat & 1)).reshape(-1, channels)
        if mode == f.CONSTANT:
            return name, np.repeat(values, count, axis=0)
        return name, np.cumsum(values, axis=0) if mode == f.DELTA else values


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of every record. Raises DataFormatError: the file ends elsewhere than it should."""
    take = _Taker(data)
    take.bytes(len(f.MAGIC))
    opcode = 0
    while opcode != f.FOOTER:
        opcode, length = take("<BQ")
        yield opcode, take.bytes(length)
    if data[take.at :] != f.MAGIC:
        raise DataFormatError("does not end after its footer: damaged, or cut off and written over")


def _unpacked(body: bytes, codec: int, size: int) -> bytes:
    """Return what was packed, of exactly that size."""
    if size > MOST_BYTES:
        raise DataFormatError(f"has a stream of {size} bytes, more than can be")
    if codec == f.DEFLATE:
        plain = zlib.decompressobj().decompress(body, size + 1)
    elif codec == f.ZSTD:
        import zstandard

        try:
            plain = zstandard.ZstdDecompressor().decompress(body, max_output_size=size)
        except zstandard.ZstdError as e:
            raise DataFormatError(f"has a damaged zstd stream ({e})") from e
    else:
        raise DataFormatError(f"has a stream of codec {codec}; deflate and zstd are read (0, 1)")
    if len(plain) != size:
        raise DataFormatError(f"has a stream of {len(plain)} bytes or more where {size} are announced")
    return plain
