"""`gof study WHAT`: accuracy against time of one part of the software; each writes its table with --json FILE."""

from __future__ import annotations

import importlib

from gof.errors import GofError

STUDIES = {
    "dve": "gof_benchmark.studies.dve",
    "generate": "gof_benchmark.studies.generator",
    "reconstruct": "gof_benchmark.studies.reconstruction",
    "ablations": "gof_benchmark.studies.reconstruction",
}
TAKES_ITS_NAME = ("dve", "reconstruct", "ablations")  # these modules read the study's name as their first argument


def main(argv: list[str]) -> int:
    """Run the study that the first argument names; each explains itself with --help.

    Raises:
        GofError: no study of that name.
    """
    if not argv or argv[0] not in STUDIES:
        if argv and argv[0] in ("-h", "--help"):
            print(f"usage: gof study {{{','.join(STUDIES)}}} [OPTIONS]\n\n{__doc__}")
            return 0
        raise GofError(f"name what to study: gof study {{{','.join(STUDIES)}}}")
    return importlib.import_module(STUDIES[argv[0]]).main(argv if argv[0] in TAKES_ITS_NAME else argv[1:]) or 0
