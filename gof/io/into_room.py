"""A captured flame in anybody's captured room: where it stands, and its light on the room's splats.

The room is a plain PLY of 3D Gaussian Splatting, or the still Gaussians of a result. At time t the flame is a lamp at
c(t), the middle of its light. Its light P(t), in red, green and blue, is what pictures show of its Gaussians
(`gof.core.shining`). A splat at x of the display colour b, which is what its constant harmonic says, then shows

    lit(t) = b + S(min(a (1 + E(t)), 1)) - S(a),   a = L(b),
    E(t) = light P(t) / (pi (|x - c(t)|^2 + r0^2)) ALBEDO / A,

with L to linear light and S back to display values, colours as far as they lie in [0, 1]. Without the flame a surface
shows a, its albedo times the room's own light; facing the lamp it sends back its albedo times the lamp's. How bright
the room's own light was, its pictures do not say: A, the median of a, is taken for surfaces of ALBEDO. r0 is the
flame's own size, the root of the mean square distance of its light from c(t), so that nothing near it is lit without
bound. Colours that change with the direction keep that part as it is. There are no shadows, and a surface that
looks away from the flame is lit alike.

All is written in metres with Z up, as every file of ours, counted from the room's origin: a room with another unit or
another up is brought there, so velocities stay m/s and formats that state their axes and units say the truth.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.core.checked_json import require
from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.errors import DataFormatError, GofError, naming
from gof.core.files import read_json
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0, plain_color
from gof.core.ply import Ply
from gof.core.records import convert_json
from gof.core.results import PROPERTIES
from gof.core.shining import shining_at
from gof.io.importers import require_kept

SUFFIXES = (".ply", ".npz")  # of a room
INSTANTS = 32  # of the clip, from which the mean light is taken
BURNING = (0.05, 0.95)  # shares of the Gaussians' times between which a flame without a stated clip burns
FOOT, LOWEST = 0.01, 0.1  # shares of the light: below the foot's height, and over whose middle the foot lies
SEEN = 1 / 255  # of a display value
# Red, green and blue of a room's usual surface in a flame's light, as three rooms show (notebook/choices.md). A flame's
# pictures end at white, in red first, so red counts for more.
ALBEDO = np.array([0.20, 0.11, 0.085])
DARKEST = 0.005  # linear: a room as black as that says nothing of its light


@dataclass(frozen=True)
class Place:
    """The JSON that `gof convert --into` takes: where and how a flame stands in a room. A PLY alone has the defaults.

    Attributes:
        room: the room's file, counted from the folder of the JSON.
        at: place of the flame's foot, in the room's units.
        scale: of the room's units to a metre of the flame, > 0.
        turn_deg: about the room's up, to the left as seen from above.
        up: direction in the room, of any length; (0, -1, 0) in many captures posed by COLMAP.
        start_s: time of the room's clock at which the flame's own is 0.
        light: factor on the flame's light, >= 0: 1 where both captures were exposed alike, 0 for none.
    """

    room: str
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    turn_deg: float = 0.0
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    start_s: float = 0.0
    light: float = 1.0

    def __post_init__(self):
        require(self.scale > 0, "scale", "above 0", self.scale)
        require(self.light >= 0, "light", "0 or more", self.light)
        require(np.linalg.norm(self.up) > 1e-9, "up", "a direction, not all zeros", self.up)

    def of_room(self) -> np.ndarray:
        """Return the similarity (4, 4) from the room to metres with Z up; the origin stays."""
        found = np.eye(4)
        found[:3, :3] = _upright(np.array(self.up)).T / self.scale
        return found

    def of_flame(self, foot: np.ndarray) -> np.ndarray:
        """Return the motion (4, 4) of the flame to there; `foot` (3,) goes to `at`."""
        a = np.deg2rad(self.turn_deg)
        found = np.eye(4)
        found[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
        found[:3, 3] = self.of_room()[:3, :3] @ self.at - found[:3, :3] @ foot
        return found


@dataclass(frozen=True)
class LitRoom:
    """A flame in a room, both in metres with Z up.

    Attributes:
        room: still Gaussians.   flame: moving ones, with as many harmonics.
        size: r0.   light: factor.   notes: in words, what stands where.
    """

    room: TransientGaussians
    flame: TransientGaussians
    size: float
    light: float
    notes: list[str]

    def lit(self, times_s: Iterable[float]) -> tuple[TransientGaussians, str]:
        """Return both together, the room in its mean light of these times; and in words how far and how even it is."""
        lamps = [self._lamp(time_s) for time_s in times_s]
        color = self._color(lamps)
        power = np.array([light.mean() for _, light in lamps])
        together = TransientGaussians.concatenate([replace(self.room, color=color), self.flame])
        gain = (plain_color(color) - plain_color(self.room.color)).max(1)
        if not gain.any():
            return together, "the flame sheds no light on the room"
        note = f"the flame's light changes {(gain >= SEEN).sum():,} of the room's {len(gain):,} splats, by up to "
        note += f"{gain.max():.2g} of white"
        if len(lamps) > 1:
            note += f"; it flickers between {power.min() / power.mean():.2g} and {power.max() / power.mean():.2g}"
        return together, note

    def color_at(self, time_s: float) -> np.ndarray:
        """Return the colours of `lit` in the light of one time, in the same rows."""
        return np.concatenate([self._color([self._lamp(time_s)]), self.flame.color])

    def instants(self, start_s: float | None = None, end_s: float | None = None) -> np.ndarray:
        """Return times spread evenly over a clip; where it is not stated, over the time in which the flame burns."""
        return _instants(self.flame, start_s, end_s)

    def _lamp(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return place c (3,) and light P (3,) of the flame at a time; zeros where nothing shines."""
        shining = shining_at(self.flame, time_s)
        total = shining.light.sum(1)
        if not total.any():
            return np.zeros(3), np.zeros(3)
        return np.average(shining.middle, axis=0, weights=total), shining.light.sum(0) / np.sqrt(2 * np.pi)

    def _color(self, lamps: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Return the room's colours, (N, 3) or (N, K, 3), in the mean light of some lamps."""
        extra = np.zeros((len(self.room), 3), np.float32)
        for place, power in lamps:
            if power.any():
                near = ((self.room.position - place) ** 2).sum(1) + self.size**2
                extra += (self.light / (np.pi * len(lamps)) * power) / near[:, None]
        shown = srgb_to_linear(np.clip(plain_color(self.room.color), 0, 1))
        extra *= ALBEDO / max(float(np.median(shown.mean(1))), DARKEST)
        gain = linear_to_srgb(np.minimum(shown * (1 + extra), 1)) - linear_to_srgb(shown)
        color = self.room.color.copy()
        if color.ndim == 2:
            return color + gain
        color[:, 0] += gain / C0
        return color


def read_place(path: Path) -> Place:
    """Read a placement, or give that of a bare room; its `room` leads there from the working folder.

    Raises:
        DataFormatError: no such file, of another kind, an unknown or missing key, or a wrong value; or no such room.
    """
    if path.suffix.lower() in SUFFIXES:
        place = Place(str(path))
    elif path.suffix.lower() == ".json":
        place = convert_json(Place, read_json(path), path)
        place = replace(place, room=str(path.parent / place.room))
    else:
        raise DataFormatError(f'{path}: --into takes the PLY of a room, or JSON such as {{"room": "room.ply"}}')
    if not Path(place.room).is_file():
        named = "" if place.room == str(path) else f", which {path} names as its room"
        raise DataFormatError(f"{place.room}: no such file{named}")
    if Path(place.room).suffix.lower() not in SUFFIXES:
        raise DataFormatError(f"{place.room}: a room is a .ply of 3D Gaussian Splatting; export it as that")
    return place


def read_room(path: Path) -> TransientGaussians:
    """Read a room: a plain PLY of 3D Gaussian Splatting, or the still Gaussians of a result of ours.

    Raises:
        DataFormatError: see `gof.core.ply.Ply`; or a result without still Gaussians.
    """
    with naming(path):
        if path.suffix.lower() == ".npz":
            return _still(TransientGaussians.load(path))
        ply = Ply.read(path)
        if ply.has(*PROPERTIES):
            return _still(TransientGaussians.load(path))
        ply.require_read()
        splats = ply.splats()
        n = len(splats["position"])
        if not n:
            raise DataFormatError("holds no splat; export the room again")
        rest = {"velocity": np.zeros((n, 3)), "t_mu": np.zeros(n), "t_sigma": np.full(n, np.inf)}
        return TransientGaussians(**splats | rest, dynamic=np.zeros(n, bool), datum=None)


def put_into_room(flame: TransientGaussians, path: Path) -> LitRoom:
    """Place a flame in a room.

    Args:
        flame: a result; its still Gaussians, which are surroundings of its own, are left out.
        path: of the room, or of the JSON that says where the flame stands in it (`Place`).
    Raises:
        DataFormatError: see `read_place` and `read_room`; or nothing of the flame moves.
        GofError: it would stand where float32 numbers do not tell its sizes or lives apart.
    """
    place = read_place(path)
    room, left = read_room(Path(place.room)), int((~flame.dynamic).sum())
    flame = flame[flame.dynamic]
    if not len(flame):
        raise DataFormatError(f"{path}: the result to place there holds no moving Gaussian, so no flame")
    datum = flame.datum
    with naming(path):
        room, flame = _moved(room, flame, place)
    room, flame = _alike(room, flame)
    x, y, z = place.at
    up = ", ".join(f"{number:g}" for number in place.up)
    notes = [
        f"the flame's foot stands at ({x:g}, {y:g}, {z:g}) of {Path(place.room).name}; up is ({up}); a metre is "
        f"{place.scale:g} there; turned by {place.turn_deg:g} degrees; its clock begins at {place.start_s:g} s; light "
        f"{place.light:g}" + ("" if path.suffix.lower() == ".json" else "; JSON given to --into says otherwise")
    ]
    if (place.of_room() != np.eye(4)).any():
        notes.append("the room is brought to metres with Z up, its origin where it was; velocities are m/s")
    if left:
        notes.append(f"{left:,} still Gaussians of the result are left out: the room takes their place")
    if datum:
        notes.append(f"the result's times count from {datum.numbers()[3]:.12g} s; the file cannot say so")
    return LitRoom(room, flame, _size(flame), place.light, notes)


def _moved(
    room: TransientGaussians, flame: TransientGaussians, place: Place
) -> tuple[TransientGaussians, TransientGaussians]:
    remedy = "Choose at, scale and start_s that suit the room"
    try:
        if (place.of_room() != np.eye(4)).any():
            room = room.transformed(place.of_room())
        flame = flame.transformed(place.of_flame(_foot(flame)))
        flame = replace(flame, t_mu=flame.t_mu + np.float64(place.start_s))
    except GofError as e:
        raise DataFormatError(f"the flame cannot stand there: {e}. {remedy}") from e
    require_kept(flame, "the placed flame's", remedy)
    return room, flame


def _still(g: TransientGaussians) -> TransientGaussians:
    if g.dynamic.all():
        raise DataFormatError("holds no still Gaussian, so it is no room; give the PLY of a capture without fire")
    return replace(g[~g.dynamic], emissive=False)  # a room hides what is behind it


def _upright(up: np.ndarray) -> np.ndarray:
    """Return the shortest turn (3, 3) that takes +z to `up`; to -z about x."""
    x, y, z = up / np.linalg.norm(up)
    if z < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    return np.array(
        [[1 - x * x / (1 + z), -x * y / (1 + z), x], [-x * y / (1 + z), 1 - y * y / (1 + z), y], [-x, -y, z]]
    )


def _instants(flame: TransientGaussians, start_s: float | None = None, end_s: float | None = None) -> np.ndarray:
    first, last = np.quantile(flame.t_mu.astype(np.float64), BURNING)
    start_s, end_s = first if start_s is None else start_s, last if end_s is None else end_s
    return start_s + (end_s - start_s) * (np.arange(INSTANTS) + 0.5) / INSTANTS


def _foot(flame: TransientGaussians) -> np.ndarray:
    """Return the foot (3,) of a flame, Z up: under the middle of its lowest tenth of light; of what is dark, of
    places."""
    found = [shining_at(flame, time_s) for time_s in _instants(flame)]
    middle, light = np.concatenate([f.middle for f in found]), np.concatenate([f.light.sum(1) for f in found])
    if not light.any():
        middle, light = flame.position.astype(np.float64), np.ones(len(flame))
    order = middle[:, 2].argsort()
    middle, light = middle[order], light[order]
    below = light.cumsum() / light.sum()
    low = slice(int(np.searchsorted(below, LOWEST)) + 1)
    x, y = np.average(middle[low, :2], axis=0, weights=light[low])
    return np.array([x, y, middle[np.searchsorted(below, FOOT), 2]])


def _size(flame: TransientGaussians) -> float:
    """Return r0: the root of the mean square distance of the light from its middle at its time; 1 without light."""
    square = total = 0.0
    for time_s in _instants(flame):
        shining = shining_at(flame, time_s)
        light = shining.light.sum(1)
        if light.any():
            away = shining.middle - np.average(shining.middle, axis=0, weights=light)
            own = flame.scale[shining.rows].astype(np.float64)  # each reaches as far around its own middle
            square += light @ ((away**2).sum(1) + (own**2).sum(1))
            total += light.sum()
    return float(np.sqrt(square / total)) if total else 1.0


def _alike(room: TransientGaussians, flame: TransientGaussians) -> tuple[TransientGaussians, TransientGaussians]:
    """Return both with as many harmonics: display colours where neither has any that change with the direction."""
    count = max(1 if g.color.ndim == 2 else g.color.shape[1] for g in (room, flame))

    def color(g: TransientGaussians) -> np.ndarray:
        if count == 1:
            return plain_color(g.color)
        found = np.zeros((len(g), count, 3), np.float32)
        known = ((g.color - 0.5) / C0)[:, None] if g.color.ndim == 2 else g.color
        found[:, : known.shape[1]] = known
        return found

    return replace(room, color=color(room)), replace(flame, color=color(flame))
