"""TSOG (.tsog): moving splats in lossless WebP pictures in a ZIP, by the Playback Profile 1 of its specification.

Its model is ours: places at the time of greatest opacity, even motion, a Gaussian fade; time runs from 0 to 1 over the
clip. Every value is a number of 8 or 16 bits between the least and the greatest. Y is up, as its players expect. What
the format has no place for (the gas' own velocity and its uncertainty, which Gaussians stand still, the clock, whether
they are emissive) stands in a member "gof" of its metadata and in pictures that other readers leave aside.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gof.core.errors import DataFormatError, require_finite
from gof.core.files import atomic_path
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.core.morton import morton_order
from gof.core.similarity import Y_UP

SUFFIX = ".tsog"
VERSION, PROFILE = 4, {"id": "org.opsiclear.tsog-playback", "version": 1}
CONTINUOUS = 1  # type of the timeline
MOST = 65535  # steps of 16 bits
SIDE = 16_384  # px; the most of a WebP
PALETTE, PALETTE_ROW = 65_536, 64  # harmonics: how many sets there may be, and how many a row of their picture has
LEFT_OUT = 252  # alpha of a rotation whose first component (w) is left out
UNFADED = np.sqrt(-2 * np.log(1 - 1 / 510))  # std-devs from a life's middle, where opacity of 8 bits is the same
ALWAYS = 8.0  # widths in clips from which nothing is seen to fade within one
UNKNOWN = 255  # an infinite uncertainty; others are logarithms between LEAST and MOST_SPREAD
LEAST_SPREAD, MOST_SPREAD = 1e-3, 1e3  # m/s
FPS = 60


def save(gaussians: TransientGaussians, path: Path, start_s: float, end_s: float, source: str) -> np.ndarray:
    """Write a .tsog; returns (N,) in which order the Gaussians are in it.

    Args:
        start_s, end_s: first and last second of the clip on the dataset clock: times 0 and 1 of the file.
        source: what the result was made from, in words; `gof.io.importers` reads it again.
    Raises:
        DataFormatError: no Gaussian, more than a picture holds, or an empty clip.
        NonFiniteError: a value is beyond a float32.
    """
    if not 0 < len(gaussians) <= SIDE**2 or not end_s > start_s:
        raise DataFormatError(f"{path}: {len(gaussians)} Gaussians from {start_s:g} s to {end_s:g} s make no .tsog")
    order = morton_order(gaussians.position)
    g, clip_s = gaussians[order].transformed(Y_UP), end_s - start_s
    farthest = np.maximum(np.abs(g.t_mu - start_s), np.abs(end_s - g.t_mu)).astype(np.float64)
    always = ~g.dynamic | (farthest < g.t_sigma * UNFADED)  # one long life would take the digits of all others
    width = np.where(always, 1, g.t_sigma.astype(np.float64)) / clip_s
    forever = max(ALWAYS, 2 * width[~always].max(initial=0))
    width[always] = forever
    middle = np.where(always, 0.5, (g.t_mu.astype(np.float64) - start_s) / clip_s)
    at_middle = np.where((g.dynamic & always)[:, None], (0.5 * clip_s + start_s - g.t_mu)[:, None] * g.velocity, 0)
    place = g.position.astype(np.float64) + at_middle
    velocity = np.where(g.dynamic[:, None], g.velocity.astype(np.float64), 0) * clip_s
    for name, values in (("velocity", velocity), ("t_mu", middle), ("t_sigma", width)):
        require_finite(name, values.astype(np.float32), "a TSOG of float32")
    sh = (g.color[:, None] - 0.5) / C0 if g.color.ndim == 2 else g.color
    pictures = _PictureWriter(len(g))
    meta: dict[str, Any] = {
        "version": VERSION,
        "profile": PROFILE,
        "count": len(g),
        "means": pictures.pair("means", np.sign(place) * np.log1p(np.abs(place))),
        "scales": pictures.codebook("scales", np.log(g.scale.astype(np.float64))),
        "quats": pictures.one("quats", _smallest_three(g.rotation.astype(np.float64))),
        "sh0": pictures.codebook("sh0", sh[:, 0].astype(np.float64), np.rint(255 * g.opacity)),
        "timeline": {"type": CONTINUOUS} | pictures.pair("timeline", np.stack([middle, width], 1)),
        "playback": {"duration": float(clip_s), "fps": FPS},
    }
    moves = pictures.pair("velocity", velocity)
    meta["temporal"] = {"means": moves | {"mins": [moves["mins"]], "maxs": [moves["maxs"]]}}
    if sh.shape[1] > 1:
        meta["shN"] = pictures.harmonics(sh[:, 1:].astype(np.float64))
    own: dict[str, Any] = {"start_s": float(start_s), "source": source, "always": float(forever)}
    if gaussians.datum:
        own["datum"] = gaussians.datum.numbers().tolist()
    if gaussians.emissive:
        own["emissive"] = True
    if g.gas_velocity is not None:
        own["gas"] = pictures.pair("gas", g.gas_velocity.astype(np.float64))
    flags = np.stack([_spread_codes(g.velocity_sd), np.where(g.dynamic, 1, 0)], 1)
    own |= pictures.one("gof", flags)
    meta["gof"] = own
    with atomic_path(path) as draft, zipfile.ZipFile(draft, "w") as archive:
        for name, data in {"meta.json": json.dumps(meta, allow_nan=False).encode(), **pictures.files}.items():
            archive.writestr(zipfile.ZipInfo(name), data)  # the same file whenever it is written
    return order


def losses(g: TransientGaussians) -> list[str]:
    """Return what a .tsog of these cannot hold, in words."""
    notes = ["axes are the format's: x to the right, y up, z backwards; (x, y, z) of ours is (x, z, -y) there"]
    if g.color.ndim == 3 and g.color.shape[1] > 1 and len(g) > PALETTE:
        notes.append(f"colours that change with the direction are rounded to fit into {PALETTE:,} sets")
    return notes


class _PictureWriter:
    """The pictures of a file: a pixel a Gaussian, row by row."""

    def __init__(self, count: int):
        self.files: dict[str, bytes] = {}
        self.count = count
        self.width = min(SIDE, int(np.ceil(np.sqrt(count))))
        self.height = -(-count // self.width)

    def one(self, name: str, codes: np.ndarray, size: tuple[int, int] | None = None) -> dict[str, Any]:
        """Add (N, up to 4) codes of 8 bits as one picture; returns the metadata's "files"."""
        width, height = size or (self.width, self.height)
        pixels = np.zeros((width * height, 4), np.uint8)
        pixels[:, 3] = 255
        pixels[: len(codes), : codes.shape[1]] = codes
        data = io.BytesIO()
        picture = Image.fromarray(pixels.reshape(height, width, 4))
        picture.save(data, "WEBP", lossless=True, exact=True, quality=60, method=4)  # exact: colours at alpha 0 too
        self.files[f"{name}.webp"] = data.getvalue()
        return {"files": [f"{name}.webp"]}

    def pair(self, name: str, values: np.ndarray) -> dict[str, Any]:
        """Add (N, up to 3) values as 16 bits between their bounds, in two pictures: the low and the high bytes."""
        low, high = values.min(0), values.max(0)
        codes = np.rint((values - low) / np.where(high > low, high - low, 1) * MOST).astype(np.int64)
        files = [*self.one(f"{name}_l", codes % 256)["files"], *self.one(f"{name}_u", codes // 256)["files"]]
        return {"mins": low.tolist(), "maxs": high.tolist(), "files": files}

    def codebook(self, name: str, values: np.ndarray, alpha: np.ndarray | None = None) -> dict[str, Any]:
        """Add (N, 3) values as the nearest of 256 even steps, with a fourth channel that is bytes already."""
        book, codes = _even_steps(values, 256)
        codes = codes if alpha is None else np.column_stack([codes, alpha])
        return {"codebook": book.tolist()} | self.one(name, codes)

    def harmonics(self, sh: np.ndarray) -> dict[str, Any]:
        """Add (N, K, 3) coefficients as numbers of a palette: in fewer steps until there are few enough sets."""
        for steps in (256, 128, 64, 32, 16, 8, 4, 2, 1):
            book, codes = _even_steps(sh, steps)
            sets, label = np.unique(codes.reshape(len(sh), -1), axis=0, return_inverse=True)
            if len(sets) <= PALETTE:
                break
        rows, size = -(-len(sets) // PALETTE_ROW), sh.shape[1]
        centroids = self.one("shN_centroids", sets.reshape(-1, 3), (PALETTE_ROW * size, rows))
        label = label.reshape(-1)
        labels = self.one("shN_labels", np.stack([label % 256, label // 256], 1))
        bands = round((size + 1) ** 0.5) - 1
        files = centroids["files"] + labels["files"]
        return {"bands": bands, "count": len(sets), "codebook": book.tolist(), "files": files}


def _even_steps(values: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a codebook (steps,) from the least to the greatest value, and which entry is nearest to each."""
    low, high = values.min(), values.max()
    if steps == 1 or not high > low:
        return np.array([(low + high) / 2]), np.zeros(values.shape, np.int64)
    book = np.linspace(low, high, steps)
    return book, np.rint((values - low) / (high - low) * (steps - 1)).astype(np.int64)


def _smallest_three(wxyz: np.ndarray) -> np.ndarray:
    """Return (N, 4) codes: the three smaller components, where the greatest is positive, and which one that is."""
    largest = np.abs(wxyz).argmax(1)
    sign = np.where(np.take_along_axis(wxyz, largest[:, None], 1) < 0, -1, 1)
    rest = (wxyz * sign)[np.arange(4) != largest[:, None]].reshape(-1, 3)
    return np.column_stack([np.rint(np.clip(rest * np.sqrt(2) + 1, 0, 2) / 2 * 255), LEFT_OUT + largest])


def _spread_codes(spread: np.ndarray) -> np.ndarray:
    """Return (N,) codes of an uncertainty in m/s: even steps of its logarithm."""
    known = np.clip(np.where(np.isfinite(spread), spread, 1), LEAST_SPREAD, MOST_SPREAD).astype(np.float64)
    share = np.log(known / LEAST_SPREAD) / np.log(MOST_SPREAD / LEAST_SPREAD)
    return np.where(np.isfinite(spread), np.rint(share * (UNKNOWN - 1)), UNKNOWN)
