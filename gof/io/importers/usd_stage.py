"""A stage of OpenUSD as an importer reads it: prims with Gaussian splats, their times, their world, and their arrays.

Every error names the prim. OpenUSD's own library does the reading; where it is absent, `gof.io.usd.library` says so.
"""

from __future__ import annotations

import importlib
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.colour import linear_to_srgb
from gof.core.errors import DataFormatError, GofError
from gof.core.harmonics import C0
from gof.core.similarity import Y_UP, decompose, transformed_splats
from gof.core.trajectory import ROUNDING
from gof.io.importers import usd_crate
from gof.io.usd import MOST_FRAMES

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
SAME_TIME = 1e-3  # of the usual step between samples: times of two attributes that are nearer are one
INSTEAD = "; give the result it was made from, or a folder of PLYs (docs/importers.md)"
# Attributes by what they hold: the schema's, of which floats go before halves, and names for what it has none for.
HARMONICS = "radiance:sphericalHarmonicsCoefficients"
DEGREE, COLOUR = "radiance:sphericalHarmonicsDegree", "primvars:displayColor"
NAMES = {
    "position": ("positions", "positionsh"),
    "opacity": ("opacities", "opacitiesh"),
    "scale": ("scales", "scalesh"),
    "rotation": ("orientations", "orientationsh"),
    "harmonics": (HARMONICS, f"{HARMONICS}h"),
    "colour": (COLOUR, f"{COLOUR}:indices"),
    "velocity": ("velocities", "primvars:velocities", "primvars:gas_velocity", "primvars:velocity"),  # gas is scored
    "id": ("ids", "primvars:ids", "primvars:id"),
}
WIDTHS = {"opacity": 1, "rotation": 4, "id": 1}  # of an entry, where it is not 3


def _part(name: str) -> Any:
    """Return a module of OpenUSD, which `gof.io.usd.library` has looked for before."""
    return importlib.import_module(f"pxr.{name}")


@contextmanager
def open_stage(path: Path) -> Iterator[Any]:
    """Give a stage of the file. Raises DataFormatError: OpenUSD cannot read it, or something in it."""
    Tf, Usd = map(_part, ("Tf", "Usd"))

    # OpenUSD's own words; what matters of them stands in the notes. 26.3 has no such trap, and prints.
    with getattr(Tf, "DiagnosticTrap", nullcontext)() as trap:
        try:
            _look_over(path)
            stage = Usd.Stage.Open(str(path))
            stage.Reload()  # what another reader holds of the file may be old
            yield stage
        except (Tf.ErrorException, UnicodeError) as e:  # names in a damaged file may be no text
            raise DataFormatError(
                f"OpenUSD cannot read it ({_reason(e)}): damaged, cut off, or of a later version?"
            ) from e
        finally:
            if trap is not None:
                trap.Clear()


def _look_over(path: Path) -> None:
    """Check a file and all layers that it refers to, and they, before OpenUSD reads a value of them."""
    Sdf, UsdUtils = map(_part, ("Sdf", "UsdUtils"))

    left, known = [path], set[Path]()
    while left:
        file = left.pop()
        is_layer = file == path or (file.suffix.lower() in SUFFIXES and file.is_file())
        if file in known or not is_layer:
            continue  # what is not there, OpenUSD names
        known.add(file)
        try:
            usd_crate.check(file)
        except DataFormatError as e:
            raise e if file == path else DataFormatError(f"refers to {file}, which {e}") from e
        layer = Sdf.Layer.FindOrOpen(str(file))
        names = [name for found in UsdUtils.ExtractExternalReferences(str(file)) for name in found]
        left += [Path(layer.ComputeAbsolutePath(name)) for name in names if layer is not None]


def _reason(error: Exception) -> str:
    try:
        reasons = re.findall(r" : '(.+)", str(error))
    except UnicodeError:  # it quotes bytes of the file
        reasons = []
    return reasons[0].strip(" '")[:200] if reasons else type(error).__name__


