"""Paths of a dataset's files; no other module knows them."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from ..core.checked_json import SpecError
from ..core.files import read_json, write_json
from . import spec as scene_spec
from .spec import SceneSpec

WHAT_BURNS = "seed", "clip", "domain", "fire", "effects"
"""Fields of a spec on which its fire depends, or the flame's look; not cameras, surroundings and quality."""

DRAWN = ("density", "shadow", "flame", "heat", "vel", "color_r", "color_g", "color_b")
"""Grids of a solver's step that pictures and truth read; from the others, which are its state, a bake goes on."""
STATES = 3  # newest steps whose state is kept

CUT_OFF = 0.05  # of the light of the widest section, from which a flame counts as cut off by the domain's side


@dataclass(frozen=True)
class FrameFiles:
    """Files of one camera at one instant."""

    rgb: Path
    exr: Path
    mask: Path


@dataclass(frozen=True)
class Layout:
    """Paths inside the dataset folder ``root``."""

    root: Path

    PATTERNS = {
        "rgb": "cameras/{camera}/rgb/{frame:06d}.png",
        "exr": "cameras/{camera}/exr/{frame:06d}.exr",
        "mask": "cameras/{camera}/mask/{frame:06d}.png",
    }
    FLOW = "cameras/{camera}/flow/{frame:06d}.exr"
    STATIC = "static/{camera}.png"
    BOARD_MASK = "cameras/{camera}/board_mask.png"

    @property
    def description(self) -> Path:
        return self.root / "dataset.json"

    @property
    def spec(self) -> Path:
        return self.root / "spec.json"

    @property
    def local_spec(self) -> Path:
        """Return the spec with the places of its files on this machine, which are private."""
        return self.hidden / "spec.json"

    @property
    def inputs(self) -> Path:
        """Return the spec's files as they were when the folder was claimed."""
        return self.hidden / "inputs.json"

    @property
    def costs(self) -> Path:
        return self.root / "costs.json"

    @property
    def report(self) -> Path:
        return self.root / "report.html"

    @property
    def background(self) -> Path:
        """Return the surroundings of the user's scene, where that is the background."""
        return self.root / scene_spec.BACKGROUND

    @property
    def blend(self) -> Path:
        return self.root / "scene.blend"

    @property
    def velocity(self) -> Path:
        return self.root / "velocity.zarr"

    @property
    def hidden(self) -> Path:
        """Work files that a user may delete once the dataset is finished."""
        return self.root / ".cache"

    @property
    def brightness(self) -> Path:
        """Return the file with the exposure of the flame in the first picture."""
        return self.hidden / "brightness.json"

    @property
    def gain(self) -> Path:
        """By what an effect has set the exposure of all cameras, from the first picture."""
        return self.hidden / "gain.json"

    @property
    def bake(self) -> Path:
        return self.hidden / "bake"

    @property
    def bake_marker(self) -> Path:
        return self.hidden / "bake-finished.json"

    @property
    def bake_begun(self) -> Path:
        """Return the note of which Blender began the bake, written again whenever it begins or goes on."""
        return self.hidden / "bake-begun.json"

    @property
    def lent(self) -> Path:
        """Return the finished bake's marker of another dataset, whose fire this one takes over (`take_fire_of`)."""
        return self.hidden / "lent-fire.json"

    def cached_velocity(self, blender_frame: int) -> Path:
        """Cache file that our solver writes last in a step."""
        return self.bake / "data" / f"vel_{blender_frame:04d}.uni"

    def newest_step(self) -> int:
        """Return the newest step of our solver that is in the cache, 0 without one; those before it are complete."""
        return max((int(path.stem[4:]) for path in self.bake.glob("data/vel_*.uni")), default=0)

    def go_on_after(self, blender: str) -> int:
        """Return the step after which an unfinished bake goes on, with what came later removed; 0: it starts over.

        Args:
            blender: version that bakes. No fire is of two.
        """
        step = self.newest_step() - 1
        same = self.bake_begun.is_file() and read_json(self.bake_begun).get("blender") == blender
        if step < 1 or not same or not self.blend.is_file():
            return 0
        for path in self.bake.rglob("*_[0-9]*.*"):
            if _step_of(path) > step:
                path.unlink()
        return step

    def prune_bake(self, needed: range, finished: bool = False) -> None:
        """Remove from the cache of our solver what nothing reads: state of steps, and steps before `needed`.

        The newest steps keep theirs until the bake is finished.
        """
        old = self.newest_step() - (0 if finished else STATES)
        for path in self.bake.glob("data/*_[0-9]*.uni"):
            step = _step_of(path)
            if step <= old and (step < needed.start or path.stem.rpartition("_")[0] not in DRAWN):
                path.unlink(missing_ok=True)

    def step_grids(self, blender_frame: int) -> Path:
        """Return the file of a fire of grids that Cycles renders in a step."""
        return self.bake / f"{blender_frame:06d}.vdb"

    def is_baked(self, blender_frame: int) -> bool:
        """Return whether a frame's cache is complete, also while the bake goes on: the next step is then there too."""
        return self.bake_marker.is_file() or self.cached_velocity(blender_frame + 1).is_file()

    def pictures(self) -> int:
        """Return the number of finished pictures: their EXR is written last."""
        return sum(1 for _ in self.root.glob("cameras/*/exr/[0-9]*.exr"))

    def plates(self, cameras: list[str]) -> int:
        """Return the number of the cameras' plates that are finished."""
        return sum(self.static_exr(name).is_file() for name in cameras)

    def log(self, stage: str) -> Path:
        return self.hidden / f"{stage}.log"

    @property
    def job_log(self) -> Path:
        """Return the progress of a job, stage by stage, for people."""
        return self.hidden / "job.log"

    def claim(self, spec: SceneSpec) -> None:
        """Make the folder this spec's, or check that it is.

        Raises SpecError if the folder holds other things, or was made from another spec or files that have changed.
        """
        self.require_free(spec)
        try:
            if not self.spec.exists():
                self.root.mkdir(parents=True, exist_ok=True)
                write_json(self.spec, spec.published_in(self.root).to_dict(), indent=2)
        except OSError as error:
            raise SpecError(f"{self.root}: cannot be made ({error.strerror}); choose another output folder") from error
        write_json(self.local_spec, spec.to_dict())
        write_json(self.inputs, self._stamps(spec))

    def take_fire_of(self, other: Layout, spec: SceneSpec) -> None:
        """Take over the finished bake of another dataset, so that this spec costs pictures only; call after `claim`.

        The other dataset may be removed afterwards. Does nothing where this dataset is baked, or finished and its
        work files deleted.

        Raises SpecError: it has no finished bake, or another fire (what differs is named).
        """
        if self.bake_marker.is_file() or self.description.is_file():
            return
        if not (other.bake_marker.is_file() and other.bake.is_dir() and other.blend.is_file()):
            raise SpecError(f"{other.root}: holds no finished bake of a fire; it is in the dataset's .cache/bake")
        theirs = scene_spec.load(other.local_spec if other.local_spec.is_file() else other.spec)
        differs = [name for name in WHAT_BURNS if getattr(theirs, name) != getattr(spec, name)]
        if spec.blend_file or theirs.blend_file:
            raise SpecError("a fire in a scene of your own is baked with what stands in it; bake it again")
        needed, kept = spec.timeline.steps_needed, theirs.timeline.steps_needed  # cameras' clocks may want more steps
        if differs or needed.start < kept.start or needed.stop > kept.stop:
            raise SpecError(f"{other.root}: another fire burns there ({', '.join(differs) or 'fewer steps'} differ)")
        if moved := other._changed_inputs(spec):
            raise SpecError(f"{other.root} was made from {', '.join(moved)}, which has changed since; bake it again")
        shutil.rmtree(self.bake, ignore_errors=True)
        shutil.copytree(other.bake, self.bake, copy_function=_link_or_copy)
        shutil.copyfile(other.blend, self.blend)
        shutil.copyfile(other.bake_marker, self.lent)

    def require_free(self, spec: SceneSpec) -> None:
        """Raise SpecError where `claim` would; nothing is written."""
        if self.spec.exists():
            self._require_unchanged(spec.published_in(self.root).to_dict(), spec)
        elif self.root.exists() and not self.root.is_dir():
            raise SpecError(f"{self.root} is a file; choose a new output folder")
        elif self.root.is_dir() and not self._holds_nothing():
            raise SpecError(f"{self.root} is not empty and holds no spec.json; choose a new output folder")

    def _holds_nothing(self) -> bool:
        """Return whether the folder is empty, but for the lock of a run that was stopped before it claimed the
        folder."""
        inside = list(self.root.iterdir())
        if inside == [self.hidden] and self.hidden.is_dir():
            inside = [path for path in self.hidden.iterdir() if path.name != ".lock"]
        return not inside

    def _require_unchanged(self, published: dict, spec: SceneSpec) -> None:
        way_out = f"choose another output folder, or delete {self.root}"
        try:
            before = scene_spec.load(self.spec).published_in(self.root).to_dict()
        except SpecError as error:
            raise SpecError(f"{error}; {way_out}") from error
        changed = sorted(name for name in published if before[name] != published[name])
        if changed:
            raise SpecError(f"{self.root} was made from another spec ({', '.join(changed)} differ); {way_out}")
        if moved := self._changed_inputs(spec):
            raise SpecError(f"{self.root} was made from {', '.join(moved)}, which has changed since; {way_out}")

    def _changed_inputs(self, spec: SceneSpec) -> list[str]:
        """Return the names of the spec's files that have changed since this dataset was begun."""
        if not self.inputs.is_file():
            return []
        stamps, now = read_json(self.inputs), self._stamps(spec)
        return sorted(name for name in now if stamps.get(name) != now[name])

    def _stamps(self, spec: SceneSpec) -> dict[str, list[int] | None]:
        """Return size and time of change of the spec's files by name; those in this folder are its own."""
        outside = [path for path in spec.files() if not path.is_relative_to(self.root.resolve())]
        return {
            path.name: [path.stat().st_size, path.stat().st_mtime_ns] if path.exists() else None for path in outside
        }

    def frame(self, camera: str, frame: int) -> FrameFiles:
        return FrameFiles(
            **{kind: self.root / pattern.format(camera=camera, frame=frame) for kind, pattern in self.PATTERNS.items()}
        )

    def uncompressed(self, camera: str, frame: int) -> Path:
        """Return the display picture before a codec, where the spec has one."""
        return self.hidden / "uncompressed" / camera / f"{frame:06d}.png"

    def video(self, camera: str) -> Path:
        return self.root / "cameras" / camera / "video.mp4"

    def flow(self, camera: str, frame: int) -> Path:
        return self.root / self.FLOW.format(camera=camera, frame=frame)

    def grid(self, quantity: str) -> Path:
        return self.root / "grids" / f"{quantity}.zarr"

    def vdb(self, frame: int) -> Path:
        return self.root / "vdb" / f"{frame:06d}.vdb"

    def static(self, camera: str) -> Path:
        return self.root / self.STATIC.format(camera=camera)

    def static_exr(self, camera: str) -> Path:
        """Return the linear form of the plate, with its depth."""
        return self.static(camera).with_suffix(".exr")

    def board_mask(self, camera: str) -> Path:
        """Return where a sync board is in the pictures, if the spec has one."""
        return self.root / self.BOARD_MASK.format(camera=camera)

    def patterns(self, camera: str, with_flow: bool = False, with_board: bool = False) -> dict[str, str]:
        """File names of a camera as dataset.json has them; ``{frame:06d}`` stays open."""
        kinds = self.PATTERNS | {"static": self.STATIC}
        kinds |= ({"flow": self.FLOW} if with_flow else {}) | ({"board_mask": self.BOARD_MASK} if with_board else {})
        return {kind: pattern.replace("{camera}", camera) for kind, pattern in kinds.items()}


