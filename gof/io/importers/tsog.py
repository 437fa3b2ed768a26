"""TSOG files (`gof.io.tsog`) with a continuous timeline, by anybody's encoder: of its Playback Profile 1, or before."""

from __future__ import annotations

import io
import json
import warnings
import zipfile
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
from PIL import Image

from gof.core.datum import Datum
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import FILLED_IN, TransientGaussians
from gof.core.harmonics import C0
from gof.core.similarity import Y_UP
from gof.io import tsog as t
from gof.io.importers.source import Imported, ImportOptions, Source

OPTIONS = ("time_unit_s", "time_zero_s")
MOST_ENTRIES, MOST_BYTES, MOST_METADATA = 1024, 1 << 29, 1 << 22  # of the specification
LOSSLESS = (b"VP8L", b"VP8X")
USUAL_FRAMES, USUAL_FPS = 300, 30.0  # of a clip that does not say how long it lasts


def matches(source: Source) -> bool:
    return source.path.is_file() and source.path.suffix.lower() == t.SUFFIX


def read(source: Source, options: ImportOptions) -> Imported:
    try:
        with zipfile.ZipFile(source.path) as archive, np.errstate(over="ignore"):  # what is too large is named later
            if len(archive.infolist()) > MOST_ENTRIES:
                raise DataFormatError(f"holds more than {MOST_ENTRIES} files")
            meta = json.loads(_entry(archive, "meta.json", MOST_METADATA).decode())
            gaussians, notes = _gaussians(_PictureReader(archive, meta), meta, options)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, OSError, RuntimeError) as e:
        raise DataFormatError(f"is no .tsog file, or damaged ({e})") from e
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError, OverflowError) as e:
        if isinstance(e, GofError):
            raise
        raise DataFormatError(f"has metadata that do not fit the format ({type(e).__name__}: {e})") from e
    own = meta.get("gof") or {}
    return Imported(gaussians, str(own.get("source", "")).partition(": ")[0] or "tsog", source.path, notes)


def _gaussians(
    pictures: _PictureReader, meta: dict[str, Any], options: ImportOptions
) -> tuple[TransientGaussians, list[str]]:
    """Return them on our clock, Z up, and what was assumed."""
    own, notes = meta.get("gof") or {}, []
    start_s = options.time_zero_s + float(own.get("start_s", 0))
    clip_s, assumption = _clip_s(meta, options)
    if not own:
        notes += [f"its times 0..1 taken as {start_s:g} to {start_s + clip_s:g} s{assumption}"]
        notes += ["its world taken as y up, in metres, and turned to Z up (else gof convert RESULT --align)"]
    place = pictures.pair(meta["means"], 3)
    middle, width = pictures.pair(meta["timeline"], 2).T
    if not width.min() > 0:
        raise DataFormatError("has a width in time that is not above 0")
    always = width >= 0.999 * float(own.get("always", np.inf))
    velocity = np.zeros_like(place)
    if "temporal" in meta:
        if set(meta["temporal"]) != {"means"} or len(meta["temporal"]["means"]["mins"]) != 1:
            raise DataFormatError("moves otherwise than evenly, which gof has no Gaussians for")
        moves = meta["temporal"]["means"]
        velocity = pictures.pair(moves | {"mins": moves["mins"][0], "maxs": moves["maxs"][0]}, 3)
    base = pictures.one(meta["sh0"]["files"][0])
    flags = pictures.one(own["files"][0]) if own else None
    g = TransientGaussians(
        position=np.sign(place) * np.expm1(np.abs(place)),
        velocity=velocity / clip_s,
        t_mu=middle * clip_s + start_s,
        t_sigma=np.where(always, np.inf, width * clip_s),
        scale=np.exp(_looked_up(meta["scales"]["codebook"], pictures.one(meta["scales"]["files"][0])[:, :3])),
        rotation=_quaternions(pictures.one(meta["quats"]["files"][0])),
        opacity=base[:, 3] / 255,
        color=_colour(pictures, meta, _looked_up(meta["sh0"]["codebook"], base[:, :3])),
        dynamic=np.ones(len(place), bool) if flags is None else flags[:, 1] != 0,
        gas_velocity=pictures.pair(own["gas"], 3) if "gas" in own else None,
        velocity_sd=FILLED_IN if flags is None else _spread(flags[:, 0]),
        emissive=own.get("emissive") is True,
    )
    if flags is not None:
        g = replace(g, velocity=np.where(g.dynamic[:, None], g.velocity, 0))
    g = g.transformed(np.linalg.inv(Y_UP))
    return replace(g, datum=Datum.from_numbers(own["datum"], "its metadata")) if "datum" in own else g, notes


def _clip_s(meta: dict[str, Any], options: ImportOptions) -> tuple[float, str]:
    """Return seconds of the clip, and where they are from. Raises DataFormatError: no moving splats, or unknown ones.

    A clip that says nothing lasts as long as the format's players let it.
    """
    profile = meta.get("profile", t.PROFILE)
    if meta["version"] != t.VERSION or {name: profile.get(name) for name in t.PROFILE} != t.PROFILE:
        raise DataFormatError("is a .tsog of a version or profile that gof does not know")
    timeline = meta.get("timeline")
    if timeline is None or timeline.get("type") != t.CONTINUOUS:
        raise DataFormatError(
            "stands still or shows one frame after another, and so has no velocities. Write it as a folder of PLYs, "
            "one a frame, and give that"
        )
    if options.time_unit_s is not None:
        return options.time_unit_s, ""
    playback = meta.get("playback") or {}
    fps = playback.get("fps", meta.get("fps", USUAL_FPS))
    clip_s = float(playback.get("duration", (USUAL_FRAMES - 1) / fps))
    if not 0 < clip_s < np.inf:
        raise DataFormatError(f"says that it lasts {clip_s} s")
    without = ", as its players do for want of a duration (else gof convert RESULT --time-unit)"
    return clip_s, "" if "duration" in playback else without


