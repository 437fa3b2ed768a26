"""Run the scripts of benchmark/evidence and keep what they print: python -m tools.evidence [NAME ...] [--again]

Each script's figures go to evidence/NAME.json, with command, commit, date, CPU and seconds. A script whose file is
there is kept. Without names, all scripts run that need no dataset; the others are listed with what they need. A
single one can have words of its own: python -m tools.evidence choices -- data/fire --only ours

Figures of runs that take hours, or were made elsewhere, are kept: `--keep TABLES.md --commit C --seconds S NAME --
COMMAND` puts the tables of a Markdown file into evidence/NAME.json with the command that made them, the commit's date,
the seconds that it took, and the CPU: this machine's, or `--cpu TEXT`.

A page quotes figures below a comment on a line of its own, which a code host hides and the site turns into a line that
says command, commit, date and CPU: <!-- evidence: ring_accuracy --> or, of several files, <!-- evidence: a, b -->
Below it stands a table, each row as a file has it, or text whose measured figures all stand in a file. A single figure:

    read to 4.6 us<!-- evidence: ring_accuracy / as it comes / fused times, rms error (us) -->

`wrong_quotes` finds figures that no file has: the site is not built with one, and a test fails. `unquoted` finds
measured figures that quote no file, on which a test fails.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import re
import subprocess
import sys
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path

from gof.core.files import read_json, write_json
from gof.host.checks import cpu_name

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "benchmark" / "evidence"
FOLDER = ROOT / "evidence"
SCHEMA, VERSION = "gof-evidence", 1
USAGE = re.compile(r"^ {4}python -m gof_benchmark\.evidence\.(\w+)\b(.*)$", re.MULTILINE)  # [what may be left out]
TAKES = re.compile(r"^Takes (.+?)\.(?: Needs (.+)\.)?$", re.MULTILINE)
QUOTE = re.compile(r"<!-- evidence: (\w+(?:, \w+)*)(?: / (.+?) / (.+?))? -->")
ALONE = re.compile(r"^<!-- evidence: (\w+(?:, \w+)*) -->$", re.MULTILINE)  # for the table or text below it
# Figures with the unit of a measurement, scores, and charts that a script draws.
MEASURED = re.compile(
    r"\d ?(?:dB|ms|us|fps|frames/s|GB|MB|%|m/s|CPU s|min|h)(?![\w-])|\d s\b|(?<![\w.])\d+\.\d{2,}(?!\d|\.\d)"
)
CHART = re.compile(r"\]\((?:\.\./)?figures/\w+\.svg\)")
NUMBERS_OF_NAMES = re.compile(r"`[^`]*`|\b(?:Python|numpy|arXiv) \d[\d.]*(?: to \d[\d.]*)?")
FIGURE = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]*\d)")


@dataclass(frozen=True)
class Script:
    """A script of benchmark/evidence, by its docstring: what it measures, how it is run, how long, with what."""

    measures: str
    words: list[str]
    takes: str
    needs: str  # "": nothing but this machine

    @property
    def places(self) -> str:
        """Words in capitals, which stand for files of the reader; "": there are none."""
        return ", ".join(dict.fromkeys(re.findall(r"[A-Z]{3,}[\w/]*", " ".join(self.words))))


def scripts() -> dict[str, Script]:
    """Return every script by its name. Raises ValueError: a docstring has no usage, or no line on time and needs."""
    found = {}
    for path in sorted(SCRIPTS.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        if 'if __name__ == "__main__":' not in text:
            continue
        about = ast.get_docstring(ast.parse(text)) or ""
        usage = {name: words for name, words in USAGE.findall(about)}
        takes = TAKES.search(about)
        if path.stem not in usage or takes is None:
            raise ValueError(f"{path}: its docstring lacks its command, or a line that begins with Takes")
        words = re.sub(r"\[[^]]*\]", "", usage[path.stem]).split()
        summary = re.split(r"(?<=[.?])\s", about)[0]
        found[path.stem] = Script(summary, words, takes[1], takes[2] or "")
    return found


def commands() -> dict[str, tuple[list[str], str]]:
    """Return the words and the needs ("": it runs with nothing but this machine) of each script by its name."""
    found = {}
    for name, script in scripts().items():
        more = f" ({script.needs})" if script.needs else ""
        found[name] = (script.words, f"needs {script.places}{more}" if script.places else "")
    return found


def tables_in(printed: str) -> dict[str, dict[str, str]]:
    """Return the cells of all Markdown tables in a text: row, column, cell.

    A row is named by its first cell, or by so many of its first cells as tell all rows of its table apart.
    """
    found: dict[str, dict[str, str]] = {}
    for head, *rows in _tables(printed):
        cells = next((k for k in range(1, len(head)) if len({tuple(row[:k]) for row in rows}) == len(rows)), len(head))
        for row in rows:
            found.setdefault(", ".join(row[:cells]), {}).update(zip(head, row, strict=False))
    return found


def _tables(text: str) -> list[list[list[str]]]:
    """Return rows of cells of each table, its head first, without the line below the head."""
    tables: list[list[list[str]]] = [[]]
    for line in text.splitlines():
        if line.startswith("|"):
            tables[-1].append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif tables[-1]:
            tables.append([])
    return [[table[0], *(row for row in table[1:] if set("".join(row)) - set("-: "))] for table in tables if table]


def run(name: str, words: list[str], folder: Path = FOLDER) -> str:
    """Run a script, write its file, and return "" or, without a file, why it did not end well."""
    command = ["python", "-m", f"gof_benchmark.evidence.{name}", *words]
    began = time.monotonic()
    done = subprocess.run([sys.executable, *command[1:]], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["no word"])[-1]
    printed = done.stdout.replace(f"{ROOT}/", "")
    figures = tables_in(printed)
    if not figures and (skipped := re.search(r"^skipped: (.*)$", printed, re.MULTILINE)):
        return skipped[1]
    about = {
        "schema": SCHEMA,
        "version": VERSION,
        "command": " ".join(command),
        "commit": _commit(),
        "date": datetime.date.today().isoformat(),
        "cpu": cpu_name(),
        "seconds": round(time.monotonic() - began, 1),
    }
    write_json(folder / f"{name}.json", about | {"figures": figures, "printed": printed.splitlines()})
    return ""


def keep(name: str, tables: str, command: str, commit: str, seconds: float, cpu: str, folder: Path = FOLDER) -> None:
    """Write the file of figures that nothing here prints again."""
    about = {
        "schema": SCHEMA,
        "version": VERSION,
        "command": command,
        "commit": _git("rev-parse", "--short", commit),  # HEAD is another one tomorrow
        "date": _git("show", "--no-patch", "--format=%as", commit),
        "cpu": cpu,
        "seconds": seconds,
    }
    write_json(folder / f"{name}.json", about | {"figures": tables_in(tables), "printed": tables.splitlines()})


def _commit() -> str:
    """Return the commit of the code, with "-dirty" where a file beside the figures themselves differs from it."""
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", f":!{FOLDER.name}")
    return _git("describe", "--always") + ("-dirty" if changed else "")


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


# ----------------------------------------------------------------
# Quotes in pages


def wrong_quotes(page: str, folder: Path = FOLDER) -> list[str]:
    """Return what a page quotes from evidence and no file says, one line each."""
    wrong = []
    for quote in QUOTE.finditer(page):
        names, row, column = quote.groups()
        files = [folder / f"{name}.json" for name in names.split(", ")]
        if absent := [file.name for file in files if not file.is_file()]:
            wrong.append(f"{quote[0]}: there is no {absent[0]}; make evidence ARGS={absent[0][:-5]} writes it")
        elif row is None:
            printed = [line for file in files for line in read_json(file)["printed"]]
            wrong += _strange_figures(_block_after(page[quote.end() :]), printed, names)
        else:
            cell = read_json(files[0])["figures"].get(row, {}).get(column)
            before = page[: quote.start()].rstrip(" *`")
            if cell is None:
                wrong.append(f"{quote[0]}: {files[0].name} has no such row and column")
            elif not re.search(rf"(?<![\w.]){re.escape(cell)}$", before):
                wrong.append(f"{quote[0]}: {files[0].name} says {cell}, the page ...{before[-20:]}")
    return wrong


def unquoted(page: str) -> dict[str, list[str]]:
    """Return the parts of a page that show measured figures and quote no file of evidence, by the heading above them.

    Code, links, and figures with a quote behind them are left out. A chart stands below the quote of its section.
    """
    found: dict[str, list[str]] = {}
    heading, quoted, in_section = "", False, False
    page = re.sub(r"^(```|~~~).*?^\1|^    [^\n]*", "", page, flags=re.MULTILINE | re.DOTALL)
    for block in re.split(r"\n\s*\n", re.sub(r"\S+<!-- evidence: \w+ / .+? -->", "", page)):
        if title := re.match(r"#+ (.*)", block):
            heading, in_section = title[1], False
        text = re.sub(r"\]\([^)]*\)", "]", NUMBERS_OF_NAMES.sub("", ALONE.sub("", block)))
        quoted = quoted or bool(ALONE.search(block))
        in_section = in_section or quoted
        if text.strip():
            if (MEASURED.search(text) and not quoted) or (CHART.search(block) and not in_section):
                found.setdefault(heading, []).append(block.strip())
            quoted = False
    return found


def _block_after(text: str) -> str:
    return text.lstrip("\n").split("\n\n")[0]


def _strange_figures(block: str, printed: list[str], names: str) -> list[str]:
    known = {tuple(map(_plain, row)) for table in _tables("\n".join(printed)) for row in table[1:]}
    shown = next(iter(_tables(block)), [])
    strange = [row for row in shown[1:] if tuple(map(_plain, row)) not in known]
    wrong = [f"{names} has no row | {' | '.join(row)} |" for row in strange]
    if not shown:
        figures = set(FIGURE.findall("\n".join(printed)))
        said = FIGURE.findall(re.sub(r"\]\([^)]*\)", "]", NUMBERS_OF_NAMES.sub("", block)))
        wrong = [f"{names} has no figure {figure}" for figure in said if figure not in figures]
        wrong += [] if said else [f"no figures below the comment on {names}"]
    return wrong


def _plain(cell: str) -> str:
    return cell.replace("*", "")


def caption(names: str, folder: Path = FOLDER) -> str:
    """Return how the figures of files were made, in one line."""
    made = []
    for name in names.split(", "):
        about = read_json(folder / f"{name}.json")
        command = textwrap.shorten(about["command"], 90, placeholder=" ...")
        origin = f"commit {about['commit']} of {about['date']}"
        made.append(", ".join(filter(None, (f"`{command}`", origin, about["cpu"]))))
    return "; ".join(made)


def main(argv: list[str] | None = None) -> int:
    """Run what is asked for; the exit status is 0 also where scripts were skipped, which are listed."""
    words = sys.argv[1:] if argv is None else argv
    words, own = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, None)
    parser = argparse.ArgumentParser(prog="python -m tools.evidence", description=__doc__.split("\n")[0])
    known = commands()
    parser.add_argument("names", nargs="*", metavar="NAME", help="scripts of benchmark/evidence; default: all")
    parser.add_argument("--again", action="store_true", help="run also what has its file")
    parser.add_argument(
        "--keep", metavar="TABLES.md", type=Path, help="keep these tables as NAME; -- COMMAND made them"
    )
    parser.add_argument("--commit", metavar="C", help="with --keep: of the code that made them")
    parser.add_argument("--seconds", metavar="S", type=float, help="with --keep: how long that took, all runs together")
    parser.add_argument("--cpu", default=cpu_name(), help="with --keep: where; default: this machine's")
    asked = parser.parse_args(words)
    if asked.keep:
        if own is None or len(asked.names) != 1 or not asked.commit or asked.seconds is None:
            parser.error("--keep wants one NAME, --commit, --seconds, and the command after --")
        tables = asked.keep.read_text(encoding="utf-8")
        keep(asked.names[0], tables, " ".join(own), asked.commit, asked.seconds, asked.cpu)
        return 0
    if unknown := set(asked.names) - set(known):
        parser.error(f"no such script: {', '.join(sorted(unknown))}; python -m tools.references evidence lists them")
    if own is not None and len(asked.names) != 1:
        parser.error("words after -- are for one script; name it")
    for name in asked.names or known:
        given, needs = known[name]
        if own is None and needs:
            print(f"{name}: skipped, {needs}")
        elif not asked.again and own is None and (FOLDER / f"{name}.json").exists():
            print(f"{name}: kept, evidence/{name}.json is there")
        else:
            print(f"{name}: runs", flush=True)
            failed = run(name, given if own is None else own)
            print(f"{name}: {f'skipped, {failed}' if failed else f'written, evidence/{name}.json'}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
