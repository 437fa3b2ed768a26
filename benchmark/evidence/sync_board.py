"""How exactly `gof capture sync` reads the generator's LED board: the effect's own pictures, in front of a grey ground.

    python -m gof_benchmark.evidence.sync_board

Nothing is simulated or rendered: pictures pass through the effects, the display transform and the codec of a spec.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from gof.capture.decode import DecodeOptions
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from gof_blender.pure.clip import Clip
from gof_blender.pure.effects import clock, motion_blur, rolling_shutter, sensor_noise, sync_board, video_compression
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import Render, Rig, SceneSpec

GREY, FRAMES = 0.1, 24
BOARD = sync_board.Settings((0.0, 0.0, 0.25), marker_m=0.12)
SENSOR = (rolling_shutter.Settings(0.004), sensor_noise.Settings())
CLOCK = clock.Settings(0.002)
BASE = SceneSpec("board", seed=3, clip=Clip(FRAMES, fps=60.0), cameras=Rig(2), render=Render(50), background="studio")


def filmed(*effects, **changes) -> SceneSpec:
    return replace(BASE, effects=(*SENSOR, *effects), **changes)


CASES = {
    "360x640, two clocks": filmed(CLOCK, BOARD),
    "720x1280, the effect's defaults": filmed(CLOCK, sync_board.Settings(), render=Render(100)),
    "turned the other way (roll -90)": filmed(CLOCK, BOARD, cameras=Rig(2, roll_deg=-90)),
    "level cameras, board turned by 90 degrees": filmed(
        CLOCK, replace(BOARD, position=(0.0, 0.0, 0.7), turn_deg=90.0), cameras=Rig(2, roll_deg=0)
    ),
    "shutter open for 1 ms (`motion_blur`)": filmed(CLOCK, motion_blur.Settings(0.06), BOARD),
    "25 fps, tick of 410 us": filmed(CLOCK, replace(BOARD, tick_us=410.0), clip=Clip(FRAMES, fps=25.0)),
    "jitter of 100 us, read with `--clock free`": filmed(clock.Settings(0.002, 1e-4), BOARD),
    "H.264, default quality": filmed(CLOCK, BOARD, video_compression.Settings()),
    "H.264, low quality": filmed(CLOCK, BOARD, video_compression.Settings("low")),
}


def film(spec: SceneSpec, layout: Layout) -> list[dict]:
    """Write both cameras' pictures; returns the cameras' entries of dataset.json."""
    import bpy

    from gof_blender.pure import effects
    from gof_blender.scene import build, render, rig, video

    layout.hidden.mkdir(parents=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build.scene(spec)
    render.configure(spec)
    bpy.context.view_layer.update()
    cameras = [rig.describe(camera, spec) for camera in rig.find(spec)]
    codec = next(filter(effects.encodes, spec.effects), None)
    for number, camera in enumerate(cameras):
        name, ground = camera["name"], np.full((camera["height"], camera["width"], 3), GREY, np.float32)
        for frame in range(spec.clip.frames):
            path = layout.uncompressed(name, frame) if codec else layout.frame(name, frame).rgb
            render._write_png(path, render.seen(ground, spec, number, frame))
        if codec:
            video.through_codec(spec, layout, name, codec)
    return cameras


def errors(spec: SceneSpec, layout: Layout, camera: dict) -> tuple[float, np.ndarray, float]:
    """Marker's side in pixels, errors of the frames' times and of the row time, us."""
    board = next(effect for effect in spec.effects if isinstance(effect, sync_board.Settings))
    jitters = any(isinstance(effect, clock.Settings) and effect.jitter_s for effect in spec.effects)
    options = DecodeOptions(10 * board.tick_us, clock="free" if jitters else "steady")
    pictures = layout.frame(camera["name"], 0).rgb.parent
    (video,) = synchronise([pictures], BoardTemplate.load("gof_board"), [options]).cameras
    read = video.times
    lines = camera["width" if spec.cameras.portrait else "height"]
    true = np.array(camera["time_s"]) + camera["row_time_s"] * (lines - 1) / 2 + board.start_s
    error = 1e6 * (np.array([frame.time_s for frame in read.frames]) - true)
    return read.marker_px, error, read.row_time_us - 1e6 * camera["row_time_s"]


def main() -> None:
    argparse.ArgumentParser(description=__doc__.split("\n")[0]).parse_args()
    from gof_blender.scene import mantaflow

    mantaflow.enable()
    rows = ["| filmed | marker (px) | times, rms (us), cam_0 and cam_1 | row time error (us) |", "|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, spec) in enumerate(CASES.items()):
            layout = Layout(Path(folder) / str(number))
            found = [errors(spec, layout, camera) for camera in film(spec, layout)]
            rms = ", ".join(f"{np.sqrt(np.mean(error**2)):.2f}" for _, error, _ in found)
            rows.append(f"| {name} | {found[0][0]:.0f} | {rms} | {max(abs(row) for *_, row in found):.3f} |")
    print("\n".join(rows), flush=True)
    mantaflow.leave()


if __name__ == "__main__":
    main()
