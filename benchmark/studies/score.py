"""`gof study score`: the motion score of one result by orders of quadrature, and by both weights of a Gaussian."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.table import Table

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.host.terminal import console, progress_bar


@dataclass
class ScoreStudy:
    """Score a result's motion with more and fewer nodes of quadrature: whether the last digits of L2 can be trusted.

    Examples:
      gof study score out/fire --dataset data/fire --order 3 5
      gof study score out/fire --dataset data/fire --order 3 --opacity temporal base

    `gof evaluate` takes order 3 and the opacity at each time.
    """

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Result of a reconstruction: ours, or any method's that docs/importers.md lists."""
    dataset: Path
    """Dataset folder with true velocities."""
    order: tuple[Literal[1, 3, 5, 7], ...] = (3, 5, 7)
    """Gauss-Hermite nodes per axis for the expected true velocity."""
    opacity: tuple[Literal["temporal", "base"], ...] = ("temporal",)
    """Weight Gaussians by their opacity at each time, or by their peak opacity at all times."""


@dataclass(frozen=True)
class OrderScore:
    """The score of one order and one weight."""

    order: int
    opacity: str
    l2: float | None
    cos_sim: float | None
    seconds: float


def main(argv: list[str]) -> int:
    """`gof study score`; see --help. Raises GofError: the dataset has no true velocity."""
    config = read_options(ScoreStudy, "study score", argv)
    dataset = Dataset.open(config.dataset)
    if not dataset.has_velocity:
        raise GofError(f"{config.dataset}: has no true velocity, so there is no score of motion")
    rows = []
    for opacity in config.opacity:
        for order in config.order:
            began = time.perf_counter()
            with progress_bar(f"order {order}, {opacity}") as progress:
                found = evaluate(config.result, dataset, order, opacity, images=False, progress=progress).dve
            rows.append(OrderScore(order, opacity, found.l2, found.cos_sim, round(time.perf_counter() - began, 1)))
    table = Table(title="Velocity (DVE) by order and weight", title_justify="left")
    for column in ("order", "opacity", "L2", "CosSim", "seconds"):
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(str(row.order), row.opacity, _number(row.l2), _number(row.cos_sim), f"{row.seconds:g}")
    console().print(table)
    write_figures({"rows": [asdict(row) for row in rows]})
    return 0


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
