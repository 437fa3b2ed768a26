"""One command for several datasets or takes: one after the other, and a fault of one does not end the others."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from gof.commands.everywhere import DEBUG_VARIABLE, write_figures
from gof.core.errors import GofError, in_words


def run_each(sources: Sequence[Path], run: Callable[[Path], dict]) -> int:
    """Run a command for each source; errors are printed where they occur, and once more at the end.

    Args:
        run: makes what belongs to one source, and returns its figures.
    Returns:
        the exit status: 1 where one failed. The figures of --json are {"runs": [{"source", its figures or "error"}]}.
    """
    if len(sources) == 1:
        write_figures(run(sources[0]))
        return 0
    runs: list[dict] = []
    for number, source in enumerate(sources, 1):
        print(f"{number} of {len(sources)}: {source}", flush=True)
        try:
            runs.append({"source": str(source), **run(source)})
        except GofError as error:
            if os.environ.get(DEBUG_VARIABLE):
                traceback.print_exc()
            runs.append({"source": str(source), "error": in_words(error)})
            print(f"{source}: {in_words(error)}", file=sys.stderr, flush=True)
    write_figures({"runs": runs})
    failed = [each for each in runs if "error" in each]
    if failed:
        print(f"{len(failed)} of {len(runs)} failed:", file=sys.stderr)
    for each in failed:
        print(f"  {each['source']}: {each['error']}", file=sys.stderr)
    return min(len(failed), 1)


def folder_of_each(sources: Sequence[Path], out: Path | None) -> Callable[[Path], Path | None]:
    """Return the function from a source to its place in `out`: `out` itself for a single one, else OUT/NAME.

    Raises:
        GofError: two sources have one name.
    """
    if out is None or len(sources) == 1:
        return lambda source: out
    names = [source.resolve().name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise GofError(f"two of them are named {name}: --out has one folder for each name; give them one by one")
    return lambda source: out / source.resolve().name