def _step_of(path: Path) -> int:
    """Return the step that a file of a solver's cache belongs to, the number at the end of its name; 0 without one."""
    number = path.stem.rpartition("_")[2]
    return int(number) if number.isdigit() else 0


def _link_or_copy(source: str, target: str) -> None:
    """One file under two names where the file system can: caches are large, and nothing writes into a finished one."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def warnings_of_bake(layout: Layout) -> list[str]:
    """Return a finished bake's warnings: a flame that reaches the domain's sides, where it is cut off, and gas that is
    faster than gas can be; nothing of others."""
    if not layout.bake_marker.is_file():
        return []
    seen = read_json(layout.bake_marker)
    of_grids = layout.spec.is_file() and read_json(layout.spec).get("fire", {}).get("grids")
    way_out = "only its solver can give it a larger box" if of_grids else "make domain.size larger there"
    warnings = [
        f"the flame leaves the domain through its {side} ({100 * share:.0f} % of its widest section), where pictures "
        f"and truth end: {way_out}"
        for side, share in seen.get("cut_off", {}).items()
        if share >= CUT_OFF
    ]
    fastest, most = seen.get("fastest_m_s"), seen.get("most_m_s")
    if fastest is not None and most is not None and fastest > most:
        remedy = "are the grids in m/s?"
        if not of_grids:
            remedy = "the solver ran away, and its truth is no fire's; lower the effect vorticity"
        warnings.append(
            f"gas reaches {fastest:.0f} m/s, and heat makes at most {most:.0f} m/s in this domain: {remedy}"
        )
    return warnings
