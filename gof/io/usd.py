"""OpenUSD: the Gaussians frame by frame as a `ParticleField3DGaussianSplat` with time samples (26.03 and later).

The text (.usda) is written here. The binary form (.usdc) is made of that text by OpenUSD's own library, where it is
installed. The Gaussians are the same ones in all frames, so that players interpolate between frames too. They move
evenly, so the first and the last place say all others exactly; opacities have a sample a frame. The closed form itself,
which the schema has no names for, stands beside in primvars; `gof.io.importers.usd` reads it.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from gof.core.errors import DataFormatError, MissingDependencyError, require_finite
from gof.core.files import atomic_path
from gof.core.gaussians import VISIBLE, TransientGaussians
from gof.core.harmonics import C0
from gof.host import extras

ColorAt: TypeAlias = Callable[[float], np.ndarray]  # second -> (N, 3) or (N, K, 3), of all Gaussians
SUFFIXES = (".usda", ".usdc")
START, SOURCE, DATUM, EMISSIVE = "gof_start_s", "source", "gof_datum", "gof_emissive"  # in the file's customLayerData
CLOSED_FORM = ("velocity", "t_mu", "t_sigma", "peak_opacity")  # primvars; gas_velocity, v_sd, is_dynamic if needed
OLDEST = (0, 26, 3)  # of OpenUSD that has splats
MOST_FRAMES = 100_000  # five digits
REACH_SIGMAS = 3.0  # of a splat's box
HEAD = """#usda 1.0
(
    customLayerData = {{
        double gof_start_s = {start_s!r}{more}
        string source = {source}
    }}
    defaultPrim = "flame"
    doc = "{count} Gaussians of gof; time code k is {start_s!r} s + k {step_s!r} s of the dataset clock"
    endTimeCode = {last}
    framesPerSecond = {rate!r}
    metersPerUnit = 1
    startTimeCode = 0
    timeCodesPerSecond = {rate!r}
    upAxis = "Z"
)

