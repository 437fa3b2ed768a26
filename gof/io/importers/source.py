"""A foreign file or folder, opened as far as needed to tell what it is. Nothing in it is ever executed."""

from __future__ import annotations

import datetime
import re
import zipfile
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import MovingGaussians
from gof.core.npz import ALWAYS, read_npz
from gof.core.ply import Ply
from gof.host import extras
from gof.host.options import require_number, require_positive

WorldBy = Literal["freetime", "gsplat"]
# Options that a user gives, by field. An importer's OPTIONS names those that it uses; another one given is an error.
FLAGS = {
    "time_unit_s": "--time-unit",
    "time_zero_s": "--time-zero",
    "world": "--world",
    "world_by": "--world-by",
    "code_date": '"code_date" of RESULT.gof.json',
}


@dataclass(frozen=True)
class ImportOptions:
    """Facts that a foreign file does not hold about itself.

    Attributes:
        time_unit_s: seconds per unit of the method's time; None = the importer's documented default, or an error.
        time_zero_s: dataset time at the method's time 0.
        frame_time_s: seconds between two frames of the clip (dataset clock); FreeTimeGS and PLY sequences need it.
        world: what the method's world was made from: a COLMAP model folder, or a JSON file with a 4x4
            "training_to_world".
        world_by: whose normalisation of that COLMAP model it was; None = found out, or an error.
        code_date: year-month-day of the method's code that wrote the file, where its meaning changed.
        flame_only: it is a flame without its surroundings, to be drawn over fire-free plates as ours is.
        emissive: as of `TransientGaussians`; where the file says so itself, it need not be given.
        clip_s: first and last second of the dataset's clip, to compare the method's times with.

    Raises:
        GofError: a time is not a finite number, a unit not above 0, or a date not one.
    """

    time_unit_s: float | None = None
    time_zero_s: float = 0.0
    frame_time_s: float | None = None
    world: Path | None = None
    world_by: WorldBy | None = None
    code_date: str | None = None
    flame_only: bool = False
    emissive: bool = False
    clip_s: tuple[float, float] | None = None

    def __post_init__(self):
        require_positive("--time-unit", self.time_unit_s)
        require_positive("--frame-time", self.frame_time_s)
        require_number("--time-zero", self.time_zero_s)
        if self.code_date is not None:
            try:
                datetime.date.fromisoformat(self.code_date)
            except ValueError as e:
                raise GofError(f"code_date '{self.code_date}': write a date as 2024-09-15") from e

    def given(self) -> list[str]:
        """Return the fields of FLAGS that differ from their defaults."""
        return [name for name in FLAGS if getattr(self, name) not in (None, 0.0)]


@dataclass(frozen=True)
class Imported:
    """A result in our units, and what had to be assumed to get there."""

    gaussians: MovingGaussians
    method: str
    path: Path
    notes: list[str] = field(default_factory=list)
    flame_only: bool = False  # as `ImportOptions`


