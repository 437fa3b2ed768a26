"""The words of documents and code: how many there are, how long sentences get, how easily they read."""

import ast
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MENU = re.findall(r"^ +- [^:]+: (\S+\.md)$", (ROOT / "tools/site.yml").read_text(encoding="utf-8"), re.MULTILINE)
PAGES = [ROOT / page for page in MENU]  # docs/ is among them: tests/test_site.py
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))

MOST_WORDS = 30_000  # of all pages of the menu, as wc counts them, without what is generated. It may only fall
OF_README = 450  # likewise
LONGEST = 35  # words of a sentence
LEAST_EASE = 60  # Flesch's reading ease of a tutorial

pytestmark = pytest.mark.checkout


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def sentences(text: str) -> list[str]:
    """Sentences of a page's running text and lists: code, tables, headings and comments are left out.

    A code word, a path and a number count as one word each.
    """
    text = re.sub(r"^(```|~~~).*?^\1", "\n\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->|<[^>]+>", "", text, flags=re.DOTALL)
    text = re.sub(r"^(#.*|\|.*|!\[.*)$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]+`", "CODE", text))
    parts = re.split(r"\n\s*\n|^\s*(?:[-*]|\d+\.)\s", text, flags=re.MULTILINE)
    found = [s for part in parts for s in re.split(r"(?<=[.!?])[\"')*]*\s+(?=[A-Z\d*\"'(])", " ".join(part.split()))]
    return [sentence for sentence in found if re.search(r"[A-Za-z]", sentence)]


def words(sentence: str) -> list[str]:
    return re.findall(r"[\w'][\w'.,/-]*", sentence)


def syllables(word: str) -> int:
    """Vowels that follow no vowel, without a silent e at the end."""
    word = re.sub(r"(?<=[^aeiouyl])e(d|s)?$", "", word.lower().strip("'.,"))
    return max(1, len(re.findall(r"[aeiouy]+", word)))


def ease(text: str) -> float:
    """Flesch's reading ease: 60 to 70 is plain English, above 90 is for children."""
    found = [[word for word in words(s) if re.search("[A-Za-z]", word)] for s in sentences(text)]
    flat = [word for sentence in found for word in sentence]
    return 206.835 - 1.015 * len(flat) / len(found) - 84.6 * sum(map(syllables, flat)) / len(flat)


def test_sentences_are_told_apart():
    page = (
        "# Title\n\nOne two three. Four `gof a --b 1` five!\n\n| no | row. |\n\n- six 0.5 m\n- seven, [eight](x.md)\n"
    )
    page += "```\nno code.\n```\n"
    assert sentences(page) == ["One two three.", "Four CODE five!", "six 0.5 m", "seven, eight"]
    assert words("six 0.5 m, the fire's gof_board-1") == ["six", "0.5", "m,", "the", "fire's", "gof_board-1"]


def test_ease_is_that_of_the_formula():
    assert ease("The cat sat on the mat.") == pytest.approx(206.835 - 1.015 * 6 - 84.6)
    counts = {"flame": 1, "fire": 1, "flames": 1, "little": 2, "velocity": 4, "moved": 1, "camera": 3}
    assert {word: syllables(word) for word in counts} == counts


def test_the_documents_do_not_grow():
    count = sum(len(page.read_text(encoding="utf-8").split()) for page in PAGES)
    assert count <= MOST_WORDS, f"{count} words; write less elsewhere"
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= OF_README


def test_sentences_are_short():
    longest = {name_of(page): max(sentences(page.read_text("utf-8")), key=lambda s: len(words(s))) for page in PAGES}
    over = {page: sentence for page, sentence in longest.items() if len(words(sentence)) > LONGEST}
    assert over == {}


def test_tutorials_read_easily():
    hard = {name_of(page): round(ease(page.read_text("utf-8"))) for page in TUTORIALS}
    assert {page: value for page, value in hard.items() if value < LEAST_EASE} == {}


def texts(path: Path) -> list[str]:
    """All strings of a file; of those with values in them, the parts together."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    joined = [node for node in nodes if isinstance(node, ast.JoinedStr)]
    parts = {id(part) for node in joined for part in node.values}
    found = ["".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values) for node in joined]
    return found + [
        n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in parts
    ]


def comments(path: Path) -> Iterator[str]:
    """Comments of a file; lines of one column that follow each other are one comment."""
    lines, place = [], None
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type == tokenize.COMMENT:
                if lines and place != (token.start[0] - 1, token.start[1]):
                    yield " ".join(lines)
                    lines = []
                lines.append(token.string.lstrip("# "))
                place = token.start
    if lines:
        yield " ".join(lines)


UNCLEAR = re.compile(
    r"^\s*(?:What|Of) |[.!?:]\s+(?:What|Of) (?![^.!?]*\?)|\b(?:[Nn]obody|[Ww]hoever)\b|\b[Pp]rocessors?\b"
    r"|\b(?:is|are|was|were|be|been|being) (?:not )?(?:said|told(?! apart| from)|asked)\b|\b[Dd]oubts?\b(?=.* )"
)


def test_what_is_unclear_is_found():
    for text in ("What it holds.", "It is. Of two the first.", "as is told", "no picture was asked for", "no doubt is"):
        assert UNCLEAR.search(text), text
    for text in ("Is it. What is it?", "read. Offers", "they are told apart", "colour: doubt", "The output of it"):
        assert not UNCLEAR.search(text), text


def test_comments_are_put_together(tmp_path):
    (tmp_path / "a.py").write_text("# One\n# two.\nx = 1  # three\n# four\ny = '# five'\n")
    assert list(comments(tmp_path / "a.py")) == ["One two.", "three", "four"]


@pytest.mark.parametrize("room", ["gof", "benchmark", "blender_addon"])
def test_docstrings_messages_and_comments_speak_plainly(room):
    """Rule 2 of CONTRIBUTING.md, over docstrings, helps, panels, messages and comments."""
    files = [path for path in (ROOT / room).rglob("*.py")]
    everything = ((path, text) for path in files for text in (*texts(path), *comments(path)))
    found = {f"{name_of(path)}: {text[:80]}" for path, text in everything if UNCLEAR.search(text)}
    assert len(files) > 40 and found == set()


LINKS = re.compile(r"\[[^]]*\]\([^)]*\)")  # titles of pages and parts, which may be questions


def test_pages_speak_plainly():
    pages = sorted({*PAGES, *(ROOT / "benchmark").rglob("README.md")})
    texts_of = {page: LINKS.sub("LINK", page.read_text(encoding="utf-8")) for page in pages}
    found = [f"{name_of(page)}: {s}" for page, text in texts_of.items() for s in sentences(text) if UNCLEAR.search(s)]
    assert len(pages) > 40 and found == []
