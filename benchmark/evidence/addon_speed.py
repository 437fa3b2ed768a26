"""Costs of the add-on's cloud: import, playback, memory; against a sequence baked per frame of the same cloud.

    python -m gof_benchmark.evidence.addon_speed

Takes about 3 min.

Every case runs in a Blender process of its own and is measured there: seconds on the clock, and seconds of CPU
time over all threads, which the clock cannot exceed on a machine without other work; memory held, which is the growth
of the resident size once the C library has returned what is free; and its peak. Goals are judged by CPU time.
Playback is `scene.frame_set`, which evaluates the modifier, without drawing.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.core.files import write_json
from gof_benchmark.evidence import child

FRAMES = 36  # of the baked sequence, and of the playback
FPS = 100
BYTES_EACH = 77  # of the arrays of a result: 18 float32 and a bool, and its colour
LEAST_ALPHA = 1 / 255


@dataclass(frozen=True)
class AddonSpeed:
    """Seconds and memory of the add-on's cloud of 1e5 and 1e6 Gaussians, and whether they meet the goals."""

    json: Path | None = None
    """Also write the figures to this file."""


@dataclass(frozen=True)
class ShownResult:
    """A result of so many Gaussians, shown by the add-on (kind "cloud", in a mode) or as baked frames ("baked")."""

    count: int
    suffix: str
    kind: str = "cloud"
    mode: str = "points"

    @property
    def shown_as(self) -> str:
        return self.mode if self.kind == "cloud" else f"{FRAMES} baked frames"


CASES = [
    ShownResult(100_000, ".npz"),
    ShownResult(100_000, ".npz", mode="ellipsoids"),
    ShownResult(100_000, ".npz", mode="arrows"),
    ShownResult(100_000, ".npz", mode="streaks"),
    ShownResult(100_000, ".npz", kind="baked"),
    ShownResult(1_000_000, ".npz"),
    ShownResult(1_000_000, ".ply"),
    ShownResult(1_000_000, ".npz", kind="baked"),
]


@dataclass(frozen=True)
class Cost:
    """The cost of a case; seconds of a frame are medians over the playback, memory is in MB (2^20 bytes)."""

    import_s: float
    import_cpu_s: float
    frame_s: float
    frame_cpu_s: float
    peak_mb: float
    mb: float


def main(argv: list[str] | None = None) -> None:
    """Print the table and the goals."""
    config = tyro.cli(AddonSpeed, prog="python -m gof_benchmark.evidence.addon_speed", args=argv)
    print(
        "| Gaussians | file | shown as | import s (CPU s) | frame ms (CPU ms) | memory held MB | held / arrays | "
        "peak MB |"
    )
    print("|---" * 8 + "|")
    costs: dict[ShownResult, Cost] = {}
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            path = Path(folder) / f"{case.count}{case.suffix}"
            if not path.exists():
                write_result(path, case.count)
            costs[case] = Cost(**child.call(measure, case.kind, str(path), case.mode))
            print(row(case, costs[case]), flush=True)
    print_goals(costs)
    if config.json:
        write_json(config.json, [asdict(case) | asdict(cost) for case, cost in costs.items()])


def row(case: ShownResult, cost: Cost) -> str:
    imported = f"{cost.import_s:.2f} ({cost.import_cpu_s:.2f})"
    frame = f"{1000 * cost.frame_s:.1f} ({1000 * cost.frame_cpu_s:.1f})"
    memory = f"{cost.mb:.0f} | {share_of_arrays(case, cost):.2f} | {cost.peak_mb:.0f}"
    return f"| {case.count:,} | {case.suffix} | {case.shown_as} | {imported} | {frame} | {memory} |"


def share_of_arrays(case: ShownResult, cost: Cost) -> float:
    """Memory held, over the size of the result's arrays."""
    return cost.mb / (case.count * BYTES_EACH / 1e6)


def print_goals(costs: dict[ShownResult, Cost]) -> None:
    large = [ShownResult(1_000_000, suffix) for suffix in (".npz", ".ply")]
    import_s = max(costs[case].import_cpu_s for case in large)
    share = max(share_of_arrays(case, costs[case]) for case in large)
    goals = [
        ("import of 1e6, CPU s", import_s, 5.0, import_s <= 5.0),
        ("memory held / arrays, 1e6 points", share, 1.5, share <= 1.5),
    ]
    for mode in ("points", "ellipsoids", "arrows", "streaks"):
        case = ShownResult(100_000, ".npz", mode=mode)
        rate, share = 1 / costs[case].frame_cpu_s, share_of_arrays(case, costs[case])
        goals.append((f"playback of 1e5 {mode}, frames per CPU s", rate, 10.0, rate >= 10.0))
        goals.append((f"memory held / arrays, 1e5 {mode}", share, 2.0, share <= 2.0))
    for name, value, goal, met in goals:
        print(f"{name}: {value:.2f}, goal {goal:g}: {'met' if met else 'MISSED'}")


