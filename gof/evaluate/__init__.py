"""Scores of a reconstruction: DVE against a true velocity field, PSNR and SSIM. What needs more than numpy loads on first use."""

from importlib import import_module

# Eager, because the function and its module share the name `dve`: the function must win whoever imports first.
from gof.evaluate.dve import DVEResult, DVESequence, dve, dve_sequence

_LAZY = {
    "psnr": "image",
    "ssim": "image",
    "temporal_l2": "image",
    "flip": "perceptual",
    "lpips": "perceptual",
    "rmse_depth": "depth",
    "evaluate": "run",
}
__all__ = [
    "DVEResult",
    "DVESequence",
    "dve",
    "dve_sequence",
    "evaluate",
    "flip",
    "lpips",
    "psnr",
    "rmse_depth",
    "ssim",
    "temporal_l2",
]


def __getattr__(name: str):
    if name in _LAZY:
        return getattr(import_module(f"gof.evaluate.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'gof.evaluate' has no attribute '{name}'")
