"""The input of a reconstruction before any Gaussian: computed in a run, and again later to show it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gof.core.errors import GofError
from gof.core.records import read_record
from gof.dataset import Dataset
from gof.dataset.leaks import require_no_leaks
from gof.reconstruct import ablations
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import VOXELS, FlowPrior
from gof.reconstruct.gas import with_gas_of
from gof.reconstruct.methods import METHODS
from gof.reconstruct.observation import Observation, observe
from gof.reconstruct.optical_flow import FlowMethod, flow_method
from gof.reconstruct.settings import FILE, ReconstructionSettings
from gof.reconstruct.shrink import shrink

Progress = Callable[..., None]  # progress(done, total)


@dataclass(frozen=True)
class RunInputs:
    """The input of a run: the dataset at the size that was reconstructed, its observation and its flow field."""

    dataset: Dataset
    observation: Observation
    field: FlowField


def observation_of(
    dataset: Dataset, settings: ReconstructionSettings, flow: FlowMethod, progress: Progress | None = None
) -> Observation:
    """Pictures, masks, plates and optical flow of the training frames, changed as the ablation wants.

    Args:
        dataset: at the size that is reconstructed.
    """
    observation = observe(dataset, METHODS[settings.method], flow, progress=progress)
    return ablations.change_plates(settings.ablation, observation)


def flow_field_of(
    dataset: Dataset, settings: ReconstructionSettings, observation: Observation, progress: Progress | None = None
) -> FlowField:
    """Return the flame's voxels in every frame and their velocities, corrected by the flow prior where it is used.

    The prior works on the voxels that it was trained on, whatever `settings.voxels` are: on finer ones its gas is
    too slow, and on coarser ones it is hardly better than the mean of every height (notebook/accuracy.md).
    """
    method, learned = METHODS[settings.method], uses_flow_prior(settings)
    twice = learned and settings.voxels != VOXELS

    def say(before: int, done: int, frames: int) -> None:
        if progress:
            progress(before * frames + done, (1 + twice) * frames)

    if not learned:
        return seen_flow_field(observation, method, settings.voxels, partial(say, 0))
    asked = seen_flow_field(observation, method, VOXELS, partial(say, 0))
    gas = FlowPrior.load().correct(asked, metres=dataset.description.in_metres)
    return with_gas_of(seen_flow_field(observation, method, settings.voxels, partial(say, 1)), gas) if twice else gas


def uses_flow_prior(settings: ReconstructionSettings) -> bool:
    """Return whether what was learned from other fires has a part in the velocities."""
    return settings.flow_prior and METHODS[settings.method].flow_prior


def recompute_inputs(
    dataset: Dataset, folder: Path, flow_weights: Path | None = None, progress: Progress | None = None
) -> RunInputs:
    """Compute the input of the reconstruction in a folder again, by its own settings. Nothing is written.

    Args:
        dataset: as it was opened, at full size.
        flow_weights: folder of the MEMFOF checkpoint, where the run's flow was "memfof".
        progress: progress(done, total, stage=name).
    Raises:
        GofError: no reconstruction is there, it is of another dataset, or see `observe` and `seen_flow_field`.
    """
    if not (folder / FILE).is_file():
        raise GofError(f"{folder}: no {FILE}; name the folder of a `gof reconstruct`, finished or not")
    settings = read_record(ReconstructionSettings, folder / FILE)
    if settings.dataset != dataset.identity():
        raise GofError(
            f"{folder}: was made of the dataset '{settings.dataset}', and {dataset.path} is '{dataset.identity()}'"
        )
    require_no_leaks(dataset)
    small, flow = shrink(dataset, settings.longest_side), flow_method(settings.flow, flow_weights)
    say = progress or (lambda *done, **stage: None)
    observation = observation_of(small, settings, flow, lambda done, of: say(done, of, stage="motion"))
    field = flow_field_of(small, settings, observation, lambda done, of: say(done, of, stage="flow field"))
    return RunInputs(small, observation, field)
