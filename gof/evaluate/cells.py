"""Names as text in the cells of tables that other programs read: a name from a file is no formula, link or markup."""

from __future__ import annotations

import html
import re

from gof.core.errors import printable


def in_csv(name: str) -> str:
    """Spreadsheets run cells that begin like a formula, also in quotes, but not after an apostrophe."""
    line = one_line(name)
    return f"'{line}" if line.startswith(("=", "+", "-", "@")) else line


def in_markdown(name: str) -> str:
    """One line, without another column, a link, a style or HTML."""
    return re.sub(r"([\\`*_\[\]()|!~#])", r"\\\1", html.escape(one_line(name), quote=False))


def one_line(name: str) -> str:
    """Without line ends, tabs, and what acts on terminals."""
    return printable(" ".join(name.split()))
