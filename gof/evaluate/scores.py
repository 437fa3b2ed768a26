"""`scores.json`: everything `gof evaluate` finds out about a result. It writes the file; pages and comparisons read it.

None stands for "undefined" or "not requested"; docs/scores.md and docs/formats.md say what each figure means.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, make_dataclass, replace
from pathlib import Path
from typing import ClassVar

from gof.core.errors import DataFormatError
from gof.core.files import without_place
from gof.core.records import read_record, write_record
from gof.evaluate.dve_frame import DVEResult, DVESequence, Opacity
from gof.evaluate.eve import EveResult, GradientErrors
from gof.evaluate.flow import FlowScores
from gof.evaluate.settled import Settled
from gof.io.importers import ImportOptions
from gof.io.importers.alignment import Alignment
from gof.io.importers.source import WorldBy

# ---------------------------------------------------------------- velocities


@dataclass(frozen=True)
class Agreement:
    """The two figures of DVE alone."""

    l2: float | None
    cos_sim: float | None

    @classmethod
    def of(cls, score: DVEResult | DVESequence) -> Agreement:
        return cls(score.l2, score.cos_sim)


@dataclass(frozen=True)
class FrameScore:
    """DVE of one frame; `n` Gaussians were scored."""

    time_s: float
    l2: float | None
    cos_sim: float | None
    n: int
    undefined: str


@dataclass(frozen=True, kw_only=True)
class ClipScore(DVEResult):
    """DVE pooled over all frames of a clip, and how the single frames scatter around their mean.

    `frames_scored` counts the frames where the score is defined.
    """

    l2_frame_mean: float | None
    l2_frame_std: float | None
    cos_sim_frame_mean: float | None
    cos_sim_frame_std: float | None
    frames_scored: int


@dataclass(frozen=True, kw_only=True)
class TrivialScore(ClipScore):
    """A trivial baseline (`gof.evaluate.trivial_baselines`); `meaning` is a sentence for people."""

    meaning: str


@dataclass(frozen=True, kw_only=True)
class EveFigures:
    """The velocities where the fire is (`gof.evaluate.eve`), which rank.

    `l2_sd`, `cos_sim_sd`: standard deviation from the number of places; `empty`: share of the true light where nothing
    of the result is; `baselines` by the names of `gof.evaluate.eve.BASELINES`.
    """

    l2: float | None
    cos_sim: float | None
    l2_sd: float | None
    cos_sim_sd: float | None
    fluctuation: Agreement
    empty: float
    speed_ratio: float | None
    l2_axis: tuple[float, float, float] | None
    undefined: str
    frames: tuple[FrameScore, ...]
    baselines: dict[str, Agreement]

    @classmethod
    def of(cls, found: EveResult, zero_s: float) -> EveFigures:
        """Take them from a score whose times count from `zero_s` on the dataset's clock."""
        frames = zip(found.times_s, found.frames, strict=True)
        return cls(
            l2=found.pooled.l2,
            cos_sim=found.pooled.cos_sim,
            l2_sd=found.l2_sd,
            cos_sim_sd=found.cos_sim_sd,
            fluctuation=Agreement.of(found.fluctuation),
            empty=found.empty,
            speed_ratio=found.pooled.speed_ratio,
            l2_axis=found.pooled.l2_axis,
            undefined=found.pooled.undefined,
            frames=tuple(FrameScore(t + zero_s, f.l2, f.cos_sim, f.n, f.undefined) for t, f in frames),
            baselines={name: Agreement.of(one) for name, one in found.baselines.items()},
        )


ORDER = 3  # of the quadrature of every DVE that is compared, as OPACITY: nothing in a submission chooses them
OPACITY: Opacity = "temporal"


@dataclass(frozen=True, kw_only=True)
class VelocityScore(ClipScore):
    """The result's own DVE.

    `inside` pools the Gaussians inside the domain alone; `fluctuation` is what is left without the mean of each height;
    `within_sd` is the share of the velocity's components within one v_sd of the truth, 0.68 where errors are normal and
    v_sd is right, None where no Gaussian has one;
    `skill_over_NAME` = 1 - (L2 / L2 of the trivial baseline)^2, None where there is no such trivial baseline;
    `eve` and `gradients` are None for a dataset without a flame grid; `settled` is the score with as many nodes of
    quadrature as its digits need, and `motion` how its velocities agree with the motion of its Gaussians
    (`gof.evaluate.settled`).
    """

    frames: tuple[FrameScore, ...]
    inside: Agreement
    fluctuation: DVEResult
    within_sd: float | None = None
    order: int
    opacity: Opacity
    skill_over_zero: float | None
    skill_over_random: float | None
    skill_over_shuffled: float | None
    skill_over_light: float | None
    skill_over_constant: float | None
    skill_over_height_mean: float | None
    skill_over_true_centre: float | None
    eve: EveFigures | None = None
    settled: Settled | None = None
    motion: Agreement | None = None
    gradients: GradientErrors | None = None


