"""`gof study generate`: what accuracy costs in the generator, as tables and plots over seconds.

Resolution: velocity error against the finest bake. Samples: picture error against many samples. Storage: error, size
and access time of the velocity store by precision and chunk. Work in progress is kept; the same command resumes.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.core.fields import VelocitySequence
from gof.core.files import atomic_path, read_json, write_json
from gof.core.zarr_array import ZarrArray
from gof.look.charts import line_chart
from gof_benchmark.generator.blender_process import ProcessCost, Renderer, run_stage
from gof_benchmark.scenes import claim, load_scene
from gof_blender.pure.layout import Layout
from gof_blender.pure.presets import PRESETS
from gof_blender.pure.spec import SceneSpec

WARM_UP_S = 0.6  # simulated before the first frame


@dataclass
class GeneratorStudy:
    """Accuracy against time of simulation resolution, render samples, and storage of the velocity.

    Examples:
      gof study generate --out out/study_generate
    """

    out: Path = Path("out/study_generate")
    """Folder for tables, plots and the runs behind them; finished ones are kept."""
    scene: str = "demo"
    """Built-in scene or spec file."""
    resolutions: tuple[int, ...] = (24, 32, 40, 64, 96)
    """Cells along the longest side; the last one is the truth."""
    samples: tuple[int, ...] = (1, 2, 4, 6, 8, 16, 32, 256)
    """Paths per pixel; the last one is the reference."""
    frames: int = 12
    """Frames compared."""


@dataclass(frozen=True)
class ResolutionRow:
    """A bake, and its velocity against the finest one's, where that one moves, relative to its rms.

    `error` compares instants, which a turbulent flow forgets; `error_mean` compares the means over the clip.
    """

    resolution: int
    steps: int
    seconds: float
    cpu_s: float
    peak_mb: float
    error: float
    error_mean: float
    speed_ratio: float


@dataclass(frozen=True)
class SamplesRow:
    """A picture; `error` is the mean absolute difference to the reference inside the flame, in 8-bit steps."""

    samples: int
    denoise: bool
    seconds: float
    cpu_s: float
    peak_mb: float
    error: float


@dataclass(frozen=True)
class StorageRow:
    """One way to store a velocity field; `read_core_s` reads the box around the flame's core alone."""

    dtype: str
    chunk: int
    mb: float
    write_s: float
    read_s: float
    read_core_s: float
    max_error_m_s: float


@dataclass(frozen=True)
class Figures:
    resolution: list[ResolutionRow]
    samples: list[SamplesRow]
    storage: list[StorageRow]


def main(argv: list[str]) -> int:
    """`gof study generate`; see --help."""
    config = read_options(GeneratorStudy, "study generate", argv)
    spec = load_scene(config.scene)
    warm_up = round(WARM_UP_S * spec.clip.fps)
    spec = replace(spec, clip=replace(spec.clip, frames=config.frames, warm_up_frames=warm_up))
    figures = Figures(study_resolution(spec, config), study_samples(spec, config), study_storage(config))
    write_json(config.out / "study.json", asdict(figures))
    write_figures(asdict(figures))
    _report(figures, config.out)
    print((config.out / "study.md").read_text(encoding="utf-8"))
    return 0


# ---------------------------------------------------------------- resolution


def study_resolution(spec: SceneSpec, config: GeneratorStudy) -> list[ResolutionRow]:
    """Bake at every resolution and compare with the finest."""
    bakes = [_bake(_at(spec, resolution), _bake_folder(config, resolution)) for resolution in config.resolutions]
    sequences = [VelocitySequence.open(layout.velocity) for layout, _ in bakes]
    finest = sequences[-1]
    points = finest.frame(0).cell_centers().reshape(-1, 3)
    truth = np.stack([finest.frame(k).velocity.reshape(-1, 3).astype(np.float64) for k in range(len(finest))])
    speed = np.linalg.norm(truth, axis=-1)
    moving = speed.mean(0) > 0.05 * speed.max()
    points, truth = points[moving], truth[:, moving]
    rows = []
    for resolution, sequence, (_, cost) in zip(config.resolutions, sequences, bakes, strict=True):
        velocity = np.stack([sequence.frame(k).sample(points) for k in range(len(finest))])
        row = ResolutionRow(
            resolution,
            spec.timeline.last_frame,
            **asdict(cost),
            error=_rms(velocity - truth) / _rms(truth),
            error_mean=_rms(velocity.mean(0) - truth.mean(0)) / _rms(truth.mean(0)),
            speed_ratio=_rms(velocity) / _rms(truth),
        )
        rows.append(row)
    return rows


