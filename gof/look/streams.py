"""Stream plots of velocity: Gaussians max-projected along the depth and cut at one X, and the truth at these places."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter, map_coordinates

from gof.core.gaussians import TransientGaussians
from gof.evaluate.draws import own_generator
from gof.evaluate.intervals import weighted_quantile

CELLS = 72  # along the longest side of the box
FAINT = 0.02  # of the largest density: below, nothing is drawn
FLOATERS = 0.002  # share of the weight that may lie outside the box at each end of an axis
RAMP = np.array(
    [[38, 12, 60], [120, 28, 109], [188, 55, 84], [237, 105, 37], [251, 180, 26], [252, 250, 190]], float
)  # dark to bright
GROUND = (18, 18, 20)


class Volume(NamedTuple):
    density: np.ndarray  # (X, Y, Z) summed s_x s_y s_z alpha per cell, any unit
    velocity: np.ndarray  # (X, Y, Z, 3) m/s, weighted mean
    low: np.ndarray  # (3,) m
    cell: float  # m

    def centres(self) -> np.ndarray:
        index = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in self.density.shape), indexing="ij"), -1)
        return self.low + index * self.cell


def volume(gaussians: TransientGaussians, time_s: float) -> Volume:
    """The dynamic Gaussians that live at a time, summed into cubic cells and blurred by one cell; at least one must."""
    position, opacity = gaussians.at(time_s)
    weight = gaussians.scale.astype(np.float64).prod(1) * opacity * gaussians.dynamic
    keep = weight > 1e-9 * max(weight.sum(), 1e-300)
    weight = weight[keep]
    position = position[keep].astype(np.float64)
    velocity = gaussians.moving_gas[keep].astype(np.float64)
    # of each axis the middle 99.6 % of the weight: a few floaters must not shrink the flame
    low, high = (np.array([weighted_quantile(x, weight, q) for x in position.T]) for q in (FLOATERS, 1 - FLOATERS))
    cell = float(max((high - low).max(), 1e-3) / (CELLS - 8))
    low = low - 4 * cell
    shape = np.maximum(np.ceil((high - low) / cell).astype(int) + 4, 9)
    index = np.floor((position - low) / cell).astype(int)
    inside = ((index >= 0) & (index < shape)).all(1)
    flat = np.ravel_multi_index(tuple(index[inside].T), shape)
    sums = [np.bincount(flat, weight[inside] * c, int(shape.prod())).reshape(shape) for c in (1.0, *velocity[inside].T)]
    density, *momentum = (gaussian_filter(s, 1.0, mode="constant") for s in sums)
    filled = density > 1e-6 * density.max()
    mean = [np.where(filled, m / np.where(filled, density, 1), 0) for m in momentum]
    return Volume(density, np.stack(mean, -1), low, cell)


def max_projection(density: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Seen along Y: density (X, Z) of the densest cell of each column, and its (v_x, v_z) (X, Z, 2)."""
    j = density.argmax(1)[:, None, :]
    picked = np.take_along_axis(velocity, j[..., None], 1)[:, 0]
    return np.take_along_axis(density, j, 1)[:, 0], picked[..., [0, 2]]


