"""The parts of this machine's installation, the use of each, and how to get a missing one.

A package adds checks of its own by an entry point of the group `gof.host.checks` that names a table like `CHECKS`.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Literal

from gof import __version__
from gof.host import extras
from gof.host.processes import python_command, run

Status = Literal["ok", "missing", "broken"]
Outcome = tuple[Status, str]

PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "drjit", "pillow", "zstandard")
# Settings of the environment that change what runs.
VARIABLES: tuple[str, ...] = ("GOF_RENDER_BACKEND", "GOF_RENDER_KERNELS", "DRJIT_LIBLLVM_PATH", "OMP_NUM_THREADS")
VARIABLES += ("NUMBA_NUM_THREADS", "OPENBLAS_CORETYPE", "CUDA_VISIBLE_DEVICES")

# Folder with optional model weights, for this check; commands take each folder by an option.
WEIGHTS_VARIABLE = "GOF_WEIGHTS"
WEIGHTS = {
    "depth_anything_v2": (
        "monocular depth (Depth-Anything-V2-Small-hf, Apache-2.0: config.json and model.safetensors); without it "
        "stereo is completed along edges",
        "gof depth --weights",
    ),
    "memfof": (
        "the paper's optical flow (optical-flow-MEMFOF-Tartan-T-TSKH, BSD-3: config.json and model.safetensors); "
        "without it OpenCV's DIS",
        "gof reconstruct --flow memfof --flow-weights",
    ),
    "scores": (
        "LPIPS (docs/scores.md names the file); without it this score is left out",
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
class CheckResult:
    """The result of a check."""

    name: str
    purpose: str
    status: Status
    detail: str


def check_python() -> Outcome:
    return "ok", f"{platform.python_version()} ({platform.python_implementation()}), gof {__version__}"


def check_system() -> Outcome:
    facts, libc = machine(), " ".join(platform.libc_ver())
    cpu = f"{facts['CPU']} ({' '.join(cpu_features()) or 'features unknown'}), {facts['cores']} cores"
    variables = [f"{name}={os.environ[name]}" for name in VARIABLES if name in os.environ]
    return "ok", ", ".join([facts["system"], *filter(None, [libc]), cpu, facts["memory"], *variables])


def check_packages() -> Outcome:
    """Return versions of what scoring, importing, rendering and reconstructing need; numpy 2 breaks bpy 4.5."""
    found, missing = {}, []
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        return "broken", f"not installed: {', '.join(missing)}. Run: pip install gaussians-on-fire"
    if not found["numpy"].startswith("1.") and sys.version_info < (3, 12) and importlib.util.find_spec("bpy"):
        return "broken", f"numpy {found['numpy']}; bpy 4.5 needs numpy below 2. Run: pip install 'numpy>=1.26.4,<2'"
    return "ok", ", ".join(f"{name.split('-')[0]} {version}" for name, version in found.items())


def check_extras() -> Outcome:
    """Return which extras are whole; of those begun, what they lack."""
    lacks = extras.missing()
    whole = ", ".join(name for name, missing in lacks.items() if not missing) or "none"
    absent = "; ".join(f"{name} lacks {', '.join(missing)}" for name, missing in lacks.items() if missing)
    return ("missing", f"{whole}. {absent}: {extras.command('NAME')}") if absent else ("ok", whole)


def check_torch() -> Outcome:
    code = (
        "import torch; print(torch.__version__, 'for CUDA', torch.version.cuda, 'with', torch.get_num_threads(), "
        "'threads,', torch.backends.cpu.get_cpu_capability())"
    )
    done = child("-c", code)
    if done.returncode == 0:
        return "ok", done.stdout.strip()
    if "No module named 'torch'" in done.stderr:
        return "missing", f"{extras.command('torch')}, or a build of your own"
    return "broken", f"import torch fails: {last_line(done.stderr)}"


# A kernel's compiler: LLVM's version and library, and Dr.Jit's lanes.
KERNEL = """
import gof.render.backend  # says why Dr.Jit does not begin
import drjit as dr, drjit.detail as d
from drjit.llvm import Float
from pathlib import Path
x = dr.sum(dr.minimum(dr.arange(Float, 1000), 10))
assert float(x[0]) == 45 + 10 * 990, x
version = ".".join(map(str, getattr(d, "llvm_version", lambda: ("of an unknown version",))()))
maps = Path("/proc/self/maps")
found = {line.split()[-1] for line in maps.read_text().splitlines() if "LLVM" in line} if maps.exists() else ()
print(f"libLLVM {version} {' '.join(found)}, {dr.thread_count()} threads")
"""


def check_drjit() -> Outcome:
    """Compile and run one kernel, in a child: an unsuitable libLLVM aborts the process."""
    done = child("-c", KERNEL)
    if done.returncode == 0:
        kind = os.environ.get("GOF_RENDER_BACKEND", "llvm")
        return "ok", f"CPU kernels compile and run ({done.stdout.strip()}); the renderer takes {kind}"
    if named := named_error(done.stderr):
        return "broken", named
    return "broken", (
        f"a kernel failed with status {done.returncode} ({last_line(done.stderr)}). libLLVM 15 and older abort on CPUs "
        "with AVX-512: "
        "apt-get install libllvm19, or set DRJIT_LIBLLVM_PATH to a newer libLLVM"
    )


def check_kernels() -> Outcome:
    """Return which kernels draw, why these, and where the compiled ones are kept."""
    code = (
        "from gof.render.backend import kernels; chosen, kept = kernels(), ''\n"
        "if chosen.name == 'native':\n"
        "    from gof.render.native.compiled import WHERE; kept = f'; compiled once, {WHERE}'\n"
        "print(chosen.name, chosen.why + kept, sep=chr(10))"
    )
    done = child("-c", code)
    if done.returncode:
        return "broken", named_error(done.stderr) or last_line(done.stderr)
    name, why = done.stdout.strip().splitlines()
    return ("ok" if name == "native" else "missing"), f"{name} kernels: {why}"


def check_cuda() -> Outcome:
    done = child("-c", "import drjit as dr; print(dr.has_backend(dr.JitBackend.CUDA))")
    if done.stdout.strip() == "True":
        return "ok", "an NVIDIA GPU and its driver are here; with GOF_RENDER_BACKEND=cuda the renderer uses it"
    return (
        "missing",
        "no CUDA device; everything runs on the CPU. For a GPU: NVIDIA's driver, and a CUDA build of torch",
    )


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
    Check("Python", "3.10 or newer; 3.11 for the extra `blender`", check_python, 10),
    Check("system", "for a bug report", check_system, 15),
    Check("packages", "versions that fit together", check_packages, 20),
    Check("extras", "optional: docs/install.md says what each is for", check_extras, 25),
    Check("Dr.Jit", "the renderer and the optimisation", check_drjit, 30),
    Check("renderer", "optional: a step in half the time", check_kernels, 32),
    Check("PyTorch", "optional: checkpoints, learned scores, rasterize() for PyTorch", check_torch, 35),
    Check("disk", "datasets and results", check_disk, 70),
    Check("CUDA", "optional: speed", check_cuda, 80),
    *(Check(f"weights/{name}", "optional: better models", check_weights(name), 90) for name in WEIGHTS),
)


def checks() -> list[Check]:
    """Return those of `gof` and of every installed package that adds some."""
    added = [check for table in entry_points(group="gof.checks") for check in table.load()]
    return sorted([*CHECKS, *added], key=lambda check: check.place)


def examine(checks: list[Check]) -> list[CheckResult]:
    """Run checks; one that itself fails counts as broken and says why."""
    findings = []
    for check in checks:
        try:
            status, detail = check.run()
        except Exception as e:  # a doctor must report whatever goes wrong
            status, detail = "broken", f"{type(e).__name__}: {e}"
        findings.append(CheckResult(check.name, check.purpose, status, detail))
    return findings


def child(*words: str) -> subprocess.CompletedProcess:
    """Run Python with these words in a process of its own, which may crash; at most five minutes."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "encoding": "utf-8", "errors": "replace"}
    return run(python_command(*words), timeout_s=300, **pipes)


