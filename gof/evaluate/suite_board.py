"""Methods side by side over the scenes of a suite: means, their uncertainty, and which methods differ significantly.

A figure of a method is the mean over a scene's frames, over its runs there, and over scenes. Two methods are compared
on the same frames of the same scenes, difference by difference (`gof.evaluate.intervals`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import ClassVar

import numpy as np

from gof.evaluate.alarms import beyond_sense, too_good
from gof.evaluate.eddy_time import EddyTime
from gof.evaluate.intervals import Estimate, over_frames, over_runs, over_scenes, ranks
from gof.evaluate.leaderboard import COLUMNS, EvaluatedResult
from gof.evaluate.method import AboutMethod
from gof.evaluate.scores import Agreement, Scores, velocity_of
from gof.evaluate.training_curve import TrainingCurve

RANKED = ("eve_l2", "eve_cos", "psnr_flame", "ssim_flame")  # figures that every frame has
PRINTED = (
    "l2",
    "cos_sim",
)  # the paper's, which every frame has too: shown with their intervals, ranked only where a scene has no true light
TRIVIAL = "trivial: "  # before a trivial baseline's name
SHOWN = ("zero", "constant", "height_mean", "true_centre")
WITHOUT_STRUCTURE = ("zero", "constant", "height_mean")  # fluctuation: L2 1, CosSim 0, by definition
UNIFORM = ("zero", "constant")  # vorticity: L2 1, and no divergence
POINTS = 40  # of a training's curve, at most
NOT_SHOWN = ("velocity_of", "flow_prior", "evaluate_s", "speed_ratio", "skill")

VELOCITY = {
    "eve_l2": (lambda scores: None if scores.dve is None else scores.dve.eve, "l2"),
    "eve_cos": (lambda scores: None if scores.dve is None else scores.dve.eve, "cos_sim"),
    "l2": (lambda scores: scores.dve, "l2"),
    "cos_sim": (lambda scores: scores.dve, "cos_sim"),
}

Series = dict[float, float]  # time in s -> a figure of that frame


@dataclass(frozen=True)
class ScoredScene:
    """A scene of the suite, and what every method that was here scores there: the runs by the method's name."""

    name: str
    split: str
    eddy_time: EddyTime
    times_s: tuple[float, ...]  # of the frames, by number
    runs: dict[str, tuple[EvaluatedResult, ...]]
    curves: dict[str, TrainingCurve] = field(default_factory=dict)  # of one run, where there is one


@dataclass(frozen=True)
class Figure:
    """One figure of a method.

    Attributes:
        half_width: of its 95 % interval; None where it is not known.
        seed_sd: standard deviation over runs of one scene, mean over scenes; None with one run each.
        rank, last_rank: the best and the worst place that it may have, shared with methods that it cannot be told apart
            from; None for those that do not compete.
        wins: scenes where its mean is the best of all.
    """

    mean: float
    half_width: float | None = None
    seed_sd: float | None = None
    rank: int | None = None
    last_rank: int | None = None
    wins: int | None = None


@dataclass(frozen=True)
class BoardRow:
    """A method, or a trivial baseline; `figures` by the names of `gof.evaluate.leaderboard.COLUMNS`.

    `over_plates`: it is a flame alone, drawn over fire-free plates; None for a trivial baseline, and where runs differ.
    `refused`: why the check refuses its submission; such a row is not ranked.
    `trivial_baseline`: it is no method.
    `alarm`: that its velocities are better than an honest method's can be; people must judge it.
    `velocity`: whose was scored, the gas' or that of the Gaussians; "" where runs differ or none was.
    """

    FORMER: ClassVar[dict[str, str]] = {"control": "trivial_baseline"}  # of 0.2; goes with the next version

    name: str
    what: str
    competes: bool
    scenes: int
    runs: int
    given: tuple[str, ...]
    prior: tuple[str, ...] | None
    figures: dict[str, Figure]
    over_plates: bool | None = None
    refused: tuple[str, ...] = ()
    trivial_baseline: bool = False
    alarm: str = ""
    velocity: str = ""


@dataclass(frozen=True)
class BoardScene:
    """One scene alone: `figures` by method, then by name; the training `curves` of methods that have one;
    `trivial_baselines` as `figures`, without ranks, on the Gaussians of `trivial_baselines_on`."""

    FORMER: ClassVar[dict[str, str]] = {"controls": "trivial_baselines", "controls_on": "trivial_baselines_on"}

    name: str
    split: str
    eddy_time_s: float
    at_least: bool
    eddies: float
    figures: dict[str, dict[str, Figure]] = field(default_factory=dict)
    curves: dict[str, TrainingCurve] = field(default_factory=dict)
    trivial_baselines: dict[str, dict[str, Figure]] = field(default_factory=dict)
    trivial_baselines_on: str = ""


