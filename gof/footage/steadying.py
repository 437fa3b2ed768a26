"""Cameras that move a little, or change their exposure: measured on what stands still in the picture, and put right.

Corners of one frame of the clip are followed through the others (pyramidal Lucas-Kanade, on pictures of equal local
contrast, so that neither exposure nor the fire's light matters). Those that keep their places among each other stand
still; fire does not. Exposure changes all light that comes from them by one factor; the fire's own light on a room is
warm, and weaker farther away, and is not taken for exposure. A camera that stands on a tripod gets nothing: no picture
of its is resampled.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.errors import DataFormatError

MOST_MOVE = 0.02  # of the picture's width that is put right
STANDS_PX = 0.15  # smaller moves are left; the eight clips of a rig on tripods have 0.03 and less
LOOKED_AT = 1280  # px: longer side at which corners are followed
MOST_POINTS, FEWEST_POINTS = 600, 24
KEPT_SHARE = 0.5  # of the frames in which a point must be found again
BACK_PX, FIT_PX = 0.5, 1.0  # px by which a point may miss its place, followed back; and where the others put it
STILL_PX = 0.5  # px: a point's usual distance from where the others put it; beyond it moves by itself
BETTER = 0.8  # of a similarity's residual below which a homography is used: turns of wide lenses
CELLS, BLOCK = 64, 6  # across the picture's width, in which brightness is compared; and how many make a block
DARK, BRIGHT = 16, 235  # of 255: what is outside says little of light
FEWEST_CELLS = 40
UNLIKE = 0.2  # by which a cell's log light may scatter over the clip beyond the exposure: flame and LEDs have more
STEADY_GAIN = 0.03  # log light: smaller changes of exposure are left
AGREE, AGREE_SHARE = 0.02, 0.25  # log light by which channels, and cells, may differ: at least, and of the change
TRUSTED = 0.8  # share of the changes' squares in which they agree: small ones drown in noise, and tell little
FLICKER = 0.5  # share of the changes from frame to frame, beyond which they are a lamp's

Model = Literal["none", "similarity", "homography"]


@dataclass(frozen=True)
class FrameCorrection:
    """One frame's way to the clip's reference.

    Attributes:
        matrix: (3, 3) that takes its pixels to those of the reference, OpenCV's coordinates; None: it stands.
        gain: (3,) of linear light that brings it to the clip's usual exposure; None: nothing to do.
        reference: (H, W, 3) uint8, seen where the moved frame shows nothing at the rim.
    """

    matrix: np.ndarray | None
    gain: np.ndarray | None
    reference: np.ndarray | None = field(default=None, repr=False)

    def applied(self, picture: np.ndarray) -> np.ndarray:
        """Return the (H, W, 3) uint8 picture as the camera would have taken it in its usual place and exposure."""
        import cv2

        if self.gain is not None:
            light = srgb_to_linear(np.arange(256) / 255)[:, None] * self.gain
            tables = np.uint8(np.rint(255 * linear_to_srgb(np.clip(light, 0, 1))))
            picture = cv2.LUT(picture, tables.reshape(256, 1, 3))
        if self.matrix is not None:
            size = picture.shape[1::-1]
            covered = cv2.warpPerspective(
                np.ones(picture.shape[:2], np.uint8), self.matrix, size, flags=cv2.INTER_NEAREST
            )
            moved = cv2.warpPerspective(
                picture, self.matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
            )
            picture = np.where(covered[..., None] > 0, moved, picture if self.reference is None else self.reference)
        return picture


@dataclass(frozen=True)
class Steadying:
    """A clip's corrections, and what was found.

    Attributes:
        frames: one correction per frame; empty: none is needed.
        model: of the camera's moves.   points: that stand still; 0: too few to tell.
        moved_px: (N,) largest move of a corner of the picture from the reference, px.
        residual_px: rms distance of the still points from where the moves put them.
        gain: (N, 3) light of the frames over the usual, by what stands still; all 1 where nothing is put right.
        notes: in words.
    """

    frames: tuple[FrameCorrection, ...]
    model: Model
    points: int
    moved_px: np.ndarray
    residual_px: float
    gain: np.ndarray
    notes: tuple[str, ...]

    @property
    def figures(self) -> dict:
        """Return what a dataset says of it."""
        low, high = self.gain.min(0), self.gain.max(0)
        return {
            "model": self.model,
            "points": self.points,
            "moved_px": round(float(self.moved_px.max(initial=0.0)), 3),
            "residual_px": round(self.residual_px, 3),
            "gain": [[round(float(a), 4), round(float(b), 4)] for a, b in zip(low, high, strict=True)],
        }


# ---- looking ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StillPoints:
    """A clip's still things as its frames show them.

    Attributes:
        size: width, height of the pictures, px.
        reference: (H, W, 3) uint8 frame that the others are compared with, and its place in the clip.
        points: (P, 2) px in it.   tracks: (N, P, 2) px of the same in every frame; NaN where they are not found.
        small: (N, h, w, 3) uint8 small pictures.
    """

    size: tuple[int, int]
    reference: np.ndarray
    place: int
    points: np.ndarray
    tracks: np.ndarray
    small: np.ndarray


def look(clip: Collection[np.ndarray], reference: np.ndarray, place: int) -> StillPoints:
    """Follow the corners of `reference`, the clip's frame number `place`, through the clip: (H, W, 3) uint8 RGB."""
    import cv2

    height, width = reference.shape[:2]
    scale = min(1.0, LOOKED_AT / max(width, height))
    base = _even(reference, scale)
    spacing = max(4, round(0.012 * max(base.shape)))
    found = cv2.goodFeaturesToTrack(base, MOST_POINTS, 0.02, spacing, blockSize=5)
    points = np.zeros((0, 1, 2), np.float32) if found is None else found
    step = max(3, round(width / CELLS))
    shape = (max(1, round(width / step)), max(1, round(height / step)))
    tracks, small = [], []
    for frame in clip:
        small.append(cv2.resize(frame, shape, interpolation=cv2.INTER_AREA))
        tracks.append(_followed(base, _even(frame, scale), points))
    pixels = (points.reshape(-1, 2) + 0.5) / scale - 0.5
    return StillPoints(
        (width, height), reference, place, pixels, (np.array(tracks) + 0.5) / scale - 0.5, np.array(small)
    )


