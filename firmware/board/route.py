"""Tracks for a two-layer board: each net grown pad by pad along the cheapest way on a grid (Lee 1961, as A*)."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

GRID = 0.635  # mm
CLEARANCE = 0.28  # asked: 0.2; between two points of the grid a slanting track comes up to 0.075 nearer
EDGE = 0.6  # copper to the board's edge
VIA, VIA_DRILL = 0.8, 0.4
VIA_COST, TURN_COST = 12, 1


@dataclass(frozen=True)
class Copper:
    """A track from a to b, or a round pad where they are equal, on `layers` (0 front, 1 back); `half` its width."""

    net: str
    a: tuple[float, float]
    b: tuple[float, float]
    half: float
    layers: tuple[int, ...]

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """mm from points to its middle line."""
        a, d = np.array(self.a), np.subtract(self.b, self.a)
        t = np.clip(((x - a[0]) * d[0] + (y - a[1]) * d[1]) / max(d @ d, 1e-9), 0, 1)
        return np.hypot(x - a[0] - t * d[0], y - a[1] - t * d[1])


class Unroutable(RuntimeError):
    """No way is left for a net."""


class Router:
    """Copper that is there already, and the ways that are free beside it."""

    def __init__(self, size: tuple[float, float], holes: list[tuple[float, float, float]]) -> None:
        """Args: size: of the board, mm.   holes: x, y, radius that copper keeps away from."""
        self.shape = (round(size[0] / GRID) + 1, round(size[1] / GRID) + 1)
        self.x, self.y = np.meshgrid(*(GRID * np.arange(n) for n in self.shape), indexing="ij")
        self.to_edge = np.minimum.reduce([self.x, self.y, size[0] - self.x, size[1] - self.y])
        self.holes = holes
        self.copper: list[Copper] = []

    def free(self, net: str, half: float) -> np.ndarray:
        """(X, Y, 2) bool: where the middle of copper of that half width may lie."""
        open_ = np.repeat((self.to_edge >= EDGE + half)[..., None], 2, 2)
        for hx, hy, radius in self.holes:
            open_ &= (np.hypot(self.x - hx, self.y - hy) >= radius + CLEARANCE + half)[..., None]
        for other in self.copper:
            if other.net == net and net:
                continue
            reach = other.half + CLEARANCE + half
            low = np.maximum((np.minimum(other.a, other.b) - reach) // GRID, 0).astype(int)
            high = ((np.maximum(other.a, other.b) + reach) // GRID + 2).astype(int)
            part = np.s_[low[0] : high[0], low[1] : high[1]]
            near = other.distance(self.x[part], self.y[part]) < reach - 1e-6
            for layer in other.layers:
                open_[(*part, layer)] &= ~near
        return open_

    def connect(self, net: str, pads: list[Copper], width: float) -> tuple[list[Copper], list[tuple[float, float]]]:
        """Tracks and vias that join the pads. Raises Unroutable."""
        tracks: list[Copper] = []
        vias: list[tuple[float, float]] = []
        clear, clear_via = self.free(net, width / 2), self.free(net, VIA / 2).all(2)
        reached = {(self._cell(pads[0].a), layer) for layer in pads[0].layers}
        left = list(pads[1:])
        at = {self._cell(pad.a): pad for pad in pads}
        for cell, pad in at.items():  # a way may always end on its own pad
            clear[(*cell, slice(None))] |= np.isin([0, 1], pad.layers)
        while left:
            left.sort(key=lambda pad: min(np.hypot(*np.subtract(self._cell(pad.a), c)) for c, _ in reached))
            goal = left.pop(0)
            way = self._cheapest(reached, self._cell(goal.a), goal.layers, clear, clear_via)
            if way is None:
                raise Unroutable(f"{net}: no way to the pad at {goal.a}")
            for (a, la), (b, lb) in pairwise(way):
                if la != lb:
                    vias.append(self._place(a, at))
                else:
                    tracks.append(Copper(net, self._place(a, at), self._place(b, at), width / 2, (la,)))
            reached |= set(way) | {(self._cell(goal.a), layer) for layer in goal.layers}
        tracks = _straightened(tracks)
        self.copper += tracks + [Copper(net, v, v, VIA / 2, (0, 1)) for v in vias]
        return tracks, vias

    def _cell(self, xy: tuple[float, float]) -> tuple[int, int]:
        return round(xy[0] / GRID), round(xy[1] / GRID)

    def _place(self, cell: tuple[int, int], pads: dict) -> tuple[float, float]:
        return pads[cell].a if cell in pads else (round(cell[0] * GRID, 4), round(cell[1] * GRID, 4))

    def _cheapest(self, start: set, goal: tuple[int, int], layers: tuple[int, ...], clear, clear_via):
        """Cells and layers from the net to the goal; None where there is no way."""
        heap = [(0.0, 0.0, cell, layer, (0, 0)) for cell, layer in start]
        heapq.heapify(heap)
        cost = {(cell, layer): 0.0 for cell, layer in start}
        came: dict = {}
        while heap:
            _, spent, cell, layer, heading = heapq.heappop(heap)
            if spent > cost.get((cell, layer), np.inf):
                continue
            if cell == goal and layer in layers:
                way = [(cell, layer)]
                while way[-1] in came:
                    way.append(came[way[-1]])
                return way[::-1]
            steps = [((cell[0] + dx, cell[1] + dy), layer, (dx, dy)) for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
            steps += [((cell[0] + dx, cell[1] + dy), layer, (dx, dy)) for dx in (-1, 1) for dy in (-1, 1)]
            if clear_via[cell]:
                steps.append((cell, 1 - layer, heading))
            for to, on, way in steps:
                if not (0 <= to[0] < self.shape[0] and 0 <= to[1] < self.shape[1] and clear[(*to, on)]):
                    continue
                price = VIA_COST if on != layer else float(np.hypot(*way)) + TURN_COST * (way != heading)
                total = spent + price
                if total < cost.get((to, on), np.inf):
                    cost[to, on] = total
                    came[to, on] = (cell, layer)
                    ahead = max(abs(to[0] - goal[0]), abs(to[1] - goal[1]))
                    heapq.heappush(heap, (total + ahead, total, to, on, way))
        return None


def _straightened(tracks: list[Copper]) -> list[Copper]:
    """Pieces in one line become one."""
    joined: list[Copper] = []
    for piece in tracks:
        if joined and joined[-1].b == piece.a and joined[-1].layers == piece.layers:
            before, now = np.subtract(joined[-1].b, joined[-1].a), np.subtract(piece.b, piece.a)
            if abs(before[0] * now[1] - before[1] * now[0]) < 1e-9 and before @ now > 0:
                joined[-1] = Copper(piece.net, joined[-1].a, piece.b, piece.half, piece.layers)
                continue
        joined.append(piece)
    return joined


def route(
    size: tuple[float, float],
    holes: list[tuple[float, float, float]],
    pads: list[Copper],
    widths: dict[str, float],
    narrow: float,
    tries: int = 40,
) -> tuple[list[Copper], list[tuple[str, tuple[float, float]]]]:
    """Tracks and vias (net, place) for all nets, wide ones and short ones first; a net that finds no way goes first in
    the next try. Raises Unroutable: after `tries`."""
    by_net: dict[str, list[Copper]] = {}
    for pad in pads:
        by_net.setdefault(pad.net, []).append(pad)
    order = [net for net in by_net if net and len(by_net[net]) > 1]
    order.sort(key=lambda net: (net == "GND", len(by_net[net]), np.ptp([p.a for p in by_net[net]], axis=0).sum()))
    for _ in range(tries):
        router = Router(size, holes)
        router.copper = list(pads)
        tracks: list[Copper] = []
        vias: list[tuple[str, tuple[float, float]]] = []
        for net in order:
            try:
                made, holes_made = router.connect(net, by_net[net], widths.get(net, narrow))
            except Unroutable as e:
                print(f"again, with this net first: {e}", flush=True)
                order.remove(net)
                order.insert(0, net)
                break
            tracks += made
            vias += [(net, v) for v in holes_made]
        else:
            return tracks, vias
    raise Unroutable(f"no way for all nets in {tries} tries")
