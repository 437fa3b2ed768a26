"""What the documents name exists: tests, files, pictures, commands, modules; every evidence script is in its table."""

import ast
import re
from pathlib import Path

import pytest

from gof.commands.cli import commands
from gof.commands.renamed import COMMANDS

ROOT = Path(__file__).parents[1]
EVIDENCE = ROOT / "benchmark/evidence"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "notebook").glob("*.md")),
    *sorted((ROOT / "benchmark").glob("*/README.md")),
    *sorted((ROOT / "benchmark/scenes").glob("*/README.md")),
    ROOT / "firmware/README.md",
]
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


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_page_names_exists(page):
    text = page.read_text()
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"link to {target}"
    for name in re.findall(r"(?<![-\w])(test_\w+)\b(?!\.py)", text):
        assert name in TESTS, f"test {name}"
    for module in modules_run_by(text) - {"evidence.NAME"}:
        path = ROOT / "benchmark" / module.replace(".", "/")
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), module
    for module in re.findall(r"python -m tests\.(\w+)", text):
        assert (ROOT / "tests" / module / "__main__.py").exists(), module
    for command in re.findall(r"(?:^|`)gof ([a-z]\w*)", text, re.MULTILINE):
        assert command in commands() or command in COMMANDS, f"gof {command}"


def test_pictures_are_shown_somewhere():
    shown = "".join(page.read_text() for page in PAGES)
    for path in [*(ROOT / "docs/images").iterdir(), *(ROOT / "docs/figures").iterdir()]:
        assert path.name in shown, path


REVIEWS = {
    "reliability": [
        *(f"H{n}" for n in range(1, 5)),
        *(f"M{n}" for n in range(1, 9)),
        *(f"L{n}" for n in range(1, 11)),
    ],
    "importers": [str(n) for n in range(1, 20)],
}


@pytest.mark.parametrize("page", REVIEWS)
def test_every_defect_of_the_reviews_has_its_row(page):
    """With its tests, whose existence is asked for above, or in words why there is none; and the commit."""
    lines = (ROOT / f"notebook/{page}.md").read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("| no. |"))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("| "):
            break
        rows.append([cell.strip() for cell in line.strip("|").split(" | ")])
    assert {len(row) for row in rows} == {5}
    listed = {number for row in rows for number in row[0].split(", ")}
    assert set(REVIEWS[page]) <= listed
    assert listed - set(REVIEWS[page]) == {"-"}, "rows without a number are siblings"
    for number, _, became, tests, commit in rows:
        assert re.search(r"`test_\w+`", tests) or tests in ("(words)", "there") or became.startswith("not "), number
        assert commit in ("-", "with this row") or all(re.fullmatch("[0-9a-f]{7}", c) for c in commit.split(", ")), (
            commit
        )


def test_every_finding_about_the_addon_has_its_row():
    """All nineteen, each with a test that `test_what_a_page_names_exists` finds, or words alone."""
    found = re.findall(r"^\| (\d+) \| (.+) \| (.+) \| (.+) \|$", (ROOT / "notebook/addon.md").read_text(), re.MULTILINE)
    assert [int(number) for number, *_ in found] == list(range(1, 20))
    assert all(re.search(r"`test_\w+(\.py)?`", holds) or holds == "(words)" for *_, holds in found)


# ---------------------------------------------------------------- benchmark/evidence


def evidence_rows() -> list[list[str]]:
    """Cells of the table: claim, script, page, how long it takes."""
    lines = [line for line in (EVIDENCE / "README.md").read_text().splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[1:]]


def evidence_scripts() -> set[str]:
    """Names of the scripts: what can be run with `python -m`."""
    return {path.stem for path in EVIDENCE.glob("*.py") if 'if __name__ == "__main__":' in path.read_text()}


def test_every_evidence_script_is_in_the_table_and_every_row_has_its_script():
    named = [modules_run_by(script) for _, script, _, _ in evidence_rows()]
    assert all(len(modules) == 1 for modules in named), "one script per row"
    assert {module.removeprefix("evidence.") for modules in named for module in modules} == evidence_scripts()
    assert len(named) == len(evidence_scripts()), "one row per script"


def test_every_evidence_row_says_where_its_claim_stands_and_how_long_it_takes():
    for claim, script, page, takes in evidence_rows():
        pages = [(EVIDENCE / target) for target in re.findall(r"\]\(([^)]+)\)", page)]
        assert claim and pages, script
        assert takes.startswith("about") or takes == "seconds", script
        (module,) = modules_run_by(script)
        name = module.removeprefix("evidence.")
        text = "".join(path.read_text() for path in [*pages, *(ROOT / "benchmark/scenes").glob("*/README.md")])
        assert re.search(rf"\b{name}\b", text), f"{name} is not named on {page}"


@pytest.mark.parametrize("name", sorted(evidence_scripts()))
def test_evidence_scripts_look_the_same(name):
    """A dataclass of options with a docstring, and `main(argv)`, by tyro."""
    text = (EVIDENCE / f"{name}.py").read_text()
    top = {node.name: node for node in ast.parse(text).body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    assert [argument.arg for argument in top["main"].args.args] == ["argv"] and ast.get_docstring(top["main"])
    asked = re.search(rf'tyro\.cli\((\w+), prog="python -m gof_benchmark\.evidence\.{name}"', text)
    assert ast.get_docstring(top[asked[1]])