def find_splats(stage: Any) -> tuple[list[Any], list[str]]:
    """Return the prims that hold splats for pictures, those of instances too; and notes on what is absent.

    Raises:
        DataFormatError: there are none, or some that cannot be unfolded.
    """
    Usd, UsdGeom, UsdVol = map(_part, ("Usd", "UsdGeom", "UsdVol"))

    found, others, hidden = [], Counter[str](), []
    lost = [str(error).partition(" introduced by")[0] for error in stage.GetCompositionErrors()]
    walk = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in walk:
        if prim.IsA(UsdGeom.PointInstancer):
            walk.PruneChildren()
            targets = UsdGeom.PointInstancer(prim).GetPrototypesRel().GetForwardedTargets()
            roots = [p for p in map(stage.GetPrimAtPath, targets) if p]
            if any(p.IsA(UsdVol.ParticleField) for root in roots for p in Usd.PrimRange(root)):
                raise DataFormatError(
                    f"{prim.GetPath()}: scatters splats (PointInstancer), which gof does not unfold; make its "
                    "instances real in the program that wrote it"
                )
        if not prim.IsA(UsdVol.ParticleField):
            others[str(prim.GetTypeName())] += 1
        elif not prim.HasAPI(UsdVol.ParticleFieldKernelGaussianEllipsoidAPI):
            others["ParticleField of other shapes than Gaussian ellipsoids"] += 1
        elif UsdGeom.Imageable(prim).ComputePurpose() in ("guide", "proxy"):
            hidden.append(str(prim.GetPath()))
        else:
            found.append(prim)
    missing = [f"it is incomplete: {'; '.join(lost[:3])}; put what it refers to beside it"] if lost else []
    if not found:
        held = ", ".join(f"{name} ({count})" for name, count in others.most_common(4) if name) or "nothing"
        raise DataFormatError(
            f"holds no ParticleField3DGaussianSplat that pictures show, but {held}"
            + (f"; {missing[0]}" if missing else INSTEAD)
        )
    left_out = f"{', '.join(hidden[:3])}: of purpose proxy or guide, left out"
    return found, missing + ([left_out] if hidden else [])


def find_samples(prims: list[Any]) -> np.ndarray:
    """Return (T,) the time codes at which anything that is read is sampled, increasing; empty: nothing changes."""
    UsdGeom = _part("UsdGeom")

    found: set[float] = set()
    for prim in prims:
        for name in {name for names in NAMES.values() for name in names}:
            if attribute := prim.GetAttribute(name):
                found.update(attribute.GetTimeSamples())
        while prim and not prim.IsPseudoRoot():
            if xform := UsdGeom.Xformable(prim):
                found.update(xform.GetTimeSamples())
            if imageable := UsdGeom.Imageable(prim):
                found.update(imageable.GetVisibilityAttr().GetTimeSamples())
            prim = prim.GetParent()
    codes = np.array(sorted(found), np.float64)
    if not np.isfinite(codes).all():
        raise DataFormatError("has time samples at times that are no numbers")
    if len(codes) > MOST_FRAMES:
        raise DataFormatError(f"has {len(codes)} time samples; gof reads {MOST_FRAMES} at most")
    steps = np.diff(codes)  # the last of several that are one: what is not interpolated is held from then on
    return codes[np.concatenate([steps > SAME_TIME * np.quantile(steps, 0.9), [True]])] if len(steps) else codes


def to_world(stage: Any, prim: Any, codes: np.ndarray) -> np.ndarray:
    """Return (T, 4, 4) from a prim's space to metres, Z up. Raises DataFormatError: one is no similarity."""
    UsdGeom = _part("UsdGeom")

    metres = UsdGeom.GetStageMetersPerUnit(stage)
    if not 0 < metres < np.inf:
        raise DataFormatError(f"says that a unit has {metres} m (metersPerUnit); correct that")
    stand = np.diag([metres, metres, metres, 1.0])
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        stand = np.linalg.inv(Y_UP) @ stand
    found = []
    for code in codes:
        rows = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))  # for row vectors
        found.append(stand @ rows.T)
        try:
            decompose(found[-1])
        except GofError as e:
            raise DataFormatError(
                f"{prim.GetPath()}: its transform at time code {code:g} stretches, shears, mirrors or flattens, which "
                "splats cannot follow; apply it in the program that wrote it"
            ) from e
    return np.array(found).reshape(-1, 4, 4)


def world_in_words(stage: Any) -> str:
    """Return a note on what the world was taken for."""
    UsdGeom = _part("UsdGeom")

    unsaid = "" if UsdGeom.StageHasAuthoredMetersPerUnit(stage) else ", as USD has it where a file says nothing"
    axis, metres = str(UsdGeom.GetStageUpAxis(stage)).lower(), UsdGeom.GetStageMetersPerUnit(stage)
    return f"its world taken as {axis} up, {metres:g} m a unit{unsaid} (else gof convert RESULT --align)"


def read_values(prim: Any, kind: str, code: float, count: int | None = None) -> np.ndarray | None:
    """Return (count, ...) what a prim says of NAMES' `kind` at a time; None: nothing. Raises as `read_array`."""
    found = (read_array(prim, name, WIDTHS.get(kind, 3), code, count) for name in NAMES[kind])
    return next((values for values in found if values is not None), None)


def read_array(prim: Any, name: str, width: int, code: float, count: int | None) -> np.ndarray | None:
    """Return (count, width) of an attribute, (count,) where width is 1; None: it has no value.

    Raises:
        DataFormatError: no numbers of that shape, NaN or Inf, or another count; None allows any.
    """
    attribute = prim.GetAttribute(name)
    value = attribute.Get(code) if attribute else None
    if value is None:
        return None
    values, where = np.asarray(value), f"{prim.GetPath()}: '{name}' at time code {code:g}"
    if values.dtype.kind not in "fiu" or values.shape[1:] != (() if width == 1 else (width,)) or not values.ndim:
        raise DataFormatError(
            f"{where} is of type {attribute.GetTypeName()}, not as the schema has it; export it again"
        )
    if not np.isfinite(values).all():
        rows = np.unique(np.argwhere(~np.isfinite(values))[:, 0])[:5].tolist()
        raise DataFormatError(f"{where} holds NaN or Inf (rows {rows}); leave these Gaussians out")
    if count is not None and len(values) != count:
        raise DataFormatError(f"{where} has {len(values)} entries for {count} Gaussians; export one for each")
    return values.astype(np.float32) if values.dtype == np.float16 else values  # products of halves stay halves


