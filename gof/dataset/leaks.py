"""Held-out frames stay unseen: a file that was computed from one is refused before anything learns from it.

Every file that is computed from a clip's pictures says which frames went into it: a dataset's plates, depth maps and
poses in dataset.json (`made_from`), a reconstruction's seeds, plates and result in made_from.json. So a split that is
changed afterwards, by hand or by mistake, is noticed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.core.records import read_record, write_record
from gof.dataset.dataset import Dataset

FILE = "made_from.json"
SETTINGS, SETTINGS_SCHEMA = "settings.json", "gof-reconstruction-settings"  # of gof.reconstruct.settings
PLATES_OF_A_CLIP = ("steady", "minimum")  # provenance.plate of datasets that were made from videos


class LeakError(DataFormatError):
    """Something to learn from was computed from a frame that is held out."""


@dataclass(frozen=True)
class MadeFrom:
    """made_from.json of a reconstruction: its files, each with the numbers of the frames that went into it.

    `learned` names what else went in that was learned from other fires: "flow_prior", or nothing.
    """

    SCHEMA: ClassVar[str] = "gof-made-from"
    VERSION: ClassVar[int] = 1

    files: dict[str, tuple[int, ...]]
    learned: tuple[str, ...] = ()

    @classmethod
    def of(cls, names: Iterable[str], frames: Iterable[int], learned: Iterable[str] = ()) -> MadeFrom:
        """Return all files from the same frames."""
        return cls(dict.fromkeys(names, tuple(int(k) for k in frames)), tuple(learned))

    @classmethod
    def read(cls, folder: Path) -> MadeFrom | None:
        """Read `folder/made_from.json`; None where there is none. Raises DataFormatError as `read_record`."""
        return read_record(cls, folder / FILE) if (folder / FILE).is_file() else None

    def write(self, folder: Path) -> None:
        """Write `folder/made_from.json`."""
        write_record(folder / FILE, self)


def warn_of_another(result: Path, dataset: Dataset) -> str | None:
    """Return a warning where a result of `gof reconstruct`, a file or its folder, was made of another dataset."""
    settings = (result if result.is_dir() else result.parent) / SETTINGS
    about = read_json(settings) if settings.is_file() else None
    if not isinstance(about, dict) or about.get("schema") != SETTINGS_SCHEMA:  # other methods have a settings.json, too
        return None
    made_of = about.get("dataset")
    if not isinstance(made_of, str) or made_of == dataset.identity():
        return None
    return (
        f"{result} was made of the dataset '{made_of}', and {dataset.path} is '{dataset.identity()}': either a copy "
        "of it with other times of change, or ANOTHER FIRE"
    )


def print_of_others(results: Iterable[Path], dataset: Dataset | None) -> None:
    """Print a warning for each result that was made of another dataset than it is shown with."""
    for result in results:
        if dataset is not None and (warning := warn_of_another(result, dataset)):
            print(f"warning: {warning}", file=sys.stderr)


def leaks(files: Mapping[str, Iterable[int]], held_out: Iterable[int]) -> dict[str, list[int]]:
    """Return the files that were computed from held-out frames, with those frames."""
    held = set(held_out)
    return {name: sorted(held & set(frames)) for name, frames in files.items() if held & set(frames)}


def require_no_leaks(dataset: Dataset) -> None:
    """Make sure that a method may learn from a dataset's plates, depth and poses.

    Raises:
        LeakError: one was computed from a held-out frame, or does not say what it was computed from.
    """
    description = dataset.description
    for name, frames in leaks(description.made_from, dataset.test_frames).items():
        raise LeakError(
            f"{dataset.path}/{name}: was computed from frames {frames}, which are held out (splits.test of "
            "dataset.json); make the dataset again, or give it the splits it was made with"
        )
    kind = description.provenance.get("plate")
    if dataset.test_frames and not description.made_from and kind in PLATES_OF_A_CLIP:
        raise LeakError(
            f"{dataset.path}: its {kind} plates do not say which frames they were made from; they are of a time when "
            "held-out frames were among them. Make the dataset again with 'gof ingest'"
        )


def require_unleaked_work(folder: Path, dataset: Dataset) -> None:
    """Make sure that a reconstruction's folder was not begun with frames that the dataset holds out now.

    Raises:
        LeakError: it was.
    """
    begun = MadeFrom.read(folder)
    for name, frames in leaks(begun.files if begun else {}, dataset.test_frames).items():
        raise LeakError(
            f"{folder}/{name}: was made from frames {frames}, which {dataset.path} holds out now; choose another --out "
            "or remove the folder"
        )
