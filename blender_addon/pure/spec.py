"""The scene spec: everything that defines a generated dataset, as dataclasses with a JSON form.

It can be read, checked and edited anywhere, without Blender. World axes: right-handed, Z up, metres, seconds.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from ..core.checked_json import SpecError, from_dict, require
from ..core.description import held_out
from ..core.errors import GofError
from ..core.files import is_name, path_in, read_json, without_place, write_json
from . import effects as effect_modules
from .fire_scaling import Constants, scaled, unscaled
from .fires import Domain, Fire, GridFire
from .fuels import FUELS, Fuel
from .presets import FORMER, NEW_NAMES, PRESETS
from .rig import AROUND, Rig
from .timeline import Timeline
from .timing import Clip

SCHEMA = "gof-scene"
VERSION = 3
# Fields that came later. A spec that leaves one at its default is written without it, so that specs of before stay as
# they were.
LATER_FIELDS = (("fire", "logs", Fire.logs), ("cameras", "around_frames", Rig.around_frames))
MOST_PICTURES = 100_000
BACKGROUND = "background.blend"  # of a dataset: the surroundings that a spec's .blend gave it
LAST_FRAME = 1_048_574  # Blender counts no further


@dataclass(frozen=True)
class Render:
    """Cycles settings, shared by all frames."""

    percentage: int = 25
    """Rendered size in percent of the sensor, rounded down to whole pixels (Blender needs at least 4)."""
    samples: int = 6
    """Paths per pixel of a frame. Without smoke a frame traces the fire's light only, so few are enough."""
    plate_samples: int = 32
    """Paths per pixel of the fire-free plate, which is rendered once per camera."""
    max_bounces: int = 1
    """Light bounces after the first hit."""
    volume_step_rate: float = 2.0
    """Ray-march step through the flame, in Cycles' automatic step lengths; larger is faster and coarser."""
    denoise: bool = True
    """Open Image Denoise on the beauty pass (never on depth and flame)."""

    def __post_init__(self):
        require(1 <= self.percentage <= 100, "render.percentage", "between 1 and 100", self.percentage)
        require(self.samples >= 1, "render.samples", "at least 1", self.samples)
        require(self.plate_samples >= 1, "render.plate_samples", "at least 1", self.plate_samples)
        require(self.max_bounces >= 0, "render.max_bounces", "0 or more", self.max_bounces)
        require(
            0.01 <= self.volume_step_rate <= 100, "render.volume_step_rate", "in [0.01, 100]", self.volume_step_rate
        )


@dataclass(frozen=True)
class Display:
    """Conversion of linear light to the PNG: Blender's colour management."""

    view_transform: Literal["Standard", "Filmic", "AgX"] = "Filmic"
    """Blender's view transform."""
    look: str = "None"
    """Blender's look for that view transform, such as "High Contrast"."""
    exposure: float = 0.0
    """Exposure, stops."""
    gamma: float = 1.0
    """Gamma after the view transform."""

    def __post_init__(self):
        # Blender would clamp what is outside, and the dataset would say what the pictures are not.
        require(-10 <= self.exposure <= 10, "display.exposure", "in [-10, 10] stops", self.exposure)
        require(0.1 <= self.gamma <= 5, "display.gamma", "in [0.1, 5]", self.gamma)


@dataclass(frozen=True)
class BlendFile:
    """A .blend as the surroundings. Its scene is moved so that an empty of it becomes the origin of our world."""

    path: str
    """The file; relative to the folder of the spec, or absolute."""
    empty: str = "Fire"
    """Name of the empty that marks where the fire burns: its place and its turn about Z; its scale is ignored."""