def _even(picture: np.ndarray, scale: float) -> np.ndarray:
    """Return (h, w) uint8 of one local contrast everywhere, at the size at which corners are followed."""
    import cv2

    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = grey.astype(np.float32)
    detail = grey - cv2.GaussianBlur(grey, (0, 0), 8)
    contrast = np.sqrt(cv2.GaussianBlur(detail * detail, (0, 0), 8)) + 3.0
    return np.clip(128 + 48 * detail / contrast, 0, 255).astype(np.uint8)


def _followed(base: np.ndarray, now: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (P, 2) places of the points in a frame; NaN where following them there and back does not close."""

    if not len(points):
        return np.zeros((0, 2))
    followed, ok = _lucas_kanade(base, now, points)
    back, returned = _lucas_kanade(now, base, followed)
    off = np.linalg.norm((back - points).reshape(-1, 2), axis=1)
    kept = (ok.ravel() > 0) & (returned.ravel() > 0) & (off <= BACK_PX)
    return np.where(kept[:, None], followed.reshape(-1, 2), np.nan)


def _lucas_kanade(first: np.ndarray, then: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (P, 1, 2) float32 places of the first picture's points in the other, and (P, 1) which were found."""
    import cv2

    end = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.003)
    places, found, _ = cv2.calcOpticalFlowPyrLK(
        first, then, points, points.copy(), winSize=(21, 21), maxLevel=4, criteria=end, minEigThreshold=1e-3
    )
    return places, found


# ---- moves -----------------------------------------------------------------------------------------------------------


def find_moves(seen: StillPoints, known: np.ndarray) -> tuple[np.ndarray, Model, int, float]:
    """Return (N, 3, 3) that take each frame's pixels to the reference's, their model, how many points stand still, and
    the rms px to which they do.

    Args:
        known: (K,) places of the frames that say which points stand still, and where.
    Returns:
        "none" and unit matrices where too few points stand still to tell.
    """
    still = np.isfinite(seen.tracks[known]).all(-1).mean(0) >= KEPT_SHARE if seen.tracks.size else np.zeros(0, bool)
    unit = np.tile(np.eye(3), (len(seen.tracks), 1, 1))
    if still.sum() < FEWEST_POINTS:
        return unit, "none", 0, 0.0
    found = _fitted(seen, known, still, "similarity")
    if found is None:
        return unit, "none", 0, 0.0
    stands = np.quantile(corner_moves(found[0], seen.size), 0.9) <= STANDS_PX
    turns = None if stands else _fitted(seen, known, found[1], "homography")
    if turns is not None and turns[2] < BETTER * found[2] and turns[1].sum() >= 0.7 * found[1].sum():
        return turns[0], "homography", int(turns[1].sum()), turns[2]
    return found[0], "similarity", int(found[1].sum()), found[2]


