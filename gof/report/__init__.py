"""One self-contained HTML page that shows a reconstruction: pictures, animation, scores with controls, and costs."""

from importlib import import_module

_EXPORTS = {"build_report": "page", "Preview": "page", "main": "page"}
__all__ = sorted(_EXPORTS)


def __getattr__(name: str):
    if name in _EXPORTS:
        return getattr(import_module(f"gof.report.{_EXPORTS[name]}"), name)
    raise AttributeError(f"module 'gof.report' has no attribute '{name}'")
