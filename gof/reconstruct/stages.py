"""The stages of a reconstruction: what each reads, makes and leaves behind.

Every stage leaves pictures of what it did in OUT/stages and its cost in OUT/costs.json.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gof.core.cameras import in_words
from gof.core.costs import StageCost, StageLog
from gof.core.files import path_in
from gof.core.gaussians import TransientGaussians
from gof.core.time_left import TimeLeft
from gof.dataset import Dataset
from gof.dataset.leaks import FILE as MADE_FROM
from gof.dataset.leaks import MadeFrom
from gof.dataset.plates import save_plates
from gof.host.terminal import progress_bar
from gof.reconstruct import ablations, stage_images
from gof.reconstruct.background import BackgroundOptions, still_gaussians
from gof.reconstruct.captions import FILE as CAPTIONS
from gof.reconstruct.captions import Captions
from gof.reconstruct.checkpoint import Spent, read_spent
from gof.reconstruct.curve import FILE as CURVE
from gof.reconstruct.curve import Curve, CurveLog, CurvePoint
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.gas import look_up_gas
from gof.reconstruct.heldout import HeldOut
from gof.reconstruct.methods import Method, Rates, rates_in_voxels
from gof.reconstruct.observation import Observation, own_part
from gof.reconstruct.optical_flow import FlowMethod
from gof.reconstruct.optimize import Schedule, Units, optimize
from gof.reconstruct.presets import LIGHT_FINER, STILL_STEPS
from gof.reconstruct.run_inputs import flow_field_of, observation_of, uses_flow_prior
from gof.reconstruct.seeds import LIFETIME_FRAMES, lifetime_s, sample_seeds
from gof.reconstruct.settings import FILE as SETTINGS
from gof.reconstruct.settings import ReconstructionSettings
from gof.reconstruct.shrink import enlarge
from gof.reconstruct.surroundings import Plates, StillScene, Surroundings
from gof.reconstruct.unseen import UnseenViews, find_flame_emission, imagine_views
from gof.reconstruct.windows import Windows
from gof.render.backend import threads_for

FILES = (  # that a reconstruction writes into its folder, beside plates and stages; the last says whose folder it is
    "result.npz",
    "result.ply",
    "snapshot.npz",
    "checkpoint.npz",
    "seeds.npz",
    "background.npz",
    CURVE,
    "costs.json",
    MADE_FROM,
    SETTINGS,
)


@dataclass(frozen=True)
class ReconstructionRun:
    """Data that all stages share: the dataset at the size that is reconstructed, and where things go."""

    dataset: Dataset
    settings: ReconstructionSettings
    method: Method
    flow: FlowMethod
    out: Path
    log: StageLog
    left: TimeLeft

    @property
    def source(self) -> str:
        """Return the record of origin that the files get."""
        return f"gof reconstruct {self.dataset.description.name}"

    def own(self, pictures: Iterable[np.ndarray]) -> list[np.ndarray]:
        """Return the cameras' own parts of pictures of one size, one of each camera; of none, none."""
        return [own_part(picture, camera) for picture, camera in zip(pictures, self.dataset.cameras, strict=False)]


@dataclass(frozen=True)
class Reconstruction:
    """A finished reconstruction.

    Attributes:
        path: of result.npz; result.ply and plates/ lie beside it.
        count: of Gaussians.
        stages: what each cost.
        held_out: the scores of the result on held-out pictures.
    """

    path: Path
    count: int
    stages: tuple[StageCost, ...]
    held_out: CurvePoint

    @classmethod
    def find(cls, folder: Path) -> Reconstruction | None:
        """Return the finished reconstruction in a folder; None without one."""
        path = folder / "result.npz"
        if not (path.exists() and (folder / "result.ply").exists()):
            return None
        stages = StageLog(folder / "costs.json").stages()
        return cls(path, len(TransientGaussians.load(path)), stages, Curve.read(folder).points[-1])


