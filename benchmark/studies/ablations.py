"""`gof study ablations`: what the parts of the method are worth, in the paper's two tables."""

from __future__ import annotations

from dataclasses import dataclass

import tyro

from gof.dataset import Dataset
from gof_benchmark.studies.variants import Row, VariantStudy, run_one, table, write_page

ABLATIONS = {
    "full method": {"ablation": "none"},
    "NoSync": {"ablation": "no-sync"},
    "RandFlow": {"ablation": "rand-flow"},
    "JointOpt": {"ablation": "joint-opt"},
    "NoMask": {"ablation": "no-mask"},
    "the paper's choices": {"method": "paper"},
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

    The full method, the paper's NoSync, RandFlow, JointOpt and NoMask, and the paper's own choices wherever ours
    differ. Every reconstruction has a folder in OUT; finished ones are kept, so a stopped study goes on where it was.
    """


def main(argv: list[str]) -> int:
    """`gof study ablations DATASET`; see --help."""
    study = tyro.cli(AblationStudy, prog="gof study ablations", args=argv)
    dataset = Dataset.open(study.dataset)
    base = study.settings()
    rows = [run_one(study, dataset, *change.values(), base | change) for change in ABLATIONS.values()]
    title = f"{dataset.description.name}: " + ", ".join(f"{key} {value}" for key, value in base.items())
    parts = [title, "## Velocity", _table(rows, VELOCITY), "## Held-out pictures", _table(rows, PICTURES)]
    write_page(study.out / "ablations.md", parts)
    study.finish("ablations", rows)
    return 0


def _table(rows: list[Row], columns: dict[str, str]) -> str:
    return table(["ablation", *columns.values()], list(ABLATIONS), rows, list(columns))