def named_error(text: str) -> str | None:
    """Return the message of the `GofError` that ended a child."""
    found = re.match(r"gof\.core\.errors\.\w+: (.*)", last_line(text))
    return found and found[1]


def last_line(text: str) -> str:
    """Return the last line that says something."""
    lines = [line.strip() for line in text.strip().splitlines() if line.strip()]
    return lines[-1] if lines else "no message"


# ----------------------------------------------------------------
# Versions and the machine, for a page that says where its figures come from and for a bug report. No names, paths or
# addresses.

STATED = ("numpy", "scipy", "opencv-contrib-python-headless", "drjit", "mitsuba", "OpenEXR", "torch", "bpy")
FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "amx_tile", "neon", "asimd", "sve")  # that kernels are made for


def machine() -> dict[str, str]:
    """CPU, cores, memory, operating system."""
    import psutil

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "CPU": cpu_name(),
        "cores": str(cores),
        "memory": f"{psutil.virtual_memory().total / 2**30:.1f} GiB",
        "system": f"{platform.system()} {platform.release().split('-')[0]} ({platform.machine()})",
    }


def versions() -> dict[str, str]:
    """Return versions of Python, this package and what the figures depend on; absent packages are left out."""
    from gof import __version__

    found = {"gof": __version__, "Python": platform.python_version()}
    for name in STATED:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def cpu_features() -> list[str]:
    """Return which of `FEATURES` the CPU has, where Linux says so."""
    flags = set(_cpuinfo("flags").split()) | set(_cpuinfo("Features").split())
    return [name for name in FEATURES if name in flags]


def cpu_name() -> str:
    """Return the model of the CPU, "unknown" where the system does not name it."""
    return _cpuinfo("model name") or platform.processor() or "unknown"


def _cpuinfo(key: str) -> str:
    """Return the first line of that name in Linux' description of the CPU; "" elsewhere."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.split(":")[0].strip() == key), "")
