"""The scene spec: everything that defines a generated dataset, as dataclasses with a JSON form.

Never imports bpy, so that a spec can be read, checked and edited anywhere. World axes: right-handed, Z up, metres,
seconds.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from .scene import effects as effect_modules

SCHEMA = "gof-scene"
VERSION = 1

Vector = tuple[float, float, float]


class SpecError(ValueError):
    """A scene spec that cannot be built; the message names the field and what it should be."""


def require(condition: bool, name: str, rule: str, value: Any) -> None:
    """Raise SpecError("<name> must be <rule>, got <value>") unless the condition holds."""
    if not condition:
        raise SpecError(f"{name} must be {rule}, got {value!r}")


@dataclass(frozen=True)
class Clip:
    """When the frames are taken. Dataset frame k is at k / fps seconds and is Blender frame ``first_frame + k``."""

    frames: int = 36
    """Number of rendered instants."""
    fps: float = 100.0
    """Frames per second of the dataset clock; the solver makes exactly one step per frame."""
    warm_up_frames: int = 90
    """Frames simulated before the first rendered one, so that the flame is developed."""
    time_scale: float = 1.0
    """Simulated seconds per second of the dataset clock, below 1 for slow motion; velocities follow the clock."""

    def __post_init__(self):
        require(self.frames >= 1, "clip.frames", "at least 1", self.frames)
        require(1.0 <= self.fps <= 32767.0, "clip.fps", "between 1 and 32767", self.fps)
        require(self.warm_up_frames >= 0, "clip.warm_up_frames", "0 or more", self.warm_up_frames)
        require(0.0 < self.time_scale <= 100.0, "clip.time_scale", "in (0, 100]", self.time_scale)

    @property
    def first_frame(self) -> int:
        """Blender frame number of dataset frame 0."""
        return 1 + self.warm_up_frames

    @property
    def last_frame(self) -> int:
        """Blender frame number of the last dataset frame."""
        return self.warm_up_frames + self.frames

    @property
    def step_s(self) -> float:
        """Simulated seconds per solver step."""
        return self.time_scale / self.fps


@dataclass(frozen=True)
class Domain:
    """The simulated box. Its cells are cubes with sides of (longest side) / resolution."""

    min: Vector = (-0.4, -0.4, 0.0)
    """Lowest corner, world metres."""
    size: Vector = (0.8, 0.8, 1.6)
    """Side lengths, metres."""
    resolution: int = 64
    """Cells along the longest side."""

    def __post_init__(self):
        require(all(side > 0 for side in self.size), "domain.size", "positive on every side", self.size)
        require(8 <= self.resolution <= 2048, "domain.resolution", "between 8 and 2048", self.resolution)

    @property
    def max(self) -> Vector:
        return tuple(low + side for low, side in zip(self.min, self.size, strict=True))


@dataclass(frozen=True)
class Fuel:
    """How a fuel burns and what its flame looks like."""

    burning_rate: float
    """Speed of the reaction: higher is a shorter flame (Mantaflow's burning rate)."""
    buoyancy: float
    """Lift per unit of heat (Mantaflow's beta): higher is a faster flame."""
    max_temperature: float
    """Heat at the hottest place of the reaction (Mantaflow's flame temperature)."""
    amount: float
    """Fuel released by the emitter, per cell."""
    colour_low_k: float
    """Black-body temperature of the coolest visible flame, kelvin."""
    colour_high_k: float
    """Black-body temperature of the hottest flame, kelvin."""
    radiance: float
    """Emission per metre of full flame, linear scene units."""


FUELS = {
    "propane_high": Fuel(0.75, 1.5, 3.0, 1.0, 1200.0, 2250.0, 15.0),
    "propane_low": Fuel(1.1, 1.0, 2.5, 0.8, 1200.0, 2200.0, 14.0),
    "wood": Fuel(0.6, 1.0, 2.2, 0.9, 1150.0, 2000.0, 12.0),
}
"""Presets. Turbulence comes from the effect ``vorticity``, soot from ``smoke``."""


@dataclass(frozen=True)
class Fire:
    """The emitter of fuel and what it burns."""

    fuel: str = "propane_high"
    """Name of a preset in FUELS."""
    shape: Literal["disc", "sphere"] = "disc"
    """disc: a flat round burner of 1/3 radius height; sphere: a ball."""
    position: Vector = (0.0, 0.0, 0.12)
    """Centre of the emitter, world metres."""
    radius: float = 0.13
    """Metres."""

    def __post_init__(self):
        require(self.fuel in FUELS, "fire.fuel", f"one of {sorted(FUELS)}", self.fuel)
        require(self.radius > 0, "fire.radius", "positive", self.radius)

    @property
    def half_size(self) -> Vector:
        """Half extents of the emitter's bounding box, metres."""
        return (self.radius, self.radius, self.radius / 6 if self.shape == "disc" else self.radius)


@dataclass(frozen=True)
class Rig:
    """Cameras on a horizontal arc around the point they look at."""

    count: int = 3
    """Number of cameras, evenly spaced on the arc."""
    arc_deg: float = 70.0
    """Angle between the first and the last camera."""
    azimuth_deg: float = -90.0
    """Direction from the look-at point to the middle of the arc, counter-clockwise from +X."""
    radius: float = 2.8
    """Horizontal distance from the look-at point, metres."""
    height: float = 0.9
    """Z of the camera centres, metres."""
    look_at: Vector = (0.0, 0.0, 0.75)
    """Point on every optical axis, world metres."""
    focal_mm: float = 50.0
    """Focal length for a sensor whose long side is 36 mm."""
    sensor_px: tuple[int, int] = (1280, 720)
    """Pixels of the sensor: (along its rows, number of rows)."""
    roll_deg: Literal[0, 90, 180, -90] = 90
    """Rotation of the camera body about its viewing direction, clockwise seen from behind. Images are stored
    upright, so 90 and -90 give portrait images whose columns are the sensor's rows."""

    def __post_init__(self):
        require(self.count >= 1, "cameras.count", "at least 1", self.count)
        require(0.0 <= self.arc_deg < 360.0, "cameras.arc_deg", "in [0, 360)", self.arc_deg)
        require(self.radius > 0, "cameras.radius", "positive", self.radius)
        require(self.focal_mm > 0, "cameras.focal_mm", "positive", self.focal_mm)
        require(min(self.sensor_px) >= 16, "cameras.sensor_px", "at least 16 pixels each way", self.sensor_px)

    @property
    def portrait(self) -> bool:
        return self.roll_deg in (90, -90)

    @property
    def names(self) -> list[str]:
        return [f"cam_{index}" for index in range(self.count)]


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
    """How linear light becomes the PNG: Blender's colour management."""

    view_transform: Literal["Standard", "Filmic", "AgX"] = "Filmic"
    look: str = "None"
    exposure: float = 0.0
    gamma: float = 1.0


@dataclass(frozen=True)
class SceneSpec:
    """Everything that defines a dataset. Only the effects listed here are simulated, rendered and paid for."""

    name: str
    seed: int = 0
    clip: Clip = field(default_factory=Clip)
    domain: Domain = field(default_factory=Domain)
    fire: Fire = field(default_factory=Fire)
    cameras: Rig = field(default_factory=Rig)
    render: Render = field(default_factory=Render)
    background: Literal["studio", "workshop"] = "workshop"
    effects: tuple[Any, ...] = ()
    """Settings objects of modules in ``scene/effects``; in JSON ``{"name": "wind", ...its settings}``."""
    display: Display = field(default_factory=Display)

    def __post_init__(self):
        require(bool(self.name) and not set(self.name) & set('/\\:*?"<>|'), "name", "a plain file name", self.name)
        require(0 <= self.seed < 2**31, "seed", "in [0, 2^31)", self.seed)
        small = min(self.cameras.sensor_px) * self.render.percentage // 100
        require(
            small >= 4,
            "render.percentage",
            f"at least {-(-400 // min(self.cameras.sensor_px))} for this sensor",
            self.render.percentage,
        )
        names = self.effect_names
        require(len(set(names)) == len(names), "effects", "listed once each", names)
        for axis, low, high in zip("xyz", self.domain.min, self.domain.max, strict=True):
            i = "xyz".index(axis)
            inside = (
                low <= self.fire.position[i] - self.fire.half_size[i]
                and self.fire.position[i] + self.fire.half_size[i] <= high
            )
            require(
                inside,
                "fire.position",
                f"such that the emitter lies inside the domain along {axis}",
                self.fire.position,
            )

    @property
    def effect_names(self) -> list[str]:
        return [effect_modules.name_of(effect) for effect in self.effects]

    @property
    def fuel(self) -> Fuel:
        return FUELS[self.fire.fuel]

    def to_dict(self) -> dict:
        """The JSON form; ``from_dict(to_dict())`` gives an equal spec."""
        data = {"schema": SCHEMA, "version": VERSION, **dataclasses.asdict(self)}
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
        if schema != SCHEMA or version != VERSION:
            raise SpecError(f'expected "schema": "{SCHEMA}", "version": {VERSION}, got {schema!r}, version {version!r}')
        effects = data.pop("effects", [])
        require(isinstance(effects, list), "effects", "a list", effects)
        data["effects"] = tuple(_effect_from_dict(item) for item in effects)
        return _from_dict(cls, data, "")

    def with_preset(self, preset: str) -> SceneSpec:
        """This spec with the cost-related fields of a preset in PRESETS. Raises SpecError for an unknown name."""
        require(preset in PRESETS, "preset", f"one of {sorted(PRESETS)}", preset)
        sections = {
            name: dataclasses.replace(getattr(self, name), **values) for name, values in PRESETS[preset].items()
        }
        return dataclasses.replace(self, **sections)


PRESETS: dict[str, dict[str, dict]] = {
    "toy": {
        "clip": {"frames": 4, "warm_up_frames": 16},
        "domain": {"resolution": 24},
        "render": {"percentage": 6, "samples": 1, "plate_samples": 2, "denoise": False},
    },
    "preview": {
        "clip": {"frames": 8},
        "domain": {"resolution": 40},
        "render": {"percentage": 12, "samples": 4, "plate_samples": 16},
    },
    "demo": {
        "clip": {"frames": 36},
        "domain": {"resolution": 64},
        "render": {"percentage": 25, "samples": 6, "plate_samples": 32},
    },
}


def load(path: str | os.PathLike) -> SceneSpec:
    """Read a spec from a JSON file. Raises SpecError that names the file."""
    path = Path(path)
    try:
        return SceneSpec.from_dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, SpecError) as error:
        raise SpecError(f"{path}: {error}") from error