def _fitted(
    seen: StillPoints, known: np.ndarray, still: np.ndarray, model: Model
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return the moves by a model, which of the points (P,) stand still by them, and their rms px; None: too few do."""
    places = seen.points.copy()
    for _ in range(3):
        moves = np.array([_move(track, places, still, model) for track in seen.tracks])
        if not np.isfinite(moves[known]).all((1, 2)).mean() >= KEPT_SHARE:
            return None
        mapped = _mapped(moves, seen.tracks)
        # One frame's own noise is in the points' first places; the mean over the clip has little of it.
        usual = _median(np.where(still[:, None], mapped[known], 0.0), 0)
        off = np.linalg.norm(mapped - usual, axis=-1)
        own = _median(np.where(still, off[known], np.inf), 0)
        now = still & (own <= STILL_PX)
        if now.sum() < FEWEST_POINTS:
            return None
        still, places = now, np.where(now[:, None], usual, places)
    moves = _filled(np.array([_move(track, places, still, model) for track in seen.tracks]))
    off = np.linalg.norm(_mapped(moves, seen.tracks) - places, axis=-1)[:, still]
    inside = off[np.isfinite(off) & (off <= FIT_PX)]
    return moves, still, float(np.sqrt(np.mean(inside**2)))


def _mapped(moves: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (N, P, 2): the points of every frame, moved."""
    out = np.einsum("nij,npj->npi", moves[:, :, :2], points) + moves[:, None, :, 2]
    return out[..., :2] / out[..., 2:]


def _move(track: np.ndarray, places: np.ndarray, still: np.ndarray, model: Model) -> np.ndarray:
    """Return (3, 3) from a frame's points (P, 2) to their places (P, 2), robustly; NaN where too few are found."""
    import cv2

    known = still & np.isfinite(track).all(1)
    if known.sum() < FEWEST_POINTS // 2:
        return np.full((3, 3), np.nan)
    now, then = track[known], places[known]
    first, kept = cv2.estimateAffinePartial2D(now, then, ransacReprojThreshold=FIT_PX, maxIters=2000, confidence=0.999)
    if first is None or kept.sum() < 0.5 * len(now):
        return np.full((3, 3), np.nan)
    matrix = np.vstack([first, [0, 0, 1]])
    for _ in range(6):
        off = np.linalg.norm(_mapped(matrix[None], now[None])[0] - then, axis=1)
        spread = max(1.4826 * float(np.median(off)), 0.03)
        weight = np.clip(1 - (off / (4 * spread)) ** 2, 0, None) ** 2  # Tukey's
        matrix = (_similarity if model == "similarity" else _homography)(now, then, weight)
    return matrix


def _similarity(now: np.ndarray, then: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (3, 3) of the weighted least squares: complex then = a * now + b (Umeyama, in the plane)."""
    w = weight / weight.sum()
    source, target = now @ [1, 1j], then @ [1, 1j]
    source_0, target_0 = w @ source, w @ target
    a = (w * np.conj(source - source_0)) @ (target - target_0) / (w @ np.abs(source - source_0) ** 2)
    b = target_0 - a * source_0
    return np.array([[a.real, -a.imag, b.real], [a.imag, a.real, b.imag], [0, 0, 1]])


def _homography(now: np.ndarray, then: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (3, 3) of the weighted least squares: h33 = 1, about the points' middle and size."""
    middle, size = now.mean(0), max(float(now.std()), 1e-9)
    norm = np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]])
    (x, y), (u, v) = ((now - middle) / size).T, ((then - middle) / size).T
    one, zero, root = np.ones_like(x), np.zeros_like(x), np.sqrt(weight)
    rows = np.concatenate(
        [
            root[:, None] * np.stack([x, y, one, zero, zero, zero, -u * x, -u * y], 1),
            root[:, None] * np.stack([zero, zero, zero, x, y, one, -v * x, -v * y], 1),
        ]
    )
    solved = np.linalg.lstsq(rows, np.concatenate([root * u, root * v]), rcond=None)[0]
    matrix = np.linalg.inv(norm) @ np.append(solved, 1.0).reshape(3, 3) @ norm
    return matrix / matrix[2, 2]


