"""The report's pictures: panels drawn from a dataset and a result, and their encoding into the page."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gof.core.errors import DataFormatError, GofError
from gof.core.files import atomic_path
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.expectation import expected_velocity
from gof.evaluate.screen_motion import screen_velocities
from gof.host.threads import map_on_cores
from gof.look import velocity as velocity_module
from gof.look.images import data_uri, enlarge, factor_for, side_by_side, to_bytes

QUALITY = 82  # of the animation, which is half of the page


@dataclass
class Animation:
    """The four panels over time.

    Attributes:
        frames: each (H, W, 3) uint8, panels side by side.   titles: of the panels.
        longest: px/s of full colour in the velocity panels, 0 = no velocity panels.
        frame_ms: how long each frame is shown.   slow_down: shown time over real time.
    """

    frames: list[np.ndarray]
    titles: list[str]
    longest: float
    frame_ms: int
    slow_down: float
    still: int  # the frame with most flame

    def save(self, path: Path) -> Path:
        """Animated WebP, endless."""
        return write_film(path, self.frames, 1000 / self.frame_ms, QUALITY)


def animate(
    dataset: Dataset,
    gaussians: TransientGaussians,
    plate: np.ndarray,
    camera_number: int,
    progress: Callable[[int, int], None] | None = None,
) -> Animation:
    """Draw truth (or what was filmed), reconstruction, velocity and true velocity for every frame of one camera.

    The reconstruction is drawn over `plate`, unless it has static Gaussians.

    Without dynamic Gaussians or true velocities the panels that need them are left out.
    """
    from gof.render import render

    camera = dataset.cameras[camera_number]
    background = None if not gaussians.dynamic.all() else plate
    frames = sorted({*dataset.train_frames, *dataset.test_frames})
    has_truth = dataset.has_velocity
    drawn, alphas = [], []
    for number, k in enumerate(frames):
        time_s = float(dataset.camera_times_s(camera_number)[k])
        alive = velocity_module.living(gaussians, time_s)
        velocities = [alive.moving_gas]
        if has_truth:
            centre, _ = alive.at(time_s)
            velocities.append(expected_velocity(dataset.velocity.at(time_s), centre, alive.scale, alive.rotation).mean)
        fields = screen_velocities(alive, camera, time_s, velocities)
        drawn.append(
            (
                [
                    to_bytes(dataset.image(camera_number, k)),
                    to_bytes(render(gaussians, camera, time_s, background=background)["color"]),
                ],
                fields,
            )
        )
        alphas.append(float(fields[0].alpha.sum()))
        if progress:
            progress(number + 1, len(frames))

    longest = velocity_module.fastest([f[-1] for _, f in drawn])
    factor = factor_for(camera.width)

    def page(number: int) -> np.ndarray:
        k, (pictures, fields) = frames[number], drawn[number]
        panels = [enlarge(p, factor) for p in pictures] + [velocity_module.draw(f, longest, factor) for f in fields]
        held_out = k in dataset.test_frames
        words = f"{1000 * (dataset.times_s[k] - dataset.times_s[0]):.0f} ms" + ("   held out" if held_out else "")
        return _stamp(side_by_side(panels), words, held_out)

    pages = map_on_cores(page, range(len(frames)))
    frame_s = dataset.frame_time_s
    shown_ms = int(np.clip(round(8 * frame_s * 1000), 60, 200))
    titles = [
        original(dataset),
        "reconstruction",
        "velocity, reconstruction",
        *(["velocity, truth"] if has_truth else []),
    ]
    return Animation(
        pages, titles, longest, shown_ms, shown_ms / 1000 / frame_s if frame_s else 1.0, int(np.argmax(alphas))
    )


def original(dataset: Dataset) -> str:
    """Return the name of a dataset's own pictures."""
    return "filmed" if dataset.description.is_filmed else "truth"


def all_views(
    dataset: Dataset, gaussians: TransientGaussians, plates: list[np.ndarray], frame: int
) -> list[tuple[str, str, str]]:
    """Return every camera at one time: its name, and data URIs of its own picture and of the reconstruction."""
    from gof.render import render

    found = []
    for number, camera in enumerate(dataset.cameras):
        time_s = float(dataset.camera_times_s(number)[frame])
        background = plates[number] if gaussians.dynamic.all() else None
        image = render(gaussians, camera, time_s, background=background)["color"]
        own, drawn = (enlarge(to_bytes(p), factor_for(camera.width)) for p in (dataset.image(number, frame), image))
        found.append((camera.name, data_uri(own), data_uri(drawn)))
    return found


