"""Can these cameras have filmed one flame? A look at a few small pictures before hours are spent on them.

Where nothing is occluded and fire shines through fire, all the light that a camera sees in a plane through two cameras'
centres is what the other sees in that plane (epipolar consistency). So each pair of cameras must agree on how light is
spread over those planes, and on how that changes; and what the masks leave standing must cover the masks.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.datum import require_digits
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.footage.flame_mask import flame_mask
from gof.reconstruct.lit_plate import faint_flame
from gof.reconstruct.observation import light_above, was_delivered
from gof.reconstruct.voxels import flame_box

LONGEST_SIDE, FRAMES = 160, 8  # of the pictures that are looked at, px, and how many of each camera
PLANES, VOXELS, CELL, NEAR = 12, 40, 4, 3  # of the hull: voxels a side, px of a cell, px by which masks are widened

FINEST = 300  # voxels to the flame's box, at the most
VIEW_DEG = (0.5, 170.0), (3.0, 130.0)  # of a picture: impossible outside the first, odd outside the second
ANGLE_DEG = 0.5, 3.0  # at the flame between the two cameras farthest apart: too little to place it, little
READOUT = 3.0, 1.05  # of a frame's time, that a picture's lines may take
COVERED = 0.5, 0.75  # share of a mask that has something standing in front of it
DARK = 5e-4, 0.02  # share of a picture, and of what is usual, below which it shows no flame
SPREAD = 0.0, 0.8  # correlation of light over the planes
WINDOW_ROOM = 1.3  # times the flame's box in a few pictures: what it reaches in others, and room around
CHANGE = 0.4  # correlation of its change over time; good captures have 0.90 and more
CHANGES = 0.1  # relative; what changes less says nothing about clocks
PLATE = 0.02, 0.5  # display values of difference, and by how much less another plate differs


@dataclass(frozen=True)
class Fault:
    """A thing that cannot be, or hardly, in words with figures. stops: nothing can come of it."""

    text: str
    stops: bool


@dataclass(frozen=True)
class _CheckedView:
    """A camera and what it saw, small: static (H, W, 3), image (F, H, W, 3), mask (F, H, W)."""

    camera: Camera
    static: np.ndarray
    image: np.ndarray
    mask: np.ndarray


def find_faults(dataset: Dataset) -> list[Fault]:
    """Return the faults of a dataset's cameras, clocks, plates and poses; empty where all agrees.

    Costs a second or two. Reads no held-out picture.

    Raises:
        DataFormatError: a picture is missing or damaged.
    """
    found = [*_lenses(dataset), *_clocks(dataset)]
    if any(fault.stops for fault in found) or len(dataset.cameras) < 2 or len(dataset.train_frames) < 2:
        return found
    views = _views(dataset)
    wrong_plates = list(_plates(views))
    dark = {} if wrong_plates else _dark(views)  # judged first: they would put the blame on those that see the flame
    bright = [view for view in views if view.camera.name not in dark]
    return [*found, *wrong_plates, *dark.values(), *(_poses(bright) if not wrong_plates else ())]


def window_share(dataset: Dataset) -> float:
    """About which part of a picture a window around the flame takes (`gof.reconstruct.windows`), 0..1.

    It looks at a few small pictures, none of them held out. A spot that is flame to one camera alone counts too.
    """
    shares = []
    for view in _views(dataset):
        mask, _ = faint_flame(view.static, view.image, view.mask, np.zeros((len(view.image), 1, 1), bool))
        rows, columns = np.nonzero(mask.any(0))
        if len(rows):
            sides = np.array([np.ptp(rows), np.ptp(columns)]) + 1
            shares.append(np.minimum(WINDOW_ROOM * sides / view.static.shape[:2], 1))
    return float(np.max(shares, axis=0).prod()) if shares else 1.0


def require_possible(found: list[Fault], dataset: Dataset) -> None:
    """Raise GofError where one of the faults stops."""
    stopping = [fault.text for fault in found if fault.stops]
    if stopping:
        raise GofError(f"{dataset.path}: {'; '.join(stopping)}. Mend it, or go on with --anyway")


# ---- What dataset.json alone says ------------------------------------------------------------------------------------


def _lenses(dataset: Dataset) -> Iterator[Fault]:
    for camera in dataset.cameras:
        for side, pixels, focal in (("wide", camera.width, camera.K[0, 0]), ("high", camera.height, camera.K[1, 1])):
            view = float(np.degrees(2 * np.arctan(pixels / (2 * focal))))
            if not VIEW_DEG[1][0] <= view <= VIEW_DEG[1][1]:
                yield Fault(
                    f"camera '{camera.name}' would see {view:.3g} degrees {side} (focal length {focal:.3g} px of "
                    f"{pixels} px)",
                    stops=not VIEW_DEG[0][0] <= view <= VIEW_DEG[0][1],
                )
                break


def _clocks(dataset: Dataset) -> Iterator[Fault]:
    yield from _digits(
        "the dataset's clock",
        dataset.times_s,
        dataset.frame_time_s,
        "The clip is too long for its frames: cut it into parts",
    )
    clocks = [dataset.camera_times_s(c) for c in range(len(dataset.cameras))]
    for number, (camera, own) in enumerate(zip(dataset.cameras, clocks, strict=True)):
        name = f"camera '{camera.name}'"
        others = [clock for k, clock in enumerate(clocks) if k != number]
        step = float(np.median(np.diff(own))) if len(own) > 1 else 0.0
        lines = camera.width if camera.readout in ("left", "right") else camera.height
        readout = camera.row_time_s * lines
        if camera.row_time_s < 0:
            yield Fault(f"{name}: row_time_s is {camera.row_time_s:g} s; give its direction as `readout`", True)
        elif step > 0 and readout > READOUT[1] * step:
            yield Fault(
                f"{name} would take {readout:.3g} s to read the {lines} lines of a frame that lasts {step:.3g} s "
                f"(row_time_s {camera.row_time_s:.3g} s)",
                stops=readout > READOUT[0] * step,
            )
        if others and step > 0:
            away = float(np.median(own - np.median(others, axis=0)))
            apart = all(own[0] > clock[-1] + step or own[-1] < clock[0] - step for clock in others)
            if apart or abs(away) > 2 * step:
                yield Fault(
                    f"{name}: its pictures were taken {away:+.3g} s from the others' of the same number"
                    + (", when no other camera filmed" if apart else f", {abs(away) / step:.1f} frames"),
                    stops=apart,
                )


def _digits(what: str, values: np.ndarray, least: float, remedy: str) -> Iterator[Fault]:
    """Clips too long and flames too far from the cameras, where a result in float32 would be rounded to nothing."""
    try:
        require_digits(what, values, least, remedy)
    except GofError as e:
        yield Fault(str(e), stops=True)


# ---- What a few pictures say -----------------------------------------------------------------------------------------


def _views(dataset: Dataset) -> list[_CheckedView]:
    chosen = np.linspace(0, len(dataset.train_frames) - 1, FRAMES).round().astype(int)
    frames = [dataset.train_frames[i] for i in np.unique(chosen)]
    views = [_view(dataset, number, frames) for number in range(len(dataset.cameras))]
    taken = np.all([was_delivered(view.image, view.static) for view in views], axis=0)
    return [_CheckedView(v.camera, v.static, v.image[taken], v.mask[taken]) for v in views] if taken.any() else views


def _view(dataset: Dataset, number: int, frames: list[int]) -> _CheckedView:
    camera = dataset.cameras[number]
    factor = min(1.0, LONGEST_SIDE / max(camera.width, camera.height))
    size = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))

    def small(picture: np.ndarray) -> np.ndarray:
        return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)

    static = small(dataset.static(number))
    image = np.stack([small(dataset.image(number, k)) for k in frames])
    counts = dataset.board_weight(number)
    if counts is not None:
        image = static + small(counts)[..., None] * (image - static)
    return _CheckedView(
        camera.scaled(*size), static, image, np.stack([flame_mask(picture, static) for picture in image])
    )


def _plates(views: list[_CheckedView]) -> Iterator[Fault]:
    """Outside the fire a picture is its plate; where another camera's fits much better, they were mixed up."""
    for view in views:
        outside = ~view.mask.any(0)
        if not outside.any():
            continue
        own = _difference(view, view.static, outside)
        turned = _difference(view, view.static[::-1, ::-1], outside)
        others = {
            other.camera.name: _difference(view, other.static, outside)
            for other in views
            if other is not view and other.static.shape == view.static.shape
        }
        nearest = min(others, key=others.__getitem__, default=None)
        if own < PLATE[0]:
            continue
        problem = f"the pictures of camera '{view.camera.name}' differ from its plate by {own:.2f} outside the fire"
        if turned < PLATE[1] * own:
            yield Fault(f"{problem}, and by {turned:.2f} from the plate turned by 180 degrees", True)
        elif nearest is not None and others[nearest] < PLATE[1] * own:
            yield Fault(
                f"{problem}, and by {others[nearest]:.2f} from that of '{nearest}': are the plates swapped?", True
            )