def _filled(moves: np.ndarray) -> np.ndarray:
    """Return the moves, where a frame has none that of the nearest one that has."""
    good = np.flatnonzero(np.isfinite(moves).all((1, 2)))
    return moves[good[np.abs(good[:, None] - np.arange(len(moves))).argmin(0)]]


def corner_moves(moves: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return (N,) px: how far the corner of the picture that moves most moves."""
    width, height = size
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], np.float64) - 0.5
    return np.linalg.norm(_mapped(moves, np.tile(corners, (len(moves), 1, 1))) - corners, axis=-1).max(1)


# ---- exposure --------------------------------------------------------------------------------------------------------


def find_gains(seen: StillPoints, moves: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, str]:
    """Return (N, 3) light of every frame over the usual, and a note; all 1 where it is steady, or changes as a fire's
    light does.

    Args:
        moves: (N, 3, 3) of `find_moves`.   known: (K,) places of the frames whose median is the usual.
    """
    light, valid = _light_of_cells(seen, moves)
    count, ones = len(light), np.ones((len(light), 3))
    log = np.where(valid, np.log(np.maximum(light, 1e-6)), np.nan)  # (N, cells, 3)
    gain = np.zeros((count, 3))
    cells = valid[known].mean(0) >= KEPT_SHARE
    for _ in range(3):
        even = log - gain[:, None]
        level = _median(even[known], 0)
        beyond = even - level
        alike = cells & (1.4826 * _median(np.abs(beyond[known]), 0) <= UNLIKE)
        if (alike.sum(0) < FEWEST_CELLS).sum() > 1:
            return ones, ""
        change = np.where(alike, log - level, np.nan)
        gain = _median(change, 1)
        gain -= _median(gain[known], 0)
    measured = np.isfinite(gain).all(0)  # a channel may be dark everywhere
    mean = gain[:, measured].mean(1)
    changed = np.abs(mean) > STEADY_GAIN / 2
    if np.ptp(np.quantile(mean, [0.02, 0.98])) <= STEADY_GAIN or not changed.any():
        return ones, ""
    limit = np.maximum(AGREE, AGREE_SHARE * np.abs(mean))
    channels = np.ptp(gain[:, measured], axis=1) <= limit
    height, width = seen.small.shape[1:3]
    blocks = _by_block(_mean(change[..., measured] - gain[:, None, measured], -1), (height, width))
    even_space = 0.5 * np.ptp(np.nanquantile(blocks, [0.1, 0.9], axis=1), axis=0) <= limit
    trusted = channels & even_space
    percent = f"{100 * np.expm1(np.ptp(mean)):.0f} %"
    told_by = np.where(changed, mean**2, 0.0)
    if told_by[trusted].sum() < TRUSTED * told_by.sum():
        return ones, f"the light on what stands still changes by {percent}, unequally, as a fire's own does: it is left"
    smooth = _smoothed(mean)
    if (mean - smooth).std() > FLICKER * mean.std():
        return ones, (
            f"what stands still flickers by {percent} from frame to frame, as under lamps: it is left; film by "
            "daylight, or at a shutter of whole periods of the mains (1/50, 1/100 s; 1/60, 1/120 s)"
        )
    filled = np.where(np.isfinite(gain), gain, mean[:, None])
    good = np.flatnonzero(trusted | ~changed)
    filled = np.stack([np.interp(np.arange(count), good, filled[good, c]) for c in range(3)], 1)
    return np.exp(filled), f"the exposure changes by {percent}: every frame is brought to the usual one"


def _light_of_cells(seen: StillPoints, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, cells, 3) linear light of the small pictures, put in place, and where it says something."""
    import cv2

    height, width = seen.small.shape[1:3]
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV's pixel centres are integers
    to_small = np.linalg.inv(half) @ np.diag([width / seen.size[0], height / seen.size[1], 1.0]) @ half
    back = np.linalg.inv(to_small)
    light, valid = [], []
    for picture, move in zip(seen.small, moves, strict=True):
        matrix, size = to_small @ move @ back, (width, height)
        placed = cv2.warpPerspective(picture, matrix, size, borderMode=cv2.BORDER_REPLICATE).reshape(-1, 3)
        inside = cv2.warpPerspective(np.full((height, width), 255, np.uint8), matrix, size).reshape(-1, 1) == 255
        light.append(srgb_to_linear(placed / 255))
        valid.append(inside & (placed > DARK) & (placed < BRIGHT))
    return np.array(light), np.array(valid)


def _by_block(cells: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return (N, blocks): medians over `BLOCK` by `BLOCK` of the (N, h * w) cells, NaN where few say something."""
    height, width = (side // BLOCK * BLOCK for side in shape)
    image = cells.reshape(-1, *shape)[:, :height, :width].reshape(-1, height // BLOCK, BLOCK, width // BLOCK, BLOCK)
    blocks = image.transpose(0, 1, 3, 2, 4).reshape(len(cells), -1, BLOCK * BLOCK)
    enough = np.isfinite(blocks).mean(-1) >= 0.25
    return np.where(enough, _median(blocks, -1), np.nan)


def _mean(values: np.ndarray, axis: int) -> np.ndarray:
    """Return the mean of what is there; NaN where nothing is."""
    known = np.isfinite(values)
    return np.where(known, values, 0).sum(axis) / np.where(known.any(axis), known.sum(axis), np.nan)


def _median(values: np.ndarray, axis: int) -> np.ndarray:
    """Return the median of what is there; NaN where nothing is. NumPy's `nanmedian` takes several times as long."""
    ordered, counts = np.sort(values, axis), (~np.isnan(values)).sum(axis, keepdims=True)  # NaN come last
    low, high = (np.take_along_axis(ordered, k, axis) for k in (np.maximum(counts - 1, 0) // 2, counts // 2))
    return ((low + high) / 2).squeeze(axis)


def _smoothed(series: np.ndarray) -> np.ndarray:
    """Return the series without what changes from frame to frame: means of nine at straight lines' weights."""
    half = min(4, (len(series) - 1) // 2)
    padded = np.pad(series, half, mode="reflect", reflect_type="odd")
    return np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid")


# ---- both ------------------------------------------------------------------------------------------------------------


def steady(seen: StillPoints, known: np.ndarray, name: str, numbers: np.ndarray) -> Steadying:
    """Return the corrections of a clip.

    Args:
        known: (K,) places of the frames that decide what stands still and what is usual: those for training.
        name: of the video, for messages.   numbers: (N,) stored frame numbers, for messages.
    Raises:
        DataFormatError: the camera moves by more than `MOST_MOVE` of the picture's width.
    """
    moves, model, points, residual = find_moves(seen, known)
    moved, width = corner_moves(moves, seen.size), seen.size[0]
    notes = []
    if moved.max() > MOST_MOVE * width:
        most = int(moved.argmax())
        raise DataFormatError(
            f"{name}: the camera moves by up to {moved[most]:.1f} px, {moved[most] / width:.1%} of the picture's width "
            f"(frame {numbers[most]}; by {points} points that stand still); up to {MOST_MOVE:.0%} are put right. Put "
            "the camera on a tripod and film again, or choose a part in which it stands: --start and --frames"
        )
    moves_much = np.quantile(moved, 0.9) > STANDS_PX
    if moves_much:
        notes.append(
            f"the camera moves by up to {moved.max():.1f} px ({moved.max() / width:.2%} of the width): every frame is "
            f"brought to frame {numbers[seen.place]}'s place, by {points} points, to {residual:.2f} px"
        )
    else:
        moves = np.tile(np.eye(3), (len(moves), 1, 1))
    gain, note = find_gains(seen, moves, known)
    notes += [note] if note else []
    put_right = bool((gain != 1).any())
    frames: tuple[FrameCorrection, ...] = ()
    if moves_much or put_right:
        usual = FrameCorrection(None, 1 / gain[seen.place] if put_right else None).applied(seen.reference)
        frames = tuple(
            FrameCorrection(move if moves_much else None, 1 / g if put_right else None, usual if moves_much else None)
            for move, g in zip(moves, gain, strict=True)
        )
    return Steadying(frames, model, points, moved, residual, gain, tuple(f"{name}: {note}" for note in notes))


def by_number(numbers: np.ndarray, steadying: Steadying) -> Mapping[int, FrameCorrection]:
    """Return the corrections by the stored numbers of their frames; empty where none is needed."""
    return dict(zip(map(int, numbers), steadying.frames, strict=True)) if steadying.frames else {}
