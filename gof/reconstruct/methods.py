"""Ours and the paper's method: every choice in which they part, side by side.

The paper's come from its text, and where that is silent from the constants of its authors' published code
(github.com/jna-358/gaussians_on_fire, `eccv-demo`), named "authors". Not among them, because it is not here at all: one
exposure per camera (authors). Plates are made before (`gof ingest --plates minimum` is the paper's), and what draws the
optical flow is `--flow` (the paper's is memfof).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gof.core.cameras import Camera
from gof.core.harmonics import C0

MethodName = Literal["gof", "paper"]
SceneName = Literal["plates", "gaussians"]  # what the flame is drawn in, see `gof.reconstruct.surroundings`

LAST_SHARE = 0.1  # of a rate, at the last step
LONGEST_HELD = 2500  # steps; what `held` says of longer runs
FRAME_MS = 2.5  # of the paper's captures, at 400 Hz; the authors' rates are per ms, ours per frame time


@dataclass(frozen=True)
class Seeding:
    """The Gaussians that the optimisation starts from.

    Attributes:
        by_emission: in proportion to a voxel's light, drawn together as for the unseen views; else half of the voxels
            of every frame, one in each, or as large a part as there are Gaussians.
        short_lives: t_sigma by how fast gas crosses the flame (`seeds.lifetime_s`); else four frame times.
        opacity: of a new Gaussian.   scale: its standard deviation, voxels.
        seen_color: the colour that the cameras see there; else middle grey.
    """

    by_emission: bool
    short_lives: bool
    opacity: float
    scale: float
    seen_color: bool


@dataclass(frozen=True)
class Rates:
    """Learning rates of Adam. Times are in frame times, so that a scene's clock does not matter.

    Attributes:
        lengths: what `position` and `velocity` are counted in, so that a scene's size does not matter either: voxels,
            or the cameras' extent (`cameras_extent`).
        position: at the first and the last step, exponential between.   velocity: per frame time.
        color, plate: display values; a plate's is 0 where plates do not change.
        t_mu, log_t_sigma, scale, rotation, opacity: of the raw parameters (`gof.reconstruct.parameters`).
        beta_1, beta_2: how slowly Adam forgets gradients, and their size. Those of a Gaussian are of another picture
            each time, and hardly hold for the next.
        held: the share of a run after which a Gaussian's other rates fall, too, exponentially to `LAST_SHARE` at the
            last step, at most `LONGEST_HELD` steps: Gaussians that are pushed to and fro by one picture after the other
            come to rest, and a long run learns the training frames ever better and the ones between them worse. None:
            never.
    """

    lengths: Literal["voxels", "extent"]
    position: tuple[float, float]
    velocity: float
    t_mu: float
    log_t_sigma: float
    scale: float
    rotation: float
    opacity: float
    color: float
    plate: float
    beta_1: float
    beta_2: float
    held: float | None


@dataclass(frozen=True)
class Method:
    """The choices in which ours and the paper's method differ; what each is worth is in notebook/choices.md.

    Attributes:
        scene: the default scene behind the flame.
        lit_plates: plates in the fire's light (`lit_plate`), not in the dark.
        faint_flame: flame as faint as what the fire throws on its surroundings is found, too, above `lit_plates`.
        flow_of_light: optical flow of the light above the plates, to both neighbouring frames and back again, without
            what does not come back; else of the pictures, to the next frame.
        flow_masks: flame is where the optical flow is; else where red rises above the plate (`flame_mask`).
        vetoes: no voxel stands where a camera that has it in view never sees flame; else two cameras are enough.
        round_flame: tomography starts from a round flame, not from the whole hull.
        fusion: both image components of every camera ("full"), or the paper's eq. 5-7.
        smooth_voxels: emission-weighted smoothing of the fused flow, std-dev in voxels; 0 = none.
        flow_prior: the fused flow is corrected to the gas' own velocity (`flow_prior`).
        gas_apart: a Gaussian has two velocities: its light's, which is free to fit the pictures, and the gas', which is
            what the fused flow says of the place where it ends (`gas`); else one for both, which the pictures move.
        windows: only the part of a picture in which the flame can be is drawn and learned from (`windows`); else all.
        density_control: Gaussians are cloned, split and pruned along the way (`density`).
        color_of_light: the brightest channel of a flame Gaussian is 1 (`parameters`), and its light is added to the
            plate behind it (`TransientGaussians.emissive`); else colours are free, and display values blended.
        square_loss: weight of the mean squared difference beside 0.8 L1 + 0.2 (1 - SSIM): large errors count more.
        unseen: weight of views from where no camera stood, as tomography has them (`unseen`), in every second step;
            0 = none.
    """

    scene: SceneName
    lit_plates: bool
    faint_flame: bool
    flow_of_light: bool
    flow_masks: bool
    vetoes: bool
    round_flame: bool
    fusion: str
    smooth_voxels: float
    flow_prior: bool
    gas_apart: bool
    windows: bool
    density_control: bool
    color_of_light: bool
    square_loss: float
    unseen: float
    seeding: Seeding
    rates: Rates


OURS = Method(
    scene="plates",
    lit_plates=True,
    faint_flame=True,
    flow_of_light=True,
    flow_masks=False,
    vetoes=True,
    round_flame=True,
    fusion="full",
    smooth_voxels=3.0,
    flow_prior=True,
    gas_apart=True,
    windows=True,
    density_control=False,  # tried, not kept
    color_of_light=True,
    square_loss=16.0,
    unseen=2.0,
    seeding=Seeding(by_emission=True, short_lives=True, opacity=0.1, scale=0.7, seen_color=True),
    rates=Rates(
        lengths="voxels",
        position=(0.075, 0.0075),
        velocity=0.01,
        t_mu=0.025,
        log_t_sigma=0.0125,
        scale=0.12,
        rotation=0.03,
        opacity=0.075,
        color=0.025,
        plate=0.0025,
        beta_1=0.6,
        beta_2=0.99,
        held=0.7,
    ),
)

PAPER_POSITION = 1.6e-4, 1.6e-6  # 3DGS, of the cameras' extent

PAPER = Method(
    scene="gaussians",  # "Dynamic Scene": static and flame Gaussians in one pass
    lit_plates=False,
    faint_flame=False,
    flow_of_light=False,  # "Dynamic Scene": the flow between consecutive frames
    flow_masks=True,  # authors: above 0.5 px per frame, dilated twice by 5x5
    vetoes=False,  # authors: at least two cameras
    round_flame=False,
    fusion="paper",  # eq. 4 to 7
    smooth_voxels=0.0,
    flow_prior=False,
    gas_apart=False,  # "Dynamic Scene": a velocity each
    windows=False,  # its density control counts on the mean over whole pictures
    density_control=True,  # "densification was left as in the original implementation"
    color_of_light=False,  # 3DGS' coefficients
    square_loss=0.0,
    unseen=0.0,
    seeding=Seeding(
        by_emission=False,  # authors: half of a frame's voxels
        short_lives=False,  # "four times the frame time"
        opacity=0.4,  # authors
        scale=0.25,  # authors
        seen_color=False,  # authors: random within 1/255 of a coefficient, which is middle grey
    ),
    rates=Rates(
        lengths="extent",
        position=PAPER_POSITION,
        velocity=1e-2 * PAPER_POSITION[0] * FRAME_MS,  # "Implementation Details": 1e-2 of the position's, per ms
        t_mu=0.01 / FRAME_MS,  # authors: ms
        log_t_sigma=0.01 / (4 * FRAME_MS),  # authors: ms, of a lifetime of four frames
        scale=0.005,  # 3DGS
        rotation=0.001,  # 3DGS
        opacity=0.025,  # 3DGS
        color=0.0025 * C0,  # 3DGS, of its constant colour coefficient
        plate=0.0,
        beta_1=0.9,
        beta_2=0.999,  # Adam's own, both
        held=None,
    ),
)

METHODS: dict[MethodName, Method] = {"gof": OURS, "paper": PAPER}


def cameras_extent(cameras: Sequence[Camera]) -> float:
    """3DGS' size of a scene, m: 1.1 of the cameras' largest distance from their middle."""
    places = np.stack([camera.position for camera in cameras])
    return float(1.1 * np.linalg.norm(places - places.mean(0), axis=1).max())


def rates_in_voxels(rates: Rates, cameras: Sequence[Camera], voxel_size: float) -> Rates:
    """Return the same rates with their lengths in voxels; voxel_size in m, > 0."""
    if rates.lengths == "voxels":
        return rates
    extent = cameras_extent(cameras) / voxel_size
    first, last = rates.position
    return replace(rates, lengths="voxels", position=(first * extent, last * extent), velocity=rates.velocity * extent)
