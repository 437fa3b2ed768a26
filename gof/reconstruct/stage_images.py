"""Pictures of what each stage did, from the user's own data (the paper's pipeline figure)."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from gof.core.colour import direction_colors
from gof.core.files import atomic_path
from gof.reconstruct.captions import Caption, Captions
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.observation import Observation
from gof.reconstruct.voxels import FlameVoxels

UNKNOWN = 0.35  # grey of flow that failed its check: brighter than any still pixel, and without hue


def save_image(folder: Path, name: str, caption: str, image: np.ndarray) -> None:
    """Write folder/name.png from (H, W, 3) display values, and its caption."""
    levels = cv2.cvtColor((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8), cv2.COLOR_RGB2BGR)
    with atomic_path(folder / f"{name}.png") as temporary:
        temporary.write_bytes(cv2.imencode(".png", levels)[1].tobytes())
    Captions.read(folder).with_caption(Caption(f"{name}.png", caption)).write(folder)


def save_observation(folder: Path, observation: Observation) -> None:
    """Masks and optical flow of the middle training frame, all cameras side by side."""
    f = len(observation.frames) // 2
    masks = observation.mask[f][..., None]
    save_image(
        folder,
        "1_masks",
        f"Motion masks, frame {observation.frames[f]}: what lies outside is darkened",
        np.hstack(observation.image[f] * (0.25 + 0.75 * masks)),
    )
    flow = observation.flow[f]
    speed = np.linalg.norm(flow[observation.mask[f]], axis=-1)
    longest = np.nanpercentile(speed, 98) if np.isfinite(speed).any() else 1.0
    known = np.isfinite(flow).all(-1, keepdims=True)
    colors = np.where(known, direction_colors(np.where(known, flow, 0), longest), UNKNOWN)
    save_image(
        folder,
        "2_optical_flow",
        f"Optical flow inside the masks: hue is direction, full brightness is {longest:.0f} px/s; "
        "grey failed the forward-backward check",
        np.hstack(list(np.where(masks, colors, 0))),
    )


def save_flow_field(folder: Path, field: FlowField) -> None:
    """Emission and velocity of the middle frame, seen from the horizontal direction that shows most of it."""
    frame = field.frames[len(field.frames) // 2]
    light, velocity = _side_view(field.voxels, frame)
    zoom = max(1, round(480 / len(light)))
    image = (255 * np.sqrt(light / light.max(initial=1e-30))).astype(np.uint8)
    image = cv2.applyColorMap(image, cv2.COLORMAP_INFERNO)
    image = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    lit = light > 0.01 * light.max(initial=1e-30)
    speed = np.linalg.norm(velocity, axis=-1)
    longest = np.percentile(speed[lit], 95) if lit.any() else 1.0
    for row, column in zip(*np.nonzero(lit), strict=True):
        if row % 4 == 2 and column % 4 == 2:
            arrow = velocity[row, column] * (1, -1) / max(longest, 1e-12) * 5
            _draw_arrow(image, zoom * np.array([column + 0.5, row + 0.5]), zoom * arrow)
    save_image(
        folder,
        "3_flow_field",
        f"Emission by tomography and the fused 3D velocity at {frame.time_s:.3f} s, seen from the side; "
        f"longest arrows {longest:.2f} m/s",
        image.astype(np.float32) / 255,
    )


def _side_view(voxels: FlameVoxels, frame: FrameField) -> tuple[np.ndarray, np.ndarray]:
    """Light (rows, columns) summed along a horizontal axis, and its mean velocity (rows, columns, 2) across and up."""
    across = int(np.argmax(np.ptp(voxels.index[:, :2], axis=0)))
    cells = voxels.resolution[2] - 1 - voxels.index[:, 2], voxels.index[:, across]
    emission = np.where(frame.known, frame.emission, 0)
    light = np.zeros((voxels.resolution[2], voxels.resolution[across]))
    momentum = np.zeros((*light.shape, 2))
    np.add.at(light, cells, emission)
    np.add.at(momentum, cells, emission[:, None] * frame.velocity[:, [across, 2]])
    return light, momentum / np.where(light > 0, light, 1)[..., None]


def _draw_arrow(image: np.ndarray, start: np.ndarray, arrow: np.ndarray) -> None:
    """start and arrow in pixels (x, y)."""
    tail, head = (tuple(point.astype(int).tolist()) for point in (start, start + arrow))
    cv2.arrowedLine(image, tail, head, (120, 220, 255), 1, cv2.LINE_AA, tipLength=0.3)
