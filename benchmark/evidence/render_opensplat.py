"""The renderer beside OpenSplat's CPU rasteriser, the strongest peer: the same Gaussians, in turn, on as many threads.

    python -m gof_benchmark.evidence.render_opensplat CLONE --build FOLDER [--quick] [--json FILE]

Takes about 3 min. Needs your own clone, and g++.

CLONE is your own clone of github.com/WebODM/OpenSplat (AGPL-3.0; nothing of it is in this project), of August 2026 or
later. Its file rasterizer/gsplat-cpu/gsplat_cpu.cpp is compiled as it is, with -O3 -march=native and the PyTorch that
is installed here, to a library in FOLDER; that takes g++ and a minute or two, once. Both draw and differentiate what
our projection makes of the scene; its own projection is left out of its time, ours is in ours. For 1, 2, 4, ... cores
and all of them a process is kept on that many, and both take as many threads. On a loaded machine ratios of CPU time
hold, single times and those by the clock do not: the load is printed beside them.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.files import write_json
from gof.host.checks import cpu_name
from gof.render import backend
from gof_benchmark.evidence import child
from gof_benchmark.evidence.render_scenes import camera, flame
from gof_benchmark.evidence.render_speed import RandomTraining

SIZES = ((20_000, 320, 180), (100_000, 640, 360), (300_000, 1280, 720))
SOURCE = Path("rasterizer/gsplat-cpu/gsplat_cpu.cpp")
GLUE = """
#include <algorithm>
#include <cstring>
#include <numeric>
#include "gsplat_cpu.cpp"

struct Scene {
    int width, height, count;
    const float *centres, *conics, *colors, *opacities, *background, *covariances, *depths;
};

static torch::Tensor seen(const float *data, std::vector<int64_t> shape) {
    return torch::from_blob(const_cast<float *>(data), shape, torch::kFloat32);
}

static void copy(const torch::Tensor &from, float *to) {
    std::memcpy(to, from.contiguous().data_ptr<float>(), from.numel() * sizeof(float));
}

extern "C" void *draw(const Scene *s, float *image, float *left) {
    auto [drawn, remaining, lists] = rasterize_forward_tensor_cpu(
        s->width, s->height, seen(s->centres, {s->count, 2}), seen(s->conics, {s->count, 3}),
        seen(s->colors, {s->count, 3}), seen(s->opacities, {s->count, 1}), seen(s->background, {3}),
        seen(s->covariances, {s->count, 2, 2}), seen(s->depths, {s->count}));
    copy(drawn, image);
    copy(remaining, left);
    return lists;
}

extern "C" void differentiate(const Scene *s, const float *left, void *lists, const float *of_image,
                              const float *of_alpha, float *of_centres, float *of_conics, float *of_colors,
                              float *of_opacities) {
    auto *of_pixels = static_cast<std::vector<int32_t> *>(lists);
    auto [centres, conics, colors, opacities] = rasterize_backward_tensor_cpu(
        s->height, s->width, seen(s->centres, {s->count, 2}), seen(s->conics, {s->count, 3}),
        seen(s->colors, {s->count, 3}), seen(s->opacities, {s->count, 1}), seen(s->background, {3}),
        seen(s->covariances, {s->count, 2, 2}), seen(s->depths, {s->count}), seen(left, {s->height, s->width}),
        of_pixels, seen(of_image, {s->height, s->width, 3}), seen(of_alpha, {s->height, s->width}),
        torch::empty({0}), torch::empty({0}), torch::empty({0}), torch::empty({0}));  // nothing for its densification
    copy(centres, of_centres);
    copy(conics, of_conics);
    copy(colors, of_colors);
    copy(opacities, of_opacities);
    delete[] of_pixels;
}
"""


@dataclass(frozen=True)
class RenderOpenSplat:
    """Draw and differentiate the same scene with both."""

    clone: tyro.conf.Positional[Path]
    """Folder of a clone of OpenSplat."""
    build: Path
    """Folder for the library that is made of it; a finished one is kept."""
    repeats: int = 7
    """For each, in turn, after one that compiles."""
    quick: bool = False
    """The smallest scene alone."""
    json: Path | None = None
    """Also write every figure to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(RenderOpenSplat, prog="python -m gof_benchmark.evidence.render_opensplat", args=argv)
    library, commit = str(compiled(config.clone, config.build)), commit_of(config.clone)
    cores = sorted(os.sched_getaffinity(0))
    print(f"OpenSplat {commit}; {cpu_name()}, {len(cores)} cores, {backend.kernels().name} kernels; {date.today()}")
    print("Smallest (median); goals, forward + backward by the clock: 20x at 100000, 25x at 300000\n")
    print("| Gaussians, picture, work | ours, ms | OpenSplat, ms | ratio by the clock | ratio in CPU time |")
    print("|---|---|---|---|---|")
    results = []
    for threads in thread_counts(len(cores)):
        for size in SIZES[:1] if config.quick else SIZES:
            figures = child.call(compare_on, library, cores[:threads], *size, config.repeats)
            results.append({"threads": threads, "size": size, **figures})
            print(report(size, threads, figures), flush=True)
    apart = max(r["pictures"] for r in results), max(r["gradients"] for r in results)
    print(f"\nPictures differ by at most {apart[0]:.1e}, gradients of the colours by {apart[1]:.1e}; ", end="")
    print(f"load at most {max(r['load'] for r in results):.1f}")
    if config.json:
        write_json(config.json, {"commit": commit, "cpu": cpu_name(), "date": str(date.today()), "rows": results})


