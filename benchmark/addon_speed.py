"""What the add-on's cloud costs: import, playback, memory; against a sequence baked per frame of the same cloud.

    python -m benchmark.addon_speed

Every case runs in a Blender process of its own and is measured there: seconds on the clock; memory held, which is the
growth of the resident size once the C library has returned what is free; and its peak. Playback is `scene.frame_set`, which evaluates the modifier, without drawing.
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
GOALS = {"import 1e6, s": 5.0, "playback 1e5, frames/s": 10.0, "memory / arrays": 1.5}


def write_result(path: Path, count: int) -> None:
    """A flame-like cloud: Gaussians of 2 to 10 mm in a column of 1 m, alive for a tenth of the clip each."""
    from gof.gaussians import TransientGaussians

    rng = np.random.default_rng(0)
    position = rng.normal(0, 0.1, (count, 3)) * [1, 1, 0] + rng.uniform(0, 1, (count, 1)) * [0, 0, 1]
    TransientGaussians(
        position=position, velocity=rng.normal((0, 0, 2), 0.3, (count, 3)), t_mu=rng.uniform(0, 0.36, count),
        t_sigma=rng.uniform(0.01, 0.05, count), scale=rng.uniform(0.002, 0.01, (count, 3)), rotation=rng.normal(size=(count, 4)),
        opacity=rng.uniform(0.05, 0.9, count), color=rng.uniform(0, 1, (count, 3)), dynamic=np.ones(count, bool)).save(path)


def resident_mb(field: str = "VmRSS") -> float:
    if field == "VmRSS":
        ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/status").read_text().split(f"{field}:")[1].split()[0]) / 1024


def play(scene, before_frame=lambda number: None) -> float:
    """Median seconds of one frame."""
    seconds = []
    for number in range(FRAMES):
        started = time.perf_counter()
        before_frame(number)
        scene.frame_set(1 + number)
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds[1:]))


def measure_cloud(result: Path, mode: str) -> dict:
    """Import by the operator, then play. Runs in Blender."""
    import bpy

    import blender_addon
    from blender_addon.io import gaussians_file
    from blender_addon.scene import point_cloud

    bpy.ops.wm.read_factory_settings(use_empty=True)
    blender_addon.register()
    scene = bpy.context.scene
    scene.render.fps = 100
    point_cloud.add_point_cloud(gaussians_file.load(result, step=1000), 1, mode)  # what a first import also loads is not counted
    scene.frame_set(5)
    bpy.data.objects.remove(bpy.data.objects[0])
    before = resident_mb()
    started, cpu = time.perf_counter(), time.process_time()
    bpy.ops.gof.import_result(filepath=str(result), mode=mode)
    imported, cpu = time.perf_counter() - started, time.process_time() - cpu
    return {"import_s": imported, "import_cpu_s": cpu, "frame_s": play(scene), "peak_mb": resident_mb("VmHWM") - before,
            "mb": resident_mb() - before}


def measure_baked(result: Path, mode: str) -> dict:
    """The same points as one mesh per frame, swapped at every frame. Runs in Blender."""
    import bpy

    from blender_addon.io import gaussians_file
    from blender_addon.scene import display

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
        for name, kind, field, values in (("gs_alpha", "FLOAT", "value", alpha), ("radius", "FLOAT", "value", radius),
                                          ("gs_color", "FLOAT_VECTOR", "vector", light)):
            mesh.attributes.new(name, kind, "POINT").data.foreach_set(field, values[seen].ravel())
        meshes.append(mesh)
    del cloud, light, alpha, age
    thing = bpy.data.objects.new("baked", meshes[0])
    scene.collection.objects.link(thing)
    tree = bpy.data.node_groups.new("points", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    given, points, out = (tree.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeMeshToPoints", "NodeGroupOutput"))
    tree.links.new(given.outputs[0], points.inputs["Mesh"])
    tree.links.new(points.outputs[0], out.inputs[0])
    thing.modifiers.new("points", "NODES").node_group = tree
    baked, cpu = time.perf_counter() - started, time.process_time() - cpu

    def swap(number: int) -> None:
        thing.data = meshes[number]

    return {"import_s": baked, "import_cpu_s": cpu, "frame_s": play(scene, swap), "peak_mb": resident_mb("VmHWM") - before,
            "mb": resident_mb() - before}


def case(kind: str, result: Path, mode: str = "points") -> dict:
    """One measurement in a process of its own."""
    run = subprocess.run([sys.executable, "-m", "benchmark.addon_speed", kind, str(result), mode], capture_output=True, text=True, timeout=600)
    if run.returncode:
        raise RuntimeError(run.stdout[-1000:] + run.stderr[-2000:])
    return json.loads(next(line for line in run.stdout.splitlines() if line.startswith("{")))


def main() -> int:
    rows, goals = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for count, suffix in ((100_000, ".npz"), (1_000_000, ".npz"), (1_000_000, ".ply")):
            path = Path(folder) / f"{count}{suffix}"
            write_result(path, count)
            for kind, mode in (("cloud", "points"), *((("cloud", m) for m in ("ellipsoids", "arrows", "streaks")) if count == 100_000 else ()),
                               *([("baked", "points")] if suffix == ".npz" else [])):
                found = case(kind, path, mode)
                arrays_mb = count * BYTES_EACH / 1e6
                rows.append((f"{count:,}", suffix, mode if kind == "cloud" else f"{FRAMES} baked frames", found, found["mb"] / arrays_mb))
                if kind == "cloud" and mode == "points":
                    if count == 1_000_000:
                        goals["import 1e6, s"] = max(goals.get("import 1e6, s", 0), found["import_s"])
                        goals["memory / arrays"] = max(goals.get("memory / arrays", 0), rows[-1][-1])
                    else:
                        goals["playback 1e5, frames/s"] = 1 / found["frame_s"]
    print("| Gaussians | file | shown as | import s (CPU s) | frame ms | frames/s | memory held MB | held / arrays | peak MB |\n|---|---|---|---|---|---|---|---|---|")
    for count, suffix, shown, found, share in rows:
        print(f"| {count} | {suffix} | {shown} | {found['import_s']:.2f} ({found['import_cpu_s']:.2f}) | {1000 * found['frame_s']:.1f} | "
              f"{1 / found['frame_s']:.0f} | {found['mb']:.0f} | {share:.2f} | {found['peak_mb']:.0f} |")
    for name, goal in GOALS.items():
        met = goals[name] >= goal if "frames" in name else goals[name] <= goal
        print(f"{name}: {goals[name]:.2f}, goal {goal:g}: {'met' if met else 'MISSED'}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) > 1:
        import os

        measured = {"cloud": measure_cloud, "baked": measure_baked}[sys.argv[1]](Path(sys.argv[2]), sys.argv[3])
        print(json.dumps(measured), flush=True)
        os._exit(0)
    sys.exit(main())
