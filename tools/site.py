"""Build the documents as a web site: python -m tools.site [OUT], default build/site; open OUT/index.html.

The pages stay where they are, in README.md, docs/ and beside the code, and their links work on a disk and in a code
host's viewer. Here they are put together with references made from the code. A link that leads nowhere is an error,
and so is a figure that evidence/ does not have. Pages of notebook/ stay out: a link to one becomes plain text.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tools import references
from tools.evidence import ALONE, caption, wrong_quotes

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "tools" / "site.yml"
PAGES = ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "benchmark/**/README.md", "firmware/README.md")
BESIDE = (ROOT / "tools" / "site.css", ROOT / "tools" / "iframe-worker.js", ROOT / "tools" / "flame.svg")
LINK = re.compile(r"\]\(([^)#\s]+)")
PICTURE = re.compile(r"!\[[^]]*\]\([^)]+\)")
TO_NOTEBOOK = re.compile(r"\[([^][]+)\]\((?:\.\./)*notebook/[^)\s]+\)")
REFERENCE = "---\nsearch: {boost: 4}\n---\n"  # found before pages that only mention a field or an option
FOR_DEVELOPERS = ("architecture.md", "renderer_inside.md")
UNSEARCHED = "---\nsearch: {exclude: true}\n---\n"  # of pages for developers, so that the index is small


def stage(folder: Path) -> None:
    """Copy the pages and the files that they show or point to, each where it lies in the repository."""
    for_users = [path for path in (ROOT / "docs").rglob("*.md") if path.name not in FOR_DEVELOPERS]
    pages = [path for pattern in PAGES for path in ROOT.glob(pattern)]
    linked = [(page.parent / target).resolve() for page in pages for target in LINK.findall(page.read_text("utf-8"))]
    for path in {*pages, *filter(_is_shown, linked)}:
        target = folder / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".md":
            text = path.read_text("utf-8")
            if wrong := wrong_quotes(text):
                sys.exit("\n".join(f"{path.relative_to(ROOT)}: {line}" for line in wrong))
            page = page_of_site(text)
            target.write_text(page if path in (*for_users, ROOT / "README.md") else UNSEARCHED + page, encoding="utf-8")
        else:
            shutil.copyfile(path, target)


def page_of_site(text: str) -> str:
    """Return a page with its generated parts, without links to the notebook; pictures further down load when seen."""
    text = TO_NOTEBOOK.sub(r"\1", text)
    text = ALONE.sub(lambda quote: f"Measured by {caption(quote[1])}.\n{{ .evidence }}", text)
    for picture in list(PICTURE.finditer(text))[:0:-1]:
        text = f"{text[: picture.end()]}{{ loading=lazy }}{text[picture.end() :]}"
    return REFERENCE + references.filled(text) if references.MARK.search(text) else text


def _is_shown(path: Path) -> bool:
    return path.is_file() and path.is_relative_to(ROOT) and not path.is_relative_to(ROOT / "notebook")


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
        quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
        done = subprocess.run([*command, "-d", str(out.resolve())], cwd=ROOT, env=quiet)
    return done.returncode


if __name__ == "__main__":
    sys.exit(build(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build" / "site"))
