"""The cost of a reconstruction by the shape of its clip and its settings alone: time of its parts, and memory."""

from __future__ import annotations

from dataclasses import dataclass

from gof.dataset import Dataset
from gof.reconstruct import memory, sanity, stages
from gof.reconstruct.batches import expect_together
from gof.reconstruct.density import MOST_GROWTH
from gof.reconstruct.flow_prior import VOXELS
from gof.reconstruct.methods import METHODS, Method
from gof.reconstruct.presets import REST_S, seeing_s, step_ms
from gof.reconstruct.run_inputs import uses_flow_prior
from gof.reconstruct.settings import ReconstructionSettings
from gof.render.backend import kernels


@dataclass(frozen=True)
class ClipShape:
    """The properties of a dataset that the cost of its reconstruction depends on, at the size that is reconstructed.

    Attributes:
        frames: for training.
        pictures_px: pixels of a picture of each camera.
        window: share of a picture that is drawn and learned from (`gof.reconstruct.windows`), 0..1.
    """

    frames: int
    pictures_px: tuple[int, ...]
    window: float = 1.0

    @classmethod
    def of(cls, dataset: Dataset, method: Method) -> ClipShape:
        """Read it; looks at a few pictures where the method has windows."""
        pictures_px = tuple(camera.width * camera.height for camera in dataset.cameras)
        return cls(len(dataset.train_frames), pictures_px, sanity.window_share(dataset) if method.windows else 1.0)

    @property
    def training_px(self) -> int:
        """Return the pixels of all training pictures together."""
        return self.frames * sum(self.pictures_px)


def expected_parts(clip: ClipShape, settings: ReconstructionSettings) -> dict[str, float]:
    """Return seconds on the machine of `gof.core.time_left` for each part of a reconstruction, by its bar's title."""
    method = METHODS[settings.method]
    steps = {"optimise": settings.iterations}
    if settings.scene == "gaussians":  # the still scene has its own steps
        steps = {"background": stages.still_steps(settings)} | steps
    pixels, native = round(clip.window * clip.pictures_px[0]), kernels().name == "native"
    alone = method.density_control
    together = 1 if alone else expect_together(clip.frames, pixels)
    each_ms = step_ms(settings.gaussians, clip.frames, pixels, native, alone, method.unseen > 0, together)
    seeing = seeing_s(clip.frames, clip.training_px, _most_voxels(settings))
    return seeing | {part: count * each_ms / 1e3 for part, count in steps.items()} | {"rest": REST_S}


def expected_bytes(clip: ClipShape, settings: ReconstructionSettings) -> float:
    """Return the peak memory of a reconstruction."""
    gaussians = settings.gaussians * (2 if settings.scene == "gaussians" else 1)  # the still scene has as many again
    if METHODS[settings.method].density_control:
        gaussians += (MOST_GROWTH - 1) * settings.gaussians
    return memory.needed_bytes(clip.training_px, clip.frames, gaussians, _most_voxels(settings))


def _most_voxels(settings: ReconstructionSettings) -> int:
    """Return voxels along the flame's longest side, of the finest grid that is made."""
    return max(settings.voxels, VOXELS) if uses_flow_prior(settings) else settings.voxels