# ---- Motion: what the cameras saw, and how it moves in their pictures ------------------------------------------------


def see_motion(run: ReconstructionRun) -> Observation:
    """Pictures, masks, plates and optical flow of the training frames, changed as the ablation wants."""
    with run.log.measure("motion") as figures, progress_bar("motion", left=run.left) as progress:
        observation = observation_of(run.dataset, run.settings, run.flow, progress)
        stage_images.save_observation(run.out / "stages", observation)
        figures.update(frames=len(observation.frames), cameras=len(observation.cameras))
    _say_what_from(run, observation)
    return observation


def _say_what_from(run: ReconstructionRun, observation: Observation) -> None:
    """Record the frames and the learned models that all later results are made from."""
    plates = [f"plates/{camera.name}.png" for camera in run.dataset.cameras]
    still = plates if run.settings.scene == "plates" else ["background.npz"]
    learned = ["flow_prior"] if uses_flow_prior(run.settings) else []
    MadeFrom.of(["seeds.npz", *still, "result.npz", "result.ply"], observation.frames, learned).write(run.out)


# ---- Still scene: what the flame burns in, where it is not a plate ---------------------------------------------------


def make_still_scene(run: ReconstructionRun, observation: Observation) -> TransientGaussians | None:
    """Make static Gaussians of the plates, in the fire's light where the method has it; None where plates are drawn."""
    settings = run.settings
    if settings.scene == "plates":
        return None
    made = run.out / "background.npz"
    if made.exists():
        return TransientGaussians.load(made)
    options = BackgroundOptions(still_steps(settings), max(settings.gaussians, 2), seed=settings.seed)
    still = still_gaussians(run.dataset, run.own(observation.plate), options, run.log)
    still.save(made, source=f"gof reconstruct {run.dataset.description.name}: the still scene")
    return still


def still_steps(settings: ReconstructionSettings) -> int:
    """Return the steps of the still scene, at least one."""
    return max(round(STILL_STEPS * settings.iterations), 1)


# ---- Flow field: where the flame is in space, and how fast it moves there --------------------------------------------


def make_flow_field(run: ReconstructionRun, observation: Observation) -> FlowField:
    """Return the flame's voxels in every frame and their velocities, corrected by the flow prior where it is used."""
    with run.log.measure("flow_field") as figures, progress_bar("flow field", left=run.left) as progress:
        field = flow_field_of(run.dataset, run.settings, observation, progress)
        stage_images.save_flow_field(run.out / "stages", field)
        voxels = field.voxels
        figures.update(
            voxels=len(voxels.center), voxel_size_m=round(voxels.voxel_size, 5), resolution=voxels.resolution.tolist()
        )
    return field


# ---- Seeds: the Gaussians that the optimisation starts from ----------------------------------------------------------


class LightUse(NamedTuple):
    """The uses of a flame's light in space, without the light itself, which is large; both None where none is found.

    Attributes:
        chances: (F, V) of the flow field's voxels, by which Gaussians start there.
        unseen: how the flame looks from all around; None where it is dark.
    """

    chances: np.ndarray | None
    unseen: UnseenViews | None


def find_light(run: ReconstructionRun, observation: Observation, field: FlowField) -> LightUse:
    """Find the flame's light in space, where the method uses it; on finer voxels than the flow field's."""
    if run.method.unseen <= 0:
        return LightUse(None, None)
    with run.log.measure("light") as figures, progress_bar("light", left=run.left) as progress:
        light = find_flame_emission(observation, round(LIGHT_FINER * run.settings.voxels), progress)
        figures.update(voxels=len(light.voxels.center), voxel_size_m=round(light.voxels.voxel_size, 5))
        return LightUse(light.pool(field.voxels), imagine_views(light, observation))


