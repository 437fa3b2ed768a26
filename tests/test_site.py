"""The documents as a site, and the tutorials as a reader runs them."""

import gzip
import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest

from tests.browser import Browser, chromium
from tests.reader import TUTORIALS, run
from tools.site import terms, with_terms

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(bash|python|text)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NAV = re.findall(r"^ +- [^:]+: (\S+\.md)$", (ROOT / "tools/site.yml").read_text(encoding="utf-8"), re.MULTILINE)

IN_A_WINDOW = {"blender_flame"}  # most of it is done in Blender's: tests/blender/test_tutorials.py

EXACT = {"score"}  # it computes from the sample's files alone, without chance: figures are compared, too

pytestmark = pytest.mark.checkout


def test_every_page_is_in_the_navigation_once():
    pages = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))]
    assert sorted(page for page in NAV if page.startswith("docs/")) == pages
    assert all((ROOT / page).is_file() for page in NAV)


def test_the_first_use_of_a_term_leads_to_the_glossary_and_no_other_place_does():
    page = "# A plate\n\n`plate`, [plate](x.md)\n\n| plate | a |\n|---|---|\n| Plates | plate |\n\nDve, DVE.\n"
    linked = with_terms(page, "docs/tutorials/x.md")
    assert re.findall(r"\[([^]]+)\]\(\.\./conventions\.md#([\w-]+) ", linked) == [
        ("Plates", "term-plate"),
        ("DVE", "term-dve"),
    ]
    assert "# A plate\n\n`plate`, [plate](x.md)\n\n| plate | a |" in linked
    assert "[" not in with_terms("In **Benchmark** leave *Background* at *This Scene*.\n", "docs/x.md"), "labels"
    linked = with_terms("Trivial baselines, trivial baselines, a baseline.\n", "docs/x.md")
    assert re.findall(r"\[([^]]+)\]\(conventions\.md#([\w-]+) ", linked) == [
        ("Trivial baselines", "term-trivial-baseline"),
        ("baseline", "term-baseline"),
    ]
    assert ", trivial baselines, a [" in linked, "a shorter term inside a longer one is not linked"
    assert with_terms("A plate.", "benchmark/fires/README.md") == "A plate."


def test_the_glossary_has_forty_terms_with_anchors():
    page = with_terms((ROOT / "docs/conventions.md").read_text(encoding="utf-8"), "docs/conventions.md")
    assert len(terms()) >= 40 and all(len(meaning.split()) > 3 for meaning in terms().values())
    assert len(set(re.findall(r'<span id="(term-[\w-]+)">', page))) == len(terms())


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed: pip install '.[site]'")
    folder = tmp_path_factory.mktemp("site")
    subprocess.run([sys.executable, "-m", "tools.site", str(folder)], cwd=ROOT, check=True)
    return folder


@pytest.mark.slow
def test_the_site_is_built_and_no_link_of_it_leads_nowhere(site):
    page = (site / "docs/reference.html").read_text(encoding="utf-8")
    assert "standard deviation along the Gaussian" in page, "the reference holds the docstrings"
    assert not re.findall(r'(?:src|<link[^>]*href)=(?:"?https?://|//)[^" >]*', page), "nothing is fetched"


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="no Chromium here: the site is not opened")
@pytest.mark.parametrize("page", ["index.html", "docs/show.html"])
def test_search_works_from_a_disk(site, page):
    """Without a server, where browsers start no worker; and nothing but the site's own files is asked for."""
    with Browser() as browser:
        browser.ask("Emulation.setFocusEmulationEnabled", {"enabled": True})
        browser.open((site / page).as_uri())
        links = browser.run(SEARCH % "tomography", seconds=120)
        assert links and all(link.startswith(site.as_uri()) for link in links)
        found = [Path(unquote(urlparse(link).path)) for link in links]
        assert any("tomography" in path.read_text(encoding="utf-8").lower() for path in found)
        assert browser.errors == []
        assert all(address.startswith(("file:", "about:")) for address in browser.requests)


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="no Chromium here: the site is not opened")
@pytest.mark.parametrize("words, page", [("spec fields", "spec"), ("arc_deg", "spec"), ("square-mm", "commands")])
def test_a_field_and_an_option_are_found_in_the_reference_first(site, words, page):
    with Browser() as browser:
        browser.ask("Emulation.setFocusEmulationEnabled", {"enabled": True})
        browser.open((site / "index.html").as_uri())
        assert f"docs/{page}.html" in browser.run(SEARCH % words, seconds=120)[0]


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="no Chromium here: the site is not opened")
@pytest.mark.parametrize("width", [390, 1400])
def test_the_first_page_is_light_and_fits_the_screen(site, width):
    """As a server sends it, its text packed."""
    with Browser(width, 850, mobile=width < 500) as browser:
        browser.open((site / "index.html").as_uri())
        files = {Path(unquote(urlparse(address).path)) for address in browser.requests}
        texts = (".html", ".css", ".js", ".svg")
        sizes = [len(gzip.compress(p.read_bytes())) if p.suffix in texts else p.stat().st_size for p in files]
        assert sum(sizes) < 300_000, dict(zip(files, sizes, strict=True))
        assert browser.run("document.documentElement.scrollWidth") <= width


