"""The methods that run here: whose code, at which commit, and what each needs before its script begins."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import torch

from gof.core.errors import GofError
from gof.on_cpu import export, hash_grid
from gof.on_cpu import gaussian_rasterizer as inria
from gof.on_cpu import small_modules as small
from gof.on_cpu.imports import ONLY_IF_ABSENT, RASTERIZER, STAND_INS, missing, read_imports
from gof.render.gsplat import rasterization

# ----------------------------------------------------------------
# Repairs, made for every method: of what libraries stopped doing since it was written, and of what is slow on a CPU.
# None touches a file.

_kept: list[torch.library.Library] = []  # declarations last as long as these


def pictures_of_signed_bytes() -> None:
    """`PIL.Image.fromarray` took int8 for the bytes they are; newer ones refuse. (D-NeRF readers)"""
    if find_spec("PIL") is None:
        return
    image = import_module("PIL.Image")
    original = image.fromarray

    def fromarray(obj, mode=None):
        if isinstance(obj, np.ndarray) and obj.dtype == np.int8:
            obj = obj.view(np.uint8)
        return original(obj) if mode is None else original(obj, mode)

    vars(image).update(fromarray=fromarray)


def torchvision_without_its_operators() -> None:
    """Declare two operators that a torchvision built for another PyTorch wants, which nothing here calls."""
    spec = find_spec("torchvision")
    if spec is None or spec.origin is None:
        return
    try:
        for compiled in Path(spec.origin).parent.glob("_C*"):
            torch.ops.load_library(str(compiled))
    except OSError:
        library = torch.library.Library("torchvision", "DEF")
        library.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        library.define("qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        _kept.append(library)


def adam_in_one_pass() -> None:
    """PyTorch's own fused Adam wherever a script leaves the choice: equal to rounding, a tenth of the time."""
    original = torch.optim.Adam.__init__

    def begin(self, params, *args, **kwargs):
        chosen = kwargs.keys() & {"fused", "foreach", "capturable", "differentiable"}
        original(self, params, *args, **(kwargs if chosen else kwargs | {"fused": True}))

    torch.optim.Adam.__init__ = begin  # type: ignore[method-assign]


def no_restart() -> None:
    """Refuse a training that replaces its own process: it would lose this one's stand-ins. (4DGS of Wu)"""

    def refuse(path, arguments):
        raise GofError(f"the script ends itself to begin again ({' '.join(map(str, arguments[1:3]))}): its loss is NaN")

    os.execv = refuse


def perceptual_loss_left_out() -> None:
    """LPIPS needs weights that are fetched when it is made."""
    from gof.on_cpu.small_modules import NoPerceptualLoss

    for module in ("torchmetrics.image.lpip", "torchmetrics.image"):
        vars(import_module(module)).update(LearnedPerceptualImagePatchSimilarity=NoPerceptualLoss)


REPAIRS = (torchvision_without_its_operators, pictures_of_signed_bytes, adam_in_one_pass, no_restart)


@dataclass(frozen=True)
class BaselineMethod:
    """One method.

    Attributes:
        title, licence: of the method's code.   repository: on GitHub.   commit: a commit that is known to run.
        modules: stand-ins by the names that the code imports.   unused: modules it imports and does not use.
        needs: packages it cannot begin without.   gsplat: its rasteriser is gsplat's.
        export: (output folder, dataset, file) writes a trajectory and says what; None: its own files are imported.
    """

    title: str
    repository: str
    commit: str
    licence: str
    modules: dict[str, Callable[[], ModuleType]] = field(default_factory=dict)
    unused: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    gsplat: bool = False
    export: Callable[[Path, Path, Path], str] | None = None