def _difference(view: _CheckedView, plate: np.ndarray, outside: np.ndarray) -> float:
    return float(np.median(np.abs(view.image - plate).mean(-1)[:, outside]))


def _dark(views: list[_CheckedView]) -> dict[str, Fault]:
    """By name the cameras that show no flame, or hardly any, while others do."""
    shares = {view.camera.name: float(view.mask.mean()) for view in views}
    usual = float(np.median([share for share in shares.values() if share > 0] or [0.0]))
    dark = [name for name, share in shares.items() if share < min(DARK[0], DARK[1] * usual) or (share == 0 < usual)]
    others = ", ".join(f"'{name}' {share:.2%}" for name, share in shares.items() if name not in dark)
    return {
        name: Fault(
            f"camera '{name}' shows no flame ({shares[name]:.2%} of its picture; {others}): is its film HDR that was "
            "read as SDR, too dark, or is the flame in its plate or outside its picture? Ingest without it, or mend it",
            True,
        )
        for name in dark
    }


def _poses(views: list[_CheckedView]) -> Iterator[Fault]:
    if sum(view.mask.any() for view in views) < 2:
        return  # there is no flame; the stage that looks for it says so
    cameras = [view.camera for view in views]
    try:
        low, high = flame_box(cameras, _padded([view.mask.any(0) for view in views]))
    except DataFormatError as e:
        yield Fault(str(e), True)
        return
    middle = (low + high) / 2
    yield from _digits(
        "the flame's place in the world",
        np.stack([low, high]),
        float((high - low).max()) / FINEST,
        "Places are measured from amid the cameras: these stand too far from so small a flame",
    )
    ray = [(middle - camera.position) / max(np.linalg.norm(middle - camera.position), 1e-30) for camera in cameras]
    angle = max(
        float(np.degrees(2 * np.arcsin(min(float(np.linalg.norm(a - b)) / 2, 1.0))))
        for a, b in itertools.combinations(ray, 2)
    )
    if angle < ANGLE_DEG[1]:
        yield Fault(
            f"the cameras see the flame from directions at most {angle:.2g} degrees apart, which hardly determine "
            "its depth",
            stops=angle < ANGLE_DEG[0],
        )
    if angle >= ANGLE_DEG[0]:
        yield from _hull(views)
        yield from _light(views, middle)


