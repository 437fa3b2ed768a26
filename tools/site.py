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
GLOSSARY = "docs/conventions.md"
TERM = re.compile(r"^\| (?!term )([^|`]+?) \| ([^|]+?) \|$", re.MULTILINE)
EVERYDAY = {"around", "axis", "dev, test", "eval", "seeds", "skill"}  # also words
# Parts of a page where no link may stand: code, headings, links and pictures, comments, heads of tables, labels.
FIXED = re.compile(
    r"^(```|~~~).*?^\1|^ {4}[^\n]*|^#[^\n]*|^\|[^\n]*\|\n(?=\|[-| :]+\|$)|`[^`]*`|!?\[[^]]*\]\([^)]*\)"
    r"|<[^>]*>|\{[^}]*\}|\*\*[^*\n]+\*\*|\*[^*\n]+\*",
    re.MULTILINE | re.DOTALL,
)
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
            page = page_of_site(with_terms(text, path.relative_to(ROOT).as_posix()))
            searched = REFERENCE if references.MARK.search(text) else ""
            head = searched if path in (*for_users, ROOT / "README.md") else UNSEARCHED
            target.write_text(head + page, encoding="utf-8")
        else:
            shutil.copyfile(path, target)


def terms() -> dict[str, str]:
    """Return the glossary: terms and what they mean, longer ones first."""
    table = (ROOT / GLOSSARY).read_text("utf-8").partition("## Glossary")[2]
    return dict(sorted(TERM.findall(table), key=lambda row: -len(row[0])))


def with_terms(page: str, path: str) -> str:
    """Return a page whose first use of each term leads to the glossary; the glossary itself with its anchors."""
    if path == GLOSSARY:
        head, title, table = page.partition("## Glossary")
        return head + title + TERM.sub(lambda row: f'| <span id="{_slug(row[1])}">{row[1]}</span> | {row[2]} |', table)
    if not path.startswith("docs/") and path != "README.md":
        return page
    glossary = os.path.relpath(GLOSSARY, Path(path).parent)
    longer: list[re.Pattern[str]] = []  # terms before this one: "trivial baseline" is no use of "baseline"
    for term, meaning in terms().items():
        word = re.compile(rf"(?<![\w-]){re.escape(term)}s?(?![\w-])", 0 if term[:1].isupper() else re.IGNORECASE)
        if term not in EVERYDAY:
            spans = [span.span() for taken in (FIXED, *longer) for span in taken.finditer(page)]
            uses = (use for use in word.finditer(page) if not any(a <= use.start() < b for a, b in spans))
            if use := next(uses, None):
                link = f'[{use[0]}]({glossary}#{_slug(term)} "{meaning}"){{ .term }}'
                page = page[: use.start()] + link + page[use.end() :]
        longer.append(word)
    return page


def _slug(term: str) -> str:
    return "term-" + re.sub(r"\W+", "-", term.lower())


def page_of_site(text: str) -> str:
    """Return a page with its generated parts, without links to the notebook; pictures further down load when seen."""
    text = TO_NOTEBOOK.sub(r"\1", text)
    text = ALONE.sub(lambda quote: f"Measured by {caption(quote[1])}.\n{{ .evidence }}", text)
    text = re.sub(r"(?<=[\d*]) ± (?=\d)", "\u00a0±\u00a0", text)
    for picture in list(PICTURE.finditer(text))[:0:-1]:
        text = f"{text[: picture.end()]}{{ loading=lazy }}{text[picture.end() :]}"
    return references.filled(text)


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
