"""`gof doctor`: what this machine has, what each part is for, and how to get what is missing."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from gof.errors import GofError
from gof.io.files import write_json

WEIGHTS_VARIABLE = (
    "GOF_WEIGHTS"  # folder with optional model weights, for this check; commands take each folder by an option
)
WEIGHTS = {
    "depth_anything_v2": (
        "monocular depth (Depth-Anything-V2-Small-hf, Apache-2.0: config.json and model.safetensors); without it stereo is completed along edges",
        "gof static --depth-weights",
    ),
    "memfof": (
        "the paper's optical flow (optical-flow-MEMFOF-Tartan-T-TSKH, BSD-3: config.json and model.safetensors); without it OpenCV's DIS",
        "gof reconstruct --flow memfof --flow-weights",
    ),
    "scores": (
        "LPIPS and CGVQM (docs/leaderboard.md names the files); without them these two scores are left out",
        "gof evaluate --weights",
    ),
}


@dataclass
class Check:
    """One finding: status "ok", "missing" (optional part) or "broken" (needed part, or installed and not working)."""

    name: str
    purpose: str
    status: str
    detail: str


@dataclass
class DoctorConfig:
    """Check this machine: Python, Blender and its Mantaflow (a real 3-frame bake), Dr.Jit, CUDA, OpenEXR, disk, weights.

    Exit status 0: everything that `make demo` needs works. 1: something needed is broken (the table says how to mend it).
    """

    json: Path | None = None
    """Also write the findings to this file."""


def check_python() -> tuple[str, str]:
    version = platform.python_version()
    if sys.version_info[:2] != (3, 11):
        return "broken", f"{version}; bpy's wheels need Python 3.11. Make the environment again with python3.11"
    return "ok", version


def check_packages() -> tuple[str, str]:
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


def check_drjit() -> tuple[str, str]:
    """Compile and run one kernel, in a child: an unsuitable libLLVM aborts the process."""
    code = (
        "import drjit as dr; from drjit.llvm import Float; x = dr.sum(dr.minimum(dr.arange(Float, 1000), 10))\n"
        "assert float(x[0]) == 45 + 10 * 990, x; import drjit.detail as d; print(getattr(d, 'llvm_version', lambda: '')())"
    )
    done = _child(["-c", code])
    library = os.environ.get("DRJIT_LIBLLVM_PATH", "found by itself")
    if done.returncode == 0:
        return "ok", f"CPU kernels compile and run (libLLVM {done.stdout.strip() or library})"
    if ("LLVM" in done.stderr and "could not be found" in done.stderr) or "dlopen" in done.stderr:
        return (
            "broken",
            "libLLVM was not found. Debian, Ubuntu: apt-get install libllvm19; elsewhere set DRJIT_LIBLLVM_PATH to libLLVM",
        )
    return "broken", (
        f"a kernel failed with status {done.returncode} ({_last(done.stderr)}). libLLVM 15 and older abort on CPUs with AVX-512: "
        "apt-get install libllvm19, or set DRJIT_LIBLLVM_PATH to a newer libLLVM"
    )


def check_cuda() -> tuple[str, str]:
    done = _child(["-c", "import drjit as dr; print(dr.has_backend(dr.JitBackend.CUDA))"])
    if done.stdout.strip() == "True":
        return "ok", "an NVIDIA GPU and its driver are here"
    return (
        "missing",
        "no CUDA device; everything runs on the CPU. For a GPU: NVIDIA's driver, and a CUDA build of torch",
    )


def check_openexr() -> tuple[str, str]:
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


def check_blender() -> tuple[str, str]:
    done = _child(["-c", "import bpy, os; print(bpy.app.version_string, flush=True); os._exit(0)"])
    if done.returncode:
        why = _last(done.stderr)
        if "No module named" in why:
            return "broken", "the bpy package is not installed. Run: pip install 'gaussians-on-fire[blender]'"
        return (
            "broken",
            f"import bpy fails: {why}. A missing lib*.so comes from apt-get install (see tools/system_packages.sh)",
        )
    return "ok", f"Blender {done.stdout.strip().splitlines()[-1]} as a Python module"


def check_mantaflow() -> tuple[str, str]:
    """A real bake of three frames in a throw-away folder, with the worker that the generator uses."""
    spec = {
        "schema": "gof-scene",
        "version": 1,
        "name": "doctor",
        "background": "studio",
        "clip": {"frames": 1, "warm_up_frames": 2},
        "domain": {"resolution": 16},
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spec.json"
        path.write_text(json.dumps(spec))
        done = _child(["-m", "gof_blender.worker.generate", "--spec", str(path), "--out", folder, "--stage", "bake"])
        if done.returncode:
            return (
                "broken",
                f"a 3-frame fire bake failed with status {done.returncode}: {_last(done.stdout + done.stderr)}",
            )
    return "ok", "3 frames of fire baked"


def check_disk() -> tuple[str, str]:
    free = shutil.disk_usage(".").free / 2**30
    if free < 2:
        return "broken", f"{free:.1f} GB free in this folder; the demo needs about 1 GB"
    return "ok", f"{free:.0f} GB free in this folder"


def check_weights(name: str) -> Callable[[], tuple[str, str]]:
    def check() -> tuple[str, str]:
        (what, option), folder = WEIGHTS[name], os.environ.get(WEIGHTS_VARIABLE)
        if folder and (Path(folder) / name).exists():
            return "ok", f"{option} {Path(folder) / name}"
        return "missing", f"{what}. To use it: {option} FOLDER (found here when it is ${WEIGHTS_VARIABLE}/{name})"

    return check


CHECKS: list[tuple[str, str, Callable[[], tuple[str, str]]]] = [
    ("Python", "bpy's wheels exist for one version", check_python),
    ("packages", "versions that fit together", check_packages),
    ("Dr.Jit", "the renderer and the optimisation", check_drjit),
    ("OpenEXR", "linear pictures and depth", check_openexr),
    ("Blender", "scenes, cameras, rendering", check_blender),
    ("Mantaflow", "fire simulation and its velocities", check_mantaflow),
    ("disk", "datasets and results", check_disk),
    ("CUDA", "optional: speed", check_cuda),
    *((f"weights/{name}", "optional: better models", check_weights(name)) for name in WEIGHTS),
]


def examine() -> list[Check]:
    """Run every check; a check that itself fails counts as broken and says why."""
    results = []
    for name, purpose, check in CHECKS:
        try:
            status, detail = check()
        except Exception as e:  # a doctor must report whatever goes wrong
            status, detail = "broken", f"{type(e).__name__}: {e}"
        results.append(Check(name, purpose, status, detail))
    return results


def main(argv: list[str]) -> int:
    """`gof doctor`; see --help."""
    config = tyro.cli(DoctorConfig, prog="gof doctor", args=argv)
    from rich.console import Console

    console = Console()
    with console.status("looking at this machine (a real 3-frame bake takes some seconds)"):
        results = examine()
    style = {"ok": "green", "missing": "yellow", "broken": "bold red"}
    for r in results:
        console.print(
            f"[{style[r.status]}]{r.status:<8}[/][bold]{r.name}[/] ({r.purpose}): {r.detail}", highlight=False
        )
    if config.json:
        write_json(config.json, {"checks": [asdict(r) for r in results]})
    broken = [r.name for r in results if r.status == "broken"]
    if broken:
        raise GofError(f"not ready: {', '.join(broken)}")
    console.print("ready: `gof demo` has all it needs")
    return 0


def _child(arguments: list[str]) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, errors="replace", timeout=300)


def _last(text: str) -> str:
    lines = [line.strip() for line in text.strip().splitlines() if line.strip()]
    return lines[-1] if lines else "no message"
