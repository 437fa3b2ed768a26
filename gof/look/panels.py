"""Panels of a result at one instant, for films and figures: picture, depth, velocity, and its Gaussians shrunk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gof.core.gaussians import MovingGaussians, TransientGaussians
from gof.core.harmonics import plain_color
from gof.evaluate.intervals import weighted_quantile
from gof.evaluate.screen_motion import ScreenVelocity, sideways_velocity
from gof.look.images import BETWEEN, GAP, INFERNO, VIRIDIS, mapped, side_by_side, to_bytes
from gof.look.path import Shot
from gof.look.velocity import GROUND, draw, legend, living

Panel = Literal["rgb", "depth", "velocity", "reduced", "error"]
MOST_ERROR = 0.5  # display values, of the last colour
SEEN = 0.5  # alpha from which a depth counts for the scale


@dataclass(frozen=True)
class Scales:
    """The meaning of full colour, one in all panels of a film: m/s, and m of the nearest and the farthest depth."""

    speed: float
    near: float
    far: float


@dataclass(frozen=True)
class Subject:
    """A result to draw.

    Attributes:
        name: what people read.
        gaussians: its own.
        scene: the still scene that stands around it, None where it has its own or there is none.
        plate: (H, W, 3 or 4) what lies behind it in the one camera of the film; None in films that move.
    """

    name: str
    gaussians: MovingGaussians
    scene: TransientGaussians | None = None
    plate: np.ndarray | None = None

    def at(self, time_s: float) -> tuple[TransientGaussians, float]:
        """Return all that is drawn at a time, the still scene too; and the time, the nearest that the result knows."""
        known = float(np.clip(time_s, *self.gaussians.covered_s))
        state = self.gaussians.state_at(known)
        return state if self.scene is None else _together(self.scene, state), known

    def moving(self, shot: Shot) -> ScreenVelocity:
        """Return velocity of what moves, parallel to the shot's picture, m/s."""
        state, known = self.at(shot.time_s)
        return sideways_velocity(living(state, known), shot.camera, known)


def _together(scene: TransientGaussians, flame: TransientGaussians) -> TransientGaussians:
    if scene.color.shape[1:] != flame.color.shape[1:]:
        scene, flame = (replace(part, color=plain_color(part.color)) for part in (scene, flame))
    return TransientGaussians.concatenate([scene, flame])


def draw_panel(kind: Panel, subject: Subject, shot: Shot, scales: Scales, reduced: float) -> np.ndarray:
    """Return (H, W, 3) uint8 of the camera's size, without words."""
    if kind == "velocity":
        return draw(subject.moving(shot), scales.speed, scale=1)
    if kind == "depth":
        return depth_colours(*_depth(subject, shot), scales)
    return to_bytes(picture(subject, shot, reduced if kind == "reduced" else 1.0))


def picture(subject: Subject, shot: Shot, size_factor: float = 1.0) -> np.ndarray:
    """Return (H, W, 3) display values of `gof.render`, over the plate where there is one.

    Args:
        size_factor: of every Gaussian's scale; below 1 they come apart and show where they are (the paper's reduced
            scale), and nothing lies behind them.
    """
    from gof.render import render

    (state, known), plate = subject.at(shot.time_s), subject.plate
    if size_factor != 1:
        state, plate = replace(state, scale=state.scale * size_factor), None
    return render(state, shot.camera, known, background=plate)["color"]


