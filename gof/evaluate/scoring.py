"""`evaluate`: every score of a result against a dataset, with the trivial baselines and what each part cost."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.costs import timed
from gof.core.errors import DataFormatError
from gof.core.fields import VelocitySequence
from gof.core.gaussians import MovingGaussians, TransientGaussians
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom, leaks, warn_of_another
from gof.dataset.plates import own_plate
from gof.evaluate.around import ViewAround, angles_deg, score_around
from gof.evaluate.dve_frame import DVESequence, Opacity
from gof.evaluate.emission import flame_grid
from gof.evaluate.eve import EveResult, GradientErrors, score_where_it_burns
from gof.evaluate.flow import FlowScores, score_views, views
from gof.evaluate.image_scores import BLACK, Extras, Progress, image_scores
from gof.evaluate.light import score_light
from gof.evaluate.scores import (
    Agreement,
    AroundScore,
    EveFigures,
    FrameScore,
    LightScore,
    Origin,
    Scores,
    TrivialScore,
    UsedAlignment,
    UsedOptions,
    VelocityScore,
)
from gof.evaluate.sequence import dve_sequence, sanity_warnings
from gof.evaluate.settled import against_motion, settle
from gof.evaluate.sparse_grid import StoredFields
from gof.evaluate.trivial_baselines import TRIVIAL_BASELINES, skill
from gof.io.importers import Imported, ImportOptions, read_result
from gof.io.importers.alignment import align_cameras, align_result, read_cameras, require_same_world
from gof.io.importers.sidecar import in_words, with_sidecar

NO_PICTURES = "the dataset holds no frame out, so there are no scores of pictures"
NO_LIGHT = 'the dataset has no grids/flame.zarr, so there is no EVE; a scene with "ground_truth": ["grids"] writes it'
OURS = ("gof", "memory")  # methods whose results without static Gaussians are known to be flames alone


def evaluate(
    result: Path | str | Imported | MovingGaussians,
    dataset: Dataset | Path | str,
    order: int = 3,
    opacity: Opacity = "temporal",
    images: bool = True,
    progress: Progress | None = None,
    foreign: ImportOptions | None = None,
    align: Path | None = None,
    extras: Extras | None = None,
    flame_only: bool = False,
) -> Scores:
    """Compute all scores of a result.

    Pictures: every held-out frame of every camera. Our own results without static Gaussians are flames before a plate:
    their own (`gof.dataset.plates`), else the dataset's fire-free one. Other methods' are drawn without it, over
    black: a whole scene drawn over our plates would be scored for them. `flame` scores count pixels of
    the true flame mask only. Pixels of the sync board do not count. Velocities: DVE on every frame of the clip that has
    a true velocity field.

    Args:
        result: file or folder of any known method (gof.io.importers), as `read_result` returned it, or the Gaussians.
            In memory, `TransientGaussians` count as ours, trajectories and functions of time do not.
        dataset: what it was made from, opened or its folder.
        order, opacity: of `dve`.
        images: also render and score pictures.
        progress: progress(done, total, stage=name).
        foreign: what a foreign result does not say; what they leave open is as RESULT.gof.json beside it says, and
            the frame time is the dataset's.
        align: cameras of the method's own world (see `read_cameras`); the result is moved by the similarity that maps
            them onto the dataset's.
        extras: material for LPIPS and RMSE_depth; without it they are named as absent.
        flame_only: the result of another method is a flame without its surroundings: draw it over plates too.
    Raises:
        GofError: see `dve_sequence`.   DataFormatError: a file is damaged.
    """
    result = Path(result) if isinstance(result, str) else result
    dataset = dataset if isinstance(dataset, Dataset) else Dataset.open(dataset)
    costs: dict[str, float] = {}
    progress = progress or (lambda *a, **k: None)
    with timed(costs, "load"):
        gaussians, origin = _load(result, dataset, foreign or ImportOptions(), align)
    known = known_frames(gaussians, dataset)
    warnings = _partly(gaussians, known, dataset.test_frames)
    own = result if isinstance(result, Path) else result.path if isinstance(result, Imported) else None
    made_from = None if own is None else MadeFrom.read(own if own.is_dir() else own.parent)
    figures: dict[str, Any] = {}
    if dataset.has_velocity:
        figures, motion_warnings = _score_motion(gaussians, dataset, order, opacity, costs, progress)
        warnings += motion_warnings
    else:
        warnings.append("the dataset has no true velocity field, so there is no DVE")
    warnings += _leak_warnings(made_from, dataset.test_frames)
    if own is not None and (other := warn_of_another(own, dataset)):
        warnings.append(other)
    if images:
        flame_only = flame_only or (own is not None and with_sidecar(own, ImportOptions())[0].flame_only)
        origin = _drawn_as(origin, gaussians, flame_only)
        plates = [dataset.static(k) for k in range(len(dataset.cameras))]
        names = [camera.name for camera in dataset.cameras]
        behind = [own_plate(*of, own) if origin.over_plates else BLACK for of in zip(plates, names, strict=True)]
        if not dataset.test_frames:
            warnings.append(NO_PICTURES)
        figures["around"] = _around(gaussians, dataset, origin.over_plates, known, costs, progress)
        figures["flow"] = _flow(gaussians, dataset, known, costs, progress)
        found = image_scores(gaussians, dataset, known, plates, behind, costs, extras or Extras(), progress)
        figures |= asdict(found.means) | {"published": found.published, "images": found.images}
    return Scores(
        gaussians=len(gaussians),
        dynamic_gaussians=int(np.count_nonzero(gaussians.dynamic)),
        import_=origin,
        dataset=dataset.scored_as(),
        flow_prior=None if made_from is None else "flow_prior" in made_from.learned,
        warnings=tuple(warnings),
        costs={name: round(seconds, 3) for name, seconds in costs.items()},
        **figures,
    )


def _around(
    gaussians: MovingGaussians,
    dataset: Dataset,
    over_plates: bool,
    known: np.ndarray,
    costs: dict[str, float],
    progress: Progress,
) -> tuple[AroundScore, ...]:
    """Score the views from all around, where the dataset has them; over its plates, or black, as the held-out ones."""
    around = dataset.around_view()
    if around is None:
        return ()
    angles = angles_deg(around.cameras, dataset.cameras)
    with timed(costs, "around"):
        views = [ViewAround(k, a, around.static(k) if over_plates else BLACK) for k, a in enumerate(angles)]
        return score_around(gaussians, around, views, known, progress)


def _flow(
    gaussians: MovingGaussians, dataset: Dataset, known: np.ndarray, costs: dict[str, float], progress: Progress
) -> FlowScores | None:
    """Score the motion of pixels, as `gof flow` does, on the held-out pictures whose exact motion is known."""
    frames = [frame for frame in dataset.test_frames if known[frame]]
    if not frames or not any(map(dataset.has_flow, range(len(dataset.cameras)))):
        return None
    chosen = [view for view in views(dataset, frames) if view.has_truth]
    with timed(costs, "flow"):
        return score_views(gaussians, chosen, partial(progress, stage="flow"))


# ---------------------------------------------------------------- the result


def is_flame_alone(gaussians: MovingGaussians, method: str, flame_only: bool) -> bool:
    """Return whether a result is drawn over plates: ours without static Gaussians, and others that say they are
    flames."""
    return bool(gaussians.dynamic.all()) and (flame_only or method in OURS)


def _drawn_as(origin: Origin, gaussians: MovingGaussians, flame_only: bool) -> Origin:
    """Return the origin with what its pictures are drawn over, and a note where that may be another than was thought
    of."""
    over_plates = is_flame_alone(gaussians, origin.method, flame_only)
    note = (
        "pictures are those of its Gaussians alone, over black; `gof convert RESULT --flame-only` says that it is a "
        "flame alone, which is drawn over the plates"
    )
    notes = origin.notes if over_plates or origin.method in OURS else (*origin.notes, note)
    return replace(origin, over_plates=over_plates, notes=notes)


def _load(
    result: Path | Imported | MovingGaussians, dataset: Dataset, foreign: ImportOptions, align: Path | None
) -> tuple[MovingGaussians, Origin]:
    if isinstance(result, Path):
        foreign, sidecar = with_sidecar(result, foreign)
        options = replace(
            foreign,
            frame_time_s=foreign.frame_time_s or dataset.frame_time_s or None,
            clip_s=(float(dataset.times_s[0]), float(dataset.times_s[-1])),
        )
        imported = read_result(result, options)
        gaussians, notes = imported.gaussians, list(imported.notes)
        notes += [] if sidecar is None else [in_words(sidecar, foreign)]
        if options.world is not None and options.world.is_dir() and align is None:
            ours = {c.name: c.world_to_camera for c in dataset.cameras}
            notes.append(require_same_world(read_cameras(options.world), ours, options.world))
        origin = Origin(imported.method, tuple(notes), str(imported.path), UsedOptions.of(options))
    elif isinstance(result, Imported):
        gaussians = result.gaussians
        origin = Origin(result.method, tuple(result.notes), str(result.path))
    else:
        gaussians = result
        origin = Origin("memory" if isinstance(gaussians, TransientGaussians) else "trajectory")
    if align is None:
        return gaussians.measured_from(dataset.datum), origin
    found = align_cameras(read_cameras(align), {c.name: c.world_to_camera for c in dataset.cameras})
    origin = replace(origin, notes=(*origin.notes, found.in_words(align)), alignment=UsedAlignment.of(found))
    return align_result(gaussians, found, dataset.datum), origin


def _leak_warnings(made_from: MadeFrom | None, held_out: list[int]) -> list[str]:
    """Return a warning where a result learned from frames that are held out here."""
    found = leaks(made_from.files if made_from else {}, held_out).values()
    frames = sorted({frame for frames in found for frame in frames})
    warning = f"it was made from frames {frames}, which are held out here: its scores are not those of unseen frames"
    return [warning] if frames else []


def known_frames(gaussians: MovingGaussians, dataset: Dataset) -> np.ndarray:
    """Find the frames, (T,) bool, whose pictures all lie in the time for which a result has a state."""
    first, last = gaussians.covered_s
    clocks = np.array([dataset.times_s, *(dataset.camera_times_s(c) for c in range(len(dataset.cameras)))])
    return ((clocks >= first - 1e-6) & (clocks <= last + 1e-6)).all(0)


def _partly(gaussians: MovingGaussians, known: np.ndarray, held_out: list[int]) -> list[str]:
    """Return a warning where a result says something about a part of the clip alone: of `known` (T,) frames."""
    if known.all():
        return []
    first, last = gaussians.covered_s
    return [
        f"the result covers {first:g}..{last:g} s, {known.sum()} of the clip's {len(known)} frames and "
        f"{known[held_out].sum()} of its {len(held_out)} held-out ones, and is scored there alone: these are no scores "
        "of the clip"
    ]


# ---------------------------------------------------------------- its velocities


def _score_motion(
    gaussians: MovingGaussians,
    dataset: Dataset,
    order: int,
    opacity: Opacity,
    costs: dict[str, float],
    progress: Progress,
) -> tuple[dict[str, Any], list[str]]:
    """Return what the true grids judge, as fields of `Scores`, and warnings: velocities, and light in space."""
    truth, flame = dataset.velocity, flame_grid(dataset.path, dataset.datum)
    with timed(costs, "dve"):
        times_s = _scored_times(truth, dataset)
        fields = StoredFields(truth)
        sequence = dve_sequence(gaussians, fields, times_s, order, opacity, progress=partial(progress, stage="DVE"))
        times_s = np.array(sequence.times_s)
    with timed(costs, "quadrature"):
        settled = settle(gaussians, fields, sequence.probed, sequence.pooled, order)
    figures: dict[str, Any] = {}
    eve, gradients = None, None
    if flame is not None:
        eve, gradients = score_where_it_burns(gaussians, fields, flame, times_s, costs, progress)
        with timed(costs, "light"):
            middle = dataset.cameras[len(dataset.cameras) // 2].world_to_camera[2, :3]
            light = score_light(gaussians, flame, times_s, middle, partial(progress, stage="light"))
            figures["light"] = None if light is None else LightScore(**asdict(light))
    figures["dve"] = replace(
        _velocity_score(sequence, dataset.datum.time_s, order, opacity, eve, gradients),
        settled=settled,
        motion=Agreement.of(against_motion(gaussians, sequence.probed)),
    )
    figures["trivial_baselines"] = {
        name: _trivial_score(name, trivial_baseline) for name, trivial_baseline in sequence.trivial_baselines.items()
    }
    dark = [NO_LIGHT] if flame is None else flame.dark_notes
    return figures, [*dark, *sanity_warnings(sequence)]


def _scored_times(truth: VelocitySequence, dataset: Dataset) -> np.ndarray:
    """Return (K,) s: the frames of the velocity store that lie in the clip, half a frame's time around it included."""
    slack = dataset.frame_time_s / 2
    in_clip = (truth.times_s >= dataset.times_s[0] - slack) & (truth.times_s <= dataset.times_s[-1] + slack)
    if not in_clip.any():
        raise DataFormatError(
            f"{dataset.path}: the velocity store covers {truth.times_s[0]:g}..{truth.times_s[-1]:g} s, the "
            f"clip {dataset.times_s[0]:g}..{dataset.times_s[-1]:g} s: their clocks do not overlap"
        )
    return truth.times_s[in_clip]


