"""Numbers of the documents: whoever shows measured ones names beside them the command, or the test, that gives them.

The slow part runs the named evidence scripts at toy size: what a page tells a reader to run does run.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from gof.dataset import CameraEntry, Dataset, DatasetDescription
from tests.conftest import look_at
from tests.reconstruct.rising_flame import reconstruct, write_flame
from tests.test_docs import ROOT, evidence_scripts, modules_run_by

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

# Figures with a unit of measurements, scores, and charts that a script draws.
MEASURED = re.compile(r"\d ?(?:dB|ms|us|fps|frames/s|GB|MB|%|m/s|CPU s)(?![\w-])|\d s\b|\d\.\d\d|\bfigures/\w+\.svg")
COMMAND = re.compile(r"\bpython -m gof_benchmark[\w.]+|(?:`|^)gof [a-z]\w*|(?:`|^)make \w+|\btest_\w+", re.MULTILINE)

NOT_MEASURED = {  # (page, heading): what its figures are
    ("docs/capture.md", "How it tells the time"): "the board's protocol",
    ("docs/ingest.md", "Which way is up"): "thresholds",
    ("docs/formats.md", "Velocity store (schema `gof-velocity`, version 1)"): "an example file",
    ("docs/how_real.md", "What real fires do"): "laws from the literature",
    ("docs/how_real.md", "Limits"): "the laws' own scatter",
    ("docs/renderer.md", "Dr.Jit arrays, differentiable"): "an example",
    ("docs/renderer.md", "torch, as gsplat"): "limits of the functions",
    ("docs/renderer.md", "Where it bends, and what happens there"): "limits of the functions",
    ("docs/renderer.md", "How it works"): "limits of the functions",
}


class Section(NamedTuple):
    """A heading, the text below it to the next one, and the text of the headings that it stands under."""

    page: str
    heading: str
    text: str
    above: str

    @property
    def shows_measurements(self) -> bool:
        return bool(MEASURED.search(self.text))

    @property
    def names_command(self) -> bool:
        return bool(COMMAND.search(self.heading + "\n" + self.text) or COMMAND.search(self.above))


def sections(page: Path) -> list[Section]:
    """All sections of a page; the page's own title is above none of them."""
    name, found, open_ = page.relative_to(ROOT).as_posix(), [], []
    fenced = False
    for line in page.read_text(encoding="utf-8").splitlines():
        fenced ^= line.startswith("```")
        heading = None if fenced else re.match(r"(#+) (.*)", line)
        if heading:
            level = len(heading[1])
            open_ = [part for part in open_ if part[0] < level]
            open_.append([level, heading[2], ""])
            found.append([open_[-1], [part for part in open_[:-1] if part[0] > 1]])
        elif open_:
            open_[-1][2] += line + "\n"
    return [
        Section(name, part[1], part[2], "\n".join(f"{p[1]}\n{p[2]}" for p in parents)) for part, parents in found
    ]


SECTIONS = [section for page in PAGES for section in sections(page)]


def test_sections_are_told_apart(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("# T\n`gof view`\n## A\n1.5 dB\n### B\n12 ms\n```\n# no heading\n```\n## C by `gof report`\n0.25\n")
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    title, a, b, c = sections(page)
    assert [s.heading for s in (title, a, b, c)] == ["T", "A", "B", "C by `gof report`"]
    assert not title.shows_measurements and title.names_command
    assert a.shows_measurements and not a.names_command, "the title's command is nobody else's"
    assert "# no heading" in b.text and b.shows_measurements and not b.names_command
    assert c.shows_measurements and c.names_command
    assert not b._replace(text="three dB, 2.5 flames").shows_measurements


@pytest.mark.checkout
def test_measured_numbers_name_what_prints_them():
    bare = {(s.page, s.heading) for s in SECTIONS if s.shows_measurements and not s.names_command}
    assert sorted(bare - NOT_MEASURED.keys()) == [], "name the command, or the test, beside the figures"


@pytest.mark.checkout
def test_the_list_of_other_numbers_is_short_and_needed():
    bare = {(s.page, s.heading) for s in SECTIONS if s.shows_measurements and not s.names_command}
    assert NOT_MEASURED.keys() - bare == set(), "no longer needed"
    assert len(NOT_MEASURED) <= 12
