"""`evaluate`: every score of a result against a dataset, with the controls and what each part cost."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.gaussians import MovingGaussians, TransientGaussians
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom, leaks
from gof.dataset.plates import background
from gof.evaluate.controls import CONTROLS, skill
from gof.evaluate.dve_frame import DVESequence, Opacity
from gof.evaluate.emission import EmissionScore, flame_grid, score_on_emission
from gof.evaluate.gradients import GradientErrors, score_gradients
from gof.evaluate.image_scores import BLACK, Extras, Progress, image_scores, known_frames, timed
from gof.evaluate.scores import (
    Agreement,
    ControlScore,
    EmissionFigures,
    FrameScore,
    Origin,
    Scores,
    UsedAlignment,
    UsedOptions,
    VelocityScore,
)
from gof.evaluate.sequence import dve_sequence, sanity_warnings
from gof.io.importers import ImportOptions, read_result
from gof.io.importers.alignment import align_cameras, read_cameras, require_same_world
from gof.io.importers.said import in_words, with_said

NO_PICTURES = "the dataset holds no frame out, so there are no scores of pictures"
OURS = ("gof", "memory")  # methods whose results without static Gaussians are known to be flames alone


def evaluate(
    result: Path | MovingGaussians,
    dataset: Dataset,
    order: int = 3,
    opacity: Opacity = "temporal",
    images: bool = True,
    progress: Progress | None = None,
    foreign: ImportOptions | None = None,
    align: Path | None = None,
    extras: Extras | None = None,
    flame_only: bool = False,
) -> Scores:
    """All scores of a result.

    Pictures: every held-out frame of every camera. Our own results without static Gaussians are flames before a plate:
    their own (`gof.dataset.plates`), else the dataset's fire-free one. Everybody else's are drawn as they are, over
    black: a whole scene drawn over our plates would be scored for them. `flame` scores count pixels of
    the true flame mask only. Pixels of the sync board do not count. Velocities: DVE on every frame of the clip that has
    a true velocity field.

    Args:
        result: file or folder of any known method (gof.io.importers), or the Gaussians. Nobody says whose those in
            memory are: `TransientGaussians` count as ours, trajectories and functions of time do not.
        dataset: what it was made from.
        order, opacity: of `dve`.
        images: also render and score pictures.
        progress: progress(done, total, stage=name).
        foreign: what a foreign result does not say; what they leave open is as RESULT.gof.json beside it says, and
            the frame time is the dataset's.
        align: cameras of the method's own world (see `read_cameras`); the result is moved by the similarity that maps
            them onto the dataset's.
        extras: material for LPIPS, CGVQM and RMSE_depth; without it they are named as absent.
        flame_only: the result of another method is a flame without its surroundings: draw it over plates too.
    Raises:
        GofError: see `dve_sequence`.   DataFormatError: a file is damaged.
    """
    costs: dict[str, float] = {}
    progress = progress or (lambda *a, **k: None)
    with timed(costs, "load"):
        gaussians, origin = _load(result, dataset, foreign or ImportOptions(), align)
    made_from = _made_from(result)
    partly = _partly(gaussians, dataset)
    scores = Scores(
        gaussians=len(gaussians),
        dynamic_gaussians=int(np.count_nonzero(gaussians.dynamic)),
        import_=origin,
        flow_prior=None if made_from is None else "flow_prior" in made_from.learned,
        warnings=partly,
    )
    if dataset.has_velocity:
        with timed(costs, "dve"):
            sequence = _dve(gaussians, dataset, order, opacity, progress)
            emission = _emission(gaussians, dataset, sequence.times_s, progress)
            gradients = _gradients(gaussians, dataset, sequence.times_s, progress)
        scores = replace(
            scores,
            dve=_velocity_score(sequence, dataset.datum.time_s, order, opacity, emission, gradients),
            controls={name: _control_score(name, control) for name, control in sequence.controls.items()},
            warnings=(*partly, *sanity_warnings(sequence)),
        )
    else:
        scores = replace(scores, warnings=(*partly, "the dataset has no true velocity field, so there is no DVE"))
    scores = replace(scores, warnings=(*scores.warnings, *_leak_warnings(made_from, dataset)))
    if images:
        flame_only = flame_only or (isinstance(result, Path) and with_said(result, ImportOptions())[0].flame_only)
        origin = replace(origin, over_plates=is_flame_alone(gaussians, origin.method, flame_only))
        if not origin.over_plates and origin.method not in OURS:
            said = (
                "pictures are those of its Gaussians alone, over black; `gof convert RESULT --flame-only` says that it "
                "is a flame alone, which is drawn over the plates"
            )
            origin = replace(origin, notes=(*origin.notes, said))
        scores = replace(scores, import_=origin)
        own = result if isinstance(result, Path) else None
        plates = [background(dataset, k, own) if origin.over_plates else BLACK for k in range(len(dataset.cameras))]
        if not dataset.test_frames:
            scores = replace(scores, warnings=(*scores.warnings, NO_PICTURES))
        found = image_scores(gaussians, dataset, plates, costs, extras or Extras(), progress)
        scores = replace(scores, **asdict(found.means), **found.videos, published=found.published, images=found.images)
    return replace(scores, costs={name: round(seconds, 3) for name, seconds in costs.items()})


# ---------------------------------------------------------------- the result


def is_flame_alone(gaussians: MovingGaussians, method: str, flame_only: bool) -> bool:
    """Whether a result is drawn over plates: ours without static Gaussians, and others that say they are flames."""
    return bool(gaussians.dynamic.all()) and (flame_only or method in OURS)


def _load(
    result: Path | MovingGaussians, dataset: Dataset, foreign: ImportOptions, align: Path | None
) -> tuple[MovingGaussians, Origin]:
    if isinstance(result, Path):
        foreign, said = with_said(result, foreign)
        options = replace(
            foreign,
            frame_time_s=foreign.frame_time_s or dataset.frame_time_s or None,
            clip_s=(float(dataset.times_s[0]), float(dataset.times_s[-1])),
        )
        imported = read_result(result, options)
        gaussians, notes = imported.gaussians.measured_from(dataset.datum), list(imported.notes)
        notes += [] if said is None else [in_words(said, foreign)]
        if options.world is not None and options.world.is_dir() and align is None:
            ours = {c.name: c.world_to_camera for c in dataset.cameras}
            notes.append(require_same_world(read_cameras(options.world), ours, options.world))
        origin = Origin(imported.method, tuple(notes), str(imported.path), UsedOptions.of(options))
    else:
        gaussians = result.measured_from(dataset.datum)
        origin = Origin("memory" if isinstance(gaussians, TransientGaussians) else "trajectory")
    if align is None:
        return gaussians, origin
    found = align_cameras(read_cameras(align), {c.name: c.world_to_camera for c in dataset.cameras})
    origin = replace(origin, notes=(*origin.notes, found.in_words(align)), alignment=UsedAlignment.of(found))
    return gaussians.transformed(found.matrix), origin


def _made_from(result: Path | MovingGaussians) -> MadeFrom | None:
    """What a result of ours was made from; None where its folder does not say."""
    if not isinstance(result, Path):
        return None
    return MadeFrom.read(result if result.is_dir() else result.parent)


def _leak_warnings(made_from: MadeFrom | None, dataset: Dataset) -> list[str]:
    """What a result learned from that is held out here, in words."""
    found = leaks(made_from.files if made_from else {}, dataset.test_frames).values()
    frames = sorted({frame for frames in found for frame in frames})
    said = f"it was made from frames {frames}, which are held out here: its scores are not those of unseen frames"
    return [said] if frames else []


def _partly(gaussians: MovingGaussians, dataset: Dataset) -> tuple[str, ...]:
    """A warning where a result says something about a part of the clip alone."""
    known = known_frames(gaussians, dataset)
    if known.all():
        return ()
    first, last = gaussians.covered_s
    held_out = dataset.test_frames
    return (
        f"the result covers {first:g}..{last:g} s, {known.sum()} of the clip's {len(known)} frames and "
        f"{known[held_out].sum()} of its {len(held_out)} held-out ones, and is scored there alone: these are no scores "
        "of the clip",
    )


# ---------------------------------------------------------------- its velocities


def _dve(gaussians: MovingGaussians, dataset: Dataset, order: int, opacity: Opacity, progress: Progress) -> DVESequence:
    """DVE of the frames of the velocity store that lie in the clip, half a frame's time around it included."""
    truth = dataset.velocity
    slack = dataset.frame_time_s / 2
    in_clip = (truth.times_s >= dataset.times_s[0] - slack) & (truth.times_s <= dataset.times_s[-1] + slack)
    if not in_clip.any():
        raise DataFormatError(
            f"{dataset.path}: the velocity store covers {truth.times_s[0]:g}..{truth.times_s[-1]:g} s, the "
            f"clip {dataset.times_s[0]:g}..{dataset.times_s[-1]:g} s: their clocks do not overlap"
        )
    return dve_sequence(
        gaussians,
        truth,
        truth.times_s[in_clip],
        order,
        opacity,
        progress=lambda done, total: progress(done, total, stage="DVE"),
    )


