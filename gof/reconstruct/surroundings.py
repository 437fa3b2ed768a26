"""Surroundings of a flame in the optimisation: a plate per camera behind it, or still Gaussians all around it.

The paper draws static and flame Gaussians in one pass. The still ones do not change meanwhile, so of each camera's view
of them what is nearer than all of the flame, and what is farther, is drawn once; only what stands among the flame is
drawn with it, again and again. The picture is the same (tested), for a fraction of the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import drjit as dr
import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.reconstruct.parameters import PLATE, rows
from gof.reconstruct.voxels import ROOM, FlameVoxels
from gof.render import Splats, render, render_splats
from gof.render.backend import Array3f, Float, UInt
from gof.render.light import show_before, to_light
from gof.render.rasterizer import Frame, splats_at
from gof.render.scene import Stack, columns


class DrawnView(NamedTuple):
    """A camera's view: colour planes in display values, the flame's share of each pixel, and how it was drawn.

    The first Gaussians of `frame` are the flame's, in their order.
    """

    color: list[Float]
    share: Float
    frame: Frame


class Surroundings(Protocol):
    """Surroundings of the flame."""

    @property
    def emissive(self) -> bool:
        """Whether the flame's light is added to what lies behind it (`TransientGaussians.emissive`)."""

    def unknowns(self) -> dict[str, Any]:
        """Return the raw parameters that the optimisation may change, by name."""

    def draw(self, flame: Splats, camera: int, near: float, unknowns: Any, stack: Stack | None = None) -> DrawnView:
        """Draw the camera's view with the flame in it.

        Args:
            near: m, Gaussians closer to the camera are not drawn.   unknowns: where those of `unknowns` are now.
            stack: several pictures of the camera's at once.
        """

    def moved(self, camera: int, unknowns: Any) -> Any:
        """Return the change of the surroundings since the start, in this camera's view; differentiable.

        Mean square, display values; 0 where they do not change.
        """

    def result(self, flame: TransientGaussians, unknowns: Any) -> tuple[TransientGaussians, list[np.ndarray]]:
        """Return the whole result, and the plates it is to be drawn over; none where it is whole.

        C x (H, W, 3) display values, and where something stands before the flame a fourth (`gof.dataset.plates`).
        """


class Plates:
    """A picture without flame per camera: fast, exact from where it was taken, and behind the flame.

    But for pixels in which a camera's view is blocked (`occluders`): there it is before the flame.
    """

    def __init__(self, cameras: list[Camera], plates: np.ndarray, blocked: np.ndarray, move: bool, emissive: bool):
        """
        Args:
            plates: (C, H, W, 3) display values.   blocked: (C, H, W) bool.
            move: whether the optimisation may change the plates.   emissive: see `Surroundings`.
        """
        self.emissive = emissive
        self._cameras, self._shape, self._blocked, self._move = cameras, plates.shape[1:], blocked, move
        self._plates = {f"{PLATE}{c}": columns(plate.reshape(-1, 3), Array3f) for c, plate in enumerate(plates)}
        self._through = [Float((~b).ravel().astype(np.float32)) if b.any() else None for b in blocked]

    def unknowns(self) -> dict[str, Any]:
        return self._plates if self._move else {}

    def moved(self, camera: int, unknowns: Any) -> Any:
        change = self._at(camera, unknowns) - self._plates[f"{PLATE}{camera}"]
        return dr.mean(dr.squared_norm(change)) / 3 if self._move else 0.0

    def draw(self, flame: Splats, camera: int, near: float, unknowns: Any, stack: Stack | None = None) -> DrawnView:
        plate, through = self._at(camera, unknowns), self._through[camera]
        planes = [plate.x, plate.y, plate.z]
        frame = render_splats(flame, self._cameras[camera], near=near, stack=stack)
        pictures = 1 if stack is None else stack.count
        if self.emissive:
            color = show_before(frame.color, frame.alpha, [to_light(plane) for plane in planes], pictures)
        else:
            pairs = zip(frame.color, planes, strict=True)
            color = [dr.fma(1 - frame.alpha, dr.tile(plane, pictures), drawn) for drawn, plane in pairs]
        if through is None:
            return DrawnView(color, frame.alpha, frame)
        through, stills = dr.tile(through, pictures), [dr.tile(plane, pictures) for plane in planes]
        color = [dr.fma(through, drawn - still, still) for drawn, still in zip(color, stills, strict=True)]
        return DrawnView(color, through * frame.alpha, frame)

    def result(self, flame: TransientGaussians, unknowns: Any) -> tuple[TransientGaussians, list[np.ndarray]]:
        plates = [rows(self._at(c, unknowns)).reshape(self._shape) for c in range(len(self._cameras))]
        before = [b[..., None].astype(np.float32) for b in self._blocked]
        flame = replace(flame, emissive=self.emissive)
        return flame, [np.concatenate([p, b], -1) if b.any() else p for p, b in zip(plates, before, strict=True)]

    def _at(self, camera: int, unknowns: Any) -> Array3f:
        name = f"{PLATE}{camera}"
        return unknowns[name] if self._move else self._plates[name]


