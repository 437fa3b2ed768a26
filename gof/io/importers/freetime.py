"""FreeTimeGS (FreeTimeGsVanilla): `ckpt_{step}.pt`, `canonical_4d.npz` and `.ftgs.ply`.

Its time runs from 0 to 1 over the sequence and its world is normalised from the COLMAP model, by a transform it does
not store; both are undone here. The PLY is read by `gof.core.ftgs`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.core import ftgs
from gof.core.errors import DataFormatError
from gof.core.ply import activate_scale, quaternions, sigmoid
from gof.io.importers.normalisation import world_from_training
from gof.io.importers.source import Imported, ImportOptions, Source, array

OPTIONS = ("time_unit_s", "time_zero_s", "world", "world_by")
SPLATS = {"means", "scales", "quats", "opacities", "sh0", "shN", "times", "durations", "velocities"}


def matches(source: Source) -> bool:
    if source.is_checkpoint:
        return isinstance(source.checkpoint, dict) and "splats" in source.checkpoint
    if source.path.suffix == ".npz":
        return "schema" not in source.npz and {"means", "durations", "velocities"} <= set(source.npz)
    return source.path.is_file() and source.path.suffix == ".ply" and ftgs.matches(source.ply)


def read(source: Source, options: ImportOptions) -> Imported:
    values, facts = ftgs.read(source.ply) if source.path.suffix == ".ply" else _from_splats(source)
    remedy = "give gof convert RESULT --time-unit (seconds of the whole sequence, first to last frame)"
    start, unit = ftgs.place_in_time(
        source.path, facts, options.time_zero_s, options.time_unit_s, options.frame_time_s, remedy
    )
    notes = [
        f"its time 0..1 taken as {unit:g} s from {start:g} s on",
        *(["trained without velocities"] if not facts.get("use_velocity", True) else []),
        "opacities without its floor of 1e-4, which would let every dead Gaussian count; life times at least "
        f"{facts.get('min_duration', ftgs.MIN_DURATION):g} of the sequence",
    ]
    gaussians = ftgs.moving(values, facts, start, unit)
    if options.world is None:
        if options.world_by is not None:
            raise DataFormatError("--world-by says whose normalisation of --world it was; give --world too")
        notes.append(
            "its world taken as the dataset's; its trainer normalises the scene, so give the COLMAP model "
            "(gof convert RESULT --world) unless that was undone"
        )
    else:
        matrix, note = world_from_training(options.world, options.world_by, gaussians.position)
        gaussians = gaussians.transformed(matrix)
        notes.append(note)
    return Imported(gaussians, "freetime", source.path, notes)


def _from_splats(source: Source) -> tuple[dict, dict]:
    if source.is_checkpoint:
        splats, meta = _checkpoint_splats(source)
    else:
        splats, meta = _canonical_splats(source)

    def get(name: str, *shape: int | None) -> np.ndarray:
        return array(splats[name], name, shape, source.path)

    means = get("means", None, 3)
    n = len(means)
    return {
        "position": means,
        "velocity": get("velocities", n, 3),
        "time": get("times", n, 1)[:, 0],
        "log_duration": get("durations", n, 1)[:, 0],
        "scale": activate_scale(get("scales", n, 3), source.path),
        "rotation": quaternions(get("quats", n, 4), source.path),
        "opacity": sigmoid(get("opacities", n)),
        "color": np.concatenate([get("sh0", n, 1, 3), get("shN", n, None, 3)], 1),
    }, meta


def _checkpoint_splats(source: Source) -> tuple[dict, dict]:
    """Return the nine tensors of `ckpt_{step}.pt` by name, and what it says of the clip."""
    content = source.checkpoint
    splats = content["splats"]
    if not isinstance(splats, dict) or set(splats) != SPLATS:
        found = sorted(splats) if isinstance(splats, dict) else type(splats).__name__
        raise DataFormatError(
            f"{source.path}: splats hold {found}, not the nine of FreeTimeGS vanilla {sorted(SPLATS)}; variants with "
            "gates or sigmoid durations mean other things by the same names"
        )
    return splats, _vanilla_facts(content, source.path)


def _canonical_splats(source: Source) -> tuple[dict, dict]:
    """Return the nine arrays of `canonical_4d.npz` by name, and what it says of the clip."""
    content = source.npz
    missing = SPLATS - set(content)
    if missing:
        raise DataFormatError(f"{source.path}: fields {sorted(missing)} are missing")
    return content, _vanilla_facts({k: v.item() for k, v in content.items() if v.size == 1}, source.path)


def _vanilla_facts(content: dict, path: Path) -> dict:
    """Return a file's statements on its clip and its life times.

    Raises:
        DataFormatError: it says that it is no vanilla model, or a figure is none.
    """
    spec = content.get("model_spec") or {}
    if not isinstance(spec, dict):
        raise DataFormatError(f"{path}: 'model_spec' is no table")
    ftgs.require_no_variants(
        {name: spec.get(name, content.get(name)) for name in ftgs.VANILLA if name in {**content, **spec}}, path
    )
    facts = {k: content[k] for k in ("n_frames", "use_velocity") if k in content}
    if "min_duration" in spec:
        facts["min_duration"] = spec["min_duration"]
    for name, value in facts.items():
        if not isinstance(value, (bool, int, float)) or not 0 <= value < np.inf:
            raise DataFormatError(f"{path}: '{name}' is {str(value)[:40]!r}, not a number")
    return facts
