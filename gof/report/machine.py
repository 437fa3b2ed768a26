"""What the page says about where its figures come from: versions and the machine. No names, paths or addresses."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path

PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "drjit", "mitsuba", "OpenEXR", "zarr", "torch", "bpy")


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


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
        platform.processor() or "unknown",
    )