class StillScene:
    """Static Gaussians: what is nearer hides the flame, and it is seen from where no camera stood.

    Both are drawn in one pass, front to back, which blends display values.
    """

    emissive = False

    def __init__(self, still: TransientGaussians, cameras: list[Camera], voxels: FlameVoxels):
        """voxels: where the flame is."""
        self._still, self._cameras = still, cameras
        self._layers = [_Layers.of(still, camera, voxels) for camera in cameras]

    def unknowns(self) -> dict[str, Any]:
        return {}

    def moved(self, camera: int, unknowns: Any) -> Any:
        return 0.0

    def draw(self, flame: Splats, camera: int, near: float, unknowns: Any, stack: Stack | None = None) -> DrawnView:
        layers, view = self._layers[camera], self._cameras[camera]
        if stack is not None:
            layers, stack = _stacked(layers, stack)
        if layers.among is None:
            frame = render_splats(flame, view, background=layers.behind, near=near, stack=stack)
            share = frame.alpha
        else:
            is_flame = dr.concat([dr.full(Float, 1, len(flame)), dr.zeros(Float, len(layers.among))])
            both = _together(flame, layers.among)
            frame = render_splats(both, view, background=layers.behind, near=near, dynamic=is_flame, stack=stack)
            share = frame.dynamic_alpha
        through = layers.through
        color = [dr.fma(through, drawn, front) for drawn, front in zip(frame.color, layers.front, strict=True)]
        return DrawnView(color, through * share, frame)

    def result(self, flame: TransientGaussians, unknowns: Any) -> tuple[TransientGaussians, list[np.ndarray]]:
        return TransientGaussians.concatenate([self._still, flame]), []


@dataclass(frozen=True)
class _Layers:
    """One camera's view of the still scene, cut at the distances of the flame; planes (H * W,).

    Attributes:
        front: 3 planes, display values times how much of the pixel they fill.   through: what is left of a pixel.
        among: still Gaussians at the flame's distances; None without any.   behind: 3 planes of display values.
    """

    front: list[Float]
    through: Float
    among: Splats | None
    behind: list[Float]

    @classmethod
    def of(cls, still: TransientGaussians, camera: Camera, voxels: FlameVoxels) -> _Layers:
        room = ROOM * voxels.voxel_size
        flame_z = camera.to_camera(voxels.center)[:, 2]
        z = camera.to_camera(still.position)[:, 2]
        nearer, farther = z < flame_z.min() - room, z > flame_z.max() + room
        front, through = _drawn(still[nearer], camera, voxels.voxel_size)
        behind, _ = _drawn(still[farther], camera, voxels.voxel_size)
        among = still[~nearer & ~farther]
        return cls(front, through, splats_at(among, camera, 0.0) if len(among) else None, behind)


def _stacked(layers: _Layers, stack: Stack) -> tuple[_Layers, Stack]:
    """Return the same view once for each picture, and the stack with those among the flame behind the flame's own."""

    def again(x: Any) -> Any:
        return dr.tile(x, stack.count)

    planes = [again(plane) for plane in layers.front], again(layers.through)
    behind = [again(plane) for plane in layers.behind]
    if layers.among is None:
        return _Layers(*planes, None, behind), stack
    s = layers.among
    among = Splats(
        again(s.position), again(s.rotation), again(s.scale), again(s.opacity), [again(column) for column in s.color]
    )
    picture = dr.concat([stack.picture, dr.repeat(dr.arange(UInt, stack.count), len(s))])
    return _Layers(*planes, among, behind), Stack(stack.count, picture)


def _drawn(still: TransientGaussians, camera: Camera, near: float) -> tuple[list[Float], Float]:
    """Colour planes over black, and what is left of every pixel."""
    pixels = camera.width * camera.height
    if not len(still):
        return [dr.zeros(Float, pixels) for _ in range(3)], dr.full(Float, 1, pixels)
    drawn = render(still, camera, 0.0, near=near)
    planes = [Float(np.ascontiguousarray(drawn["color"][..., k].ravel())) for k in range(3)]
    return planes, Float(1 - drawn["alpha"].ravel())


def _together(flame: Splats, still: Splats) -> Splats:
    def joined(a: Any, b: Any) -> Any:
        return type(a)(*(dr.concat([x, y]) for x, y in zip(a, b, strict=True)))

    return Splats(
        joined(flame.position, still.position),
        joined(flame.rotation, still.rotation),
        joined(flame.scale, still.scale),
        dr.concat([flame.opacity, still.opacity]),
        [dr.concat([a, b]) for a, b in zip(flame.color, still.color, strict=True)],
    )
