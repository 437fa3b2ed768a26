"""What the documents name exists: tests, files, pictures, commands, modules; evidence scripts say how they are run."""

import ast
import re
from pathlib import Path

import pytest

from gof.commands.cli import commands
from gof.commands.renamed import COMMANDS
from tests.test_printed_commands import SOURCES, texts
from tools import evidence
from tools.references import of_evidence

ROOT = Path(__file__).parents[1]
EVIDENCE = ROOT / "benchmark/evidence"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "benchmark").glob("*/README.md")),
    *sorted((ROOT / "benchmark/scenes").glob("*/README.md")),
    ROOT / "firmware/README.md",
]
NOTEBOOK = sorted((ROOT / "notebook").glob("*.md"))  # history: its links lead to files, its names may be of before
TESTS = {name for path in (ROOT / "tests").rglob("*.py") for name in re.findall(r"def (test_\w+)", path.read_text())}
TESTS |= {
    path.stem for folder in ("tests", "firmware", EVIDENCE / "checks") for path in (ROOT / folder).rglob("test_*.*")
}
TESTS |= {
    name for path in (ROOT / "firmware/host").glob("*.c") for name in re.findall(r"void (test_\w+)", path.read_text())
}


def modules_run_by(text: str) -> set[str]:
    """Names, without the package, of the modules of `gof_benchmark` that a text runs with `python -m`."""
    return {name.strip(".") for name in re.findall(r"python -m gof_benchmark([\w.]*)", text)}


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOK], ids=lambda p: str(p.relative_to(ROOT)))
def test_links_of_a_page_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"link to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_page_names_exists(page):
    text = page.read_text()
    for name in re.findall(r"(?<![-\w])(test_\w+)\b(?!\.py)", text):
        assert name in TESTS, f"test {name}"
    for module in modules_run_by(text) - {"evidence.NAME"}:
        path = ROOT / "benchmark" / module.replace(".", "/")
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), module
    for module in re.findall(r"python -m tests\.(\w+)", text):
        assert (ROOT / "tests" / module / "__main__.py").exists(), module
    for command in re.findall(r"(?:^|`)gof ([a-z]\w*)", text, re.MULTILINE):
        assert command in commands() or command in COMMANDS or command == "help", f"gof {command}"


def test_pictures_are_shown_somewhere():
    shown = "".join(page.read_text() for page in [*PAGES, *NOTEBOOK])
    for path in [*(ROOT / "docs/images").iterdir(), *(ROOT / "docs/figures").iterdir()]:
        assert path.name in shown, path


def test_troubleshooting_quotes_what_the_program_prints():
    """Each heading in code is a part of a message, letter by letter; others are questions."""
    messages = [text for path in SOURCES for _, text in texts(path)]
    headings = re.findall(r"^### `(.+)`$", (ROOT / "docs/troubleshooting.md").read_text(), re.MULTILINE)
    assert len(headings) > 30 and not any("no such message is printed" in text for text in messages)
    assert [heading for heading in headings if not any(heading in text for text in messages)] == []


# ---------------------------------------------------------------- benchmark/evidence


def evidence_scripts() -> set[str]:
    """Names of the scripts: what can be run with `python -m`."""
    return {path.stem for path in EVIDENCE.glob("*.py") if 'if __name__ == "__main__":' in path.read_text()}


def test_every_evidence_script_is_listed_with_its_command_and_time():
    rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in of_evidence().splitlines()[2:]]
    assert [re.split(r"[ `]", script)[1] for script, *_ in rows] == sorted(evidence_scripts())
    for script, measures, takes, _ in rows:
        assert len(measures) > 20 and takes.startswith(("about", "seconds")), script


def test_a_script_without_its_command_or_time_is_refused(tmp_path, monkeypatch):
    (tmp_path / "one.py").write_text('"""Measures."""\nif __name__ == "__main__":\n    pass\n')
    monkeypatch.setattr(evidence, "SCRIPTS", tmp_path)
    with pytest.raises(ValueError, match="one.py.*Takes"):
        evidence.scripts()


@pytest.mark.parametrize("name", sorted(evidence_scripts()))
def test_evidence_scripts_look_the_same(name):
    """A dataclass of options with a docstring, and `main(argv)`, by tyro."""
    text = (EVIDENCE / f"{name}.py").read_text()
    top = {node.name: node for node in ast.parse(text).body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    assert [argument.arg for argument in top["main"].args.args] == ["argv"] and ast.get_docstring(top["main"])
    asked = re.search(rf'tyro\.cli\((\w+), prog="python -m gof_benchmark\.evidence\.{name}"', text)
    assert ast.get_docstring(top[asked[1]])