def make_seeds(
    run: ReconstructionRun,
    observation: Observation,
    still: TransientGaussians | None,
    field: FlowField,
    light: LightUse,
    held_out: HeldOut,
) -> TransientGaussians:
    """Return the Gaussians that the optimisation starts from; kept in OUT/seeds.npz. light: see `find_light`."""
    settings, method, dt = run.settings, run.method, run.dataset.frame_time_s
    rng = np.random.default_rng(settings.seed)
    with run.log.measure("seeds") as figures:
        t_sigma = lifetime_s(field, dt) if method.seeding.short_lives else LIFETIME_FRAMES[1] * dt
        seeds = sample_seeds(field, method.seeding, t_sigma, settings.gaussians, rng, light.chances)
        seeds = ablations.change_seeds(settings.ablation, seeds, rng).measured_from(run.dataset.datum)
        seeds.save(run.out / "seeds.npz", source="gof reconstruct: seeds before optimisation")
        figures.update(gaussians=len(seeds), t_sigma_s=round(t_sigma, 5))
    shown = (
        (seeds, run.own(observation.plate)) if still is None else (TransientGaussians.concatenate([still, seeds]), [])
    )
    _show(run, held_out, "4_seeds", "the seeds before any optimisation", *shown)
    return seeds


# ---- Fit -------------------------------------------------------------------------------------------------------------


def fit(
    run: ReconstructionRun,
    observation: Observation,
    still: TransientGaussians | None,
    field: FlowField,
    light: LightUse,
    seeds: TransientGaussians,
    held_out: HeldOut,
) -> tuple[TransientGaussians, list[np.ndarray], Curve]:
    """Fit the pictures, from the last checkpoint if there is one.

    Args:
        light: see `find_light`; without, no view but the given ones holds the Gaussians.
    Returns:
        Gaussians and plates as `gof.reconstruct.surroundings.Surroundings.result`, and the curve of held-out scores.
    """
    settings, method, dt = run.settings, run.method, run.dataset.frame_time_s
    schedule = _make_schedule(
        settings, method, rates_in_voxels(method.rates, observation.cameras, field.voxels.voxel_size)
    )
    believed_s = ablations.change_times(settings.ablation, observation.camera_time_s, dt)
    observation = replace(observation, camera_time_s=believed_s)
    units = Units(field.voxels.voxel_size, dt)
    cameras = observation.cameras
    windows = Windows.around(field.voxels, cameras) if method.windows else Windows.whole(cameras)
    surroundings: Surroundings = (
        _cut_plates(windows, observation, move=schedule.rates.plate > 0, emissive=method.color_of_light)
        if still is None
        else StillScene(still, windows.cameras(cameras), field.voxels)
    )
    checkpoint = _checkpoint(run)
    spent = read_spent(checkpoint)
    curve = CurveLog(run.out, resumed_s=spent.fitting_s if spent else None)
    before_s = spent.stage_s if spent else 0.0
    with (
        run.log.measure(
            "optimize",
            before_s,
            iterations=settings.iterations,
            gaussians=len(seeds),
            window_px=[windows.width, windows.height],
        ),
        progress_bar("optimise", left=run.left) as progress,
        threads_for(windows.width * windows.height),
    ):

        def whole(parts: list[np.ndarray]) -> list[np.ndarray]:
            own = run.own(windows.plates(parts, observation.plate, observation.blocked))
            # Where nothing stands before the flame, but beyond a smaller picture's edge, a plate needs no such channel.
            return [plate if plate[..., 3:].any() else plate[..., :3] for plate in own]

        monitor = _Monitor(_snapshot(run), held_out, whole, curve, progress, time.perf_counter() - before_s)
        gaussians, plates = optimize(
            seeds, observation, windows, surroundings, schedule, units, checkpoint, monitor, light.unseen
        )
    if method.gas_apart:
        gaussians = ablations.change_gas(settings.ablation, gaussians, look_up_gas(gaussians, field))
    return gaussians, whole(plates), curve.curve


