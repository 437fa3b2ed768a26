"""How exactly `gof capture sync` reads the generator's LED board: the effect's own pictures, in front of a grey ground.

    python -m gof_benchmark.evidence.generated_board

Takes about 2 min.

Nothing is simulated or rendered: pictures pass through the effects, the display transform and the codec of a spec.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.capture.decode import DecodeOptions
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from gof.core.files import write_json
from gof_benchmark.evidence import child
from gof_blender.core.description import CameraEntry
from gof_blender.pure import effects
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import clock, motion_blur, rolling_shutter, sensor_noise, sync_board, video_compression
from gof_blender.pure.layout import Layout
from gof_blender.pure.rig import Rig
from gof_blender.pure.spec import Render, SceneSpec
from gof_blender.pure.timing import Clip

GREY = 0.1
FRAMES = 24
BOARD = sync_board.Settings((0.0, 0.0, 0.25), marker_m=0.12)
SENSOR = (rolling_shutter.Settings(0.004), sensor_noise.Settings())
CLOCK = clock.Settings(0.002)
BASE = SceneSpec("board", seed=3, clip=Clip(FRAMES, fps=60.0), cameras=Rig(2), render=Render(50), background="studio")


def filmed(*listed, **changes) -> SceneSpec:
    return replace(BASE, effects=(*SENSOR, *listed), **changes)


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


@dataclass(frozen=True)
class GeneratedBoard:
    """Film the generator's LED board in several ways and read the frame times back; prints a table."""

    json: Path | None = None
    """Also write the figures to this file."""


@dataclass(frozen=True)
class Reading:
    """One camera: the marker's side in pixels, rms error of the frames' times and error of the row time, us."""

    marker_px: float
    rms_us: float
    row_time_error_us: float


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(GeneratedBoard, prog="python -m gof_benchmark.evidence.generated_board", args=argv)
    print("| filmed | marker (px) | times, rms (us), cam_0 and cam_1 | row time error (us) |\n|---|---|---|---|")
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, spec) in enumerate(CASES.items()):
            layout = Layout(Path(folder) / str(number))
            layout.hidden.mkdir(parents=True)
            scene_spec.save(spec, layout.spec)
            cameras = child.call(film, str(layout.root))
            found = [read(spec, layout, CameraEntry(**camera)) for camera in cameras]
            rms = ", ".join(f"{reading.rms_us:.2f}" for reading in found)
            row_time = max(abs(reading.row_time_error_us) for reading in found)
            print(f"| {name} | {found[0].marker_px:.0f} | {rms} | {row_time:.3f} |", flush=True)
            figures[name] = [asdict(reading) for reading in found]
    if config.json:
        write_json(config.json, figures)


def film(root: str) -> list[dict]:
    """In a process of its own: write the pictures of the spec in `root`; returns the entries of its cameras."""
    import bpy

    from gof_blender.scene import build, mantaflow, render, rig, video

    mantaflow.enable()
    layout = Layout(Path(root))
    spec = scene_spec.load(layout.spec)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build.scene(spec)
    render.configure(spec)
    bpy.context.view_layer.update()
    cameras = [rig.describe(camera, spec, {}) for camera in rig.find(spec)]
    codec = next(filter(effects.encodes, spec.effects), None)
    for number, camera in enumerate(cameras):
        ground = np.full((camera.height, camera.width, 3), GREY, np.float32)
        for frame in range(spec.clip.frames):
            path = layout.uncompressed(camera.name, frame) if codec else layout.frame(camera.name, frame).rgb
            render._write_png(path, render.seen(ground, spec, number, frame))
        if codec:
            video.through_codec(spec, layout, camera.name, codec)
    return [asdict(camera) for camera in cameras]


def read(spec: SceneSpec, layout: Layout, camera: CameraEntry) -> Reading:
    """Decode a camera's pictures and compare with its true times, which are those of its middle line."""
    board = next(effect for effect in spec.effects if isinstance(effect, sync_board.Settings))
    jitters = any(isinstance(effect, clock.Settings) and effect.jitter_s for effect in spec.effects)
    options = DecodeOptions(10 * board.tick_us, clock="free" if jitters else "steady")
    pictures = layout.frame(camera.name, 0).rgb.parent
    (video,) = synchronise([pictures], BoardTemplate.load("gof_board"), [options]).cameras
    lines = camera.width if spec.cameras.portrait else camera.height
    true = np.array(camera.time_s) + camera.row_time_s * (lines - 1) / 2 + board.start_s
    error_us = 1e6 * (np.array([frame.time_s for frame in video.times.frames]) - true)
    return Reading(
        marker_px=video.times.marker_px,
        rms_us=float(np.sqrt(np.mean(error_us**2))),
        row_time_error_us=video.times.row_time_us - 1e6 * camera.row_time_s,
    )


if __name__ == "__main__":
    main()
