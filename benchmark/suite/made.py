"""The scenes of the suite that are made in a folder, as `gof benchmark make` leaves them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.core.records import read_record
from gof.dataset import Dataset
from gof.dataset.pack import VelocityFingerprint
from gof_benchmark.suite import FOLDER, SIZES, Size, SuiteScene, scenes_of
from gof_benchmark.views.shrunk import SHRUNK
from gof_blender.core.checked_json import SpecError
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec


@dataclass(frozen=True)
class MadeScene:
    """A scene and its dataset."""

    scene: SuiteScene
    dataset: Dataset

    @property
    def pictures(self) -> str:
        """Their size, and whether they were made smaller than the suite's (`gof_benchmark.views.shrunk`)."""
        first = self.dataset.cameras[0]
        smaller = ", smaller than the suite's" if SHRUNK in self.dataset.description.provenance else ""
        return f"{first.width}x{first.height}{smaller}"


def made_scenes(folder: Path, split: str = "all") -> dict[str, MadeScene]:
    """Return the finished scenes of WORK/SIZE, by name.

    Raises:
        DataFormatError: not a size's folder, nothing finished in it, or a scene there was made from another spec.
    """
    size = size_of(folder)
    if size is None:
        raise DataFormatError(f"{folder}: not the folder of a size ({', '.join(SIZES)}) that 'gof benchmark make' made")
    found = {}
    for scene in scenes_of(size, split):
        layout = Layout(folder / scene.name)
        if layout.description.exists():
            _require_spec(scene, layout)
            found[scene.name] = MadeScene(scene, Dataset.open(layout.root))
    if not found:
        raise DataFormatError(f"{folder}: no finished scene; make them with: gof benchmark make {folder.parent}")
    return found


def size_of(folder: Path) -> Size | None:
    """Return the size whose scenes a folder holds, by its name; None where it is none."""
    return next((size for size in SIZES if size == folder.resolve().name), None)


def scene_of(dataset: Path) -> MadeScene:
    """Return the scene whose dataset lies in WORK/SIZE/SCENE. Raises DataFormatError: it is none of the suite."""
    name = dataset.resolve().name
    found = made_scenes(dataset.resolve().parent)
    if name not in found:
        raise DataFormatError(f"{dataset}: not a finished scene of the suite; there are {', '.join(found)}")
    return found[name]


def _require_spec(scene: SuiteScene, layout: Layout) -> None:
    """Raise DataFormatError: the dataset is of another spec than the suite's."""
    try:
        made = SceneSpec.from_dict(read_json(layout.spec))
    except SpecError as e:
        raise DataFormatError(f"{layout.spec}: {e}; make the scene again") from e
    different = [part for part in made.differences(scene.spec) if part != "fire" or scene.foam is None]
    if different:
        raise DataFormatError(
            f"{layout.root}: was made from another spec ({', '.join(different)} differ) and is not the suite's scene; "
            "remove the folder and make it again"
        )


# ----------------------------------------------------------------
# The recorded truths of the suite's fires: truth.json.
#
# Cameras and surroundings do not change a fire: scenes of one fire share its truth, and it is recorded once a size. A
# size that has not been made yet has no record.

FILE = FOLDER / "truth.json"

Verdict = Literal["same", "not to the bit", "unknown"]


@dataclass(frozen=True)
class SuiteTruths:
    """truth.json: `fires[FIRE][SIZE]`; `made_with`: the programs that made them."""

    SCHEMA: ClassVar[str] = "gof-suite-truth"
    VERSION: ClassVar[int] = 1

    made_with: dict[str, str]
    fires: dict[str, dict[str, VelocityFingerprint]]


def compare(scene: SuiteScene, size: Size, dataset: Dataset) -> tuple[Verdict, str]:
    """Return a made scene's truth against the recorded one, and in words."""
    truths = read_record(SuiteTruths, FILE)
    recorded = truths.fires.get(scene.fire, {}).get(size)
    if recorded is None:
        return "unknown", f"no truth of {scene.fire} is recorded in this size: it has not been made yet"
    differs = VelocityFingerprint.of(dataset).differs(recorded)
    if not differs:
        return "same", "its truth is the recorded one, to the bit"
    made_with = truths.made_with[scene.solver]
    words = f"{differs}. {scene.solver} differs slightly between CPUs ({made_with} made the recorded fire)"
    return "not to the bit", f"{words}: scores may differ a little"