# ---------------------------------------------------------------- pictures


@dataclass(frozen=True, kw_only=True)
class PictureFigures:
    """Scores of pictures. `_flame`: on flame pixels alone; `_plate`: of the fire-free plate in place of the result;
    `_between`: of the two frames around, carried along their flow (`gof.evaluate.between`)."""

    psnr: float | None = None
    psnr_flame: float | None = None
    psnr_plate: float | None = None
    psnr_flame_plate: float | None = None
    psnr_between: float | None = None
    psnr_flame_between: float | None = None
    ssim: float | None = None
    ssim_flame: float | None = None
    ssim_plate: float | None = None
    ssim_flame_plate: float | None = None
    ssim_between: float | None = None
    ssim_flame_between: float | None = None
    flip: float | None = None
    flip_flame: float | None = None
    flip_plate: float | None = None
    flip_flame_plate: float | None = None
    lpips: float | None = None
    lpips_plate: float | None = None
    temporal_l2: float | None = None
    temporal_l2_plate: float | None = None
    rmse_depth: float | None = None


@dataclass(frozen=True, kw_only=True)
class PublishedFigures:
    """The six that the authors publish, by their definitions (`gof.evaluate.authors_figures`)."""

    psnr_flame: float | None = None
    ssim_flame: float | None = None
    rmse_depth_flame: float | None = None
    lpips: float | None = None
    psnr_no_sync: float | None = None
    ssim_no_sync: float | None = None


@dataclass(frozen=True, kw_only=True)
class PictureScore(PictureFigures):
    """One held-out picture. `flame_share` of its pixels show flame; None without masks."""

    camera: str
    frame: int
    flame_share: float | None


FIGURES = tuple(f.name for f in fields(PictureFigures))
Spread = make_dataclass("Spread", [(f"{name}_std", float | None, None) for name in FIGURES], frozen=True, kw_only=True)


@dataclass(frozen=True, kw_only=True)
class ImageScores(Spread):  # type: ignore[valid-type, misc]  # a class made from FIGURES
    """The figures behind the means: every picture, and of each figure F its standard deviation over pictures, `F_std`.

    `board_share` of the pixels do not count; `absent` says which scores are not there, and why. `sizes_px` are the
    (width, height) that pictures were scored at: the same result scores lower at a larger size.
    """

    count: int
    absent: tuple[str, ...]
    board_share: float
    pictures: tuple[PictureScore, ...]
    sizes_px: tuple[tuple[int, int], ...] = ()


# ---------------------------------------------------------------- where the result came from


@dataclass(frozen=True)
class UsedOptions:
    """The `gof.io.importers.ImportOptions` that were used."""

    time_unit_s: float | None
    time_zero_s: float
    frame_time_s: float | None
    world: str | None
    world_by: WorldBy | None = None
    code_date: str | None = None
    emissive: bool = False

    @classmethod
    def of(cls, options: ImportOptions) -> UsedOptions:
        world = None if options.world is None else str(options.world)
        times = options.time_unit_s, options.time_zero_s, options.frame_time_s
        return cls(*times, world, options.world_by, options.code_date, options.emissive)

    def options(self) -> ImportOptions:
        world = None if self.world is None else Path(self.world)
        times = self.time_unit_s, self.time_zero_s, self.frame_time_s
        return ImportOptions(*times, world, self.world_by, self.code_date, emissive=self.emissive)


@dataclass(frozen=True)
class UsedAlignment:
    """The similarity that moved the result into the dataset's world (`gof.io.importers.alignment`)."""

    matrix: tuple[tuple[float, ...], ...]
    scale: float
    position_rms_m: float
    rotation_max_deg: float

    @classmethod
    def of(cls, alignment: Alignment) -> UsedAlignment:
        matrix = tuple(tuple(row) for row in alignment.matrix.tolist())
        return cls(matrix, alignment.scale, alignment.position_rms_m, alignment.rotation_max_deg)


@dataclass(frozen=True)
class Origin:
    """The way in which the result was read. `path` and `options` are None for Gaussians that came from memory.

    `over_plates`: it was drawn over fire-free plates, as a flame without its surroundings.
    """

    method: str
    notes: tuple[str, ...] = ()
    path: str | None = None
    options: UsedOptions | None = None
    alignment: UsedAlignment | None = None
    over_plates: bool = False


