"""Results side by side at one instant of one camera: pictures, enlarged parts, errors and velocities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.colour import linear_to_srgb
from gof.core.errors import DataFormatError
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.image import psnr
from gof.evaluate.leaderboard import EvaluatedResult
from gof.evaluate.scoring import is_flame_alone
from gof.footage.flame_mask import flame_mask
from gof.io.importers import ImportOptions, read_result
from gof.look.animation import brightest_frame, original
from gof.look.panels import Subject, picture
from gof.look.path import Shot
from gof.look.tiles import Box, Row, error_tile, picture_tile, velocity_tile
from gof.look.velocity import fastest, of_result, true_there, unit
from gof.reconstruct.observation import light_above

Kind = Literal["picture", "parts", "error", "velocity"]
KINDS: tuple[Kind, ...] = get_args(Kind)
ERROR_SCALES = (0.05, 0.1, 0.2, 0.5)  # display values
PART = 1 / 3  # side of an enlarged part, of the picture's shorter side


@dataclass(frozen=True)
class Moment:
    """One frame of one camera of a dataset, by their numbers."""

    dataset: Dataset
    number: int
    frame: int

    @classmethod
    def near(cls, dataset: Dataset, camera: int, time_s: float | None) -> Moment:
        """Return the frame nearest to a time; by default the held-out one with most flame."""
        if time_s is None:
            return cls(dataset, camera, brightest_frame(dataset))
        return cls(dataset, camera, int(abs(dataset.camera_times_s(camera) - time_s).argmin()))

    @property
    def in_words(self) -> str:
        held_out = "held out" if self.frame in self.dataset.test_frames else "not held out"
        return f"{self.camera.name}, frame {self.frame} at {self.time_s:.3f} s, {held_out}"

    @property
    def camera(self) -> Camera:
        return self.dataset.cameras[self.number]

    @property
    def time_s(self) -> float:
        return float(self.dataset.camera_times_s(self.number)[self.frame])

    @cached_property
    def recorded(self) -> np.ndarray:
        """(H, W, 3) display values."""
        return self.dataset.image(self.number, self.frame)

    @cached_property
    def plate(self) -> np.ndarray:
        """(H, W, 3) display values: the dataset's, without fire."""
        return self.dataset.static(self.number)

    @cached_property
    def flame(self) -> np.ndarray:
        """(H, W) what a pixel counts for as flame: the dataset's mask, else a motion mask; none on the sync board."""
        mask = self.dataset.mask(self.number, self.frame)
        mask = flame_mask(self.recorded, self.plate).astype(np.float32) if mask is None else mask
        return mask if self.counts is None else mask * self.counts

    @cached_property
    def counts(self) -> np.ndarray | None:
        """(H, W) what a pixel counts for: 0 on the sync board, whose lamps no flame model draws; None = all count."""
        return self.dataset.board_weight(self.number)

    def judged(self, image: np.ndarray) -> np.ndarray:
        """Return the picture (H, W, 3) with what was recorded where nothing counts."""
        return image if self.counts is None else self.recorded + self.counts[..., None] * (image - self.recorded)

    def flame_db(self, image: np.ndarray) -> str:
        """PSNR on flame pixels in words; nothing where there is no flame."""
        found = psnr(image, self.recorded, self.flame)
        return "" if found is None else f"flame {found:.2f} dB"


def subject(
    name: str, gaussians: MovingGaussians, method: str, path: Path, moment: Moment, flame_only: bool = False
) -> Subject:
    """Return a result as `gof evaluate` draws it: flames alone over their plates, other methods' Gaussians over black.

    Args:
        method: the importer that read it.   path: the result's file, beside which its own plates may lie.
        flame_only: another method's result is a flame alone, too.
    """
    alone = is_flame_alone(gaussians, method, flame_only)
    return Subject(name, gaussians, plate=_plate(path, moment) if alone else None)


def scored_subject(result: EvaluatedResult, moment: Moment) -> Subject:
    """Return a result of `gof evaluate`, read and drawn as it was scored. Raises DataFormatError: see `read_again`."""
    gaussians = read_again(result).measured_from(moment.dataset.datum)
    path = scored_file(result)
    over_plates = result.scores.import_.over_plates
    return Subject(result.name, gaussians, plate=_plate(path, moment) if over_plates else None)


def read_again(result: EvaluatedResult) -> MovingGaussians:
    """Return the Gaussians behind the scores: the file that was scored, or the one in the folder, read and moved as it
    was.

    Raises:
        DataFormatError: the file is gone, or damaged.
    """
    origin = result.scores.import_
    options = ImportOptions() if origin.options is None else origin.options.options()
    gaussians = read_result(scored_file(result), options).gaussians
    return gaussians if origin.alignment is None else gaussians.transformed(np.array(origin.alignment.matrix))


def scored_file(result: EvaluatedResult) -> Path:
    """Return the file behind the scores. Raises DataFormatError: it is gone."""
    origin = result.scores.import_
    candidates = [result.folder / "result.npz", result.folder / "reconstruct" / "result.npz"]
    if origin.path is not None:
        candidates.insert(0, Path(origin.path))
    path = next((p for p in candidates if p.exists()), None)
    if path is None:
        looked = ", ".join(map(str, candidates))
        raise DataFormatError(f"{result.folder}: the result is not there any more (looked for {looked})")
    return path


def _plate(path: Path, moment: Moment) -> np.ndarray:
    return background(moment.dataset, moment.number, path)


