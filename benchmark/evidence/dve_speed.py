"""Time and memory of a frame's DVE against the number of Gaussians and the size of the field, in one run.

    python -m gof_benchmark.evidence.dve_speed --json dve_speed.json

The fields are a closed-form swirling plume in a sparse chunked store (float16, written by the generator's own writer) in a
temporary folder. Every case is a process of its own, so its peak memory is its own. "gof" is the whole of `dve`: it reads the
store, chunk by chunk, evaluates 27 nodes per Gaussian and sums; "again" is a second score on the same frame, whose chunks are
kept; the compiler's start is left out. "scipy" is the straightforward version of the expected velocities alone: the whole field in
memory as float32, three calls of `map_coordinates(order=1)` on all nodes (in pieces that fit into memory).
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.fields import VelocitySequence
from gof.gaussians import TransientGaussians
from gof.io.files import write_json
from gof_blender.pure.io.velocity_store import VelocityWriter

SIZE_M = 2.0


@dataclass
class DveSpeedConfig:
    """Table of seconds and peak memory, N Gaussians by field size."""

    counts: tuple[int, ...] = (10_000, 100_000, 1_000_000, 10_000_000)
    """Numbers of Gaussians."""
    sizes: tuple[int, ...] = (64, 128, 256, 640)
    """Cells along each side of the field."""
    scipy_up_to: int = 1_000_000
    """Largest number of Gaussians for the scipy version, which is slow."""
    json: Path | None = None
    """File to write the figures to."""


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

    writer = VelocityWriter(path, (n, n, n), index_to_world, np.zeros(1), SIZE_M / n)
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


def with_scipy(sequence: VelocitySequence, position, scale, rotation) -> np.ndarray:
    from scipy.ndimage import map_coordinates

    from gof.evaluate.quadrature import product_rule
    from gof.rotations import rotation_matrices

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


def run_case(store: str, method: str, count: int, n: int) -> dict:
    from gof.evaluate import dve
    from gof.evaluate.quadrature import expected_velocity
    from gof.evaluate.sparse_grid import StoredField

    g, sequence = gaussians(count, n), VelocitySequence.open(store)
    shape = g.position.astype(np.float64), g.scale.astype(np.float64), g.rotation
    field, out = StoredField(sequence, 0.0), {}

    def timed(name: str, work):
        start, cpu = time.perf_counter(), time.process_time()
        result = work()
        out[name], out[f"{name}_cpu"] = time.perf_counter() - start, time.process_time() - cpu
        return result

    if method == "gof":
        dve(g[:5000], StoredField(sequence, 0.0), 0.0)  # starts the compiler
        timed("seconds", lambda: dve(g, field, 0.0))
        timed("again", lambda: dve(g, field, 0.0))
    else:
        mean = timed("seconds", lambda: with_scipy(sequence, *shape))
    out["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if method == "gof":
        mean = expected_velocity(field, *(a[:5000] for a in shape)).mean
    return out | {"mean": mean[:200].tolist()}


def main(argv: list[str] | None = None) -> int:
    config = tyro.cli(DveSpeedConfig, prog="python -m gof_benchmark.evidence.dve_speed", args=argv)
    rows = []
    with tempfile.TemporaryDirectory(prefix="dve_speed_") as folder:
        print(
            "| field | Gaussians | s | CPU s | again, s | peak MB | scipy, s | CPU s | MB | ratio | CPU ratio | differ, m/s |"
        )
        print("|---|" + "---:|" * 11)
        for n in config.sizes:
            store = Path(folder) / f"{n}.zarr"
            share = make_store(store, n)
            for count in config.counts:
                row = {"cells": n, "gaussians": count, "chunks_full": share}
                for method in ("gof", "scipy") if count <= config.scipy_up_to else ("gof",):
                    done = subprocess.run(
                        [
                            sys.executable,
                            "-m",
                            "gof_benchmark.evidence.dve_speed",
                            "--case",
                            str(store),
                            method,
                            str(count),
                            str(n),
                        ],
                        capture_output=True,
                        text=True,
                    )
                    if done.returncode:
                        raise SystemExit(done.stderr)
                    row[method] = json.loads(done.stdout.splitlines()[-1])
                means = [np.array(row[m].pop("mean")) for m in ("gof", "scipy") if m in row]
                gof, scipy = row["gof"], row.get("scipy")
                line = f"| {n}³ | {count:.0e} | {gof['seconds']:.2f} | {gof['seconds_cpu']:.2f} | {gof['again']:.2f} | {gof['peak_mb']:.0f} | "
                if scipy:
                    row["ratio"], row["ratio_cpu"] = (scipy[k] / gof[k] for k in ("seconds", "seconds_cpu"))
                    row["differ"] = float(np.abs(means[0] - means[1]).max())
                    line += f"{scipy['seconds']:.2f} | {scipy['seconds_cpu']:.2f} | {scipy['peak_mb']:.0f} | "
                    line += f"{row['ratio']:.1f} | {row['ratio_cpu']:.1f} | {row['differ']:.0e} |"
                else:
                    line += "- | - | - | - | - | - |"
                print(line, flush=True)
                rows.append(row)
    if config.json:
        write_json(config.json, {"schema": "gof-dve-speed", "version": 1, "rows": rows})
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--case"]:
        print(json.dumps(run_case(sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))))
    else:
        sys.exit(main())
