"""Printable front and rails for the LED board, as STL: `python firmware/board/holder.py OUT [--marker-mm 55]`.

front.stl takes the marker (a print on paper, glued into its recess) and 16 LEDs; rails.stl, printed twice and set end
to end, takes the five strips in grooves. Places are those of the board gof_board, which `gof capture sync` recognises.
Plates are made of boxes on one grid of lines, some with a round hole: closed surfaces by construction.
"""

from __future__ import annotations

import argparse
import json
import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

TEMPLATE = Path(__file__).parents[2] / "gof/capture/gof_board.json"
THICK, RECESS, GROOVE = 3.0, 0.4, 1.6  # mm: plates; for the marker's paper; for a strip
LED_HOLE, SCREW_HOLE = 5.2, 3.4  # mm
STRIP_WIDTH = 8.6  # mm: COB strips are 8 mm wide
ROUND = 48  # corners of a hole
EDGE = 0.5  # mm between a hole and the lines around it, at least


@dataclass(frozen=True)
class Plate:
    """Boxes on a grid: cell (i, j) spans x[i]..x[i + 1], y[j]..y[j + 1] and is `height[i, j]` high, above 0.

    Attributes:
        x, y: (N + 1,), (M + 1,) rising, mm.
        height: (N, M) mm.
        holes: by cell, the diameter of a round hole through its middle.
    """

    x: np.ndarray
    y: np.ndarray
    height: np.ndarray
    holes: dict[tuple[int, int], float]

    def triangles(self) -> np.ndarray:
        """Return (T, 3, 3) mm, counter-clockwise seen from outside."""
        found: list[np.ndarray] = []
        n, m = self.height.shape
        levels = np.unique(np.append(self.height, 0.0))  # walls are cut at all of them, to meet edge to edge
        for i in range(n):
            for j in range(m):
                corners = np.array(
                    [
                        [self.x[i], self.y[j]],
                        [self.x[i + 1], self.y[j]],
                        [self.x[i + 1], self.y[j + 1]],
                        [self.x[i], self.y[j + 1]],
                    ]
                )
                found += self._lids(corners, self.height[i, j], self.holes.get((i, j)))
                for k, (di, dj) in enumerate(((0, -1), (1, 0), (0, 1), (-1, 0))):
                    inside = 0 <= i + di < n and 0 <= j + dj < m
                    beside = self.height[i + di, j + dj] if inside else 0.0
                    if self.height[i, j] > beside:
                        cuts = levels[(levels >= beside) & (levels <= self.height[i, j])]
                        for low, high in pairwise(cuts):
                            found += _wall(corners[k], corners[(k + 1) % 4], low, high)
        return np.array(found)

    def _lids(self, corners: np.ndarray, top: float, hole: float | None) -> list[np.ndarray]:
        if hole is None:
            flat = [corners[[0, 1, 2]], corners[[0, 2, 3]]]
            return [_at(t, top) for t in flat] + [_at(t[::-1], 0.0) for t in flat]
        middle, found = corners.mean(0), []
        # The circle starts towards the first corner; a quarter of it faces each side.
        angle = np.arctan2(*(corners[0] - middle)[::-1]) + 2 * np.pi * np.arange(ROUND) / ROUND
        rim = middle + hole / 2 * np.stack([np.cos(angle), np.sin(angle)], 1)
        quarter = ROUND // 4
        for k in range(4):
            a, b = corners[k], corners[(k + 1) % 4]
            arc = [rim[(quarter * k + s) % ROUND] for s in range(quarter + 1)]
            flat = [np.array([a, b, arc[-1]])] + [np.array([a, q, p]) for p, q in pairwise(arc)]
            found += [_at(t, top) for t in flat] + [_at(t[::-1], 0.0) for t in flat]
        for p, q in zip(rim, np.roll(rim, -1, 0), strict=True):
            found += _wall(q, p, 0.0, top)
        return found

    def volume(self) -> float:
        """mm^3, from the boxes and the holes' polygons."""
        area = np.outer(np.diff(self.x), np.diff(self.y))
        rim = ROUND / 2 * np.sin(2 * np.pi / ROUND)  # of a circle with radius 1
        return float((area * self.height).sum()) - sum(
            rim * (d / 2) ** 2 * self.height[cell] for cell, d in self.holes.items()
        )


def _at(flat: np.ndarray, z: float) -> np.ndarray:
    return np.column_stack([flat, np.full(3, z)])


def _wall(a: np.ndarray, b: np.ndarray, low: float, high: float) -> list[np.ndarray]:
    p, q, r, s = (np.append(v, z) for v, z in ((a, low), (b, low), (b, high), (a, high)))
    return [np.array([p, q, r]), np.array([p, r, s])]


