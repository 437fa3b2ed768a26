"""FreeTimeGS (FreeTimeGsVanilla): `ckpt_{step}.pt`, `canonical_4d.npz` and `.ftgs.ply`.

Its time runs from 0 to 1 over the sequence and its world is normalised from the COLMAP model, by a transform it does
not store; both are undone here. Spec of the PLY: FTGS PLY version 1.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path
from gof.core.gaussians import TransientGaussians
from gof.core.ply import activate_scale, exp, quaternions, sigmoid, splat_columns, write
from gof.io.importers.normalisation import world_from_training
from gof.io.importers.source import Imported, ImportOptions, Source, array

OPTIONS = ("time_unit_s", "time_zero_s", "world", "world_by")
SPLATS = {"means", "scales", "quats", "opacities", "sh0", "shN", "times", "durations", "velocities"}
MIN_DURATION = 0.02  # of the sequence; its renderer never uses a shorter one
# What vanilla files say where they say it, in the file or in its "model_spec"; its own validator rejects all else.
VANILLA = {
    "time_units": "normalized",
    "duration_activation": "exp",
    "use_marginal_gating": False,
    "use_color_velocity": False,
    "color_correction": None,
}
SWITCH = {"1": True, "true": True, "0": False, "false": False}
MEANT = {"0": False, "false": False, "no": False, "none": None, "off": False}  # in words of a PLY's comment
CLIP = "gof_clip_s"  # our own comment in an .ftgs.ply: seconds of its times 0 and 1


def matches(source: Source) -> bool:
    if source.is_checkpoint:
        return isinstance(source.checkpoint, dict) and "splats" in source.checkpoint
    if source.path.suffix == ".npz":
        return "schema" not in source.npz and {"means", "durations", "velocities"} <= set(source.npz)
    return (
        source.path.is_file()
        and source.path.suffix == ".ply"
        and any(c.startswith("ftgs_version") for c in source.ply.comments)
    )


def read(source: Source, options: ImportOptions) -> Imported:
    notes: list[str] = []
    if source.path.suffix == ".ply":
        values, meta = _from_ply(source)
    else:
        values, meta = _from_splats(source)
    start, unit = _sequence(source.path, meta, options)
    notes.append(f"its time 0..1 taken as {unit:g} s from {start:g} s on")
    if not meta.get("use_velocity", True):
        values["velocity"] = np.zeros_like(values["velocity"])
        notes.append("trained without velocities")
    notes.append(
        "opacities without its floor of 1e-4, which would let every dead Gaussian count; life times at least "
        f"{meta.get('min_duration', MIN_DURATION):g} of the sequence"
    )
    gaussians = TransientGaussians(
        position=values["position"],
        velocity=values["velocity"].astype(np.float64) / unit,
        t_mu=values["time"].astype(np.float64) * unit + start,
        t_sigma=np.maximum(exp(values["log_duration"]), meta.get("min_duration", MIN_DURATION)) * unit,
        scale=values["scale"],
        rotation=values["rotation"],
        opacity=values["opacity"],
        color=values["color"],
        dynamic=np.ones(len(values["time"]), bool),
    )
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
    """The nine tensors of `ckpt_{step}.pt` by name, and what it says of the clip."""
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
    """The nine arrays of `canonical_4d.npz` by name, and what it says of the clip."""
    content = source.npz
    missing = SPLATS - set(content)
    if missing:
        raise DataFormatError(f"{source.path}: fields {sorted(missing)} are missing")
    return content, _vanilla_facts({k: v.item() for k, v in content.items() if v.size == 1}, source.path)


def _vanilla_facts(content: dict, path: Path) -> dict:
    """What a file says of its clip and its life times.

    Raises:
        DataFormatError: it says that it is no vanilla model, or a figure is none.
    """
    spec = content.get("model_spec") or {}
    if not isinstance(spec, dict):
        raise DataFormatError(f"{path}: 'model_spec' is no table")
    _refuse_variants({name: spec.get(name, content.get(name)) for name in VANILLA if name in {**content, **spec}}, path)
    facts = {k: content[k] for k in ("n_frames", "use_velocity") if k in content}
    if "min_duration" in spec:
        facts["min_duration"] = spec["min_duration"]
    for name, value in facts.items():
        if not isinstance(value, (bool, int, float)) or not 0 <= value < np.inf:
            raise DataFormatError(f"{path}: '{name}' is {str(value)[:40]!r}, not a number")
    return facts


def _refuse_variants(said: dict, path: Path) -> None:
    """Raises DataFormatError: one of the settings that VANILLA lists is another one, so fields mean other things."""
    for name, value in said.items():
        if value != VANILLA[name] and (value or VANILLA[name]):
            raise DataFormatError(
                f"{path}: '{name}' is {str(value)[:40]!r}, so this is a variant of FreeTimeGS vanilla in which the "
                "same fields mean other things; export positions at times, as a gof-trajectory (docs/importers.md)"
            )


def _from_ply(source: Source) -> tuple[dict, dict]:
    ply = source.ply
    words = dict(c.split(maxsplit=1) for c in ply.comments if " " in c)
    if words.get("ftgs_version") != "1" or words.get("time_units") != "normalized":
        raise DataFormatError(
            f"{source.path}: ftgs_version {words.get('ftgs_version')}, time_units {words.get('time_units')}; expected "
            "1, normalized"
        )
    _refuse_variants(
        {name: MEANT.get(words[name].lower(), words[name]) for name in VANILLA if name in words}, source.path
    )
    try:
        meta = {"use_velocity": SWITCH[words["use_velocity"].lower()], "min_duration": float(words["min_duration"])}
        if "n_frames" in words:
            meta["n_frames"] = int(words["n_frames"])
        if CLIP in words:
            meta["clip_s"] = tuple(map(float, words[CLIP].split()))
        if not 0 <= meta["min_duration"] < np.inf or not np.isfinite(meta.get("clip_s", (0.0, 1.0))).all():
            raise ValueError("a duration or a clip")
    except (KeyError, ValueError) as e:
        raise DataFormatError(f"{source.path}: header comment {e} is missing or not a number") from e
    return ply.splats() | {
        "velocity": ply.columns("velocity_0", "velocity_1", "velocity_2"),
        "time": ply.columns("time")[:, 0],
        "log_duration": ply.columns("log_duration")[:, 0],
    }, meta


def _sequence(path: Path, meta: dict, options: ImportOptions) -> tuple[float, float]:
    """Second of its time 0, and seconds from there to its time 1."""
    start, frames = options.time_zero_s, meta.get("n_frames")
    if options.time_unit_s is not None:
        return start, options.time_unit_s
    if len(clip := meta.get("clip_s", ())) == 2 and clip[1] > clip[0]:
        return start or clip[0], clip[1] - clip[0]
    if frames and frames > 1 and options.frame_time_s:
        return start, (frames - 1) * options.frame_time_s
    raise DataFormatError(
        f"{path}: its time runs from 0 to 1 and the file does not say how many seconds that is: give gof convert "
        "RESULT --time-unit (seconds of the whole sequence, first to last frame)"
    )


def save(gaussians: TransientGaussians, path: Path, start_s: float, end_s: float, frames: int | None = None) -> Path:
    """Write `.ftgs.ply` version 1; start_s..end_s becomes 0..1, static Gaussians become ones that do not move or fade.

    Raises:
        DataFormatError: start_s >= end_s, no Gaussian, or a path not ending in .ply.
    """
    if not end_s > start_s or len(gaussians) == 0 or path.suffix != ".ply":
        raise DataFormatError(
            f"{path}: FTGS-PLY needs a name ending in .ftgs.ply, at least one Gaussian, and a clip longer than 0 s"
        )
    start_s, end_s = float(start_s), float(end_s)
    g, unit = gaussians, end_s - start_s
    forever = ~g.dynamic | np.isinf(g.t_sigma)
    duration = np.where(forever, 1e6, np.clip(g.t_sigma / unit, MIN_DURATION, 1e6))
    columns = splat_columns(g.arrays()) | {
        "time": np.where(g.dynamic, (g.t_mu - start_s) / unit, 0.5),
        "log_duration": np.log(duration),
        **{f"velocity_{i}": np.where(g.dynamic, g.velocity[:, i] * unit, 0) for i in range(3)},
    }
    coefficients = sum(name.startswith(("f_dc", "f_rest")) for name in columns) // 3
    comments = [
        "ftgs_version 1",
        "time_units normalized",
        f"sh_degree {int(np.sqrt(coefficients)) - 1}",
        "use_velocity 1",
        f"min_duration {MIN_DURATION}",
        "opacity_floor 0.0001",
        f"{CLIP} {start_s!r} {end_s!r}",
    ] + ([f"n_frames {frames}"] if frames else [])
    with atomic_path(path) as temporary:
        write(temporary, columns, comments)
    return path


def losses(gaussians: TransientGaussians, start_s: float, end_s: float) -> list[str]:
    """What the format cannot hold, in words; args as `save`."""
    short = gaussians.dynamic & (gaussians.t_sigma < MIN_DURATION * (end_s - start_s))
    notes = [f"its times 0..1 are {start_s:g}..{end_s:g} s of the dataset clock (comment {CLIP})"]
    if gaussians.gas_velocity is not None:
        notes.append("velocities are how the Gaussians move; what the gas does (v_gas) is left out")
    if short.any():
        notes.append(
            f"{short.sum()} of {len(short)} life times were shorter than the format's least, {MIN_DURATION} of the "
            f"clip, and are {MIN_DURATION * (end_s - start_s):.3g} s now"
        )
    return notes
