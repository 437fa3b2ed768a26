"""`gof capture annotate`: gives a dataset what the capture knows: soft masks of the LED board, per-pixel row delays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import tyro

from gof.cameras import Camera
from gof.capture.locate import BoardNotFound, Summary, locate
from gof.capture.mask import board_mask
from gof.capture.template import BoardTemplate
from gof.dataset import Dataset
from gof.errors import DataFormatError, GofError
from gof.footage import stored_frames
from gof.io.files import atomic_path, write_json
from gof.lens import ROLL_DEG, Lens, Turn, prepare, read_cameras, row_delay

LOOK_AT = 160  # frames in which the board is looked for


@dataclass(frozen=True)
class AnnotateConfig:
    """Add soft masks of the LED board and per-pixel row delays to a dataset of `gof static`.

    Every camera in which the board is found gets "board_mask", an 8-bit picture (255 = board), so that scores and losses
    leave its flicker out. With --cameras, every camera with a rolling shutter and lens distortion gets "row_delay", float32
    seconds after the sensor's first line, because undistortion bends the sensor's lines.
    """

    dataset: tyro.conf.Positional[Path]
    footage: list[Path] | None = None
    """The cameras' videos as given to gof static, to look for the board at full size; else the dataset's own pictures."""
    cameras: Path | None = None
    """The file given to gof static --cameras, when the footage is not yet undistorted."""
    template: str = "paper_rig"
    """Board: gof_board, paper_rig, or a JSON file."""
    json: Path | None = None
    """Also write what was added to this file."""


def find_mask(pictures: Iterable[np.ndarray], template: BoardTemplate) -> np.ndarray:
    """(H, W) uint8, 255 on the board, from RGB pictures of a fixed camera.

    Raises:
        BoardNotFound: the board cannot be found in them.
    """
    summary = Summary()
    for picture in islice(pictures, LOOK_AT):
        summary.add(picture)
    height, width = summary.low.shape
    return np.rint(255 * board_mask(locate(summary, template), template, (width, height))).astype(np.uint8)


def dataset_row_delay(lens: Lens, turn: Turn, camera: Camera) -> np.ndarray:
    """(H, W) float32 s: `gof.lens.row_delay` at the pixels of a dataset camera made from footage of this lens."""
    import cv2

    upright = lens.turned(turn)
    stored = camera.scaled(upright.width, upright.height)
    delay = row_delay(lens, turn, camera.readout, stored.row_time_s)
    return cv2.resize(delay.astype(np.float32), (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def annotate(
    dataset: Dataset, template: BoardTemplate, footage: list[Path] | None = None, cameras: Path | None = None
) -> dict[str, list[str]]:
    """Write the pictures, then dataset.json.

    Returns:
        what was added and what was not, in words, per camera.
    Raises:
        GofError: another number of videos than cameras.
        DataFormatError: see `gof.lens.read_cameras`; footage of another size than the lens.
    """
    import cv2

    count = len(dataset.cameras)
    if footage and len(footage) != count:
        raise GofError(f"--footage: give one video per camera of the dataset ({count}), in their order")
    lenses = (
        [Lens.from_dict(d, f"{cameras}: camera {c}") for c, d in enumerate(read_cameras(cameras, count))]
        if cameras
        else None
    )
    turns: dict[int, Turn] = {roll: turn for turn, roll in ROLL_DEG.items()}
    entries = {e["name"]: e for e in dataset.meta["cameras"]}
    added: dict[str, list[str]] = {}
    for c, camera in enumerate(dataset.cameras):
        entry, notes = entries[camera.name], added.setdefault(camera.name, [])
        turn = turns.get(round(entry.get("roll_deg", 0)))
        if turn is None:
            raise DataFormatError(
                f"{dataset.path}/dataset.json: camera '{camera.name}': roll_deg must be one of {list(turns)}"
            )
        folder = f"cameras/{camera.name}"
        try:
            if footage:
                mask = find_mask(stored_frames(footage[c]), template)
                lens = lenses[c] if lenses else Lens(mask.shape[1], mask.shape[0], np.eye(3))
                if mask.shape != (lens.height, lens.width):
                    raise DataFormatError(
                        f"{footage[c]}: is {mask.shape[1]}x{mask.shape[0]}, its lens {lens.width}x{lens.height}"
                    )
                mask = prepare(mask, lens, turn)
            else:
                frames = range(len(dataset.times_s))
                mask = find_mask((np.uint8(np.rint(255 * dataset.image(c, k))) for k in frames), template)
            mask = cv2.resize(mask, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
            with atomic_path(dataset.path / folder / "board_mask.png") as temporary:
                cv2.imwrite(str(temporary), mask)
            entry["board_mask"] = f"{folder}/board_mask.png"
            notes.append(f"board mask, {(mask > 127).mean():.1%} of the picture")
        except BoardNotFound as e:
            notes.append(f"no board mask: {e}" + ("" if footage else " Small pictures? Give the --footage"))
        if lenses and lenses[c].distortion.any() and camera.row_time_s > 0:
            delay = dataset_row_delay(lenses[c], turn, camera)
            with atomic_path(dataset.path / folder / "row_delay.npy") as temporary:
                np.save(temporary, delay)
            entry["row_delay"] = f"{folder}/row_delay.npy"
            notes.append(
                f"row delays, up to {1e6 * np.abs(delay - straight_lines(camera)).max():.0f} us from straight lines"
            )
    write_json(dataset.path / "dataset.json", dataset.meta)
    return added


def straight_lines(camera: Camera) -> np.ndarray:
    """(H, W) s: the delays of a camera whose sensor lines are lines of its picture."""
    return row_delay(Lens(camera.width, camera.height, camera.K), "none", camera.readout, camera.row_time_s)


def main(argv: list[str]) -> int:
    """Annotate a dataset and say what was added."""
    config = tyro.cli(AnnotateConfig, prog="gof capture annotate", args=argv)
    added = annotate(Dataset.open(config.dataset), BoardTemplate.load(config.template), config.footage, config.cameras)
    for name, notes in added.items():
        print(f"{name}: {'; '.join(notes)}")
    if config.json:
        write_json(config.json, added)
    return 0