def _rms(vectors: np.ndarray) -> float:
    """Return root mean square length of vectors (..., 3)."""
    return float(np.sqrt((vectors**2).sum(-1).mean()))


def _at(spec: SceneSpec, resolution: int) -> SceneSpec:
    return replace(spec, domain=replace(spec.domain, resolution=resolution))


def _bake_folder(config: GeneratorStudy, resolution: int) -> Path:
    return config.out / "runs" / f"r{resolution}"


def _bake(spec: SceneSpec, root: Path) -> tuple[Layout, ProcessCost]:
    """Return a bake with exported velocity, made once, and what the bake cost."""
    layout = Layout(root.resolve())
    claim(layout, spec)
    if not _cost_file(layout).exists():
        shutil.rmtree(layout.bake, ignore_errors=True)
        layout.bake_marker.unlink(missing_ok=True)
        cost = run_stage("bake", layout.root)
        run_stage("ground-truth", layout.root)
        write_json(_cost_file(layout), asdict(cost))
    return layout, _known_cost(layout)


def _cost_file(layout: Layout) -> Path:
    return layout.hidden / "study-cost.json"


def _known_cost(layout: Layout) -> ProcessCost:
    return ProcessCost(**read_json(_cost_file(layout)))


# ---------------------------------------------------------------- samples


def study_samples(spec: SceneSpec, config: GeneratorStudy) -> list[SamplesRow]:
    """Return one picture with every number of samples, with and without denoiser, of the second finest bake.

    The reference is not denoised: it would be compared with its own bias.
    """
    resolution = config.resolutions[-2]
    baked = Layout(_bake_folder(config, resolution).resolve())
    spec = _at(spec, resolution)
    frame, camera = config.frames // 2, spec.cameras.count // 2
    *fewer, most = config.samples
    rows = []
    for n, denoise in [(most, False)] + [(n, denoise) for denoise in (True, False) for n in fewer]:
        layout = Layout((config.out / "runs" / f"s{n}{'d' if denoise else ''}").resolve())
        with_samples = replace(spec, render=replace(spec.render, samples=n, denoise=denoise))
        if _cost_file(layout).exists():
            claim(layout, with_samples)  # or it says that the picture is of another scene
        else:
            write_json(_cost_file(layout), asdict(_picture(with_samples, baked, layout, frame, camera)))
        files = layout.frame(f"cam_{camera}", frame)
        picture = _read(files.rgb)
        if not rows:
            reference = picture
            flame = _read(files.mask)[..., 0] > 0
        error = float(np.abs(picture - reference)[flame].mean())
        rows.append(SamplesRow(n, denoise, **asdict(_known_cost(layout)), error=error))
    return rows


def _picture(spec: SceneSpec, baked: Layout, layout: Layout, frame: int, camera: int) -> ProcessCost:
    """Render one picture of a bake that lies in another folder; what it cost without loading the scene."""
    shutil.rmtree(layout.root, ignore_errors=True)
    claim(layout, spec)
    _borrow_bake(baked, layout)
    run_stage("bake", layout.root)  # finds the bake finished
    Renderer.render(layout.root, frame + 1, camera)  # loads the scene
    cost = Renderer.render(layout.root, frame, camera)
    Renderer.close(layout.root)
    return cost


def _borrow_bake(source: Layout, target: Layout) -> None:
    target.hidden.mkdir(parents=True)
    target.bake.symlink_to(source.bake)
    shutil.copy(source.bake_marker, target.bake_marker)
    shutil.copy(source.blend, target.blend)


