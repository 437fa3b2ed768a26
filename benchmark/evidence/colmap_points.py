"""Can COLMAP find the cameras of a scene from its pictures? Structure from motion on views without fire.

    python -m gof_benchmark.evidence.colmap_points workshop classroom cloister [--work out/colmap]

Takes about 4 min.

The rig's few cameras stand too far apart for feature matching, as in a real set-up, where a calibration clip is filmed
with one moving camera. So the views are many more cameras on the same arc. COLMAP runs as its users run it, with its
default pipeline, and knows nothing but the pictures; `gof.ingest.sfm`, which knows the lenses, is not
measured here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.io.importers.alignment import align_cameras
from gof_benchmark.commands import generate
from gof_benchmark.scenes import load_scene
from gof_blender.pure import spec as scene_spec


@dataclass(frozen=True)
class ColmapPoints:
    """Run COLMAP on fire-free views of scenes, and compare the camera centres that it finds."""

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """Built-in scenes or spec files."""
    work: Path = Path("out/colmap")
    """Folder for the views and COLMAP's models."""
    views: int = 8
    """Cameras on the rig's arc."""
    percentage: int = 40
    """Size of the pictures, of the sensor; 100 is 720x1280."""


@dataclass(frozen=True)
class ColmapModel:
    """COLMAP's largest model: world_to_camera (4, 4) by picture name, in a frame and unit of its own."""

    poses: dict[str, np.ndarray]
    points: int
    reprojection_px: float


def main(argv: list[str] | None = None) -> None:
    """Print one row per scene."""
    config = tyro.cli(ColmapPoints, prog="python -m gof_benchmark.evidence.colmap_points", args=argv)
    config.work.mkdir(parents=True, exist_ok=True)
    print("| scene | views registered | points | reprojection error, px | camera centres, mm rms |")
    print("|---|---|---|---|---|")
    for scene in config.scenes:
        dataset = render_views(scene, config)
        model = structure_from_motion(dataset.path / "static", dataset.path)
        if model is None:
            print(f"| {scene} | 0 of {config.views} | 0 | | |", flush=True)
            continue
        true = {camera.name: camera.world_to_camera for camera in dataset.cameras}
        centres_mm = 1000 * align_cameras(model.poses, true).position_rms_m
        registered = f"{len(model.poses)} of {config.views}"
        print(
            f"| {scene} | {registered} | {model.points} | {model.reprojection_px:.2f} | {centres_mm:.1f} |", flush=True
        )


def render_views(scene: str, config: ColmapPoints) -> Dataset:
    """Fire-free pictures of a scene from cameras on the arc of its rig (and one coarse frame of its fire)."""
    spec = load_scene(scene, "toy")
    spec = replace(
        spec,
        effects=(),
        clip=replace(spec.clip, frames=1, warm_up_frames=1),
        cameras=replace(spec.cameras, count=config.views, eval_count=0),
        render=replace(spec.render, percentage=config.percentage, plate_samples=4, denoise=True),
    )
    file = config.work / f"{scene}.json"
    scene_spec.save(spec, file)
    generate.main([str(file), "--out", str(config.work / scene)])
    return Dataset.open(config.work / scene)


def structure_from_motion(pictures: Path, work: Path) -> ColmapModel | None:
    """COLMAP's default pipeline; None when it registers nothing."""
    import pycolmap

    database = work / "database.db"
    database.unlink(missing_ok=True)
    pycolmap.set_random_seed(0)
    names = sorted(path.name for path in pictures.glob("*.png"))
    pycolmap.extract_features(database, pictures, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE)
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, pictures, work / "models")
    model = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    if model is None:
        return None
    poses = {}
    for image in model.images.values():
        if image.has_pose:
            pose = image.cam_from_world  # a method in newer versions
            matrix = (pose() if callable(pose) else pose).matrix()
            poses[Path(image.name).stem] = np.vstack([matrix, [0, 0, 0, 1]])
    return ColmapModel(poses, model.num_points3D(), model.compute_mean_reprojection_error())


if __name__ == "__main__":
    main()
