"""Files that are recognised but have no velocities, with what to do instead: a wrong guess would be a wrong score."""

from __future__ import annotations

from gof.errors import DataFormatError
from gof.io.importers.authors import is_capture
from gof.io.importers.source import Imported, ImportOptions, Source

EXPORT = (
    "its positions come from a network that only its own code runs; export positions at the frame times and half steps "
    "with it, as a gof-trajectory npz or a folder of PLYs (docs/importers.md)"
)


def reason(source: Source) -> str | None:
    path = source.path
    if path.is_dir() and ((path / "deform").is_dir() or any(path.glob("point_cloud/iteration_*/deformation.pth"))):
        return f"a deformation method (4DGS of Wu et al. or Grid4D): {EXPORT}"
    if path.is_file() and path.suffix == ".ply":
        if source.ply.has("f_dc_0", "scale_0", "rot_0") and not source.ply.has("t_mu"):
            return "a plain 3DGS PLY has neither time nor velocity; give the folder of all its times"
    if source.is_checkpoint:
        content = source.checkpoint
        if is_capture(content, 14):
            return f"a checkpoint of 4DGS (Wu et al.): {EXPORT}"
        if is_capture(content, 12):
            return (
                "a checkpoint of 3D Gaussians (12 entries, as 3DGS or 4DGS with gaussian_dim 3): it has no velocities"
            )
        if isinstance(content, tuple) and len(content) == 2 and all(isinstance(c, dict) for c in content):
            return f"deform.pth of Grid4D: {EXPORT}"
        if isinstance(content, dict) and any(k.startswith("deformation_net") for k in content):
            return f"deformation.pth of 4DGS (Wu et al.): {EXPORT}"
    return None


def matches(source: Source) -> bool:
    return reason(source) is not None


def read(source: Source, options: ImportOptions) -> Imported:
    raise DataFormatError(f"{source.path}: {reason(source)}")
