"""An error that docs/troubleshooting.md explains is printed with the address of its heading, which is there."""

import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gof.commands.cli import main
from gof.core.errors import EXPLAINED, DataFormatError, GofError, anchor, in_words, naming

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/troubleshooting.md"

pytestmark = pytest.mark.checkout


def test_every_explained_message_has_its_heading_and_every_heading_its_message():
    """That the program prints these words: tests/test_docs.py."""
    headings = re.findall(r"^### `(.+)`$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert list(EXPLAINED) == headings
    assert len({anchor(heading) for heading in headings}) == len(headings) > 30


def test_the_anchor_is_that_of_a_code_host():
    assert anchor("cameras; it cannot be placed in space") == "cameras-it-cannot-be-placed-in-space"
    assert anchor("the films' clocks cannot be compared") == "the-films-clocks-cannot-be-compared"


@pytest.mark.slow
def test_the_anchors_are_on_the_site(tmp_path):
    pytest.importorskip("mkdocs", reason="mkdocs is not installed: pip install '.[site]'")
    subprocess.run([sys.executable, "-m", "tools.site", str(tmp_path)], cwd=ROOT, check=True)
    page = (tmp_path / "docs/troubleshooting.html").read_text(encoding="utf-8")
    assert [heading for heading in EXPLAINED if f'id="{anchor(heading)}"' not in page] == []


def test_an_error_is_printed_with_its_heading(tmp_path, capsys):
    np.savez(tmp_path / "mine.npz", nothing=np.zeros(3))
    assert main(["convert", str(tmp_path / "mine.npz"), str(tmp_path / "out.ply")]) == 1
    error = capsys.readouterr().err
    assert "no format gof knows" in error and error.endswith("\nmore: docs/troubleshooting.md#no-format-gof-knows\n")


@pytest.mark.parametrize("heading", EXPLAINED)
def test_the_heading_goes_with_the_error(heading):
    """Into another process, where a file's name is put before its text, and where the text is cut."""
    error = DataFormatError(f"{'x' * 3800} {heading} {'y' * 3800}")
    with pytest.raises(DataFormatError) as caught, naming(Path("a.mp4")):
        raise pickle.loads(pickle.dumps(error))
    assert in_words(caught.value).startswith("a.mp4: xxx")
    assert in_words(caught.value).endswith(f"\nmore: docs/troubleshooting.md#{anchor(heading)}")


def test_other_errors_are_printed_alone():
    assert in_words(GofError("plain")) == "plain"
