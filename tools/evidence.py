"""Run the scripts of benchmark/evidence and keep what they print: python -m tools.evidence [NAME ...] [--again]

Each script's figures go to evidence/NAME.json, with command, commit, date, CPU and seconds. A script whose file is
there is kept. Without names, all scripts run that need no dataset; the others are listed with what they need. A
single one can have words of its own: python -m tools.evidence choices -- data/fire --only ours

A page quotes a figure by a comment behind it, which a code host and the site both hide:

    read to 4.6 us<!-- evidence: ring_accuracy / as it comes / fused times, rms error (us) -->

or has rows of a script's table below such a comment on a line of its own: <!-- evidence: ring_accuracy -->
`wrong_quotes` finds figures and rows that no file has; the site is not built with one, and a test fails.
"""

from __future__ import annotations

import argparse
import datetime
import re
import subprocess
import sys
import time
from pathlib import Path

from gof.core.files import read_json, write_json
from gof.host.checks import cpu_name

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "benchmark" / "evidence" / "README.md"
FOLDER = ROOT / "evidence"
SCHEMA, VERSION = "gof-evidence", 1
COMMAND = re.compile(r"\| `python -m gof_benchmark\.evidence\.(\w+)([^`]*)`([^|]*)\|")
QUOTE = re.compile(r"<!-- evidence: (\w+)(?: / (.+?) / (.+?))? -->")


def commands() -> dict[str, tuple[list[str], str]]:
    """Return the words and the needs ("": none) of each script by its name, as the table of evidence has them."""
    found = {}
    for name, words, more in COMMAND.findall(TABLE.read_text(encoding="utf-8")):
        places = ", ".join(dict.fromkeys(re.findall(r"[A-Z]{3,}[\w/]*", words)))
        found[name] = (words.split(), places and f"needs {places} {more.strip()}".strip())
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
        "commit": _git("describe", "--always", "--dirty"),
        "date": datetime.date.today().isoformat(),
        "cpu": cpu_name(),
        "seconds": round(time.monotonic() - began, 1),
    }
    write_json(folder / f"{name}.json", about | {"figures": figures, "printed": printed.splitlines()})
    return ""


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


# ----------------------------------------------------------------
# Quotes in pages


def wrong_quotes(page: str, folder: Path = FOLDER) -> list[str]:
    """Return what a page quotes from evidence and no file says, one line each."""
    wrong = []
    for quote in QUOTE.finditer(page):
        name, row, column = quote.groups()
        file = folder / f"{name}.json"
        if not file.is_file():
            wrong.append(f"{quote[0]}: there is no {file.name}; make evidence ARGS={name} writes it")
        elif row is None:
            wrong += _strange_rows(page[quote.end() :], read_json(file)["printed"], file.name)
        else:
            cell = read_json(file)["figures"].get(row, {}).get(column)
            before = page[: quote.start()].rstrip(" *`")
            if cell is None:
                wrong.append(f"{quote[0]}: {file.name} has no such row and column")
            elif not re.search(rf"(?<![\w.]){re.escape(cell)}$", before):
                wrong.append(f"{quote[0]}: {file.name} says {cell}, the page ...{before[-20:]}")
    return wrong


def _strange_rows(after: str, printed: list[str], name: str) -> list[str]:
    rows = [row for table in _tables("\n".join(printed)) for row in table[1:]]
    shown = next(iter(_tables(after.lstrip("\n").split("\n\n")[0])), [])
    if not shown:
        return [f"no table below the comment on {name}"]
    return [f"{name} has no row | {' | '.join(row)} |" for row in shown[1:] if row not in rows]


def main(argv: list[str] | None = None) -> int:
    """Run what is asked for; the exit status is 0 also where scripts were skipped, which are listed."""
    words = sys.argv[1:] if argv is None else argv
    words, own = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, None)
    parser = argparse.ArgumentParser(prog="python -m tools.evidence", description=__doc__.split("\n")[0])
    known = commands()
    parser.add_argument("names", nargs="*", metavar="NAME", help="scripts of benchmark/evidence; default: all")
    parser.add_argument("--again", action="store_true", help="run also what has its file")
    asked = parser.parse_args(words)
    if unknown := set(asked.names) - set(known):
        parser.error(f"no such script: {', '.join(sorted(unknown))}; benchmark/evidence/README.md lists them")
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
