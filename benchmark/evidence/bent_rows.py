"""The cost of straight sensor lines: undistorting bends the lines of a sensor, the renderer draws straight ones.

    python -m gof_benchmark.evidence.bent_rows [--captures FOLDER] [--json FILE]

FOLDER holds calibration/*.npz of the cameras and their clips, already undistorted and upright (capture_04/... ,
capture_05/...). Prints how far straight lines are from the bent ones in time, how far the flame moves in that time, and
what a rendered flame with the lens's own delays differs from one with straight lines.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import tyro

from gof.capture.locate import sample
from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.core.gaussians import TransientGaussians
from gof.footage.flame_mask import flame_mask
from gof.footage.lens import Lens, prepare
from gof.footage.videos import stored_frames

ROW_TIME_S, FPS = 2.85e-6, 400  # of the cameras' 720 rows (paper)
TURN = "clockwise"  # of capture_04 and capture_05: rows are read towards the left
GAUSSIANS = 20_000


def read_times(lens: Lens) -> np.ndarray:
    """Return (H, W) s after the sensor's first line at which each pixel of a prepared picture was read: a picture of
    its own row numbers, prepared as footage is."""
    rows = np.repeat(np.arange(lens.height, dtype=np.float32)[:, None], lens.width, 1)
    return ROW_TIME_S * prepare(rows, lens, TURN).astype(np.float64)


def straight_times(lens: Lens) -> np.ndarray:
    """Return (H, W) s: the same as the renderer has it, every line of the sensor a line of the prepared picture."""
    return read_times(replace(lens, distortion=np.zeros(0)))


def flame_pixels(clip: Path, size: tuple[int, int], every: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Return where flame is in every tenth frame, and how fast its picture moves there by OpenCV's DIS flow.

    Args:
        size: (width, height) of the picture in which to give the pixels.
    Returns:
        (N, 2) pixels x, y; (N,) pixels of that picture per second.
    """
    import cv2

    frames = np.stack(list(islice(stored_frames(clip), 100)))
    plate = frames.min(0).astype(np.float32) / 255
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    scale = size[0] / frames.shape[2]
    pixels, speeds = [], []
    for first, second in zip(frames[:-1:every], frames[1::every], strict=True):
        grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (first, second)]
        y, x = np.nonzero(flame_mask(first.astype(np.float32) / 255, plate))
        pixels.append(np.stack([x, y], 1))
        speeds.append(np.linalg.norm(flow.calc(*grey, None), axis=-1)[y, x])
    return scale * (np.concatenate(pixels) + 0.5), scale * FPS * np.concatenate(speeds)


def rising_flame() -> TransientGaussians:
    """Return a column 0.5 m wide and 1.5 m high of Gaussians that rise at 4 m/s and whirl at 1 m/s: the speed of the
    fast clips."""
    rng = np.random.default_rng(0)
    n = GAUSSIANS
    return TransientGaussians(
        position=rng.uniform((-0.25, -0.25, -0.75), (0.25, 0.25, 0.75), (n, 3)),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        scale=rng.uniform(0.005, 0.02, (n, 3)),
        opacity=rng.uniform(0.02, 0.2, n),
        color=rng.uniform((0.6, 0.2, 0.0), (1.0, 0.7, 0.2), (n, 3)),
        velocity=rng.normal((0, 0, 4.0), 1.0, (n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, 0.01),
        dynamic=np.ones(n, bool),
    )


def drawn(flame: TransientGaussians, camera: Camera, times: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) the flame as a camera sees it that reads each pixel at its own time, (H, W) s."""
    from gof.render import render

    delay = np.zeros(len(flame))
    for _ in range(4):  # where a Gaussian is when it is read, and when it is read there
        pixels, _ = camera.project(flame.position + (delay - flame.t_mu)[:, None] * flame.velocity)
        delay = sample(times.astype(np.float32), pixels).astype(np.float64)
    since = delay - flame.t_mu
    seen = replace(
        flame,
        position=flame.position + since[:, None] * flame.velocity,
        opacity=flame.opacity * np.exp(-0.5 * (since / flame.t_sigma) ** 2),
        dynamic=np.zeros(len(flame), bool),
    )
    return render(seen, camera, 0.0, shutter="global")["color"]


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a.astype(np.float64) - b) ** 2)))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def measure_camera(lens: Lens, clips: list[Path]) -> dict[str, float]:
    """Figures of one camera: us in the whole picture and where flame is, pixels of flame, dB of a rendered flame."""
    times = read_times(lens)
    straight = straight_times(lens)
    error = times - straight
    height, width = times.shape
    found = [flame_pixels(clip, (width, height)) for clip in clips]
    pixels, speed = (np.concatenate(part) for part in zip(*found, strict=True))
    at_flame = sample(error.astype(np.float32), pixels)
    moved = np.abs(at_flame) * speed

    upright = lens.turned(TURN)
    looking_along_y = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 2.5], [0, 0, 0, 1]])
    camera = Camera("lens", upright.width, upright.height, upright.K, looking_along_y)
    flame = rising_flame()
    true = drawn(flame, camera, times)
    return {
        "rms_us": 1e6 * rms(error),
        "worst_us": 1e6 * float(np.abs(error).max()),
        "flame_rms_us": 1e6 * rms(at_flame),
        "flame_px_per_frame": float(np.median(speed)) / FPS,
        "moved_rms_px": rms(moved),
        "moved_99_px": float(np.percentile(moved, 99)),
        "straight_psnr_db": psnr(drawn(flame, camera, straight), true),
        "no_rows_psnr_db": psnr(drawn(flame, camera, np.full_like(times, times.mean())), true),
    }


@dataclass(frozen=True)
class BentRows:
    """Measure the cost of straight sensor lines, with the real lenses and clips."""

    captures: Path = Path(os.environ.get("GOF_CAPTURES", Path(__file__).parents[3] / "shared" / "captures"))
    """Folder with calibration/*.npz and capture_0N/scene_000N/cam_N.mp4; GOF_CAPTURES names it too."""
    json: Path | None = None
    """Also write the figures to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print one row per camera."""
    study = tyro.cli(BentRows, prog="python -m gof_benchmark.evidence.bent_rows", args=argv)
    calibrations = sorted((study.captures / "calibration").glob("*.npz"))
    if not calibrations:
        raise GofError(f"{study.captures}: no calibration/*.npz (give --captures, or set GOF_CAPTURES)")
    rows = []
    for c, path in enumerate(calibrations):
        d = np.load(path)
        width, height = (int(v) for v in d["image_size"])
        lens = Lens(width, height, d["camera_matrix"], d["dist_coeffs"].ravel())
        clips = [clip for name in ("capture_04", "capture_05") for clip in study.captures.glob(f"{name}/*/cam_{c}.mp4")]
        rows.append({"camera": path.stem} | measure_camera(lens, sorted(clips)))
        if c == 0:
            print("| " + " | ".join(rows[0]) + " |\n" + "|---" * len(rows[0]) + "|")
        print("| " + " | ".join(v if isinstance(v, str) else f"{v:.3g}" for v in rows[-1].values()) + " |", flush=True)
    if study.json:
        write_json(study.json, rows)


if __name__ == "__main__":
    main()
