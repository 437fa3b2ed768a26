"""The fires that come with the benchmark, by name."""

from __future__ import annotations

from pathlib import Path

from gof.core.errors import DataFormatError
from gof.core.records import read_record
from gof_benchmark.solvers.openfoam.case import FoamFire

FIRES = Path(__file__).parent / "fires"


def find_fire(name: str) -> FoamFire:
    """The description of a file, or of a fire that comes with the benchmark.

    Raises:
        DataFormatError: neither; names those that there are.
    """
    path = Path(name) if name.endswith(".json") else FIRES / f"{name}.json"
    if not path.exists():
        raise DataFormatError(
            f"{path}: no such file; fires by name: {', '.join(sorted(p.stem for p in FIRES.glob('*.json')))}"
        )
    return read_record(FoamFire, path)
