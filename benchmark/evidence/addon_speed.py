"""What the add-on's cloud costs: import, playback, memory; against a sequence baked per frame of the same cloud.

    python -m gof_benchmark.evidence.addon_speed

Every case runs in a Blender process of its own and is measured there: seconds on the clock, and seconds of processor time
over all threads, which the clock cannot exceed on a machine without other work; memory held, which is the growth of the
resident size once the C library has returned what is free; and its peak. Goals are judged by processor time. Playback is `scene.frame_set`, which evaluates the modifier, without drawing.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

FRAMES = 36  # of the baked sequence, and of the playback
BYTES_EACH = 77  # of the arrays of a result: 18 float32 and a bool, and its colour


def write_result(path: Path, count: int) -> None:
    """A flame-like cloud: Gaussians of 2 to 10 mm in a column of 1 m, alive for a tenth of the clip each."""
    from gof.gaussians import TransientGaussians

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


def resident_mb(field: str = "VmRSS") -> float:
    if field == "VmRSS":
        ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/status").read_text().split(f"{field}:")[1].split()[0]) / 1024


def play(scene, before_frame=lambda number: None) -> dict:
    """Median seconds of one frame, on the clock and of the processor."""
    seconds = []
    for number in range(FRAMES):
        started = np.array([time.perf_counter(), time.process_time()])
        before_frame(number)
        scene.frame_set(1 + number)
        seconds.append(np.array([time.perf_counter(), time.process_time()]) - started)
    clock, cpu = np.median(seconds[1:], axis=0)
    return {"frame_s": float(clock), "frame_cpu_s": float(cpu)}


def measure_cloud(result: Path, mode: str) -> dict:
    """Import by the operator, then play. Runs in Blender."""
    import bpy

    import gof_blender
    from gof_blender.pure.io import gaussians_file
    from gof_blender.scene import point_cloud

    bpy.ops.wm.read_factory_settings(use_empty=True)
    gof_blender.register()
    scene = bpy.context.scene
    scene.render.fps = 100
    point_cloud.add_point_cloud(
        gaussians_file.load(result, step=1000), 1, mode
    )  # what a first import also loads is not counted
    scene.frame_set(5)
    bpy.data.objects.remove(bpy.data.objects[0])
    before = resident_mb()
    started, cpu = time.perf_counter(), time.process_time()
    bpy.ops.gof.import_result(filepath=str(result), mode=mode)
    imported, cpu = time.perf_counter() - started, time.process_time() - cpu
    return {
        "import_s": imported,
        "import_cpu_s": cpu,
        **play(scene),
        "peak_mb": resident_mb("VmHWM") - before,
        "mb": resident_mb() - before,
    }


def measure_baked(result: Path, mode: str) -> dict:
    """The same points as one mesh per frame, swapped at every frame. Runs in Blender."""
    import bpy

    from gof_blender.pure.io import gaussians_file
    from gof_blender.scene import display

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    before = resident_mb()
    started, cpu = time.perf_counter(), time.process_time()
    cloud = gaussians_file.load(result)
    light = display.emission(cloud, display.ToneCurve.measure(scene))
    radius = np.cbrt(cloud.scale.prod(1))
    meshes = []
    for number in range(FRAMES):
        age = number / 100 - cloud.t_mu
        alpha = cloud.opacity * np.exp(-0.5 * (age / cloud.t_sigma) ** 2)
        seen = np.flatnonzero(alpha >= 1 / 255)
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
    del cloud, light, alpha, age
    thing = bpy.data.objects.new("baked", meshes[0])
    scene.collection.objects.link(thing)
    tree = bpy.data.node_groups.new("points", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    given, points, out = (
        tree.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeMeshToPoints", "NodeGroupOutput")
    )
    tree.links.new(given.outputs[0], points.inputs["Mesh"])
    tree.links.new(points.outputs[0], out.inputs[0])
    thing.modifiers.new("points", "NODES").node_group = tree
    baked, cpu = time.perf_counter() - started, time.process_time() - cpu

    def swap(number: int) -> None:
        thing.data = meshes[number]

    return {
        "import_s": baked,
        "import_cpu_s": cpu,
        **play(scene, swap),
        "peak_mb": resident_mb("VmHWM") - before,
        "mb": resident_mb() - before,
    }


def case(kind: str, result: Path, mode: str = "points") -> dict:
    """One measurement in a process of its own."""
    run = subprocess.run(
        [sys.executable, "-m", "gof_benchmark.evidence.addon_speed", kind, str(result), mode],
        capture_output=True,
        text=True,
        timeout=600,
    )
    if run.returncode:
        raise RuntimeError(run.stdout[-1000:] + run.stderr[-2000:])
    return json.loads(next(line for line in run.stdout.splitlines() if line.startswith("{")))


CASES = [  # Gaussians, file, what shows them, how
    (100_000, ".npz", "cloud", "points"),
    (100_000, ".npz", "cloud", "ellipsoids"),
    (100_000, ".npz", "cloud", "arrows"),
    (100_000, ".npz", "cloud", "streaks"),
    (100_000, ".npz", "baked", "points"),
    (1_000_000, ".npz", "cloud", "points"),
    (1_000_000, ".ply", "cloud", "points"),
    (1_000_000, ".npz", "baked", "points"),
]


def main() -> int:
    found = {}
    print(
        "| Gaussians | file | shown as | import s (CPU s) | frame ms (CPU ms) | memory held MB | held / arrays | peak MB |"
    )
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for count, suffix, kind, mode in CASES:
            path = Path(folder) / f"{count}{suffix}"
            if not path.exists():
                write_result(path, count)
            row = found[count, suffix, kind, mode] = case(kind, path, mode)
            row["share"] = row["mb"] / (count * BYTES_EACH / 1e6)
            print(
                f"| {count:,} | {suffix} | {mode if kind == 'cloud' else f'{FRAMES} baked frames'} | {row['import_s']:.2f} ({row['import_cpu_s']:.2f}) | "
                f"{1000 * row['frame_s']:.1f} ({1000 * row['frame_cpu_s']:.1f}) | {row['mb']:.0f} | {row['share']:.2f} | {row['peak_mb']:.0f} |",
                flush=True,
            )
    large = [found[1_000_000, suffix, "cloud", "points"] for suffix in (".npz", ".ply")]
    fast = 1 / found[100_000, ".npz", "cloud", "points"]["frame_cpu_s"]
    slowest = max(row["import_cpu_s"] for row in large)
    for name, value, goal, met in (
        ("import of 1e6, CPU s", slowest, 5.0, slowest <= 5),
        ("playback of 1e5 points, frames per CPU s", fast, 10.0, fast >= 10),
        (
            "memory held / arrays, 1e6",
            max(row["share"] for row in large),
            1.5,
            max(row["share"] for row in large) <= 1.5,
        ),
    ):
        print(f"{name}: {value:.2f}, goal {goal:g}: {'met' if met else 'MISSED'}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) > 1:
        import os

        measured = {"cloud": measure_cloud, "baked": measure_baked}[sys.argv[1]](Path(sys.argv[2]), sys.argv[3])
        print(json.dumps(measured), flush=True)
        os._exit(0)
    sys.exit(main())