def _read(path: Path) -> np.ndarray:
    import cv2

    return cv2.imread(str(path), cv2.IMREAD_COLOR).astype(np.float64)


# ---------------------------------------------------------------- storage


def study_storage(config: GeneratorStudy) -> list[StorageRow]:
    """Write one field of the finest bake in several ways; read all of it, and the box around the flame's core."""
    baked = Layout(_bake_folder(config, config.resolutions[-1]))
    exact = VelocitySequence.open(baked.velocity).frame(0).velocity.astype(np.float32)
    rng = np.random.default_rng(0)
    exact = (exact * (1 + 1e-4 * rng.standard_normal(exact.shape))).astype(np.float32)  # digits that half cannot hold
    return [_stored(exact, dtype, chunk) for dtype in ("float16", "float32") for chunk in (16, 32, 64, 128)]


def _stored(exact: np.ndarray, dtype: str, chunk: int) -> StorageRow:
    core = tuple(slice(n // 3, 2 * n // 3) for n in exact.shape[:3])
    with tempfile.TemporaryDirectory() as folder:
        store = ZarrArray.create(f"{folder}/v", (1, *exact.shape), (1, chunk, chunk, chunk, 3), dtype, {})
        start = time.perf_counter()
        store.write(0, exact)
        written = time.perf_counter()
        back = store[(0,)]
        read = time.perf_counter()
        store[(0, *core)]
        done = time.perf_counter()
        size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    return StorageRow(
        dtype,
        chunk,
        mb=size / 2**20,
        write_s=written - start,
        read_s=read - written,
        read_core_s=done - read,
        max_error_m_s=float(np.abs(back.astype(np.float64) - exact).max()),
    )


# ---------------------------------------------------------------- tables and plots


def _report(figures: Figures, out: Path) -> None:
    """study.md with a table and a chart of each part."""
    _draw_charts(figures, out)
    parts = []
    for part in fields(figures):
        rows = [asdict(row) for row in getattr(figures, part.name)]
        columns = list(rows[0])
        table = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
        table += [f"| {' | '.join(_text(row[column]) for column in columns)} |" for row in rows]
        parts.append("\n".join([f"## {part.name}", "", *table, "", f"![{part.name}]({part.name}.svg)"]))
    with atomic_path(out / "study.md") as path:
        path.write_text("\n\n".join(parts) + "\n")


def _draw_charts(figures: Figures, out: Path) -> None:
    finest = max(row.resolution for row in figures.resolution)
    coarser = [row for row in figures.resolution if row.resolution < finest]  # the reference has no error to draw
    line_chart(
        "Velocity error against time",
        "CPU seconds of the bake",
        "relative error",
        {
            "instants": [(r.cpu_s, r.error, _label("domain", "resolution", r.resolution)) for r in coarser],
            "mean over the clip": [(r.cpu_s, r.error_mean, str(r.resolution)) for r in coarser],
        },
    ).write(out / "resolution.svg")
    denoised = [r for r in figures.samples if r.denoise]
    traced = [r for r in figures.samples if not r.denoise]
    line_chart(
        "Picture error against time",
        "CPU seconds per picture",
        "mean error in the flame, 8-bit steps",
        {
            "denoised": [(r.cpu_s, r.error, _label("render", "samples", r.samples)) for r in denoised],
            "as traced": [(r.cpu_s, r.error, str(r.samples)) for r in traced],
        },
    ).write(out / "samples.svg")
    half, single = ([r for r in figures.storage if r.dtype == dtype] for dtype in ("float16", "float32"))
    line_chart(
        "Size of the velocity store against reading time",
        "seconds to read the core",
        "MB per frame",
        {
            "float16": [(r.read_core_s, r.mb, str(r.chunk)) for r in half],
            "float32": [(r.read_core_s, r.mb, str(r.chunk)) for r in single],
        },
    ).write(out / "storage.svg")


def _label(section: str, field: str, value: int) -> str:
    """Return the setting of a point, and the presets that use it."""
    users = [name for name, values in PRESETS.items() if values[section].get(field) == value]
    return " ".join([str(value), *users])


def _text(value: float | int | bool | str) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
