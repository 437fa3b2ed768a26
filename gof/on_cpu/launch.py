"""Run another method's script in this process, with stand-ins for what needs CUDA."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

from gof.core.errors import GofError, MissingDependencyError
from gof.host.processes import run
from gof.on_cpu import baseline_methods, gaussian_rasterizer
from gof.on_cpu.baseline_methods import REPAIRS, BaselineMethod, replace_gsplat
from gof.on_cpu.devices import CpuForCuda, replace_cuda
from gof.on_cpu.imports import missing
from gof.on_cpu.small_modules import Unused
from gof.render import gsplat


def launch(
    method: BaselineMethod, script: Path, arguments: list[str], curve: Path | None = None, without_lpips: bool = False
) -> None:
    """Run the script as `python SCRIPT ARGUMENTS` would. This process is not good for anything else afterwards.

    Args:
        curve: CSV of the loss over steps and seconds.   without_lpips: LPIPS is NaN, and an error as a loss.
    Raises:
        GofError: no such script, or a module that the method needs is absent. Else whatever the script raises.
    """
    record = LossRecorder(curve) if curve else None
    mode = CpuForCuda(record.add if record else None)
    _begin(method, script, mode)
    if without_lpips:
        baseline_methods.perceptual_loss_left_out()
    if record:
        _count_gaussians(record)
    sys.argv = [str(script), *arguments]
    with mode:
        runpy.run_path(str(script), run_name="__main__")


def export(method: BaselineMethod, script: Path, model: Path, dataset: Path, out: Path) -> None:
    """Write a trained model as gof-trajectory/1, with the classes of the checkout that the script is of.

    Raises:
        GofError: a method whose own files are imported, no checkout, or no finished training in `model`.
    """
    if method.export is None:
        raise GofError(f"{method.title}: its own files are read; give them to gof evaluate (docs/importers.md)")
    mode = CpuForCuda()
    _begin(method, script, mode)
    with mode:
        print(method.export(model, dataset, out))


def _begin(method: BaselineMethod, script: Path, mode: CpuForCuda) -> None:
    os.environ.setdefault("MPLBACKEND", "agg")  # otherwise matplotlib opens a window by tkinter, which may be missing
    replace_cuda(mode)
    prepare(method)
    sys.path.insert(0, str(script.parent.resolve()))  # as Python does; `gof.host.processes` has left the place empty


def prepare(method: BaselineMethod) -> None:
    """Repairs, then stand-ins. Raises MissingDependencyError: the method's code would not find a library."""
    absent = missing({*method.needs, *(["gsplat"] if method.gsplat else [])})
    if absent:
        raise MissingDependencyError(f"{method.title} needs {', '.join(absent)}: docs/baselines.md lists its packages")
    for repair in REPAIRS:
        repair()
    if method.gsplat:
        replace_gsplat()
    for name, build in method.modules.items():
        put(name, build())
    for name in method.unused:
        put(name, Unused(name))


def put(name: str, module: ModuleType) -> None:
    """Make `import name` find the module. A package of the script's own around it is left to be found."""
    package, _, last = name.rpartition(".")
    if last == "_C":  # of a package that is compiled as a whole
        around = ModuleType(package)
        around.__path__ = []
        setattr(around, last, module)
        sys.modules[package] = around
    sys.modules[name] = module


def _count_gaussians(record: LossRecorder) -> None:
    """Let the curve know how many Gaussians each picture was drawn from."""
    draw = gaussian_rasterizer.rasterize

    def counted(means, *args, **kwargs):
        record.count = len(means)
        return draw(means, *args, **kwargs)

    gaussian_rasterizer.rasterize = gsplat.rasterize = counted


def method_of(name: str | None, script: Path) -> BaselineMethod:
    """Return a listed method by its name, or one found out by what the script imports.

    Raises:
        GofError: no such script, or a rasteriser without a stand-in.
    """
    if not script.is_file():
        raise GofError(f"{script}: no such script; give the path of a script in your checkout")
    return baseline_methods.METHODS[name] if name else baseline_methods.by_imports(script)


def provenance(method: BaselineMethod, script: Path) -> str:
    """Return one line: which commit of which repository this is, and whether files of it are changed."""
    folder = script.resolve().parent

    def git(*words):
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
        done = run(["git", "-C", str(folder), *words], **pipes)
        return done.stdout.strip() if done.returncode == 0 else None

    head, changed = git("rev-parse", "HEAD"), git("diff", "--name-only", "--diff-filter=d", "HEAD")
    if head is None:
        return "no git checkout: its commit is not known"
    state = f"{len(changed.splitlines())} files changed" if changed else "no file changed"
    known = "" if not method.commit or head.startswith(method.commit) else f"; known to run: {method.commit[:12]}"
    return f"commit {head[:12]}, {state}{known}"


# ----------------------------------------------------------------
# How a training went: one line per `loss.backward()`, thinned, as CSV.

EVERY = 10  # steps; a line is their mean


class LossRecorder:
    """Attributes: count, the Gaussians of the last picture drawn."""

    def __init__(self, path: Path):
        self.count = 0
        self._path, self._began = path, time.perf_counter()
        self._losses: list[float] = []
        self._step = 0
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("step,seconds,cpu_seconds,loss,gaussians\n")

    def add(self, loss: float) -> None:
        """Count one step."""
        self._step += 1
        self._losses.append(loss)
        if len(self._losses) < EVERY:
            return
        mean = sum(self._losses) / EVERY
        now = time.perf_counter() - self._began
        with self._path.open("a") as file:
            file.write(f"{self._step},{now:.2f},{time.process_time():.2f},{mean:.6g},{self.count}\n")
        self._losses.clear()
