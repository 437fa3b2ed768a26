"""`gof study dve`: what quadrature order, grid resolution, precision and Monte Carlo buy, in error against closed forms and seconds."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from gof.evaluate import line_chart
from gof.evaluate.closed_forms import Flow, abc, gaussian_vortex, linear, taylor_green
from gof.evaluate.grid_quadrature import expected_velocity_on_grid
from gof.evaluate.quadrature import ORDERS, expected_velocity_plain
from gof.fields import VelocityField
from gof.rotations import rotation_matrices

HALF = 0.6  # m; the Gaussians stay well inside the box of this half width


class _Analytic:
    """A flow with the interface of a field, everywhere."""

    voxel_size = 1.0

    def __init__(self, flow: Flow):
        self.sample = flow.velocity

    def contains(self, points: np.ndarray) -> np.ndarray:
        return np.ones(len(points), bool)


def gaussians(count: int, k_sigma: float, k: float, seed: int = 0):
    """Random anisotropic Gaussians with a root-mean-square width of k_sigma / k; (position, scale, rotation)."""
    rng = np.random.default_rng(seed)
    scale = rng.uniform(0.3, 1.0, (count, 3))
    scale *= k_sigma / k / np.sqrt((scale**2).mean())
    return rng.uniform(-0.25, 0.25, (count, 3)), scale, rng.normal(size=(count, 4))


def run(count: int = 20_000, samples: int = 1_000_000, progress=None) -> list[dict[str, Any]]:
    """All rows: {"study", "flow", "setting", "k_sigma", "error" (relative L2 over the Gaussians), "seconds" (per 10 000 Gaussians)}."""
    k = 10.0
    flows = [linear(), taylor_green(k), abc(k), gaussian_vortex(1.5 / k)]
    rows: list[dict[str, Any]] = []
    widths = (0.25, 0.5, 1.0, 1.5)
    total = len(flows) * len(widths) + 2 * len(flows) + 1

    def record(study, flow, setting, k_sigma, got, truth, seconds, n):
        rows.append(
            {
                "study": study,
                "flow": flow.name,
                "setting": setting,
                "k_sigma": k_sigma,
                "error": float(np.linalg.norm(got - truth) / np.linalg.norm(truth)),
                "seconds": seconds / n * 10_000,
            }
        )

    def step(done):
        if progress:
            progress(done, total)

    done = 0
    for flow in flows:
        for k_sigma in widths:
            x, s, q = gaussians(count // 10, k_sigma, k)
            truth = flow.mean(x, _covariance(s, q))
            for order in ORDERS:
                start = time.perf_counter()
                got = expected_velocity_plain(_Analytic(flow), x, s, q, order).mean
                record("order", flow, f"order {order}", k_sigma, got, truth, time.perf_counter() - start, len(x))
            step(done := done + 1)
    for flow in flows:
        x, s, q = gaussians(count, 0.5, k)
        truth = flow.mean(x, _covariance(s, q))
        for cells in (16, 32, 64, 128):
            field = _grid(flow, cells)
            for order in (1, 3, 5, 7):
                if order in (1, 7) and cells != 64:
                    continue
                expected_velocity_on_grid(field, x[:100], s[:100], q[:100], order)  # compiled once, not timed
                start = time.perf_counter()
                got = expected_velocity_on_grid(field, x, s, q, order).mean
                record("grid", flow, f"{cells}^3 order {order}", 0.5, got, truth, time.perf_counter() - start, count)
        step(done := done + 1)
        field = _grid(flow, 128)
        for dtype in (np.float16, np.float32, np.float64):
            cast = VelocityField(field.velocity.astype(dtype), field.index_to_world)
            for name, function in (("kernel", expected_velocity_on_grid), ("plain", expected_velocity_plain)):
                n = count if name == "kernel" else count // 10
                start = time.perf_counter()
                got = function(cast, x[:n], s[:n], q[:n], 3).mean
                reference = expected_velocity_plain(field, x[: n // 10], s[: n // 10], q[: n // 10], 3).mean
                record(
                    "precision",
                    flow,
                    f"{np.dtype(dtype).name} {name}",
                    0.5,
                    got[: n // 10],
                    reference,
                    time.perf_counter() - start,
                    n,
                )
        step(done := done + 1)
    _monte_carlo(abc(k), k, samples, record)
    step(total)
    return rows


def _monte_carlo(flow: Flow, k: float, samples: int, record) -> None:
    x, s, q = gaussians(20, 0.5, k)
    truth, rng = flow.mean(x, _covariance(s, q)), np.random.default_rng(1)
    axes = rotation_matrices(q) * s[:, None, :]
    count = 100
    while count <= samples:
        start = time.perf_counter()
        got = np.empty_like(x)
        for i in range(len(x)):
            got[i] = flow.velocity(x[i] + rng.standard_normal((count, 3)) @ axes[i].T).mean(0)
        record("monte carlo", flow, f"{count} samples", 0.5, got, truth, time.perf_counter() - start, len(x))
        count *= 10


def _grid(flow: Flow, cells: int) -> VelocityField:
    field = VelocityField.from_array(np.zeros((cells, cells, cells, 3)), (-HALF,) * 3, 2 * HALF / cells)
    velocity = flow.velocity(field.cell_centers().reshape(-1, 3)).reshape(cells, cells, cells, 3)
    return VelocityField(velocity, field.index_to_world)


def _covariance(scale, rotation):
    axes = rotation_matrices(rotation) * scale[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


LINES = (
    ("order", 0.5, "exact field, orders 1 3 5 7 (k sigma 0.5)"),
    ("order", 1.5, "exact field, orders 1 3 5 7 (k sigma 1.5)"),
    ("grid", 0.5, "grids of 16 to 128 cells, order 3"),
    ("monte carlo", 0.5, "Monte Carlo, 1e2 to 1e6 samples"),
)


def write_charts(rows: list[dict[str, Any]], folder: Path) -> list[Path]:
    """Error over seconds, study_dve_FLOW.svg per flow. Errors below 1e-17 count as 1e-17."""
    paths = []
    for flow in dict.fromkeys(r["flow"] for r in rows):
        lines: dict[str, list] = {}
        for study, k_sigma, label in LINES:
            picked = [r for r in rows if (r["flow"], r["study"], r["k_sigma"]) == (flow, study, k_sigma)]
            if study == "grid":
                picked = [r for r in picked if r["setting"].endswith("order 3")]
            if picked:
                lines[label] = [
                    (
                        r["seconds"],
                        max(r["error"], 1e-17),
                        r["setting"].removesuffix(" order 3").removesuffix(" samples"),
                    )
                    for r in picked
                ]
        paths.append(folder / f"study_dve_{flow.lower().replace(' ', '_')}.svg")
        line_chart.write(
            paths[-1],
            f"{flow}: error of the expected velocity",
            "seconds per 10 000 Gaussians",
            "relative L2 error",
            lines,
        )
    return paths


@dataclass
class StudyConfig:
    """Accuracy against time: quadrature order, grid resolution and precision, against closed forms and Monte Carlo."""

    what: tyro.conf.Positional[Literal["dve"]]
    """What to study."""
    out: Path = Path("out/study")
    """Folder for study_dve.json and a chart per flow; older ones are replaced."""
    gaussians: int = 20_000
    """Gaussians per measurement."""
    samples: int = 1_000_000
    """Largest number of Monte Carlo samples per Gaussian."""
    json: Path | None = None
    """Another file to write the rows to."""


def main(argv: list[str]) -> int:
    """The command line of `gof study`."""
    from rich.console import Console
    from rich.table import Table

    from gof.io.files import write_json
    from gof.progress import progress_bar

    config = tyro.cli(StudyConfig, prog="gof study", args=argv)
    with progress_bar("study") as progress:
        rows = run(config.gaussians, config.samples, lambda done, total: progress(done, total, stage="DVE"))
    table = Table(title="Expected velocity against closed forms", title_justify="left")
    for column in ("study", "flow", "setting", "k sigma", "relative error", "s per 10 000"):
        table.add_column(column, no_wrap=True)
    for r in rows:
        table.add_row(
            r["study"], r["flow"], r["setting"], f"{r['k_sigma']:g}", f"{r['error']:.2e}", f"{r['seconds']:.4f}"
        )
    console = Console()
    console.print(table)
    content = {"schema": "gof-study-dve", "version": 1, "rows": rows}
    for path in {config.out / "study_dve.json", config.json} - {None}:
        write_json(path, content)
    charts = write_charts(rows, config.out)
    console.print(f"written to {config.out}/study_dve.json, {', '.join(path.name for path in charts)}")
    return 0
