"""Errors a user can act on. Every message names the file or parameter, what is wrong, and what to do."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 4000  # characters of a message


def printable(text: str) -> str:
    """Return the text with a replacement for every character that is not seen but acts: on terminals, or on reading
    order."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\ufffd" for c in text)


class GofError(Exception):
    """Base of every error this package raises on purpose; command lines print it without a traceback.

    Its text may quote files: it is `printable`, and cut in the middle where a file would fill the terminal.

    Attributes:
        anchor: of the heading in docs/troubleshooting.md that explains the error; "" where none does.
    """

    def __init__(self, *words: object, anchor: str = ""):
        super().__init__(*words)
        self.anchor = anchor

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
    """Return an error's text and, where a page says more, that page."""
    return f"{error}\nmore: docs/troubleshooting.md#{error.anchor}" if error.anchor else str(error)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put a file's name before the text of an error of ours that does not hold it."""
    try:
        yield
    except GofError as e:
        raise e if str(path) in str(e) else type(e)(f"{path}: {e}", anchor=e.anchor) from e


def require_finite(name: str, array, context: str = "") -> None:
    """Raise `NonFiniteError` naming `name` and the first bad rows when `array` holds NaN or Inf."""
    import numpy as np

    finite = np.isfinite(array)
    if not finite.all():
        rows = np.unique(np.argwhere(~finite)[:, 0])[:5].tolist() if np.ndim(array) else []
        where = f" in {context}" if context else ""
        raise NonFiniteError(f"'{name}'{where} holds {int((~finite).sum())} NaN or Inf values (first rows: {rows})")
