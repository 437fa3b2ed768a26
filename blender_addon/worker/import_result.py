"""Worker of `gof import`: a reconstruction back in the scene it was made from, as an animated cloud in a .blend.

It also renders one preview frame. (The panel's operator of the same name adds a cloud to the scene that is open.)

    python -m gof_blender.worker.import_result --result result.npz --dataset DATASET --blend out.blend \\
        --preview preview.png --frame 5 --camera cam_0

The scene of a generated dataset (background, cameras, colour management, clock) is built again from the spec in
DATASET/dataset.json, without the simulated fire; the Gaussians take its place. The cameras of a real capture are known,
and each one's picture without fire is put behind the Gaussians. The preview is the view that
cameras/<camera>/rgb/<frame>.png shows.

Progress goes to standard output as lines ``{"progress": {"stage": "import", "done": 1, "total": 3}}``; what Blender
prints goes to a log beside the .blend.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

from ..core.datum import Datum
from ..core.description import FILE, DatasetDescription
from ..core.errors import DataFormatError, GofError
from ..core.files import atomic_path
from ..pure.io import cloud as clouds
from ..pure.spec import SceneSpec
from .reporter import Reporter, exit_status, leave


def read_spec(dataset: Path) -> SceneSpec:
    """Return the scene spec of a generated dataset.

    Raises:
        DataFormatError: no dataset there, one without a scene spec, such as a capture, a broken spec, or one whose
            scene is a file outside the dataset.
    """
    description = DatasetDescription.read(dataset)
    if not description.spec:
        raise DataFormatError(f"{dataset / FILE}: holds no scene spec; it is no generated dataset")
    try:
        return SceneSpec.from_dict(description.spec).resolved_in(dataset)
    except GofError as error:
        raise DataFormatError(f"{dataset / FILE}: spec: {error}") from None


@dataclass(frozen=True)
class GeneratedScene:
    """The scene that a dataset was generated from."""

    spec: SceneSpec

    @property
    def frames(self) -> int:
        return self.spec.clip.frames

    @property
    def cameras(self) -> list[str]:
        return list(self.spec.cameras.names)

    def build(self, cloud: clouds.GaussianCloud, mode: str):
        """Replace the open scene by this one with the cloud. Returns the cloud's object."""
        return import_into_scene(cloud, self.spec, mode)

    def show(self, camera: str, frame: int) -> None:
        """Set the scene's camera and time."""
        import bpy

        bpy.context.scene.camera = bpy.data.objects[camera]
        bpy.context.scene.frame_set(self.spec.timeline.blender_frame(frame))

    @property
    def samples(self) -> int:
        return self.spec.render.samples


@dataclass(frozen=True)
class CapturedScene:
    """The cameras of a real capture, in `folder`, before their plates."""

    description: DatasetDescription
    folder: Path
    samples: int = 16

    @property
    def frames(self) -> int:
        return len(self.description.time_s)

    @property
    def cameras(self) -> list[str]:
        return [entry.name for entry in self.description.cameras]

    def build(self, cloud: clouds.GaussianCloud, mode: str):
        """Replace the open scene by this one with the cloud. Returns the cloud's object."""
        from ..scene import captured, point_cloud

        captured.scene(self.description, self.folder)
        return point_cloud.add_point_cloud(cloud, captured.FIRST_FRAME, mode)

    def show(self, camera: str, frame: int) -> None:
        """Set the scene's camera and the time at which it took the frame."""
        import bpy

        from ..scene import captured

        entry = self.description.cameras[self.cameras.index(camera)]
        captured.look_through(entry)
        at = captured.moment(self.description, (entry.time_s or self.description.time_s)[frame])
        bpy.context.scene.frame_set(math.floor(at), subframe=at - math.floor(at))


def read_scene(dataset: Path, datum: Datum) -> GeneratedScene | CapturedScene:
    """Return the scene of a dataset, a capture's measured from the datum: Blender knows float32 alone.

    Raises DataFormatError as `read_spec`, but not for a capture.
    """
    description = DatasetDescription.read(dataset)
    if description.spec:
        return GeneratedScene(read_spec(dataset))
    return CapturedScene(description.measured_from(datum), dataset)


