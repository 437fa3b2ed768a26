"""The Dr.Jit types of the active backend, and the few backend settings the kernels rely on.

`GOF_RENDER_BACKEND=cuda` selects Dr.Jit's CUDA types; the default is the LLVM backend (CPU).
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

import drjit as dr
import numpy as np

from gof.core.errors import GofError, MissingDependencyError
from gof.host import extras

THREADS_VARIABLE = "OMP_NUM_THREADS"  # what users and job schedulers set; NumPy, PyTorch and numba read it themselves
# More threads wait for each other: of 16 cores, a step on small pictures takes 73 ms with all, 22 with 8, 16 with 3.
MOST_THREADS, FEW_THREADS = 8, 4
THREAD_PIXELS = 30_000
LEAST_ADDRESSES = 1.25e9  # bytes that may be mapped
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"


def _require_numbers_of_threads() -> None:
    """Libraries would go on with another number, or end in words that do not name the variable."""
    if not os.environ.get("NUMBA_NUM_THREADS", "1").strip():
        del os.environ["NUMBA_NUM_THREADS"]  # numba does not take an empty one for none
    for name in (THREADS_VARIABLE, "NUMBA_NUM_THREADS"):
        asked = os.environ.get(name, "").split(",")[0].strip()  # "4,2": of nested levels, the first
        if asked and not (asked.isascii() and asked.isdigit() and int(asked) > 0):
            raise GofError(f"{name} is '{os.environ[name]}'; unset it, or set it to a whole number from 1 on")


def _require_addresses() -> None:
    """Below this LLVM ends the process in the middle of its work, or never ends (tried with 0.5 to 2 GB)."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows has no such limit
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST_ADDRESSES:
        raise GofError(
            f"memory is limited to {limit / 1e9:.1f} GB (ulimit -v); the renderer and its compiler need "
            f"{LEAST_ADDRESSES / 1e9:.2f} GB of addresses"
        )


def _require_backend() -> None:
    """Let Dr.Jit begin, which it does with its first array. Raises MissingDependencyError: it cannot, and why."""
    try:
        dr.eval(dr.arange(Float, 2))
    except Exception as e:
        raise MissingDependencyError(_obstacle_to_cuda() if BACKEND == "cuda" else _obstacle_to_llvm(str(e))) from e


def _obstacle_to_cuda() -> str:
    return "GOF_RENDER_BACKEND is 'cuda', but no NVIDIA GPU with its driver is found here; unset it to draw on the CPU"


def _obstacle_to_llvm(message: str) -> str:
    """Why libLLVM does not begin: first what the user has set, then what is installed, at last Dr.Jit's own words."""
    install = "Debian, Ubuntu: apt-get install libllvm19; elsewhere set DRJIT_LIBLLVM_PATH to libLLVM"
    if path := os.environ.get(LLVM_VARIABLE):
        remedy = "unset it, or give the path of libLLVM itself"
        return f"{LLVM_VARIABLE} is '{path}', which {_fault_of_library(path) or 'Dr.Jit cannot use'}; {remedy}"
    places = [Path("/usr/lib"), Path("/usr/lib64"), Path("/usr/local/lib"), *Path("/usr/lib").glob("*-linux-gnu")]
    found = sorted(str(path) for place in places for path in place.glob("libLLVM*.so*"))
    faults = [f"{path} {fault}" for path in found if (fault := _fault_of_library(path))]
    if found and len(faults) == len(found):
        memory = "; is memory limited (ulimit -v)?" if re.search("map segment|allocate memory", faults[-1]) else ""
        return f"libLLVM is installed, but {faults[-1]}{memory}"
    if found:
        return f"libLLVM does not begin ({' '.join(message.split())[:200]})"
    return f"libLLVM was not found. {install}"


def _fault_of_library(path: str) -> str | None:
    """Return the fault of a shared library that should be LLVM's; None where no fault is visible."""
    if not Path(path).exists():
        return "does not exist"
    if Path(path).is_dir():
        return "is a folder"
    try:
        return None if hasattr(ctypes.CDLL(path), "LLVMContextCreate") else "is another library than LLVM"
    except OSError as e:
        return f"cannot be loaded ({str(e).removeprefix(f'{path}: ')})"


BACKEND = os.environ.get("GOF_RENDER_BACKEND", "llvm")
if BACKEND not in ("llvm", "cuda"):
    raise GofError(f"GOF_RENDER_BACKEND is '{BACKEND}'; use 'llvm' or 'cuda'")
