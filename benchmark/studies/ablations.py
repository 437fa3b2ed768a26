"""`gof study ablations`: what the parts of the method are worth, in the paper's two tables."""

from __future__ import annotations

from dataclasses import dataclass

from gof.commands.read import read_options
from gof.dataset import Dataset
from gof.reconstruct.methods import MethodName
from gof_benchmark.studies.variants import Row, VariantStudy, run_one, table, write_page

LEFT_OUT = {
    "full method": "none",
    "NoSync": "no-sync",
    "RandFlow": "rand-flow",
    "JointOpt": "joint-opt",
    "NoMask": "no-mask",
}
VELOCITY = {"l2": "L2 (lower)", "cos_sim": "CosSim (higher)", "seconds": "seconds"}
PICTURES = {
    "psnr_flame": "PSNR flame",
    "ssim_flame": "SSIM flame",
    "psnr": "PSNR",
    "ssim": "SSIM",
    "psnr_flame_novel": "PSNR flame, novel view",
}


@dataclass
class AblationStudy(VariantStudy):
    """Reconstruct a dataset with a part of the method left out at a time: velocity (DVE) and held-out pictures.

    Examples:
      gof study ablations data/fire --out out/ablations

    The full method and the paper's NoSync, RandFlow, JointOpt and NoMask, of ours or of the paper's method; and the
    other method beside them. Every reconstruction has a folder in OUT; finished ones are kept, so a stopped study goes
    on where it was.
    """

    method: MethodName = "gof"
    """Whose parts are left out."""


def main(argv: list[str]) -> int:
    """`gof study ablations DATASET`; see --help."""
    study = read_options(AblationStudy, "study ablations", argv)
    dataset = Dataset.open(study.dataset)
    base = study.settings(dataset)
    variants = _variants(study.method)
    rows = [run_one(study, dataset, f"{v['method']}-{v['ablation']}", base | v) for v in variants.values()]
    title = f"{dataset.description.name}: " + ", ".join(f"{key} {value}" for key, value in base.items())
    parts = [title, "## Velocity", _table(variants, rows, VELOCITY)]
    parts += ["## Held-out pictures", _table(variants, rows, PICTURES)]
    write_page(study.folder / "ablations.md", parts)
    study.finish("ablations", rows)
    return 0


def _variants(method: MethodName) -> dict[str, dict[str, str]]:
    """Return options of `gof reconstruct` by the name of the row; plates throughout, so that JointOpt is of the same
    kind."""
    left_out = {name: {"method": method, "scene": "plates", "ablation": part} for name, part in LEFT_OUT.items()}
    other, words = ("paper", "the paper's choices") if method == "gof" else ("gof", "ours")
    return left_out | {words: {"method": other, "scene": "plates", "ablation": "none"}}


def _table(variants: dict[str, dict[str, str]], rows: list[Row], columns: dict[str, str]) -> str:
    return table(["ablation", *columns.values()], list(variants), rows, list(columns))
