"""Files that are recognised but have no velocities, with what to do instead: a wrong guess would be a wrong score."""

from __future__ import annotations

from pathlib import Path

from gof.core.errors import DataFormatError
from gof.core.ply import name_kind
from gof.io.importers.paper_code import is_capture
from gof.io.importers.source import FLAGS, Imported, ImportOptions, Source

EXPORT = (
    "its positions come from a network that only its own code runs; export positions at the frame times and half steps "
    "with it, as a gof-trajectory npz or a folder of PLYs (docs/importers.md)"
)


SAMPLED = (
    "its positions are known at the frames alone; stack them and add their seconds, as a gof-trajectory npz "
    "(docs/importers.md)"
)
STILL = "convert every instant to an uncompressed PLY (SuperSplat exports them) and give the folder of all times"
SPLATS = {
    ".splat": "a file of antimatter15's web viewer",
    ".spz": "a file of Niantic's SPZ",
    ".ksplat": "a file of mkkellogg's web viewer",
    ".sog": "a file of PlayCanvas' SOG",
    ".glb": "a GLB",
    ".gltf": "a glTF",
}
OPTIONS = tuple(FLAGS)  # options for a file that cannot be read does not matter


def reason(source: Source) -> str | None:
    path = source.path
    if path.is_dir() and ((path / "deform").is_dir() or _of_wu(path)):
        return f"a deformation method (4DGS of Wu et al., Grid4D or Deformable-3DGS): {EXPORT}"
    if path.is_dir() and (path / "params.npz").is_file():
        return f"a folder of Dynamic3DGaussians: {SAMPLED}"
    if path.is_file() and (kind := SPLATS.get(path.suffix.lower())):
        return f"{kind}, splats of one instant without velocity: {STILL}"
    if path.is_file() and path.suffix == ".ply":
        if kind := name_kind(source.ply.vertex.dtype.names):
            return kind
        if source.ply.has("f_dc_0", "scale_0", "rot_0") and not source.ply.has("t_mu"):
            return "a plain 3DGS PLY has neither time nor velocity; give the folder of all its times"
    if path.is_file() and path.suffix == ".npz" and {"means3D", "unnorm_rotations"} <= set(source.npz):
        return f"params.npz of Dynamic3DGaussians: {SAMPLED}"
    if path.is_file() and path.suffix == ".npz" and "position" in source.npz and "schema" not in source.npz:
        return "a gof-trajectory without its field 'schema'; add schema = 'gof-trajectory/1' (docs/importers.md)"
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
        names = [k for k in content if isinstance(k, str)] if isinstance(content, dict) else []
        if any(k.startswith("deformation_net") for k in names):
            return f"deformation.pth of 4DGS (Wu et al.): {EXPORT}"
        if any(k.startswith(("gaussian_warp", "branch_w")) for k in names):
            return f"deform.pth of Deformable-3DGS: {EXPORT}"
    return None


def _of_wu(folder: Path) -> bool:
    """Return its training's folder, or that of one iteration."""
    return (folder / "deformation.pth").is_file() or any(folder.glob("point_cloud/iteration_*/deformation.pth"))


def matches(source: Source) -> bool:
    return reason(source) is not None


def read(source: Source, options: ImportOptions) -> Imported:
    raise DataFormatError(f"{source.path}: {reason(source)}")
