"""`gof benchmark score`: submissions -> one page."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gof import __version__
from gof.commands.everywhere import require_writable, write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError
from gof.core.files import atomic_path
from gof.core.records import to_json, write_record
from gof.dataset import Dataset
from gof.evaluate.eddy_time import eddy_time
from gof.evaluate.leaderboard import EvaluatedResult
from gof.evaluate.method import AboutMethod
from gof.evaluate.scores import OPACITY, ORDER, Scores
from gof.evaluate.submission import PICTURES, SCORES, Run, Submission, check, score_again
from gof.evaluate.suite_board import RANKED, ScoredScene, SuiteBoard, board
from gof.evaluate.training_curve import FILE as CURVE
from gof.evaluate.training_curve import TrainingCurve
from gof.host.terminal import console
from gof.look.boards import suite_html, suite_markdown
from gof.look.comparison import Moment
from gof.look.pages import PageGrid, side_by_side
from gof_benchmark.suite import pick, scenes_of, split_of, suite_name
from gof_benchmark.suite.made import MadeScene, made_scenes, size_of


@dataclass
class ScoreConfig:
    """Score submissions and write one page: means with intervals, wins, and ranks that are shared where the scores do
    not differ significantly.

    Examples:
      gof benchmark score mine others bench/preview --out board

    Scores are computed from the results, whatever the submissions say, and kept in OUT/scores: the same result on the
    same dataset is scored once. A method that `gof benchmark check` refuses is shown with the reason and not ranked.
    Development scenes are scored apart, with --scenes dev; no rank mixes the two.
    """

    FIGURES: ClassVar = (SuiteBoard,)

    folders: tyro.conf.Positional[Annotated[list[Path], tyro.conf.arg(metavar="SUBMISSION ... SUITE")]]
    """Submissions, and last the folder of a size of the suite: mine others WORK/standard."""
    out: Path | None = None
    """Folder for board.html, .md and .json, and the scores that are kept. Default: "board" beside the first submission.
    Older pages are replaced."""
    scenes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="dev|NAME")] = ()
    """Only these, of the scenes that are scored or, with "dev" before them, of those for development; default: all
    scored ones in which a submission has a result. Who lacks a result in one of them gets no rank."""


def main(argv: list[str]) -> int:
    """Run `gof benchmark score`."""
    config = read_options(ScoreConfig, "benchmark score", argv)
    if len(config.folders) < 2:
        raise GofError("give one submission or more, and last the folder of the suite's size: mine WORK/standard")
    *folders, suite = config.folders
    submissions = [Submission.open(folder) for folder in folders]
    names = [submission.name for submission in submissions]
    if len(set(names)) < len(names):
        raise GofError(f"two submissions have one name: {', '.join(sorted(names))}; change it in method.json")
    split, names = split_of(config.scenes)
    by_name = made_scenes(suite, split)
    chosen = pick([made.scene for made in by_name.values()], names)
    entered = [by_name[scene.name] for scene in chosen if any(scene.name in s.runs for s in submissions)]
    if not entered:
        raise GofError(f"no submission has a result of a {split} scene that is made in {suite}")
    out = config.out or require_writable(folders[0].absolute().parent) / "board"
    kept = out / "scores"
    refused = {submission.name: crosses(submission, entered, kept) for submission in submissions}
    scenes = [scored_scene(made, submissions, kept) for made in entered]
    pictures = "; ".join(sorted({made.pictures for made in entered}))
    size = size_of(suite)
    share = f"{len(entered)} of {len(scenes_of(size, split))} {split} scenes"
    title = f"{suite_name()}, {size}, {share}, pictures {pictures}"
    found = board(title, {submission.name: submission.method for submission in submissions}, scenes, refused)
    write_record(out / "board.json", found)
    write_figures(found)
    grids = {made.scene.name: _pictures(made, scored) for made, scored in zip(entered, scenes, strict=True)}
    for name, text in (("board.html", suite_html(found, grids)), ("board.md", suite_markdown(found))):
        with atomic_path(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    console().print(suite_markdown(found), markup=False, highlight=False)
    print(f"written to {out}/board.html, .md, .json")
    return 0


def crosses(submission: Submission, entered: list[MadeScene], kept: Path) -> tuple[str, ...]:
    """Why `gof benchmark check` refuses a submission, for what it has of these scenes; () where it does not."""
    datasets = {made.scene.name: made.dataset for made in entered}
    of_these = replace(submission, runs={name: runs for name, runs in submission.runs.items() if name in datasets})
    found = check(of_these, datasets, lambda run, dataset: kept_scores(run, dataset, kept))
    refused = tuple(str(finding) for finding in found if finding.verdict == "refused")
    for cross in refused:
        console().print(f"{submission.name}: {cross}", style="bold red", markup=False, highlight=False)
    return refused


def scored_scene(made: MadeScene, submissions: list[Submission], kept: Path) -> ScoredScene:
    """Return a scene with the scores of every submission that has it; what cannot be read is left out, as the check
    says."""
    runs, curves = {}, {}
    for submission in submissions:
        folders = submission.runs.get(made.scene.name, ())
        try:
            opened = [Run.open(folder, made.scene.name) for folder in folders]
            scored = tuple(evaluated(run, made, submission.method, kept) for run in opened)
            with_curve = [run.folder / CURVE for run in opened if (run.folder / CURVE).is_file()]
            read = [TrainingCurve.read(path) for path in with_curve[:1]]
        except GofError:
            continue
        if scored:
            runs[submission.name] = scored
        if read:
            curves[submission.name] = read[0]
    times_s = tuple(map(float, made.dataset.times_s))
    return ScoredScene(made.scene.name, made.scene.split, eddy_time(made.dataset), times_s, runs, curves)


def _pictures(made: MadeScene, scored: ScoredScene) -> PageGrid | None:
    """Return the first run of every method, from the middle camera."""
    first = [replace(runs[0], name=name) for name, runs in scored.runs.items()]
    return side_by_side(first, Moment.near(made.dataset, len(made.dataset.cameras) // 2, None))


def evaluated(run: Run, made: MadeScene, about: AboutMethod, kept: Path) -> EvaluatedResult:
    """Return a run's scores, computed here or kept from before."""
    scores = kept_scores(run, made.dataset, kept)
    # of one scene: its own costs, where they are there, else what the method says of itself
    costs_here = (run.folder / "costs.json").is_file()
    return EvaluatedResult.of(run.folder, replace(about, train_seconds=None) if costs_here else about, scores)


