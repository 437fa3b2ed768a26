"""Build the documents as a web site: python tools/site.py [OUT], default build/site; open OUT/index.html.

The pages stay where they are, in README.md, docs/ and beside the code, and their links work on a disk and in a code
host's viewer. Here they are put together with a reference made from docstrings. A link that leads nowhere is an error.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "tools" / "site.yml"
PAGES = ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "benchmark/**/README.md", "firmware/README.md")
BESIDE = (ROOT / "tools" / "site.css", ROOT / "tools" / "iframe-worker.js")
LINK = re.compile(r"\]\(([^)#\s]+)")


def stage(folder: Path) -> None:
    """Copy the pages and the files that they show or point to, each where it lies in the repository."""
    pages = [path for pattern in PAGES for path in ROOT.glob(pattern)]
    linked = [(page.parent / target).resolve() for page in pages for target in LINK.findall(page.read_text("utf-8"))]
    for path in {*pages, *(path for path in linked if path.is_file() and path.is_relative_to(ROOT))}:
        target = folder / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)


def build(out: Path) -> int:
    """Return the exit status of mkdocs, which names every link that leads nowhere."""
    with tempfile.TemporaryDirectory() as temporary:
        pages = Path(temporary) / "pages"
        stage(pages)
        for path in BESIDE:
            shutil.copyfile(path, pages / path.name)
        config = Path(temporary) / "mkdocs.yml"
        config.write_text(f"docs_dir: {pages}\n{CONFIG.read_text(encoding='utf-8')}", encoding="utf-8")
        command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "-f", str(config)]
        done = subprocess.run([*command, "-d", str(out.resolve())], cwd=ROOT)
    return done.returncode


if __name__ == "__main__":
    sys.exit(build(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build" / "site"))