def _emission(
    gaussians: MovingGaussians, dataset: Dataset, times_s: list[float], progress: Progress
) -> EmissionFigures | None:
    flame = flame_grid(dataset)
    if flame is None:
        return None
    found: EmissionScore = score_on_emission(
        gaussians,
        dataset.velocity,
        flame,
        np.array(times_s),
        progress=lambda done, total: progress(done, total, stage="on emission"),
    )
    return EmissionFigures(
        l2=found.score.l2,
        cos_sim=found.score.cos_sim,
        n=found.score.n,
        speed_ratio=found.score.speed_ratio,
        l2_axis=found.score.l2_axis,
        undefined=found.score.undefined,
        uncovered=found.uncovered,
        constant=Agreement.of(found.constant),
    )


def _gradients(
    gaussians: MovingGaussians, dataset: Dataset, times_s: list[float], progress: Progress
) -> GradientErrors | None:
    flame = flame_grid(dataset)
    if flame is None:
        return None
    return score_gradients(
        gaussians,
        dataset.velocity,
        flame,
        np.array(times_s),
        progress=lambda done, total: progress(done, total, stage="gradients"),
    )


def _clip_figures(sequence: DVESequence) -> dict[str, float | int | None]:
    """The fields of a `ClipScore`: the pooled score, and mean and standard deviation over the frames that have one."""
    l2_mean, l2_std, _ = sequence.spread("l2") or (None, None, 0)
    cos_mean, cos_std, count = sequence.spread("cos_sim") or (None, None, 0)
    return asdict(sequence.pooled) | {
        "l2_frame_mean": l2_mean,
        "l2_frame_std": l2_std,
        "cos_sim_frame_mean": cos_mean,
        "cos_sim_frame_std": cos_std,
        "frames_scored": count,
    }


def _control_score(name: str, control: DVESequence) -> ControlScore:
    return ControlScore(**_clip_figures(control), meaning=CONTROLS[name])


def _velocity_score(
    sequence: DVESequence,
    zero_s: float,
    order: int,
    opacity: Opacity,
    emission: EmissionFigures | None,
    gradients: GradientErrors | None,
) -> VelocityScore:
    frames = zip(sequence.times_s, sequence.frames, strict=True)
    controls = ((name, sequence.controls.get(name)) for name in CONTROLS)
    skills = {f"skill_over_{name}": skill(sequence.pooled, c.pooled) if c else None for name, c in controls}
    return VelocityScore(
        **_clip_figures(sequence),
        **skills,
        frames=tuple(FrameScore(t + zero_s, f.l2, f.cos_sim, f.n, f.undefined) for t, f in frames),
        inside=Agreement.of(sequence.inside),
        fluctuation=sequence.fluctuation,
        within_sd=sequence.within_sd,
        order=order,
        opacity=opacity,
        on_emission=emission,
        gradients=gradients,
    )