@dataclass(frozen=True)
class SceneSpec:
    """Everything that defines a dataset. Only the effects listed here are simulated, rendered and paid for."""

    name: str
    """Name of the scene, and of its dataset where no other is given."""
    seed: int = 0
    """Seed of everything that is drawn at random."""
    clip: Clip = field(default_factory=Clip)
    """Number of frames, their rate, and how long the fire burns before the first."""
    domain: Domain | None = None
    """The simulated box; left out for a fire of another solver, whose grids have their own."""
    fire: GridFire | Fire = field(default_factory=Fire)
    """The fire: burner and fuel or, with the field `grids`, the fire of another solver."""
    cameras: Rig = field(default_factory=Rig)
    """Number of cameras, their places, lens and sensor."""
    render: Render = field(default_factory=Render)
    """Size and quality of the pictures."""
    background: Literal["studio", "workshop", "classroom", "cloister", "ground", "blend_file"] = "workshop"
    """Surroundings of the fire; ground: open ground, a wall and a burner that follow the size of the domain."""
    blend_file: BlendFile | None = None
    """The user's scene, for the background "blend_file"."""
    effects: tuple[Any, ...] = ()
    """Effects, each as `{"name": "wind"}` with its settings."""
    ground_truth: tuple[Literal["grids", "flow", "vdb"], ...] = ()
    """Truth beside the velocity: grids (flame, heat, density), flow (optical flow), vdb (OpenVDB per frame)."""
    display: Display = field(default_factory=Display)
    """Tone mapping of the PNG pictures; EXR files keep linear light."""

    def __post_init__(self):
        if self.domain is None and isinstance(self.fire, Fire):
            object.__setattr__(self, "domain", Domain())
        require(is_name(self.name), "name", "a plain file name", self.name)
        require(0 <= self.seed < 2**31, "seed", "in [0, 2^31)", self.seed)
        with_file = self.background == "blend_file"
        rule = 'given exactly when background is "blend_file"'
        require(with_file == (self.blend_file is not None), "blend_file", rule, self.blend_file)
        for name, listed in (("ground_truth", self.ground_truth), ("effects", self.effect_names)):
            require(len(set(listed)) == len(listed), name, "listed once each", listed)
        self._require_pictures()
        self._require_timeline()
        self.fire.check(self.domain, self.effects)

    def _require_pictures(self) -> None:
        least = -(-400 // min(self.cameras.sensor_px))
        require(
            min(self.picture_px) >= 4, "render.percentage", f"at least {least} for this sensor", self.render.percentage
        )
        rig, clip = self.cameras, self.clip
        pictures = clip.frames * len(rig.whole_clip) + len(AROUND) * rig.around_frames
        rule = f"such that all cameras make at most {MOST_PICTURES} pictures"
        require(pictures <= MOST_PICTURES, "clip.frames", rule, pictures)
        rule = f"at most the clip's {clip.frames} frames"
        require(rig.around_frames <= clip.frames, "cameras.around_frames", rule, rig.around_frames)

    def _require_timeline(self) -> None:
        rule = "long enough for the shutter to open before frame 0"
        require(self.timeline.earliest_seen >= 1, "clip.warm_up_frames", rule, self.clip.warm_up_frames)
        rule = f"such that the solver ends by step {LAST_FRAME}, Blender's last"
        require(self.timeline.last_frame <= LAST_FRAME, "clip.warm_up_frames", rule, self.timeline.last_frame)

    @property
    def effect_names(self) -> list[str]:
        return [effect_modules.name_of(effect) for effect in self.effects]

    @property
    def fuel(self) -> Fuel:
        """Return the fuel of a fire that we simulate."""
        return FUELS[self.fire.fuel]

    @cached_property
    def solver(self) -> Constants:
        """Return the solver's constants of a fire that we simulate."""
        if self.fire.speeds == "solver":
            return unscaled(self.fuel)
        return scaled(self.fuel, 2 * self.fire.radius, max(self.domain.size))

    @cached_property
    def box(self) -> Domain:
        """Return the box of the flame's cells, and how many. Raises SpecError: files of a fire of grids are wrong."""
        return self.fire.box(self.domain, self.timeline)

    @property
    def picture_px(self) -> tuple[int, int]:
        """Pixels of a rendered picture as the sensor has them: (along its rows, number of rows)."""
        along_rows, rows = (side * self.render.percentage // 100 for side in self.cameras.sensor_px)
        return along_rows, rows

    @cached_property
    def pictures(self) -> tuple[tuple[int, int], ...]:
        """(frame, number of the camera) of all pictures, all cameras at one instant before the next instant."""
        whole, count = len(self.cameras.whole_clip), len(self.cameras.names)
        around = frames_around(self.clip.frames, self.cameras.around_frames)
        frames = range(self.clip.frames)
        return tuple((frame, c) for frame in frames for c in range(count if frame in around else whole))

    @cached_property
    def timeline(self) -> Timeline:
        """Return the times of the solver's steps and of the pictures."""
        return Timeline(self.clip, self.effects, len(self.cameras.names), self.picture_px[1], self.seed)

    def resolved(self, folder: Path) -> SceneSpec:
        """Return this spec with the paths of its files absolute; relative ones count from the folder of the spec's
        file."""
        return self._with_paths(lambda path: (folder / path).resolve())

    def resolved_in(self, folder: Path) -> SceneSpec:
        """As `resolved`, for a spec that came with the folder: its .blend lies in there, or DataFormatError is raised.

        The grids of a fire are not opened to build a scene again.
        """
        if not self.blend_file:
            return self.resolved(folder)
        path = path_in(folder.resolve(), self.blend_file.path)
        return dataclasses.replace(self, blend_file=dataclasses.replace(self.blend_file, path=path.as_posix()))

    def published_in(self, folder: Path) -> SceneSpec:
        """Return this spec as a dataset in `folder` has it: without the places of the author's files.

        The user's .blend is the dataset's own copy of its surroundings. Grids are relative where they share a folder
        with the dataset, else only their name is left.
        """
        blend_file = self.blend_file and dataclasses.replace(self.blend_file, path=BACKGROUND)
        fire = self.fire
        if isinstance(fire, GridFire):
            fire = dataclasses.replace(fire, grids=without_place(Path(fire.grids), folder.resolve()))
        return dataclasses.replace(self, blend_file=blend_file, fire=fire)

    def files(self) -> list[Path]:
        """Return the files that say whether what the spec burns and stands in is still the same."""
        blend = [Path(self.blend_file.path)] if self.blend_file else []
        return blend + ([Path(self.fire.grids) / "fire.json"] if isinstance(self.fire, GridFire) else [])

    def relative_to(self, folder: Path) -> SceneSpec:
        """Return this spec with the paths of its files relative where they lie in the folder: all can be moved
        together."""
        root = folder.resolve()
        return self._with_paths(lambda path: path.relative_to(root) if path.is_relative_to(root) else path)

    def _with_paths(self, moved: Callable[[Path], Path]) -> SceneSpec:
        """Return this spec with the path of every file that it names, where it names one, mapped."""
        changes: dict[str, Any] = {}
        if self.blend_file:
            changes["blend_file"] = dataclasses.replace(
                self.blend_file, path=moved(Path(self.blend_file.path)).as_posix()
            )
        if isinstance(self.fire, GridFire):
            changes["fire"] = dataclasses.replace(self.fire, grids=moved(Path(self.fire.grids)).as_posix())
        return dataclasses.replace(self, **changes) if changes else self

    def to_dict(self) -> dict:
        """Return the JSON form; ``from_dict(to_dict())`` gives an equal spec."""
        data = {"schema": SCHEMA, "version": VERSION, **dataclasses.asdict(self)}
        for section, name, default in LATER_FIELDS:
            if data[section].get(name) == default:
                del data[section][name]
        data["effects"] = [
            {"name": name, **dataclasses.asdict(effect)}
            for name, effect in zip(self.effect_names, self.effects, strict=True)
        ]
        return json.loads(json.dumps(data))  # tuples become lists, as in a file

    @classmethod
    def from_dict(cls, data: dict) -> SceneSpec:
        """Build and check a spec. Raises SpecError for a wrong schema, version, type, name or range."""
        if not isinstance(data, dict):
            raise SpecError(f"a scene spec is a JSON object, got {type(data).__name__}")
        data = dict(data)
        schema, version = data.pop("schema", None), data.pop("version", None)
        if schema != SCHEMA or version not in (*FORMER_FIRES, VERSION):
            found = f"{str(schema)[:40]!r}, version {str(version)[:40]}"
            raise SpecError(f'expected "schema": "{SCHEMA}", "version": {VERSION}, got {found}')
        data = from_version(version, data)
        effects = data.pop("effects", [])
        require(isinstance(effects, list), "effects", "a list", effects)
        data["effects"] = tuple(_effect_from_dict(item) for item in effects)
        return from_dict(cls, data, "")

    def differences(self, other: SceneSpec) -> list[str]:
        """Return names of the sections in which two specs differ."""
        mine, theirs = self.to_dict(), other.to_dict()
        return sorted(name for name in mine if mine[name] != theirs[name])

    def with_preset(self, preset: str) -> SceneSpec:
        """Return this spec with the cost-related fields of a preset; a fire of grids keeps its cells.

        Raises SpecError for an unknown name.
        """
        preset, known = NEW_NAMES.get(preset, preset), PRESETS | FORMER
        require(preset in known, "preset", f"one of {', '.join(PRESETS)}", preset)
        sections = {
            name: dataclasses.replace(getattr(self, name), **values)
            for name, values in known[preset].items()
            if getattr(self, name) is not None
        }
        return dataclasses.replace(self, **sections)


def frames_around(count: int, wanted: int) -> tuple[int, ...]:
    """`wanted` frames of a clip of `count`, evenly: of those that are held out, where these are enough."""
    test = held_out(count).test
    known = test if len(test) >= wanted else range(count)
    return tuple(known[(2 * k + 1) * len(known) // (2 * wanted)] for k in range(wanted))


def load(path: str | os.PathLike) -> SceneSpec:
    """Read a spec from a JSON file; paths of files in it become absolute. Raises SpecError that names the file."""
    path = Path(path)
    try:
        return SceneSpec.from_dict(read_json(path)).resolved(path.parent)
    except SpecError as error:
        raise SpecError(f"{path}: {error}") from error
    except GofError as error:  # of the file, which it names
        raise SpecError(str(error)) from error


def save(spec: SceneSpec, path: str | os.PathLike) -> None:
    """Write a spec as JSON, atomically; paths of files beside it become relative."""
    write_json(Path(path), spec.relative_to(Path(path).parent).to_dict(), indent=2)


def _effect_from_dict(item: Any) -> Any:
    require(isinstance(item, dict) and "name" in item, "effects", 'objects like {"name": "wind"}', item)
    settings = dict(item)
    name = settings.pop("name")
    require(name in effect_modules.names(), "effects", f"one of {effect_modules.names()}", name)
    return from_dict(effect_modules.module(name).Settings, settings, f"effects.{name}.")


# ----------------------------------------------------------------
# Scene specs of older versions in the words of today.

FORMER_FIRES = {1: {"light": "reaction", "speeds": "solver"}, 2: {"light": "soot"}}
"""Defaults of a fire that were others in these versions."""


def from_version(version: int, data: dict) -> dict:
    """Return a spec of any version in the words of today: what it leaves out is as it was then."""
    fire = data.get("fire", {})
    if isinstance(fire, dict) and "grids" not in fire:
        data = data | {"fire": FORMER_FIRES.get(version, {}) | fire}
    listed = data.get("effects", [])
    if version == 1 and isinstance(listed, list):
        data = data | {"effects": [_effect_from_version_1(item) for item in listed]}
    return data


def _effect_from_version_1(item: Any) -> Any:
    if isinstance(item, dict) and item.get("name") == "wind":
        return {"strength": 0.3, "unit": "field"} | item
    return item