METHODS = {
    "wu": BaselineMethod(
        title="4D Gaussian Splatting (Wu et al.)",
        repository="hustvl/4DGaussians",
        commit="843d5ac636c37e4b611242287754f3d4ed150144",
        licence="Apache-2.0; its parts of 3D Gaussian Splatting for research only",
        modules={
            "diff_gaussian_rasterization": lambda: inria.module("depth"),
            "simple_knn._C": small.simple_knn,
            "mmcv": small.mmcv,
        },
        unused=("open3d", "tkinter", "lpips"),
        needs=("torchvision",),
        export=export.export_wu,
    ),
    "yang": BaselineMethod(
        title="4D Gaussian Splatting (Yang et al.)",
        repository="fudan-zvg/4d-gaussian-splatting",
        commit="63725f21d4adc29669e565ae10e6b3ad6e0d1250",
        licence="MIT; its parts of 3D Gaussian Splatting for research only",
        modules={
            "gaussian_renderer.diff_gaussian_rasterization": lambda: inria.module("spacetime"),
            "simple_knn._C": small.simple_knn,
            "kornia": small.kornia,
        },
        unused=("pointops2_cuda",),
        needs=("torchvision",),
    ),
    "freetime": BaselineMethod(
        title="FreeTimeGsVanilla, a re-implementation of FreeTimeGS",
        repository="raiscui/FreeTimeGsVanilla",
        commit="911dcf4",
        licence="AGPL-3.0",
        modules={"fused_ssim": small.fused_ssim},
        unused=("kornia", "plas"),
        needs=("torchvision",),
        gsplat=True,
    ),
    "grid4d": BaselineMethod(
        title="Grid4D",
        repository="JiaweiXu8/Grid4D",
        commit="c9a93fb7d399d332c27e585ac05f9d6cfa31f250",
        licence="none is stated; its parts of 3D Gaussian Splatting for research only",
        modules={
            "diff_gaussian_rasterization": lambda: inria.module("depth"),
            "simple_knn._C": small.simple_knn,
            "hashencoder.backend": hash_grid.backend,
        },
        unused=("cachetools",),
        export=export.export_grid4d,
    ),
    "deformable": BaselineMethod(
        title="Deformable 3D Gaussians",
        repository="ingra14m/Deformable-3D-Gaussians",
        commit="ac423728df780ee57a82025a6d7c4c7312fdf9bb",
        licence="MIT; its parts of 3D Gaussian Splatting for research only",
        modules={
            "diff_gaussian_rasterization": lambda: inria.module("depth"),
            "simple_knn._C": small.simple_knn,
        },
        export=export.export_deformable,
    ),
    "3dgs": BaselineMethod(
        title="code that calls 3D Gaussian Splatting's rasteriser as it was first published",
        repository="graphdeco-inria/gaussian-splatting",
        commit="",
        licence="for research only",
        modules={
            "diff_gaussian_rasterization": lambda: inria.module("plain"),
            "simple_knn._C": small.simple_knn,
        },
    ),
    "gsplat": BaselineMethod(
        title="code that calls gsplat",
        repository="nerfstudio-project/gsplat",
        commit="",
        licence="Apache-2.0",
        modules={"fused_ssim": small.fused_ssim},
        gsplat=True,
    ),
}


def by_imports(script: Path) -> BaselineMethod:
    """Return a method for code that is not listed: stand-ins by what it imports; packages that it lacks are empty.

    Raises:
        GofError: it calls a rasteriser that has no stand-in.
    """
    found = read_imports(script)
    modules = {name: STAND_INS[name] for name in sorted(found.others) if name in STAND_INS}
    if RASTERIZER in found.others:
        variant = found.variant()
        modules[RASTERIZER] = lambda: inria.module(variant)
    rest = found.others - set(modules)
    absent = missing(rest)
    modules = {name: build for name, build in modules.items() if name not in ONLY_IF_ABSENT or missing({name})}
    stood_in = ", ".join(modules) or "nothing"
    lacks = f"; not installed, and an error once it is used: {', '.join(absent)}" if absent else ""
    return BaselineMethod(
        title=f"a method that is not listed (stand-ins for {stood_in}{lacks})",
        repository="",
        commit="",
        licence="see its checkout",
        modules=modules,
        unused=tuple(sorted(name for name in rest if name.partition(".")[0] in absent)),
        gsplat="gsplat" not in absent and any(name.partition(".")[0] == "gsplat" for name in rest),
    )


def replace_gsplat() -> None:
    """Put our rasteriser in the place of gsplat's, under each name that it has."""
    import gsplat
    import gsplat.rendering

    gsplat.rendering.rasterization = gsplat.rasterization = rasterization