def _make_schedule(settings: ReconstructionSettings, method: Method, rates: Rates) -> Schedule:
    """Return the optimisation's steps, as the method and the ablation want them."""
    schedule = Schedule(
        settings.iterations,
        rates,
        method.gas_apart,
        method.density_control,
        method.color_of_light,
        method.square_loss,
        unseen=method.unseen,
        seed=settings.seed,
    )
    return ablations.change_schedule(settings.ablation, schedule)


def _cut_plates(windows: Windows, observation: Observation, *, move: bool, emissive: bool) -> Plates:
    """Return the plates, and what is blocked before them, in the windows."""
    plates, blocked = (
        np.stack([windows.cut(c, picture) for c, picture in enumerate(pictures)])
        for pictures in (observation.plate, observation.blocked)
    )
    return Plates(windows.cameras(observation.cameras), plates, blocked, move=move, emissive=emissive)


@dataclass(frozen=True)
class _Monitor:
    """Along the optimisation: its progress, a snapshot for `gof view`, and the curve of held-out scores."""

    snapshot: Path
    held_out: HeldOut
    whole: Callable[[list[np.ndarray]], list[np.ndarray]]  # plates of the pictures from those of their windows
    curve: CurveLog
    progress: Callable[..., None]
    start: float  # of the stage, by the clock

    def spent(self) -> Spent:
        return Spent(time.perf_counter() - self.start, self.curve.seconds)

    def evaluate(self, step: int, gaussians: TransientGaussians, plates: list[np.ndarray]) -> str | None:
        gaussians.save(self.snapshot, source=f"gof reconstruct, step {step}")
        point = self.curve.add(step, partial(self.held_out.score, gaussians, self.whole(plates)))
        scores = point.scores
        if scores.psnr_flame is None:
            return None
        return f"held-out flame {scores.psnr_flame:.2f} dB at {in_words(scores.sizes_px)}"


# ---- Save ------------------------------------------------------------------------------------------------------------


def save(
    run: ReconstructionRun, gaussians: TransientGaussians, plates: list[np.ndarray], curve: Curve, held_out: HeldOut
) -> Reconstruction:
    """Write the result and the plates that it is drawn over; remove what was only on the way."""
    _show(run, held_out, "5_result", "the result", gaussians, plates)
    save_plates(run.out, [camera.name for camera in run.dataset.cameras if plates], plates)
    gaussians = enlarge(gaussians, run.dataset)
    gaussians.save(run.out / "result.ply", source=run.source)
    path = gaussians.save(run.out / "result.npz", source=run.source)
    _checkpoint(run).unlink(missing_ok=True)
    _snapshot(run).unlink(missing_ok=True)
    return Reconstruction(path, len(gaussians), run.log.stages(), curve.points[-1])


def remove_made(out: Path) -> None:
    """Remove the files that a reconstruction has written into a folder, by the names that it wrote down; no other."""
    made = MadeFrom.read(out)
    plates = [name for name in (made.files if made else ()) if name.startswith("plates/")]
    pictures = [f"stages/{image.file}" for image in Captions.read(out / "stages").images]
    for name in (*pictures, f"stages/{CAPTIONS}", *plates, *FILES):
        path_in(out, name).unlink(missing_ok=True)
    for folder in (out / "plates", out / "stages"):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _checkpoint(run: ReconstructionRun) -> Path:
    return run.out / "checkpoint.npz"


def _snapshot(run: ReconstructionRun) -> Path:
    return run.out / "snapshot.npz"


def _show(
    run: ReconstructionRun,
    held_out: HeldOut,
    name: str,
    caption: str,
    gaussians: TransientGaussians,
    plates: list[np.ndarray],
) -> None:
    """Save a held-out frame beside what the Gaussians make of it, where there is one."""
    image = held_out.side_by_side(gaussians, plates)
    if image is not None:
        stage_images.save_image(run.out / "stages", name, f"A held-out frame, above {caption}", image)
