"""Repairs of what libraries stopped doing since the methods were written. None touches a file of theirs."""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch

from gof.core.errors import GofError

_kept: list[torch.library.Library] = []  # declarations last as long as these


def pictures_of_signed_bytes() -> None:
    """`PIL.Image.fromarray` took int8 for the bytes they are; newer ones refuse. (4DGS of Yang, Deformable-3DGS)"""
    image = import_module("PIL.Image")
    original = image.fromarray

    def fromarray(obj, mode=None):
        if isinstance(obj, np.ndarray) and obj.dtype == np.int8:
            obj = obj.view(np.uint8)
        return original(obj) if mode is None else original(obj, mode)

    image.fromarray = fromarray


def torchvision_without_its_operators() -> None:
    """A torchvision built for another PyTorch: its Python wants two operators declared, which nothing here calls."""
    spec = find_spec("torchvision")
    if spec is None:
        raise ModuleNotFoundError("No module named 'torchvision'", name="torchvision")
    try:
        for compiled in Path(spec.origin).parent.glob("_C*"):
            torch.ops.load_library(str(compiled))
    except OSError:
        library = torch.library.Library("torchvision", "DEF")
        library.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        library.define("qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        _kept.append(library)


def no_restart() -> None:
    """A training that replaces its own process would lose this one's stand-ins; it ends, and says so. (4DGS of Wu)"""

    def refuse(path, arguments):
        raise GofError(f"the script ends itself to begin again ({' '.join(map(str, arguments[1:3]))}): its loss is NaN")

    os.execv = refuse


def perceptual_loss_left_out() -> None:
    """LPIPS needs weights that are fetched when it is made."""
    from gof.on_cpu.small_modules import NoPerceptualLoss

    import_module("torchmetrics.image.lpip").LearnedPerceptualImagePatchSimilarity = NoPerceptualLoss
    import_module("torchmetrics.image").LearnedPerceptualImagePatchSimilarity = NoPerceptualLoss