def import_into_scene(cloud: clouds.GaussianCloud, spec: SceneSpec, mode: str):
    """Replace the open scene by the spec's, with the cloud in place of the fire. Returns the cloud's object."""
    import bpy

    from ..scene import build, point_cloud

    build.scene(spec)
    for object_ in list(bpy.data.collections["Fire"].objects):
        bpy.data.objects.remove(object_)
    return point_cloud.add_point_cloud(cloud, spec.timeline.first_frame, mode)


def save_blend(path: Path) -> None:
    """Save the open scene to `path`, atomically."""
    import bpy

    from ..scene import paths

    paths.forget_browsed()
    with atomic_path(path) as draft:
        bpy.ops.wm.save_as_mainfile(filepath=str(draft), copy=True, compress=True, check_existing=False)


def render_preview(path: Path, samples: int) -> None:
    """Render the current frame with Cycles and save it as 8-bit display sRGB, atomically."""
    import bpy

    scene = bpy.context.scene
    scene.cycles.samples = samples
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "8"
    with atomic_path(path) as draft:
        scene.render.filepath = str(draft)
        bpy.ops.render.render(write_still=True)


def run(args: argparse.Namespace) -> None:
    """Check everything that can be wrong, then build, save and render. Raises DataFormatError that names the remedy."""
    outputs = [path for path in (args.blend, args.preview) if path is not None]
    _require_no_outputs(outputs, args.overwrite)
    _require_mode(args.mode)
    cloud = clouds.load(args.result)
    scene = read_scene(args.dataset, cloud.datum or Datum())
    _require_view(args, scene)
    for path in outputs:
        path.parent.mkdir(parents=True, exist_ok=True)
    progress = Reporter("import", args.blend.with_suffix(".log"))
    total = 1 + len(outputs)
    object_ = scene.build(cloud, args.mode)
    scene.show(args.camera, args.frame)
    progress(1, total)
    save_blend(args.blend)
    progress(2, total)
    if args.preview is not None:
        render_preview(args.preview, min(args.samples, scene.samples))
        progress(3, total)
    print(f"{object_.name}: {len(cloud)} Gaussians, {args.mode}")


def _require_no_outputs(outputs: list[Path], overwrite: bool) -> None:
    existing = [path for path in outputs if path.exists()]
    if existing and not overwrite:
        raise DataFormatError(f"{existing[0]}: exists already; delete it or pass --overwrite")


def _require_mode(mode: str) -> None:
    import bpy

    from ..scene import gaussian_nodes

    if mode not in gaussian_nodes.MODES:
        raise DataFormatError(f"--mode {mode}: Blender {bpy.app.version_string} has no Gaussian splats; 5.3 has")


def _require_view(args: argparse.Namespace, scene: GeneratedScene | CapturedScene) -> None:
    last, names = scene.frames - 1, scene.cameras
    if not 0 <= args.frame <= last:
        raise DataFormatError(f"--frame {args.frame}: the dataset {args.dataset} has frames 0 to {last}")
    if args.camera not in names:
        raise DataFormatError(f"--camera {args.camera}: the dataset {args.dataset} has {', '.join(names)}")


def main(argv: list[str] | None = None) -> int:
    """Run the import; returns the exit status. The process must then end through ``reporter.leave``."""
    parser = argparse.ArgumentParser(
        prog="python -m gof_blender.worker.import_result", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--result", type=Path, required=True, help="result.npz or result.ply")
    parser.add_argument("--dataset", type=Path, required=True, help="the dataset it was reconstructed from")
    parser.add_argument("--blend", type=Path, required=True, help="file to save the scene with the cloud to")
    parser.add_argument("--preview", type=Path, help="PNG to render one frame to")
    parser.add_argument("--frame", type=int, default=0, help="dataset frame of the preview and of the saved scene")
    parser.add_argument("--camera", default="cam_0", help="rig camera of the preview")
    parser.add_argument("--mode", choices=("ellipsoids", "points", "splats"), default="ellipsoids", help="shapes")
    parser.add_argument(
        "--samples", type=int, default=4, help="Cycles samples of the preview, at most the dataset's own; default: 4"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing output files")
    args = parser.parse_args(argv)
    for name in ("result", "dataset", "blend", "preview"):
        if getattr(args, name) is not None:
            setattr(args, name, getattr(args, name).resolve())
    return exit_status(lambda: run(args), GofError)


if __name__ == "__main__":
    leave(main())
