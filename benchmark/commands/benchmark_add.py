"""`gof benchmark add`: add a result to a submission, with all files that the check needs."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from gof.commands.everywhere import figures_file
from gof.commands.read import read_options
from gof.core.errors import DataFormatError, GofError
from gof.core.files import is_name, only_run_in
from gof.dataset import Dataset
from gof.dataset.leaks import FILE as MADE_FROM
from gof.dataset.leaks import MadeFrom
from gof.evaluate import evaluate
from gof.evaluate.scores import Scores
from gof.evaluate.submission import ADDING, PICTURES, SCORES, Run, write_pictures
from gof.evaluate.training_curve import FILE as CURVE
from gof.evaluate.training_curve import TrainingCurve
from gof.host.terminal import progress_bar
from gof.io.importers import ImportOptions
from gof.io.importers.sidecar import with_sidecar
from gof_benchmark.suite.made import MadeScene, scene_of

BESIDE = (MADE_FROM, "costs.json")  # of a reconstruction of ours, and its plates


@dataclass
class AddConfig:
    """Put a result into a submission: copied, scored, with its held-out pictures and the frames that it was made from.

    Examples:
      gof benchmark add out/demo mine --dataset bench/preview/demo

    A result of ours is a folder with result.npz; its frames, costs and plates come along. For another method give the
    file, the frames that it learned from, and the pictures that its own renderer drew.
    """

    FIGURES: ClassVar = (Scores,)

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Folder of `gof reconstruct`, or file or folder of any method that docs/importers.md lists."""
    submission: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SUBMISSION")]]
    """Folder of the submission; made if it is not there."""
    dataset: Path
    """The scene's dataset in the suite: WORK/standard/jet."""
    run: str | None = None
    """Name of the run, where there are several (seed_0, seed_1, ...)."""
    trained_on: Literal["train", "all"] | None = None
    """Frames that the method was trained on. Needed where the result's folder does not list them."""
    pictures: Path | None = None
    """Folder CAMERA/000004.png of the held-out frames, by the method's own renderer; default: gof draws them."""
    curve: Path | None = None
    """Training curve of `gof baseline --curve`; the board shows from it whether the training had converged."""


def main(argv: list[str]) -> int:
    """Run `gof benchmark add`."""
    config = read_options(AddConfig, "benchmark add", argv)
    if config.run is not None and not is_name(config.run):
        raise GofError(f"--run {config.run!r}: must be a plain name, as seed_0")
    made = scene_of(config.dataset)
    folder = config.submission / made.scene.name / (config.run or "")
    require_new(config.result, folder, config.submission / made.scene.name)
    if config.curve is not None:
        TrainingCurve.read(config.curve)
    if config.pictures is not None:
        require_pictures(config.pictures, made.dataset)
    place = config.submission / ADDING
    with only_run_in(place):
        draft = place / "run"
        shutil.rmtree(draft, ignore_errors=True)  # what an attempt left that was stopped
        draft.mkdir()
        try:
            put_together(config, made, draft)
            folder.parent.mkdir(parents=True, exist_ok=True)
            if folder.is_dir():  # an empty one, as `require_new` saw
                folder.rmdir()
            os.replace(draft, folder)  # whole or not at all
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    if (file := figures_file()) is not None:
        Scores.read(folder / SCORES).write(file)
    print(f"{folder}: added")
    return 0


def require_new(result: Path, folder: Path, scene: Path) -> None:
    """Make sure that the run's folder is not taken yet.

    Raises:
        DataFormatError: no such result, or it lies in the submission already, or around it.
        GofError: the folder holds something; or the scene's folder is a run itself, which hides others.
    """
    if not result.exists():
        raise DataFormatError(f"{result}: no such file or folder")
    if folder.resolve() in (result.resolve(), result.parent.resolve()):
        raise DataFormatError(f"{result}: is inside the submission already; give the folder where it was made")
    if result.is_dir() and not (result / "result.npz").is_file() and folder.resolve().is_relative_to(result.resolve()):
        raise DataFormatError(f"{result}: contains the submission; give the folder of this result alone")
    if folder != scene and (scene / SCORES).exists():
        raise GofError(f"{scene}: is a run itself, beside which no other is found; move it to {scene / 'seed_0'}")
    if (folder / SCORES).exists():
        raise GofError(f"{folder}: holds a run already; remove it, or give --run another name")
    if os.path.lexists(folder) and not (folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir())):
        raise GofError(f"{folder}: already holds other files, which are kept; give another SUBMISSION, or a --run")


def require_pictures(pictures: Path, dataset: Dataset) -> None:
    """Raise DataFormatError: a held-out picture is not there."""
    names = [f"{camera.name}/{frame:06d}.png" for camera in dataset.cameras for frame in dataset.test_frames]
    missing = [name for name in names if not (pictures / name).is_file()]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise DataFormatError(
            f"{pictures}: has no {missing[0]}{more}; --pictures holds CAMERA/FRAME.png of held-out frames"
        )


def put_together(config: AddConfig, made: MadeScene, folder: Path) -> None:
    """Put everything of a run into a folder of its own."""
    result = copy(config.result, folder)
    if config.curve is not None:
        shutil.copyfile(config.curve, folder / CURVE)
    say_frames(config, folder, made.dataset)
    options, _ = with_sidecar(config.result, ImportOptions())
    if options.world is not None:
        options = replace(options, world=_copied(options.world, folder))
    with progress_bar(made.scene.name) as progress:
        scores = evaluate(result, made.dataset, progress=progress, foreign=options, flame_only=options.flame_only)
    if config.pictures is not None:
        shutil.copytree(config.pictures, folder / PICTURES)
    else:
        write_pictures(Run(folder, made.scene.name, scores, result), made.dataset)
    scores.write(folder / SCORES)


def copy(result: Path, folder: Path) -> Path:
    """Copy a result, and of a reconstruction of ours what is beside it; the copy."""
    ours = result / "result.npz" if result.is_dir() else result
    if not ours.is_file():
        return _copied(result, folder)
    for name in BESIDE:
        if (ours.parent / name).is_file():
            shutil.copyfile(ours.parent / name, folder / name)
    if (ours.parent / "plates").is_dir():
        shutil.copytree(ours.parent / "plates", folder / "plates")
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
        GofError: the frames that the result was made from are unknown, or stated twice.
    """
    says_itself = (folder / MADE_FROM).is_file()
    if says_itself == (config.trained_on is not None):
        why = "says itself which frames went in" if says_itself else f"does not say which frames went in ({MADE_FROM})"
        raise GofError(f"{config.result}: {why}; {'leave out' if says_itself else 'give'} --trained-on")
    if config.trained_on is not None:
        frames = dataset.train_frames if config.trained_on == "train" else range(len(dataset.times_s))
        MadeFrom.of([config.result.name], frames).write(folder)
