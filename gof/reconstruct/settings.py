"""`settings.json`: what a reconstruction is made with, so that a folder never mixes two."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

from gof.core.errors import GofError
from gof.core.files import digest, stamp
from gof.core.records import claim, is_replaced
from gof.dataset import Dataset
from gof.host.options import require_choice, require_choices, require_whole
from gof.reconstruct.ablations import Ablation
from gof.reconstruct.flow_prior import WEIGHTS
from gof.reconstruct.methods import METHODS, MethodName, SceneName
from gof.reconstruct.optical_flow import FlowName
from gof.reconstruct.presets import FLAGS, LEAST, Effort

FILE = "settings.json"
Until = Literal["motion", "flow-field", "seeds", "result"]  # the stages that a reconstruction can stop after


OPTIONS = FLAGS | {
    "method": "--method",
    "scene": "--scene",
    "flow": "--flow",
    "flow_weights": "--flow-weights",
    "flow_prior": "--no-flow-prior",
    "ablation": "--ablation",
    "seed": "--seed",
}


def require_stage(until: str) -> None:
    """Raise GofError: no stage of that name to stop after (names those that there are)."""
    require_choice("--until", until, get_args(Until))


def option_of(field: str) -> str:
    """Return the option of `gof reconstruct` that gives a field of the settings; the field's own name without one."""
    return OPTIONS.get(field, field)


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
        GofError: a choice that there is not (names those that there are), a number that is no whole one or too small,
            or an ablation and a scene that do not go together.
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
        require_choices(self, option_of)
        for name, least in (LEAST | {"seed": 0}).items():
            require_whole(option_of(name), getattr(self, name), least)
        if self.ablation == "joint-opt" and self.scene == "gaussians":
            raise GofError("--ablation joint-opt moves the plates' pixels; it goes with --scene plates")

    @classmethod
    def of(
        cls, dataset: Dataset, effort: Effort, flow_weights: Path | None = None, **choices: Any
    ) -> ReconstructionSettings:
        """Choose settings for a dataset by a preset's effort; `choices` are the fields that `Effort` does not have.

        Where they name no scene, it is the method's.
        """
        require_choice("--method", choices.get("method", "gof"), METHODS)
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
        claim(folder / FILE, self, folder / "result.npz", option_of)

    def is_replaced(self, folder: Path, overwrite: bool) -> bool:
        """Return whether the folder holds a reconstruction with other settings that is to be replaced.

        Raises:
            GofError: as `claim`, unless `overwrite` and a reconstruction of ours is there.
        """
        return is_replaced(folder / FILE, self, folder / "result.npz", overwrite, option_of)
