"""An error that names a heading of docs/troubleshooting.md names one that is there, and is about that error."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from gof.commands.cli import main
from gof.core.errors import DataFormatError, GofError, in_words, naming

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/troubleshooting.md"
ANCHOR = re.compile(r"(?:anchor=|^UNSOLVED = )\"(\w+-[\w-]+)\"", re.MULTILINE)

pytestmark = pytest.mark.checkout


def slug(heading: str) -> str:
    """The anchor that a code host and the site give a heading."""
    return re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-")


def named() -> list[tuple[Path, str]]:
    """Every anchor that the source names, with its file."""
    files = sorted((ROOT / "gof").rglob("*.py"))
    return [(path, anchor) for path in files for anchor in ANCHOR.findall(path.read_text(encoding="utf-8"))]


def test_the_ten_most_frequent_errors_name_a_heading():
    assert len({anchor for _, anchor in named()}) >= 10


@pytest.mark.parametrize("path, anchor", named(), ids=lambda value: value if isinstance(value, str) else value.stem)
def test_an_anchor_is_a_heading_whose_words_the_error_holds(path, anchor):
    headings = {
        slug(heading): heading.strip("` ") for heading in re.findall(r"^#+ (.+)$", PAGE.read_text("utf-8"), re.M)
    }
    assert anchor in headings, f"{path.name} names #{anchor}"
    source = re.sub(r'"\n\s+f?"', "", path.read_text(encoding="utf-8"))  # texts over several lines
    assert headings[anchor] in source


def test_an_error_is_printed_with_its_heading(tmp_path, capsys):
    np.savez(tmp_path / "mine.npz", nothing=np.zeros(3))
    assert main(["convert", str(tmp_path / "mine.npz"), str(tmp_path / "out.ply")]) == 1
    error = capsys.readouterr().err
    assert "no format gof knows" in error and error.endswith("\nmore: docs/troubleshooting.md#no-format-gof-knows\n")


def test_the_heading_goes_with_the_error():
    """Into another process, and where a file's name is put before its text."""
    error = DataFormatError("broken", anchor="breaks-off")
    assert pickle.loads(pickle.dumps(error)).anchor == "breaks-off"
    with pytest.raises(DataFormatError) as caught, naming(Path("a.mp4")):
        raise error
    assert in_words(caught.value) == "a.mp4: broken\nmore: docs/troubleshooting.md#breaks-off"
    assert in_words(GofError("plain")) == "plain"
