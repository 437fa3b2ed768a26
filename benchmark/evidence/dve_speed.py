"""Time and memory of a frame's DVE against the number of Gaussians and the size of the field, in one run.

    python -m gof_benchmark.evidence.dve_speed [--json dve_speed.json]

Takes about 20 min.

The fields are a closed-form swirling plume in a sparse chunked store (float16, written by the generator's own writer)
in a temporary folder. Every case is a process of its own, so its peak memory is its own. "gof" is the whole of `dve`:
it reads the store, chunk by chunk, evaluates 27 nodes per Gaussian and sums; "again" is a second score on the same
frame, whose chunks are kept; the compiler's start is left out. "scipy" is the straightforward version of the expected
velocities alone: the whole field in memory as float32, three calls of `map_coordinates(order=1)` on all nodes (in
pieces that fit into memory).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.core.costs import peak_memory_mb
from gof.core.fields import VelocitySequence
from gof.core.files import write_json
from gof.core.gaussians import TransientGaussians
from gof.core.grid_writer import GridWriter
from gof_benchmark.evidence import child

SIZE_M = 2.0
COMPARED = 200  # Gaussians whose expected velocities by both ways are compared


@dataclass(frozen=True)
class DveSpeed:
    """Table of seconds and peak memory, N Gaussians by field size."""

    counts: tuple[int, ...] = (10_000, 100_000, 1_000_000, 10_000_000)
    """Numbers of Gaussians."""
    sizes: tuple[int, ...] = (64, 128, 256, 640)
    """Cells along each side of the field."""
    scipy_up_to: int = 1_000_000
    """Largest number of Gaussians for the scipy version, which is slow."""
    json: Path | None = None
    """File to write the figures to."""


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(DveSpeed, prog="python -m gof_benchmark.evidence.dve_speed", args=argv)
    print(
        "| field | Gaussians | s | CPU s | again, s | peak MB | scipy, s | CPU s | MB | ratio | CPU ratio "
        "| differ, m/s |"
    )
    print("|---|" + "---:|" * 11)
    rows = []
    with tempfile.TemporaryDirectory(prefix="dve_speed_") as folder:
        for n in config.sizes:
            store = Path(folder) / f"{n}.zarr"
            share = make_store(store, n)
            for count in config.counts:
                row = {"cells": n, "gaussians": count, "chunks_full": share}
                row |= compare(store, count, n, with_scipy=count <= config.scipy_up_to)
                print(table_row(row), flush=True)
                rows.append(row)
    if config.json:
        write_json(config.json, {"schema": "gof-dve-speed", "version": 1, "rows": rows})


def compare(store: Path, count: int, n: int, with_scipy: bool) -> dict[str, Any]:
    """Return costs of "gof", and of "scipy" where it is named, their ratios and how far their results differ."""
    gof = child.call(run_gof, str(store), count, n)
    mean = np.array(gof.pop("mean"))
    if not with_scipy:
        return {"gof": gof}
    scipy = child.call(run_scipy, str(store), count, n)
    differ = float(np.abs(mean - np.array(scipy.pop("mean"))).max())
    ratio, ratio_cpu = (scipy[key] / gof[key] for key in ("seconds", "seconds_cpu"))
    return {"gof": gof, "scipy": scipy, "ratio": ratio, "ratio_cpu": ratio_cpu, "differ": differ}


def table_row(row: dict[str, Any]) -> str:
    gof, scipy = row["gof"], row.get("scipy")
    line = f"| {row['cells']}³ | {row['gaussians']:.0e} | {gof['seconds']:.2f} | {gof['seconds_cpu']:.2f} | "
    line += f"{gof['again']:.2f} | {gof['peak_mb']:.0f} | "
    if scipy is None:
        return line + "- | - | - | - | - | - |"
    line += f"{scipy['seconds']:.2f} | {scipy['seconds_cpu']:.2f} | {scipy['peak_mb']:.0f} | "
    return line + f"{row['ratio']:.1f} | {row['ratio_cpu']:.1f} | {row['differ']:.0e} |"


# ---------------------------------------------------------------- what is measured


def plume(points: np.ndarray) -> np.ndarray:
    """Swirling, rising, turbulent-looking flow (M, 3) m/s in a column of 0.3 m radius; exactly zero outside it."""
    x, y, z = points.T
    r2 = (x**2 + y**2) / 0.3**2
    shape = np.clip(1 - r2, 0, 1)[:, None]
    waves = sum(np.sin(k * points[:, [1, 2, 0]] + k) / k**0.33 for k in (7.0, 19.0, 47.0, 113.0))
    return shape * (np.stack([-3 * y, 3 * x, 1.5 + 0 * z], 1) + 0.4 * waves)


def make_store(path: Path, n: int) -> float:
    """Write the plume on n^3 cells as the generator does; returns the share of chunks that hold flow."""
    low = np.array([-SIZE_M / 2, -SIZE_M / 2, 0])
    index_to_world = np.diag([SIZE_M / n] * 3 + [1.0])
    index_to_world[:3, 3] = low
    full = []

    def block(box: tuple[slice, slice, slice]) -> np.ndarray:
        axes = [(np.arange(b.start, b.stop) + 0.5) * SIZE_M / n + o for b, o in zip(box, low, strict=True)]
        full.append(np.hypot(*(np.abs(a).min() for a in axes[:2])) < 0.3)
        if not full[-1]:
            return np.zeros((*map(len, axes), 3), np.float16)
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        return plume(points.reshape(-1, 3)).reshape(points.shape)

    writer = GridWriter(path, (n, n, n), index_to_world, np.zeros(1), SIZE_M / n)
    writer.write_frame(0, block)
    writer.finish()
    return float(np.mean(full))


def gaussians(count: int, n: int) -> TransientGaussians:
    """In the column, 0.2 to 2 cells wide, always on, with random velocities."""
    rng = np.random.default_rng(0)
    radius, angle = 0.28 * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    position = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.2, 1.8, count)], 1)
    return TransientGaussians(
        position=position,
        velocity=rng.normal(size=(count, 3)),
        t_mu=np.zeros(count),
        t_sigma=np.full(count, np.inf),
        scale=rng.uniform(0.2, 2, (count, 3)) * SIZE_M / n,
        rotation=rng.normal(size=(count, 4)),
        opacity=np.full(count, 0.5),
        color=np.zeros((count, 3)),
        dynamic=np.ones(count, bool),
    )


def means_with_scipy(
    sequence: VelocitySequence, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray
) -> np.ndarray:
    """Return expected velocities (N, 3) m/s."""
    from scipy.ndimage import map_coordinates

    from gof.core.rotations import rotation_matrices
    from gof.evaluate.quadrature import product_rule

    velocity = np.ascontiguousarray(np.moveaxis(sequence.frame(0).velocity.astype(np.float32), -1, 0))
    nodes, weights = product_rule(3)
    to_index = np.linalg.inv(sequence.index_to_world)
    out = np.empty_like(position)
    for start in range(0, len(position), 100_000):
        rows = slice(start, start + 100_000)
        axes = rotation_matrices(rotation[rows]) * scale[rows, None, :]
        points = position[rows, None, :] + np.einsum("nik,pk->npi", axes, nodes)
        index = (points.reshape(-1, 3) @ to_index[:3, :3].T + to_index[:3, 3] - 0.5).T
        for k in range(3):
            out[rows, k] = map_coordinates(velocity[k], index, order=1, mode="nearest").reshape(-1, 27) @ weights
    return out


# ---------------------------------------------------------------- one case, in a process of its own


def run_gof(store: str, count: int, n: int) -> dict[str, Any]:
    """Return seconds of a first and of another score of the frame, peak memory, and the first expected velocities."""
    from gof.evaluate import dve
    from gof.evaluate.expectation import expected_velocity
    from gof.evaluate.sparse_grid import StoredField

    g, sequence = gaussians(count, n), VelocitySequence.open(store)
    field = StoredField(sequence, 0.0)
    dve(g[:5000], StoredField(sequence, 0.0), 0.0)  # starts the compiler
    seconds, cpu = _timed(lambda: dve(g, field, 0.0))
    again, again_cpu = _timed(lambda: dve(g, field, 0.0))
    costs = {
        "seconds": seconds,
        "seconds_cpu": cpu,
        "again": again,
        "again_cpu": again_cpu,
        "peak_mb": peak_memory_mb(),
    }
    few = g[:COMPARED]
    mean = expected_velocity(field, few.position.astype(np.float64), few.scale.astype(np.float64), few.rotation).mean
    return costs | {"mean": mean.tolist()}


def run_scipy(store: str, count: int, n: int) -> dict[str, Any]:
    """Return the same figures of the straightforward version."""
    g, sequence = gaussians(count, n), VelocitySequence.open(store)
    means = []
    shape = (g.position.astype(np.float64), g.scale.astype(np.float64), g.rotation)
    seconds, cpu = _timed(lambda: means.append(means_with_scipy(sequence, *shape)))
    return {"seconds": seconds, "seconds_cpu": cpu, "peak_mb": peak_memory_mb(), "mean": means[0][:COMPARED].tolist()}


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    """Return seconds on the clock and of the CPU."""
    start, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - start, time.process_time() - cpu


if __name__ == "__main__":
    main()
