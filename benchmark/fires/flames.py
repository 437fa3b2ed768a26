"""A fire as the laws of fires ask for it, from wherever: grids of a solver, a generated dataset, filmed clips."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.colour import srgb_to_linear
from gof.core.errors import DataFormatError
from gof.core.fire import Hearth
from gof.core.numbered import is_hidden
from gof.dataset import Dataset
from gof.footage.flame_mask import flame_mask
from gof.footage.videos import stored_frames
from gof_benchmark.fires import measures
from gof_benchmark.fires.measured import SimulatedFlow
from gof_benchmark.solvers.grids import FireGrids, FireHistory
from gof_blender.core.checked_json import SpecError
from gof_blender.pure.fires import GridFire
from gof_blender.pure.spec import SceneSpec

EVERY = 4  # frame of a video is looked at for where its flame goes
PROBES = 7  # heights on the axis, up to two diameters, whose speed is looked at for puffing


@dataclass(frozen=True)
class SideView:
    """A flame from one side.

    Args:
        height: (Z,) evenly spaced, rising; m above the burner, or pixels above the flame's foot of a filmed one.
        brightest: (T, Z) of the brightest line of sight at each height.
        total: (T, Z) light of all at that height.
    """

    height: np.ndarray
    brightest: np.ndarray
    total: np.ndarray


@dataclass(frozen=True)
class Axis:
    """Mean vertical speed (Z,) m/s on a burner's axis at heights (Z,) m above it, averaged over so many seconds."""

    height_m: np.ndarray
    speed_m_s: np.ndarray
    over_s: float


@dataclass(frozen=True)
class Swings:
    """Vertical speed (N, P) m/s over time (N,) s at P points on the axis, up to two diameters above the burner."""

    time_s: np.ndarray
    rise_m_s: np.ndarray


@dataclass(frozen=True)
class SimulationFacts:
    """Facts that only a simulation knows. NaN or None where this one does not.

    Args:
        diameter_m: of the burner whose axis is looked at (the first), as a circle of equal area.
        heat_kw: what that burner's fuel gives.
        heat_nominal_kw, heat_burnt_kw: of all burners; burnt in the grids' box, mean of the clip.
        shining: speed of the shining gas at each height, averaged over the clip.
        hottest_k, fastest_m_s: of any cell and frame.
        cpu_s: seconds of one core that the fire took.
        windy: the flame leans; the laws are of still air, and the axis is not where it burns.
        flow: for profiles across the fire.
    """

    diameter_m: float
    axis: Axis
    swings: Swings
    fastest_m_s: float
    heat_kw: float = math.nan
    heat_nominal_kw: float = math.nan
    heat_burnt_kw: float = math.nan
    shining: Axis | None = None
    hottest_k: float = math.nan
    cpu_s: float = math.nan
    windy: bool = False
    flow: SimulatedFlow | None = None


@dataclass(frozen=True)
class ViewedFlame:
    """One fire.

    Args:
        source: who made it, in a word: a solver, or "real".
        truth: None of a filmed one.
        cut: whether flame is known to leave a picture, so that what is seen is not all of it.
    """

    name: str
    source: str
    time_s: np.ndarray
    views: tuple[SideView, ...]
    truth: SimulationFacts | None = None
    cut: bool = False


def flame_of(path: Path, clip_rate_hz: float = 0.0) -> ViewedFlame:
    """Open whatever a folder holds: grids of a solver, a dataset, or one video per camera.

    Args:
        clip_rate_hz: at which videos were filmed; slow-motion files state another one.
    Raises:
        DataFormatError: nothing of these, or damaged (names the file).
    """
    if (path / "fire.json").exists() and (path / "velocity.zarr").exists():
        return of_grids(FireGrids.open(path))
    if (path / "dataset.json").exists():
        return of_dataset(Dataset.open(path))
    if videos := sorted(video for video in path.glob("*.mp4") if not is_hidden(video)):
        return of_clips(f"{path.parent.name}/{path.name}", videos, clip_rate_hz)
    raise DataFormatError(
        f"{path}: neither a fire's grids (fire.json), nor a dataset (dataset.json), nor videos (*.mp4)"
    )


# ---------------------------------------------------------------- a solver's grids


