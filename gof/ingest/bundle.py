"""Robust bundle adjustment, with known focal lengths or free ones: Levenberg-Marquardt on the Schur complement (Triggs
et al. 2000).

Turning and moving trade off against each other almost freely when cameras are a few degrees apart: the cost has a long,
shallow valley. Exact derivatives and the exact step follow it to its end; a general solver stopped where it came in.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

MOST_STEPS = 200
ENOUGH = 1e-7  # relative decrease of the cost below which the minimum is reached
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-12, 1e8
TINY = 1e-12
MOST_ZOOM = 3.0  # logarithm of a factor on a focal length: no step goes where numbers end
EXACT = 1e-8  # cost of a sighting, that is 1e-4 of its uncertainty, below which nothing is gained
BEHIND = 1e3  # residual of a point behind its camera: a loss, but no pull in any direction


@dataclass(frozen=True)
class Sightings:
    """O pixels in which cameras see points: free points, or points of bodies, whose shape is known.

    Attributes:
        camera: (O,) number.   pixel: (O, 2).   weight: (O,) 1 / the pixel's uncertainty in px.
        point: (O,) number of the free point, -1 for a point of a body.
        body: (O,) number of the body of such a point.   xyz: (O, 3) where it lies in its body.
    """

    camera: np.ndarray
    pixel: np.ndarray
    weight: np.ndarray
    point: np.ndarray
    body: np.ndarray
    xyz: np.ndarray

    def sorted(self) -> Sightings:
        """Return those of one free point after each other, points of bodies first."""
        order = np.argsort(self.point, kind="stable")
        return Sightings(*(getattr(self, name)[order] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class BundleParameters:
    """The adjusted quantities: cameras (C, 4, 4) world to camera, bodies (B, 4, 4) body to world, free points (N, 3),
    and zooms (Z,), logarithms of the factors on the focal lengths of cameras that share one; none where lenses are
    known."""

    cameras: np.ndarray
    bodies: np.ndarray
    points: np.ndarray
    zooms: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def moved(self, step: np.ndarray, shift: np.ndarray) -> BundleParameters:
        """By rotation vectors and shifts of cameras and bodies, then changes of zooms, (6 C + 6 B + Z,), and shifts (N,
        3) of points."""
        count = len(self.cameras)
        poses, zooms = np.split(step, [6 * (count + len(self.bodies))])
        poses = poses.reshape(-1, 6)
        bodies = _moved(self.bodies, poses[count:])
        return BundleParameters(_moved(self.cameras, poses[:count]), bodies, self.points + shift, self.zooms + zooms)

    def about(self, origin: np.ndarray) -> BundleParameters:
        """Return the same in a world whose origin (3,) is there."""
        cameras, bodies = self.cameras.copy(), self.bodies.copy()
        cameras[:, :3, 3] += cameras[:, :3, :3] @ origin
        bodies[:, :3, 3] -= origin
        return replace(self, cameras=cameras, bodies=bodies, points=self.points - origin)


@dataclass(frozen=True)
class Anchor:
    """Poses near which cameras stand, and how far they may be off: what pulls where pixels say nothing.

    Attributes:
        cameras: (C, 4, 4) world to camera.
        turn_rad: (3,) standard deviation of the turn about the camera's axes.
        place: (3,) standard deviation of the camera's centre along the world's axes, in the world's unit; all > 0.
    """

    cameras: np.ndarray
    turn_rad: np.ndarray
    place: np.ndarray

    def about(self, origin: np.ndarray) -> Anchor:
        """Return the same in a world whose origin (3,) is there."""
        cameras = self.cameras.copy()
        cameras[:, :3, 3] += cameras[:, :3, :3] @ origin
        return replace(self, cameras=cameras)

    def residual(self, cameras: np.ndarray) -> np.ndarray:
        """Return (C, 6) by how many standard deviations cameras (C, 4, 4) are turned and moved."""
        from scipy.spatial.transform import Rotation  # here: it takes long to load

        turn = Rotation.from_matrix(cameras[:, :3, :3] @ np.swapaxes(self.cameras[:, :3, :3], 1, 2)).as_rotvec()
        return np.concatenate([turn / self.turn_rad, (_centres(cameras) - _centres(self.cameras)) / self.place], 1)

    def slope(self, cameras: np.ndarray) -> np.ndarray:
        """Return (C, 6, 6) of the residual by `BundleParameters.moved`'s step; of the turn near the anchor."""
        J = np.zeros((len(cameras), 6, 6))
        back = np.swapaxes(cameras[:, :3, :3], 1, 2)
        J[:, :3, :3] = np.diag(1 / self.turn_rad)
        J[:, 3:, :3] = -back @ _cross(cameras[:, :3, 3]) / self.place[:, None]
        J[:, 3:, 3:] = -back / self.place[:, None]
        return J

    def cost(self, cameras: np.ndarray) -> float:
        """Half the sum of squares, which is what soft L1 is near zero."""
        return 0.5 * float((self.residual(cameras) ** 2).sum())


