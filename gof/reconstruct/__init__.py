"""From three videos to transient flame Gaussians: motion -> voxels -> flow field -> seeds -> optimisation."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gof.core.errors import GofError
from gof.host.callable_package import CallablePackage

if TYPE_CHECKING:
    from gof.dataset import Dataset
    from gof.reconstruct.presets import PresetName
    from gof.reconstruct.settings import Until
    from gof.reconstruct.stages import Reconstruction


def reconstruct(
    dataset: Dataset | str | Path,
    out: str | Path,
    preset: PresetName = "preview",
    *,
    until: Until = "result",
    flow_weights: Path | None = None,
    anyway: bool = False,
    **choices: Any,
) -> Reconstruction | None:
    """Reconstruct the flame of a dataset; a finished result in `out` is kept, an interrupted one resumed.

    Args:
        dataset: an opened dataset, or its folder.
        out: folder of the reconstruction.
        preset: how much work, see `gof.reconstruct.presets.PRESETS`.
        until: the stage to stop after.
        flow_weights: folder of a MEMFOF checkpoint, for flow="memfof".
        anyway: go on where cameras, clocks, plates or memory look impossible.
        choices: a figure of the preset to replace (`gof.reconstruct.presets.Effort`), or a field of
            `gof.reconstruct.settings.ReconstructionSettings`: method, scene, flow, flow_prior, ablation, seed.
    Returns:
        The reconstruction: `.path` of result.npz, `.count` of Gaussians, costs of the stages and held-out scores; None
        when stopped before the result.
    Raises:
        GofError: see `gof.reconstruct.pipeline.reconstruct`.
        TypeError: a choice has an unknown name.
    """
    from gof.dataset import Dataset  # late: importing a room of this package stays cheap
    from gof.reconstruct.pipeline import reconstruct as run
    from gof.reconstruct.presets import PRESETS, Effort
    from gof.reconstruct.settings import ReconstructionSettings

    if not isinstance(dataset, Dataset):
        dataset = Dataset.open(dataset)
    if preset not in PRESETS:
        raise GofError(f"there is no preset '{preset}'; there are {', '.join(PRESETS)}")
    own = {field.name: choices.pop(field.name) for field in fields(Effort) if field.name in choices}
    effort = replace(PRESETS[preset], **own)
    settings = ReconstructionSettings.of(dataset, effort, flow_weights, **choices)
    return run(dataset, settings, Path(out), until, flow_weights, anyway)


sys.modules[__name__].__class__ = CallablePackage
