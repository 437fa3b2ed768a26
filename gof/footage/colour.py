"""The colours that a film means: its code values (ITU-T H.273) to the display values that everything here works in.

OpenCV decodes every film as if it were Rec. 601 SDR, whatever the file says. Its output is taken back to luma and
colour differences and read by the matrix, the curve and the primaries that the file names. HLG and PQ, an HDR film's
curves, become light on a screen (Rec. ITU-R BT.2100); its 203 cd/m2 are the white of SDR (BT.2408), what is brighter is
rolled off below that white, and Rec. 2020 becomes Rec. 709.

OpenCV gives 8 bits per channel, as many as the pictures that are stored have; notebook/ingest.md compares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

REC_709, UNSAID, REC_2020 = 1, 2, 9  # H.273, primaries and matrices
PQ, HLG = 16, 18  # H.273, transfer characteristics
LUMA = {REC_709: (0.2126, 0.0722), REC_2020: (0.2627, 0.0593)}  # of red and of blue, by the matrix
REC_601 = (0.299, 0.114)  # what OpenCV takes for all
WHITE, BRIGHTEST = 203.0, 1000.0  # cd/m2: SDR's white in HDR (BT.2408), and the screen that HLG is shown on (BT.2100)
KNEE = 0.7  # of white: light below it is kept as it is
TO_709 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])  # of Rec. 2020


@dataclass(frozen=True)
class Colour:
    """The code points of H.273 that a film's file states; 2 where it says nothing. full_range: whether black is 0 and
    white all ones; else there is room below and above."""

    primaries: int = UNSAID
    transfer: int = UNSAID
    matrix: int = UNSAID
    full_range: bool = False

    @property
    def name(self) -> str:
        """Return "HLG", "PQ", "SDR", or "" where the file does not say."""
        return {HLG: "HLG", PQ: "PQ", UNSAID: ""}.get(self.transfer, "SDR")

    @property
    def is_hdr(self) -> bool:
        """Whether its curve is one of HDR."""
        return self.transfer in (HLG, PQ)

    def reader(self) -> Callable[[np.ndarray], np.ndarray]:
        """Return what makes (H, W, 3) uint8 RGB display values of OpenCV's (H, W, 3) uint8 BGR."""
        import cv2

        if self.is_hdr:
            return _table(self)
        if self.matrix in LUMA:
            matrix = _matrix(LUMA[self.matrix])[:, ::-1]
            return lambda picture: cv2.transform(picture, matrix)
        return lambda picture: cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


UNKNOWN = Colour()


def _matrix(luma: tuple[float, float]) -> np.ndarray:
    """Return (3, 3) by which R'G'B' that were decoded as Rec. 601 become those of a matrix with these weights."""
    return np.linalg.inv(_to_luma(luma)) @ _to_luma(REC_601)


def _to_luma(luma: tuple[float, float]) -> np.ndarray:
    """Return (3, 3) from R'G'B' to Y', Cb, Cr."""
    red, blue = luma
    y = np.array([red, 1 - red - blue, blue])
    return np.stack([y, (np.array([0.0, 0, 1]) - y) / (2 - 2 * blue), (np.array([1.0, 0, 0]) - y) / (2 - 2 * red)])


# ---- HDR -------------------------------------------------------------------------------------------------------------


def hlg_light(code: np.ndarray) -> np.ndarray:
    """Return (..., 3) light on a screen of 1000 cd/m2, in cd/m2, of HLG's (..., 3) code values in [0, 1] (BT.2100,
    table 5)."""
    a = 0.17883277
    b, c = 1 - 4 * a, 0.5 - a * np.log(4 * a)
    scene = np.where(code <= 0.5, code**2 / 3, (np.exp((code - c) / a) + b) / 12)
    red, blue = LUMA[REC_2020]
    luminance = scene @ np.array([red, 1 - red - blue, blue], scene.dtype)
    return BRIGHTEST * luminance[..., None] ** 0.2 * scene


def pq_light(code: np.ndarray) -> np.ndarray:
    """Return light in cd/m2 of PQ's code values in [0, 1] (BT.2100, table 4)."""
    m1, m2 = 2610 / 16384, 2523 / 4096 * 128
    c1, c2, c3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    power = code ** (1 / m2)
    return 10_000 * (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1)


def rolled_off(light: np.ndarray) -> np.ndarray:
    """Return (..., 3) light of white = 1 in [0, 1]: unchanged up to KNEE, and `BRIGHTEST` becomes 1; hues are kept.

    The curve is the Möbius transform that joins the straight part without a bend, as in FFmpeg's filter `tonemap`.
    """
    peak, j = BRIGHTEST / WHITE, KNEE
    a = -j * j * (peak - 1) / (j * j - 2 * j + peak)
    b = (j * j - 2 * j * peak + peak) / (peak - 1)
    most = np.minimum(light.max(-1, keepdims=True), peak)
    curved = (b * b + 2 * b * j + j * j) / (b - a) * (most + a) / (most + b)
    factor = np.where(most > j, curved / np.maximum(most, 1e-9), 1.0)
    return np.clip(light * factor, 0, 1)


def display_values(colour: Colour, code: np.ndarray) -> np.ndarray:
    """Return (..., 3) sRGB display values in [0, 1] of an HDR film's (..., 3) R'G'B' in [0, 1]."""
    light = (hlg_light if colour.transfer == HLG else pq_light)(np.clip(code, 0, 1)) / WHITE
    if colour.primaries in (UNSAID, REC_2020):
        light = light @ TO_709.T.astype(light.dtype)
    light = rolled_off(np.maximum(light, 0))
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


GREEN_LOW = 1.2  # levels by which OpenCV's FFmpeg gives green too low for films of 10 bits (notebook/ingest.md)
NOT_YET = np.uint32(0xFFFFFFFF)


class _Table:
    """Display values by OpenCV's colour, each found when a picture first has it: a picture has few of the 2^24."""

    def __init__(self, colour: Colour):
        self._colour = colour
        self._matrix = _matrix(LUMA.get(colour.matrix, LUMA[REC_2020])).astype(np.float32)
        self._known = np.full(1 << 24, NOT_YET)

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """Return (H, W, 3) uint8 RGB of (H, W, 3) uint8 BGR."""
        place = picture[..., 2].astype(np.uint32) << 16 | picture[..., 1].astype(np.uint32) << 8 | picture[..., 0]
        found = self._known[place]
        if (new := found == NOT_YET).any():
            self._find(np.unique(place[new]))
            found = self._known[place]
        return np.ascontiguousarray(found.astype("<u4").view(np.uint8).reshape(*place.shape, 4)[..., :3])

    def _find(self, places: np.ndarray) -> None:
        decoded = np.stack([places >> 16, (places >> 8 & 255) + GREEN_LOW, places & 255], -1).astype(np.float32)
        values = display_values(self._colour, decoded @ (self._matrix.T / 255))
        red, green, blue = np.rint(255 * values).astype(np.uint32).T
        self._known[places] = red | green << 8 | blue << 16


@lru_cache(maxsize=2)
def _table(colour: Colour) -> _Table:
    return _Table(colour)
