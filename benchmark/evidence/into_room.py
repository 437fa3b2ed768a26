"""Compare the light of `gof convert --into` with a rendered fire's own.

    gof background DATASET --out ROOM
    python -m gof_benchmark.evidence.into_room DATASET RESULT ROOM.ply

Takes about a minute, after `gof background`.

A dataset whose fire lights its room, and whose plates show the room without: the flame is put where it burnt into still
Gaussians of the plates. The change by its light in a camera's view of these is added to the plate, and compared with
the picture outside the flame mask. A row for each factor `light`; 0 is the room as it was.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.io.importers import read_result
from gof.io.into_room import LitRoom, put_into_room
from gof.render import render

LIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
FRAMES = 6


@dataclass
class IntoRoomConfig:
    """Compare a lit room with pictures of it. Prints a table."""

    dataset: tyro.conf.Positional[Path]
    """Dataset with plates and masks."""
    result: tyro.conf.Positional[Path]
    """Its flame."""
    room: tyro.conf.Positional[Path]
    """Its room without fire, of `gof background`."""


def main(argv: list[str] | None = None) -> None:
    """Print dB outside the flame, and the mean change in red, green and blue, for each factor."""
    options = tyro.cli(IntoRoomConfig, prog="python -m gof_benchmark.evidence.into_room", args=argv)
    dataset = Dataset.open(options.dataset)
    room = where_it_burnt(options.result, options.room)
    frames = np.linspace(0, len(dataset.times_s) - 1, FRAMES).round().astype(int)
    rows: dict[float, list[np.ndarray]] = {light: [] for light in LIGHTS}
    true = []
    for c, camera in enumerate(dataset.cameras):
        plate = dataset.static(c)
        for k in map(int, frames):
            mask = dataset.mask(c, k)
            if mask is None:
                raise GofError(f"{options.dataset}: has no flame masks; give a dataset of gof generate")
            picture, outside = dataset.image(c, k), mask < 0.5
            views = [view(replace(room, light=light), camera, float(dataset.times_s[k])) for light in LIGHTS]
            true.append((picture - plate)[outside].mean(0))
            for light, seen in zip(LIGHTS, views, strict=True):
                change = (np.clip(plate + seen - views[0], 0, 1) - plate)[outside]
                off = change - (picture - plate)[outside]
                rows[light].append(np.array([(off**2).mean(), *change.mean(0)]))
    print("| light | dB outside the flame | red | green | blue |\n|---|---|---|---|---|")
    for light, found in rows.items():
        off, *change = np.mean(found, 0)
        print(f"| {light:g} | {-10 * np.log10(off):.2f} | {' | '.join(f'{c:.4f}' for c in change)} |")
    print(f"| as filmed | | {' | '.join(f'{c:.4f}' for c in np.mean(true, 0))} |")


def where_it_burnt(result: Path, room: Path) -> LitRoom:
    """Return the flame in the room in which it was filmed, unmoved."""
    flame = read_result(result).gaussians
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "place.json"
        path.write_text(json.dumps({"room": str(room.absolute())}))
        away = put_into_room(flame, path).flame.position[0] - flame[flame.dynamic].position[0]
        path.write_text(json.dumps({"room": str(room.absolute()), "at": (-away).tolist()}))
        return put_into_room(flame, path)


def view(room: LitRoom, camera: Camera, time_s: float) -> np.ndarray:
    """Return (H, W, 3) the room alone, in the flame's light."""
    still = replace(room.room, color=room.color_at(time_s)[: len(room.room)])
    return np.clip(render(still, camera, time_s)["color"], 0, 1)


if __name__ == "__main__":
    main()