@dataclass(frozen=True)
class SuiteBoard:
    """board.json."""

    SCHEMA: ClassVar[str] = "gof-suite-board"
    VERSION: ClassVar[int] = 1

    title: str
    rows: tuple[BoardRow, ...]
    scenes: tuple[BoardScene, ...]


def board(
    title: str,
    methods: dict[str, AboutMethod],
    scenes: Sequence[ScoredScene],
    refused: Mapping[str, Sequence[str]] | None = None,
) -> SuiteBoard:
    """Return the board of some methods, by name, over scenes. A method without a result somewhere is not ranked.

    Args:
        refused: by the name of a method why its submission is refused; it is shown and not ranked. One whose
            figures are beyond sense is refused here, and those figures are not shown: they would spoil every mean.
    """
    crosses = {name: tuple((refused or {}).get(name, ())) for name in methods}
    sensible = []
    for scene in scenes:
        wrong = {
            name: [beyond_sense(run.scores) for run in runs] for name, runs in scene.runs.items() if name in methods
        }
        for name, found in wrong.items():
            crosses[name] += tuple(f"{scene.name}: {reason}" for reason in found if reason)
        runs = {name: runs for name, runs in scene.runs.items() if not any(wrong.get(name, ()))}
        sensible.append(replace(scene, runs=runs, curves={n: c for n, c in scene.curves.items() if n in runs}))
    scenes = sensible
    out = {name for name, about in methods.items() if about.unfinished or crosses[name]}
    competing = [name for name in methods if name not in out and all(name in scene.runs for scene in scenes)]
    places = {key: _places(key, competing, scenes) for key in ranked_in(scenes)}
    rows = [
        replace(_row(name, about, scenes, name in competing, places), refused=crosses[name])
        for name, about in methods.items()
    ]
    whose = _whose([*(name for name in methods if not crosses[name]), *(n for n in methods if crosses[n])], scenes)
    alone = tuple(_alone(scene, out, whose) for scene in scenes)
    return SuiteBoard(title, (*rows, *_trivial_rows(whose, scenes)), alone)


# ---------------------------------------------------------------- one method


def ranked_in(scenes: Sequence[ScoredScene]) -> tuple[str, ...]:
    """Return the figures that rank in scenes: the paper's own velocities where not all of them have true light."""
    lit = all(
        any(run.scores.dve is not None and run.scores.dve.eve for runs in scene.runs.values() for run in runs)
        for scene in scenes
    )
    return RANKED if lit else (*PRINTED, *RANKED[len(PRINTED) :])


def _row(
    name: str, about: AboutMethod, scenes: Sequence[ScoredScene], competes: bool, places: dict[str, dict[str, Figure]]
) -> BoardRow:
    own_scenes = [scene for scene in scenes if name in scene.runs]
    figures = {key: _plain(column.value, name, own_scenes) for key, column in COLUMNS.items() if key not in NOT_SHOWN}
    for key in (*RANKED, *PRINTED):
        estimate, seed_sd = _estimate(key, name, own_scenes)
        if estimate is not None:
            figures[key] = placed(Figure(estimate.mean, estimate.half_width, seed_sd), places.get(key, {}).get(name))
    return BoardRow(
        name=name,
        what="; ".join(filter(None, (about.code, about.commit, about.licence, about.hardware))),
        competes=competes,
        scenes=len(own_scenes),
        runs=sum(len(scene.runs[name]) for scene in own_scenes),
        given=about.given,
        prior=about.prior,
        figures={key: figure for key, figure in figures.items() if figure is not None},
        over_plates=_over_plates([run.scores for scene in own_scenes for run in scene.runs[name]]),
        alarm=next(
            (f"{s.name}: {reason}" for s in own_scenes for run in s.runs[name] if (reason := too_good(run.scores))), ""
        ),
        velocity=velocity_of([run.scores for scene in own_scenes for run in scene.runs[name]]) or "",
    )


def _over_plates(scores: Sequence[Scores]) -> bool | None:
    drawn_over = {one.import_.over_plates for one in scores}
    return drawn_over.pop() if len(drawn_over) == 1 else None


def _plain(value: Callable, name: str, scenes: Sequence[ScoredScene]) -> Figure | None:
    """Return mean over runs and scenes of what has a value for every run; None where one has none."""
    found = [[value(run) for run in scene.runs[name]] for scene in scenes]
    if not found or any(number is None for runs in found for number in runs):
        return None
    return Figure(float(np.mean([np.mean(runs) for runs in found])))