_require_numbers_of_threads()
_require_addresses()
WORK_UNIT = 2048  # lanes
KERNELS_VARIABLE = "GOF_RENDER_KERNELS"
_types = import_module(f"drjit.{BACKEND}.ad")
Array2f, Array3f, Array4f, Bool = _types.Array2f, _types.Array3f, _types.Array4f, _types.Bool
Float, Int, UInt, Array2u = _types.Float, _types.Int, _types.UInt, _types.Array2u


def _asked_threads() -> int | None:
    """Return the number that THREADS_VARIABLE asks for; None: it asks for none."""
    asked = os.environ.get(THREADS_VARIABLE, "").split(",")[0].strip()
    return int(asked) if asked else None


def _limit_threads() -> None:
    """Dr.Jit takes a thread per core, whatever THREADS_VARIABLE says, and those without work cost time. Never more."""
    limit = _asked_threads() or MOST_THREADS
    if limit < dr.thread_count():
        dr.set_thread_count(limit)


@contextmanager
def threads_for(pixels: int):
    """As many threads as pictures of that many pixels keep busy, where the user does not say how many."""
    before = dr.thread_count()
    if _asked_threads() is None:
        dr.set_thread_count(min(before, max(FEW_THREADS, pixels // THREAD_PIXELS)))
    try:
        yield
    finally:
        dr.set_thread_count(before)


_require_backend()
_limit_threads()


@dataclass(frozen=True)
class Kernels:
    """The kernels that sort, bin and blend ("native" or "drjit"), and the reason."""

    name: str
    why: str


def kernels() -> Kernels:
    """Choose the kernels, here alone: $GOF_RENDER_KERNELS if it is set, else the native ones where they run.

    Raises:
        GofError: the variable names neither, or forces the native ones where they cannot run.
    """
    wanted = os.environ.get(KERNELS_VARIABLE)
    if wanted not in (None, "native", "drjit"):
        raise GofError(f"{KERNELS_VARIABLE} is '{wanted}'; use 'native' or 'drjit'")
    if wanted == "drjit":
        return Kernels("drjit", f"{KERNELS_VARIABLE}=drjit")
    obstacle = _obstacle_to_native()
    if obstacle is None:
        return Kernels("native", "numba is here and the CPU multiplies and adds at once")
    if wanted == "native":
        raise GofError(f"{KERNELS_VARIABLE}=native, but {obstacle}")
    return Kernels("drjit", obstacle)


@cache
def _obstacle_to_native() -> str | None:
    """Why the native kernels cannot run here; None: they can."""
    if BACKEND == "cuda":
        return "they are for CPUs, and GOF_RENDER_BACKEND is 'cuda'"
    try:
        import llvmlite.binding
        import numba
    except ImportError as e:
        return f"numba is not installed ({e}). Run: {extras.command('fast')}"
    except OSError as e:
        return f"numba's compiler cannot be loaded ({' '.join(str(e).split())[:200]})"
    if numba.config.DISABLE_JIT:
        return "NUMBA_DISABLE_JIT is set"
    if platform.machine() == "x86_64" and not llvmlite.binding.get_host_cpu_features().get("fma"):
        return "this CPU has no fused multiply-add (AVX2)"
    return None


def _set_work_unit(lanes: int) -> None:
    """Do nothing; replaced below where the LLVM backend offers it."""


@contextmanager
def work_units(lanes: int):
    """Kernels evaluated inside hand `lanes` lanes to a thread at a time."""
    _set_work_unit(lanes)
    try:
        yield
    finally:
        _set_work_unit(WORK_UNIT)


def _tune_llvm():
    """Two settings of the LLVM backend that have no Python call; their C++ functions are exported.

    Work units: Dr.Jit hands 16384 lanes to a thread at a time. One lane of the blend kernels is a 4x4 pixel block, so a
    640x360 image would run on one thread; a unit itself costs about 0.2 us, too much for cheap lanes in small units.
    Gathers: on Intel CPUs whose microcode guards against CVE-2022-40982 a hardware gather takes about 180 ns. Sixteen
    scalar loads take 30 ns, and as long as the gather elsewhere.

    Without these functions the results are the same, only slower.
    """
    try:
        core = ctypes.CDLL(str(Path(next(iter(dr.__path__))) / "libdrjit-core.so"))
        cpu, features = core._Z19jit_llvm_target_cpuv, core._Z24jit_llvm_target_featuresv
        cpu.restype = features.restype = ctypes.c_char_p
        if platform.machine() == "x86_64" and b"prefer-no-gather" not in (features() or b""):
            wanted = b",".join(f for f in (features(), b"+prefer-no-gather") if f)
            core._Z19jit_llvm_set_targetPKcS0_j(cpu(), wanted, ctypes.c_uint32(core._Z21jit_llvm_vector_widthv()))
        set_block_size = core._Z23jit_llvm_set_block_sizej
        return lambda lanes: set_block_size(ctypes.c_uint32(lanes))
    except (OSError, AttributeError):
        return _set_work_unit


if BACKEND == "llvm":
    _set_work_unit = _tune_llvm()
    _set_work_unit(WORK_UNIT)


def frozen(function):
    """Record a function of arrays and integers once per set of integers and replay its kernels afterwards, at any
    array size: tracing the blend and loss kernels in Python costs milliseconds per step otherwise. Arrays must be in
    memory. A recording holds as many sums as there were threads: with more of them it would write beyond its memory,
    so it is of one number of threads."""
    return dr.freeze(function, state_fn=lambda *_: dr.thread_count(), warn_after=1000)


def opaque(value: float) -> Float:
    """Return a scalar that the kernels read from memory, so that a new value does not compile a new kernel."""
    return dr.opaque(Float, float(value))


def floats(array) -> Float:
    """Any numpy array, flattened to a float32 array in Dr.Jit's own memory.

    Dr.Jit would share numpy's memory, which may be unaligned, and compiles the alignment into every kernel.
    """
    return _copied(np.ascontiguousarray(array, np.float32).reshape(-1), Float)


def whole_numbers(array) -> UInt:
    """Copy whole numbers from 0 on, of any shape, into a flat array of uint32."""
    return _copied(np.ascontiguousarray(array, np.uint32).reshape(-1), UInt)


def _copied(flat: np.ndarray, kind):
    if BACKEND == "cuda" or flat.size == 0:  # on a GPU numpy sees a copy of an array: what is written there is lost
        return kind(flat)
    out = dr.empty(kind, flat.size)
    out.numpy()[:] = flat
    return out


def pack(columns: list[Float], stride: int) -> Float:
    """N records of `stride` floats (a multiple of 4, padded with 0): a lane fetches a record in 128-bit loads."""
    out = scattered(columns, stride)
    dr.eval(out)
    return out


def scattered(columns: list[Float], stride: int) -> Float:
    """`pack`, to be evaluated by the caller together with other arrays of N entries."""
    out = dr.empty(Float, len(columns[0]) * stride)
    columns = columns + [Float(0)] * (stride - len(columns))
    record = dr.arange(UInt, len(out) // stride) * (stride // 4)
    for q in range(stride // 4):
        dr.scatter(out, Array4f(*columns[4 * q : 4 * q + 4]), record + q, mode=dr.ReduceMode.NoConflicts)
    return out


def pack_words(a: UInt, b: UInt) -> UInt:
    """N records of two words."""
    out = dr.empty(UInt, 2 * max(len(a), len(b)))
    dr.scatter(out, Array2u(a, b), dr.arange(UInt, len(out) // 2), mode=dr.ReduceMode.NoConflicts)
    dr.eval(out)
    return out


_released: list[Float] = []  # owners of borrowed memory, to be let go of by the thread that calls us


class _Borrowed:
    """Part of a Dr.Jit array's memory as something numpy can wrap.

    Dr.Jit lets go of memory that it shares with numpy on a thread of its own, which holds Python's lock while it does.
    If that release reached a Dr.Jit array, the thread would wait for Dr.Jit's lock, which the main thread may hold
    while it waits for Python's: a deadlock, met once in some thousand training steps. So the owner is only put aside
    here.
    """

    def __init__(self, owner: Float, start: int, n: int):
        self.owner = owner
        address = owner.numpy().__array_interface__["data"][0] + 4 * start
        self.__array_interface__ = {"version": 3, "data": (address, False), "shape": (n,), "typestr": "<f4"}

    def __del__(self):
        _released.append(self.owner)


def shifted(array: Float, start: int, n: int) -> Float:
    """Entries [start, start + n) of an array in memory. On the CPU nothing is copied or gathered: kernels read the same
    memory from another address, with contiguous loads. Neither array may be written to afterwards."""
    if BACKEND == "cuda":
        return dr.gather(Float, array, dr.arange(UInt, n) + start)
    _released.clear()
    return Float(np.asarray(_Borrowed(array, start, n)))