def save(spec: SceneSpec, path: str | os.PathLike) -> None:
    """Write a spec as JSON, atomically."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.write_text(json.dumps(spec.to_dict(), indent=2) + "\n", encoding="utf-8")
    os.replace(temporary, path)


def _effect_from_dict(item: Any) -> Any:
    require(isinstance(item, dict) and "name" in item, "effects", 'objects like {"name": "wind"}', item)
    settings = dict(item)
    name = settings.pop("name")
    require(name in effect_modules.names(), "effects", f"one of {effect_modules.names()}", name)
    return _from_dict(effect_modules.module(name).Settings, settings, f"effects.{name}.")


def _from_dict(cls: type, data: Any, prefix: str) -> Any:
    """Build dataclass ``cls`` from a JSON object, checking names and types field by field."""
    require(isinstance(data, dict), prefix.rstrip(".") or "spec", "an object", data)
    hints = typing.get_type_hints(cls)
    unknown = sorted(set(data) - set(hints))
    if unknown:
        raise SpecError(f"{prefix}{unknown[0]} is not a field; known: {', '.join(sorted(hints))}")
    for item in dataclasses.fields(cls):
        optional = item.default is not dataclasses.MISSING or item.default_factory is not dataclasses.MISSING
        if item.name not in data and not optional:
            raise SpecError(f"{prefix}{item.name} is missing")
    return cls(**{name: _value(hints[name], value, prefix + name) for name, value in data.items()})


def _value(hint: Any, value: Any, name: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _from_dict(hint, value, name + ".")
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        require(value in args and type(value) in map(type, args), name, f"one of {list(args)}", value)
        return value
    if origin is tuple:
        if args[-1] is Ellipsis:  # effects, already built
            return value
        require(isinstance(value, (list, tuple)) and len(value) == len(args), name, f"{len(args)} numbers", value)
        return tuple(_value(arg, item, f"{name}[{i}]") for i, (arg, item) in enumerate(zip(args, value, strict=True)))
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if hint is float:
        require(number and math.isfinite(value), name, "a finite number", value)
        return float(value)
    if hint is int:
        require(
            number and value == int(value) if number and math.isfinite(value) else False, name, "a whole number", value
        )
        return int(value)
    require(isinstance(value, hint), name, f"a {hint.__name__}", value)
    return value
