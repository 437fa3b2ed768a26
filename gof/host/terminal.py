"""What people see in a terminal: texts from files are text there, not colours, links or commands to the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gof.core.errors import printable

if TYPE_CHECKING:
    from rich.console import Console


def console() -> Console:
    """Where commands print their tables: no markup, no emoji, nothing that acts; styles are given as arguments."""
    from rich.console import Console

    class PlainConsole(Console):
        """One whose texts are `printable`, in tables too."""

        def render_str(self, text: str, **options):
            return super().render_str(printable(text), **options)

    return PlainConsole(markup=False, emoji=False, highlight=False)
