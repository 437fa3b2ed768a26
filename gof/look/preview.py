"""`preview.json`: a picture of the result in Blender, and which true picture it shows. `gof import` writes it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from gof.core.errors import DataFormatError
from gof.core.files import is_name
from gof.core.records import read_record, write_record


@dataclass(frozen=True)
class Preview:
    """A frame rendered by Blender from the imported result.

    Attributes:
        image: name of the picture, in the folder of preview.json.
        camera: number of the dataset's camera.   frame: of the dataset.

    Raises:
        DataFormatError: `image` is a path.
    """

    SCHEMA: ClassVar[str] = "gof-preview"
    VERSION: ClassVar[int] = 1

    image: str
    camera: int
    frame: int

    def __post_init__(self):
        if not is_name(self.image):
            raise DataFormatError(f"image: {self.image[:80]!r} cannot be the name of a picture in this folder")

    @classmethod
    def read(cls, path: Path) -> Preview:
        return read_record(cls, path)

    def write(self, path: Path) -> None:
        write_record(path, self)