def _hull(views: list[_CheckedView]) -> Iterator[Fault]:
    shares = [_covered(views, f) for f in range(len(views[0].mask)) if sum(v.mask[f].any() for v in views) >= 2]
    for view, share in zip(views, np.transpose(shares) if shares else (), strict=False):
        share = share[np.isfinite(share)]
        if len(share) and (usual := float(np.median(share))) < COVERED[1]:
            yield Fault(
                f"only {usual:.0%} of the flame that camera '{view.camera.name}' sees can be where the others see it: "
                "is a pose, a focal length or a clock wrong?",
                stops=usual < COVERED[0],
            )


def _covered(views: list[_CheckedView], frame: int) -> np.ndarray:
    """(C,) share of each mask, where other cameras look, before which something stands in all views; NaN: no mask."""
    cameras, masks = [view.camera for view in views], [view.mask[frame] for view in views]
    try:
        low, high = flame_box(cameras, _padded(masks))
    except DataFormatError:
        return np.zeros(len(views))
    axes = [np.linspace(low[i], high[i], VOXELS) for i in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * NEAR + 1, 2 * NEAR + 1))
    looks, hits, cell = [], [], []
    for camera, mask in zip(cameras, masks, strict=True):
        pixel, _ = camera.project(points)
        with np.errstate(invalid="ignore"):
            seen = ((pixel >= 0) & (pixel < (camera.width, camera.height))).all(1)
        column, row = np.where(seen[:, None], pixel, 0).astype(int).T
        looks.append(seen)
        hits.append(seen & (cv2.dilate(mask.astype(np.uint8), disc) > 0)[row, column])
        cell.append((row // CELL, column // CELL))
    inside, hit = np.array(looks), np.array(hits)
    standing = (hit | ~inside).all(0) & (hit.sum(0) >= 2)
    shares = np.full(len(views), np.nan)
    for c, mask in enumerate(masks):
        grid = np.zeros((3, mask.shape[0] // CELL + 1, mask.shape[1] // CELL + 1), bool)
        for layer, chosen in enumerate((hit[c] & np.delete(inside, c, 0).any(0), standing)):
            grid[layer, cell[c][0][chosen], cell[c][1][chosen]] = True
        rows, columns = np.nonzero(mask)
        grid[2, rows // CELL, columns // CELL] = True
        judged = grid[0] & grid[2]
        if mask.any():  # flame that no other camera can see is not explained either
            shares[c] = (judged & grid[1]).sum() / max(judged.sum(), 1)
    return shares


def _light(views: list[_CheckedView], middle: np.ndarray) -> Iterator[Fault]:
    for number, view in enumerate(views):
        others = views[:number] + views[number + 1 :]
        spread, change = _agreement(view, others, middle)
        name = f"camera '{view.camera.name}'"
        if spread < SPREAD[1]:
            turned = _agreement(_turned(view), others, middle)[0]
            upside_down = turned > max(SPREAD[1], spread)
            yield Fault(
                f"the flame's light is spread otherwise in {name} than in any other (correlation {spread:.2f} over the "
                "planes that they share): "
                + (
                    f"turned by 180 degrees its pictures would agree ({turned:.2f}), so they are upside down"
                    if upside_down
                    else "is its focal length or pose wrong?"
                ),
                stops=upside_down or spread < SPREAD[0],
            )
        elif change < CHANGE:
            yield Fault(
                f"the flame in {name} changes otherwise than in any other (correlation {change:.2f}): is its clock "
                "off by frames?",
                stops=False,
            )


def _agreement(view: _CheckedView, others: list[_CheckedView], middle: np.ndarray) -> tuple[float, float]:
    """Return the best correlations with another camera: of light over the planes, of its change; 1 without any.

    The best, because in a pair with a wrong camera both are wrong.
    """
    pairs = [profiles for other in others if (profiles := _in_common_planes(view, other, middle)) is not None]
    spread = [_correlation(*(p.mean(0) for p in profiles)) for profiles in pairs]
    change = [_change(*profiles) for profiles in pairs]
    best = [max((x for x in found if np.isfinite(x)), default=1.0) for found in (spread, change)]
    return best[0], best[1]


def _turned(view: _CheckedView) -> _CheckedView:
    """By 180 degrees in the picture, with the camera as it was."""
    return _CheckedView(view.camera, view.static[::-1, ::-1], view.image[:, ::-1, ::-1], view.mask[:, ::-1, ::-1])


def _in_common_planes(a: _CheckedView, b: _CheckedView, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """(F, planes) light that each sees in bundles of planes through both centres; None where they share none."""
    baseline = b.camera.position - a.camera.position
    forward = middle - a.camera.position
    normal = np.cross(baseline, forward)
    if np.linalg.norm(normal) <= 1e-9 * np.linalg.norm(baseline) * np.linalg.norm(forward):
        return None
    across = np.cross(normal, baseline)  # towards the flame, across the baseline
    turn = np.stack([across / np.linalg.norm(across), normal / np.linalg.norm(normal)])
    angle = [_plane_of_pixels(view.camera, turn) for view in (a, b)]
    flame = [np.ravel(view.mask.any(0)) for view in (a, b)]
    if not all(f.any() for f in flame):
        return None
    low = min(x[f].min() for x, f in zip(angle, flame, strict=True))
    high = max(x[f].max() for x, f in zip(angle, flame, strict=True))
    if not high > low:
        return None
    profiles, seen = [], np.ones(PLANES, bool)
    for view, x in zip((a, b), angle, strict=True):
        place = np.floor((x - low) / (high - low) * PLANES)
        place = np.where((place >= 0) & (place < PLANES), place, PLANES).astype(int)
        seen &= np.bincount(place, minlength=PLANES + 1)[:PLANES] > 0
        light = light_above(view.image, view.static).mean(-1).reshape(len(view.image), -1)
        profiles.append(np.stack([np.bincount(place, row, PLANES + 1)[:PLANES] for row in light]))
    return tuple(profile[:, seen] for profile in profiles) if seen.sum() >= 4 else None


def _plane_of_pixels(camera: Camera, turn: np.ndarray) -> np.ndarray:
    """(H W,) angle about the baseline of every pixel's ray. turn: (2, 3) directions at angles 0 and 90 degrees."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
    ray = camera.world_to_camera[:3, :3].T @ np.linalg.solve(camera.K, pixels)
    return np.arctan2(*(turn @ ray)[::-1])


def _change(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation of how two profiles (F, planes) change; NaN where one hardly does, or there are few frames."""
    if len(a) < 4 or min(a.sum(), b.sum()) <= 0:
        return float("nan")
    swings = [p / p.sum() - (p / p.sum()).mean(0) for p in (a, b)]
    sizes = [np.sqrt((s**2).mean()) * s.size for s in swings]  # of the mean light in a plane
    return _correlation(*swings) if min(sizes) > CHANGES else float("nan")


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum() / power) if power > 0 else float("nan")


def _padded(masks: list[np.ndarray]) -> np.ndarray:
    """(C, H, W) of masks of several sizes."""
    size = np.max([mask.shape for mask in masks], axis=0)
    return np.stack([np.pad(mask, [(0, n - k) for n, k in zip(size, mask.shape, strict=True)]) for mask in masks])
