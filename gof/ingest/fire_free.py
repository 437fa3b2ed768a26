"""The cameras' fire-free plates: given, or made of the clip, of its video beyond the clip, and of other clips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.ingest import plates
from gof.ingest.footage import Footage, PreparedClip
from gof.ingest.over_time import MEDIAN_PASSES, darkest

PlateKind = Literal["steady", "minimum"]


@dataclass(frozen=True)
class PlateOptions:
    """How plates are made.

    Attributes:
        kind: when there is no `folder`: "minimum" over time, or "steady", that where fire passed and the temporal
            median elsewhere.
        folder: pictures or films cam_0 ... as stored, filmed without fire.
        frames: of each camera's video, around the clip, that show what stands behind the fire; None: the clip's own.

    Raises:
        GofError: both a folder and a number of frames.
    """

    kind: PlateKind = "steady"
    folder: Path | None = None
    frames: int | None = None

    def __post_init__(self):
        if self.folder is not None and self.frames is not None:
            raise GofError("--plates: a folder brings the plates; no number of frames goes with it")

    @property
    def source(self) -> str:
        """Return the dataset's notes on them."""
        return "given" if self.folder else self.kind

    @property
    def passes(self) -> int:
        """How often making them reads the clip."""
        return 2 if self.folder or self.kind == "minimum" else 2 + MEDIAN_PASSES


@dataclass(frozen=True)
class FireFree:
    """The plates (H, W, 3) uint8 per camera, and what is known of them.

    Attributes:
        lowest: the clip's minimum over time, which poses are found on.
        fire_left: share of each plate that still has a flame's colour where fire was.
        fire_left_by_clip: the same of plates from the clip's own frames; None where the options name nothing else.
    """

    pictures: list[np.ndarray]
    lowest: list[np.ndarray]
    fire_left: list[float]
    fire_left_by_clip: list[float] | None = None


def around(used: np.ndarray, frames: int, count: int) -> np.ndarray:
    """Return numbers of the frames outside a clip that join its own to make `frames`, evenly before and behind it.

    Nothing between the clip's first and last frame is among them: a frame that is held out, or one filmed beside it,
    must not get into a plate.

    Args:
        used: (T,) stored numbers of the clip's frames, increasing.   count: frames that the video has.
    """
    first, last = int(used[0]), int(used[-1])
    more = max(frames - (last - first + 1), 0)
    before = min(first, max(more // 2, more - (count - 1 - last)))
    behind = min(count - 1 - last, more - before)
    return np.r_[first - before : first, last + 1 : last + 1 + behind]


def outside(footage: Footage, used: list[np.ndarray], options: PlateOptions) -> list[PreparedClip]:
    """Per camera the frames outside the clip that its plate may use; none unless `options.frames` asks for them.

    Raises:
        GofError: the frames are no more than those of the clip, or there are none outside it.
    """
    if options.frames is None:
        return []
    asked = f"--plates {options.kind}:{options.frames}"
    if options.frames <= len(used[0]):
        raise GofError(f"{asked}: the clip has {len(used[0])} frames; give more than that")
    numbers = [around(u, options.frames, n) for u, n in zip(used, footage.frame_counts, strict=True)]
    if not any(map(len, numbers)):
        raise GofError(
            f"{asked}: the videos have no frames outside the clip; choose a shorter clip with "
            "--start and --frames, or leave it out"
        )
    return footage.clips(numbers)


def make_plates(
    footage: Footage,
    clips: list[PreparedClip],
    beyond: list[PreparedClip],
    elsewhere: list[list[np.ndarray]],
    options: PlateOptions,
) -> FireFree:
    """Plates of all cameras.

    Args:
        clips: training frames.   beyond: frames outside the clip, per camera; empty: none are used.
        elsewhere: per camera the minimum plates of its other clips.
    """
    lowest = [darkest(clip) for clip in clips]
    fire = [plates.fire_reached(*each) for each in zip(clips, lowest, strict=True)]
    if options.folder:
        pictures = read_plates(options.folder, footage)
        return FireFree(pictures, lowest, _left(pictures, fire))
    for others, more in zip(elsewhere, beyond, strict=True) if beyond else ():
        others += [darkest(more)] if len(more) else []
    dark = [plates.uncovered(*each) for each in zip(lowest, fire, elsewhere, strict=True)]
    pictures = dark
    if options.kind == "steady":
        pictures = [plates.steady(*each) for each in zip(clips, dark, fire, strict=True)]
    return FireFree(pictures, lowest, _left(pictures, fire), _left(lowest, fire) if beyond else None)


def _left(pictures: list[np.ndarray], fire: list[np.ndarray]) -> list[float]:
    return [round(plates.fire_left(*each), 4) for each in zip(pictures, fire, strict=True)]


def read_plates(folder: Path, footage: Footage) -> list[np.ndarray]:
    """Return (H, W, 3) uint8 per camera, filmed without fire.

    Raises:
        DataFormatError: by their names, films are in another order than the plates; see `find_plates`, `read_plate`.
    """
    found = plates.find_plates(folder, footage.names)
    stems = [(info.path.name if info.path.is_dir() else info.path.stem).lower() for info in footage.infos]
    for stem, name in zip(stems, footage.names, strict=False):  # of pictures in memory there are none
        if stem != name and stem in footage.names and stems.count(stem) == 1:
            raise DataFormatError(
                f"{folder}: camera {name} is the film {stem}, whose name there is another camera's; give the films in "
                "the order of the plates, or name the plates otherwise"
            )
    tags = [info.rotation_deg for info in footage.infos] or [0] * len(found)
    return [
        footage.preparation(c)(plates.read_plate(path, lens, tag))
        for c, (path, lens, tag) in enumerate(zip(found, footage.lenses, tags, strict=True))
    ]
