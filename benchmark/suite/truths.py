"""The recorded truths of the suite's fires: truth.json.

Cameras and surroundings do not change a fire: scenes of one fire share its truth, and it is recorded once a size. What
has not been made yet has no record, and is said to have none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from gof.core.records import read_record
from gof.dataset import Dataset
from gof.dataset.truth import Truth
from gof_benchmark.suite import FOLDER, SEALED, Size, SuiteScene

FILE = FOLDER / "truth.json"

Verdict = Literal["same", "not to the bit", "unknown"]


@dataclass(frozen=True)
class SuiteTruths:
    """truth.json: `fires[FIRE][SIZE]`, sizes as in SEALED; `made_with`: the programs that made them."""

    SCHEMA: ClassVar[str] = "gof-suite-truth"
    VERSION: ClassVar[int] = 1

    made_with: dict[str, str]
    fires: dict[str, dict[str, Truth]]


def compare(scene: SuiteScene, size: Size, dataset: Dataset) -> tuple[Verdict, str]:
    """A made scene's truth against the recorded one, and in words."""
    truths = read_record(SuiteTruths, FILE)
    recorded = truths.fires.get(scene.fire, {}).get(SEALED[size])
    if recorded is None:
        return "unknown", f"no truth of {scene.fire} is recorded in this size: nobody has made it yet"
    differs = Truth.of(dataset).differs(recorded)
    if not differs:
        return "same", "its truth is the recorded one, to the bit"
    made_with = truths.made_with[scene.solver]
    said = f"{differs}. {scene.solver} is not bit-stable between processors ({made_with} made the recorded one)"
    return "not to the bit", f"{said}: scores may differ a little"