# ---------------------------------------------------------------- from all around


@dataclass(frozen=True, kw_only=True)
class AroundScore:
    """Pictures of a camera that stands where the method was given no view, means over its frames.

    Attributes:
        camera: its name.   angle_deg: from the nearest given camera, seen from the flame.   pictures: how many.
        psnr_flame: dB.   ssim_flame, gradient_ratio, false_colour: see `gof.evaluate.around`; None: undefined there.
    """

    camera: str
    angle_deg: float
    pictures: int
    psnr_flame: float | None = None
    ssim_flame: float | None = None
    gradient_ratio: float | None = None
    false_colour: float | None = None


# ---------------------------------------------------------------- light in space


@dataclass(frozen=True, kw_only=True)
class LightScore:
    """Scores of the light's place in space; see `gof.evaluate.light.LightResult`."""

    relative_l2: float
    correlation: float
    outside: float
    smear: float | None = None


# ---------------------------------------------------------------- all of it


@dataclass(frozen=True, kw_only=True)
class Scores(PictureFigures):
    """All scores of a result. The picture figures are means over every held-out frame of every camera.

    Attributes:
        gaussians, dynamic_gaussians: how many there are.
        import_: where the result came from.
        dataset: what it was scored on, see `Dataset.scored_as`; None in files of before 0.3.
        flow_prior: whether a learned flow prior had a part in it; None where the result does not say.
        warnings: hints that something is in other units or another world, or missing.
        dve: None when the dataset has no true velocity.
        trivial_baselines: by name (`gof.evaluate.trivial_baselines.TRIVIAL_BASELINES`); empty without `dve`.
        published: means over the held-out pictures; None when not requested.
        images: None without pictures.
        around: of cameras all around the flame; empty where the dataset has none.
        light: None where the dataset has no true light.
        flow: motion of pixels on held-out pictures; None without them, or without exact optical flow.
        costs: seconds by part.
    """

    SCHEMA: ClassVar[str] = "gof-scores"
    VERSION: ClassVar[int] = 1
    FORMER: ClassVar[dict[str, str]] = {"controls": "trivial_baselines"}  # of 0.2; goes with the next version

    gaussians: int
    dynamic_gaussians: int
    import_: Origin
    dataset: str | None = None
    flow_prior: bool | None = None
    warnings: tuple[str, ...] = ()
    dve: VelocityScore | None = None
    trivial_baselines: dict[str, TrivialScore] = field(default_factory=dict)
    published: PublishedFigures | None = None
    images: ImageScores | None = None
    around: tuple[AroundScore, ...] = ()
    light: LightScore | None = None
    flow: FlowScores | None = None
    costs: dict[str, float] = field(default_factory=dict)

    @property
    def controls(self) -> dict[str, TrivialScore]:
        """Return the trivial baselines by their old name, which goes with the next version."""
        warnings.warn("scores.controls is now scores.trivial_baselines", DeprecationWarning, stacklevel=2)
        return self.trivial_baselines

    @classmethod
    def read(cls, path: Path) -> Scores:
        """Read a scores.json.

        Raises:
            DataFormatError: absent, damaged, or of another version (says to evaluate again).
        """
        try:
            return read_record(cls, path)._with_paths(lambda name: os.path.normpath(path.parent / name))
        except DataFormatError as e:
            remedy = f"gof evaluate RESULT --dataset DATASET --json {path}"
            if path.name == "scores.json":
                remedy = f"gof evaluate RESULT --dataset DATASET --out {path.parent}"
            raise DataFormatError(f"{e}; to write it: {remedy}{' --overwrite' if path.exists() else ''}") from e

    def write(self, path: Path) -> None:
        """Write it, atomically; an older file is replaced. Paths in it count from its folder."""
        write_record(path, self._with_paths(lambda name: without_place(Path(name), path.parent)))

    def _with_paths(self, moved: Callable[[str], str]) -> Scores:
        """Return these scores with the path of every file that they name mapped."""
        origin = self.import_
        path, options = origin.path and moved(origin.path), origin.options
        if options is not None and options.world is not None:
            options = replace(options, world=moved(options.world))
        return replace(self, import_=replace(origin, path=path, options=options))


def velocity_of(scores: Sequence[Scores]) -> str | None:
    """Return whose velocity was scored; None where runs differ or none was.

    A result that says another velocity for the gas has that of its Gaussians as a trivial baseline.
    """
    scored = {"gas" if "light" in one.trivial_baselines else "light" for one in scores if one.dve is not None}
    return scored.pop() if len(scored) == 1 else None
