"""`gof background`: the fire-free scene as static Gaussians, from the plates and their depth (paper, "Static Scene").

For views that no camera took; from the cameras themselves a plate is exact. Seeds are the back-projected depth maps. Loss:
0.8 L1 + 0.2 (1 - SSIM) + w mean |1/D - 1/D_render| z with w falling exponentially from 100 to 1 times 3DGS' own final weight
of 0.01. The depth term is in disparity times the scene's median depth z, which has no unit and is what stereo measures evenly.
Gaussians are cloned and split where the picture pulls hardest, and none is pruned.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import drjit as dr
import numpy as np
import tyro
from drjit.opt import Adam
from scipy.spatial import cKDTree

from gof.cameras import Camera
from gof.dataset import Dataset
from gof.errors import DataFormatError, GofError, NonFiniteError
from gof.gaussians import TransientGaussians
from gof.io.files import write_json
from gof.reconstruct.shrink import shrink
from gof.reconstruct.static import depth as depth_maps
from gof.reconstruct.static.stereo import stereo_depth
from gof.render import Splats, Target, l1_ssim, render_splats
from gof.render.backend import Array3f, Array4f, Float
from gof.stages import StageLog, progress_bar

SSIM_WEIGHT = 0.2
DEPTH_WEIGHT = (1.0, 0.01)  # first and last step; 3DGS' 0.01 at the end, 100 times as much at the start (paper)
DENSIFY_EVERY, DENSIFY_UNTIL = 100, 0.5  # steps; share of the steps
PULL = 2e-4  # mean gradient of the centre, in half picture widths, above which a Gaussian is cloned or split (3DGS)
LARGE = 0.01  # of the scene's size, larger ones are split, smaller ones cloned (3DGS)
SPLIT_SHRINK = 1.6  # (3DGS)
RATES = {"position": 1.6e-4, "log_scale": 5e-3, "rotation": 1e-3, "opacity": 0.05, "color": 2.5e-3}  # 3DGS; position times the size
POSITION_DECAY = 0.01


@dataclass
class BackgroundConfig:
    """The scene without fire as static Gaussians: background.npz and background.ply, for views that no camera took."""

    dataset: tyro.conf.Positional[Path]
    """Dataset folder. Uses its depth/CAMERA.npy (from `gof static --depth`), else stereo between its plates."""
    out: Path
    """Folder for the result; a finished one there is kept."""
    steps: int = 3000
    """Optimisation steps, one plate each; the paper's are 10 000."""
    gaussians: int = 120_000
    """At most so many."""
    longest_side: int = 640
    """Pictures with a longer side, in pixels, are shrunk to it."""
    depth_term: bool = True
    """Hold the Gaussians to the depth maps."""
    depth_weights: Path | None = None
    """Folder of a Depth-Anything-V2 checkpoint that completes stereo depth; without it edges of the plate do."""
    flame: Path | None = None
    """Result of `gof reconstruct` to add: scene.npz and scene.ply hold both."""
    seed: int = 0
    """Random seed of the order of pictures and of splitting."""
    json: Path | None = None
    """Also write the summary to this file."""


