"""The splats of one instant in other programs' compressed formats, .spz and .sog, written by GaussForge."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path
from gof.core.gaussians import VISIBLE, TransientGaussians
from gof.core.ply import splat_columns, write
from gof.core.similarity import Y_UP
from gof.host import extras

SUFFIXES = (".spz", ".sog")
# Limits of .spz: places of 24 bits in steps of 1/4096 m, sizes, colours and harmonics of 8 bits each.
SPZ_REACH_M = 2**23 / 4096
SPZ_RANGES = {"scale_": (-10.0, 255 / 16 - 10), "f_dc_": (-0.5 / 0.15, 0.5 / 0.15), "f_rest_": (-1.0, 127 / 128)}
SPZ_NAMES = {"scale_": "sizes", "f_dc_": "colours", "f_rest_": "colours that change with the direction"}
SOG_STEPS = 65535  # of a place, over the logarithm of what the scene spans


def save(gaussians: TransientGaussians, path: Path, time_s: float) -> list[str]:
    """Write what can be seen at a time, as it stands then; the formats know no motion.

    Both have Y up by their own texts, as glTF: (x, y, z) here is (x, z, -y) there, and harmonics are turned too.

    Returns what was left out or changed, in words.

    Raises:
        MissingDependencyError: GaussForge is not installed.   DataFormatError: nothing is seen, all of it lies beyond
            what the format can hold, or GaussForge refuses.
    """
    library = extras.load("gaussforge", "splats", f"writing {path.suffix}")
    turned = gaussians.transformed(Y_UP)
    position, opacity = turned.at(time_s)
    seen = opacity >= VISIBLE
    if not seen.any():
        raise DataFormatError(f"{path}: no Gaussian can be seen at {time_s:g} s; --time chooses another instant")
    notes = [f"the state at {time_s:g} s of the {seen.sum():,} Gaussians seen then; motion is left out"]
    notes.append("axes are the format's: x to the right, y up, z backwards; (x, y, z) of ours is (x, z, -y) there")
    if path.suffix == ".spz":
        far = seen & ~(np.abs(position) < SPZ_REACH_M - 1 / 4096).all(-1)
        if (far == seen).all():
            raise DataFormatError(
                f"{path}: all {far.sum():,} Gaussians lie beyond the {SPZ_REACH_M:g} m that .spz can hold; write .sog "
                "or .glb, or move the result near zero (--align)"
            )
        if far.any():
            notes.append(f"{far.sum():,} Gaussians beyond the {SPZ_REACH_M:g} m that .spz can hold are left out")
        seen &= ~far
    columns = splat_columns(turned.arrays() | {"position": position, "opacity": opacity})
    columns = {name: values[seen] for name, values in columns.items()}
    notes += _clip_to_spz(columns) if path.suffix == ".spz" else _steps_of_sog(position[seen])
    with tempfile.TemporaryDirectory(prefix="gof-") as folder:
        ply = Path(folder) / "instant.ply"
        write(ply, columns, [])
        made = library.GaussForge().convert(ply.read_bytes(), "ply", path.suffix[1:])
    if made.get("error"):
        raise DataFormatError(f"{path}: GaussForge refuses: {made['error']}")
    with atomic_path(path) as temporary:
        temporary.write_bytes(bytes(made["data"]))
    return notes


def _clip_to_spz(columns: dict[str, np.ndarray]) -> list[str]:
    """Clip columns of a splat PLY to what .spz can hold, in place; says of how many Gaussians something was lost."""
    notes = []
    for prefix, (low, high) in SPZ_RANGES.items():
        names = [name for name in columns if name.startswith(prefix)]
        lost = np.zeros(len(columns["x"]), bool)
        for name in names:
            lost |= (columns[name] < low) | (columns[name] > high)
            columns[name] = np.clip(columns[name], low, high)
        if lost.any():
            notes.append(f"{SPZ_NAMES[prefix]} of {lost.sum():,} Gaussians are clipped to what .spz can hold")
    return notes


def _steps_of_sog(position: np.ndarray) -> list[str]:
    """Return the rounding of places by .sog: its steps are even in the logarithm of the scene's span along an axis."""
    logarithm = np.log1p(np.abs(position)) * np.sign(position)
    step = np.ptp(logarithm, axis=0) / SOG_STEPS * (1 + np.abs(position).max(0))
    return [
        f"places are rounded by up to {1000 * step.max() / 2:.2g} mm; sizes and colours are the nearest of 256 "
        "values each"
    ]
