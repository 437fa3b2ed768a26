"""Pictures of what each stage did, from the user's own data (the paper's pipeline figure)."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from gof.io.files import atomic_path, read_json, write_json
from gof.reconstruct.motion import Motion
from gof.reconstruct.voxels import FlameVoxels


def flow_colors(flow: np.ndarray, longest: float) -> np.ndarray:
    """(H, W, 2) vectors to (H, W, 3) display colours: hue = direction, brightness = length up to `longest`; NaN = dark grey."""
    known = np.isfinite(flow).all(-1)
    x, y = np.where(known, flow[..., 0], 0), np.where(known, flow[..., 1], 0)
    hue = ((np.arctan2(-y, x) % (2 * np.pi)) * (180 / (2 * np.pi))).astype(np.uint8)
    value = np.clip(np.hypot(x, y) / max(longest, 1e-12), 0, 1)
    hsv = np.stack([hue, np.full_like(hue, 200), (255 * value).astype(np.uint8)], -1)
    rgb = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB).astype(np.float32) / 255
    return np.where(known[..., None], rgb, 0.12)


def save_picture(folder: Path, name: str, caption: str, image: np.ndarray) -> None:
    """Write folder/name.png from (H, W, 3) display values and its caption into folder/captions.json (kept in order)."""
    levels = cv2.cvtColor((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8), cv2.COLOR_RGB2BGR)
    with atomic_path(folder / f"{name}.png") as temporary:
        temporary.write_bytes(cv2.imencode(".png", levels)[1].tobytes())
    captions = read_json(folder / "captions.json") if (folder / "captions.json").exists() else {}
    captions[f"{name}.png"] = caption
    write_json(folder / "captions.json", captions)


def save_motion(folder: Path, motion: Motion) -> None:
    """Masks and optical flow of the middle training frame, all cameras side by side."""
    f = len(motion.frames) // 2
    masked = [
        image * (0.25 + 0.75 * mask[..., None]) for image, mask in zip(motion.image[f], motion.mask[f], strict=True)
    ]
    save_picture(
        folder, "1_masks", f"Motion masks, frame {motion.frames[f]}: what lies outside is darkened", np.hstack(masked)
    )
    speed = np.linalg.norm(motion.flow[f][motion.mask[f]], axis=-1)
    longest = np.nanpercentile(speed, 98) if np.isfinite(speed).any() else 1.0
    colors = [
        flow_colors(np.where(m[..., None], flow, 0), longest)
        for flow, m in zip(motion.flow[f], motion.mask[f], strict=True)
    ]
    save_picture(
        folder,
        "2_optical_flow",
        f"Optical flow inside the masks: hue is direction, full brightness is {longest:.0f} px/s; "
        "grey failed the forward-backward check",
        np.hstack(colors),
    )


def save_flow_field(folder: Path, voxels: FlameVoxels, frame: dict) -> None:
    """Emission and fused velocity of one frame, projected along the horizontal axis with the larger spread, with arrows."""
    spread = np.ptp(voxels.index[:, :2], axis=0)
    across = int(np.argmax(spread))
    column, row = voxels.index[:, across], voxels.resolution[2] - 1 - voxels.index[:, 2]
    shape = (voxels.resolution[2], voxels.resolution[across])
    weight, vx, vz = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    emission = np.where(frame["known"], frame["emission"], 0)
    np.add.at(weight, (row, column), emission)
    np.add.at(vx, (row, column), emission * frame["velocity"][:, across])
    np.add.at(vz, (row, column), emission * frame["velocity"][:, 2])
    seen = weight > 0.01 * weight.max(initial=1e-30)
    vx, vz = (np.where(seen, v / np.where(seen, weight, 1), 0) for v in (vx, vz))
    zoom = max(1, round(480 / shape[0]))
    glow = cv2.applyColorMap((255 * np.sqrt(weight / weight.max(initial=1e-30))).astype(np.uint8), cv2.COLORMAP_INFERNO)
    glow = cv2.cvtColor(cv2.resize(glow, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST), cv2.COLOR_BGR2RGB)
    longest = np.percentile(np.hypot(vx, vz)[seen], 95) if seen.any() else 1.0
    for r, c in zip(*np.nonzero(seen), strict=True):
        if r % 4 == 2 and c % 4 == 2:
            start = np.array([(c + 0.5) * zoom, (r + 0.5) * zoom])
            end = start + np.array([vx[r, c], -vz[r, c]]) / max(longest, 1e-12) * 5 * zoom
            cv2.arrowedLine(
                glow,
                tuple(start.astype(int).tolist()),
                tuple(end.astype(int).tolist()),
                (120, 220, 255),
                1,
                cv2.LINE_AA,
                tipLength=0.3,
            )
    save_picture(
        folder,
        "3_flow_field",
        f"Emission by tomography and the fused 3D velocity at {frame['time_s']:.3f} s, seen from the side; "
        f"longest arrows {longest:.2f} m/s",
        glow.astype(np.float32) / 255,
    )
