"""Bodies of a user's scene in the domain of a fire that we simulate: which of them the gas does not feel.

The solver knows obstacles alone. Other things in the domain are drawn, and gas and flame pass through them: a spec may
mean that, so it is a warning, never an error.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from . import plausibility
from .effects.obstacles import Obstacle, Settings
from .fires import Domain, Fire
from .spec import SceneSpec

TOLD = 3  # bodies that are named one by one
BORDER = 0.5  # cells inside the domain's sides, which a floor or a wall may touch


@dataclass(frozen=True)
class Body:
    """One object of a scene, or all instances of it, as it looks in a render."""

    name: str
    triangles: np.ndarray
    """(T, 3, 3) corners, world metres of the spec."""
    is_obstacle: bool = False
    """The solver knows it."""


def air(spec: SceneSpec) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the domain without its outermost half cells, world metres."""
    border = BORDER * max(spec.domain.size) / spec.domain.resolution
    return np.array(spec.domain.min) + border, np.array(spec.domain.max) - border


def notes(spec: SceneSpec, bodies: Iterable[Body]) -> list[str]:
    """Return notes for the maker of the scene on them; none where no gas is simulated."""
    if not isinstance(spec.fire, Fire):
        return []
    low, high = air(spec)
    burner, half = np.array(spec.fire.position), np.array(spec.fire.half_size)
    in_burner, in_gas = [], []
    for body in bodies:
        if reach_into(body.triangles, burner - half, burner + half).any():
            in_burner.append(body)
        elif not body.is_obstacle and (inside := reach_into(body.triangles, low, high)).any():
            in_gas.append(replace(body, triangles=body.triangles[inside]))
    return [*_told(in_burner, _in_burner, spec), *_told(in_gas, _in_gas, spec)]


def reach_into(triangles: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return (T,) whether each triangle (T, 3, 3) and the box have a point in common, by separating axes.

    Source: Akenine-Moeller, Fast 3D triangle-box overlap testing, 2001. A surface around the box has none.
    """
    half = (np.asarray(high) - low) / 2
    corners = np.asarray(triangles, float) - (np.asarray(low) + half)
    near = (corners.min(1) <= half).all(1) & (corners.max(1) >= -half).all(1)
    corners = corners[near]
    edges = np.roll(corners, -1, axis=1) - corners
    axes = np.cross(np.eye(3)[None, :, None], edges[:, None]).reshape(-1, 9, 3)
    axes = np.concatenate([axes, np.cross(edges[:, 0], edges[:, 1])[:, None]], axis=1)
    along = np.einsum("tak,tck->tac", axes, corners)
    reach = np.abs(axes) @ half
    near[near] = ((along.min(2) <= reach) & (along.max(2) >= -reach)).all(1)
    return near


def _told(bodies: list[Body], tell, spec: SceneSpec) -> Iterator[str]:
    """Yield a line for each of the first, and one for all others."""
    for body in bodies[:TOLD]:
        yield tell(body, spec)
    if others := [body.name for body in bodies[TOLD:]]:
        yield f"and {len(others)} more: {', '.join(map(repr, others[:10]))}{' ...' if others[10:] else ''}"


def _in_burner(body: Body, spec: SceneSpec) -> str:
    where = f"{body.name!r} stands in the burner at {plausibility.point_text(spec.fire.position)}"
    if body.is_obstacle:
        return f"{where} and is an obstacle: no gas comes out there. Move it, or remove its Fluid physics"
    return f"{where}: fuel comes out of it. Leave it if that is what burns (logs, a wick); else move it or the fire"


def _in_gas(body: Body, spec: SceneSpec) -> str:
    text = (
        f"{body.name!r} is in the domain and no obstacle: gas and flame pass through it. Move it if it is in their "
        "way, or give it Physics > Fluid > Effector in Blender"
    )
    block = _block(body.triangles, spec)
    if block is None:
        return text
    place, size = (plausibility.point_text(values) for values in (block.position, block.size))
    return f"{text}; or list a block: effects.obstacles, shape box, position {place}, size {size} m"


def _block(triangles: np.ndarray, spec: SceneSpec) -> Obstacle | None:
    """Return an obstacle as large as what of a body is in the domain; None where it would stand on the burner."""
    domain: Domain = spec.domain
    corners = triangles.reshape(-1, 3)
    low, high = np.maximum(corners.min(0), domain.min), np.minimum(corners.max(0), domain.max)
    least = plausibility.CELLS_ACROSS * max(domain.size) / domain.resolution
    size = tuple(float(f"{side:.3g}") for side in np.maximum(high - low, 1.01 * least))
    place = tuple(float(f"{value:.3g}") for value in (low + high) / 2)
    block = Obstacle("box", place, size)
    alone = replace(spec, effects=(Settings((block,)),))
    return None if any(finding.fatal for finding in plausibility.obstacles(alone)) else block