class Source:
    """A path with its content read once, on demand."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not self.path.exists():
            raise DataFormatError(f"{self.path}: no such file or folder")

    @property
    def is_checkpoint(self) -> bool:
        return self.path.is_file() and self.path.suffix in (".pth", ".pt", ".ckpt")

    @cached_property
    def checkpoint(self) -> Any:
        """Content of a torch file: tensors, tuples, dicts, numbers.

        Raises:
            MissingDependencyError: torch is not installed.
            DataFormatError: not a torch file, or it holds objects that only executing it could make.
        """
        torch = extras.load("torch", "torch", f"{self.path}: reading a checkpoint")
        scalar = np.float64(0).__reduce__()[0]  # what makes a number of numpy, in whichever of its modules it stands
        dtypes = [type(np.dtype(kind)) for kind in ("f2", "f4", "f8", "i4", "i8", "bool")]
        # a numpy number (3DGS saves spatial_lr_scale as one) under its names of numpy 1 and 2
        allowed = [
            (scalar, "numpy.core.multiarray.scalar"),
            (scalar, "numpy._core.multiarray.scalar"),
            np.dtype,
            *dtypes,
        ]
        _require_unpacked_size(self.path)
        try:
            with torch.serialization.safe_globals(allowed):
                return torch.load(self.path, map_location="cpu", weights_only=True)
        except Exception as e:
            if "weights_only" in str(e) or "Unsupported" in str(e) or "GLOBAL" in str(e):
                named = re.search(r"GLOBAL ([\w.]+)", str(e))  # torch's own advice is to execute them
                raise DataFormatError(
                    f"{self.path}: holds {named[1] if named else 'objects'} besides tensors and numbers, and reading "
                    "that would execute code from the file, which gof never does; export tensors only"
                ) from e
            raise DataFormatError(
                f"{self.path}: not a readable PyTorch file ({type(e).__name__}: {str(e)[:120]})"
            ) from e

    @cached_property
    def npz(self) -> dict[str, np.ndarray]:
        return read_npz(self.path)

    @cached_property
    def ply(self) -> Ply:
        return Ply.read(self.path)


def array(value: Any, name: str, shape: tuple[int | None, ...], path: Path) -> np.ndarray:
    """Return a tensor of a checkpoint, or an array of an npz, as numpy with its shape checked; None matches any length.

    Floats come as float32; what else there is keeps its type.

    Raises:
        DataFormatError: no numbers, another shape, NaN or Inf (names the field).
    """
    if hasattr(value, "detach"):
        if value.is_nested or value.is_quantized or value.is_meta or str(value.layout) != "torch.strided":
            raise DataFormatError(f"{path}: '{name}' is a sparse, nested, quantised or empty tensor; save a dense one")
        if value.is_complex():
            raise DataFormatError(f"{path}: '{name}' holds complex numbers")
        tensor = value.detach().cpu()
        needed, held = tensor.numel() * tensor.element_size(), tensor.untyped_storage().nbytes()
        if needed > held:
            raise DataFormatError(f"{path}: '{name}' announces {needed} bytes, more than the file holds ({held})")
        value = tensor.float().numpy() if tensor.is_floating_point() else tensor.numpy()
    elif not isinstance(value, np.ndarray):
        raise DataFormatError(
            f"{path}: '{name}' is a {type(value).__name__}, expected a tensor; another version of the method?"
        )
    elif value.dtype.kind not in "biuf":
        raise DataFormatError(f"{path}: '{name}' does not hold numbers")
    else:
        value = value.astype(np.float32)
    fits = value.ndim == len(shape) and all(b in (None, a) for a, b in zip(value.shape, shape, strict=True))
    if not fits:
        raise DataFormatError(
            f"{path}: '{name}' has shape {value.shape}, expected {tuple('N' if s is None else s for s in shape)}"
        )
    if not np.isfinite(value).all():
        raise DataFormatError(f"{path}: '{name}' holds NaN or Inf; did the training diverge?")
    if value.ndim and not len(value):
        raise DataFormatError(f"{path}: '{name}' has no rows; the file holds no Gaussian")
    return value


def require_unit(times: np.ndarray, options: ImportOptions, path: Path) -> None:
    """Make sure that times which are taken for seconds can be: that they last about as long as the clip.

    Args:
        times: of the Gaussians, or first and last.
    Raises:
        DataFormatError: no unit was given, and they last much longer or shorter (says which units could be meant).
    """
    if options.time_unit_s is not None or options.clip_s is None:
        return
    clip = options.clip_s[1] - options.clip_s[0]
    first, last = np.percentile(times, [1, 99])
    if clip <= 0 or 0.6 * clip < last - first < 1.7 * clip:
        return
    shares = -0.3 < first and last < 1.3 and last - first > 0.4
    raise DataFormatError(
        f"{path}: its times run from {first:.3g} to {last:.3g}, the clip lasts {clip:.3g} s; give gof "
        "convert RESULT --time-unit, the seconds of one unit of its time"
        + (f": {clip:g} if they are shares of the clip, as in the D-NeRF layout, 1 if seconds" if shares else ""),
    )


def _require_unpacked_size(path: Path) -> None:
    """torch.save packs nothing: an archive that unpacks to more than its size is no work of its own."""
    try:
        if not zipfile.is_zipfile(path):
            return
        with zipfile.ZipFile(path) as archive:
            total = sum(member.file_size for member in archive.infolist())
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as e:
        raise DataFormatError(f"{path}: not a readable PyTorch file ({e})") from e
    if total > max(2 * path.stat().st_size, ALWAYS):
        raise DataFormatError(
            f"{path}: unpacks to {total} bytes from {path.stat().st_size}, and PyTorch's own files are not packed"
        )
