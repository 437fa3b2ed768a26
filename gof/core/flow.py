"""Motion of every pixel of a picture: its files, and how far one is from another.

Motion is (H, W, 2), right and down, in pixels per frame, as benchmarks of optical flow have it; weight (H, W) >= 0 is
how much of the pixel moves so, 0 where nothing is known.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import DataFormatError, GofError, require_finite
from .exr import read_exr, write_exr
from .files import write_bytes

CHANNELS = ("flow.X", "flow.Y", "weight")  # in pixels per frame; the generator writes the true flow so
FLO_MAGIC, FLO_UNKNOWN = b"PIEH", 1e10  # Middlebury's; above 1e9 is unknown
OUTLIER_PX, OUTLIER_SHARE = 3.0, 0.05  # KITTI 2015: off by more than both


def write_flow(path: Path, flow: np.ndarray, weight: np.ndarray, notes: dict[str, str] | None = None) -> None:
    """Write motion by suffix, atomically: .exr (channels flow.X, flow.Y, weight) or .flo (Middlebury).

    Args:
        flow: (H, W, 2) px per frame.   weight: (H, W); where it is 0 a .flo says "unknown".
        notes: texts for the header of an .exr.
    Raises:
        DataFormatError: another suffix.
    """
    if path.suffix == ".exr":
        write_exr(path, dict(zip(CHANNELS, (flow[..., 0], flow[..., 1], weight), strict=True)), notes)
    elif path.suffix == ".flo":
        height, width = weight.shape
        values = np.where(weight[..., None] > 0, flow, FLO_UNKNOWN).astype("<f4")
        write_bytes(path, FLO_MAGIC + struct.pack("<ii", width, height) + values.tobytes())
    else:
        raise DataFormatError(f"{path}: motion of pixels is written as .exr or .flo")


def read_flow(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return motion (H, W, 2) px per frame and weight (H, W) of an .exr or .flo, float32; 0 where it is unknown.

    Raises:
        DataFormatError: no such file, damaged, or an .exr without the channels flow.X, flow.Y and weight.
        NonFiniteError: NaN or Inf where the weight is not 0.
    """
    if path.suffix == ".flo":
        flow, weight = _read_flo(path)
    else:
        channels = read_exr(path)
        missing = [name for name in CHANNELS if name not in channels]
        if missing:
            raise DataFormatError(f"{path}: has no channel {missing[0]}, only {sorted(channels)}")
        x, y, weight = (channels[name].astype(np.float32) for name in CHANNELS)
        flow = np.stack([x, y], -1)
    known = weight > 0
    require_finite("motion of pixels", flow[known], str(path))
    return np.where(known[..., None], flow, 0), weight


def _read_flo(path: Path) -> tuple[np.ndarray, np.ndarray]:
    try:
        data = path.read_bytes()
    except OSError as e:
        raise DataFormatError(f"{path}: {e.strerror}") from e
    if data[:4] != FLO_MAGIC or len(data) < 12:
        raise DataFormatError(f"{path}: is no .flo of Middlebury")
    width, height = struct.unpack_from("<ii", data, 4)
    if width < 1 or height < 1 or len(data) != 12 + 8 * width * height:
        raise DataFormatError(f"{path}: {len(data)} bytes are no .flo of {width} x {height} pixels; cut off?")
    flow = np.frombuffer(data, "<f4", offset=12).reshape(height, width, 2)
    return flow, (np.abs(flow).max(-1) <= 1e9).astype(np.float32)


@dataclass(frozen=True)
class FlowScore:
    """Errors of motion against the true motion, over pixels.

    Attributes:
        epe_px: mean end-point error, px per frame.
        fl_all: share in [0, 1] of pixels off by more than 3 px per frame and by more than 5 % of the true motion.
        angular_deg: mean angle between (u, v, 1) and the true one (Barron et al. 1994), degrees.
        pixels: that were compared.
    """

    epe_px: float
    fl_all: float
    angular_deg: float
    pixels: int


class FlowErrors:
    """Sums of errors over pixels of many pictures, from which their means follow."""

    def __init__(self) -> None:
        self.sums, self.pixels = np.zeros(3), 0

    def add(self, flow: np.ndarray, truth: np.ndarray) -> None:
        """Count pixels. Args: flow, truth: (P, 2) px per frame. Raises GofError: shapes disagree."""
        flow, truth = np.asarray(flow, np.float64), np.asarray(truth, np.float64)
        if flow.shape != truth.shape or flow.shape[1:] != (2,):
            raise GofError(f"motion {flow.shape} and truth {truth.shape} of pixels; expected (P, 2) of both")
        off = np.linalg.norm(flow - truth, axis=1)
        outlier = (off > OUTLIER_PX) & (off > OUTLIER_SHARE * np.linalg.norm(truth, axis=1))
        a, b = (np.insert(values, 2, 1.0, axis=1) for values in (flow, truth))
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1))
        self.sums += [off.sum(), outlier.sum(), np.degrees(angle).sum()]
        self.pixels += len(off)

    def score(self) -> FlowScore:
        """Return the means. Raises GofError: no pixel was counted."""
        if not self.pixels:
            raise GofError("no pixel to compare motion in")
        epe, outliers, angle = (self.sums / self.pixels).tolist()
        return FlowScore(epe, outliers, angle, self.pixels)
