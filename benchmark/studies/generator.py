"""`gof study generate`: what accuracy costs in the generator, as tables and plots over seconds.

Resolution: velocity error against the finest bake. Samples: picture error against many samples. Storage: error, size and
access time of the velocity store by precision and chunk. Work in progress is kept; the same command resumes.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.evaluate import line_chart
from gof.fields import VelocitySequence
from gof.io.files import atomic_path, read_json, write_json
from gof_benchmark.commands.generate import claim, load_scene
from gof_benchmark.generator.blender_process import Renderer, run_stage
from gof_blender.pure.layout import Layout
from gof_blender.pure.presets import PRESETS
from gof_blender.pure.spec import SceneSpec


@dataclass
class StudyConfig:
    """Accuracy against time of simulation resolution, render samples, and storage of the velocity."""

    out: Path = Path("out/study_generate")
    """Folder for tables, plots and the runs behind them."""
    scene: str = "demo"
    """Built-in scene or spec file."""
    resolutions: tuple[int, ...] = (24, 32, 40, 64, 96)
    """Cells along the longest side; the last one is the truth."""
    samples: tuple[int, ...] = (1, 2, 4, 6, 8, 16, 32, 256)
    """Paths per pixel; the last one is the reference."""
    frames: int = 12
    """Frames compared."""
    warm_up_s: float = 0.6
    """Simulated before the first of them, seconds."""
    json: Path | None = None
    """Also write all figures to this file."""


def main(argv: list[str]) -> int:
    """`gof study generate`; see --help."""
    config = tyro.cli(StudyConfig, prog="gof study generate", args=argv)
    spec = load_scene(config.scene)
    warm_up = round(config.warm_up_s * spec.clip.fps)
    spec = replace(spec, clip=replace(spec.clip, frames=config.frames, warm_up_frames=warm_up))
    figures = {
        "resolution": study_resolution(spec, config),
        "samples": study_samples(spec, config),
        "storage": study_storage(config),
    }
    write_json(config.out / "study.json", figures)
    if config.json:
        write_json(config.json, figures)
    _report(figures, config.out)
    print((config.out / "study.md").read_text())
    return 0


def study_resolution(spec: SceneSpec, config: StudyConfig) -> list[dict]:
    """Error of each bake's velocity against the finest one, where that one moves, relative to its rms.

    `error` compares instants, which a turbulent flow forgets; `error_mean` compares the means over the clip.
    """
    rows, runs = [], {}
    for resolution in config.resolutions:
        layout = _run(
            replace(spec, domain=replace(spec.domain, resolution=resolution)), config.out / "runs" / f"r{resolution}"
        )
        cost = read_json(layout.hidden / "study-cost.json")
        runs[resolution] = VelocitySequence.open(layout.velocity)
        rows.append({"resolution": resolution, "steps": spec.last_frame, **cost})
    finest = runs[config.resolutions[-1]]
    points = finest.frame(0).cell_centers().reshape(-1, 3)
    truth = np.stack([finest.frame(k).velocity.reshape(-1, 3).astype(np.float64) for k in range(len(finest))])
    moving = np.linalg.norm(truth, axis=-1).mean(0) > 0.05 * np.linalg.norm(truth, axis=-1).max()
    points, truth = points[moving], truth[:, moving]
    scale, scale_mean = np.sqrt((truth**2).sum(-1).mean()), np.sqrt((truth.mean(0) ** 2).sum(-1).mean())
    for row in rows:
        field = np.stack([runs[row["resolution"]].frame(k).sample(points) for k in range(len(finest))])
        row["error"] = float(np.sqrt(((field - truth) ** 2).sum(-1).mean()) / scale)
        row["error_mean"] = float(np.sqrt(((field.mean(0) - truth.mean(0)) ** 2).sum(-1).mean()) / scale_mean)
        row["speed_ratio"] = float(np.sqrt((field**2).sum(-1).mean()) / scale)
    return rows


def study_samples(spec: SceneSpec, config: StudyConfig) -> list[dict]:
    """Error of the displayed picture against the reference, inside the flame, in 8-bit steps, with and without denoiser."""
    rows = []
    base = Layout((config.out / "runs" / f"r{config.resolutions[-2]}").resolve())
    spec = replace(spec, domain=replace(spec.domain, resolution=config.resolutions[-2]))
    frame, camera = config.frames // 2, spec.cameras.count // 2
    pictures = {}
    # The reference is not denoised: it would be compared with its own bias.
    settings = [(config.samples[-1], False)] + [(n, denoise) for denoise in (True, False) for n in config.samples[:-1]]
    for n, denoise in settings:
        root = (config.out / "runs" / f"s{n}{'d' if denoise else ''}").resolve()
        layout = Layout(root)
        result = layout.hidden / "study-cost.json"
        if not result.exists():
            shutil.rmtree(root, ignore_errors=True)
            claim(layout, replace(spec, render=replace(spec.render, samples=n, denoise=denoise)))
            _borrow_bake(base, layout)
            run_stage("bake", root)  # finds the bake finished
            Renderer.render(root, frame + 1, camera)  # loads the scene
            cost = Renderer.render(root, frame, camera)
            Renderer.close(root)
            write_json(result, cost)
        pictures[n, denoise] = _read(layout.frame(f"cam_{camera}", frame).rgb)
        if (n, denoise) == settings[0]:
            mask = _read(layout.frame(f"cam_{camera}", frame).mask)[..., 0] > 0
        error = np.abs(pictures[n, denoise] - pictures[settings[0]])[mask]
        rows.append({"samples": n, "denoise": denoise, **read_json(result), "error": float(error.mean())})
    return rows


def study_storage(config: StudyConfig) -> list[dict]:
    """Write one exact field of the finest bake in several ways; read all of it, and the box around the flame's core."""
    import zarr

    source = config.out / "runs" / f"r{config.resolutions[-1]}"
    exact = VelocitySequence.open(Layout(source).velocity).frame(0).velocity.astype(np.float32)
    rng = np.random.default_rng(0)
    exact = (exact * (1 + 1e-4 * rng.standard_normal(exact.shape))).astype(np.float32)  # digits that half cannot hold
    core = tuple(slice(n // 3, 2 * n // 3) for n in exact.shape[:3])
    rows = []
    for dtype in ("float16", "float32"):
        for chunk in (16, 32, 64, 128):
            with tempfile.TemporaryDirectory() as folder:
                store = zarr.create_array(
                    f"{folder}/v",
                    shape=exact.shape,
                    chunks=(chunk,) * 3 + (3,),
                    dtype=dtype,
                    compressors=zarr.codecs.GzipCodec(level=5),
                    fill_value=0,
                )
                start = time.perf_counter()
                store[:] = exact.astype(dtype)
                written = time.perf_counter()
                back = store[:]
                read = time.perf_counter()
                store[core]
                done = time.perf_counter()
                size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
            error = float(np.abs(back.astype(np.float64) - exact).max())
            rows.append(
                {
                    "dtype": dtype,
                    "chunk": chunk,
                    "mb": size / 2**20,
                    "write_s": written - start,
                    "read_s": read - written,
                    "read_core_s": done - read,
                    "max_error_m_s": error,
                }
            )
    return rows


def _run(spec: SceneSpec, root: Path) -> Layout:
    """A bake with exported velocity, made once."""
    layout = Layout(root.resolve())
    claim(layout, spec)
    cost = layout.hidden / "study-cost.json"
    if not cost.exists():
        shutil.rmtree(layout.bake, ignore_errors=True)
        layout.bake_marker.unlink(missing_ok=True)
        figures = run_stage("bake", layout.root)
        run_stage("ground-truth", layout.root)
        write_json(cost, figures)
    return layout


def _borrow_bake(source: Layout, target: Layout) -> None:
    target.hidden.mkdir(parents=True)
    target.bake.symlink_to(source.bake)
    shutil.copy(source.bake_marker, target.bake_marker)
    shutil.copy(source.blend, target.blend)


def _read(path: Path) -> np.ndarray:
    import cv2

    return cv2.imread(str(path), cv2.IMREAD_COLOR).astype(np.float64)


def _report(figures: dict, out: Path) -> None:
    finest = max(r["resolution"] for r in figures["resolution"])
    coarser = [r for r in figures["resolution"] if r["resolution"] < finest]  # the reference has no error to draw
    charts = {
        "resolution": (
            "Velocity error against time",
            "CPU seconds of the bake",
            "relative error",
            {
                "instants": [(r["cpu_s"], r["error"], _label("domain", "resolution", r)) for r in coarser],
                "mean over the clip": [(r["cpu_s"], r["error_mean"], str(r["resolution"])) for r in coarser],
            },
        ),
        "samples": (
            "Picture error against time",
            "CPU seconds per picture",
            "mean error in the flame, 8-bit steps",
            {
                name: [
                    (r["cpu_s"], r["error"], _label("render", "samples", r) if denoise else str(r["samples"]))
                    for r in figures["samples"]
                    if r["denoise"] == denoise
                ]
                for name, denoise in (("denoised", True), ("as traced", False))
            },
        ),
        "storage": (
            "Size of the velocity store against reading time",
            "seconds to read the core",
            "MB per frame",
            {
                dtype: [(r["read_core_s"], r["mb"], str(r["chunk"])) for r in figures["storage"] if r["dtype"] == dtype]
                for dtype in ("float16", "float32")
            },
        ),
    }
    parts = []
    for name, rows in figures.items():
        line_chart.write(out / f"{name}.svg", *charts[name])
        columns = list(rows[0])
        table = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
        table += [f"| {' | '.join(_text(row[c]) for c in columns)} |" for row in rows]
        parts.append("\n".join([f"## {name}", "", *table, "", f"![{name}]({name}.svg)"]))
    with atomic_path(out / "study.md") as path:
        path.write_text("\n\n".join(parts) + "\n")


def _label(section: str, field: str, row: dict) -> str:
    """The setting of a point, and the presets that use it."""
    return " ".join(
        [str(row[field]), *(name for name, values in PRESETS.items() if values[section].get(field) == row[field])]
    )


def _text(value) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
