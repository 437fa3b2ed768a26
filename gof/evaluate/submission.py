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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.core.files import is_name, path_in
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.dataset.leaks import FILE as MADE_FROM
from gof.dataset.leaks import MadeFrom, leaks
from gof.dataset.plates import background
from gof.evaluate.alarms import beyond_sense, too_good
from gof.evaluate.image import psnr
from gof.evaluate.intervals import over_frames
from gof.evaluate.method import AboutMethod
from gof.evaluate.scores import OPACITY, ORDER, Scores
from gof.evaluate.scoring import evaluate, known_frames
from gof.evaluate.training_curve import FILE as CURVE
from gof.evaluate.training_curve import TrainingCurve
from gof.footage.pictures import read_picture, write_picture
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
        """Open it. Raises DataFormatError: no scores.json, or it names a result that is not inside the folder."""
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
    """Return the folders of a scene's runs: itself where it has a scores.json, else the folders in it that do."""
    if (scene / SCORES).is_file():
        return (scene,)
    return tuple(sorted(path for path in scene.iterdir() if _counts(path) and (path / SCORES).is_file()))


def _counts(path: Path) -> bool:
    """Return whether a folder may be a scene or a run: hidden ones are not."""
    return is_name(path.name) and not path.name.startswith(".")


def _inside(folder: Path, path: Path) -> None:
    """Raise DataFormatError: a file of a run is elsewhere, or not there."""
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
    """Yield the frames of every camera, drawn by our renderer as `gof evaluate` draws them."""
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
    """Return the Gaussians of a run, read as its scores say, beside the dataset. Raises DataFormatError: they are
    damaged."""
    return read_result(run.result, run.options).gaussians.measured_from(dataset.datum)


# ----------------------------------------------------------------
# Whether a submission can be believed: every claim that can be looked at is looked at, and every finding is a line.
#
# A cross refuses the submission. A question mark is a hint that people must judge.

Verdict = Literal["ok", "hint", "refused"]
SIGNS: dict[Verdict, str] = {"ok": "✓", "hint": "?", "refused": "✗"}

SEEDS = 3  # runs of a method whose training is random
ALIKE_DB = 40.0  # PSNR, whole and in the flame, of a submitted picture against ours of the same Gaussians
SAME = 0.005  # relative: what another CPU may change of a score
FIGURES = ("l2", "cos_sim")  # of the velocities, by DVE and by EVE; and of the pictures:
PICTURE_FIGURES = ("psnr", "psnr_flame", "ssim", "ssim_flame")


@dataclass(frozen=True)
class SubmissionFinding:
    """One line of a check: what was looked at (`of`: "jet/seed_0", "method.json"), and what was found."""

    of: str
    what: str
    verdict: Verdict
    found: str

    def __str__(self) -> str:
        return f"{SIGNS[self.verdict]} {self.of}: {self.what}: {self.found}"


def check(
    submission: Submission,
    datasets: dict[str, Dataset],
    scored: Callable[[Run, Dataset], Scores] | None = None,
) -> Iterator[SubmissionFinding]:
    """Yield all findings about a submission, one by one.

    Args:
        datasets: of the suite, by the name of the scene.
        scored: scores of a run, computed anew (default: `evaluate`).
    """
    yield from _about(submission, datasets)
    for scene, runs in submission.runs.items():
        if scene not in datasets:
            continue
        for folder in runs:
            name = folder.relative_to(submission.folder).as_posix()
            try:
                yield from _run(Run.open(folder, scene), datasets[scene], submission, name, scored or score_again)
            except GofError as e:
                yield SubmissionFinding(name, "can be read", "refused", str(e))


def score_again(run: Run, dataset: Dataset) -> Scores:
    """Return a run's scores, computed from its files: read and drawn as its scores.json says, scored like every
    other."""
    over_plates = run.scores.import_.over_plates
    return evaluate(run.result, dataset, ORDER, OPACITY, foreign=run.options, flame_only=over_plates)


# ---------------------------------------------------------------- the method


def _about(submission: Submission, datasets: dict[str, Dataset]) -> Iterator[SubmissionFinding]:
    method = submission.method
    missing = method.missing()
    message = f"does not say {', '.join(missing)}" if missing else "states authors, code and prior knowledge"
    yield SubmissionFinding("method.json", "complete", "refused" if missing else "ok", message)
    unknown = sorted(submission.runs.keys() - datasets.keys())
    if unknown:
        yield SubmissionFinding("scenes", "of the suite", "refused", f"{', '.join(unknown)}: no such scene here")
    absent = sorted(datasets.keys() - submission.runs.keys())
    message = f"no result of {', '.join(absent)}: the row is shown but not ranked" if absent else "all there"
    yield SubmissionFinding("scenes", "all of them", "hint" if absent else "ok", message)
    few = sorted(scene for scene, runs in submission.runs.items() if len(runs) < SEEDS)
    if method.random and few:
        yield SubmissionFinding(
            "runs", "seeds", "hint", f"training is random, and {', '.join(few)} have fewer than {SEEDS} runs"
        )


