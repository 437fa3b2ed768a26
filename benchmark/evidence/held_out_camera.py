"""How a filmed flame looks to a camera that took no part: each camera of a clip in turn, from the others.

    python -m gof_benchmark.evidence.held_out_camera DATASET... [--out out/held_out_camera]

Takes about 8 min a clip of three cameras.

DATASETs are of `gof ingest`. Poses, clocks and masks are those that all cameras gave; flames are made of the others
alone. Scored are the held-out frames of the camera that was left out, and of those that were given, over their own
fire-free pictures at full size.

The trivial baseline is a picture: the light that the nearest given camera saw in that frame, on an upright plane
through the flame that faces that camera; "degrees" says how far it stands. A flame that is right in depth does better
the farther the cameras stand apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tyro

from gof.core.cameras import Camera
from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.presets import effort_of, size_of
from gof.reconstruct.settings import ReconstructionSettings
from gof.render import render
from gof_benchmark.evidence.real_clips import Draw, figures, of_result


@dataclass(frozen=True)
class HeldOutCamera:
    """Leave out each camera of real clips in turn. Prints a table."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of `gof ingest`, of two or more cameras."""
    out: Path = Path("out/held_out_camera")
    """Folder for the reconstructions; finished ones are kept."""
    preset: str = "preview"
    """For every reconstruction."""
    steps: int | None = None
    """Instead of the preset's."""


def hold_out(dataset: Dataset, camera: int) -> Dataset:
    """Return the dataset with one of its cameras for novel views."""
    name = dataset.cameras[camera].name
    entries = tuple(replace(e, role="eval") if e.name == name else e for e in dataset.description.cameras)
    description = replace(dataset.description, cameras=entries)
    return replace(dataset, description=description, cameras=description.cameras_from(dataset.datum, "train"))


def angle_deg(a: Camera, b: Camera, place: np.ndarray) -> float:
    """Return the angle at a place (3,) between the ways to two cameras, degrees."""
    ways = [camera.position - place for camera in (a, b)]
    cosine = ways[0] @ ways[1] / np.prod([np.linalg.norm(way) for way in ways])
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def draw_upright_picture(given: Dataset, nearest: int, seen: Dataset, middle: np.ndarray) -> Draw:
    """Return a drawer of the trivial baseline: the nearest camera's light on a plane through the flame's `middle`."""
    nearest_camera, seen_camera = given.cameras[nearest], seen.cameras[0]
    towards = nearest_camera.position - middle
    across = np.cross([0.0, 0.0, 1.0], towards)
    across /= np.linalg.norm(across)
    size = 0.1 * np.linalg.norm(towards)
    corners = middle + size * np.array(
        [[x * across[0], x * across[1], z] for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )
    pixels = [camera.project(corners)[0].astype(np.float32) for camera in (nearest_camera, seen_camera)]
    warp = cv2.getPerspectiveTransform(*pixels)
    plates = [srgb_to_linear(dataset.static(c)) for dataset, c in ((given, nearest), (seen, 0))]

    def draw(_: int, frame: int) -> np.ndarray:
        light = np.maximum(srgb_to_linear(given.image(nearest, frame)) - plates[0], 0).astype(np.float32)
        moved = cv2.warpPerspective(light, warp, (seen_camera.width, seen_camera.height), flags=cv2.INTER_LINEAR)
        return linear_to_srgb(np.clip(plates[1] + moved, 0, 1))

    return draw


def print_row(clip: str, dataset: Dataset, camera: int, config: HeldOutCamera) -> None:
    given = hold_out(dataset, camera)
    seen = given.evaluation_view()
    assert seen is not None, "it has the camera that was left out"
    folder = config.out / clip / f"without_{seen.cameras[0].name}"
    effort = effort_of(config.preset, config.steps, clip=size_of(given))
    reconstruct(given, ReconstructionSettings.of(given, effort), folder)
    gaussians = TransientGaussians.load(folder / "result.npz")
    weight = gaussians.opacity * gaussians.scale.prod(axis=1)
    middle = np.average(gaussians.position, axis=0, weights=weight)
    angles = [angle_deg(seen.cameras[0], other, middle) for other in given.cameras]
    nearest = int(np.argmin(angles))

    def draw(c: int, k: int) -> np.ndarray:
        time_s = float(seen.camera_times_s(c)[k])
        return np.clip(render(gaussians, seen.cameras[c], time_s, background=seen.static(c))["color"], 0, 1)

    drawers = draw, draw_upright_picture(given, nearest, seen, middle), lambda c, k: seen.static(c)
    scores = [figures(seen, drawer)[0] for drawer in drawers] + [figures(given, of_result(given, folder))[0]]
    cells = " | ".join(f"{score:.2f}" for score in scores)
    print(f"| {clip} | {seen.cameras[0].name} | {min(angles):.0f} | {cells} |", flush=True)


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(HeldOutCamera, prog="python -m gof_benchmark.evidence.held_out_camera", args=argv)
    print("| clip | left out | degrees | ours | the nearest picture, upright | no flame | given views, ours |")
    print("|---|---|---|---|---|---|---|")
    for path in config.datasets:
        dataset = Dataset.open(path)
        for camera in range(len(dataset.cameras)):
            print_row(path.name, dataset, camera, config)


if __name__ == "__main__":
    main()