def _clip_figures(sequence: DVESequence) -> dict[str, Any]:
    """Return the fields of a `ClipScore`: the pooled score, and mean and standard deviation over the frames that have
    one."""
    l2_mean, l2_std, _ = sequence.spread("l2") or (None, None, 0)
    cos_mean, cos_std, count = sequence.spread("cos_sim") or (None, None, 0)
    return asdict(sequence.pooled) | {
        "l2_frame_mean": l2_mean,
        "l2_frame_std": l2_std,
        "cos_sim_frame_mean": cos_mean,
        "cos_sim_frame_std": cos_std,
        "frames_scored": count,
    }


def _trivial_score(name: str, trivial_baseline: DVESequence) -> TrivialScore:
    return TrivialScore(**_clip_figures(trivial_baseline), meaning=TRIVIAL_BASELINES[name])


def _velocity_score(
    sequence: DVESequence,
    zero_s: float,
    order: int,
    opacity: Opacity,
    eve: EveResult | None,
    gradients: GradientErrors | None,
) -> VelocityScore:
    inside, fluctuation = sequence.inside, sequence.fluctuation
    assert inside is not None and fluctuation is not None, "scored with its trivial baselines"
    frames = zip(sequence.times_s, sequence.frames, strict=True)
    trivial_baselines = ((name, sequence.trivial_baselines.get(name)) for name in TRIVIAL_BASELINES)
    skills: dict[str, Any] = {
        f"skill_over_{name}": skill(sequence.pooled, c.pooled) if c else None for name, c in trivial_baselines
    }
    return VelocityScore(
        **_clip_figures(sequence),
        **skills,
        frames=tuple(FrameScore(t + zero_s, f.l2, f.cos_sim, f.n, f.undefined) for t, f in frames),
        inside=Agreement.of(inside),
        fluctuation=fluctuation,
        within_sd=sequence.within_sd,
        order=order,
        opacity=opacity,
        eve=None if eve is None else EveFigures.of(eve, zero_s),
        gradients=gradients,
    )