# ---------------------------------------------------------------- a run


def _run(
    run: Run, dataset: Dataset, submission: Submission, name: str, scored: Callable[[Run, Dataset], Scores]
) -> Iterator[SubmissionFinding]:
    pictures = _missing_pictures(run, dataset)
    absent = [MADE_FROM] * (not (run.folder / MADE_FROM).is_file()) + pictures
    message = f"{', '.join(absent[:3])}{' ...' if len(absent) > 3 else ''} not there" if absent else "all there"
    yield SubmissionFinding(name, "files", "refused" if absent else "ok", message)
    gaussians = read_again(run, dataset)
    if (run.folder / CURVE).is_file():
        TrainingCurve.read(run.folder / CURVE)
    yield _clock(gaussians, dataset, name)
    yield from _frames(run, dataset, submission, name)
    if not pictures:
        yield _pictures(run, dataset, gaussians, name)
    yield _unseen(run, dataset, gaussians, name)
    again = scored(run, dataset)
    if unlikely := beyond_sense(again):
        yield SubmissionFinding(name, "scores are those of a flame", "refused", unlikely)
    if suspicious := too_good(again):
        yield SubmissionFinding(name, "velocities are not the truth's", "hint", suspicious)
    yield from _scores(run, again, name)


def _missing_pictures(run: Run, dataset: Dataset) -> list[str]:
    files = [picture_file(run.folder, camera.name, k) for camera in dataset.cameras for k in dataset.test_frames]
    return [path.relative_to(run.folder).as_posix() for path in files if not path.is_file()]


def _clock(gaussians: MovingGaussians, dataset: Dataset, name: str) -> SubmissionFinding:
    """Return the result speaks of the whole clip, and of no time far from it."""
    first, last = float(dataset.times_s[0]), float(dataset.times_s[-1])
    known = known_frames(gaussians, dataset)
    born, dead = gaussians.life()
    clip = f"the clip's {first:g} to {last:g} s"
    if not known.all():
        covered = "{:g} to {:g} s".format(*gaussians.covered_s)
        return SubmissionFinding(
            name, "clock", "refused", f"says something about {covered} only, not about all of {clip}"
        )
    if dead < first or born > last:
        return SubmissionFinding(
            name, "clock", "refused", f"its Gaussians live from {born:g} to {dead:g} s, outside {clip}"
        )
    return SubmissionFinding(name, "clock", "ok", f"covers {clip}")


def _frames(run: Run, dataset: Dataset, submission: Submission, name: str) -> Iterator[SubmissionFinding]:
    """Yield whether the run says what it was made from, and whether method.json says it too."""
    made_from = MadeFrom.read(run.folder)
    if made_from is None:
        return
    found = leaks(made_from.files, dataset.test_frames)
    if found:
        frames = sorted({frame for frames in found.values() for frame in frames})
        message = f"{', '.join(found)} made from held-out frames {frames}"
        yield SubmissionFinding(name, "held-out frames", "refused", message)
    elif not made_from.files:
        yield SubmissionFinding(
            name, "held-out frames", "refused", f"{MADE_FROM} names no file: from which frames was it made?"
        )
    else:
        yield SubmissionFinding(name, "held-out frames", "ok", "in nothing that it was made from, by its own word")
    if made_from.learned and not submission.method.prior:
        message = f"{MADE_FROM} says that {', '.join(made_from.learned)} went in; method.json names no prior"
        yield SubmissionFinding(name, "prior knowledge", "refused", message)
    if run.scores.import_.over_plates and not any("plate" in given for given in submission.method.given):
        message = "it is drawn over the dataset's plates; `given` in method.json does not name them"
        yield SubmissionFinding(name, "plates", "refused", message)


