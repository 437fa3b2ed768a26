"""What the documents name exists: tests, files, pictures, commands, modules."""

import re
from pathlib import Path

import pytest

from gof.cli import ALIASES, commands

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "benchmark/scenes").glob("*/README.md")),
    ROOT / "firmware/README.md",
]
TESTS = {name for path in (ROOT / "tests").rglob("*.py") for name in re.findall(r"def (test_\w+)", path.read_text())}
TESTS |= {path.stem for folder in ("tests", "firmware") for path in (ROOT / folder).rglob("test_*.*")}
TESTS |= {
    name for path in (ROOT / "firmware/host").glob("*.c") for name in re.findall(r"void (test_\w+)", path.read_text())
}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_page_names_exists(page):
    text = page.read_text()
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"link to {target}"
    for name in re.findall(r"\b(test_\w+)\b(?!\.py)", text):
        assert name in TESTS, f"test {name}"
    for module in re.findall(r"python -m gof_(benchmark[\w.]*)", text):
        assert (ROOT / (module.replace(".", "/") + ".py")).exists() or (
            ROOT / module.replace(".", "/") / "__main__.py"
        ).exists(), module
    for command in re.findall(r"(?:^|`)gof ([a-z]\w*)", text, re.MULTILINE):
        assert command in commands() or command in ALIASES, f"gof {command}"


def test_pictures_are_shown_somewhere():
    shown = "".join(page.read_text() for page in PAGES)
    for path in [*(ROOT / "docs/images").iterdir(), *(ROOT / "docs/figures").iterdir()]:
        assert path.name in shown, path
