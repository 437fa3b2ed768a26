"""`gof benchmark add`: a result into a submission, with all that a check asks for."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gof.commands.foreign_options import ForeignOptions
from gof.dataset import Dataset
from gof.dataset.leaks import FILE as MADE_FROM
from gof.dataset.leaks import MadeFrom
from gof.errors import DataFormatError, GofError
from gof.evaluate import evaluate
from gof.evaluate.submission import PICTURES, SCORES, Run, write_pictures
from gof.evaluate.training_curve import FILE as CURVE
from gof.evaluate.training_curve import TrainingCurve
from gof.files import is_name
from gof.progress import progress_bar
from gof_benchmark.suite.made import scene_of

BESIDE = (MADE_FROM, "costs.json")  # of a reconstruction of ours, and its plates


@dataclass
class AddConfig:
    """Put a result into a submission: copied, scored, with its held-out pictures and the frames that it was made from.

    A result of ours is a folder with result.npz; its frames, costs and plates come along. Of another method give the
    file, say which frames it learned from, and give the pictures that its own renderer drew.
    """

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Folder of `gof reconstruct`, or file or folder of any method that docs/importers.md lists."""
    scene: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE")]]
    """The scene's dataset in the suite: WORK/standard/jet."""
    submission: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SUBMISSION")]]
    """Folder of the submission; made if it is not there."""
    other_method: tyro.conf.OmitArgPrefixes[ForeignOptions]
    run: str | None = None
    """Name of the run, where there are several (seed_0, seed_1, ...)."""
    trained_on: Literal["train", "all"] | None = None
    """Which frames the method learned from, where the result's folder does not say."""
    pictures: Path | None = None
    """Folder CAMERA/000004.png of the held-out frames, by the method's own renderer; without it ours draws them."""
    curve: Path | None = None
    """How the training went, as `gof baseline --curve` writes it; the board shows whether it had converged."""
    flame_only: bool = False
    """The result of another method is a flame alone, drawn over the dataset's fire-free plates."""
    json: Path | None = None
    """Also write the scores to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof benchmark add`."""
    config = tyro.cli(AddConfig, prog="gof benchmark add", args=argv)
    if config.run is not None and not is_name(config.run):
        raise GofError(f"--run {config.run!r}: must be a plain name, as seed_0")
    made = scene_of(config.scene)
    folder = config.submission / made.scene.name / (config.run or "")
    if (folder / SCORES).exists():
        raise GofError(f"{folder}: holds a run already; remove it, or give --run another name")
    if config.curve is not None:
        TrainingCurve.read(config.curve)
    result = copy(config.result, folder)
    if config.curve is not None:
        shutil.copyfile(config.curve, folder / CURVE)
    say_frames(config, folder, made.dataset)
    options = config.other_method.options()
    if options.world is not None:
        options = replace(options, world=_copied(options.world, folder))
    with progress_bar(made.scene.name) as progress:
        scores = evaluate(result, made.dataset, progress=progress, foreign=options, flame_only=config.flame_only)
    scores.write(folder / SCORES)
    if config.pictures is not None:
        shutil.copytree(config.pictures, folder / PICTURES)
    else:
        write_pictures(Run.open(folder, made.scene.name), made.dataset)
    if config.json is not None:
        scores.write(config.json)
    print(f"{folder}: added")
    return 0


def copy(result: Path, folder: Path) -> Path:
    """Copy a result, and of a reconstruction of ours what is beside it; the copy.

    Raises:
        DataFormatError: it is not there, or lies where it would be copied to.
    """
    if not result.exists():
        raise DataFormatError(f"{result}: no such file or folder")
    if folder.resolve() in (result.resolve(), result.parent.resolve()):
        raise DataFormatError(f"{result}: lies in the submission already; give the result where it was made")
    folder.mkdir(parents=True, exist_ok=True)
    for name in BESIDE:  # what an attempt left that failed
        (folder / name).unlink(missing_ok=True)
    shutil.rmtree(folder / "plates", ignore_errors=True)
    ours = result / "result.npz" if result.is_dir() else result
    if not ours.is_file():
        return _copied(result, folder)
    for name in BESIDE:
        if (ours.parent / name).is_file():
            shutil.copyfile(ours.parent / name, folder / name)
    if (ours.parent / "plates").is_dir():
        shutil.copytree(ours.parent / "plates", folder / "plates", dirs_exist_ok=True)
    return _copied(ours, folder)


def _copied(path: Path, folder: Path) -> Path:
    target = folder / path.name
    if path.is_dir():
        shutil.copytree(path, target, dirs_exist_ok=True)
    else:
        shutil.copyfile(path, target)
    return target


def say_frames(config: AddConfig, folder: Path, dataset: Dataset) -> None:
    """Write made_from.json, where it did not come with the result.

    Raises:
        GofError: nobody says which frames the result was made from, or two say it.
    """
    there = (folder / MADE_FROM).is_file()
    if there == (config.trained_on is not None):
        why = "says itself which frames went in" if there else f"does not say which frames went in ({MADE_FROM})"
        raise GofError(f"{config.result}: {why}; {'leave out' if there else 'give'} --trained-on")
    if config.trained_on is not None:
        frames = dataset.train_frames if config.trained_on == "train" else range(len(dataset.times_s))
        MadeFrom.of([config.result.name], frames).write(folder)