def _estimate(key: str, name: str, scenes: Sequence[ScoredScene]) -> tuple[Estimate | None, float | None]:
    """Over scenes, and the spread that seeds make; None where a scene has no such figure."""
    estimates, spreads = [], []
    for scene in scenes:
        runs = _common([frame_figures(run.scores, scene, key) for run in scene.runs[name]])
        if not runs[0]:
            return None, None
        estimates.append(over_runs([list(run.values()) for run in runs], _eddy_frames(runs[0], scene)))
        if len(runs) > 1:
            spreads.append(float(np.std([np.mean(list(run.values())) for run in runs], ddof=1)))
    if not estimates:
        return None, None
    return over_scenes(estimates), float(np.mean(spreads)) if spreads else None


def _scene_mean(key: str, name: str, scene: ScoredScene) -> float:
    """Return the mean of a scene; NaN where it has no such figure."""
    estimate, _ = _estimate(key, name, [scene])
    return float("nan") if estimate is None else estimate.mean


def frame_figures(scores: Scores, scene: ScoredScene, key: str) -> Series:
    """Return a figure of every frame that has one; of pictures the mean over cameras."""
    if key in VELOCITY:
        part, figure = VELOCITY[key]
        frames = () if (of := part(scores)) is None else of.frames
        return {round(f.time_s, 9): getattr(f, figure) for f in frames if not f.undefined}
    rows: dict[int, list[float]] = {}
    for picture in scores.images.pictures if scores.images else ():
        if (value := getattr(picture, key)) is not None:
            rows.setdefault(picture.frame, []).append(value)
    return {round(scene.times_s[frame], 9): float(np.mean(values)) for frame, values in sorted(rows.items())}


def _common(series: Sequence[Series]) -> list[Series]:
    """Return the series at the times that all of them have."""
    times = sorted(set.intersection(*(set(one) for one in series)))
    return [{time_s: one[time_s] for time_s in times} for one in series]


def _eddy_frames(series: Series, scene: ScoredScene) -> float:
    steps = np.diff(list(series))
    return scene.eddy_time.seconds / float(np.median(steps)) if len(steps) else 0.0


# ---------------------------------------------------------------- between methods


def difference(key: str, first: str, second: str, scene: ScoredScene) -> Estimate | None:
    """Return first less second, frame by frame, on the frames that both have; None where there are none."""
    sides = [[frame_figures(run.scores, scene, key) for run in scene.runs[name]] for name in (first, second)]
    shared = _common([*sides[0], *sides[1]])
    if not shared[0]:
        return None
    ours, theirs = (
        np.array([list(run.values()) for run in part]) for part in (shared[: len(sides[0])], shared[len(sides[0]) :])
    )
    frames = over_frames(ours.mean(0) - theirs.mean(0), _eddy_frames(shared[0], scene))
    seeds = sum(runs.mean(1).var(ddof=1) / len(runs) for runs in (ours, theirs) if len(runs) > 1)
    if frames.standard_error is None:
        return frames
    return Estimate(frames.mean, float(np.sqrt(frames.standard_error**2 + seeds)), frames.degrees)


def placed(figure: Figure, place: Figure | None) -> Figure:
    """Return the figure with the ranks and wins of `place`; None: it has none."""
    return figure if place is None else replace(figure, rank=place.rank, last_rank=place.last_rank, wins=place.wins)


def _places(key: str, names: Sequence[str], scenes: Sequence[ScoredScene]) -> dict[str, Figure]:
    """Mean, rank and wins of the methods that have the figure everywhere; empty with fewer than two."""
    sign = COLUMNS[key].better
    estimates = {name: _estimate(key, name, scenes)[0] for name in names}
    found = {name: estimate for name, estimate in estimates.items() if estimate is not None}
    names = list(found)
    if len(names) < 2 or not scenes:
        return {}
    means = [found[name].mean for name in names]
    p_values = np.ones((len(names), len(names)))
    for i, j in combinations(range(len(names)), 2):
        apart = [difference(key, names[i], names[j], scene) for scene in scenes]
        known = [estimate for estimate in apart if estimate is not None]
        p_values[i, j] = p_values[j, i] = over_scenes(known).p_value if len(known) == len(apart) else 1.0
    order = ranks(means, p_values, sign)
    per_scene = np.array([[_scene_mean(key, name, scene) for name in names] for scene in scenes])
    wins = (per_scene == (sign * per_scene).max(1, keepdims=True) * sign).sum(0)
    return {
        name: Figure(mean, rank=first, last_rank=last, wins=int(won))
        for name, mean, (first, last), won in zip(names, means, order, wins, strict=True)
    }