def _centres(cameras: np.ndarray) -> np.ndarray:
    return -np.einsum("cji,cj->ci", cameras[:, :3, :3], cameras[:, :3, 3])


def _moved(poses: np.ndarray, step: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation  # here: it takes long to load

    result = poses.copy()
    result[:, :3, :3] = Rotation.from_rotvec(step[:, :3]).as_matrix() @ poses[:, :3, :3] if len(poses) else 0
    result[:, :3, 3] += step[:, 3:]
    return result


@dataclass(frozen=True)
class _Projection:
    """Residuals (O, 2), weighted, and what their derivatives need: see `_project`."""

    residual: np.ndarray
    slope: np.ndarray  # (O, 2, 3) of the residual by the point in the camera's axes
    in_camera: np.ndarray  # (O, 3) the point turned, not yet shifted, into the camera's axes
    in_world: np.ndarray  # (O, 3) a body's point turned, not yet shifted, into the world's
    by_zoom: np.ndarray  # (O, 2) derivative of the residual by the camera's zoom

    @property
    def cost(self) -> float:
        """Soft L1 at one standard deviation."""
        square = (self.residual**2).sum(1)
        return float((square / (np.sqrt(1 + square) + 1)).sum())


@dataclass(frozen=True)
class _Lenses:
    """K (C, 3, 3) of the cameras, and the number (C,) of the zoom by which each one's focal lengths are multiplied, -1
    where they are known."""

    K: np.ndarray
    zoom: np.ndarray

    def at(self, zooms: np.ndarray) -> np.ndarray:
        """Return (C, 3, 3) at these zooms (Z,)."""
        K, free = self.K.copy(), self.zoom >= 0
        factor = np.exp(np.clip(zooms, -MOST_ZOOM, MOST_ZOOM))
        K[free, :2, :2] *= factor[self.zoom[free], None, None]
        return K


def adjust(
    start: BundleParameters,
    seen: Sightings,
    K: np.ndarray,
    zoom: np.ndarray | None = None,
    anchor: Anchor | None = None,
) -> BundleParameters:
    """Return the state near `start` that explains the pixels best (soft L1, so that single mismatches hardly pull).

    Args:
        K: (C, 3, 3) of the cameras.
        zoom: (C,) number of the zoom of `start` that each camera has, -1 for those whose lens is known; None: all are.
        anchor: where the cameras are known to stand roughly; None: nothing is known of it.
    Returns:
        in a world that is only near the start's: cameras, bodies and points may have moved as a whole.
    """
    seen, lenses = seen.sorted(), _Lenses(K, np.full(len(K), -1) if zoom is None else zoom)
    # About a middle of what is seen: far from the world's origin turning is moving, to the last digit.
    middle = np.median(np.concatenate([start.points, start.bodies[:, :3, 3]]), 0)
    state, damping = start.about(middle), DAMPING
    anchor = None if anchor is None else anchor.about(middle)
    now = _project(state, seen, lenses)
    cost = now.cost + _pull_of(anchor, state)
    for _ in range(MOST_STEPS):
        normal = _Normal.of(state, seen, now, lenses)
        normal = normal if anchor is None else normal.held(anchor, state.cameras)
        while damping < MOST_DAMPING:
            trial = state.moved(*normal.step(damping))
            then = _project(trial, seen, lenses)
            less = then.cost + _pull_of(anchor, trial)
            if less < cost:
                break
            damping *= 4
        else:
            break  # no step helps: it is the minimum, to the last digit
        gain = (cost - less) / (cost + EXACT * len(seen.camera))
        state, now, cost, damping = trial, then, less, max(damping / 5, LEAST_DAMPING)
        if gain < ENOUGH:
            break
    return state.about(-middle)


def _pull_of(anchor: Anchor | None, state: BundleParameters) -> float:
    return 0.0 if anchor is None else anchor.cost(state.cameras)


def misfit(state: BundleParameters, seen: Sightings, K: np.ndarray, zoom: np.ndarray) -> float:
    """Return the cost that `adjust` makes least, per sighting."""
    return _project(state, seen.sorted(), _Lenses(K, zoom)).cost / len(seen.camera)


def _project(state: BundleParameters, seen: Sightings, lenses: _Lenses) -> _Projection:
    free = seen.point >= 0
    world, in_world = np.zeros_like(seen.xyz), np.zeros_like(seen.xyz)
    world[free] = state.points[seen.point[free]]
    body = state.bodies[seen.body[~free]]
    in_world[~free] = np.einsum("oij,oj->oi", body[:, :3, :3], seen.xyz[~free])
    world[~free] = in_world[~free] + body[:, :3, 3]

    pose = state.cameras[seen.camera]
    in_camera = np.einsum("oij,oj->oi", pose[:, :3, :3], world)
    local = in_camera + pose[:, :3, 3]
    front = local[:, 2] > 1e-6 * np.linalg.norm(local, axis=1)
    depth = np.where(front, local[:, 2], 1.0)
    uv = local[:, :2] / depth[:, None]
    lens = lenses.at(state.zooms)[seen.camera]
    from_middle = np.einsum("oij,oj->oi", lens[:, :2, :2], uv)
    pixel = from_middle + lens[:, :2, 2]
    slope = np.zeros((len(uv), 2, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = 1
    slope[:, :, 2] = -uv
    slope = lens[:, :2, :2] @ slope * (front * seen.weight / depth)[:, None, None]
    residual = np.where(front[:, None], (pixel - seen.pixel) * seen.weight[:, None], BEHIND)
    return _Projection(residual, slope, in_camera, in_world, from_middle * (front * seen.weight)[:, None])


@dataclass(frozen=True)
class _Normal:
    """Gauss-Newton's equations, weighted by the loss, in blocks: poses and zooms (P parameters) and N free points.

    Attributes:
        poses: (P, P).   mixed: (N, P, 3).   points: (N, 3, 3).   pull, pulls: (P,) and (N, 3) gradients.
    """

    poses: np.ndarray
    mixed: np.ndarray
    points: np.ndarray
    pull: np.ndarray
    pulls: np.ndarray

    @classmethod
    def of(cls, state: BundleParameters, seen: Sightings, now: _Projection, lenses: _Lenses) -> _Normal:
        O, count = len(seen.camera), len(state.cameras)
        by_world = now.slope @ state.cameras[seen.camera, :3, :3]
        J = np.zeros((O, 2, count + len(state.bodies), 6))
        J[np.arange(O), :, seen.camera] = np.concatenate([-now.slope @ _cross(now.in_camera), now.slope], 2)
        known = np.flatnonzero(seen.point < 0)
        turn = -by_world[known] @ _cross(now.in_world[known])
        J[known, :, count + seen.body[known]] = np.concatenate([turn, by_world[known]], 2)
        stretch = np.zeros((O, 2, len(state.zooms)))
        zoomed = np.flatnonzero(lenses.zoom[seen.camera] >= 0)
        stretch[zoomed, :, lenses.zoom[seen.camera[zoomed]]] = now.by_zoom[zoomed]
        J = np.concatenate([J.reshape(O, 2, -1), stretch], 2)
        weighted = J / np.sqrt(1 + (now.residual**2).sum(1))[:, None, None]
        share = by_world / np.sqrt(1 + (now.residual**2).sum(1))[:, None, None]

        free = slice(len(known), None)  # sightings are sorted
        first = np.searchsorted(seen.point[free], np.arange(len(state.points)))

        def per_point(values: np.ndarray) -> np.ndarray:
            return np.add.reduceat(values, first) if len(first) else values[:0]

        return cls(
            np.tensordot(weighted, J, ([0, 1], [0, 1])),
            per_point(np.swapaxes(weighted[free], 1, 2) @ by_world[free]),
            per_point(np.swapaxes(share[free], 1, 2) @ by_world[free]),
            np.tensordot(weighted, now.residual, ([0, 1], [0, 1])),
            per_point((np.swapaxes(share[free], 1, 2) @ now.residual[free, :, None])[..., 0]),
        )

    def held(self, anchor: Anchor, cameras: np.ndarray) -> _Normal:
        """Return the equations with the pull of an anchor on cameras (C, 4, 4)."""
        poses, pull = self.poses.copy(), self.pull.copy()
        for c, (J, r) in enumerate(zip(anchor.slope(cameras), anchor.residual(cameras), strict=True)):
            own = slice(6 * c, 6 * c + 6)
            poses[own, own] += J.T @ J
            pull[own] += J.T @ r
        return replace(self, poses=poses, pull=pull)

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (P,) and (N, 3): the step, damped in proportion to the diagonal."""
        size = np.einsum("nii->ni", self.points)
        inverse = np.linalg.inv(
            self.points + (damping * size + TINY * size.max(1, keepdims=True) + 1e-300)[..., None] * np.eye(3)
        )
        back = self.mixed @ inverse
        reduced = self.poses + damping * np.diag(np.diag(self.poses)) - np.tensordot(back, self.mixed, ([0, 2], [0, 2]))
        step = -np.linalg.lstsq(reduced, self.pull - np.tensordot(back, self.pulls, ([0, 2], [0, 1])), rcond=TINY)[0]
        rest = self.pulls + np.tensordot(self.mixed, step, (1, 0))
        return step, -(inverse @ rest[..., None])[..., 0]


def _cross(vectors: np.ndarray) -> np.ndarray:
    """Return (O, 3, 3) matrices that take the cross product with vectors (O, 3) from the left."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
