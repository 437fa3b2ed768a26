"""The benchmark's fires: specs in two parts. Every choice is made on `dev`; `test` is made once, and only scored.

`dev/*.json` and `test/*.json` are scene specs. A fire that we simulate is one of them alone; one that burns grids of
OpenFOAM names their folder relative to the place where all fires are made (`openfoam/<fire>/grids`). The test specs
are sealed: `test/SHA256SUMS` holds their digests, as `sha256sum` writes them.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof_benchmark.solvers.openfoam.foam_fire import FoamFire, find_fire
from gof_blender.core.checked_json import SpecError
from gof_blender.pure.fires import GridFire
from gof_blender.pure.spec import SceneSpec

FOLDER = Path(__file__).parent
SEAL = "SHA256SUMS"
Split = Literal["dev", "test"]
SPLITS: tuple[Split, ...] = ("dev", "test")


@dataclass(frozen=True)
class BenchmarkFire:
    """One fire of the benchmark.

    Args:
        spec: as it stands in the file: the folder of its grids, if it burns any, is relative.
        foam: what OpenFOAM has to solve first; None for a fire that we simulate.
    """

    split: Split
    spec: SceneSpec
    foam: FoamFire | None

    @property
    def name(self) -> str:
        """With its split, as its folder is named: "dev/pool_wide"."""
        return f"{self.split}/{self.spec.name}"


def fires(split: Split, folder: Path = FOLDER) -> list[BenchmarkFire]:
    """Return all fires of a split, by name.

    Raises:
        DataFormatError: a spec is wrong, is not named as its file, or is of the test split and not as it was sealed.
    """
    if split == "test":
        require_seal(folder / split)
    return [_read(split, path) for path in sorted((folder / split).glob("*.json"))]


def _read(split: Split, path: Path) -> BenchmarkFire:
    try:
        spec = SceneSpec.from_dict(read_json(path))
    except SpecError as error:
        raise DataFormatError(f"{path}: {error}") from error
    if spec.name != path.stem:
        raise DataFormatError(f"{path}: its name is '{spec.name}'; file and spec are named alike")
    if not isinstance(spec.fire, GridFire):
        return BenchmarkFire(split, spec, None)
    place = Path(spec.fire.grids).parts
    if len(place) != 3 or (place[0], place[2]) != ("openfoam", "grids"):
        raise DataFormatError(f"{path}: fire.grids is '{spec.fire.grids}', expected 'openfoam/<fire>/grids'")
    return BenchmarkFire(split, spec, find_fire(place[1]))


def require_seal(folder: Path) -> None:
    """Check that the JSON files of a folder are those of its `SHA256SUMS`.

    Raises:
        DataFormatError: one was changed, added or taken away (names it).
    """
    lines = [line.split(maxsplit=1) for line in (folder / SEAL).read_text(encoding="utf-8").splitlines()]
    sealed = {name.lstrip("*"): digest for digest, name in lines}
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.json")}
    wrong = sorted(name for name in sealed.keys() | found.keys() if sealed.get(name) != found.get(name))
    if wrong:
        raise DataFormatError(
            f"{folder}: {', '.join(wrong)} is not as sealed in {SEAL}. A test fire must not change: older scores "
            "could not be compared any more. Take the file of the release; a new fire gets a new name"
        )
