"""FTGS-PLY version 1 (FreeTimeGS): a splat PLY with time, log_duration and velocity_*; its clip is time 0 to 1."""

from __future__ import annotations

import numpy as np

from . import FileFormatError
from .cloud import splats
from .ply_file import PlyVertices, columns

PROPERTIES = ("time", "log_duration", "velocity_0", "velocity_1", "velocity_2")
VANILLA = {"duration_activation": "exp", "use_marginal_gating": "0", "use_color_velocity": "0", "color_correction": "0"}
SWITCH = {"1": True, "true": True, "0": False, "false": False}
NOTHING = ("0", "false", "no", "none", "off")
CLIP = "gof_clip_s"  # comment of `gof convert`: seconds of its times 0 and 1


def matches(ply: PlyVertices) -> bool:
    return any(comment.startswith("ftgs_version") for comment in ply.comments) or ply.has(*PROPERTIES)


def read(ply: PlyVertices, clip_s: float | None, fps: float, step: int) -> dict[str, np.ndarray]:
    """Fields of a GaussianCloud, in seconds and metres per second; its world is taken as it is.

    Args:
        clip_s: seconds from the first to the last frame; None = what the file says, or its number of
            frames at fps.

    Raises:
        FileFormatError: another version or time unit, missing comments or properties, or no way to know the seconds.
    """
    words = dict(comment.split(maxsplit=1) for comment in ply.comments if " " in comment)
    version = words.get("ftgs_version"), words.get("time_units")
    if version != ("1", "normalized"):
        raise FileFormatError(f"{ply.path}: ftgs_version {version[0]}, time_units {version[1]}; expected 1, normalized")
    for name, vanilla in VANILLA.items():
        if words.get(name, vanilla).lower() not in (vanilla, *NOTHING[: 5 * (vanilla == "0")]):
            raise FileFormatError(
                f"{ply.path}: {name} {words[name][:40]}: a variant of FreeTimeGS vanilla in which the same fields mean "
                "other things; export positions at times"
            )
    try:
        shortest, moving = float(words["min_duration"]), SWITCH[words["use_velocity"].lower()]
        frames = int(words.get("n_frames", 0))
        first, last = map(float, words[CLIP].split()) if CLIP in words else (0.0, 0.0)
    except (KeyError, ValueError) as error:
        raise FileFormatError(f"{ply.path}: header comment {error} is missing or not a number") from None
    if clip_s or not last > first:  # what the user says goes first
        first = 0.0
        seconds = clip_s or (frames - 1) / fps
    else:
        seconds = last - first
    if not seconds > 0:
        raise FileFormatError(
            f"{ply.path}: its time runs from 0 to 1 and the file does not say how many seconds that is; set "
            "Clip Length (first to last frame)"
        )
    rows = ply.rows(step)
    try:
        velocity = columns(rows, "velocity_0", "velocity_1", "velocity_2").astype(np.float64) / seconds
        time, log_duration = columns(rows, "time", "log_duration").astype(np.float64).T
    except KeyError as error:
        raise FileFormatError(
            f"{ply.path}: properties {error.args[0]} are missing; export the FTGS-PLY again"
        ) from None
    with np.errstate(over="ignore"):  # an endless duration is "always on"
        t_sigma = np.maximum(np.exp(log_duration), shortest) * seconds
    return splats(rows, ply, step) | {
        "velocity": velocity * moving,
        "t_mu": first + time * seconds,
        "t_sigma": t_sigma,
        "dynamic": np.ones(len(rows), bool),
    }
