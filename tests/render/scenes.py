"""Small random scenes shared by the renderer's tests."""

import numpy as np

from gof.core.cameras import Camera


def camera(width=50, height=37, **kwargs) -> Camera:
    """Looks along +y at the origin from 2 m away; slightly rotated, principal point off centre."""
    c, s = np.cos(0.1), np.sin(0.1)
    R = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    W = np.eye(4)
    W[:3, :3], W[:3, 3] = R, R @ -np.array([0.1, -2.0, 0.05])
    f = 1.2 * max(width, height)
    return Camera(
        "test", width, height, [[f, 0, width / 2 + 0.7], [0, 1.05 * f, height / 2 - 0.4], [0, 0, 1]], W, **kwargs
    )


def gaussians(
    n: int, seed: int = 0, size: float = 0.05, spread: float = 0.35, channels: int = 3
) -> dict[str, np.ndarray]:
    """float64 parameters in the order of `Splats`, exactly representable in float32."""
    r = np.random.default_rng(seed)
    values = {
        "position": r.normal(0, spread, (n, 3)),
        "rotation": r.normal(size=(n, 4)),
        "scale": np.exp(r.normal(np.log(size), 0.6, (n, 3))),
        "opacity": r.uniform(0.05, 0.95, n),
        "color": r.uniform(-0.2, 1.5, (n, channels)),
    }
    return {k: v.astype(np.float32).astype(np.float64) for k, v in values.items()}


_FOUND: dict[tuple, object] = {}


def found_once(key: tuple, find):
    """What `find()` gives, the first time: the differences of the float64 twin, whichever kernels draw."""
    if key not in _FOUND:
        _FOUND[key] = find()
    return _FOUND[key]
