"""From three videos to transient flame Gaussians: motion -> voxels -> flow field -> seeds -> optimisation."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gof.host.callable_package import CallablePackage

if TYPE_CHECKING:
    from gof.dataset import Dataset
    from gof.reconstruct.settings import Until
    from gof.reconstruct.stages import Reconstruction


def reconstruct(
    dataset: Dataset | str | Path,
    out: str | Path,
    preset: str = "preview",
    *,
    steps: int | None = None,
    gaussians: int | None = None,
    voxels: int | None = None,
    max_size: int | None = None,
    until: Until = "result",
    flow_weights: Path | None = None,
    anyway: bool = False,
    overwrite: bool = False,
    **choices: Any,
) -> Reconstruction | None:
    """Reconstruct the flame of a dataset; a finished result in `out` is kept, an interrupted one resumed.

    Args:
        dataset: an opened dataset, or its folder.
        out: folder of the reconstruction.
        preset: how much work, see `gof.reconstruct.presets`; the next four replace one of its figures each.
        steps: of the optimisation, one training picture each.
        gaussians: in all frames together.
        voxels: along the longest side of the flame's box.
        max_size: px; pictures with a longer side are shrunk to it.
        until: the stage to stop after.
        flow_weights: folder of a MEMFOF checkpoint, for flow="memfof".
        anyway: go on where cameras, clocks, plates or memory look impossible.
        overwrite: replace a reconstruction in `out` that has other settings; other files there stay.
        choices: method, scene, flow, flow_prior, ablation, seed of `gof.reconstruct.settings.ReconstructionSettings`.
    Returns:
        The reconstruction: `.path` of result.npz, `.count` of Gaussians, costs of the stages and held-out scores; None
        when stopped before the result.
    Raises:
        GofError: an unknown preset, choice or stage, or see `gof.reconstruct.pipeline.reconstruct`.
        TypeError: a choice has an unknown name.
    """
    from gof.dataset import Dataset  # late: importing a room of this package stays cheap
    from gof.reconstruct.pipeline import reconstruct as run
    from gof.reconstruct.presets import effort_of, size_of
    from gof.reconstruct.settings import ReconstructionSettings, require_stage

    require_stage(until)
    opened = dataset if isinstance(dataset, Dataset) else Dataset.open(dataset)
    effort = effort_of(preset, steps, gaussians, voxels, max_size, clip=size_of(opened))
    settings = ReconstructionSettings.of(opened, effort, flow_weights, **choices)
    return run(opened, settings, Path(out), until, flow_weights, anyway, overwrite)


sys.modules[__name__].__class__ = CallablePackage
