"""A point cloud over time as one USD file: places, velocities, widths, colours, and the Gaussians' own values.

A ``UsdGeom.Points`` has a sample a frame, each with as many points as are seen then; ``ids`` say which is which, and
``velocities`` (per second) let a renderer blur their motion although their number changes. Needs the ``pxr`` modules
that Blender ships, never bpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import DataFormatError
from ...core.files import atomic_path
from ...core.harmonics import C0
from ..voxels import FAINT, linear, state_at
from .cloud import GaussianCloud

SUFFIXES = (".usd", ".usdc", ".usda")
PATH = "/reconstruction"


@dataclass(frozen=True)
class SceneFrames:
    """Frames of the scene: the first, the last, and how many there are in a second."""

    first: int
    last: int
    rate: float


def write(
    path: Path,
    frames: Iterator[tuple[int, VisibleGaussians]],
    clock: SceneFrames,
    to_world: np.ndarray,
    metres_per_unit: float,
) -> None:
    """Write points frame by frame, atomically.

    Args:
        path: one of SUFFIXES; .usda is text.
        frames: number and points of every frame, in order.
        to_world: (4, 4) from the points' metres to the scene's units.
    Raises:
        DataFormatError: this Python has no ``pxr``.
    """
    try:
        from pxr import Gf, Sdf, Usd, UsdGeom, Vt
    except ImportError:
        raise DataFormatError(
            "this Blender comes without the pxr modules for Python: use 4.2 or later, of blender.org"
        ) from None
    arrays = {
        "vector": Vt.Vec3fArray.FromNumpy,
        "color": Vt.Vec4fArray.FromNumpy,
        "number": Vt.FloatArray.FromNumpy,
        # Its quaternions hold the real part last, ours first.
        "quaternion": lambda wxyz: Vt.QuatfArray.FromNumpy(np.ascontiguousarray(np.roll(wxyz, -1, axis=1))),
    }
    with atomic_path(path) as draft:
        stage = Usd.Stage.CreateNew(str(draft))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
        stage.SetTimeCodesPerSecond(clock.rate)
        stage.SetFramesPerSecond(clock.rate)
        stage.SetStartTimeCode(clock.first)
        stage.SetEndTimeCode(clock.last)
        root = UsdGeom.Xform.Define(stage, PATH)
        stage.SetDefaultPrim(root.GetPrim())
        root.AddTransformOp().Set(Gf.Matrix4d(to_world.T.tolist()))  # USD multiplies row vectors
        prim = UsdGeom.Points.Define(stage, f"{PATH}/points")
        kinds, vertex = Sdf.ValueTypeNames, UsdGeom.Tokens.vertex
        primvars = UsdGeom.PrimvarsAPI(prim)

        def value(name: str, kind) -> Usd.Attribute:
            return primvars.CreatePrimvar(name, kind, vertex).GetAttr()

        columns = (
            (prim.CreatePointsAttr(), "position", "vector"),
            (prim.CreateVelocitiesAttr(), "velocity", "vector"),
            (prim.CreateWidthsAttr(), "width", "number"),
            (value("displayColor", kinds.Color3fArray), "color", "vector"),
            (value("displayOpacity", kinds.FloatArray), "opacity", "number"),
            (value("gas_velocity", kinds.Vector3fArray), "gas_velocity", "vector"),
            (value("scale", kinds.Float3Array), "scale", "vector"),
            (value("rotation", kinds.QuatfArray), "rotation", "quaternion"),
            (value("radiance:base", kinds.Float4Array), "radiance", "color"),
        )
        ids, extent = prim.CreateIdsAttr(), prim.CreateExtentAttr()
        prim.SetWidthsInterpolation(vertex)
        for number, points in frames:
            for attribute, name, kind in columns:
                attribute.Set(arrays[kind](np.ascontiguousarray(getattr(points, name), np.float32)), number)
            ids.Set(Vt.Int64Array.FromNumpy(points.row.astype(np.int64)), number)
            extent.Set(Vt.Vec3fArray.FromNumpy(_extent(points)), number)
        stage.GetRootLayer().Save()
        del stage


def _extent(points: VisibleGaussians) -> np.ndarray:
    """Return (2, 3) the lowest and the highest corner; at the origin where nothing is seen."""
    if not len(points):
        return np.zeros((2, 3), np.float32)
    half = points.width[:, None] / 2
    return np.stack([(points.position - half).min(axis=0), (points.position + half).max(axis=0)])


@dataclass(frozen=True)
class VisibleGaussians:
    """M Gaussians that are seen at an instant; float32 unless said otherwise.

    Attributes:
        row: (M,) int64, the Gaussian's number in its file: the same at all times.
        position: (M, 3) m.     velocity: (M, 3) m/s, of the light: how the point moves.
        gas_velocity: (M, 3) m/s, of the gas that shines there.
        scale: (M, 3) m, standard deviations.     rotation: (M, 4) unit quaternion wxyz.
        color: (M, 3) linear light.     opacity: (M,) at this instant.
        radiance: (M, 4) constant spherical harmonic of display red, green and blue, and the opacity.
    """

    row: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    gas_velocity: np.ndarray
    scale: np.ndarray
    rotation: np.ndarray
    color: np.ndarray
    opacity: np.ndarray
    radiance: np.ndarray

    def __len__(self) -> int:
        return len(self.row)

    @property
    def width(self) -> np.ndarray:
        """(M,) m, diameter of the ball of one standard deviation and the Gaussian's volume."""
        return 2 * np.cbrt(self.scale.prod(axis=1, dtype=np.float64)).astype(np.float32)


def at(cloud: GaussianCloud, time_s: float, least: float = FAINT, time_scale: float = 1.0) -> VisibleGaussians:
    """Return the Gaussians of which at least an opacity `least` is left at a time.

    Args:
        time_scale: how many seconds of the recording pass in one second of the scene; velocities are on that clock.
    """
    place, opacity = state_at(cloud, time_s)
    seen = np.flatnonzero((opacity >= least) & np.isfinite(place).all(axis=1))
    moving = cloud.dynamic[seen, None] * np.float32(time_scale)
    color, left = cloud.color[seen].astype(np.float64), opacity[seen]
    return VisibleGaussians(
        seen,
        place[seen].astype(np.float32),
        cloud.velocity[seen] * moving,
        cloud.moving_gas[seen] * np.float32(time_scale),
        cloud.scale[seen],
        cloud.rotation[seen],
        linear(color).astype(np.float32),
        left.astype(np.float32),
        np.column_stack([(color - 0.5) / C0, left]).astype(np.float32),
    )