def _alone(scene: ScoredScene, out: set[str], whose: dict[str, str]) -> BoardScene:
    """Return the figures of every method in one scene, with ranks of that scene alone; those that are `out` have
    none."""
    names = list(scene.runs)
    figures: dict[str, dict[str, Figure]] = {name: {} for name in names}
    for key in (*RANKED, *PRINTED):
        competing = [name for name in names if name not in out]
        places = _places(key, competing, [scene]) if key in ranked_in([scene]) else {}
        for name in names:
            estimate, seed_sd = _estimate(key, name, [scene])
            if estimate is not None:
                figure = placed(Figure(estimate.mean, estimate.half_width, seed_sd), places.get(name))
                figures[name][key] = replace(figure, wins=None)  # of one scene they say nothing
    clip_s = scene.times_s[-1] - scene.times_s[0]
    eddy = scene.eddy_time
    eddies = clip_s / max(eddy.seconds, 1e-9)
    curves = {name: curve.thinned(POINTS) for name, curve in scene.curves.items()}
    trivial_baselines = {row.name: row.figures for row in _trivial_rows(whose, [scene])}
    return BoardScene(
        scene.name,
        scene.split,
        eddy.seconds,
        eddy.at_least,
        eddies,
        figures,
        curves,
        trivial_baselines,
        whose.get(scene.name, ""),
    )


# ---------------------------------------------------------------- trivial baselines


def _whose(methods: Sequence[str], scenes: Sequence[ScoredScene]) -> dict[str, str]:
    """By scene the method whose Gaussians the trivial baselines have: a flame alone, if one is there, and one of every
    scene.

    In a whole scene most Gaussians are the room, where the true velocity is zero: a trivial baseline there is that of a
    room.
    """

    def last(scene: ScoredScene, name: str) -> tuple[bool, bool]:
        flame = all(run.scores.import_.over_plates for run in scene.runs[name])
        return not flame, not all(name in other.runs for other in scenes)

    taking_part = [(scene, [name for name in methods if name in scene.runs]) for scene in scenes]
    return {scene.name: min(names, key=partial(last, scene)) for scene, names in taking_part if names}


def _trivial_rows(whose: dict[str, str], scenes: Sequence[ScoredScene]) -> list[BoardRow]:
    """Return the permanent rows."""
    if not scenes or any(scene.name not in whose for scene in scenes):
        return []
    runs = [scene.runs[whose[scene.name]][0] for scene in scenes]
    names = ", then ".join(dict.fromkeys(whose[scene.name] for scene in scenes))
    rows = [_trivial_row(name, [run.scores for run in runs]) for name in SHOWN]
    plate = {f"{key}": f"{key}_plate" for key in ("psnr_flame", "ssim_flame", "psnr", "ssim")}
    rows.append(
        ("fire-free background", "the picture without fire", {key: _mean(runs, of) for key, of in plate.items()}),
    )
    return [
        BoardRow(
            name=f"{TRIVIAL}{name}",
            what=f"{meaning}, on the Gaussians of {names}",
            competes=False,
            scenes=len(scenes),
            runs=len(scenes),
            given=(),
            prior=None,
            figures={key: Figure(value) for key, value in found.items() if value is not None},
            trivial_baseline=True,
        )
        for name, meaning, found in rows
    ]


def _trivial_row(name: str, scores: Sequence[Scores]) -> tuple[str, str, dict[str, float | None]]:
    trivial_baselines = [one.trivial_baselines[name] for one in scores if name in one.trivial_baselines]
    if len(trivial_baselines) < len(scores):
        return name, "", {}
    known = [{"zero": Agreement(1.0, 0.0)} | one.dve.eve.baselines for one in scores if one.dve and one.dve.eve]
    eves = [baselines[name] for baselines in known if name in baselines]
    found: dict[str, float | None] = {
        "eve_l2": _average([eve.l2 for eve in eves]),
        "eve_cos": _average([eve.cos_sim for eve in eves]),
        "l2": _average([trivial_baseline.l2_frame_mean for trivial_baseline in trivial_baselines]),
        "cos_sim": _average([trivial_baseline.cos_sim_frame_mean for trivial_baseline in trivial_baselines]),
    }
    if name in WITHOUT_STRUCTURE:
        found |= {"fluctuation_l2": 1.0, "fluctuation_cos": 0.0}
    gradients = [one.dve.gradients for one in scores if one.dve is not None and one.dve.gradients is not None]
    if name in UNIFORM and len(gradients) == sum(one.dve is not None for one in scores):
        found["vorticity_l2"] = 1.0
        found["divergence_l2"] = _average([errors.still_divergence_l2 for errors in gradients])
    return name, trivial_baselines[0].meaning, found


def _mean(runs: Sequence[EvaluatedResult], figure: str) -> float | None:
    return _average([getattr(run.scores, figure) for run in runs])


def _average(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known and len(known) == len(values) else None