class _PictureReader:
    """Pictures of an archive, as the codes of their pixels."""

    def __init__(self, archive: zipfile.ZipFile, meta: dict[str, Any]):
        self.archive, self.count = archive, meta["count"]
        self.size: tuple[int, ...] | None = None  # of the pictures, once one is read
        if not isinstance(self.count, int) or not 0 < self.count <= t.SIDE**2:
            raise DataFormatError(f"announces {self.count!r:.40} Gaussians")

    def one(self, name: str) -> np.ndarray:
        """Return (N, 4) codes of the Gaussians."""
        pixels = self.whole(name)
        self.size = self.size or pixels.shape
        if pixels.shape != self.size or pixels.shape[0] * pixels.shape[1] < self.count:
            raise DataFormatError(f"has a picture {name!r:.40} of {pixels.shape[1]} x {pixels.shape[0]} px")
        return pixels.reshape(-1, 4)[: self.count]

    def whole(self, name: str) -> np.ndarray:
        """Return (H, W, 4) codes of a picture."""
        data = _entry(self.archive, name, MOST_BYTES)
        if data[8:12] != b"WEBP" or data[12:16] not in LOSSLESS:
            raise DataFormatError(f"has a picture {name!r:.40} that is no lossless WebP")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                with Image.open(io.BytesIO(data), formats=["WEBP"]) as picture:
                    return np.asarray(picture.convert("RGBA"))
        except (Image.DecompressionBombWarning, Image.DecompressionBombError, SyntaxError) as e:
            raise DataFormatError(f"has a picture {name!r:.40} that cannot be read ({e})") from e

    def pair(self, group: dict[str, Any], channels: int) -> np.ndarray:
        """Return (N, channels) values between the group's bounds, of two pictures of bytes, or of one."""
        low, high = (np.array(group[name], np.float64).reshape(channels) for name in ("mins", "maxs"))
        if not np.isfinite([low, high]).all() or (low > high).any():
            raise DataFormatError("has bounds that are no numbers, or the wrong way round")
        codes = [self.one(name)[:, :channels].astype(np.int64) for name in group["files"]]
        return low + (high - low) * sum(256**k * part for k, part in enumerate(codes)) / (256 ** len(codes) - 1)


def _entry(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Return a file of the archive. Raises DataFormatError: it is absent or too large."""
    try:
        info = archive.getinfo(name)
    except KeyError as e:
        raise DataFormatError(f"lacks the file {name!r:.40}") from e
    if info.file_size > most:
        raise DataFormatError(f"has a file {name!r:.40} of {info.file_size} bytes")
    return archive.read(info)


def _looked_up(codebook: list[float], codes: np.ndarray) -> np.ndarray:
    book = np.array(codebook, np.float64)
    if book.ndim != 1 or not np.isfinite(book).all() or codes.max(initial=0) >= len(book):
        raise DataFormatError("has a codebook that is no list of numbers, or lacks entries that are used")
    return book[codes]


def _quaternions(codes: np.ndarray) -> np.ndarray:
    """Return (N, 4) wxyz of the three kept components."""
    largest = codes[:, 3].astype(np.int64) - t.LEFT_OUT
    if largest.min() < 0:
        raise DataFormatError("leaves out a component of a rotation that there is not")
    rest = (codes[:, :3] / 127.5 - 1) / np.sqrt(2)
    wxyz = np.empty((len(codes), 4))
    wxyz[np.arange(4) != largest[:, None]] = rest.reshape(-1)
    np.put_along_axis(wxyz, largest[:, None], np.sqrt(np.maximum(1 - (rest**2).sum(1), 0))[:, None], 1)
    return wxyz


def _colour(pictures: _PictureReader, meta: dict[str, Any], base: np.ndarray) -> np.ndarray:
    """Return (N, 3) display colours, or coefficients (N, K, 3) where there are more."""
    if "shN" not in meta:
        return 0.5 + C0 * base
    group = meta["shN"]
    size = (int(group["bands"]) + 1) ** 2 - 1
    centroids, label = pictures.whole(group["files"][0]), pictures.one(group["files"][1]).astype(np.int64)
    label = label[:, 0] + 256 * label[:, 1]
    if centroids.shape[1] != t.PALETTE_ROW * size or label.max() >= group["count"]:
        raise DataFormatError("has colours by direction whose pictures do not fit")
    rest = _looked_up(group["codebook"], centroids.reshape(-1, size, 4)[label, :, :3])
    return np.concatenate([base[:, None], rest], 1)


def _spread(codes: np.ndarray) -> np.ndarray:
    """Return (N,) m/s, the uncertainty of our own pictures."""
    share = codes.astype(np.float64) / (t.UNKNOWN - 1)
    return np.where(codes < t.UNKNOWN, t.LEAST_SPREAD * (t.MOST_SPREAD / t.LEAST_SPREAD) ** share, np.inf)
