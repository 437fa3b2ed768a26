"""`stages/captions.json`: what each picture of a stage shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from gof.core.errors import DataFormatError
from gof.core.files import is_name
from gof.core.records import read_record, write_record

FILE = "captions.json"


@dataclass(frozen=True)
class Caption:
    """The text under a picture; `file` is its name in the folder. Raises DataFormatError: that is a path."""

    file: str
    text: str

    def __post_init__(self):
        if not is_name(self.file):
            raise DataFormatError(f"file: {self.file[:80]!r} cannot be the name of a picture in this folder")


@dataclass(frozen=True)
class Captions:
    """The pictures of a folder, in the order of the stages."""

    SCHEMA: ClassVar[str] = "gof-captions"
    VERSION: ClassVar[int] = 1

    images: tuple[Caption, ...] = ()

    @classmethod
    def read(cls, folder: Path) -> Captions:
        """Read a folder's captions; none when it has no captions.json. Raises DataFormatError as `read_record`."""
        return read_record(cls, folder / FILE) if (folder / FILE).exists() else cls()

    def write(self, folder: Path) -> None:
        write_record(folder / FILE, self)

    def with_caption(self, caption: Caption) -> Captions:
        """Return these with one more; a picture that has one already keeps its place and gets the new text."""
        if any(old.file == caption.file for old in self.images):
            return Captions(tuple(caption if old.file == caption.file else old for old in self.images))
        return Captions((*self.images, caption))
