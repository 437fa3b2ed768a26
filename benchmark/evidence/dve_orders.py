"""The worth of DVE's quadrature order, grid resolution, precision and Monte Carlo, in error and in seconds.

    python -m gof_benchmark.evidence.dve_orders [--gaussians 2000]

Takes about 2 min.

The truth is a closed form of the expected velocity (written out at the end of this file).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import tyro

from gof.core.fields import VelocityField
from gof.core.files import write_json
from gof.core.records import to_json
from gof.core.rotations import rotation_matrices
from gof.evaluate.expectation import expected_velocity_plain
from gof.evaluate.grid_quadrature import expected_velocity_on_grid
from gof.evaluate.quadrature import ORDERS
from gof.host.terminal import progress_bar
from gof.look.charts import line_chart

HALF = 0.6  # m; the Gaussians stay well inside the box of this half width
WAVE_NUMBER = 10.0  # 1/m, of the periodic flows; `k_sigma` is this times a Gaussian's width
WIDTHS = (0.25, 0.5, 1.0, 1.5)  # k_sigma
GRIDS = (16, 32, 64, 128)  # cells along each side
FEW_SAMPLES = 100  # of Monte Carlo; each further row has ten times as many


@dataclass(frozen=True)
class DveOrders:
    """Accuracy against time: quadrature order, grid resolution and precision, against closed forms and Monte Carlo."""

    out: Path = Path("out/dve_orders")
    """Folder for study_dve.json and a chart per flow; older ones are replaced."""
    gaussians: int = 20_000
    """Gaussians per measurement."""
    samples: int = 1_000_000
    """Largest number of Monte Carlo samples per Gaussian."""


@dataclass(frozen=True)
class OrderMeasurement:
    """One measurement: `error` is relative (L2 over the Gaussians), `seconds` are per 10 000 Gaussians."""

    study: str
    flow: str
    setting: str
    k_sigma: float
    error: float
    seconds: float


@dataclass(frozen=True)
class OrderMeasurements:
    """`study_dve.json`."""

    SCHEMA: ClassVar[str] = "gof-study-dve"
    VERSION: ClassVar[int] = 1

    rows: tuple[OrderMeasurement, ...]


def main(argv: list[str] | None = None) -> None:
    """Print the table, and write it with its charts."""
    from rich.console import Console
    from rich.table import Table

    config = tyro.cli(DveOrders, prog="python -m gof_benchmark.evidence.dve_orders", args=argv)
    out = config.out
    with progress_bar("study") as progress:
        rows = run(config.gaussians, config.samples, lambda done, total: progress(done, total, stage="DVE"))
    table = Table(title="Expected velocity against closed forms", title_justify="left")
    for column in ("study", "flow", "setting", "k sigma", "relative error", "s per 10 000"):
        table.add_column(column, no_wrap=True)
    for r in rows:
        table.add_row(r.study, r.flow, r.setting, f"{r.k_sigma:g}", f"{r.error:.2e}", f"{r.seconds:.4f}")
    console = Console()
    console.print(table)
    content = to_json(OrderMeasurements(tuple(rows)))
    write_json(out / "study_dve.json", content)
    charts = write_charts(rows, out)
    console.print(f"written to {out}/study_dve.json, {', '.join(path.name for path in charts)}")


def run(
    count: int = 20_000, samples: int = 1_000_000, progress: Callable[[int, int], None] | None = None
) -> list[OrderMeasurement]:
    """Return all rows; progress(parts done, parts)."""
    k = WAVE_NUMBER
    flows = [linear(), taylor_green(k), abc(k), gaussian_vortex(1.5 / k)]
    parts = [partial(order_rows, flow, width, count // 10) for flow in flows for width in WIDTHS]
    parts += [partial(part, flow, count) for flow in flows for part in (grid_rows, precision_rows)]
    parts += [partial(monte_carlo_rows, abc(k), samples)]
    rows: list[OrderMeasurement] = []
    for done, part in enumerate(parts, 1):
        rows += part()
        if progress:
            progress(done, len(parts))
    return rows


def order_rows(flow: AnalyticFlow, k_sigma: float, count: int) -> Iterator[OrderMeasurement]:
    """Orders of the product rule, on the flow itself."""
    x, s, q = gaussians(count, k_sigma)
    truth = flow.mean(x, _covariance(s, q))
    for order in ORDERS:
        start = time.perf_counter()
        got = expected_velocity_plain(_Everywhere(flow), x, s, q, order).mean
        yield _row("order", flow, f"order {order}", k_sigma, got, truth, time.perf_counter() - start)


def grid_rows(flow: AnalyticFlow, count: int) -> Iterator[OrderMeasurement]:
    """Grids of several resolutions, by the compiled kernel."""
    x, s, q = gaussians(count, 0.5)
    truth = flow.mean(x, _covariance(s, q))
    for cells in GRIDS:
        field = _grid(flow, cells)
        for order in ORDERS if cells == 64 else (3, 5):
            expected_velocity_on_grid(field, x[:100], s[:100], q[:100], order)  # compiled once, not timed
            start = time.perf_counter()
            got = expected_velocity_on_grid(field, x, s, q, order).mean
            yield _row("grid", flow, f"{cells}^3 order {order}", 0.5, got, truth, time.perf_counter() - start)


def precision_rows(flow: AnalyticFlow, count: int) -> Iterator[OrderMeasurement]:
    """Precisions of the stored velocity, by kernel and in numpy; the truth is the same grid in float64."""
    x, s, q = gaussians(count, 0.5)
    few = count // 10
    field = _grid(flow, GRIDS[-1])
    truth = expected_velocity_plain(field, x[:few], s[:few], q[:few], 3).mean
    for dtype in (np.float16, np.float32, np.float64):
        cast = VelocityField(field.velocity.astype(dtype), field.index_to_world)
        for name, function, n in (
            ("kernel", expected_velocity_on_grid, count),
            ("plain", expected_velocity_plain, few),
        ):
            start = time.perf_counter()
            got = function(cast, x[:n], s[:n], q[:n], 3).mean
            seconds = (time.perf_counter() - start) * few / n
            yield _row("precision", flow, f"{np.dtype(dtype).name} {name}", 0.5, got[:few], truth, seconds)


def monte_carlo_rows(flow: AnalyticFlow, most: int) -> Iterator[OrderMeasurement]:
    """Yield numbers of random samples per Gaussian, on the flow itself."""
    x, s, q = gaussians(20, 0.5)
    truth = flow.mean(x, _covariance(s, q))
    rng = np.random.default_rng(1)
    axes = rotation_matrices(q) * s[:, None, :]
    count = FEW_SAMPLES
    while count <= most:
        start = time.perf_counter()
        got = np.empty_like(x)
        for i in range(len(x)):
            got[i] = flow.velocity(x[i] + rng.standard_normal((count, 3)) @ axes[i].T).mean(0)
        yield _row("monte carlo", flow, f"{count} samples", 0.5, got, truth, time.perf_counter() - start)
        count *= 10


def gaussians(count: int, k_sigma: float, k: float = WAVE_NUMBER, seed: int = 0):
    """Random anisotropic Gaussians with a root-mean-square width of k_sigma / k; (position, scale, rotation)."""
    rng = np.random.default_rng(seed)
    scale = rng.uniform(0.3, 1.0, (count, 3))
    scale *= k_sigma / k / np.sqrt((scale**2).mean())
    return rng.uniform(-0.25, 0.25, (count, 3)), scale, rng.normal(size=(count, 4))


class _Everywhere:
    """A flow with the interface of a field, everywhere."""

    voxel_size = 1.0

    def __init__(self, flow: AnalyticFlow):
        self.sample = flow.velocity

    def contains(self, points: np.ndarray) -> np.ndarray:
        return np.ones(len(points), bool)


def _row(
    study: str, flow: AnalyticFlow, setting: str, k_sigma: float, got: np.ndarray, truth: np.ndarray, seconds: float
) -> OrderMeasurement:
    error = float(np.linalg.norm(got - truth) / np.linalg.norm(truth))
    return OrderMeasurement(study, flow.name, setting, k_sigma, error, seconds / len(got) * 10_000)


def _grid(flow: AnalyticFlow, cells: int) -> VelocityField:
    field = VelocityField.from_array(np.zeros((cells, cells, cells, 3)), (-HALF,) * 3, 2 * HALF / cells)
    velocity = flow.velocity(field.cell_centers().reshape(-1, 3)).reshape(cells, cells, cells, 3)
    return VelocityField(velocity, field.index_to_world)


def _covariance(scale: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    axes = rotation_matrices(rotation) * scale[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


LINES = (
    ("order", 0.5, "exact field, 1 to 7 nodes, small Gaussians"),
    ("order", 1.5, "exact field, 1 to 7 nodes, large Gaussians"),
    ("grid", 0.5, "grids of 16 to 128 cells, 3 nodes"),
    ("monte carlo", 0.5, "Monte Carlo, 100 to 1 000 000 samples"),
)


def write_charts(rows: list[OrderMeasurement], folder: Path) -> list[Path]:
    """Error over seconds, study_dve_FLOW.svg per flow. Errors below 1e-17 count as 1e-17."""
    paths = []
    for flow in dict.fromkeys(row.flow for row in rows):
        lines = {label: _points(rows, flow, study, k_sigma) for study, k_sigma, label in LINES}
        paths.append(folder / f"study_dve_{flow.lower().replace(' ', '_')}.svg")
        line_chart(
            f"{flow}: error of the expected velocity",
            "seconds per 10 000 Gaussians",
            "relative L2 error",
            {label: points for label, points in lines.items() if points},
        ).write(paths[-1])
    return paths


def _points(rows: list[OrderMeasurement], flow: str, study: str, k_sigma: float) -> list[tuple[float, float, str]]:
    """Return (seconds, error, label) of one line of a chart."""
    found = [row for row in rows if (row.flow, row.study, row.k_sigma) == (flow, study, k_sigma)]
    if study == "grid":
        found = [row for row in found if row.setting.endswith("order 3")]
    labels = [row.setting.removesuffix(" order 3").removesuffix(" samples") for row in found]
    return [(row.seconds, max(row.error, 1e-17), label) for row, label in zip(found, labels, strict=True)]


# ----------------------------------------------------------------
# Flows whose expected value under any Gaussian is known exactly: what the quadrature is judged against.


@dataclass(frozen=True)
class AnalyticFlow:
    """velocity(points (M, 3) m) -> (M, 3) m/s; mean(position (M, 3), covariance (M, 3, 3)) -> expectation (M, 3)."""

    name: str
    velocity: Callable[[np.ndarray], np.ndarray]
    mean: Callable[[np.ndarray, np.ndarray], np.ndarray]


def linear() -> AnalyticFlow:
    """V = A x + b: the expectation is the value at the centre."""
    A, b = np.array([[0.3, -2, 0], [2, 0.3, 0], [0.5, 0, -0.6]]), np.array([0.1, 0, 1.5])
    return AnalyticFlow("linear", lambda x: x @ A.T + b, lambda m, C: m @ A.T + b)


def taylor_green(k: float) -> AnalyticFlow:
    """V = (sin kx cos ky, -cos kx sin ky, 0): two plane waves, each damped by exp(-(k sigma)^2 / 2) along itself."""

    def velocity(x):
        s, c = np.sin(k * x), np.cos(k * x)
        return np.stack([s[:, 0] * c[:, 1], -c[:, 0] * s[:, 1], 0 * c[:, 0]], 1)

    def mean(m, C):
        a, b = (_damped(m, C, k * np.array([1.0, sign, 0]), np.sin) for sign in (1, -1))
        return np.stack([(a + b) / 2, (b - a) / 2, 0 * a], 1)

    return AnalyticFlow("Taylor-Green", velocity, mean)


def abc(k: float) -> AnalyticFlow:
    """Arnold-Beltrami-Childress with A = B = C = 1: six plane waves along the axes."""

    def velocity(x):
        s, c = np.sin(k * x), np.cos(k * x)
        return np.stack([s[:, 2] + c[:, 1], s[:, 0] + c[:, 2], s[:, 1] + c[:, 0]], 1)

    def mean(m, C):
        s, c = (np.stack([_damped(m, C, k * e, f) for e in np.eye(3)], 1) for f in (np.sin, np.cos))
        return np.stack([s[:, 2] + c[:, 1], s[:, 0] + c[:, 2], s[:, 1] + c[:, 0]], 1)

    return AnalyticFlow("ABC", velocity, mean)


def gaussian_vortex(width: float) -> AnalyticFlow:
    """V = (w x X + u) exp(-|X|^2 / (2 width^2)): two Gaussians multiply to a Gaussian, so the mean is closed too."""
    spin = np.array([[0, -3.0, 1], [3, 0, 0.5], [-1, -0.5, 0]])
    u = np.array([0, 0, 0.4])

    def velocity(x):
        return (x @ spin.T + u) * np.exp(-0.5 * np.sum(x**2, 1) / width**2)[:, None]

    def mean(m, C):
        M = np.eye(3) + C / width**2
        centre = np.linalg.solve(M, m[:, :, None])[:, :, 0]
        factor = np.exp(-0.5 * np.sum(m * centre, 1) / width**2) / np.sqrt(np.linalg.det(M))
        return factor[:, None] * (centre @ spin.T + u)

    return AnalyticFlow("Gaussian vortex", velocity, mean)


def _damped(m, C, wave, function):
    return np.exp(-0.5 * np.einsum("i,nij,j->n", wave, C, wave)) * function(m @ wave)


if __name__ == "__main__":
    main()
