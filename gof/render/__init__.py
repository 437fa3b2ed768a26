"""Differentiable Gaussian renderer on Dr.Jit. Importing this package is cheap: names are loaded on first use."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for editors and type checkers; tests/render/test_package.py holds it to the table below
    from gof.render.harmonics import harmonics_color as harmonics_color
    from gof.render.loss import Target as Target
    from gof.render.loss import l1_ssim as l1_ssim
    from gof.render.rasterizer import Frame as Frame
    from gof.render.rasterizer import render as render
    from gof.render.rasterizer import render_splats as render_splats
    from gof.render.scene import Splats as Splats
    from gof.render.scene import require_finite_splats as require_finite_splats
    from gof.render.scene import transient_state as transient_state
    from gof.render.shutter import shutter_delay as shutter_delay
    from gof.render.torch_api import rasterize as rasterize

_MODULES = {
    "Frame": "rasterizer",
    "Splats": "scene",
    "Target": "loss",
    "harmonics_color": "harmonics",
    "l1_ssim": "loss",
    "rasterize": "torch_api",
    "render": "rasterizer",
    "render_splats": "rasterizer",
    "require_finite_splats": "scene",
    "shutter_delay": "shutter",
    "transient_state": "scene",
}
__all__ = [*_MODULES]


def __getattr__(name: str):
    if name in _MODULES:
        return getattr(import_module(f"gof.render.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'gof.render' has no attribute '{name}'")
