"""Differentiable Gaussian renderer on Dr.Jit. Importing this package is cheap: names are loaded on first use."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for editors and type checkers; tests/render/test_package.py holds it to the table below
    from gof.render.harmonics import harmonics_color
    from gof.render.loss import Target, l1_ssim
    from gof.render.rasterizer import Frame, render, render_splats
    from gof.render.scene import Splats, require_finite_splats, transient_state
    from gof.render.shutter import shutter_delay
    from gof.render.torch_api import rasterize

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
__all__ = [
    "Frame",
    "Splats",
    "Target",
    "harmonics_color",
    "l1_ssim",
    "rasterize",
    "render",
    "render_splats",
    "require_finite_splats",
    "shutter_delay",
    "transient_state",
]


def __getattr__(name: str):
    if name in _MODULES:
        return getattr(import_module(f"gof.render.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'gof.render' has no attribute '{name}'")