def make_background(config: BackgroundConfig) -> Path:
    """Run what is not there yet; returns the path of background.npz.

    Raises:
        GofError: no depth can be had; see `stereo_depth` and `depth.whole_depth`.
    """
    result = config.out / "background.npz"
    if not result.exists():
        config.out.mkdir(parents=True, exist_ok=True)
        full, log = Dataset.open(config.dataset), StageLog(config.out / "costs.json")
        dataset = shrink(full, config.longest_side)
        plates = [dataset.static(c) for c in range(len(dataset.cameras))]
        with log.measure("depth"):
            depths = plate_depths(dataset, plates, config.depth_weights)
        rng = np.random.default_rng(config.seed)
        with log.measure("background") as figures, progress_bar("background") as progress:
            seeds = seed_background(dataset.cameras, plates, depths, config.gaussians // 2, rng)
            gaussians = optimize_background(
                seeds, dataset.cameras, plates, depths if config.depth_term else None, config.steps, config.gaussians, rng, progress)  # fmt: skip
            figures.update(gaussians=len(gaussians), steps=config.steps)
        source = f"gof background {full.meta['name']}"
        gaussians.save(config.out / "background.ply", source=source)
        gaussians.save(result, source=source)
    if config.flame is not None:
        both = TransientGaussians.concatenate([TransientGaussians.load(result), TransientGaussians.load(config.flame)])
        for name in ("scene.npz", "scene.ply"):
            both.save(config.out / name, source="gof background and gof reconstruct")
    return result


def plate_depths(dataset: Dataset, plates: list[np.ndarray], weights: Path | None) -> list[np.ndarray]:
    """C x (H, W) camera depth in m, everywhere: the dataset's own maps, else stereo between the plates, completed."""
    files = [dataset.path / "depth" / f"{camera.name}.npy" for camera in dataset.cameras]
    pictures = [np.uint8(np.rint(255 * plate)) for plate in plates]
    if all(file.is_file() for file in files):
        found = [np.load(file, allow_pickle=False) for file in files]
        import cv2

        for file, depth in zip(files, found, strict=True):
            if depth.ndim != 2 or not (np.isfinite(depth) & (depth > 0)).all():
                raise DataFormatError(f"{file}: not an (H, W) map of positive depths; run gof static --depth again")
        # Nearest: a mean of two surfaces is a place where nothing is.
        return [cv2.resize(d.astype(np.float32), p.shape[1::-1], interpolation=cv2.INTER_NEAREST) for d, p in zip(found, plates, strict=True)]
    if len(plates) < 2:
        raise GofError(f"{dataset.path}: one camera has no stereo depth; give depth/{files[0].name}")
    points = np.array(dataset.meta.get("points", []), np.float64).reshape(-1, 3)
    partial = stereo_depth(pictures, dataset.cameras, points)
    return [depth_maps.whole_depth(d, picture, weights) for d, picture in zip(partial, pictures, strict=True)]


def seed_background(
    cameras: list[Camera], plates: list[np.ndarray], depths: list[np.ndarray], budget: int, rng: np.random.Generator
) -> TransientGaussians:
    """At most `budget` pixels of the plates as Gaussians at their depth, as large as the way to their three nearest neighbours."""
    clouds = [
        depth_maps.back_project(d, plate, camera) for d, plate, camera in zip(depths, plates, cameras, strict=True)
    ]
    points, colors = (np.concatenate(x) for x in zip(*clouds, strict=True))
    chosen = rng.permutation(len(points))[:budget]
    points, colors = points[chosen], colors[chosen]
    apart = cKDTree(points).query(points, k=min(4, len(points)))[0]
    size = np.sqrt((apart[:, 1:] ** 2).mean(1)) if len(points) > 1 else np.ones(len(points))
    n = len(points)
    return TransientGaussians(
        position=points,
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.tile(np.maximum(size, 1e-7 * np.ptp(points, axis=0).max() + 1e-12)[:, None], (1, 3)),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.1),
        color=colors,
        dynamic=np.zeros(n, bool),
    )


def optimize_background(
    seeds: TransientGaussians,
    cameras: list[Camera],
    plates: list[np.ndarray],
    depths: list[np.ndarray] | None,
    steps: int,
    budget: int,
    rng: np.random.Generator,
    progress=lambda done, total, **_: None,
) -> TransientGaussians:
    """3D Gaussian Splatting of the plates.

    Args:
        plates: C x (H, W, 3) display values.   depths: C x (H, W) m, or None for no depth term.
        budget: densification ends at so many Gaussians.
    Raises:
        NonFiniteError: the loss became NaN or Inf.
    """
    # 3DGS takes the cameras' spread as the scene's size; three cameras side by side say little, their distance says more.
    size = float(np.median(np.concatenate([c.to_camera(seeds.position)[:, 2] for c in cameras])))
    raw = _to_raw(seeds)
    optimizer = _adam(raw, size)
    targets = [Target(plate) for plate in plates]
    disparity = None if depths is None else [Float(np.ascontiguousarray(size / d.ravel(), np.float32)) for d in depths]
    pull, seen, order = np.zeros(len(seeds)), np.zeros(len(seeds)), []
    for step in range(steps):
        if not order:
            order = rng.permutation(len(plates)).tolist()
        c, done = order.pop(), step / max(steps - 1, 1)
        optimizer.set_learning_rate({"position": RATES["position"] * size * POSITION_DECAY**done})
        frame = render_splats(_splats(optimizer), cameras[c], depth=depths is not None, near=0.01 * size)
        loss = l1_ssim(frame.color, targets[c], ssim_weight=SSIM_WEIGHT)
        if disparity is not None:
            weight = DEPTH_WEIGHT[0] * (DEPTH_WEIGHT[1] / DEPTH_WEIGHT[0]) ** done
            covered = dr.detach(frame.alpha) > 0.5  # elsewhere the expected depth is of almost nothing
            rendered = dr.select(covered, size / dr.maximum(frame.expected_depth, 1e-3 * size), disparity[c])
            loss += weight * dr.mean(dr.abs(rendered - disparity[c]))
        dr.backward(loss)
        grows = step < DENSIFY_UNTIL * steps
        if grows:
            moved = np.hypot(*np.array(frame.mean2d_grad)) * cameras[c].width / 2
            drawn = frame.radius.numpy() > 0
            pull[drawn] += moved[drawn]
            seen[drawn] += 1
        optimizer.step()
        dr.eval(list(optimizer.values()))
        if (step + 1) % DENSIFY_EVERY == 0:
            value = float(loss.array[0])
            if not np.isfinite(value):
                raise NonFiniteError(f"step {step}: the loss of the background is {value}; report this dataset as a bug")
            if grows and len(pull) < budget:
                optimizer = _densify(optimizer, pull / np.maximum(seen, 1), size, budget, rng)
                pull, seen = np.zeros(dr.width(optimizer["opacity"])), np.zeros(dr.width(optimizer["opacity"]))
            progress(step + 1, steps, note=f"loss {value:.4f}, {len(pull)} Gaussians")
    return _from_raw(optimizer)


