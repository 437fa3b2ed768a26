"""The cost of a large picture of a fire, and which setting buys most: one picture, one setting changed at a time.

    python -m gof_benchmark.evidence.picture_costs [--out out/picture_costs]

Takes about 12 min.

The demo's fire in the light of soot, one camera. Every picture is rendered in a Blender of its own, and its CPU
seconds are those of that process between its request and its written files, which a busy machine hardly
changes; plates are not counted, they are made once per camera. Printed beside them, against a reference of many
samples:

- flame: mean absolute difference where there is flame, in steps of the 8-bit display picture;
- blotches: that of the fire's light on its surroundings, linear, blurred (the reference's own noise is then gone), over
  its mean;
- grain: mean absolute difference of that light from itself, blurred, over its mean.

A smaller picture is enlarged for it. Finished pictures in --out are not made again.
"""

from __future__ import annotations

import shutil
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import tyro

from gof.core.files import atomic_path, read_json, write_json
from gof_benchmark.evidence import child
from gof_benchmark.generator.blender_process import run_stage
from gof_benchmark.scenes import claim, load_scene
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

FLAME = 'objects["Fire Domain"].active_material.cycles'
BASE = {"samples": 4, "denoise": True, "max_bounces": 1, "volume_step_rate": 2.0}
REFERENCE = {"samples": 40, "denoise": False, "max_bounces": 2, "volume_step_rate": 1.0}


@dataclass(frozen=True)
class PictureCosts:
    """Render one picture with each setting in turn, and compare CPU seconds and errors."""

    out: Path = Path("out/picture_costs")
    """Folder for the pictures and picture_costs.md; what is finished there is not made again."""
    percentage: int = 100
    """For 720 x 1280 pixels."""
    resolution: int = 64
    """Cells along the box's longest side."""
    scene: str = "demo"
    """Built-in scene or spec file."""


@dataclass(frozen=True)
class RenderVariant:
    """The differences from the base: fields of `spec.render`, of the fire, cells (a factor), or what no spec has, of
    Blender's scene; and whether it shows the same as the reference, up to error."""

    name: str
    render: dict = field(default_factory=dict)
    fire: dict = field(default_factory=dict)
    cells: float = 1.0
    blender: dict = field(default_factory=dict)
    same: bool = True


VARIANTS = (
    RenderVariant("1 sample", {"samples": 1}),
    RenderVariant("2 samples", {"samples": 2}),
    RenderVariant("8 samples", {"samples": 8}),
    RenderVariant("16 samples", {"samples": 16}),
    RenderVariant("no denoiser", {"denoise": False}),
    RenderVariant("1 sample, no denoiser", {"samples": 1, "denoise": False}),
    RenderVariant("denoiser at high quality", blender={"cycles.denoising_quality": "HIGH"}),
    RenderVariant("step of the march 1 (half)", {"volume_step_rate": 1.0}),
    RenderVariant("step of the march 4", {"volume_step_rate": 4.0}),
    RenderVariant("step of the march 8", {"volume_step_rate": 8.0}),
    RenderVariant("2 samples, step 4 (preset large)", {"samples": 2, "volume_step_rate": 4.0}),
    RenderVariant("1 sample, step 4", {"samples": 1, "volume_step_rate": 4.0}),
    RenderVariant("linear interpolation of cells", blender={f"{FLAME}.volume_interpolation": "LINEAR"}),
    RenderVariant("cover with all samples", blender={'view_layers["Cover"].samples': BASE["samples"]}),
    RenderVariant("0 bounces", {"max_bounces": 0}),
    RenderVariant("2 bounces", {"max_bounces": 2}),
    RenderVariant("no light tree", blender={"cycles.use_light_tree": False}),
    RenderVariant(
        "adaptive sampling", blender={"cycles.use_adaptive_sampling": True, "cycles.adaptive_threshold": 0.05}
    ),
    RenderVariant("one thread", blender={"render.threads_mode": "FIXED", "render.threads": 1}),
    RenderVariant("half the size, 4 samples", {"samples": 4, "percentage": 0.5}),
    RenderVariant("a quarter of the size, 16 samples", {"samples": 16, "percentage": 0.25}),
    RenderVariant("light of sheets", fire={"light": "sheets"}, same=False),
    RenderVariant("light of the reaction", fire={"light": "reaction"}, same=False),
    RenderVariant("half the cells along a side", cells=0.5, same=False),
)