def _pictures(run: Run, dataset: Dataset, gaussians: MovingGaussians, name: str) -> SubmissionFinding:
    """Return the checkpoint draws the pictures that came with it."""
    ours = draw(gaussians, dataset, run.result, run.scores.import_.over_plates, dataset.test_frames)
    worst = min(((_like_the_submitted(run, dataset, shown), shown) for shown in ours), key=lambda pair: pair[0])
    message = f"the least alike of them is {worst[0]:.1f} dB from its Gaussians drawn here (camera {worst[1].camera}, "
    message += f"frame {worst[1].frame}; {ALIKE_DB:g} dB are required)"
    return SubmissionFinding(
        name, "checkpoint reproduces its pictures", "ok" if worst[0] >= ALIKE_DB else "refused", message
    )


def _like_the_submitted(run: Run, dataset: Dataset, shown: Shown) -> float:
    camera = dataset.cameras[shown.camera]
    theirs = read_picture(picture_file(run.folder, camera.name, shown.frame), size=(camera.width, camera.height))
    pair = shown.image, theirs[..., ::-1] / 255
    flame = psnr(*pair, dataset.mask(shown.camera, shown.frame))  # the surroundings are easy; None without flame
    whole = psnr(*pair)
    return min(99.0 if found is None else found for found in (whole, flame, 99.0))


def _unseen(run: Run, dataset: Dataset, gaussians: MovingGaussians, name: str) -> SubmissionFinding:
    """Held-out frames look worse than their neighbours, which the method learned from.

    Every method fits what it saw better than what it did not see. Where the flame in held-out frames is as good as in
    the frames before and after, the held-out ones were probably seen.
    """
    count = len(dataset.times_s)
    held_out = [k for k in dataset.test_frames if 0 < k < count - 1]
    frames = sorted({k + step for k in held_out for step in (-1, 0, 1)})
    drawn = draw(gaussians, dataset, run.result, run.scores.import_.over_plates, frames)
    found = {(s.camera, s.frame): _flame_psnr(dataset, s) for s in drawn}
    gaps = [
        (found[c, k - 1] + found[c, k + 1]) / 2 - found[c, k] for c in range(len(dataset.cameras)) for k in held_out
    ]
    gaps = [gap for gap in gaps if np.isfinite(gap)]
    if len(gaps) < 2:
        return SubmissionFinding(
            name, "unseen frames", "hint", "too few held-out frames to compare with their neighbours"
        )
    gap = over_frames(gaps, 0)
    worse = gap.mean > 0 and gap.p_value < 0.05
    message = f"the flame in held-out frames is {gap.mean:.2f} ± {gap.half_width:.2f} dB worse than in their neighbours"
    return SubmissionFinding(
        name, "unseen frames", "ok" if worse else "hint", message if worse else f"{message}: were they seen?"
    )


def _flame_psnr(dataset: Dataset, shown: Shown) -> float:
    """NaN without flame in the picture."""
    truth, mask = dataset.image(shown.camera, shown.frame), dataset.mask(shown.camera, shown.frame)
    found = psnr(shown.image, truth, mask)
    return float("nan") if found is None else found


def _scores(run: Run, again: Scores, name: str) -> Iterator[SubmissionFinding]:
    """Yield whether its scores are those that it states."""
    if (dve := run.scores.dve) is not None and (dve.order, dve.opacity) != (ORDER, OPACITY):
        message = f"scores.json has order {dve.order} and {dve.opacity} opacity; all are scored with {ORDER}, {OPACITY}"
        yield SubmissionFinding(name, "scored as all others", "refused", message)
    stated, ours = _figures(run.scores), _figures(again)
    off = [
        f"{key} is {ours[key]:.4f}, its scores.json says {stated[key]:.4f}"
        if stated.get(key) is not None
        else f"{key} is {ours[key]:.4f}, its scores.json does not say"
        for key in ours
        if stated.get(key) is None or abs(stated[key] - ours[key]) > SAME * max(abs(ours[key]), 0.1)
    ]
    if off:
        yield SubmissionFinding(name, "scores reproduce", "refused", "; ".join(off))
    else:
        listed = ", ".join(f"{key} {value:.4f}" for key, value in ours.items())
        yield SubmissionFinding(name, "scores reproduce", "ok", listed)
    for warning in again.warnings:
        yield SubmissionFinding(name, "warning", "hint", warning)


def _figures(scores: Scores) -> dict[str, float]:
    dve, eve = scores.dve, None if scores.dve is None else scores.dve.eve
    found = {} if dve is None else {name: getattr(dve, name) for name in FIGURES}
    found |= {} if eve is None else {f"eve_{name}": getattr(eve, name) for name in FIGURES}
    found |= {name: getattr(scores, name) for name in PICTURE_FIGURES}
    return {name: value for name, value in found.items() if value is not None}