def _densify(optimizer: Adam, pull: np.ndarray, size: float, budget: int, rng: np.random.Generator) -> Adam:
    """Clone small and split large Gaussians that the pictures pull hardest, at most up to the budget; Adam starts anew for them."""
    g = _from_raw(optimizer)
    wanted = np.flatnonzero(pull > PULL)
    wanted = wanted[np.argsort(-pull[wanted], kind="stable")][: budget - len(g)]
    if not len(wanted):
        return optimizer
    child = g[wanted]
    split = child.scale.max(1) > LARGE * size
    scale = np.where(split[:, None], child.scale / SPLIT_SHRINK, child.scale)
    child = replace(child, scale=scale, position=child.position + split[:, None] * _within(child, rng))
    g.scale[wanted] = scale  # the parent of a split shrinks as its child does, and moves the other way
    g.position[wanted] += split[:, None] * _within(g[wanted], rng)
    grown = _adam(_to_raw(TransientGaussians.concatenate([g, child])), size)
    for name in grown.keys():  # those that were there keep their moments
        value, promoted, rate, (t, *_, extra) = grown.state[name]
        _, _, _, (t, m, v, _) = optimizer.state[name]
        kind, zero = type(dr.detach(value)), np.zeros(_shape(m)[:-1] + (len(wanted),), np.float32)
        moments = [kind(np.concatenate([np.array(x), zero], axis=-1)) for x in (m, v)]
        grown.state[name] = (value, promoted, rate, (t, *moments, extra))
    return grown


def _within(g: TransientGaussians, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) a random offset drawn from each Gaussian, m."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.roll(g.rotation, -1, axis=1)).apply(rng.normal(size=(len(g), 3)) * g.scale)


def _shape(x) -> tuple[int, ...]:
    return np.array(x).shape


def _adam(raw: dict, size: float) -> Adam:
    optimizer = Adam(lr=1.0, params=raw, epsilon=1e-15)
    optimizer.set_learning_rate(RATES | {"position": RATES["position"] * size})
    return optimizer


def _splats(raw) -> Splats:
    color = raw["color"]
    opacity = 1 / (1 + dr.exp(-raw["opacity"]))
    return Splats(raw["position"], raw["rotation"], dr.exp(raw["log_scale"]), opacity, [color.x, color.y, color.z])


def _to_raw(g: TransientGaussians) -> dict:
    opacity = np.clip(g.opacity.astype(np.float64), 1e-4, 1 - 1e-4)

    def columns(x: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(x.T, np.float32)

    return {
        "position": Array3f(columns(g.position)),
        "log_scale": Array3f(columns(np.log(g.scale))),
        "rotation": Array4f(columns(g.rotation)),
        "opacity": Float((np.log(opacity) - np.log1p(-opacity)).astype(np.float32)),
        "color": Array3f(columns(g.color)),
    }


def _from_raw(raw) -> TransientGaussians:
    values = {name: np.array(dr.detach(raw[name])) for name in RATES}
    n = values["opacity"].shape[-1]
    return TransientGaussians(
        position=values["position"].T,
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.exp(values["log_scale"].T.astype(np.float64)),
        rotation=values["rotation"].T,
        opacity=1 / (1 + np.exp(-values["opacity"].astype(np.float64))),
        color=values["color"].T,
        dynamic=np.zeros(n, bool),
    )


def main(argv: list[str]) -> int:
    """`gof background DATASET --out DIR`; see --help."""
    config = tyro.cli(BackgroundConfig, prog="gof background", args=argv)
    result = make_background(config)
    stages = StageLog(config.out / "costs.json").stages()
    summary = {"result": str(result), "gaussians": len(TransientGaussians.load(result)), "stages": [s.__dict__ for s in stages]}
    if config.json:
        write_json(config.json, summary)
    for stage in stages:
        print(f"{stage.name:<12} {stage.seconds:8.1f} s {stage.peak_mb:8.0f} MB")
    print(f"{summary['gaussians']} Gaussians -> {result}")
    return 0
