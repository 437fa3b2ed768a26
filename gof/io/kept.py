"""What a lossy file keeps of a result: how far pictures, places and velocities are from those it was made of."""

from __future__ import annotations

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians

SIDE_PX, FOCAL_PX = 400, 800.0
INSTANTS = (0.25, 0.5, 0.75)  # of the clip
VISIBLE = 1 / 255  # opacity below which a Gaussian changes no 8-bit picture
LIT = 0.02  # display value from which a pixel shows something


def what_is_kept(before: TransientGaussians, after: TransientGaussians, start_s: float, end_s: float) -> str:
    """Return in words how far Gaussians are from the same ones before, row by row: dB, mm and mm/s.

    Pictures are compared where either shows something, from the front, at three instants of the clip, by the PSNR of
    display values within [0, 1].
    """
    place = 1e3 * np.linalg.norm(after.position - before.position, axis=1)
    words = [f"places are {np.sqrt(np.mean(place**2)):.2g} mm off (rms; at most {place.max():.2g})"]
    for name, label in (("velocity", "velocities"), ("gas_velocity", "those of the gas")):
        one, other = getattr(before, name), getattr(after, name)
        if one is not None and other is not None and before.dynamic.any():
            off = 1e3 * np.linalg.norm(other - one, axis=1)[before.dynamic]
            words.append(f"{label} {np.sqrt(np.mean(off**2)):.2g} mm/s (rms; at most {off.max():.2g})")
    psnr = _psnr(before, after, [start_s + share * (end_s - start_s) for share in INSTANTS])
    return f"compared with what was written: {', '.join(words)}; pictures from the front " + (
        "show nothing then" if psnr is None else f"agree to {psnr:.1f} dB"
    )


def _psnr(before: TransientGaussians, after: TransientGaussians, times_s: list[float]) -> float | None:
    """Return dB, inf where nothing differs, None where nothing is seen."""
    from gof.render import render

    squares = []
    for time_s in times_s:
        camera = _front(before, time_s)
        if camera is None:
            continue
        one, other = (np.clip(render(g, camera, time_s)["color"], 0, 1) for g in (before, after))
        lit = np.maximum(one, other).max(-1) > LIT
        squares.append(((one - other)[lit] ** 2).reshape(-1))
    off = np.concatenate(squares) if squares else np.zeros(0)
    if not len(off):
        return None
    return float(-10 * np.log10(off.mean())) if off.any() else float("inf")


def _front(g: TransientGaussians, time_s: float) -> Camera | None:
    """Return a camera that looks along +y at most of what is seen at a time; None where nothing is."""
    position, opacity = g.at(time_s)
    seen = position[opacity >= VISIBLE]
    if not len(seen):
        return None
    low, high = np.percentile(seen.astype(np.float64), [2, 98], axis=0)
    middle, reach = (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)
    rows = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    pose = np.eye(4)
    pose[:3, :3] = rows
    pose[:3, 3] = -rows @ (middle - [0, 2.5 * reach * FOCAL_PX / (SIDE_PX / 2), 0])
    K = np.array([[FOCAL_PX, 0, SIDE_PX / 2], [0, FOCAL_PX, SIDE_PX / 2], [0, 0, 1]])
    return Camera("front", SIDE_PX, SIDE_PX, K, pose)