def thread_counts(cores: int) -> list[int]:
    """1, 2, 4, ... and all."""
    return sorted({min(2**k, cores) for k in range(cores.bit_length() + 1)})


def commit_of(clone: Path) -> str:
    """Return hash and date of the clone's commit."""
    command = ["git", "-C", str(clone), "log", "-1", "--format=%h of %cs"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def compiled(clone: Path, build: Path) -> Path:
    """Return the library. Raises GofError: no clone there, or it does not compile."""
    library = build / "opensplat_cpu.so"
    if library.is_file():
        return library
    if not (clone / SOURCE).is_file():
        raise GofError(f"{clone}: no {SOURCE} there; clone github.com/WebODM/OpenSplat to it")
    import torch

    build.mkdir(parents=True, exist_ok=True)
    glue, home = build / "glue.cpp", Path(torch.__file__).parent
    glue.write_text(GLUE)
    command = ["g++", "-std=c++17", "-O3", "-march=native", "-shared", "-fPIC", "-w", str(glue), "-o", str(library)]
    command += [
        f"-I{path}" for path in (clone / SOURCE.parent, home / "include", home / "include/torch/csrc/api/include")
    ]
    command += [f"-L{home / 'lib'}", "-ltorch", "-ltorch_cpu", "-lc10", f"-Wl,-rpath,{home / 'lib'}"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise GofError(f"{clone / SOURCE} does not compile:\n{done.stderr[-2000:]}")
    return library


class Scene(ctypes.Structure):
    """GLUE's scene; numpy arrays that must outlive it."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("width", "height", "count")),
        *(
            (name, ctypes.c_void_p)
            for name in ("centres", "conics", "colors", "opacities", "background", "covariances", "depths")
        ),
    )


class OpenSplat:
    """Its rasteriser on what our projection makes of the random flame."""

    def __init__(self, library: ctypes.CDLL, n: int, width: int, height: int):
        self.library, self.shape = library, (height, width)
        library.draw.restype = ctypes.c_void_p
        library.draw.argtypes = [ctypes.c_void_p] * 3
        library.differentiate.argtypes, library.differentiate.restype = [ctypes.c_void_p] * 9, None
        self.arrays = _projected(n, width, height)
        self.scene = Scene(width, height, n, **{name: a.ctypes.data for name, a in self.arrays.items()})
        self.image, self.left = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
        self.of_alpha = np.zeros((height, width), np.float32)
        self.of_centres, self.of_conics = np.zeros((n, 2), np.float32), np.zeros((n, 3), np.float32)
        self.of_colors, self.of_opacities = np.zeros((n, 3), np.float32), np.zeros((n, 1), np.float32)

    def draw(self) -> int:
        """Fill `image`; returns the lists that `differentiate` frees."""
        return self.library.draw(ctypes.byref(self.scene), self.image.ctypes.data, self.left.ctypes.data)

    def draw_and_differentiate(self) -> None:
        """Draw, and differentiate the sum of squares of the picture; fills the arrays `of_...`."""
        self._differentiate(self.draw())

    def draw_alone(self) -> None:
        """Draw; the lists are freed by the derivative alone, whose time is not counted here: see `compare`."""
        self.lists = self.draw()

    def _differentiate(self, lists: int) -> None:
        of_image = 2 * self.image
        found = self.of_centres, self.of_conics, self.of_colors, self.of_opacities
        out = [a.ctypes.data for a in found]
        args = self.left.ctypes.data, lists, of_image.ctypes.data, self.of_alpha.ctypes.data
        self.library.differentiate(ctypes.byref(self.scene), *args, *out)


def _projected(n: int, width: int, height: int) -> dict[str, np.ndarray]:
    """Our 2D Gaussians in its convention: pixel centres at integers, exponents to the base e."""
    import drjit as dr

    from gof.render.backend import Array3f, Array4f, floats
    from gof.render.project import ProjectionOptions, project
    from gof.render.scene import columns

    g = flame(n)
    shape = columns(g.rotation, Array4f), columns(g.scale, Array3f)
    p = project(columns(g.position, Array3f), *shape, floats(g.opacity), camera(width, height), ProjectionOptions())
    visible = np.array(p.visible)

    def table(*parts: Any) -> np.ndarray:
        return np.ascontiguousarray(np.stack([np.array(dr.detach(part)) for part in parts], -1), np.float32)

    ln2 = np.float32(np.log(2))
    return {
        "centres": table(p.mean_x, p.mean_y) - np.float32(0.5),
        "conics": table(p.a, p.b, p.c) * np.array([2 * ln2, ln2, 2 * ln2], np.float32),
        "colors": np.ascontiguousarray(g.color, np.float32),
        "opacities": np.where(visible, g.opacity, 0)[:, None].astype(np.float32),
        "background": np.zeros(3, np.float32),
        "covariances": table(p.cov_xx, p.cov_xy, p.cov_xy, p.cov_yy),
        "depths": np.array(p.depth, np.float32),
    }


def compare_on(library: str, cores: list[int], n: int, width: int, height: int, repeats: int) -> dict[str, Any]:
    """Return what `compare` does, on these cores alone; call it before Dr.Jit has threads."""
    os.sched_setaffinity(0, cores)
    import drjit as dr
    import torch

    dr.set_thread_count(len(cores))
    torch.set_num_threads(len(cores))
    return compare(ctypes.CDLL(library), n, width, height, repeats)


def compare(library: ctypes.CDLL, n: int, width: int, height: int, repeats: int) -> dict[str, Any]:
    """Return wall and CPU ms of both, forward and forward + backward, in turn; and how far they agree."""
    ours, theirs = RandomTraining(n, width, height), OpenSplat(library, n, width, height)
    figures: dict[str, Any] = {"load": os.getloadavg()[0]}
    both = {
        "forward": (lambda: ours.draw(), theirs.draw_alone),
        "forward + backward": (ours.draw_and_differentiate, theirs.draw_and_differentiate),
    }
    for name, pair in both.items():
        found: dict[str, list[tuple[float, float]]] = {"ours": [], "OpenSplat": []}
        for repeat in range(repeats + 1):
            for who, run in zip(found, pair, strict=True):
                spent = _ms(run)
                if who == "OpenSplat" and name == "forward":
                    theirs._differentiate(theirs.lists)
                if repeat:
                    found[who].append(spent)
        figures[name] = found
    return figures | _agreement(ours, theirs)


def _ms(run: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)


def _agreement(ours: RandomTraining, theirs: OpenSplat) -> dict[str, float]:
    """Return mean difference of the pictures over their mean, and of the colours' gradients in L2."""
    theirs.draw_and_differentiate()
    image = np.stack([np.array(plane) for plane in ours.draw().color], -1).reshape(theirs.image.shape)
    ours.dr.clear_grad([ours.optimizer[name] for name in ours.raw])  # of all the repetitions
    ours.draw_and_differentiate()
    color = np.array(ours.dr.grad(ours.optimizer["color"])).T
    wrong = np.linalg.norm(color - theirs.of_colors) / np.linalg.norm(theirs.of_colors)
    return {"pictures": float(np.abs(image - theirs.image).mean() / theirs.image.mean()), "gradients": float(wrong)}


def report(size: tuple[int, int, int], threads: int, figures: dict[str, Any]) -> str:
    """Return the figures as two rows of the table."""
    n, width, height = size
    lines = []
    for name in ("forward", "forward + backward"):
        spent = {who: np.array(rows) for who, rows in figures[name].items()}  # (repeats, 2): by the clock, of the CPUs
        ms = [f"{s[:, 0].min():.1f} ({np.median(s[:, 0]):.1f})" for s in (spent["ours"], spent["OpenSplat"])]
        least, middle = (f(spent["OpenSplat"], axis=0) / f(spent["ours"], axis=0) for f in (np.min, np.median))
        ratios = [f"{low:.1f}x ({mid:.1f}x)" for low, mid in zip(least, middle, strict=True)]
        what = f"{n}, {width}x{height}, {name}, {threads} thread" + "s" * (threads > 1)
        lines.append(" | ".join(["", what, *ms, *ratios, ""]).strip())
    return "\n".join(lines)


if __name__ == "__main__":
    main()