SEARCH = """new Promise(async (done) => {
    const pause = (ms) => new Promise((after) => setTimeout(after, ms));
    const input = document.querySelector(".md-search__input");
    const links = () => [...document.querySelectorAll(".md-search-result__link")].map((a) => a.href);
    input.focus();
    input.value = "%s";
    for (let k = 0; k < 400 && !links().length; k++) {
        input.dispatchEvent(new KeyboardEvent("keyup", { bubbles: true }));
        await pause(250);
    }
    done(links());
})"""


@pytest.mark.long
@pytest.mark.timeout(1500)
@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.blender] if of == "bpy" else []) for page, of in TUTORIALS.items()]
)
def test_a_tutorial_runs_as_it_is_written(page, tmp_path):
    """Each block in its order; a block of text is in what the block before printed, numbers aside."""
    if importlib.util.find_spec(TUTORIALS[page]) is None:
        pytest.skip(f"{TUTORIALS[page]} is not installed")
    blocks = BLOCK.findall((ROOT / f"docs/tutorials/{page}.md").read_text(encoding="utf-8"))
    least = 1 if page in IN_A_WINDOW else 3
    assert len([language for language, _ in blocks if language != "text"]) >= least and "text" in dict(blocks)
    printed = ""
    for language, code in blocks:
        if language == "text":
            missing = [line for line in code.splitlines() if without_numbers(line) not in without_numbers(printed)]
            assert not missing, f"not in the output: {missing}\n{printed[-3000:]}"
            if page in EXACT:
                stale = [line for line in code.splitlines() if not has_numbers(line, printed)]
                assert not stale, f"other figures in the output: {stale}\n{printed[-3000:]}"
        else:
            printed = run(tmp_path, code, language, small=False)


def without_numbers(text: str) -> str:
    return " ".join(re.sub(r"[-+]?\d[\d.,]*", "#", text).split())


def has_numbers(line: str, printed: str) -> bool:
    """Whether a line of the output has this line's words, and its numbers to 1 %: CPUs differ in the last digit."""
    known = [said for said in printed.splitlines() if without_numbers(line) in without_numbers(said)]
    ours = numbers(line)
    theirs = [numbers(said)[k:] for said in known for k in range(len(numbers(said)) - len(ours) + 1)]
    return any(values[: len(ours)] == pytest.approx(ours, rel=0.01) for values in theirs)


def numbers(text: str) -> list[float]:
    return [float(word.replace(",", "")) for word in re.findall(r"(?<![\w.])\d[\d,]*(?:\.\d+)?(?!\w)", text)]


def test_numbers_of_an_output_are_compared():
    printed = "took 3 s\ngof yes 0.388  0.931\n| PSNR | 6.16 | 4.24 | 25.65 |"
    assert has_numbers("gof yes 0.387 0.931", printed) and has_numbers("| PSNR | 6.16 | 4.24 | 25.65 |", printed)
    assert not has_numbers("gof yes 0.416 0.931", printed) and not has_numbers("mine 0.388 0.931", printed)


def test_output_is_compared_without_its_numbers():
    assert without_numbers("rms 2.08 us\n (max 3.4,  0") == without_numbers("rms 11 us (max 1,234.5, 7")
    assert without_numbers("L2 beats zero") not in without_numbers("L2 beats  constant")
