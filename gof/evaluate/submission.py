"""A submission: a folder with what one method made of a suite's scenes, and all that others need to believe it.

SUBMISSION/method.json                          who, with which code, from which knowledge (`gof.evaluate.method`)
           SCENE/                               one run, or one folder a run: SCENE/seed_0, SCENE/seed_1, ...
                 scores.json                    as `gof evaluate` wrote it; names the result and how it is read
                 made_from.json                 the frames that the result was made from
                 pictures/CAMERA/000004.png     the held-out frames, drawn by the method's own renderer
                 costs.json                     seconds and memory, where they are known
                 curve.csv                      loss over steps and seconds, where it is known
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import is_name, path_in
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.method import AboutMethod
from gof.evaluate.scores import Scores
from gof.footage.pictures import write_picture
from gof.io.importers import ImportOptions, read_result

SCORES, PICTURES = "scores.json", "pictures"
ADDING = ".adding"  # in a submission: where a run is put together before it has its name
BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Run:
    """One training on one scene.

    Attributes:
        folder: of the run.
        scene: its name in the suite.
        scores: what its authors say that it scores.
        result: the file or folder that is scored, inside `folder`.
    """

    folder: Path
    scene: str
    scores: Scores
    result: Path

    @property
    def options(self) -> ImportOptions:
        used = self.scores.import_.options
        return ImportOptions() if used is None else used.options()

    @classmethod
    def open(cls, folder: Path, scene: str) -> Run:
        """Raises DataFormatError: no scores.json, or it names a result that is not inside the folder."""
        scores = Scores.read(folder / SCORES)
        origin = scores.import_
        if origin.path is None or origin.alignment is not None:
            why = "does not name a result" if origin.path is None else "is of a result that was moved (--align)"
            raise DataFormatError(
                f"{folder / SCORES}: {why}; bring the result into the dataset's world, in a file, and evaluate that"
            )
        _inside(folder, Path(origin.path))
        if origin.options is not None and origin.options.world is not None:
            _inside(folder, Path(origin.options.world))
        return cls(folder, scene, scores, Path(origin.path))


@dataclass(frozen=True)
class Submission:
    """A method's runs, by scene in the order of their names."""

    folder: Path
    method: AboutMethod
    runs: dict[str, tuple[Path, ...]]

    @property
    def name(self) -> str:
        return self.method.title(self.folder)

    @classmethod
    def open(cls, folder: Path) -> Submission:
        """Read method.json and find the runs; nothing of a run is read yet.

        Raises:
            DataFormatError: no such folder, no method.json, or a field of it is wrong.
        """
        if not (folder / "method.json").is_file():
            raise DataFormatError(
                f"{folder}: no method.json; a submission is a folder that has one (docs/benchmark.md)"
            )
        scenes = sorted(path for path in folder.iterdir() if path.is_dir() and _counts(path))
        runs = {scene.name: runs_of(scene) for scene in scenes}
        return cls(folder, AboutMethod.read(folder), {name: found for name, found in runs.items() if found})


def runs_of(scene: Path) -> tuple[Path, ...]:
    """The folders of a scene's runs: itself where it has a scores.json, else the folders in it that do."""
    if (scene / SCORES).is_file():
        return (scene,)
    return tuple(sorted(path for path in scene.iterdir() if _counts(path) and (path / SCORES).is_file()))


def _counts(path: Path) -> bool:
    """Whether a folder may be a scene or a run: hidden ones are not."""
    return is_name(path.name) and not path.name.startswith(".")


def _inside(folder: Path, path: Path) -> None:
    """Raises DataFormatError: a file of a run is elsewhere, or not there."""
    path_in(folder, Path(os.path.relpath(path, folder)).as_posix())
    if not path.exists():
        raise DataFormatError(f"{path}: no such file; {folder / SCORES} names it as the result, or what it needs")


# ---------------------------------------------------------------- its pictures


@dataclass(frozen=True)
class Shown:
    """A picture (H, W, 3) of display values in [0, 1], by the number of its camera and frame."""

    camera: int
    frame: int
    image: np.ndarray


def draw(
    gaussians: MovingGaussians, dataset: Dataset, result: Path, over_plates: bool, frames: list[int]
) -> Iterator[Shown]:
    """The frames of every camera, drawn by our renderer as `gof evaluate` draws them."""
    from gof.render import render  # here: it loads the compiler

    for number, camera in enumerate(dataset.cameras):
        behind = background(dataset, number, result) if over_plates else BLACK
        times_s = dataset.camera_times_s(number)
        for frame in frames:
            time_s = float(times_s[frame])
            drawn = render(gaussians.state_at(time_s), camera, time_s, background=behind)
            yield Shown(number, frame, np.clip(drawn["color"], 0, 1))


def picture_file(run: Path, camera: str, frame: int) -> Path:
    return path_in(run, f"{PICTURES}/{camera}/{frame:06d}.png")


def write_pictures(run: Run, dataset: Dataset) -> None:
    """Draw a run's held-out frames with our renderer, for methods whose own it is."""
    gaussians = read_again(run, dataset)
    for shown in draw(gaussians, dataset, run.result, run.scores.import_.over_plates, dataset.test_frames):
        path = picture_file(run.folder, dataset.cameras[shown.camera].name, shown.frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_picture(path, np.rint(shown.image[..., ::-1] * 255).astype(np.uint8))


def read_again(run: Run, dataset: Dataset) -> MovingGaussians:
    """The Gaussians of a run, read as its scores say, beside the dataset. Raises DataFormatError: they are damaged."""
    return read_result(run.result, run.options).gaussians.measured_from(dataset.datum)
