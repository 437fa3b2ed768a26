"""A method as its authors describe it: method.json in a folder of results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.core.records import convert_json

TEXTS = ("made_by", "unfinished", "code", "commit", "licence", "hardware")
ASKED = ("name", "authors", "code", "commit", "licence", "hardware", "train_seconds", "given", "random")


@dataclass(frozen=True)
class AboutMethod:
    """method.json, by hand. Nothing in it is needed for a leaderboard of one's own; a submission says all of it.

    Attributes:
        name: of the method; with `made_by` after it, if that is given ("CPU re-run").
        train_seconds: that its training took.
        unfinished: why the training is not the method's best ("stopped at 3000 of 12000 steps"); such a row says so in
            its name and is not ranked.
        given: what the method was given ("plates", "starting points", "all pictures, held-out ones too").
        authors: of the method.
        code, commit, licence: where its code is, which version of it ran, and what others may do with it.
        hardware: that it ran on.
        memory_mb: the most it needed.
        prior: what it knew of other fires before it began ("flow prior learned on the dev fires"); () for nothing.
        random: whether another seed gives another result; then a submission holds three runs or more.
    """

    name: str | None = None
    train_seconds: float | None = None
    made_by: str | None = None
    unfinished: str | None = None
    given: tuple[str, ...] = ()
    authors: tuple[str, ...] = ()
    code: str | None = None
    commit: str | None = None
    licence: str | None = None
    hardware: str | None = None
    memory_mb: float | None = None
    prior: tuple[str, ...] | None = None
    random: bool | None = None

    def __post_init__(self):
        if self.name is not None and not self.name.strip():
            raise DataFormatError("name: is empty; leave it out to use the folder's name")
        for field in TEXTS:
            if getattr(self, field) is not None and not getattr(self, field).strip():
                raise DataFormatError(f"{field}: is empty; leave it out, or say it")
        for field, unit in (("train_seconds", "seconds"), ("memory_mb", "megabytes")):
            number = getattr(self, field)
            if number is not None and not 0 <= number < float("inf"):
                raise DataFormatError(f"{field}: {number} is no number of {unit}")

    def title(self, folder: Path) -> str:
        """Return the name of the row.

        Raises:
            DataFormatError: as a trivial baseline is, or with invisible characters, which turn or hide others.
        """
        remarks = [remark for remark in (self.made_by, self.unfinished) if remark]
        name = self.name or folder.resolve().name
        ours = name.strip().lower().startswith(("trivial:", "control:"))  # today's name of such rows, and that of 0.2
        if ours or not "".join((name, *remarks)).isprintable():
            raise DataFormatError(
                f"{folder}: a method cannot be called {name!r}: 'trivial:' marks our own rows, and every character "
                "must be visible; give it another name in method.json"
            )
        return f"{name} ({', '.join(remarks)})" if remarks else name

    @property
    def notes(self) -> tuple[str, ...]:
        found = [f"given: {', '.join(self.given)}"] if self.given else []
        return (*found, f"knew before: {', '.join(self.prior)}") if self.prior else tuple(found)

    def missing(self) -> list[str]:
        """Return the names of the fields that a submission must still fill in."""
        return [name for name in ASKED if getattr(self, name) in (None, ())] + ["prior"] * (self.prior is None)

    @classmethod
    def read(cls, folder: Path) -> AboutMethod:
        """Read it from a folder; empty where it has none. Raises DataFormatError: a field is of the wrong type
        (named)."""
        path = folder / "method.json"
        return convert_json(cls, read_json(path), path) if path.is_file() else cls()
