"""`gof video`: every frame of a film as a picture on the disk, then the film; a run that was stopped goes on."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

import gof
from gof.core.errors import GofError
from gof.core.files import only_run_in
from gof.dataset import Dataset
from gof.footage.pictures import read_picture, write_picture
from gof.look.animation import original, require_film, write_film
from gof.look.images import to_bytes
from gof.look.panels import (
    MOST_ERROR,
    Panel,
    Scales,
    Subject,
    draw_panel,
    error_colours,
    label,
    measure_scales,
    sheet,
    stamp,
)
from gof.look.path import Shot

FRAMES = ".frames"
MEASURED = 5  # shots from which colours are scaled
OURS = re.compile(r"[0-9a-f]{16}_\d{5}\.png")  # frames that a film left behind; nothing else is ever removed


@dataclass(frozen=True)
class FilmOptions:
    """The looks of a film.

    Attributes:
        panels: beside each other, for each result.   fps: frames a second.
        reduced: factor of the Gaussians' size in the panel of that name.
        keep_frames: leave the pictures beside the film.
    """

    panels: tuple[Panel, ...] = ("rgb", "depth", "velocity", "reduced")
    fps: float = 30.0
    reduced: float = 0.3
    keep_frames: bool = False


@dataclass(frozen=True)
class Film:
    """A film that was made: the file, its frames, how many of them an earlier run had made, and the size in pixels."""

    path: Path
    frames: int
    found: int
    size: tuple[int, int]
    scales: Scales


@dataclass(frozen=True)
class Recorded:
    """The pictures that a camera of a dataset recorded, shown beside the results."""

    dataset: Dataset
    camera: int

    def picture(self, shot: Shot) -> np.ndarray:
        """Return (H, W, 3) uint8 of the shot's size: the frame nearest to its time."""
        frame = int(np.abs(self.dataset.camera_times_s(self.camera) - shot.time_s).argmin())
        image = self.dataset.image(self.camera, frame)
        return to_bytes(fitted(image, shot.camera.width, shot.camera.height))


def fitted(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return an image resampled to a size."""
    smaller = width < image.shape[1]
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)


def make_film(
    out: Path,
    subjects: Sequence[Subject],
    shots: Sequence[Shot],
    options: FilmOptions,
    made_of: str,
    recorded: Recorded | None = None,
    zero_s: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Film:
    """Draw a film, one row of panels for each result.

    Frames lie in OUT.frames until the film is whole, so that a run that was stopped goes on where it was.

    Args:
        made_of: what says which files the subjects are; with everything else here it decides which frames are the same.
        recorded: adds its panel in front of each row; the panel "error" needs it.
        zero_s: from when the time written in the frames counts.
    Raises:
        GofError: no such kind of film, or another run is at work on it.   DataFormatError: it cannot be written.
    """
    require_film(out)
    key = _key(subjects, shots, options, made_of, recorded)
    folder = frames_folder(out)
    with only_run_in(folder):
        _remove(folder, lambda name: not name.startswith(key))
        files = [folder / f"{key}_{number:05d}.png" for number in range(len(shots))]
        missing = [number for number, file in enumerate(files) if not file.is_file()]
        scales = measure_scales(subjects, [shots[k] for k in _some(len(shots))])
        for done, number in enumerate(missing):
            page = draw_frame(subjects, shots[number], options, scales, recorded)
            note = shots[number].note
            page = stamp(page, f"{1000 * (shots[number].time_s - zero_s):.1f} ms" + (f", {note}" if note else ""))
            write_picture(files[number], page[..., ::-1])
            if progress:
                progress(len(files) - len(missing) + done + 1, len(files))
        write_film(out, _read(files), options.fps)
        height, width = read_picture(files[0]).shape[:2]
        if not options.keep_frames:
            _remove(folder, lambda name: True)
    if not options.keep_frames:
        (folder / ".lock").unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()
    return Film(out, len(files), len(files) - len(missing), (width, height), scales)


def frames_folder(out: Path) -> Path:
    """Return the folder of a film's frames, OUT.frames."""
    return out.with_name(f"{out.name}{FRAMES}")


def is_begun(out: Path) -> bool:
    """Return whether frames of ours lie beside a film: of a run that was stopped, or kept."""
    folder = frames_folder(out)
    return folder.is_dir() and any(OURS.fullmatch(file.name) for file in folder.iterdir())


def draw_frame(
    subjects: Sequence[Subject], shot: Shot, options: FilmOptions, scales: Scales, recorded: Recorded | None = None
) -> np.ndarray:
    """Return (H, W, 3) uint8: all panels of one instant with their words, a row for each result."""
    titles = {
        "rgb": "",
        "depth": "depth",
        "velocity": "velocity",
        "reduced": f"Gaussians x {options.reduced:g}",
        "error": f"error, bright: {MOST_ERROR:g}",
    }
    picture = None if recorded is None else recorded.picture(shot)
    rows = []
    for subject in subjects:
        row = []
        if recorded is not None and picture is not None:
            row.append(label(picture, original(recorded.dataset), "rgb", scales))
        for kind in options.panels:
            panel = draw_panel("rgb" if kind == "error" else kind, subject, shot, scales, options.reduced)
            if kind == "error":
                if picture is None:
                    raise GofError('the panel "error" needs the recorded pictures')
                panel = error_colours(panel, picture)
            title = titles[kind] if len(subjects) == 1 else f"{subject.name}  {titles[kind]}"
            row.append(label(panel, title or subject.name, kind, scales))
        rows.append(row)
    return sheet(rows if len(options.panels) > 1 else [[panel for row in rows for panel in row]])


# ---------------------------------------------------------------- parts


def _some(count: int) -> list[int]:
    return sorted({int(k) for k in np.linspace(0, count - 1, MEASURED)})


def _key(
    subjects: Sequence[Subject],
    shots: Sequence[Shot],
    options: FilmOptions,
    made_of: str,
    recorded: Recorded | None,
) -> str:
    """Sixteen hex digits that change with everything a frame shows."""
    look = {name: value for name, value in asdict(options).items() if name not in ("keep_frames", "fps")}
    seen = [(shot.camera.to_dict(), shot.time_s, shot.note) for shot in shots]
    names = [subject.name for subject in subjects]
    text = json.dumps([gof.__version__, made_of, names, look, seen, recorded is not None and recorded.camera])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _read(files: list[Path]) -> Iterator[np.ndarray]:
    for file in files:
        yield read_picture(file)[..., ::-1]


def _remove(folder: Path, which: Callable[[str], bool]) -> None:
    for file in folder.iterdir():
        if OURS.fullmatch(file.name) and which(file.name):
            file.unlink()
