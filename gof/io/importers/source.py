"""A foreign file or folder, opened as far as needed to tell what it is. Nothing in it is ever executed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gof.errors import DataFormatError, MissingDependencyError
from gof.gaussians import MovingGaussians
from gof.npz import read_npz
from gof.ply import Ply


@dataclass(frozen=True)
class ImportOptions:
    """What a foreign file does not say about itself.

    Attributes:
        time_unit_s: seconds per unit of the method's time; None = the importer's documented default, or an error.
        time_zero_s: dataset time at the method's time 0.
        frame_time_s: seconds between two frames of the clip (dataset clock); FreeTimeGS and PLY sequences need it.
        world: what the method's world was made from: a COLMAP model folder, or a JSON file with a 4x4
            "training_to_world".
    """

    time_unit_s: float | None = None
    time_zero_s: float = 0.0
    frame_time_s: float | None = None
    world: Path | None = None


@dataclass(frozen=True)
class Imported:
    """A result in our units, and what had to be assumed to get there."""

    gaussians: MovingGaussians
    method: str
    path: Path
    notes: list[str] = field(default_factory=list)


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
        try:
            import torch
        except ImportError as e:
            raise MissingDependencyError(
                f"{self.path}: reading a checkpoint needs PyTorch; pip install 'gaussians-on-fire[torch]'"
            ) from e
        scalar = np.core.multiarray.scalar
        dtypes = [type(np.dtype(kind)) for kind in ("f2", "f4", "f8", "i4", "i8", "bool")]
        # a numpy number (3DGS saves spatial_lr_scale as one) under its names of numpy 1 and 2
        allowed = [
            (scalar, "numpy.core.multiarray.scalar"),
            (scalar, "numpy._core.multiarray.scalar"),
            np.dtype,
            *dtypes,
        ]
        try:
            with torch.serialization.safe_globals(allowed):
                return torch.load(self.path, map_location="cpu", weights_only=True)
        except Exception as e:
            if "weights_only" in str(e) or "Unsupported" in str(e) or "GLOBAL" in str(e):
                raise DataFormatError(
                    f"{self.path}: holds objects besides tensors and numbers, and reading those would execute code "
                    f"from the file, which gof never does ({str(e).splitlines()[0][:200]}); export tensors only"
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
    """A tensor of a checkpoint, or an array of an npz, as numpy with its shape checked; None matches any length.

    Floats come as float32; what else there is keeps its type.

    Raises:
        DataFormatError: no numbers, another shape, NaN or Inf (names the field).
    """
    if hasattr(value, "detach"):
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
    return value
