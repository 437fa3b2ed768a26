"""Which frames of several videos belong together, and when each was taken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError, GofError
from gof.io.files import read_json


@dataclass(frozen=True)
class Clock:
    """Per camera: frames (range of stored frame numbers, all of one length T), time_s (T,) start of each frame on the
    dataset clock (camera 0's first is 0), row_time_s per stored line and readout of the upright picture; and where it is from."""

    frames: list[range]
    time_s: list[np.ndarray]
    row_time_s: list[float]
    readout: list[str]
    source: str

    def turned(self, turn: str) -> Clock:
        """For pictures that are turned: readout directions turn with them."""
        circle = ["down", "left", "up", "right"]  # each a clockwise quarter after the one before
        quarters = {"none": 0, "clockwise": 1, "counterclockwise": 3}[turn]
        return replace(self, readout=[circle[(circle.index(r) + quarters) % 4] for r in self.readout])


def read_clock(times: Path | None, fps: float | None, counts: list[int], start: int, limit: int | None) -> Clock:
    """Times by `gof capture sync`, or equal steps at `fps` with all videos starting together.

    With measured times, each camera's clip starts at its frame nearest to the first camera's frame `start`; the clips end
    together.

    Raises:
        DataFormatError: times.json is not what `gof capture sync` writes, has another number of cameras or frames, or lacks
            a camera (it says which and why); dropped frames inside the range.
        GofError: neither times nor fps; fewer than two frames are left.
    """
    if (times is None) == (fps is None):
        raise GofError("give the frame times with either --times times.json (of 'gof capture sync') or --fps RATE")
    if fps is not None:
        if not fps > 0:
            raise GofError(f"--fps {fps}: must be positive")
        count = _length([n - start for n in counts], limit)
        line = np.arange(count) / fps
        return Clock(
            [range(start, start + count)] * len(counts),
            [line] * len(counts),
            [0.0] * len(counts),
            ["down"] * len(counts),
            f"{fps:g} frames per second, all cameras starting together",
        )

    d = read_json(times)
    entries = d.get("cameras") if isinstance(d, dict) and d.get("schema") == "gof-times" else None
    if not isinstance(entries, list) or len(entries) != len(counts):
        raise DataFormatError(
            f"{times}: must be a times.json of 'gof capture sync' for {len(counts)} videos in the same order"
        )
    clocks, rows, readouts = [], [], []
    for entry, count in zip(entries, counts, strict=True):
        if "error" in entry:
            raise DataFormatError(
                f"{times}: camera '{entry.get('name')}' has no times ({entry['error']}); film the board whole and lit, "
                "leave this camera out, or use --fps"
            )
        try:
            middle = np.array([f["time_s"] for f in entry["frames"]], np.float64)
            row, readout = float(entry.get("row_time_us") or 0) * 1e-6, str(entry.get("readout") or "down")
            lines = int(entry["width"] if readout in ("left", "right") else entry["height"])
        except (KeyError, TypeError, ValueError) as e:
            raise DataFormatError(f"{times}: camera '{entry.get('name')}': field {e} is missing or malformed") from e
        if len(middle) != count:
            raise DataFormatError(f"{times}: camera '{entry['name']}' has {len(middle)} frames, its video {count}")
        # Sync gives the middle of the picture; a dataset's frame starts when its first line is read.
        clocks.append(middle - row * (lines - 1) / 2)
        rows.append(row)
        readouts.append(readout)
    if not 0 <= start < len(clocks[0]):
        raise GofError(f"--start {start}: the first video has {len(clocks[0])} frames")
    # Pairing by the middle of the picture: where the flame is, whatever the readout direction.
    middles = [
        t + r * (int(e["width"] if o in ("left", "right") else e["height"]) - 1) / 2
        for t, r, o, e in zip(clocks, rows, readouts, entries, strict=True)
    ]
    while start < len(middles[0]) and any(m[0] > middles[0][start] + 0.5 * np.median(np.diff(m)) for m in middles):
        start += 1  # a camera that began later
    if start == len(middles[0]):
        raise GofError(f"{times}: the videos do not overlap in time")
    first = [int(np.abs(m - middles[0][start]).argmin()) for m in middles]
    count = _length([len(m) - k for m, k in zip(middles, first, strict=True)], limit)
    ranges = [range(k, k + count) for k in first]
    zero = clocks[0][first[0]]
    result = [t[r.start : r.stop] - zero for t, r in zip(clocks, ranges, strict=True)]
    for entry, t in zip(entries, result, strict=True):
        step = np.diff(t)
        if len(step) and (step.min() <= 0 or step.max() > 1.5 * np.median(step)):
            raise DataFormatError(
                f"{times}: camera '{entry['name']}' repeats or drops frames at {int(np.argmax(np.abs(step - np.median(step))))} of the "
                "paired range; choose a range without with --start and --frames"
            )
    return Clock(ranges, result, rows, readouts, "gof capture sync")


def _length(available: list[int], limit: int | None) -> int:
    count = min(available) if limit is None else min(limit, *available)
    if count < 2:
        raise GofError(
            f"{count} frames are left in common; at least 2 are needed (check --start, --frames and the times)"
        )
    return count