def _cell(lines: np.ndarray, value: float) -> int:
    return int(np.searchsorted(lines, value) - 1)


def _plate(xs: list[float], ys: list[float], lowered: list, holes: list[tuple[float, float, float]]) -> Plate:
    """Return a plate with lines at xs and ys. lowered: (x0, x1, y0, y1, height).   holes: x, y, diameter."""
    x, y = np.unique(np.round(xs, 6)), np.unique(np.round(ys, 6))
    height = np.full((len(x) - 1, len(y) - 1), THICK)
    middle_x, middle_y = (x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2
    for x0, x1, y0, y1, top in lowered:
        height[np.ix_((middle_x > x0) & (middle_x < x1), (middle_y > y0) & (middle_y < y1))] = top
    return Plate(x, y, height, {(_cell(x, hx), _cell(y, hy)): d for hx, hy, d in holes})


def front(marker_mm: float) -> Plate:
    """Return the plate around the marker, seen from the front; y up."""
    board = json.loads(TEMPLATE.read_text(encoding="utf-8"))
    leds = np.array([led["xy"] for led in board["leds"]]) * [marker_mm, -marker_mm]
    low, high = -0.7 * marker_mm, 1.7 * marker_mm
    reach = LED_HOLE / 2 + EDGE
    xs, ys = [low, high, 0.0, marker_mm], [-high, -low, -marker_mm, 0.0]
    for lines, places in ((xs, leds[:, 0]), (ys, leds[:, 1])):
        for place in np.unique(places.round(6)):
            lines += [place - reach, place + reach]
    screw = 0.14 * marker_mm  # from the corners
    screws = [(low + screw, -high + screw), (high - screw, -high + screw), (low + screw, -low - screw)]
    screws.append((high - screw, -low - screw))
    for sx, sy in screws:
        xs += [sx - SCREW_HOLE / 2 - EDGE, sx + SCREW_HOLE / 2 + EDGE]
        ys += [sy - SCREW_HOLE / 2 - EDGE, sy + SCREW_HOLE / 2 + EDGE]
    holes = [(*xy, LED_HOLE) for xy in leds] + [(*xy, SCREW_HOLE) for xy in screws]
    return _plate(xs, ys, [(0.0, marker_mm, -marker_mm, 0.0, THICK - RECESS)], holes)


def rails(marker_mm: float) -> Plate:
    """Half the length of the strips; printed twice."""
    board = json.loads(TEMPLATE.read_text(encoding="utf-8"))
    ends = np.array([strip["ends"] for strip in board["strips"]]) * marker_mm
    length = float(np.ptp(ends[..., 0])) / 2
    at = -np.sort(ends[:, 0, 1])
    margin = 0.15 * marker_mm
    reach = SCREW_HOLE / 2 + EDGE
    ys = [at.min() - margin, at.max() + margin]
    lowered = []
    for y in at:
        ys += [y - STRIP_WIDTH / 2, y + STRIP_WIDTH / 2]
        lowered.append((0.0, length, y - STRIP_WIDTH / 2, y + STRIP_WIDTH / 2, THICK - GROOVE))
    # Screws between the two uppermost and the two lowest strips, near both ends.
    rows = [float(at[:2].mean()), float(at[-2:].mean())]
    columns = [0.1 * length, 0.9 * length]
    xs = [0.0, length, *(c + s * reach for c in columns for s in (-1, 1))]
    ys += [r + s * reach for r in rows for s in (-1, 1)]
    return _plate(xs, ys, lowered, [(c, r, SCREW_HOLE) for c in columns for r in rows])


def write_stl(path: Path, triangles: np.ndarray) -> None:
    """Binary STL, mm."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    rows = np.concatenate([normal[:, None], triangles], 1).astype("<f4").reshape(-1, 12)
    body = b"".join(row.tobytes() + b"\0\0" for row in rows)
    path.write_bytes(b"LED board holder, mm".ljust(80) + struct.pack("<I", len(rows)) + body)


def main() -> None:
    """Write both parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder")
    parser.add_argument("--marker-mm", type=float, default=55.0, help="side of the marker; everything scales with it")
    args = parser.parse_args()
    if not 45 <= args.marker_mm <= 200:
        parser.error("--marker-mm must lie in 45 to 200: with a smaller marker the LEDs' holes would touch it")
    args.out.mkdir(parents=True, exist_ok=True)
    for name, plate in (("front", front(args.marker_mm)), ("rails", rails(args.marker_mm))):
        write_stl(args.out / f"{name}.stl", plate.triangles())
        print(f"{args.out / name}.stl  {np.ptp(plate.x):.1f} x {np.ptp(plate.y):.1f} x {THICK} mm")


if __name__ == "__main__":
    main()
