"""Make gof/sample/sample.zip, which `gof sample` unpacks: a fire, a result, a submission and three films.

    python tools/make_sample.py --work build/sample          about 15 minutes on 2 cores; goes on where it was stopped

Needs the extra `blender` and ffmpeg. The same sources give the same scenes; films and results differ in their last
digits between machines, so the archive is kept in the repository.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import cv2

from gof.core.files import atomic_path, write_json
from gof.core.records import write_record
from gof.dataset import Dataset
from gof.footage.lens import CalibratedCamera, CamerasFile
from gof.sample import CHANGED_NS

ROOT = Path(__file__).resolve().parents[1]
SPECS = ROOT / "tools/sample"
LIMIT_MB = 7.5
EPOCH = (1980, 1, 1, 0, 0, 0)  # the first time a zip can hold
METHOD = {
    "name": "Paper's choices, 1500 steps",
    "authors": ["Nazarenus et al. (method), gof (this run)"],
    "unfinished": "1500 of 30 000 steps, 5000 Gaussians: an example of a submission, not the method's best",
    "licence": "Apache-2.0",
    "given": ["plates"],
    "random": True,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--work", type=Path, default=ROOT / "build/sample", help="folder for what is made on the way")
    parser.add_argument("--out", type=Path, default=ROOT / "gof/sample/sample.zip")
    options = parser.parse_args()
    work, sample = options.work.resolve(), options.work.resolve() / "sample"
    for name in ("fire", "clip"):
        run("generate", SPECS / f"{name}.json", "--out", work / name)
    shutil.rmtree(sample, ignore_errors=True)
    keep_fire(work / "fire", sample / "fire")
    keep_clip(work / "clip", sample / "clip")
    run("reconstruct", sample / "fire", "--out", work / "result", "--gaussians", "10000")
    keep_result(work / "result", sample / "result")
    run("reconstruct", sample / "fire", "--out", work / "paper", "--method", "paper", "--scene", "plates",
        "--steps", "1500", "--gaussians", "5000", "--no-flow-prior")  # fmt: skip
    keep_submission(work / "paper", sample)
    size = write_archive(sample, options.out)
    print(f"{options.out}: {size / 1e6:.2f} MB")
    return 0 if size <= 1e6 * LIMIT_MB else f"larger than {LIMIT_MB} MB"


def run(*words) -> None:
    subprocess.run([sys.executable, "-m", "gof.commands.cli", *map(str, words)], check=True)


def keep_fire(dataset: Path, out: Path) -> None:
    """Keep the dataset without its linear pictures and Blender files, which are most of its bytes."""
    description = json.loads((dataset / "dataset.json").read_text(encoding="utf-8"))
    for camera in description["cameras"]:
        camera.pop("exr", None)
    write_json(out / "dataset.json", description)
    for name in ("spec.json", "costs.json"):
        shutil.copyfile(dataset / name, out / name)
    shutil.copytree(dataset / "velocity.zarr", out / "velocity.zarr")
    for camera in description["cameras"]:
        folder = Path("cameras") / camera["name"]
        for kind in ("rgb", "mask"):
            shutil.copytree(dataset / folder / kind, out / folder / kind)
        (out / camera["static"]).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(dataset / camera["static"], out / camera["static"])
    pack_pictures(out)
    for path in out.rglob("*"):
        os.utime(path, ns=(CHANGED_NS, CHANGED_NS))


def keep_clip(dataset: Path, out: Path) -> None:
    """Keep the clip's pictures as films of three cameras, and the lenses and places of these."""
    opened = Dataset.open(dataset)
    out.mkdir(parents=True)
    cameras = []
    for entry in opened.description.cameras:
        pictures, film = dataset / "cameras" / entry.name / "rgb/%06d.png", out / f"{entry.name}.mp4"
        write_film(pictures, film, round(1 / opened.frame_time_s))
        camera = entry.camera()
        K, pose = (tuple(map(tuple, matrix.tolist())) for matrix in (camera.K, camera.world_to_camera))
        cameras.append(CalibratedCamera(camera.width, camera.height, K, name=entry.name, world_to_camera=pose))
    write_record(out / "cameras.json", CamerasFile(tuple(cameras)))


def write_film(pictures: Path, film: Path, rate: int) -> None:
    """H.264 as phones write it: 8 bits, 4:2:0, BT.709."""
    words = ["ffmpeg", "-loglevel", "error", "-y", "-framerate", rate, "-i", pictures, "-c:v", "libx264", "-crf", 20]
    words += ["-preset", "slow", "-pix_fmt", "yuv420p", "-vf", "scale=out_color_matrix=bt709:out_range=tv"]
    words += ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv"]
    subprocess.run([*map(str, words), "-movflags", "+faststart", str(film)], check=True)


def keep_result(run_folder: Path, out: Path) -> None:
    """Keep the parts of a reconstruction that report, share and film need."""
    out.mkdir(parents=True)
    for name in ("result.npz", "settings.json", "costs.json", "curve.json", "made_from.json"):
        if (run_folder / name).is_file():
            shutil.copyfile(run_folder / name, out / name)
    if (run_folder / "plates").is_dir():
        shutil.copytree(run_folder / "plates", out / "plates")
    pack_pictures(out)


def keep_submission(run_folder: Path, sample: Path) -> None:
    """Another method's result as `gof benchmark add` lays one out, with its scores and held-out pictures."""
    from gof.evaluate import evaluate
    from gof.evaluate.submission import PICTURES, SCORES, Run, write_pictures

    folder = sample / "submission/fire"
    keep_result(run_folder, folder)
    for name in ("settings.json", "curve.json"):
        (folder / name).unlink(missing_ok=True)
    write_json(sample / "submission/method.json", METHOD)
    dataset = Dataset.open(sample / "fire")
    evaluate(folder / "result.npz", dataset).write(folder / SCORES)
    write_pictures(Run.open(folder, "fire"), dataset)
    pack_pictures(folder / PICTURES)


def pack_pictures(folder: Path) -> None:
    """Pack PNG files tightly, as cameras' frames are not written for the sake of time; their pixels stay."""
    tightly = (cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_FILTERED)
    for path in folder.rglob("*.png"):
        if not cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED), tightly):
            raise SystemExit(f"{path}: cannot be written")


def write_archive(folder: Path, path: Path) -> int:
    """Return the folder as a zip, the same bytes from the same files; its size."""
    with atomic_path(path) as draft, zipfile.ZipFile(draft, "w") as archive:
        for file in sorted(file for file in folder.rglob("*") if file.is_file()):
            entry = zipfile.ZipInfo(file.relative_to(folder).as_posix(), EPOCH)
            entry.external_attr, entry.compress_type = 0o644 << 16, zipfile.ZIP_DEFLATED
            archive.writestr(entry, file.read_bytes())
    return path.stat().st_size


if __name__ == "__main__":
    sys.exit(main())
