"""How much work a reconstruction does, the time it takes, and where ours and the paper's method part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gof.errors import GofError

PresetName = Literal["preview", "draft", "standard", "paper"]
MethodName = Literal["gof", "paper"]
SceneName = Literal["plates", "gaussians"]  # what the flame is drawn in, see `gof.reconstruct.surroundings`
LEAST = {"iterations": 1, "gaussians": 1, "voxels": 4, "longest_side": 16}


@dataclass(frozen=True)
class Effort:
    """Settings that trade quality for time.

    Attributes:
        iterations: optimisation steps.   gaussians: in all frames together.
        voxels: along the longest side of the flame's box.   longest_side: of the pictures, px; larger ones are shrunk.

    Raises:
        GofError: one of them is below its least.
    """

    iterations: int
    gaussians: int
    voxels: int
    longest_side: int

    def __post_init__(self):
        for name, least in LEAST.items():
            if getattr(self, name) < least:
                raise GofError(f"--{name.replace('_', '-')} {getattr(self, name)}: must be {least} or more")


PRESETS: dict[PresetName, Effort] = {
    "preview": Effort(2500, 60_000, 72, 320),
    "draft": Effort(10_000, 100_000, 72, 320),
    "standard": Effort(15_000, 120_000, 96, 640),
    "paper": Effort(30_000, 300_000, 128, 1280),  # the paper's steps and picture size; Gaussians and voxels are ours
}


STILL_STEPS = 1 / 3  # of the flame's: the paper's 10 000 and 30 000
NATIVE_SHARE = 0.53  # of a step's time that is left with the native kernels: the demo, 60 000 Gaussians, 180x320


def step_ms(gaussians: int, pixels: int, native: bool) -> float:
    """Expected ms of an optimisation step on two free CPU cores.

    Linear fit to four runs on a demo clip of 32 training frames (15 000 and 60 000 Gaussians; 90x160 and 180x320
    pixels), with Dr.Jit's kernels.

    Args:
        native: whether the renderer's native kernels run (`gof.render.backend.kernels`).
    """
    return (5.9 + 0.41e-3 * gaussians + 0.155e-3 * pixels) * (NATIVE_SHARE if native else 1)


@dataclass(frozen=True)
class Method:
    """The choices in which ours and the paper's method differ; what each is worth is in docs/reconstruction.md.

    Attributes:
        scene: what the flame is drawn in where nobody says otherwise.
        lit_plates: plates in the fire's light (`lit_plate`), not in the dark.
        round_flame: tomography starts from a round flame, not from the whole hull.
        fusion: both image components of every camera ("full"), or the paper's eq. 5-7.
        smooth_voxels: emission-weighted smoothing of the fused flow, std-dev in voxels; 0 = none.
        flow_prior: the fused flow is corrected to the gas' own velocity (`flow_prior`).
        seed_emission: seeds in proportion to a voxel's emission, not as many in every voxel of the hull.
        short_lives: t_sigma by how fast gas crosses the flame (`seeds.lifetime_s`), not four frame times.
        opacity: of a new Gaussian.
        velocity_rate: learning rate, voxels per frame time.
        plate_rate: learning rate of the plates, display values; 0 = they stay as they are.
    """

    scene: SceneName
    lit_plates: bool
    round_flame: bool
    fusion: str
    smooth_voxels: float
    flow_prior: bool
    seed_emission: bool
    short_lives: bool
    opacity: float
    velocity_rate: float
    plate_rate: float


METHODS: dict[MethodName, Method] = {
    "gof": Method(
        scene="plates",
        lit_plates=True,
        round_flame=True,
        fusion="full",
        smooth_voxels=3.0,
        flow_prior=True,
        seed_emission=True,
        short_lives=True,
        opacity=0.1,
        velocity_rate=0.0002,
        plate_rate=0.001,
    ),
    "paper": Method(
        scene="gaussians",
        lit_plates=False,
        round_flame=False,
        fusion="paper",
        smooth_voxels=0.0,
        flow_prior=False,
        seed_emission=False,
        short_lives=False,
        opacity=0.4,
        velocity_rate=0.00075,  # 1e-2 of the position's per ms at 400 Hz
        plate_rate=0.0,
    ),
}
