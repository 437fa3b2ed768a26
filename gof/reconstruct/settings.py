"""`settings.json`: what a reconstruction is made with, so that a folder never mixes two."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from gof.core.errors import GofError
from gof.core.files import digest, stamp
from gof.core.records import claim
from gof.dataset import Dataset
from gof.reconstruct.ablations import Ablation
from gof.reconstruct.flow_prior import WEIGHTS
from gof.reconstruct.methods import METHODS, MethodName, SceneName
from gof.reconstruct.optical_flow import FlowName
from gof.reconstruct.presets import Effort

FILE = "settings.json"
Until = Literal["motion", "flow-field", "seeds", "result"]  # the stages that a reconstruction can stop after


@dataclass(frozen=True)
class ReconstructionSettings:
    """Settings that identify a reconstruction: only one with equal settings may be resumed.

    Attributes:
        dataset: which one, see `gof.dataset.Dataset.identity`.
        iterations, gaussians, voxels, longest_side: see `gof.reconstruct.presets.Effort`.
        method: see `gof.reconstruct.methods.METHODS`.
        scene: what the flame is drawn in, see `gof.reconstruct.surroundings`.
        flow: see `gof.reconstruct.optical_flow`.
        flow_prior: whether the fused flow is corrected (`gof.reconstruct.flow_prior`), where the method has it.
        flow_prior_weights: which weights correct it, as `gof.core.files.digest` of their file.
        ablation: the part that is left out, see `gof.reconstruct.ablations`.
        flow_weights: which checkpoint the flow "memfof" has, as `gof.core.files.stamp` of its folder.
        seed: of the seeding and of the order of pictures.

    Raises:
        GofError: the seed is negative, or the ablation and the scene do not go together.
    """

    SCHEMA: ClassVar[str] = "gof-reconstruction-settings"
    VERSION: ClassVar[int] = 7  # 7: the learning rates fall in every run; results of 6 had others

    dataset: str
    iterations: int
    gaussians: int
    voxels: int
    longest_side: int
    method: MethodName = "gof"
    scene: SceneName = "plates"
    flow: FlowName = "dis"
    flow_weights: str | None = None
    flow_prior: bool = True
    flow_prior_weights: str | None = None
    ablation: Ablation = "none"
    seed: int = 0

    def __post_init__(self):
        if self.seed < 0:
            raise GofError(f"--seed {self.seed}: must be 0 or more")
        if self.ablation == "joint-opt" and self.scene == "gaussians":
            raise GofError("--ablation joint-opt moves the plates' pixels; it goes with --scene plates")

    @classmethod
    def of(
        cls, dataset: Dataset, effort: Effort, flow_weights: Path | None = None, **choices: Any
    ) -> ReconstructionSettings:
        """Choose settings for a dataset by a preset's effort; `choices` are the fields that `Effort` does not have.

        Where they name no scene, it is the method's.
        """
        if choices.get("scene") is None:
            choices["scene"] = METHODS[choices.get("method", "gof")].scene
        weights = None if flow_weights is None else stamp(flow_weights, ("config.json", "model.safetensors"))
        prior = digest(WEIGHTS) if choices.get("flow_prior", True) else None
        return cls(dataset.identity(), **asdict(effort), flow_weights=weights, flow_prior_weights=prior, **choices)

    def claim(self, folder: Path) -> None:
        """Write them into a new reconstruction's folder, or make sure that the folder's are the same.

        Raises:
            GofError: it holds a reconstruction with other settings, or one of an older version.
        """
        claim(folder / FILE, self, folder / "result.npz")
