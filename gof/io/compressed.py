"""The splats of one instant in other programs' compressed formats, .spz and .sog, written by GaussForge."""

from __future__ import annotations

import tempfile
from pathlib import Path

from gof import extras
from gof.errors import DataFormatError
from gof.files import atomic_path
from gof.gaussians import TransientGaussians
from gof.ply import splat_columns, write

SUFFIXES = (".spz", ".sog")
VISIBLE = 1 / 255  # opacity below which a Gaussian changes no 8-bit picture


def save(gaussians: TransientGaussians, path: Path, time_s: float) -> list[str]:
    """Write what can be seen at a time, as it stands then; the formats know no motion.

    Places and axes are those of our PLYs (metres, Z up). Values are quantised: .spz has places in steps of 1/4096 m.

    Returns what was left out, in words.

    Raises:
        MissingDependencyError: GaussForge is not installed.   DataFormatError: nothing is seen, or it refuses.
    """
    library = extras.load("gaussforge", "splats", f"writing {path.suffix}")
    position, opacity = gaussians.at(time_s)
    seen = opacity >= VISIBLE
    if not seen.any():
        raise DataFormatError(f"{path}: no Gaussian can be seen at {time_s:g} s; --time chooses another instant")
    columns = splat_columns(gaussians.arrays() | {"position": position, "opacity": opacity})
    with tempfile.TemporaryDirectory(prefix="gof-") as folder:
        ply = Path(folder) / "instant.ply"
        write(ply, {name: values[seen] for name, values in columns.items()}, [])
        made = library.GaussForge().convert(ply.read_bytes(), "ply", path.suffix[1:])
    if made.get("error"):
        raise DataFormatError(f"{path}: GaussForge refuses: {made['error']}")
    with atomic_path(path) as temporary:
        temporary.write_bytes(bytes(made["data"]))
    return [f"the state at {time_s:g} s of the {seen.sum():,} Gaussians seen then; motion is left out"]
