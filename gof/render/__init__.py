"""Differentiable Gaussian renderer on Dr.Jit. Importing this package is cheap: names are loaded on first use."""

from importlib import import_module

_EXPORTS = {
    "Splats": "scene",
    "transient_state": "scene",
    "require_finite_splats": "scene",
    "render_splats": "rasterizer",
    "Frame": "rasterizer",
    "render": "rasterizer",
    "l1_ssim": "loss",
    "Target": "loss",
    "harmonics_color": "harmonics",
    "shutter_delay": "shutter",
    "rasterize": "torch_api",
}
__all__ = sorted(_EXPORTS)


def __getattr__(name: str):
    if name in _EXPORTS:
        return getattr(import_module(f"gof.render.{_EXPORTS[name]}"), name)
    raise AttributeError(f"module 'gof.render' has no attribute '{name}'")