def comparison(
    subjects: Sequence[Subject], moment: Moment, parts: Sequence[Box] | int = 2, shown: Sequence[Kind] = KINDS
) -> list[Row]:
    """Return rows of tiles, the first column of what was recorded, then one of each result.

    Args:
        parts: which are enlarged, or how many: then those where the results' mean error is largest, for all the same.
        shown: "picture", with the flame's PSNR; "parts" of it; "error", of the plate alone in the first column, and
            none on the sync board; "velocity" where anything moves, the true one at the first result's Gaussians in
            the first column.
    """
    shot = Shot(moment.camera, moment.time_s)
    drawn = [np.clip(picture(one, shot), 0, 1) for one in subjects]
    parts = parts if "parts" in shown else 0
    judged = [moment.judged(image) for image in drawn]
    boxes = largest_errors(judged, moment.recorded, parts) if isinstance(parts, int) else list(parts)
    rows: list[Row] = []
    if "picture" in shown:
        named = zip(subjects, drawn, strict=True)
        whole = [picture_tile(image, one.name, moment.flame_db(image)) for one, image in named]
        first = picture_tile(moment.recorded, original(moment.dataset))
        rows.append([replace(one, boxes=tuple(boxes)) for one in (first, *whole)])
    for number, box in enumerate(boxes):
        rows.append([replace(picture_tile(box.of(image), ""), frame=number) for image in (moment.recorded, *drawn)])
    if "error" in shown:
        rows.append(_errors(judged, moment))
    moving = _velocities(subjects, moment) if "velocity" in shown else []
    return [*rows, moving] if moving else rows


def _errors(drawn: Sequence[np.ndarray], moment: Moment) -> Row:
    """Show errors of judged pictures, on the smallest scale that holds nearly all; the plate's own may go beyond."""
    found = np.concatenate([np.abs(image - moment.recorded).mean(-1).ravel() for image in drawn])
    most = next((scale for scale in ERROR_SCALES if scale >= np.quantile(found, 0.999)), 1.0)
    note = moment.flame_db(moment.plate)
    plate = error_tile(moment.judged(moment.plate), moment.recorded, "error: background alone", note, most)
    return [plate, *(error_tile(image, moment.recorded, "error", most=most) for image in drawn)]


def _velocities(subjects: Sequence[Subject], moment: Moment) -> Row:
    """Empty where nothing moves."""
    states = [one.at(moment.time_s) for one in subjects]
    fields = [of_result(state, moment.camera, known) for state, known in states]
    if not any(np.abs(one.flow).max(initial=0) > 0 for one in fields):
        return []
    speed, first = unit(moment.dataset), None
    longest = fastest(fields)
    if moment.dataset.has_velocity:
        true = true_there(states[0][0], moment.dataset, moment.camera, moment.time_s)
        longest = fastest([true, *fields])
        first = velocity_tile(true, "true velocity", longest, speed, f"where {subjects[0].name} has Gaussians")
    return [first, *(velocity_tile(one, "velocity", longest, speed) for one in fields)]


def largest_errors(drawn: Sequence[np.ndarray], recorded: np.ndarray, count: int) -> list[Box]:
    """Square parts that do not overlap, where the mean error of all pictures (H, W, 3) is largest; at most `count`."""
    height, width = recorded.shape[:2]
    side = max(1, round(PART * min(height, width)))
    error = np.mean([np.abs(one - recorded).mean(-1) for one in drawn], axis=0)
    total = cv2.boxFilter(error, -1, (side, side), anchor=(0, 0), borderType=cv2.BORDER_REFLECT)
    total = total[: height - side + 1, : width - side + 1].copy()
    found: list[Box] = []
    while len(found) < count and np.isfinite(total).any():
        y, x = map(int, np.unravel_index(int(np.argmax(total)), total.shape))
        found.append(Box(x, y, side, side))
        total[max(0, y - side + 1) : y + side, max(0, x - side + 1) : x + side] = -np.inf
    return sorted(found, key=lambda box: box.y)


# ----------------------------------------------------------------
# A picture, the plate that was made of the clip, and what was taken out: what the removal of the fire is worth.

# By provenance, as `gof ingest --plates` writes it.
PLATE_KINDS = {"steady": "background (steady light)", "minimum": "background (minimum)"}


def fire_removal(dataset: Dataset, frame: int, cameras: Sequence[int], result: Path | None = None) -> list[Row]:
    """Return a row for each camera: picture, plate, that of a result (in the fire's light) where it has one, fire,
    difference.

    The difference is between the picture and the last plate; its note is what is left of it where neither fire nor a
    sync board is: error of the plate, light of the fire on the room, noise.

    Args:
        cameras: their numbers.   result: a result's file, beside which its own plates may lie.
    """
    return [_row(dataset, frame, camera, result) for camera in cameras]


def _row(dataset: Dataset, frame: int, camera: int, result: Path | None) -> Row:
    image, plate = dataset.image(camera, frame), dataset.static(camera)
    name = dataset.cameras[camera].name
    row = [picture_tile(image, f"{original(dataset)}, {name}"), picture_tile(plate, _plate_name(dataset))]
    lit = None if result is None else background(dataset, camera, result)[..., :3]
    if lit is not None and not np.array_equal(lit, plate):
        row.append(picture_tile(lit, "background of the result"))
        plate = lit
    flame = flame_mask(image, dataset.static(camera))
    alone = linear_to_srgb(light_above(image, plate))
    row.append(picture_tile(alone, "the fire's own light"))
    board = dataset.board_weight(camera)
    counts = ~flame if board is None else ~flame & (board > 0.5)
    rest = np.abs(image - plate).mean(-1)[counts]
    note = f"mean {rest.mean():.4f} outside the flame" if rest.size else ""
    row.append(replace(error_tile(plate, image, "difference", note), outline=flame))
    return row


def _plate_name(dataset: Dataset) -> str:
    kind = dataset.description.provenance.get("plate")
    if kind is None:
        return "background" if dataset.description.is_filmed else "background (simulated without fire)"
    return PLATE_KINDS.get(str(kind), f"background ({kind})")