def of_grids(fire: FireGrids) -> ViewedFlame:
    """From the truth; on the axis of the first burner, over the history where there is one, else over the clip.

    Raises:
        DataFormatError: a frame is damaged, or the fire names no burner.
    """
    if not fire.description.hearths:
        raise DataFormatError(f"{fire.path}: no hearth in fire.json, so there is no law to compare with")
    hearth, frames = fire.description.hearths[0], range(len(fire.times_s))
    z = fire.centers(2) - hearth.position_m[2]

    def velocity() -> Iterator[np.ndarray]:
        return (fire.velocity.frame(k).velocity.astype(np.float32, copy=False) for k in frames)

    def light() -> Iterator[np.ndarray]:
        return (fire.grids["emission"].cells(k).sum(-1, dtype=np.float32) for k in frames)

    along = [(e.sum(0).max(0), e.sum(1).max(0), e.sum((0, 1))) for e in light()]
    from_x, from_y, total = (np.array(part, float) for part in zip(*along, strict=True))
    columns = measures.axis_columns(fire.centers(0), fire.centers(1), hearth.position_m[:2], hearth.diameter_m)
    axis, swings = _on_axis(fire.times_s, velocity(), columns, z, hearth.diameter_m)
    if fire.history:
        axis, swings = _of_history(fire.history, hearth, axis)
    heat, hot = fire.grids.get("heat_release"), fire.grids.get("temperature")
    burnt = [measures.heat_release_kw(heat.cells(k), fire.voxel_m) for k in frames] if heat else [math.nan]
    shining = measures.light_speed(velocity(), light())
    truth = SimulationFacts(
        diameter_m=hearth.diameter_m,
        axis=axis,
        swings=swings,
        fastest_m_s=max(float(np.linalg.norm(v, axis=-1).max()) for v in velocity()),
        heat_kw=hearth.heat_release_kw,
        heat_nominal_kw=sum(h.heat_release_kw for h in fire.description.hearths),
        heat_burnt_kw=float(np.mean(burnt)),
        shining=Axis(z, shining, float(fire.times_s[-1])),
        hottest_k=max(float(hot.cells(k).max()) for k in frames) if hot else math.nan,
        cpu_s=sum(fire.description.cpu_s.values()),
        windy=any(fire.description.wind_m_s),
        flow=SimulatedFlow(fire.velocity, np.array(hearth.position_m, float)),
    )
    views = tuple(SideView(z, brightest, total) for brightest in (from_x, from_y))
    return ViewedFlame(fire.description.name, fire.description.solver.split()[0], fire.times_s, views, truth)


def _of_history(history: FireHistory, hearth: Hearth, clip: Axis) -> tuple[Axis, Swings]:
    """From the probes: their mean over the whole record, and those up to two diameters over time.

    Above the highest probe the clip's mean has to do.
    """
    time_s, rise = np.array(history.time_s), np.array(history.rise_m_s)
    heights = np.array(history.probe_position_m)[:, 2] - hearth.position_m[2]
    near = heights <= max(2 * hearth.diameter_m, heights.min())
    above = clip.height_m > heights.max()
    mean = np.concatenate([measures.mean_over_time(time_s, rise), clip.speed_m_s[above]])
    axis = Axis(np.concatenate([heights, clip.height_m[above]]), mean, float(time_s[-1] - time_s[0]))
    return axis, Swings(time_s, rise[:, near])


def _on_axis(
    time_s: np.ndarray,
    velocity: Iterator[np.ndarray],
    columns: tuple[np.ndarray, np.ndarray],
    height_m: np.ndarray,
    diameter_m: float,
) -> tuple[Axis, Swings]:
    """From the clip's own frames of velocity (X, Y, Z, 3)."""
    x, y = columns
    rise = np.array([frame[x, y, :, 2].mean(0, dtype=float) for frame in velocity])
    near = np.nonzero((height_m > 0) & (height_m <= 2 * diameter_m))[0]
    probes = near[np.linspace(0, len(near) - 1, min(PROBES, len(near))).round().astype(int)]
    return Axis(height_m, rise.mean(0), float(time_s[-1] - time_s[0])), Swings(time_s, rise[:, probes])


# ---------------------------------------------------------------- a dataset


def of_dataset(dataset: Dataset) -> ViewedFlame:
    """Return that of a generated dataset. A fire that we simulate: speed from `velocity.zarr`, light from the linear
    pictures of all cameras, the burner from the spec, its heat unknown. One of grids: the grids themselves.

    Raises:
        DataFormatError: not generated, or a file is damaged.
    """
    if dataset.description.spec is None:
        raise DataFormatError(f"{dataset.path}: not a generated dataset: dataset.json holds no spec")
    try:
        spec = SceneSpec.from_dict(dataset.description.spec).resolved(dataset.path)
    except SpecError as error:
        raise DataFormatError(f"{dataset.path}: {error}") from error
    if isinstance(spec.fire, GridFire):
        return of_grids(FireGrids.open(spec.fire.grids))
    burner, fields = spec.fire.burner, dataset.velocity
    first = fields.frame(0)
    x, y, z = (
        first.index_to_world[i, 3] + first.index_to_world[i, i] * (np.arange(first.resolution[i]) + 0.5)
        for i in range(3)
    )
    base = np.array([burner.position[0], burner.position[1], burner.position[2] + burner.half_height])
    height_m, diameter_m = z - base[2], 2 * burner.radius
    frames = [fields.frame(k).velocity for k in range(len(fields))]
    columns = measures.axis_columns(x, y, (base[0], base[1]), diameter_m)
    axis, swings = _on_axis(fields.times_s, iter(frames), columns, height_m, diameter_m)
    fastest = max(float(np.linalg.norm(v.astype(np.float32), axis=-1).max()) for v in frames)
    top = float(height_m[-1])
    views = tuple(_picture_view(dataset, number, base, top) for number in range(len(dataset.cameras)))
    windy = "wind" in spec.effect_names
    truth = SimulationFacts(diameter_m, axis, swings, fastest, windy=windy, flow=SimulatedFlow(fields, base))
    return ViewedFlame("/".join(dataset.path.resolve().parts[-2:]), "Mantaflow", dataset.times_s, views, truth)


