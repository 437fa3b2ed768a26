"""Can COLMAP find the cameras of a scene from its pictures? Structure from motion on views without fire.

    python -m gof_benchmark.evidence.colmap_points workshop classroom cloister --work out/colmap

The rig's few cameras stand too far apart for feature matching, as in a real set-up, where a calibration clip is filmed
with one moving camera. So the views are many more cameras on the same arc. pycolmap knows nothing but the pictures.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from gof.dataset import Dataset
from gof_benchmark.commands import generate
from gof_benchmark.commands.generate import load_scene
from gof_blender.pure import spec as scene_spec


def render_views(scene: str, work: Path, views: int, percentage: int) -> Dataset:
    """Fire-free pictures of a scene from `views` cameras on the arc of its rig (and one coarse frame of its fire)."""
    spec = load_scene(scene, "toy")
    spec = replace(
        spec,
        effects=(),
        clip=replace(spec.clip, frames=1, warm_up_frames=1),
        cameras=replace(spec.cameras, count=views, eval_count=0),
        render=replace(spec.render, percentage=percentage, plate_samples=4, denoise=True),
    )
    scene_spec.save(spec, work / f"{scene}.json")
    generate.main([str(work / f"{scene}.json"), "--out", str(work / scene)])
    return Dataset.open(work / scene)


def structure_from_motion(pictures: Path, work: Path) -> dict:
    """Run COLMAP's default pipeline. Returns points, registered images, mean reprojection error and camera centres."""
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
        return {"points": 0, "images": 0, "of": len(names)}
    centres = {Path(image.name).stem: image.projection_center() for image in model.images.values() if image.has_pose}
    return {
        "points": model.num_points3D(),
        "images": model.num_reg_images(),
        "of": len(names),
        "reprojection_px": model.compute_mean_reprojection_error(),
        "centres": centres,
    }


def centre_error(found: dict[str, np.ndarray], true: dict[str, np.ndarray]) -> float:
    """Rms distance (m) of camera centres after the best similarity transform (Umeyama 1991)."""
    a, b = (np.array([side[name] for name in found]) for side in (found, true))
    a, b = a - a.mean(0), b - b.mean(0)
    u, values, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (values * np.diag(sign)).sum() / (a**2).sum()
    return float(np.sqrt(((scale * a @ (u @ sign @ vt).T - b) ** 2).sum(-1).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--work", type=Path, default=Path("out/colmap"))
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--percentage", type=int, default=40, help="of the sensor; 100 is 720x1280")
    args = parser.parse_args()
    rows = [
        "| scene | views registered | points | reprojection error, px | camera centres, mm rms |",
        "|---|---|---|---|---|",
    ]
    args.work.mkdir(parents=True, exist_ok=True)
    for scene in args.scenes:
        dataset = render_views(scene, args.work, args.views, args.percentage)
        found = structure_from_motion(args.work / scene / "static", args.work / scene)
        if not found["points"]:
            rows.append(f"| {scene} | 0 of {found['of']} | 0 | | |")
            continue
        error = centre_error(found["centres"], {camera.name: camera.position for camera in dataset.cameras})
        rows.append(
            f"| {scene} | {found['images']} of {found['of']} | {found['points']} | {found['reprojection_px']:.2f} | {1000 * error:.1f} |"
        )
    print("\n".join(rows))


if __name__ == "__main__":
    main()
