"""Versions and the machine, for a page that says where its figures come from and for a bug report. No names, paths or
addresses."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path

PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "drjit", "mitsuba", "OpenEXR", "torch", "bpy")
FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "amx_tile", "neon", "asimd", "sve")  # that kernels are made for


def machine() -> dict[str, str]:
    """Processor, cores, memory, operating system."""
    import psutil

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "processor": _processor(),
        "cores": str(cores),
        "memory": f"{psutil.virtual_memory().total / 2**30:.1f} GiB",
        "system": f"{platform.system()} {platform.release().split('-')[0]} ({platform.machine()})",
    }


def versions() -> dict[str, str]:
    """Versions of Python, this package and what the figures depend on; absent packages are left out."""
    from gof import __version__

    found = {"gof": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def cpu_features() -> list[str]:
    """Which of `FEATURES` the processor has, where Linux says so."""
    flags = set(_cpuinfo("flags").split()) | set(_cpuinfo("Features").split())
    return [name for name in FEATURES if name in flags]


def _processor() -> str:
    return _cpuinfo("model name") or platform.processor() or "unknown"


def _cpuinfo(key: str) -> str:
    """The first line of that name in Linux' description of the processor; "" elsewhere."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.split(":")[0].strip() == key), "")
