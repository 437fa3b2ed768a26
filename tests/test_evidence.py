"""Figures that pages quote stand in evidence/NAME.json, which scripts wrote; a figure that no file has is found."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_docs import PAGES, evidence_scripts
from tools import evidence, site

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.checkout

PRINTED = """\
| camera | rate | off (us) |
|---|---|---|
| a | 30 | 4.6 |
| a | 60 | 12 |
| b | 30 | 0.31 |

| plate | all |
|---|---:|
| steady | 1.50 |
"""


@pytest.fixture
def folder(tmp_path) -> Path:
    about = {"figures": evidence.tables_in(PRINTED), "printed": PRINTED.splitlines()}
    (tmp_path / "rows.json").write_text(json.dumps(about))
    return tmp_path


def test_a_cell_is_named_by_row_and_column():
    figures = evidence.tables_in(PRINTED)
    assert figures["a, 60"]["off (us)"] == "12" and figures["b, 30"]["off (us)"] == "0.31"
    assert figures["steady"] == {"plate": "steady", "all": "1.50"}


@pytest.mark.parametrize(
    "page, says",
    [
        ("read to 4.6<!-- evidence: rows / a, 30 / off (us) --> us", None),
        ("read to **4.6**<!-- evidence: rows / a, 30 / off (us) --> us", None),
        ("read to 4.7<!-- evidence: rows / a, 30 / off (us) --> us", "says 4.6"),
        ("read to 14.6<!-- evidence: rows / a, 30 / off (us) --> us", "says 4.6"),
        ("read to 4.6<!-- evidence: rows / c, 30 / off (us) --> us", "no such row"),
        ("read to 4.6<!-- evidence: others / a, 30 / off (us) --> us", "there is no others.json"),
        ("<!-- evidence: rows -->\n\n| plate | all dB |\n|---|---|\n| steady | 1.50 |\n\nmore", None),
        ("<!-- evidence: rows -->\n| plate | all dB |\n|---|---|\n| steady | 1.5 |", "no row | steady | 1.5 |"),
        ("<!-- evidence: rows -->\n\nno table", "no figures"),
        ("<!-- evidence: rows -->\n\nOff by 4.6 us with `x 7`, 12 us at 60 Hz.\n\n99 dB", None),
        ("<!-- evidence: rows -->\n\nOff by 4.6 to 13 us.", "no figure 13"),
        ("<!-- evidence: rows -->\n\n| a | **60** | 12 |\n|---|---|---|\n| a | **60** | 12 |", None),
        ("<!-- evidence: rows, others -->\n\n4.6 us", "there is no others.json"),
    ],
)
def test_a_figure_that_no_file_has_is_found(page, says, folder):
    wrong = evidence.wrong_quotes(page, folder)
    assert len(wrong) == (says is not None) and (says is None or says in wrong[0])


def test_a_measured_figure_without_a_quote_is_found():
    page = """# T

In 3 ways, 12 ms each.

## A

<!-- evidence: rows -->

| a | 4.6 us |

Then 0.31 of it, with `0.44` and Python 3.11.

![chart](figures/rows.svg)

## B

4.6<!-- evidence: rows / a, 30 / off (us) --> us, [0.5 m](x.md).

```
7.25 dB
```

![chart](figures/rows.svg)
"""
    assert evidence.unquoted(page) == {
        "T": ["In 3 ways, 12 ms each."],
        "A": ["Then 0.31 of it, with `0.44` and Python 3.11."],
        "B": ["![chart](figures/rows.svg)"],
    }


def test_kept_figures_say_where_they_are_from(tmp_path):
    (tmp_path / "tables.md").write_text(PRINTED)
    evidence.keep("rows", PRINTED, "gof study score", "HEAD", 90.0, "a CPU", tmp_path)
    about = json.loads((tmp_path / "rows.json").read_text())
    assert about["command"] == "gof study score" and re.fullmatch(r"\d{4}-\d\d-\d\d", about["date"])
    assert evidence.wrong_quotes("4.6<!-- evidence: rows / a, 30 / off (us) --> us", tmp_path) == []
    assert re.fullmatch(r"[0-9a-f]{7,40}", about["commit"])
    origin = f"commit {about['commit']} of {about['date']}"
    assert (about["seconds"], evidence.caption("rows", tmp_path)) == (90, f"`gof study score`, {origin}, a CPU")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_quotes_of_the_pages_are_right(page):
    assert evidence.wrong_quotes(page.read_text(encoding="utf-8")) == []


def test_the_site_is_not_built_with_a_figure_that_no_file_has(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("4.6<!-- evidence: nothing / a / b -->")
    monkeypatch.setattr(site, "ROOT", tmp_path)
    monkeypatch.setattr(site, "PAGES", ("page.md",))
    with pytest.raises(SystemExit, match="page.md.*nothing.json"):
        site.stage(tmp_path / "out")


FILES = sorted((ROOT / "evidence").glob("*.json"))


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_a_file_of_evidence_says_how_it_was_made(path):
    about = json.loads(path.read_text(encoding="utf-8"))
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", about["date"]) and about["commit"] and about["command"]
    assert about["cpu"] is None or about["seconds"] > 0
    assert set(re.findall(r"gof_benchmark\.evidence\.(\w+)", about["command"])) <= evidence_scripts()
    assert about["figures"] == evidence.tables_in("\n".join(about["printed"]))
    assert "/tmp" not in path.read_text() and str(Path.home()) not in path.read_text()


def test_every_script_is_known_with_what_it_needs():
    known = evidence.commands()
    assert set(known) == evidence_scripts()
    assert known["ring_accuracy"] == ([], "") and known["interval_coverage"] == (["--repeats", "2000"], "")
    assert known["scene_model"][1] == "needs DATASET, RESULT"


def test_what_needs_a_dataset_and_what_has_its_file_is_not_run():
    words = [sys.executable, "-m", "tools.evidence", "ring_accuracy", "choices"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "ring_accuracy: kept, evidence/ring_accuracy.json is there",
        "choices: skipped, needs DATASET",
    ]


@pytest.mark.slow
def test_a_script_that_runs_writes_its_file_and_one_that_fails_says_why(tmp_path):
    assert evidence.run("interval_coverage", ["--repeats", "20"], tmp_path) == ""
    about = json.loads((tmp_path / "interval_coverage.json").read_text())
    assert about["command"] == "python -m gof_benchmark.evidence.interval_coverage --repeats 20"
    assert len(about["figures"]) == 15 and "here" in about["figures"]["24, 0"]
    assert evidence.run("interval_coverage", ["--no-such-option"], tmp_path / "none") != ""
    assert not (tmp_path / "none").exists()


def test_a_commit_is_dirty_by_its_code_not_by_its_figures(tmp_path, monkeypatch):
    def git(*words: str) -> str:
        mine = ["-c", "user.name=a", "-c", "user.email=a@b"]
        return subprocess.run(["git", *mine, *words], cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    for name in ("code.py", "evidence/rows.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1")
    git("init"), git("add", "."), git("commit", "-m", "one")
    monkeypatch.setattr(evidence, "ROOT", tmp_path)
    (tmp_path / "evidence/rows.json").write_text("2")
    assert evidence._commit() == git("rev-parse", "--short", "HEAD").strip()
    (tmp_path / "code.py").write_text("2")
    assert evidence._commit().endswith("-dirty")
