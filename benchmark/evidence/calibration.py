"""Is the flow prior as sure as it should be?

    python -m gof_benchmark.evidence.calibration DATASET... [--chart FILE.svg]

Takes about 20 s a dataset.

For datasets with true velocity, fused field before any optimisation, weighted by emission. A component of the velocity
should be within one standard deviation of the truth for 0.68 of the light, within two for 0.95, if errors are normal.
The chart says more: the light is dealt into ten parts by how sure the prior is, and each part's RMS error is drawn over
its mean standard deviation, both over the flame's true mean speed. On the diagonal the prior is right about itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.look.charts import line_chart
from gof.look.drawing import require_figure
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.observation import observe
from gof_benchmark.training.field_score import open_small, preview_field, within

PARTS = 10


@dataclass(frozen=True)
class PriorCalibration:
    """Compare the prior's standard deviations with its errors."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Datasets with true velocity, none of which it was trained on."""
    chart: Path | None = None
    """Where the chart goes."""


def reliability(field: FlowField, dataset: Dataset) -> np.ndarray:
    """Return (PARTS, 2): mean standard deviation and RMS error of a component, over the true mean speed, surest part
    first."""
    truth = np.stack([dataset.velocity.at(frame.time_s).sample(field.voxels.center) for frame in field.frames])
    emission, deviation = field.emission, np.stack([frame.velocity_sd for frame in field.frames])
    speed = (emission * np.linalg.norm(truth, axis=-1)).sum() / emission.sum()
    square = ((field.velocity - truth) ** 2).mean(-1).ravel()
    order = deviation.ravel().argsort()
    light = emission.ravel()[order]
    part = np.minimum(np.cumsum(light) / light.sum() * PARTS, PARTS - 1).astype(int)
    of_part = np.bincount(part, light, PARTS)
    variances = [np.bincount(part, light * v[order], PARTS) / of_part for v in (deviation.ravel() ** 2, square)]
    return np.sqrt(np.stack(variances, -1)) / speed


def main(argv: list[str] | None = None) -> None:
    """Print the table, draw the chart."""
    config = tyro.cli(PriorCalibration, prog="python -m gof_benchmark.evidence.calibration", args=argv)
    if config.chart:
        require_figure(config.chart)
    print("| dataset | within 1 | within 2 | of the surest tenth: said, true | of the least sure |")
    print("|---|---|---|---|---|")
    series = {}
    for path in config.datasets:
        dataset = open_small(path)
        seen = preview_field(observe(dataset))
        gas = FlowPrior.load().correct(seen, metres=dataset.description.in_metres)
        parts = reliability(gas, dataset)
        ends = [f"{said:.2f}, {true:.2f}" for said, true in parts[[0, -1]]]
        shares = [f"{within(gas, dataset, deviations):.2f}" for deviations in (1, 2)]
        print(f"| {path.name} | {shares[0]} | {shares[1]} | {ends[0]} | {ends[1]} |", flush=True)
        series[path.name.replace("_", " ")] = [(float(said), float(true), "") for said, true in parts]
    if config.chart:
        ends = np.concatenate([np.asarray([point[:2] for point in points]) for points in series.values()])
        diagonal = {"uncertainty as large as the error": [(float(v), float(v), "") for v in (ends.min(), ends.max())]}
        line_chart(
            "Uncertainty that the flow prior states, and its error",
            "stated standard deviation, over the mean speed",
            "RMS error, over the mean speed",
            diagonal | series,
        ).write(config.chart)
        print(f"chart -> {config.chart}")


if __name__ == "__main__":
    main()
