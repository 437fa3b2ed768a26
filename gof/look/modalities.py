"""All that a method sees and makes of one picture, from the user's own data (the paper's figure of modalities)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.files import path_in
from gof.core.gaussians import TransientGaussians
from gof.core.npz import read_npy
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.depth import read_depth
from gof.evaluate.screen_motion import ScreenVelocity, sideways_velocity
from gof.ingest.depth import align, from_relative, monocular
from gof.ingest.stereo import stereo_depth
from gof.look.animation import original
from gof.look.tiles import Tile, depth_tile, dimmed, picture_tile, velocity_tile
from gof.look.velocity import fastest, of_result, true_there, unit
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.observation import own_part
from gof.reconstruct.run_inputs import RunInputs
from gof.render import render

SHRUNK = 0.3  # of the Gaussians' size in the tile of seeds: each is seen by itself
VOXEL_SIZE = 0.6  # standard deviation of a voxel that is drawn as a Gaussian, voxels: neighbours run together
DENSEST = 0.6  # opacity of the brightest voxels
SOLID = 0.3  # alpha from which a result's depth is shown
FLOW_FIELD = "fused flow field"


@dataclass
class Modalities:
    """The tiles in their order, and why others are missing: name -> reason."""

    tiles: list[Tile] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Sources:
    """Files that some tiles are of.

    Attributes:
        run: folder of the reconstruction.
        depth_weights: folder of a Depth-Anything-V2 checkpoint, for monocular depth; None without one.
        depth: folder of `gof depth`, for the depth of this very frame; None without one.
    """

    run: Path
    depth_weights: Path | None = None
    depth: Path | None = None


def training_frame(dataset: Dataset, camera: int, time_s: float | None) -> int:
    """Return the training frame nearest to a time, by default the one with most light above the plate.

    Held-out frames have neither flow nor a flow field: a method must not look at them.
    """
    frames = dataset.train_frames
    if not frames:
        raise GofError(f"{dataset.path}: splits.train is empty; nothing was reconstructed from it")
    if time_s is None:
        static = dataset.static(camera)
        return max(frames, key=lambda k: float(np.maximum(dataset.image(camera, k) - static, 0).mean()))
    return min(frames, key=lambda k: abs(float(dataset.camera_times_s(camera)[k]) - time_s))


def modalities(dataset: Dataset, inputs: RunInputs, sources: Sources, camera: int, frame: int) -> Modalities:
    """Return the tiles of one camera and one training frame.

    Args:
        dataset: at full size.   inputs: what the run in `sources.run` saw of it.
        camera, frame: numbers.
    """
    view, out = _FrameTiles(dataset, inputs, sources, camera, frame), Modalities()
    seeds, result = (view.gaussians(name, out) for name in ("seeds", "result"))
    depths = view.depths(result, out)
    velocities = view.velocities(result)
    out.tiles = [
        *view.pictures(),
        *depths,
        view.optical_flow(),
        velocities.pop(FLOW_FIELD),
        *([] if seeds is None else [view.seeds(seeds)]),
        *([] if result is None else [view.result(result)]),
        *velocities.values(),
    ]
    return out


class _FrameTiles:
    """One camera at one training frame."""

    def __init__(self, dataset: Dataset, inputs: RunInputs, sources: Sources, number: int, frame: int):
        self.dataset, self.inputs, self.sources, self.number, self.frame = dataset, inputs, sources, number, frame
        self.camera: Camera = dataset.cameras[number]
        self.small: Camera = inputs.dataset.cameras[number]
        self.time_s = float(dataset.camera_times_s(number)[frame])
        self.f = int(np.flatnonzero(inputs.observation.frames == frame)[0])
        self.length = "m" if dataset.description.in_metres else "units"

    def pictures(self) -> list[Tile]:
        """Show what was filmed, what is behind the fire, and where the fire is."""
        image, plate = self.dataset.image(self.number, self.frame), self.dataset.static(self.number)
        mask = own_part(self.inputs.observation.mask[self.f, self.number], self.small)
        small = self.inputs.dataset.image(self.number, self.frame)
        shown = replace(picture_tile(dimmed(small, 0.3 + 0.7 * mask), "flame mask"), outline=mask)
        return [picture_tile(image, f"picture ({original(self.dataset)})"), picture_tile(plate, "background"), shown]

    def depths(self, result: TransientGaussians | None, out: Modalities) -> list[Tile]:
        """Show depth of the plates by stereo and a network, of this frame, and of the result, where there is any."""
        stereo = self._stereo()
        sources = {
            "stereo depth": stereo,
            "monocular depth": self._monocular(stereo),
            "depth, background": self._ingested(),
            "depth, this frame": self._of_frame(),
        }
        out.missing |= {name: why for name, why in sources.items() if isinstance(why, str)}
        found = {name: values for name, values in sources.items() if not isinstance(values, str)}
        if result is not None:
            found["depth, result"] = self._drawn_depth(result)
        known = [values[np.isfinite(values) & (values > 0)] for values in found.values()]
        if not sum(map(len, known)):
            return []
        near, far = np.percentile(np.concatenate(known), [2, 98])
        near, far = float(near), float(max(far, 1.001 * near))
        return [depth_tile(values, name, near, far, self.length, _share(values)) for name, values in found.items()]

    def _drawn_depth(self, result: TransientGaussians) -> np.ndarray:
        """Return (H, W), NaN where hardly anything is drawn; a flame's is that of its middle, and no surface."""
        drawn = render(result, self.camera, self.time_s)
        return np.where(drawn["alpha"] > SOLID, drawn["depth"], np.nan)

    def _stereo(self) -> np.ndarray | str:
        """Return (H, W) m of the plate, NaN where no second view confirms it; or why there is none, as of all these
        maps."""
        if len(self.dataset.cameras) < 2:
            return "one camera has no stereo"
        plates = [np.rint(255 * self.dataset.static(c)).astype(np.uint8) for c in range(len(self.dataset.cameras))]
        depth = stereo_depth(plates, self.dataset.cameras, self.dataset.sparse_points())[self.number]
        return depth if np.isfinite(depth).any() else "no second view confirms any"

    def _monocular(self, stereo: np.ndarray | str) -> np.ndarray | str:
        if self.sources.depth_weights is None:
            return "no network's weights were named (--depth)"
        if isinstance(stereo, str):
            return f"its scale comes from stereo depth, and {stereo}"
        plate = np.rint(255 * self.dataset.static(self.number)).astype(np.uint8)
        relative = monocular(plate, self.sources.depth_weights)
        return from_relative(relative, *align(relative, stereo), farthest=2 * float(np.nanmax(stereo)))

    def _ingested(self) -> np.ndarray | str:
        path = path_in(self.dataset.path, f"depth/{self.camera.name}.npy")
        return read_npy(path) if path.is_file() else "the dataset has no depth maps (gof depth DATASET --plates)"

    def _of_frame(self) -> np.ndarray | str:
        if self.sources.depth is None:
            return "no maps were named (--depth, of gof depth --all-frames)"
        return read_depth(self.sources.depth / "depth", self.camera.name, self.frame)

    def optical_flow(self) -> Tile:
        """Return where it is known and flame is, px/s of the pictures that the run has seen."""
        observation = self.inputs.observation
        flow, mask = (own_part(seen[self.f, self.number], self.small) for seen in (observation.flow, observation.mask))
        known = np.isfinite(flow).all(-1) & mask
        longest = float(np.percentile(np.linalg.norm(flow[known], axis=-1), 98)) if known.any() else 0.0
        shown = ScreenVelocity(np.where(known[..., None], flow, 0), known.astype(float))
        size = f"{self.small.width} x {self.small.height} px"
        return velocity_tile(shown, "optical flow", max(longest, 1e-9), "px/s", size)

    def velocities(self, result: TransientGaussians | None) -> dict[str, Tile]:
        """Show the gas' velocities parallel to the picture, on one scale: flow field, result, and true ones there."""
        field = self.inputs.field
        frame = field.frames[self.f]
        fields = {FLOW_FIELD: sideways_velocity(voxels_as_gaussians(field, frame), self.small, frame.time_s)}
        if result is not None:
            fields["velocity, result"] = of_result(result, self.camera, self.time_s)
            if self.dataset.has_velocity:
                fields["velocity, truth"] = true_there(result, self.dataset, self.camera, self.time_s)
        full = fastest(list(fields.values()))
        return {name: velocity_tile(values, name, full, unit(self.dataset)) for name, values in fields.items()}

    def gaussians(self, name: str, out: Modalities) -> TransientGaussians | None:
        """Return those of a file of the run, None before it is there."""
        path = self.sources.run / f"{name}.npz"
        if not path.is_file():
            out.missing[name] = f"{path.name} is not there yet: the reconstruction has not come so far"
            return None
        return TransientGaussians.load(path).measured_from(self.dataset.datum)

    def seeds(self, seeds: TransientGaussians) -> Tile:
        """Show what the optimisation starts from, each Gaussian by itself."""
        shrunk = replace(seeds, scale=seeds.scale * SHRUNK, opacity=np.full(len(seeds), 0.9))
        drawn = render(shrunk, self.camera, self.time_s)["color"]
        return picture_tile(drawn, "seeds", f"{len(seeds):,}, of {SHRUNK:g} their size")

    def result(self, result: TransientGaussians) -> Tile:
        """Return its picture, over its plate where it is the flame alone."""
        behind = background(self.dataset, self.number, self.sources.run) if result.dynamic.all() else None
        drawn = render(result, self.camera, self.time_s, background=behind)["color"]
        return picture_tile(drawn, "result", f"{len(result):,} Gaussians")


def _share(depth: np.ndarray) -> str:
    share = np.isfinite(depth).mean()
    return "" if share == 1 else f"{share:.0%} of the pixels"


def voxels_as_gaussians(field: FlowField, frame: FrameField) -> TransientGaussians:
    """Return the voxels whose velocity is known as round Gaussians that move with the gas, denser where more light
    is."""
    shown = frame.known & (frame.emission > 0)
    emission = frame.emission[shown]
    brightest = np.percentile(emission, 98) if len(emission) else 1.0
    n = len(emission)
    return TransientGaussians(
        position=field.voxels.center[shown],
        velocity=frame.velocity[shown],
        t_mu=np.full(n, frame.time_s),
        t_sigma=np.full(n, np.inf),
        scale=np.full((n, 3), VOXEL_SIZE * field.voxels.voxel_size),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=DENSEST * np.clip(emission / max(float(brightest), 1e-30), 0, 1),
        color=np.ones((n, 3)),
        dynamic=np.ones(n, bool),
    )
