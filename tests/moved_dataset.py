"""A dataset whose world and clock lie far from zero."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from gof.core.datum import Datum
from gof.core.description import DatasetDescription
from gof.core.files import read_json, write_json


def moved_copy(folder: Path, out: Path, by: Datum) -> Path:
    """Copy a dataset with its world and its clock moved away from zero; its pictures are links to the same files.

    Args:
        folder: the dataset.
        out: folder of the copy; must not be there.
        by: where the origin and time 0 go to, m and s.
    Returns: `out`.
    """
    shutil.copytree(folder, out, copy_function=os.link)
    said = DatasetDescription.read(folder)
    back = Datum(tuple(-x for x in by.position), -by.time_s)

    def later(times_s: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(t + by.time_s for t in times_s)

    cameras = tuple(
        replace(
            entry,
            world_to_camera=tuple(map(tuple, camera.world_to_camera.tolist())),
            time_s=None if entry.time_s is None else later(entry.time_s),
        )
        for entry in said.cameras
        for camera in [entry.camera().measured_from(back)]
    )
    (out / "dataset.json").unlink()
    replace(said, cameras=cameras, time_s=later(said.time_s)).write(out)
    for store in out.rglob("*.zarr/zarr.json"):
        content = read_json(store)
        attributes = content["attributes"]
        attributes["time_s"] = list(later(attributes["time_s"]))
        for row, x in zip(attributes["index_to_world"], by.position, strict=False):
            row[3] += x
        store.unlink()
        write_json(store, content)
    return out
