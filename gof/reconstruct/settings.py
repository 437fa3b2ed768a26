"""`settings.json`: what a reconstruction is made with, so that a folder never mixes two."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from gof.dataset import Dataset
from gof.errors import DataFormatError, GofError
from gof.reconstruct.ablations import Ablation
from gof.reconstruct.optical_flow import FlowName
from gof.reconstruct.presets import Effort, MethodName
from gof.records import read_record, write_record

FILE = "settings.json"
Until = Literal["motion", "flow-field", "seeds", "result"]  # the stages that a reconstruction can stop after


@dataclass(frozen=True)
class ReconstructionSettings:
    """What identifies a reconstruction: with equal settings it may be resumed, with others it is another one.

    Attributes:
        dataset: name of the dataset's folder.
        iterations, gaussians, voxels, longest_side: see `gof.reconstruct.presets.Effort`.
        method: see `gof.reconstruct.presets.METHODS`.
        flow: see `gof.reconstruct.optical_flow`.
        flow_prior: whether the fused flow is corrected (`gof.reconstruct.flow_prior`), where the method has it.
        ablation: the part that is left out, see `gof.reconstruct.ablations`.
        seed: of the seeding and of the order of pictures.
    """

    SCHEMA: ClassVar[str] = "gof-reconstruction-settings"
    VERSION: ClassVar[int] = 1

    dataset: str
    iterations: int
    gaussians: int
    voxels: int
    longest_side: int
    method: MethodName = "gof"
    flow: FlowName = "dis"
    flow_prior: bool = True
    ablation: Ablation = "none"
    seed: int = 0

    @classmethod
    def of(cls, dataset: Dataset, effort: Effort, **choices: Any) -> ReconstructionSettings:
        """Settings for a dataset with the effort of a preset; `choices` are the fields that `Effort` does not have."""
        return cls(dataset.path.resolve().name, **asdict(effort), **choices)

    def claim(self, folder: Path) -> None:
        """Write them into a new reconstruction's folder, or make sure that the folder's are the same.

        Raises:
            GofError: it holds a reconstruction with other settings, or one of an older version.
        """
        path = folder / FILE
        if not path.exists():
            write_record(path, self)
            return
        try:
            before = asdict(read_record(ReconstructionSettings, path))
        except DataFormatError as e:
            raise GofError(
                f"{e}; the reconstruction there was made by an older version: choose another --out or remove the folder"
            ) from e
        changed = sorted(name for name, value in asdict(self).items() if value != before[name])
        if changed:
            raise GofError(
                f"{folder} holds a reconstruction with other settings ({', '.join(changed)} differ); "
                "choose another --out or remove the folder"
            )