def x_slice(density: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The plane of constant X through the centre of mass: density (Y, Z), (v_y, v_z) (Y, Z, 2), and its cell number."""
    i = round(float((density.sum((1, 2)) * np.arange(len(density))).sum() / density.sum()))
    return density[i], velocity[i][..., 1:], i


def streamlines(velocity: np.ndarray, density: np.ndarray, spacing: float = 2.6, steps: int = 22) -> list[np.ndarray]:
    """Lines (P, 2) in cells along `velocity` (A, B, 2), seeded evenly where there is density, drawn both ways.

    Fourth-order steps of 0.3 cells along the direction; a line ends where the density is faint or nothing moves.
    """
    bound = FAINT * density.max()
    a, b = (np.arange(spacing / 2, n, spacing) for n in density.shape)
    jitter = own_generator("starts of stream lines").uniform(-0.8, 0.8, (len(a) * len(b), 2))
    seeds = np.stack(np.meshgrid(a, b, indexing="ij"), -1).reshape(-1, 2) + jitter

    def sample(values, p):
        return map_coordinates(values, (p - 0.5).T, order=1, mode="constant")

    def direction(p):
        v = np.stack([sample(velocity[..., k], p) for k in range(2)], 1)
        length = np.linalg.norm(v, axis=1, keepdims=True)
        return v / np.maximum(length, 1e-9), length[:, 0]

    seeds = seeds[(sample(density, seeds) > bound) & (direction(seeds)[1] > 1e-6)]
    halves = []
    for sign in (-0.3, 0.3):
        p, alive, path = seeds.copy(), np.ones(len(seeds), bool), [seeds]
        for _ in range(steps):
            k1 = direction(p)[0]
            k2 = direction(p + sign / 2 * k1)[0]
            k3 = direction(p + sign / 2 * k2)[0]
            k4, speed = direction(p + sign * k3)
            p = np.where(alive[:, None], p + sign / 6 * (k1 + 2 * k2 + 2 * k3 + k4), p)
            alive &= (sample(density, p) > bound) & (speed > 1e-6)
            path.append(p)
        halves.append(np.stack(path, 1))
    lines = np.concatenate([halves[0][:, :0:-1], halves[1]], 1)
    return [line for line in lines if np.abs(np.diff(line, axis=0)).sum() > 0.5]


def cropped(density: np.ndarray, velocity: np.ndarray, margin: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A plane's density (A, B) and velocity (A, B, 2) without the cells around it where nothing would be drawn."""
    seen = density > FAINT * density.max()
    box = tuple(slice(max(int(k.min()) - margin, 0), int(k.max()) + margin + 1) for k in np.nonzero(seen))
    return density[box], velocity[box]


def draw(density: np.ndarray, velocity: np.ndarray, scale: int = 6, cell: float | None = None) -> Image.Image:
    """Streamlines coloured by density, second axis up, with an arrow head in the direction of motion on each.

    With `cell`, the edge of a cell in metres, a scale bar is drawn at the bottom.
    """
    height = density.shape[1]
    image = Image.new("RGB", (density.shape[0] * scale * 2, height * scale * 2), GROUND)
    pen = ImageDraw.Draw(image)
    lines = streamlines(velocity, density)
    level = [float(map_coordinates(density, (line[len(line) // 2 :][:1] - 0.5).T, order=1)[0]) for line in lines]
    for line, value in sorted(zip(lines, level, strict=True), key=lambda pair: pair[1]):
        t = np.clip((value / density.max()) ** 0.5, 0, 1) * (len(RAMP) - 1)
        low = min(int(t), len(RAMP) - 2)
        color = tuple((RAMP[low] + (t - low) * (RAMP[low + 1] - RAMP[low])).astype(int).tolist())
        points = [(float(x) * scale * 2, (height - float(y)) * scale * 2) for x, y in line]
        pen.line(points, color, 3)
        tip, before = np.array(points[-1]), np.array(points[max(0, len(points) - 6)])
        along = tip - before
        if (size := float(np.hypot(*along))) > 1e-6:
            along *= 11 / size
            side = np.array([-along[1], along[0]]) * 0.45
            pen.polygon(
                [tuple(tip + along * 0.4), tuple(tip - along * 0.6 + side), tuple(tip - along * 0.6 - side)], color
            )
    image = image.resize((image.width // 2, image.height // 2), Image.LANCZOS)
    if cell is not None:
        width_m = image.width / scale * cell
        bar = max(
            (m for m in (10.0**k * f for k in range(-4, 3) for f in (1, 2, 5)) if m < 0.5 * width_m),
            default=0.5 * width_m,
        )
        pen, y = ImageDraw.Draw(image), image.height - 8
        pen.line([(8, y), (8 + bar / cell * scale, y)], (235, 235, 235), 2)
        pen.text((8, y - 4), f"{bar:g} m", (235, 235, 235), ImageFont.load_default(13), anchor="ls")
    return image


def plots(gaussians: TransientGaussians, time_s: float, truth=None) -> dict[str, Image.Image]:
    """By kind: "projection", "slice"; with a true field (anything with `sample`) also these with "truth_" before."""
    v = volume(gaussians, time_s)
    seen = {"": v.velocity}
    if truth is not None:
        seen["truth_"] = truth.sample(v.centres().reshape(-1, 3)).reshape(v.velocity.shape)
    cuts = {"projection": max_projection, "slice": lambda density, velocity: x_slice(density, velocity)[:2]}
    return {
        whose + kind: draw(*cropped(*cut(v.density, velocity)), cell=v.cell)
        for kind, cut in cuts.items()
        for whose, velocity in seen.items()
    }
