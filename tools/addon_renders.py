"""Render the pictures of a reconstruction in docs/addon.md: the modes, the errors, and the cloud beside the true frame.

    python tools/addon_renders.py --result RESULT.npz --dataset DATASET [--out docs/images] [--frame 20]
                                  [--camera cam_1]

Runs in a Python that has the bpy wheel. The modes and errors are rendered on a dark floor; the last picture is the
dataset's own scene with the cloud in place of the fire, and its PSNR is printed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from math import pi
from pathlib import Path

import bpy
import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import gof_blender
from gof_blender.pure.io import cloud as clouds
from gof_blender.scene import gaussian_nodes, images, point_cloud
from gof_blender.worker import import_result

TIME_S = 0.2  # of the clip
SHARES = {"arrows": 0.08, "streaks": 0.3}


def stage(size: tuple[int, int], place: tuple[float, float, float]) -> bpy.types.Scene:
    """Return an empty scene: dark world, floor, one camera that looks along +Y."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.engine = 100, "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces = 5, 2
    scene.view_settings.view_transform = "Filmic"
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.ops.mesh.primitive_plane_add(size=8)
    scene.world = bpy.data.worlds.new("dark")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.02, 0.02, 0.025, 1)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.location, scene.camera.rotation_euler = place, (pi / 2 - 0.03, 0, 0)
    return scene


def render(path: Path) -> Path:
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return path


def modes(result: Path, folder: Path) -> list[Path]:
    """Return the same moment in each mode; arrows and streaks coloured by speed."""
    scene = stage((220, 360), (0, -2.9, 0.8))
    bpy.ops.gof.import_result(filepath=str(result))
    thing = bpy.context.object
    scene.frame_set(1 + round(TIME_S * 100))
    pictures = []
    for number, mode in enumerate(gaussian_nodes.MODES):
        point_cloud.inputs(thing)["Mode"] = number
        point_cloud.color_by(thing, "speed" if mode in SHARES else "image")
        point_cloud.inputs(thing)["Share"] = SHARES.get(mode, 1.0)
        pictures.append(render(folder / f"{mode}.png"))
    return pictures


def errors(result: Path, dataset: Path, folder: Path) -> list[Path]:
    """Return the cloud and the views that Show Errors puts beside it."""
    scene = stage((760, 360), (0, -5.4, 0.85))
    bpy.ops.gof.import_result(filepath=str(result))
    scene.gof.score.dataset = str(dataset)
    scene.frame_set(1 + round(TIME_S * 100))
    bpy.ops.gof.show_errors()
    scene.camera.location.x = max(view.location.x for view in scene.objects if "gof_view_of" in view) / 2
    print(scene.gof.score.centres)
    return [render(folder / "errors.png")]


def side_by_side(result: Path, dataset: Path, folder: Path, frame: int, camera: str) -> list[Path]:
    """Return the true frame, and the cloud in the same scene."""
    spec = import_result.read_spec(dataset)
    import_result.import_into_scene(clouds.load(result), spec, "ellipsoids")
    bpy.context.scene.frame_set(spec.timeline.blender_frame(frame))
    own, view = folder / "own.png", dataset / "cameras" / camera
    bpy.context.scene.camera = bpy.data.objects[camera]
    import_result.render_preview(own, samples=4)
    true = view / "rgb" / f"{frame:06d}.png"
    error = (pixels(own) - pixels(true)) ** 2
    flame = pixels(view / "mask" / f"{frame:06d}.png")[..., 0] > 0
    whole, on_flame = (-10 * np.log10(part.mean()) for part in (error, error[flame]))
    print(f"{camera}, frame {frame}: PSNR {whole:.2f} dB, on the flame {on_flame:.2f} dB")
    return [true, own]


def pixels(path: Path) -> np.ndarray:
    """Display values (H, W, C) in [0, 1] of a picture."""
    return images.read_png(path).astype(float) / 255


def join(pictures: list[Path], target: Path, scale: int = 100) -> None:
    """Join pictures side by side in one WebP."""
    joined = np.hstack([cv2.imread(str(picture)) for picture in pictures])
    larger = cv2.resize(joined, None, fx=scale / 100, fy=scale / 100, interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(target), larger, [cv2.IMWRITE_WEBP_QUALITY, 85])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--result", type=Path, required=True, help="a reconstruction")
    parser.add_argument("--dataset", type=Path, required=True, help="the dataset it was made from")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the pictures")
    parser.add_argument("--frame", type=int, default=20, help="held-out frame of the side-by-side picture")
    parser.add_argument("--camera", default="cam_1", help="its camera")
    args = parser.parse_args()
    result, dataset, out = args.result.resolve(), args.dataset.resolve(), args.out.resolve()
    gof_blender.register()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        join(modes(result, folder), out / "addon_modes.webp")
        join(errors(result, dataset, folder), out / "addon_errors.webp")
        join(side_by_side(result, dataset, folder, args.frame, args.camera), out / "addon_side_by_side.webp", scale=200)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # Blender as a module may hang at its end
