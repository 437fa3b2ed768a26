"""FTGS-PLY version 1 (FreeTimeGS): a splat PLY with time, log_duration and velocity_*; its clip is time 0 to 1.

The other files of FreeTimeGsVanilla (`gof.io.importers.freetime`) hold the same fields under other names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .errors import DataFormatError
from .files import atomic_path
from .gaussians import TransientGaussians
from .ply import Ply, exp, splat_columns, write

MIN_DURATION = 0.02  # of the sequence; its renderer never uses a shorter one
# Settings of vanilla files that state them, in the file or in its "model_spec"; its own validator rejects all else.
VANILLA = {
    "time_units": "normalized",
    "duration_activation": "exp",
    "use_marginal_gating": False,
    "use_color_velocity": False,
    "color_correction": None,
}
SWITCH = {"1": True, "true": True, "0": False, "false": False}
MEANT = {"0": False, "false": False, "no": False, "none": None, "off": False}  # in words of a PLY's comment
PROPERTIES = ("time", "log_duration", "velocity_0", "velocity_1", "velocity_2")
FOREVER = 1e6  # clips: what is always on has such a duration; read, a tenth of it is always on
CLIP = "gof_clip_s"  # our own comment in an .ftgs.ply: seconds of its times 0 and 1


def matches(ply: Ply) -> bool:
    """Return whether a PLY says that it is one, or has its properties."""
    return any(comment.startswith("ftgs_version") for comment in ply.comments) or ply.has(*PROPERTIES)


def read(ply: Ply) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the fields as they are stored, those of 3DGS activated, and the facts that `place_in_time` and `moving`
    ask for.

    Raises:
        DataFormatError: another version or time unit, a variant, or missing comments or properties.
    """
    words = dict(c.split(maxsplit=1) for c in ply.comments if " " in c)
    if words.get("ftgs_version") != "1" or words.get("time_units") != "normalized":
        raise DataFormatError(
            f"{ply.path}: ftgs_version {words.get('ftgs_version')}, time_units {words.get('time_units')}; expected "
            "1, normalized"
        )
    require_no_variants(
        {name: MEANT.get(words[name].lower(), words[name]) for name in VANILLA if name in words}, ply.path
    )
    try:
        facts: dict[str, Any] = {"use_velocity": SWITCH[words["use_velocity"].lower()]}
        facts["min_duration"] = float(words["min_duration"])
        if "n_frames" in words:
            facts["n_frames"] = int(words["n_frames"])
        if CLIP in words:
            facts["clip_s"] = tuple(map(float, words[CLIP].split()))
        if not 0 <= facts["min_duration"] < np.inf or not np.isfinite(facts.get("clip_s", (0.0, 1.0))).all():
            raise ValueError("a duration or a clip")
    except (KeyError, ValueError) as e:
        raise DataFormatError(f"{ply.path}: header comment {e} is missing or not a number") from e
    return ply.splats() | {
        "velocity": ply.columns("velocity_0", "velocity_1", "velocity_2"),
        "time": ply.columns("time")[:, 0],
        "log_duration": ply.columns("log_duration")[:, 0],
    }, facts


def place_in_time(
    path: Path, facts: dict[str, Any], start_s: float, unit_s: float | None, frame_time_s: float | None, remedy: str
) -> tuple[float, float]:
    """Second of its time 0, and seconds from there to its time 1.

    Args:
        start_s, unit_s: as the user says; 0 and None: as the file says, or by its number of frames.
        frame_time_s: of the dataset, or as the user says; None where unknown.
        remedy: what to give where it is unknown.
    """
    frames = facts.get("n_frames")
    if unit_s is not None:
        return start_s, unit_s
    if len(clip := facts.get("clip_s", ())) == 2 and clip[1] > clip[0]:
        return start_s or clip[0], clip[1] - clip[0]
    if frames and frames > 1 and frame_time_s:
        return start_s, (frames - 1) * frame_time_s
    raise DataFormatError(
        f"{path}: its time runs from 0 to 1 and the file does not say how many seconds that is: {remedy}"
    )


def moving(values: dict[str, np.ndarray], facts: dict[str, Any], start_s: float, unit_s: float) -> TransientGaussians:
    """Return Gaussians of fields as `read` gives them, in seconds and metres per second; their world is taken as it
    is. One that is always on and rests is background."""
    velocity = values["velocity"] if facts.get("use_velocity", True) else np.zeros_like(values["velocity"])
    duration = np.maximum(exp(values["log_duration"]), facts.get("min_duration", MIN_DURATION))
    always = duration > FOREVER / 10
    return TransientGaussians(
        position=values["position"],
        velocity=velocity.astype(np.float64) / unit_s,
        t_mu=values["time"].astype(np.float64) * unit_s + start_s,
        t_sigma=np.where(always, np.inf, duration * unit_s),
        scale=values["scale"],
        rotation=values["rotation"],
        opacity=values["opacity"],
        color=values["color"],
        dynamic=~always | velocity.any(1),
    )


def require_no_variants(settings: dict, path: Path) -> None:
    """Raise DataFormatError: one of the settings that VANILLA lists is another one, so fields mean other things."""
    for name, value in settings.items():
        if value != VANILLA[name] and (value or VANILLA[name]):
            raise DataFormatError(
                f"{path}: '{name}' is {str(value)[:40]!r}, so this is a variant of FreeTimeGS vanilla in which the "
                "same fields mean other things; export positions at times, as a gof-trajectory (docs/importers.md)"
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
    duration = np.where(forever, FOREVER, np.clip(g.t_sigma / unit, MIN_DURATION, FOREVER))
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
    """Return the losses in this format, in words; args as `save`."""
    short = gaussians.dynamic & (gaussians.t_sigma < MIN_DURATION * (end_s - start_s))
    notes = [f"its times 0..1 are {start_s:g}..{end_s:g} s of the dataset clock (comment {CLIP})"]
    if gaussians.gas_velocity is not None:
        notes.append("velocities are those of the Gaussians; the velocity of the gas (v_gas) is left out")
    if short.any():
        notes.append(
            f"{short.sum()} of {len(short)} life times were shorter than the format's least, {MIN_DURATION} of the "
            f"clip, and are {MIN_DURATION * (end_s - start_s):.3g} s now"
        )
    return notes