def views_around(
    dataset: Dataset, gaussians: TransientGaussians, angles_deg: dict[str, float]
) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return rows of pictures of one frame from all around: [(row title, [(angle, data URI)])].

    Args:
        dataset: seen by its cameras around (`Dataset.around_view`).
        angles_deg: by camera's name, from the nearest given one: whom to show, and in which order.
    """
    from gof.render import render

    rows: dict[str, list] = {original(dataset): [], "reconstruction": []}
    numbers = {camera.name: number for number, camera in enumerate(dataset.cameras)}
    for name in sorted(angles_deg, key=angles_deg.__getitem__):
        number, camera = numbers[name], dataset.cameras[numbers[name]]
        frame = dataset.frames(number)[0]
        time_s = float(dataset.camera_times_s(number)[frame])
        background = dataset.static(number) if gaussians.dynamic.all() else None
        image = np.clip(render(gaussians, camera, time_s, background=background)["color"], 0, 1)
        for title, picture in zip(rows, (dataset.image(number, frame), image), strict=True):
            rows[title].append((f"{angles_deg[name]:.0f}°", data_uri(to_bytes(picture))))
    return list(rows.items())


def brightest_frame(dataset: Dataset) -> int:
    """Return the held-out frame with most flame (without masks: farthest from the plate); any frame when none is held
    out."""

    def flame(k: int) -> float:
        mask = dataset.mask(0, k)
        return float(mask.mean() if mask is not None else np.abs(dataset.image(0, k) - dataset.static(0)).mean())

    return max(dataset.test_frames or dataset.train_frames, key=flame)


def _stamp(page: np.ndarray, text: str, accent: bool) -> np.ndarray:
    image = Image.fromarray(page)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(18)
    pen.text(
        (10, page.shape[0] - 30),
        text,
        font=font,
        fill=(255, 190, 90) if accent else (255, 255, 255),
        stroke_width=2,
        stroke_fill=(0, 0, 0),
    )
    return np.asarray(image)


# ----------------------------------------------------------------
# Films as files: WebM and MP4 (both VP9) by the FFmpeg of OpenCV, animated WebP by Pillow; a still one as PNG.

CODES = {".webm": "VP90", ".mp4": "vp09"}  # the tags by which OpenCV finds the codec in either container
STILL = ".png"  # a film of one frame
SUFFIXES = (*CODES, ".webp", STILL)
WEBP_QUALITY = 88


def require_film(path: Path) -> None:
    """Raise GofError: the suffix is none of a film that can be written here."""
    if path.suffix.lower() not in SUFFIXES:
        raise GofError(f"--out {path}: a film ends in {', '.join(SUFFIXES)}")


def write_film(path: Path, frames: Iterable[np.ndarray], fps: float, quality: int = WEBP_QUALITY) -> Path:
    """Write frames (H, W, 3) uint8, all of one even size, one after another; atomically.

    Args:
        quality: of a .webp, 0 to 100.
    Raises:
        GofError: no such kind of film.   DataFormatError: it cannot be written, or not all of it was.
    """
    require_film(path)
    with atomic_path(path) as temporary:
        if path.suffix.lower() in CODES:
            count = _write_video(temporary, frames, fps)
        else:
            count = _write_pictures(temporary, frames, fps, quality)
        if count == 0 or not temporary.is_file() or temporary.stat().st_size == 0:
            raise DataFormatError(f"{path}: no film could be written")
    return path


def _write_video(path: Path, frames: Iterable[np.ndarray], fps: float) -> int:
    import cv2

    writer, count = None, 0
    for frame in frames:
        if writer is None:
            code = cv2.VideoWriter.fourcc(*CODES[path.suffix.lower()])
            with _quiet():
                writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, fps, frame.shape[1::-1])
            if not writer.isOpened():
                raise DataFormatError(f"{path.name}: this build of OpenCV cannot write VP9; write a .webp")
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
        count += 1
    if writer is not None:
        writer.release()
    return count


def _write_pictures(path: Path, frames: Iterable[np.ndarray], fps: float, quality: int) -> int:
    from PIL import Image

    pictures = [Image.fromarray(frame) for frame in frames]
    if path.suffix.lower() == STILL and pictures:
        pictures[0].save(path, optimize=True)
    elif pictures:
        how = {"duration": round(1000 / fps), "loop": 0, "quality": quality}
        pictures[0].save(path, "webp", save_all=True, append_images=pictures[1:], **how)
    return len(pictures)


@contextmanager
def _quiet() -> Iterator[None]:
    """FFmpeg says on the screen that it takes another tag than it was given: of no use to anybody."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