@dataclass(frozen=True)
class PictureCost:
    """Errors are None where the picture shows something else than the reference, or is it."""

    name: str
    cpu_s: float
    flame: float | None = None
    blotches: float | None = None
    grain: float | None = None


def main(argv: list[str] | None = None) -> None:
    """Print the table, and write it."""
    config = tyro.cli(PictureCosts, prog="python -m gof_benchmark.evidence.picture_costs", args=argv)
    reference, seconds = picture(RenderVariant("reference", REFERENCE), config)
    rows = [PictureCost("reference", seconds)]
    for variant in (RenderVariant("base"), *VARIANTS):
        made, seconds = picture(variant, config)
        rows.append(PictureCost(variant.name, seconds, *(errors(made, reference) if variant.same else ())))
    text = (
        table(rows, _read(reference.rgb).shape, config.resolution)
        + "\n"
        + limits({row.name: row.cpu_s for row in rows})
    )
    with atomic_path(config.out / "picture_costs.md") as path:
        path.write_text(text + "\n")
    write_json(config.out / "picture_costs.json", [asdict(row) for row in rows])
    print(text)


def table(rows: list[PictureCost], shape: tuple[int, ...], cells: int) -> str:
    height, width, _ = shape
    base = next(row.cpu_s for row in rows if row.name == "base")
    lines = [
        f"base: {width} x {height} pixels, {cells} cells, {_settings(BASE)}; reference: {_settings(REFERENCE)}",
        "",
        "| changed | CPU s | of the base | flame, of 255 | blotches | grain |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        flame = "-" if row.flame is None else f"{row.flame:.2f}"
        around = ("-" if share is None else f"{100 * share:.0f} %" for share in (row.blotches, row.grain))
        lines.append(f"| {row.name} | {row.cpu_s:.1f} | {row.cpu_s / base:.2f} | {flame} | {' | '.join(around)} |")
    return "\n".join(lines) + "\n"


def _settings(render: dict) -> str:
    return ", ".join(f"{name} {value}" for name, value in render.items())


def limits(cpu_s: dict[str, float]) -> str:
    """Return where the seconds of the base go, from straight lines through what was measured."""
    samples = {1: "1 sample", 2: "2 samples", 4: "base", 8: "8 samples", 16: "16 samples"}
    each, once = np.polyfit(list(samples), [cpu_s[name] for name in samples.values()], 1)
    steps = {1: "step of the march 1 (half)", 2: "base", 4: "step of the march 4", 8: "step of the march 8"}
    march, _ = np.polyfit([1 / step for step in steps], [cpu_s[name] for name in steps.values()], 1)
    return (
        f"{each:.2f} CPU s a sample and {once:.1f} once; of the base's {cpu_s['base']:.1f}, "
        f"{march / 2:.1f} are the march through the flame"
    )


@dataclass(frozen=True)
class Made:
    """Files of a picture: for display, where the flame is, and the light that the fire adds to the plate (.npy)."""

    rgb: Path
    mask: Path
    light: Path


def errors(made: Made, reference: Made) -> tuple[float, float, float]:
    """In the flame, blotches and grain; see the module."""
    flame = cv2.imread(str(reference.mask), cv2.IMREAD_GRAYSCALE) > 0
    size, blur = flame.shape[::-1], 2 * (flame.shape[0] // 80) + 1
    shown = cv2.resize(_read(made.rgb), size, interpolation=cv2.INTER_CUBIC)
    light, true = (
        cv2.resize(np.load(file), size, interpolation=cv2.INTER_LINEAR) for file in (made.light, reference.light)
    )
    # The room behind the flame is dimmed, and where it begins a blur would mix the two.
    around = cv2.dilate(flame.astype(np.uint8), np.ones((2 * blur + 1, 2 * blur + 1))) == 0
    mean = float(true[around].mean())
    smooth = cv2.blur(light, (blur, blur))
    blotches = np.abs(smooth - cv2.blur(true, (blur, blur)))[around].mean()
    grain = np.abs(light - smooth)[around].mean()
    return float(np.abs(shown - _read(reference.rgb))[flame].mean()), float(blotches / mean), float(grain / mean)


def picture(variant: RenderVariant, config: PictureCosts) -> tuple[Made, float]:
    """Return a picture, rendered unless it is there, and its CPU seconds."""
    spec = _spec(variant, config)
    layout = Layout((config.out / variant.name.replace(" ", "_")).resolve())
    files, cost = layout.frame(spec.cameras.names[0], 0), layout.hidden / "study-cost.json"
    light = layout.hidden / "light.npy"
    if not cost.is_file():
        _prepare(layout, spec, config)
        write_json(cost, {"cpu_s": child.call(draw, str(layout.root), variant.blender, str(light))})
    return Made(files.rgb, files.mask, light), read_json(cost)["cpu_s"]


def _spec(variant: RenderVariant, config: PictureCosts) -> SceneSpec:
    """Return the first frame after the warm-up, seen by the middle of the arc."""
    scene = load_scene(config.scene)
    render = BASE | {"percentage": 1.0} | variant.render
    render["percentage"] = round(render["percentage"] * config.percentage)
    return replace(
        scene,
        clip=replace(scene.clip, frames=1),
        domain=replace(scene.domain, resolution=round(variant.cells * config.resolution)),
        fire=replace(scene.fire, **({"light": "soot", "speeds": "physical"} | variant.fire)),
        cameras=replace(scene.cameras, count=1, eval_count=0),
        render=replace(scene.render, plate_samples=8, **render),
    )


def _prepare(layout: Layout, spec: SceneSpec, config: PictureCosts) -> None:
    """Prepare a dataset folder whose bake and plate are there; they are borrowed where another picture has the same."""
    shutil.rmtree(layout.root, ignore_errors=True)
    claim(layout, spec)
    fire = replace(spec, render=replace(spec.render, **BASE, percentage=config.percentage))
    baked = Layout((config.out / "bakes" / f"{spec.fire.light}_{spec.domain.resolution}").resolve())
    claim(baked, fire)
    run_stage("bake", baked.root)  # finds a finished one finished
    layout.hidden.mkdir(parents=True, exist_ok=True)
    layout.bake.symlink_to(baked.bake)
    shutil.copy(baked.bake_marker, layout.bake_marker)
    shutil.copy(baked.blend, layout.blend)
    plates = Layout((config.out / "plates" / str(spec.render.percentage)).resolve())
    if not plates.static_exr(spec.cameras.names[0]).is_file():
        shutil.copytree(layout.root, plates.root, symlinks=True, dirs_exist_ok=True)
        child.call(draw_plate, str(plates.root))
    shutil.copytree(plates.static(spec.cameras.names[0]).parent, layout.static(spec.cameras.names[0]).parent)


def draw_plate(root: str) -> None:
    """In a Blender of its own: the view without the fire."""
    from gof_blender.scene import render

    spec, layout = _open(root)
    render.configure(spec)
    render.plates(spec, layout)


def draw(root: str, settings: dict, light: str) -> float:
    """In a Blender of its own: the picture, with settings of Blender's scene by dotted names; its CPU seconds.
    Writes the light that the fire adds, (H, W, 3)."""
    import time

    import bpy

    from gof_blender.scene import images, render

    spec, layout = _open(root)
    renderer = render.FrameRenderer(spec, layout)
    for name, value in settings.items():
        *owner, last = name.split(".")
        setattr(bpy.context.scene.path_resolve(".".join(owner)), last, value)
    start = time.process_time()
    renderer(0, 0)
    cpu_s = time.process_time() - start
    camera = spec.cameras.names[0]
    seen, plate = map(images.read_exr, (layout.frame(camera, 0).exr, layout.static_exr(camera)))
    np.save(light, np.stack([seen[channel] - plate[channel] for channel in "RGB"], axis=-1))
    return cpu_s


def _open(root: str) -> tuple[SceneSpec, Layout]:
    import bpy

    from gof_blender.pure import spec as scene_spec
    from gof_blender.scene import mantaflow, rig

    layout = Layout(Path(root))
    spec = scene_spec.load(layout.local_spec)
    mantaflow.enable()
    bpy.ops.wm.open_mainfile(filepath=str(layout.blend), use_scripts=False)
    rig.set_picture_size(spec)  # the bake may be another size's
    return spec, layout


def _read(path: Path) -> np.ndarray:
    """Return (H, W, 3) display values of a picture."""
    return cv2.imread(str(path), cv2.IMREAD_COLOR).astype(np.float32)


if __name__ == "__main__":
    main()
