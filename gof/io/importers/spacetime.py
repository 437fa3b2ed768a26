"""SpacetimeGaussians (STG, lite and full): a PLY whose positions are polynomials of degree 3 in time.

With d = t - trbf_center: position (x, y, z) + m[0:3] d + m[3:6] d^2 + m[6:9] d^3, opacity
sigmoid(o) exp(-(d / exp(trbf_scale))^2), rotation normalise(rot + d omega). t counts the `duration` frames of the
training as 1.
"""

from __future__ import annotations

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.motion import Motion, State
from gof.core.ply import Ply, activate_scale, exp, quaternions, require_raw, require_rows, sigmoid
from gof.io.importers.source import Imported, ImportOptions, Source

OPTIONS = ("time_unit_s", "time_zero_s")
MOTION = tuple(f"motion_{i}" for i in range(9))


def matches(source: Source) -> bool:
    return (
        source.path.is_file()
        and source.path.suffix == ".ply"
        and source.ply.has("trbf_center", "trbf_scale", *MOTION, "omega_0")
    )


def read(source: Source, options: ImportOptions) -> Imported:
    ply, unit = source.ply, options.time_unit_s
    if unit is None:
        whole = ""
        if options.frame_time_s and options.clip_s:
            seconds = options.clip_s[1] - options.clip_s[0] + options.frame_time_s
            whole = f"; {seconds:g} if that was the whole clip"
        raise DataFormatError(
            f"{source.path}: its time counts the frames of its training (--duration, 50 if not given) as 1: give "
            f"gof convert RESULT --time-unit, the seconds of so many frames{whole}"
        )
    lite = not ply.has("f_t_0")
    notes = [
        f"its time 0..1 taken as {unit:g} s from {options.time_zero_s:g} s on; velocities are the polynomials' own",
        "colours as stored"
        if lite
        else "its colours need its own decoder, so they are grey: gof evaluate RESULT --dataset DATASET --no-images",
    ]
    first, count = options.clip_s[0] if options.clip_s else options.time_zero_s, 101
    times = np.linspace(first, options.clip_s[1] if options.clip_s else first + unit, count)
    motion = Motion(_state(ply, unit, options.time_zero_s, lite), times_s=times, source=str(source.path))
    return Imported(motion, "spacetime", source.path, notes)


def _state(ply: Ply, unit: float, zero_s: float, lite: bool):
    """time in s -> `State`."""
    place = ply.columns("x", "y", "z").astype(np.float64)
    m1, m2, m3 = np.split(ply.columns(*MOTION).astype(np.float64), 3, axis=1)
    centre, width = ply.columns("trbf_center").astype(np.float64), exp(ply.columns("trbf_scale"))
    rotation, turn = ply.columns(*(f"rot_{i}" for i in range(4))), ply.columns(*(f"omega_{i}" for i in range(4)))
    logits, sizes = ply.columns("opacity"), ply.columns("scale_0", "scale_1", "scale_2")
    require_rows(~np.isnan(logits), "opacity", "a number", ply.path)
    require_raw(sizes, logits[:, 0], ply.path)
    peak, scale = sigmoid(logits), activate_scale(sizes, ply.path)
    color = ply.columns("f_dc_0", "f_dc_1", "f_dc_2") if lite else np.full(place.shape, 0.5)
    for name, values in (("position", place), ("trbf_center", centre), ("motion", np.hstack([m1, m2, m3]))):
        require_rows(np.isfinite(values), name, "finite (did the training diverge?)", ply.path)

    def state(time_s: float) -> State:
        d = (time_s - zero_s) / unit - centre
        return State(
            position=place + d * (m1 + d * (m2 + d * m3)),
            velocity=(m1 + d * (2 * m2 + d * 3 * m3)) / unit,
            opacity=(peak * np.exp(-(np.clip(d / width, -40, 40) ** 2)))[:, 0],
            scale=scale,
            rotation=quaternions(rotation + d * turn, ply.path),
            color=color,
        )

    return state
