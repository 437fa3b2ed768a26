"""Checks that the parts of a scene fit together, made before anything is simulated.

A spec whose fields are all in range may still describe a picture of nothing: a camera in the fire, a wall through it.
A spec that makes no dataset at all is refused; an odd one is warned of. Every message has the
number that would be right.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.checked_json import SpecError
from .fires import MOST_CELLS, Domain, Fire
from .rig import HALF_SENSOR, positions, seen

if TYPE_CHECKING:
    from .spec import SceneSpec

if TYPE_CHECKING:
    from .spec import SceneSpec

LEAST_ACROSS, CELLS_ACROSS = (
    0.5,
    3,
)  # of a burner or an obstacle, below which it is a point, and hardly more, to the solver
COLUMN = 1.5  # burner radii from the axis, which the flame fills
PIXELS_ACROSS = 4  # of a burner (or, where none is known, of the grids' box) in a picture, below which it is a dot


@dataclass(frozen=True)
class Implausibility:
    """Something that does not make sense; `fatal` where there would be no dataset."""

    text: str
    fatal: bool


def require_sense(spec: SceneSpec, files: bool = True) -> list[str]:
    """Return the findings for the maker of the scene.

    Args:
        files: also look whether the files that the spec names are there.
    Raises:
        SpecError: there would be no dataset; says all that has to change.
    """
    found = [*(_missing_files(spec) if files else ()), *findings(spec)]
    if fatal := [finding.text for finding in found if finding.fatal]:
        raise SpecError("; ".join(fatal))
    return [finding.text for finding in found]


def findings(spec: SceneSpec) -> list[Implausibility]:
    """Return all that does not make sense. Raises SpecError: files of a fire of grids are wrong."""
    simulated = [*_burner(spec), *obstacles(spec)] if isinstance(spec.fire, Fire) else []
    return [*simulated, *_cameras(spec), *_room(spec)]


def _missing_files(spec: SceneSpec) -> Iterator[Implausibility]:
    if spec.blend_file and not Path(spec.blend_file.path).is_file():
        yield Implausibility(f"blend_file.path: there is no file {spec.blend_file.path}", True)


def _burner(spec: SceneSpec) -> Iterator[Implausibility]:
    across, cell = 2 * spec.fire.radius, max(spec.domain.size) / spec.domain.resolution
    needed = math.ceil(CELLS_ACROSS * max(spec.domain.size) / across - 1e-9)
    finer = f"domain.resolution {needed}, or " if needed <= MOST_CELLS else ""
    way_out = f"make fire.radius {CELLS_ACROSS * cell / 2:.2g}, or {finer}domain.size smaller"
    if across < LEAST_ACROSS * cell:
        text = f"fire.radius: a burner of {_length(across)} in cells of {_length(cell)} burns nothing; {way_out}"
        yield Implausibility(text, True)
    elif across < (CELLS_ACROSS - 1e-9) * cell:
        yield Implausibility(f"fire.radius: the burner is only {across / cell:.1f} cells across; {way_out}", False)
    swing = next((effect for effect in spec.effects if hasattr(effect, "reach")), None)
    if swing is not None:
        turn = math.radians(swing.direction_deg)
        for axis, part in enumerate((math.cos(turn), math.sin(turn))):
            room = min(
                spec.domain.max[axis] - spec.fire.position[axis], spec.fire.position[axis] - spec.domain.min[axis]
            )
            most = room - spec.fire.radius
            if abs(part) * swing.reach > most + 1e-9:
                yield Implausibility(
                    f"effects.moving_emitter.reach: the burner swings out of the domain along {'xy'[axis]}; it may "
                    f"reach {max(most, 0) / abs(part):.2g} m",
                    True,
                )


def obstacles(spec: SceneSpec) -> Iterator[Implausibility]:
    """Bodies of the effect that the solver flows around."""
    cell = max(spec.domain.size) / spec.domain.resolution
    low, high = np.array(spec.domain.min), np.array(spec.domain.max)
    for effect in (effect for effect in spec.effects if hasattr(effect, "items")):
        for number, item in enumerate(effect.items):
            name, half = f"effects.obstacles.items[{number}]", np.array(item.size) / 2
            centre = np.array(item.position)
            if ((centre + half <= low) | (centre - half >= high)).any():
                yield Implausibility(
                    f"{name}.position: {point_text(centre)} is outside the domain, {box_text(spec.domain)}", True
                )
            elif (np.abs(np.array(spec.fire.position) - centre) < half).all():
                yield Implausibility(
                    f"{name}.position: the obstacle stands on the burner at {point_text(spec.fire.position)}", True
                )
            elif min(item.size) < CELLS_ACROSS * cell:
                text = (
                    f"{name}.size: {_length(min(item.size))} is {min(item.size) / cell:.1f} cells; gas leaks through "
                )
                yield Implausibility(text + f"less than {CELLS_ACROSS}, which is {CELLS_ACROSS * cell:.2g} m", False)


def _cameras(spec: SceneSpec) -> Iterator[Implausibility]:
    box, burner = spec.box, spec.fire.burner
    low, high = np.array(box.min), np.array(box.max)
    foot = np.array(burner.position) if burner else np.array([*(low + high)[:2] / 2, low[2]])
    radius = burner.radius if burner else 0.0
    part, wide = (burner.name, 2 * radius) if burner else ("whole box of the grids", float(min((high - low)[:2])))
    axis = np.linspace(foot, [foot[0], foot[1], (foot[2] + high[2]) / 2], 9)
    sizes, burning, blind = {}, [], []
    for name, place, sees in zip(spec.cameras.names, positions(spec.cameras), seen(spec.cameras, axis), strict=True):
        aside = float(np.hypot(*(place - foot)[:2]))
        if aside < COLUMN * radius and low[2] <= place[2] <= high[2]:
            burning.append(name)
            continue
        if ((place > low) & (place < high)).all():
            yield Implausibility(f"cameras: {name} at {point_text(place)} is in the domain, {box_text(box)}", False)
        if not sees.any():
            blind.append(name)
            continue
        sizes[name] = spec.picture_px[0] * spec.cameras.focal_mm / (2 * HALF_SENSOR) * wide / max(aside, 1e-9)
    if burning:
        away = _length(COLUMN * radius)
        text = f"cameras: {', '.join(burning)} in the fire at {point_text(foot)}; go more than {away} from its axis"
        yield Implausibility(f"{text} (cameras.radius)", True)
    if blind:
        text = f"cameras: the fire at {point_text(foot)} is not in the picture of {', '.join(blind)}"
        yield Implausibility(f"{text}; change cameras.look_at or cameras.focal_mm, or turn them there", True)
    name = min(sizes, key=sizes.get, default="")
    if name and 0 < sizes[name] < PIXELS_ACROSS:
        more = spec.cameras.focal_mm * PIXELS_ACROSS / sizes[name]
        text = f"cameras: in {name} the {part} is {sizes[name]:.1f} pixels across"
        yield Implausibility(f"{text}; cameras.focal_mm {more:.0f} makes it {PIXELS_ACROSS}, or go nearer", False)


def _room(spec: SceneSpec) -> Iterator[Implausibility]:
    """Fire and cameras in built-in surroundings; the studio is built as large as they need."""
    room, box = FREE_SPACE.get(spec.background), spec.box
    if room is None:
        return
    if box.min[2] < -1e-6:
        yield Implausibility(f"domain.min: reaches {_length(-box.min[2])} below the floor, which is at z = 0", True)
    places = dict(zip(spec.cameras.names, positions(spec.cameras), strict=True))
    for name in (name for name, place in places.items() if place[2] <= 0):
        yield Implausibility(
            f"cameras: {name} at {point_text(places[name])} is below the floor, which is at z = 0", True
        )
    if spec.background == "studio":
        return
    large = 'choose the background "studio", which grows with the fire, or a .blend of yours'
    if box.max[1] > room.high[1]:
        yield Implausibility(
            f"domain: reaches y = {box.max[1]:.3g}, and the {room.wall} of the {spec.background} stand at y = "
            f"{room.high[1]:g}: they would be in the fire; make the domain end there, or {large}",
            True,
        )
    for axis in (0, 1):
        if box.min[axis] < room.low[axis] or (axis == 0 and box.max[0] > room.high[0]):
            yield Implausibility(f"domain: {box_text(box)} is larger than the {spec.background}; {large}", True)
    for name in spec.cameras.whole_clip:  # those all around see through what is nearer than the fire
        place = places[name]
        if place[1] > room.high[1]:
            text = (
                f"cameras: {name} at {point_text(place)} stands behind the {room.wall} of the {spec.background}, which "
            )
            yield Implausibility(text + f"stand at y = {room.high[1]:g}; go nearer, or {large}", True)
        elif (place[:2] < room.low[:2]).any() or place[0] > room.high[0]:
            yield Implausibility(
                f"cameras: {name} at {point_text(place)} is off the floor and sees its edge; {large}", False
            )


def _length(metres: float) -> str:
    return f"{1000 * metres:.3g} mm" if metres < 0.01 else f"{100 * metres:.3g} cm" if metres < 1 else f"{metres:.3g} m"


def point_text(place) -> str:
    """Return a place as people write it."""
    return f"({', '.join(f'{round(float(value), 6) + 0.0:.3g}' for value in place)})"


def box_text(domain: Domain) -> str:
    """Return a box as people write it."""
    return f"{point_text(domain.min)} to {point_text(domain.max)} m"


# ----------------------------------------------------------------
# How much room the built-in surroundings leave for a fire and its cameras.


@dataclass(frozen=True)
class FreeSpace:
    """The free air of surroundings, world metres: from the floor's edges to the wall or what stands before it."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    wall: str
    """The thing at the far side, y = high[1]."""


FREE_SPACE = {
    "studio": FreeSpace((-4.0, -4.0, 0.0), (4.0, 1.95, 5.0), "backdrop"),
    "workshop": FreeSpace((-4.5, -4.5, 0.0), (4.5, 1.4, 4.0), "shelves"),
    "classroom": FreeSpace((-4.5, -4.5, 0.0), (4.5, 1.0, 4.0), "desks"),
    "cloister": FreeSpace((-5.0, -4.65, 0.0), (5.0, 1.3, 4.0), "arcade"),
}
SPARE = 1.05


def studio_scale(spec: SceneSpec) -> float:
    """Return the factor by which the studio is built larger, so that fire and cameras stand in it; 1 where they do."""
    room, box = FREE_SPACE["studio"], spec.box
    reach = [high / wall for high, wall in zip(box.max, room.high, strict=True)]
    reach += [low / wall for low, wall in zip(box.min[:2], room.low[:2], strict=True)]
    cameras = positions(spec.cameras)
    reach += [np.abs(cameras[:, 0]).max() / room.high[0], (cameras[:, 1] / room.low[1]).max()]
    most = float(max(reach))
    return 1.0 if most <= 1 else SPARE * most