def _depth(subject: Subject, shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) camera depth in m of all that is drawn, and alpha (H, W); plates have no depth."""
    from gof.render import render

    state, known = subject.at(shot.time_s)
    drawn = render(state, shot.camera, known)
    return drawn["depth"], drawn["alpha"]


def depth_colours(depth: np.ndarray, alpha: np.ndarray, scales: Scales) -> np.ndarray:
    """Return (H, W, 3) uint8: near yellow, far violet, by log depth; dark where nothing is."""
    low, high = np.log(scales.near), np.log(scales.far)
    share = (high - np.log(np.clip(depth, scales.near, scales.far))) / max(high - low, 1e-9)
    colour = mapped((255 * share + 0.5).astype(np.uint8), VIRIDIS) / 255
    return to_bytes(alpha[..., None] * colour + (1 - alpha[..., None]) * GROUND)


def error_colours(drawn: np.ndarray, recorded: np.ndarray, most: float = MOST_ERROR) -> np.ndarray:
    """Return (H, W, 3) uint8 of two pictures (H, W, 3) uint8: the channels' mean difference, black none, bright
    `most`."""
    error = np.abs(drawn.astype(np.float32) - recorded).mean(-1) / 255
    share = (255 * np.clip(error / most, 0, 1) + 0.5).astype(np.uint8)
    return mapped(share, INFERNO)


def measure_scales(subjects: Sequence[Subject], some: Sequence[Shot]) -> Scales:
    """From a few shots: the 98th percentile of speed by opacity, and 1 % to 99 % of the depths that are solid."""
    speeds, weights, depths = [np.zeros(1)], [np.zeros(1)], []
    for subject in subjects:
        for shot in some:
            flow, alpha = subject.moving(shot)
            speeds.append(np.linalg.norm(flow, axis=-1).ravel())
            weights.append(alpha.ravel())
            depth, alpha = _depth(subject, shot)
            solid = depth[(alpha > min(SEEN, 0.5 * alpha.max(initial=0))) & (depth > 0)]
            depths.append(solid.ravel())
    speed, weight, depth = np.concatenate(speeds), np.concatenate(weights), np.concatenate(depths)
    longest = max(weighted_quantile(speed, weight, 0.98), 1e-9) if weight.any() else 1.0
    near, far = np.percentile(depth, [1, 99]) if len(depth) else (1.0, 2.0)
    return Scales(float(longest), float(near), float(max(far, 1.001 * near)))


# ---------------------------------------------------------------- words and legends


def label(panel: np.ndarray, title: str, kind: str, scales: Scales) -> np.ndarray:
    """Return the panel with its title above, and below its legend: the colour wheel in m/s, the depths in m."""
    height, width = panel.shape[:2]
    size = int(np.clip(height / 28, 9, 28))
    image = Image.fromarray(panel)
    _write(image, (size // 2, size // 3), title, size)
    if kind == "velocity":
        wheel = Image.fromarray(legend(max(24, height // 7)))
        corner = width - wheel.width - size // 2, height - wheel.height - size // 2
        image.paste(wheel, corner, wheel)
        _write(image, (corner[0] - size // 3, corner[1] + wheel.height), f"{scales.speed:.3g} m/s", size, "rd")
    if kind == "depth":
        bar_height, bar_width = height // 3, max(5, size // 2)
        share = np.linspace(255, 0, bar_height).astype(np.uint8)[:, None].repeat(bar_width, 1)
        bar = Image.fromarray(mapped(share, VIRIDIS))
        corner = width - bar_width - size // 2, height - bar_height - size // 2
        image.paste(bar, corner)
        _write(image, (corner[0] - size // 3, corner[1]), f"{scales.near:.3g} m", size, "ra")
        _write(image, (corner[0] - size // 3, corner[1] + bar_height), f"{scales.far:.3g} m", size, "rd")
    return np.asarray(image)


def stamp(page: np.ndarray, text: str) -> np.ndarray:
    """Return the page with words in the lower left corner, in as many lines as its width asks for."""
    image = Image.fromarray(page)
    size = int(np.clip(page.shape[0] / 28, 9, 28))
    lines = _lines_within(text, page.shape[1] - size, size)
    _write(image, (size // 2, page.shape[0] - size // 2), "\n".join(lines), size, "ld")
    return np.asarray(image)


def _lines_within(text: str, width: int, size: int) -> list[str]:
    """Return a text's words in lines of at most `width` px; a word that is wider has a line of its own."""
    font, lines = ImageFont.load_default(size), [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _write(image: Image.Image, place: tuple[int, int], text: str, size: int, anchor: str = "la") -> None:
    ImageDraw.Draw(image).text(
        place,
        text,
        font=ImageFont.load_default(size),
        anchor=anchor,
        fill=(255, 255, 255),
        stroke_width=max(1, size // 9),
        stroke_fill=(0, 0, 0),
    )


def sheet(rows: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Return rows of panels as one picture of even width and height, as video wants them."""
    lines = [side_by_side(list(row)) for row in rows]
    lines = [part for line in lines for part in (line, np.full((GAP, line.shape[1], 3), BETWEEN, np.uint8))][:-1]
    page = np.concatenate(lines)
    return np.pad(page, [(0, page.shape[0] % 2), (0, page.shape[1] % 2), (0, 0)], mode="edge")
