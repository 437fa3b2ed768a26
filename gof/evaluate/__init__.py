"""Scores of a reconstruction: DVE against a true velocity field, scores of pictures, and `evaluate` for all of them."""

import sys

from gof.evaluate.depth import rmse_depth
from gof.evaluate.dve_frame import DVEResult, DVESequence, dve
from gof.evaluate.image import flip, lpips, psnr, ssim, temporal_l2
from gof.evaluate.scores import Scores
from gof.evaluate.scoring import Extras, evaluate
from gof.evaluate.sequence import dve_sequence
from gof.host.callable_package import CallablePackage

__all__ = [
    "DVEResult",
    "DVESequence",
    "Extras",
    "Scores",
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

sys.modules[__name__].__class__ = CallablePackage