def kept_scores(run: Run, dataset: Dataset, kept: Path) -> Scores:
    """Return a run's scores: computed, or of an earlier time when nothing was different that has a part in them."""
    path = kept / f"{_digits(run, dataset)}.json"
    if path.is_file():
        return Scores.read(path)
    print(f"{run.folder}: scoring", flush=True)
    scores = score_again(run, dataset)
    scores.write(path)
    return scores


def _digits(run: Run, dataset: Dataset) -> str:
    """Change with all that a run holds but its pictures and its own words on scores and costs, with how its result is
    read and scored, with the dataset and its velocities, and with the program that scores."""
    state = hashlib.sha256()
    for path in sorted(path for path in run.folder.rglob("*") if path.is_file()):
        name = path.relative_to(run.folder).as_posix()
        if name not in (SCORES, CURVE, "costs.json") and not name.startswith(f"{PICTURES}/"):
            state.update(name.encode() + hashlib.sha256(path.read_bytes()).digest())
    origin = to_json(run.scores)["import"]
    how = [os.path.relpath(run.result, run.folder), origin["options"], origin["over_plates"], ORDER, OPACITY, RANKED]
    truth = [path.relative_to(dataset.path).as_posix() for path in dataset.path.glob("*.zarr/**/*") if path.is_file()]
    truth += [path.relative_to(dataset.path).as_posix() for path in dataset.path.glob("grids/**/*") if path.is_file()]
    state.update(json.dumps([how, dataset.identity(*truth), __version__], sort_keys=True).encode())
    return state.hexdigest()[:24]