def write_result(path: Path, count: int) -> None:
    """Write a flame-like cloud: Gaussians of 2 to 10 mm in a column of 1 m, alive for a tenth of the clip each."""
    from gof.core.gaussians import TransientGaussians

    rng = np.random.default_rng(0)
    position = rng.normal(0, 0.1, (count, 3)) * [1, 1, 0] + rng.uniform(0, 1, (count, 1)) * [0, 0, 1]
    TransientGaussians(
        position=position,
        velocity=rng.normal((0, 0, 2), 0.3, (count, 3)),
        t_mu=rng.uniform(0, 0.36, count),
        t_sigma=rng.uniform(0.01, 0.05, count),
        scale=rng.uniform(0.002, 0.01, (count, 3)),
        rotation=rng.normal(size=(count, 4)),
        opacity=rng.uniform(0.05, 0.9, count),
        color=rng.uniform(0, 1, (count, 3)),
        dynamic=np.ones(count, bool),
    ).save(path)


# ---------------------------------------------------------------- in Blender


def measure(kind: str, result: str, mode: str) -> dict[str, float]:
    """Return one case, as the fields of `Cost`."""
    cost = measure_cloud(Path(result), mode) if kind == "cloud" else measure_baked(Path(result))
    return asdict(cost)


def measure_cloud(result: Path, mode: str) -> Cost:
    """Import by the operator, then play."""
    import bpy

    import gof_blender
    from gof_blender.pure.io import cloud as clouds
    from gof_blender.scene import point_cloud

    bpy.ops.wm.read_factory_settings(use_empty=True)
    gof_blender.register()
    scene = bpy.context.scene
    scene.render.fps = FPS
    few = clouds.load(result, step=1000)
    point_cloud.add_point_cloud(few, 1, mode)  # what a first import also loads is not counted
    scene.frame_set(5)
    bpy.data.objects.remove(bpy.data.objects[0])
    before = resident_mb()
    return _imported_and_played(before, scene, lambda: bpy.ops.gof.import_result(filepath=str(result), mode=mode))


def measure_baked(result: Path) -> Cost:
    """Return the same points as one mesh per frame, swapped at every frame."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    before = resident_mb()
    baked: list[Any] = []

    def bake() -> None:
        meshes = bake_meshes(result)
        baked.extend([point_object(meshes[0]), meshes])

    def swap(number: int) -> None:
        thing, meshes = baked
        thing.data = meshes[number]

    return _imported_and_played(before, bpy.context.scene, bake, swap)


def _imported_and_played(
    before: float, scene: Any, make: Callable[[], Any], before_frame: Callable[[int], Any] = lambda number: None
) -> Cost:
    """`make` timed, then the playback; memory counts from `before`, MB."""
    started, cpu = time.perf_counter(), time.process_time()
    make()
    import_s, import_cpu_s = time.perf_counter() - started, time.process_time() - cpu
    frame_s, frame_cpu_s = play(scene, before_frame)
    peak_mb = resident_mb("VmHWM") - before
    return Cost(import_s, import_cpu_s, frame_s, frame_cpu_s, peak_mb, resident_mb() - before)


def play(scene: Any, before_frame: Callable[[int], Any]) -> tuple[float, float]:
    """Return median seconds of one frame, on the clock and of the CPU."""
    seconds = []
    for number in range(FRAMES):
        started = np.array([time.perf_counter(), time.process_time()])
        before_frame(number)
        scene.frame_set(1 + number)
        seconds.append(np.array([time.perf_counter(), time.process_time()]) - started)
    clock, cpu = np.median(seconds[1:], axis=0)
    return float(clock), float(cpu)


def resident_mb(field: str = "VmRSS") -> float:
    if field == "VmRSS":
        ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/status").read_text().split(f"{field}:")[1].split()[0]) / 1024


def bake_meshes(result: Path) -> list[Any]:
    """Return a mesh of the visible points for every frame."""
    import bpy

    from gof_blender.pure.io import cloud as clouds
    from gof_blender.scene import display

    cloud = clouds.load(result)
    light = display.emission(cloud, display.ToneCurve.measure(bpy.context.scene))
    radius = np.cbrt(cloud.scale.prod(1))
    meshes = []
    for number in range(FRAMES):
        age = number / FPS - cloud.t_mu
        alpha = cloud.opacity * np.exp(-0.5 * (age / cloud.t_sigma) ** 2)
        seen = np.flatnonzero(alpha >= LEAST_ALPHA)
        mesh = bpy.data.meshes.new(f"frame {number}")
        mesh.vertices.add(len(seen))
        mesh.vertices.foreach_set("co", (cloud.position[seen] + age[seen, None] * cloud.velocity[seen]).ravel())
        for name, kind, field, values in (
            ("gs_alpha", "FLOAT", "value", alpha),
            ("radius", "FLOAT", "value", radius),
            ("gs_color", "FLOAT_VECTOR", "vector", light),
        ):
            mesh.attributes.new(name, kind, "POINT").data.foreach_set(field, values[seen].ravel())
        meshes.append(mesh)
    return meshes


def point_object(mesh: Any) -> Any:
    """Return an object that shows a mesh's vertices as points."""
    import bpy

    thing = bpy.data.objects.new("baked", mesh)
    bpy.context.scene.collection.objects.link(thing)
    tree = bpy.data.node_groups.new("points", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeMeshToPoints", "NodeGroupOutput")
    given, points, out = (tree.nodes.new(kind) for kind in kinds)
    tree.links.new(given.outputs[0], points.inputs["Mesh"])
    tree.links.new(points.outputs[0], out.inputs[0])
    thing.modifiers.new("points", "NODES").node_group = tree
    return thing


if __name__ == "__main__":
    main()