def _picture_view(dataset: Dataset, number: int, base: np.ndarray, top_m: float) -> SideView:
    """Return a camera's linear red light by height: a picture's row is the height of the axis that it shows."""
    camera = dataset.cameras[number]
    step = _row_m(camera, base, top_m)
    height = step * (np.arange(int(top_m / step)) + 0.5)
    pixels, _ = camera.project(base + height[:, None] * [0.0, 0.0, 1.0])
    inside = (pixels[:, 1] >= 0.5) & (pixels[:, 1] <= camera.height - 0.5)
    height, rows = height[inside], pixels[inside, 1] - 0.5
    red = [_flame_red(dataset.file(number, "exr", k)) for k in range(len(dataset.times_s))]
    return SideView(height, *(_at_rows(red, by, rows) for by in (_brightest, _total)))


def _brightest(red: np.ndarray) -> np.ndarray:
    return red.max(1)


def _total(red: np.ndarray) -> np.ndarray:
    return red.sum(1)


def _at_rows(pictures: list[np.ndarray], by: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Return (T, Z): what a function says of each row of (H, W) pictures, between rows linearly."""
    return np.array([np.interp(rows, np.arange(len(picture)), by(picture)) for picture in pictures])


def _row_m(camera: Camera, base: np.ndarray, top_m: float) -> float:
    """Return metres of the axis that a row of the picture shows, in the middle."""
    middle = base + [0.0, 0.0, top_m / 2]
    pixels, _ = camera.project(np.array([middle, middle + [0.0, 0.0, 0.01]]))
    return 0.01 / abs(float(pixels[0, 1] - pixels[1, 1]))


def _flame_red(path: Path) -> np.ndarray:
    """Return (H, W) linear red light of the flame alone. Raises DataFormatError: no such picture, or another kind."""
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return np.array(file.channels()["flame.R"].pixels, float)
    except (RuntimeError, OSError, KeyError) as error:
        raise DataFormatError(
            f"{path}: no channel flame.R can be read ({error}); generate the dataset again"
        ) from error


# ---------------------------------------------------------------- filmed clips


def of_clips(name: str, videos: list[Path], rate_hz: float) -> ViewedFlame:
    """Return that of a real fire, one video a camera: light above the scene without fire, the darkest of each pixel.

    Heights are pixels above the flame's foot; the brightest light may be clipped by the sensor.

    Raises:
        DataFormatError: no rate, a video cannot be read, or no flame is seen.
    """
    if not rate_hz > 0:
        raise DataFormatError(f"{videos[0].parent}: at which rate was this filmed? --clip-rate-hz 400, for example")
    filmed = [_filmed_view(video) for video in videos]
    count = min(len(view.total) for view, _ in filmed)
    views = tuple(SideView(view.height, view.brightest[:count], view.total[:count]) for view, _ in filmed)
    return ViewedFlame(name, "real", np.arange(count) / rate_hz, views, cut=any(cut for _, cut in filmed))


def _filmed_view(video: Path) -> tuple[SideView, bool]:
    """Return a camera's view, and whether flame leaves its picture."""
    frames = np.array(list(stored_frames(video)))
    plate = frames.min(0)
    region = _flame_region(frames[::EVERY].astype(np.float32) / 255, plate.astype(np.float32) / 255)
    if not region.any():
        raise DataFormatError(f"{video}: no flame is seen in it")
    dark = srgb_to_linear(plate[..., 0] / 255)
    red = np.array([np.where(region, srgb_to_linear(frame[..., 0] / 255) - dark, 0) for frame in frames])
    rows = np.nonzero(region.any(1))[0]
    part = red[:, rows[0] : rows[-1] + 1][:, ::-1]  # from the foot up
    cut = bool(region[0].any() or region[:, 0].any() or region[:, -1].any())
    return SideView(np.arange(part.shape[1]) + 0.5, part.max(2), part.sum(2, dtype=float)), cut


def _flame_region(frames: np.ndarray, plate: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: the largest place that flame visits, without the LEDs of a board or what reflects it."""
    visited = np.any([flame_mask(frame, plate) for frame in frames], axis=0)
    outlines, _ = cv2.findContours(visited.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    region = np.zeros(visited.shape, np.uint8)
    if outlines:
        cv2.drawContours(region, [max(outlines, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    return region > 0
