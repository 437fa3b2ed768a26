"""Errors a user can act on. Every message names the file or parameter, what is wrong, and what to do."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 4000  # characters of a message

EXPLAINED = (  # parts of messages: each is a heading of docs/troubleshooting.md
    "libLLVM was not found",
    'pip install "gaussians-on-fire',
    "bpy 4.5 needs numpy below 2",
    "no file says",
    "camera poses could not be solved",
    "stand in one place",
    "the clips differ in length",
    "the videos do not overlap in time",
    "the files differ in rate",
    "has no one rate",
    "moments some camera has no frame",
    "breaks off",
    "is interlaced",
    "rotation tags differ",
    "fire left in the plates",
    "is the same footage as",
    "already holds a dataset",
    "no camera could be decoded",
    "no flickering strips where the board should have them",
    "the period counter does not advance",
    "so long that every frame straddles a change",
    "the films' clocks cannot be compared",
    "the views do not determine the focal length",
    "no LED board found",
    "no flame found in any training frame",
    "the flame would lie behind camera",
    "cameras; it cannot be placed in space",
    "no voxel lies in the flame masks of",
    "and this machine has",
    "plates do not say which frames they were made from",
    "no format gof knows",
    "its times run from",
    "besides tensors and numbers, and reading",
    "alignment needs two cameras with the same name in both",
    "holds the scores of another result",
    "no frame is held out",
    "cannot be written to",
)


def printable(text: str) -> str:
    """Return the text with a replacement for every character that is not seen but acts: on terminals, or on reading
    order."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\ufffd" for c in text)


class GofError(Exception):
    """Base of every error this package raises on purpose; command lines print it without a traceback.

    Its text may quote files: it is `printable`, and cut in the middle where a file would fill the terminal.
    """

    def __str__(self) -> str:
        text = printable(super().__str__())
        return text if len(text) <= LONGEST else f"{text[: LONGEST - 400]} ... {text[-400:]}"


class DataFormatError(GofError):
    """A file or folder does not follow its format (missing field, wrong version, truncated, foreign)."""


class NonFiniteError(GofError, ValueError):
    """NaN or Inf where only finite numbers make sense; names the parameter and the first rows."""


class MissingDependencyError(GofError):
    """A library, system package or weight file is absent; says what it is for and how to get it."""


def in_words(error: GofError) -> str:
    """Return an error's text and, where docs/troubleshooting.md explains it, the address of that heading."""
    heading = next((words for words in EXPLAINED if words in Exception.__str__(error)), None)
    return str(error) if heading is None else f"{error}\nmore: docs/troubleshooting.md#{anchor(heading)}"


def anchor(heading: str) -> str:
    """Return the anchor that a code host and the site of the documents give a heading."""
    return re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put a file's name before the text of an error of ours that does not hold it."""
    try:
        yield
    except GofError as e:
        raise e if str(path) in str(e) else type(e)(f"{path}: {Exception.__str__(e)}") from e


def require_finite(name: str, array, context: str = "") -> None:
    """Raise `NonFiniteError` naming `name` and the first bad rows when `array` holds NaN or Inf."""
    import numpy as np

    finite = np.isfinite(array)
    if not finite.all():
        rows = np.unique(np.argwhere(~finite)[:, 0])[:5].tolist() if np.ndim(array) else []
        where = f" in {context}" if context else ""
        raise NonFiniteError(f"'{name}'{where} holds {int((~finite).sum())} NaN or Inf values (first rows: {rows})")