def ParticleField3DGaussianSplat "flame"
{{
    uniform int radiance:sphericalHarmonicsDegree = {degree}
"""
TUPLES = {1: "%.7g", 3: "(%.7g, %.7g, %.7g)", 4: "(%.7g, %.7g, %.7g, %.7g)"}  # seven digits: what a float32 holds


def library(purpose: str) -> Any:
    """Return OpenUSD's module Usd. Raises MissingDependencyError: it is not installed, or older than its splats."""
    found = extras.load("pxr.Usd", "usd", purpose)
    if found.GetVersion() < OLDEST:
        version = ".".join(map(str, found.GetVersion()[1:]))
        raise MissingDependencyError(
            f"{purpose} needs OpenUSD 26.3 or later, which knows splats; here is {version}, as a Blender brings it: "
            f"{extras.command('usd')}"
        )
    return found


def save(
    gaussians: TransientGaussians,
    path: Path,
    start_s: float,
    end_s: float,
    step_s: float,
    source: str = "",
    color_at: ColorAt | None = None,
) -> tuple[np.ndarray, list[str]]:
    """Write .usda, or .usdc: frame k is the state at start_s + k step_s, Z up, metres, time codes are frames.

    Returns (N,) bool, which Gaussians some frame shows and the file holds; and what was written, in words.

    Args:
        color_at: gives the colours where they change: a sample a frame.

    Raises:
        DataFormatError: no or too many frames, or nothing is ever seen.   NonFiniteError: a value is beyond a float32.
        MissingDependencyError: a .usdc, and OpenUSD is not installed, or older than the schema.
    """
    times, seen = frames_of(gaussians, path, start_s, end_s, step_s)
    binary = _binary(path) if path.suffix == ".usdc" else None
    with atomic_path(path) as draft:
        text = draft.with_suffix(".usda")
        try:
            with text.open("w", encoding="ascii", newline="\n") as out:
                shown = None if color_at is None else lambda time_s: color_at(time_s)[seen]
                _write_text(out, gaussians[seen], times, step_s, source, shown)
            if binary:
                binary(text, draft)
        finally:
            if text != draft:
                text.unlink(missing_ok=True)
    return seen, [
        f"{len(times)} frames of {seen.sum():,} Gaussians, {1e3 * step_s:g} ms apart from {start_s:g} s on, Z up",
        f"{path.stat().st_size:,} bytes; numbers have seven digits, opacities below 1/255 are 0",
    ]


def frames_of(
    gaussians: TransientGaussians, out: Path, start_s: float, end_s: float, step_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (T,) the times of a clip's frames, s, and (N,) which Gaussians some of them show.

    Raises:
        DataFormatError: no or too many frames, or nothing is ever seen; names `out`.
    """
    count = int(np.floor((end_s - start_s) / step_s + 1e-6)) + 1
    if not 1 <= count <= MOST_FRAMES:
        raise DataFormatError(f"{out}: {count} frames from {start_s} s to {end_s} s; choose --clip, --frame-time")
    times, seen = start_s + step_s * np.arange(count), np.zeros(len(gaussians), bool)
    for time_s in times:
        seen |= gaussians.at(time_s)[1] >= VISIBLE
    if not seen.any():
        raise DataFormatError(f"{out}: no Gaussian can be seen between {start_s} s and {end_s} s; is that the clip?")
    return times, seen


def _write_text(
    out: IO[str], g: TransientGaussians, times: np.ndarray, step_s: float, source: str, color_at: ColorAt | None
) -> None:
    sh = _harmonics(g.color)
    always = ~(g.dynamic & np.isfinite(g.t_sigma))
    more = f"\n        double[] {DATUM} = {g.datum.numbers().tolist()}" if g.datum else ""
    more += f"\n        bool {EMISSIVE} = true" if g.emissive else ""
    ends = sorted({0, len(times) - 1})
    facts: dict[str, object] = {
        "count": len(g),
        "start_s": float(times[0]),
        "step_s": float(step_s),
        "rate": float(1 / step_s),
        "more": more,
    }
    facts |= {"degree": round(sh.shape[1] ** 0.5) - 1, "last": len(times) - 1, "source": json.dumps(source)}
    out.write(HEAD.format(**facts))
    _write(out, "point3f[] positions", ((k, g.at(times[k])[0]) for k in ends))
    _write(out, "float[] opacities", ((k, _opacity(g, time_s)) for k, time_s in enumerate(times)))
    _write(out, "float3[] extent", ((k, _box(g, time_s)) for k, time_s in enumerate(times)))
    _write(out, "float3[] scales", g.scale)
    _write(out, "quatf[] orientations", g.rotation)  # in text the real part comes first, as here
    frames = color_at and ((k, _harmonics(color_at(t)).reshape(-1, 3)) for k, t in enumerate(times))
    _write(out, "float3[] radiance:sphericalHarmonicsCoefficients", frames or sh.reshape(-1, 3))
    _write(out, "vector3f[] primvars:velocity", np.where(g.dynamic[:, None], g.velocity, 0))
    if g.gas_velocity is not None:
        _write(out, "vector3f[] primvars:gas_velocity", g.moving_gas)
    _write(out, "float[] primvars:t_mu", np.where(g.dynamic, g.t_mu, 0))
    _write(out, "float[] primvars:t_sigma", np.where(always, 0, g.t_sigma))  # 0: always on
    _write(out, "float[] primvars:peak_opacity", g.opacity)
    if not np.array_equal(g.dynamic, ~always | (g.dynamic & g.velocity.any(1))):  # what a reader takes to be dynamic
        _write(out, "float[] primvars:is_dynamic", g.dynamic.astype(np.float32))
    if np.isfinite(g.velocity_sd).any():
        _write(out, "float[] primvars:v_sd", np.where(np.isinf(g.velocity_sd), -1, g.velocity_sd))  # -1: unknown
    out.write("}\n")


def _harmonics(color: np.ndarray) -> np.ndarray:
    return (color[:, None] - 0.5) / C0 if color.ndim == 2 else color


def _opacity(g: TransientGaussians, time_s: float) -> np.ndarray:
    opacity = g.at(time_s)[1]
    return np.where(opacity >= VISIBLE, opacity, 0)


def _box(g: TransientGaussians, time_s: float) -> np.ndarray:
    """Return (2, 3) the lowest and the highest corner of what is seen; at the origin where nothing is."""
    position, opacity = g.at(time_s)
    seen = opacity >= VISIBLE
    if not seen.any():
        return np.zeros((2, 3))
    half = REACH_SIGMAS * g.scale[seen].max(1, keepdims=True)
    return np.stack([(position[seen] - half).min(0), (position[seen] + half).max(0)])


def _write(out: IO[str], name: str, values: np.ndarray | Iterable[tuple[int, np.ndarray]]) -> None:
    """Write an attribute: an array that holds at all times, or arrays by frame."""
    primvar = ' (\n        interpolation = "vertex"\n    )' if "primvars:" in name else ""
    if isinstance(values, np.ndarray):
        out.write(f"    {name} = [")
        out.writelines(_tuples(name, values))
        out.write(f"]{primvar}\n")
        return
    out.write(f"    {name}.timeSamples = {{\n")
    for frame, array in values:
        out.write(f"        {frame}: [")
        out.writelines(_tuples(name, array))
        out.write("],\n")
    out.write("    }\n")


def _tuples(name: str, values: np.ndarray) -> Iterator[str]:
    """Yield an array's values as text, many at a time."""
    require_finite(name, values, "a USD of float32")
    one = TUPLES[1 if values.ndim == 1 else values.shape[1]]
    for first in range(0, len(values), 4096):
        part = values[first : first + 4096]
        yield (", " if first else "") + ", ".join([one] * len(part)) % tuple(part.ravel().tolist())


def _binary(path: Path) -> Callable[[Path, Path], None]:
    """Return what makes a .usdc of a .usda. Raises MissingDependencyError: see `library`."""
    library(f"{path}: writing .usdc (a .usda is the same as text)")
    layers = importlib.import_module("pxr.Sdf").Layer

    def convert(text: Path, binary: Path) -> None:
        layers.FindOrOpen(str(text)).Export(str(binary))

    return convert
