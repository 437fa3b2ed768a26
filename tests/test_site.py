"""The documents as a site, and the tutorials as a reader runs them."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NAV = re.findall(r"^ +- (\S+\.md)$", (ROOT / "tools/site.yml").read_text(encoding="utf-8"), re.MULTILINE)

pytestmark = pytest.mark.checkout


def test_every_page_is_in_the_navigation_once():
    pages = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))]
    assert sorted(page for page in NAV if page.startswith("docs/")) == pages
    assert all((ROOT / page).is_file() for page in NAV)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="mkdocs is not installed: pip install '.[site]'")
def test_the_site_is_built_and_no_link_of_it_leads_nowhere(tmp_path):
    subprocess.run([sys.executable, str(ROOT / "tools/site.py"), str(tmp_path)], check=True)
    page = (tmp_path / "docs/reference.html").read_text(encoding="utf-8")
    assert "standard deviation along the Gaussian" in page, "the reference holds the docstrings"
    assert not re.findall(r'(?:src|<link[^>]*href)="https?://[^"]*', page), "nothing is fetched"


@pytest.mark.slow
@pytest.mark.blender
@pytest.mark.parametrize("page", ["benchmark", "score"])
def test_a_tutorial_runs_as_it_is_written(page, tmp_path):
    text = (ROOT / f"docs/tutorials/{page}.md").read_text(encoding="utf-8")
    blocks = BLOCK.findall(text)
    assert len(blocks) >= 3
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for language, code in blocks:
        command = ["bash", "-ec", code] if language == "bash" else [sys.executable, "-c", code]
        subprocess.run(command, cwd=tmp_path, env=os.environ | {"PATH": path}, check=True)
    if page == "score":
        assert (tmp_path / "boards/page/leaderboard.html").is_file()
