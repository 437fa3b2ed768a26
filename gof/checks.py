"""What this machine has, what each part is for, and how to get what is missing.

A package adds checks of its own by an entry point of the group `gof.checks` that names a table like `CHECKS`.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Literal

Status = Literal["ok", "missing", "broken"]
Outcome = tuple[Status, str]

# Folder with optional model weights, for this check; commands take each folder by an option.
WEIGHTS_VARIABLE = "GOF_WEIGHTS"
WEIGHTS = {
    "depth_anything_v2": (
        "monocular depth (Depth-Anything-V2-Small-hf, Apache-2.0: config.json and model.safetensors); without it "
        "stereo is completed along edges",
        "gof ingest --depth-weights",
    ),
    "memfof": (
        "the paper's optical flow (optical-flow-MEMFOF-Tartan-T-TSKH, BSD-3: config.json and model.safetensors); "
        "without it OpenCV's DIS",
        "gof reconstruct --flow memfof --flow-weights",
    ),
    "scores": (
        "LPIPS and CGVQM (docs/leaderboard.md names the files); without them these two scores are left out",
        "gof evaluate --weights",
    ),
}


@dataclass(frozen=True)
class Check:
    """One thing to look at.

    Attributes:
        name, purpose: for the report.
        run: returns its status and the detail: what is there, or how to get it. "missing" is an optional part, "broken"
            a needed one, or one that is installed and does not work.
        place: checks are made in this order.
    """

    name: str
    purpose: str
    run: Callable[[], Outcome]
    place: int


@dataclass(frozen=True)
class Finding:
    """What a check found."""

    name: str
    purpose: str
    status: Status
    detail: str


def check_python() -> Outcome:
    version = platform.python_version()
    if sys.version_info[:2] != (3, 11):
        return "broken", f"{version}; bpy's wheels need Python 3.11. Make the environment again with python3.11"
    return "ok", version


def check_packages() -> Outcome:
    """Versions of what must fit together; numpy 2 breaks bpy."""
    found, missing = [], []
    for name in ("numpy", "scipy", "opencv-contrib-python-headless", "drjit", "mitsuba", "OpenEXR", "zarr", "torch"):
        try:
            found.append(f"{name.split('-')[0]} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        return "broken", f"not installed: {', '.join(missing)}. Run: pip install 'gaussians-on-fire[blender,torch]'"
    import numpy

    if numpy.__version__.startswith("2"):
        return "broken", f"numpy {numpy.__version__}; bpy 4.5 needs numpy below 2. Run: pip install 'numpy>=1.26.4,<2'"
    return "ok", ", ".join(found)


def check_drjit() -> Outcome:
    """Compile and run one kernel, in a child: an unsuitable libLLVM aborts the process."""
    code = (
        "import drjit as dr; from drjit.llvm import Float; x = dr.sum(dr.minimum(dr.arange(Float, 1000), 10))\n"
        "assert float(x[0]) == 45 + 10 * 990, x; import drjit.detail as d; print(getattr(d, 'llvm_version', lambda: "
        "'')())"
    )
    done = child(["-c", code])
    library = os.environ.get("DRJIT_LIBLLVM_PATH", "found by itself")
    if done.returncode == 0:
        return "ok", f"CPU kernels compile and run (libLLVM {done.stdout.strip() or library})"
    if ("LLVM" in done.stderr and "could not be found" in done.stderr) or "dlopen" in done.stderr:
        return (
            "broken",
            "libLLVM was not found. Debian, Ubuntu: apt-get install libllvm19; elsewhere set DRJIT_LIBLLVM_PATH to "
            "libLLVM",
        )
    return "broken", (
        f"a kernel failed with status {done.returncode} ({last_line(done.stderr)}). libLLVM 15 and older abort on CPUs "
        "with AVX-512: "
        "apt-get install libllvm19, or set DRJIT_LIBLLVM_PATH to a newer libLLVM"
    )


def check_kernels() -> Outcome:
    """Which kernels draw, why these, and where the compiled ones are kept."""
    code = (
        "from gof.render.backend import kernels; chosen, kept = kernels(), ''\n"
        "if chosen.name == 'native':\n"
        "    from gof.render.native.compiled import WHERE; kept = f'; compiled once, {WHERE}'\n"
        "print(chosen.name, chosen.why + kept, sep=chr(10))"
    )
    done = child(["-c", code])
    if done.returncode:
        return "broken", last_line(done.stderr)
    name, why = done.stdout.strip().splitlines()
    return ("ok" if name == "native" else "missing"), f"{name} kernels: {why}"


def check_cuda() -> Outcome:
    done = child(["-c", "import drjit as dr; print(dr.has_backend(dr.JitBackend.CUDA))"])
    if done.stdout.strip() == "True":
        return "ok", "an NVIDIA GPU and its driver are here"
    return (
        "missing",
        "no CUDA device; everything runs on the CPU. For a GPU: NVIDIA's driver, and a CUDA build of torch",
    )


def check_openexr() -> Outcome:
    """Write and read back a small EXR."""
    import numpy as np
    import OpenEXR

    with tempfile.TemporaryDirectory() as folder:
        path, pixels = f"{folder}/a.exr", np.arange(12, dtype=np.float32).reshape(3, 4)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Z": pixels}).write(path)
        with OpenEXR.File(path) as file:
            same = np.array_equal(file.channels()["Z"].pixels, pixels)
    if not same:
        return "broken", "a written picture reads back differently; reinstall OpenEXR"
    return "ok", f"round trip exact (OpenEXR {importlib.metadata.version('OpenEXR')})"


def check_disk() -> Outcome:
    free = shutil.disk_usage(".").free / 2**30
    if free < 2:
        return "broken", f"{free:.1f} GB free in this folder; the demo needs about 1 GB"
    return "ok", f"{free:.0f} GB free in this folder"


def check_weights(name: str) -> Callable[[], Outcome]:
    def check() -> Outcome:
        (what, option), folder = WEIGHTS[name], os.environ.get(WEIGHTS_VARIABLE)
        if folder and (Path(folder) / name).exists():
            return "ok", f"{option} {Path(folder) / name}"
        return "missing", f"{what}. To use it: {option} FOLDER (found here when it is ${WEIGHTS_VARIABLE}/{name})"

    return check


CHECKS = (
    Check("Python", "bpy's wheels exist for one version", check_python, 10),
    Check("packages", "versions that fit together", check_packages, 20),
    Check("Dr.Jit", "the renderer and the optimisation", check_drjit, 30),
    Check("renderer", "optional: a step in half the time", check_kernels, 35),
    Check("OpenEXR", "linear pictures and depth", check_openexr, 40),
    Check("disk", "datasets and results", check_disk, 70),
    Check("CUDA", "optional: speed", check_cuda, 80),
    *(Check(f"weights/{name}", "optional: better models", check_weights(name), 90) for name in WEIGHTS),
)


def checks() -> list[Check]:
    """Those of `gof` and of every installed package that adds some."""
    added = [check for table in entry_points(group="gof.checks") for check in table.load()]
    return sorted([*CHECKS, *added], key=lambda check: check.place)


def examine(checks: list[Check]) -> list[Finding]:
    """Run checks; one that itself fails counts as broken and says why."""
    findings = []
    for check in checks:
        try:
            status, detail = check.run()
        except Exception as e:  # a doctor must report whatever goes wrong
            status, detail = "broken", f"{type(e).__name__}: {e}"
        findings.append(Finding(check.name, check.purpose, status, detail))
    return findings


def child(arguments: list[str]) -> subprocess.CompletedProcess:
    """Python with these arguments in a process of its own, which may crash; at most five minutes."""
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, errors="replace", timeout=300)


def last_line(text: str) -> str:
    """The last line that says something."""
    lines = [line.strip() for line in text.strip().splitlines() if line.strip()]
    return lines[-1] if lines else "no message"