def read_state(prim: Any, code: float, matrix: np.ndarray, places: np.ndarray, colored: bool) -> dict[str, np.ndarray]:
    """Return position, opacity, scale, rotation and color of a prim's Gaussians at a time, in metres, Z up."""
    UsdGeom = _part("UsdGeom")

    count = len(places)
    opacity, scale = read_values(prim, "opacity", code, count), read_values(prim, "scale", code, count)
    turn = read_values(prim, "rotation", code, count)
    if scale is None:
        raise DataFormatError(
            f"{prim.GetPath()}: has no 'scales' at time code {code:g}; export the Gaussians' sizes too"
        )
    wxyz = np.tile([1.0, 0, 0, 0], (count, 1)) if turn is None else np.roll(turn, 1, axis=1).astype(np.float64)
    norm = np.linalg.norm(wxyz, axis=1, keepdims=True)
    opacity = np.ones(count) if opacity is None else opacity
    in_range = (opacity > -ROUNDING) & (opacity < 1 + ROUNDING)
    for name, ok, rule in (
        ("opacities", in_range, "within 0..1 (not a logit)"),
        ("scales", (scale > 0).all(1), "> 0 (not their logarithm)"),
        ("orientations", norm[:, 0] > 1e-12, "quaternions other than 0"),
    ):
        if not ok.all():
            rows = np.flatnonzero(~ok)[:5].tolist()
            raise DataFormatError(
                f"{prim.GetPath()}: '{name}' at time code {code:g} must be {rule}; rows {rows} are not"
            )
    color = read_colour(prim, code, count) if colored else np.zeros((count, 3))
    position, size, turned, seen = transformed_splats(matrix, places.astype(np.float64), scale, wxyz / norm, color)
    hidden = UsdGeom.Imageable(prim).ComputeVisibility(code) == UsdGeom.Tokens.invisible
    return {
        "position": position,
        "opacity": np.zeros(count) if hidden else np.clip(opacity, 0, 1),
        "scale": size,
        "rotation": turned,
        "color": seen,
    }


def read_colour(prim: Any, code: float, count: int) -> np.ndarray:
    """Return (count, K, 3) harmonics: stored, or of the prim's display colours, which are linear light; else grey."""
    UsdGeom = _part("UsdGeom")

    stored = read_values(prim, "harmonics", code)
    if stored is not None:
        attribute = prim.GetAttribute(DEGREE)
        value = attribute.Get(code) if attribute else None
        degree = value if isinstance(value, int) else -1  # a prim without that schema, or a damaged one
        size = (degree + 1) ** 2
        if not 0 <= degree <= 3 or len(stored) != count * size:
            raise DataFormatError(
                f"{prim.GetPath()}: '{HARMONICS}' at time code {code:g} has {len(stored)} entries; {count} Gaussians "
                f"of '{DEGREE}' {degree} have {count * size}; correct the degree (0 to 3) or the entries"
            )
        return stored.reshape(count, size, 3)
    shown = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
    flat = shown.ComputeFlattened(code) if shown and shown.HasValue() else None
    if flat is None:
        return np.zeros((count, 1, 3))
    linear = np.asarray(flat, np.float64)
    if linear.shape not in ((1, 3), (count, 3)) or not np.isfinite(linear).all():
        raise DataFormatError(
            f"{prim.GetPath()}: '{COLOUR}' at time code {code:g} has {len(linear)} entries, or NaN, for {count} "
            "Gaussians; export one for each"
        )
    return np.broadcast_to((linear_to_srgb(np.maximum(linear, 0)) - 0.5) / C0, (count, 3))[:, None]


def list_unsaid(prim: Any, code: float) -> list[str]:
    """Return a note on what a prim leaves to the schema: fully opaque, unturned, grey."""
    absent = [kind for kind in ("opacity", "rotation", "harmonics") if read_values(prim, kind, code) is None]
    words = {"opacity": "no opacities: all 1", "rotation": "no orientations: unturned"}
    colour = "colours from displayColor, linear light" if prim.GetAttribute(COLOUR).HasValue() else "no colours: grey"
    return ["; ".join((words | {"harmonics": colour})[kind] for kind in absent)] if absent else []


def may_vary(prim: Any, kind: str) -> bool:
    return any(a.ValueMightBeTimeVarying() for name in NAMES[kind] if (a := prim.GetAttribute(name)))
