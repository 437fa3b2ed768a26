"""GoF-Bench: a frozen list of scenes, in sizes, some to develop on and some to be scored on.

A scene is a fire of `gof_benchmark.fires`, or a built-in scene, and how it is seen: `gof_bench_2.json` holds the list,
and how all of its fires shine and move. A suite does not change once it is out: the next one has another number, and
this one is sealed, as the test fires are.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

from gof.core.errors import GofError
from gof.core.files import read_json
from gof.core.records import read_record
from gof_benchmark.fires import SPLITS, Split, fires, require_seal
from gof_benchmark.scenes import FOLDER as BUILT_IN
from gof_benchmark.solvers.openfoam.foam_fire import FoamFire
from gof_blender.pure.spec import SceneSpec

FOLDER = Path(__file__).parent
FILE = FOLDER / "gof_bench_2.json"
Size = Literal["preview", "standard", "full"]  # rungs of gof.core.ladder
SIZES: tuple[Size, ...] = get_args(Size)


@dataclass(frozen=True)
class ListedScene:
    """A line of the list.

    Attributes:
        fire: "dev/NAME", "test/NAME" or "scenes/NAME", whose spec it is.
        speeds: of the fire's, where it does not move as the list says: a small jet at physical speeds is a candle.
        background, cameras: what is seen otherwise than in the fire's own spec: the surroundings, and with them the
            light; fields of the rig.
    """

    name: str
    split: Split
    fire: str
    speeds: str | None = None
    background: str | None = None
    cameras: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class SuiteSize:
    """A cost preset for all scenes, None for their own settings; and which scenes there are, None for all."""

    preset: str | None
    scenes: tuple[str, ...] | None


@dataclass(frozen=True)
class SuiteList:
    """gof_bench_2.json.

    Attributes:
        ground_truth: what every scene has beside its velocities.
        fire: fields of every fire that we simulate, whatever its own spec says.   cameras: likewise, of every rig.
    """

    SCHEMA: ClassVar[str] = "gof-suite"
    VERSION: ClassVar[int] = 1

    name: str
    sizes: dict[str, SuiteSize]
    ground_truth: tuple[str, ...]
    scenes: tuple[ListedScene, ...]
    fire: dict[str, Any] = dataclasses.field(default_factory=dict)
    cameras: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class SuiteScene:
    """A scene of the suite in a size.

    Attributes:
        fire: what burns, as its line says.
        spec: of a fire of grids with their folder relative to the place where all fires are solved.
        foam: what OpenFOAM has to solve first; None for a fire that we simulate.
    """

    name: str
    split: Split
    fire: str
    spec: SceneSpec
    foam: FoamFire | None

    @property
    def digest(self) -> str:
        """SHA-256 of the spec's fields, whatever version writes them: other ones are another scene."""
        fields = {name: value for name, value in self.spec.to_dict().items() if name != "version"}
        return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()

    @property
    def solver(self) -> str:
        return "Mantaflow" if self.foam is None else "OpenFOAM"


def suite_name() -> str:
    return read_record(SuiteList, FILE).name


def scenes_of(size: Size, split: Split | Literal["all"] = "all") -> list[SuiteScene]:
    """Return the scenes of a size, in the list's order.

    Raises:
        DataFormatError: the list, a truth or a test fire is not as it was sealed.
    """
    require_seal(FOLDER)
    listed = read_record(SuiteList, FILE)
    chosen = listed.sizes[size]
    burning = _specs()
    return [
        _scene(line, listed, chosen.preset, *burning[line.fire])
        for line in listed.scenes
        if (chosen.scenes is None or line.name in chosen.scenes) and split in (line.split, "all")
    ]


def split_of(words: tuple[str, ...], default: str = "test") -> tuple[str, tuple[str, ...]]:
    """Return the split that a first word "dev", "test" or "all" names, and the names of scenes that follow."""
    return (words[0], words[1:]) if words[:1] in (("dev",), ("test",), ("all",)) else (default, words)


def choose(size: Size, words: tuple[str, ...]) -> list[SuiteScene]:
    """Return the scenes of a size that words name, see `split_of`; all without any. Raises GofError: one is not
    there."""
    split, names = split_of(words, "all")
    return pick(scenes_of(size, split), names)


def pick(scenes: list[SuiteScene], names: tuple[str, ...]) -> list[SuiteScene]:
    """Return the named ones of them, all where no name is given. Raises GofError: one is not there."""
    unknown = sorted(set(names) - {scene.name for scene in scenes})
    if unknown:
        listed = ", ".join(scene.name for scene in scenes)
        raise GofError(f"no scene {', '.join(map(repr, unknown))} in this size and split; there are {listed}")
    return [scene for scene in scenes if not names or scene.name in names]


def _specs() -> dict[str, tuple[SceneSpec, FoamFire | None]]:
    """Return every fire that a line can name."""
    found = {fire.name: (fire.spec, fire.foam) for split in SPLITS for fire in fires(split)}
    for path in BUILT_IN.glob("*/spec.json"):
        spec = SceneSpec.from_dict(read_json(path))
        found[f"scenes/{path.parent.name}"] = spec, None
    return found


def _scene(
    line: ListedScene, listed: SuiteList, preset: str | None, spec: SceneSpec, foam: FoamFire | None
) -> SuiteScene:
    speeds = {"speeds": line.speeds} if line.speeds else {}
    seen = dataclasses.replace(
        spec,
        name=line.name,
        fire=spec.fire if foam else dataclasses.replace(spec.fire, **listed.fire | speeds),
        ground_truth=listed.ground_truth,
        background=line.background or spec.background,
        cameras=dataclasses.replace(spec.cameras, **listed.cameras | line.cameras),
    )
    if preset:  # grids end when they end: a fire of grids keeps its clip
        dearer = seen.with_preset(preset)
        seen = dearer if foam is None else dataclasses.replace(dearer, clip=seen.clip)
    return SuiteScene(line.name, line.split, line.fire, seen, foam)
