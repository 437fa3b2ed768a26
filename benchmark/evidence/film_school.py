"""Good and bad ways to film a fire, side by side, and the faults that `gof capture check-footage` finds.

    python -m gof_benchmark.evidence.film_school DEMO --work WORK --out docs/images/film_school.webp

Takes about 5 min.

DEMO is a dataset of `gof demo` or `gof generate demo`. Its fire is filmed anew by cameras that stand as they should,
too far away, and before an empty wall (`--fire-of`: pictures only); the other faults are made of good pictures. Every
film begins with what is behind the fire, as the tutorial says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tyro
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.dataset import Dataset
from gof.ingest.look_over import Finding, look_over
from gof_benchmark.commands import generate
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.spec import SceneSpec

FIRE_FREE = 64  # frames before the fire
NOISE = 1 / 255  # of a sensor: no two pictures are equal
COLUMNS, TEXT_PX, LINES, GAP = 3, 12, 6, 8
SIGNS = {"good": "\N{CHECK MARK}", "look": "!", "bad": "\N{MULTIPLICATION SIGN}"}
Film = np.ndarray  # (T, H, W, 3) display values in [0, 1]


@dataclass(frozen=True)
class FilmSchool:
    """Film a fire in good and bad ways, and put them into one picture with their faults."""

    demo: tyro.conf.Positional[Path]
    """Dataset whose fire burns."""
    work: Path
    """Folder of what is made; what is there is used."""
    out: Path
    """Picture to write."""


def near(spec: SceneSpec) -> SceneSpec:
    """Return the cameras as the tutorial wants them: 10 degrees apart, the flame as large as the picture."""
    cameras = replace(spec.cameras, arc_deg=20.0, around_frames=0)
    return replace(spec, cameras=cameras, render=replace(spec.render, samples=2, plate_samples=16))


PLACES: dict[str, Callable[[SceneSpec], SceneSpec]] = {
    "near": near,
    "far": lambda spec: replace(near(spec), cameras=replace(near(spec).cameras, focal_mm=12.0)),
    "bare": lambda spec: replace(near(spec), background="studio"),
}


def overexposed(film: Film) -> Film:
    return linear_to_srgb(np.minimum(8 * srgb_to_linear(film), 1))


def slow(film: Film) -> Film:
    """Return a quarter of the frames, the shutter always open."""
    light = srgb_to_linear(film[: len(film) // 4 * 4])
    return linear_to_srgb(light.reshape(-1, 4, *film.shape[1:]).mean(1))


def shaken(film: Film) -> Film:
    """Return pictures of a camera that wanders by up to 3 % of the width."""
    wander = np.cumsum(np.random.default_rng(0).normal(size=(len(film), 2)), axis=0)
    wander *= 0.03 * film.shape[2] / np.abs(wander).max()
    moves = [np.float32([[1, 0, x], [0, 1, y]]) for x, y in wander]
    return np.stack([_moved(frame, move) for frame, move in zip(film, moves, strict=True)])


def _moved(frame: np.ndarray, move: np.ndarray) -> np.ndarray:
    return cv2.warpAffine(frame, move, frame.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)


SET_UPS: dict[str, tuple[str, Callable[[Film], Film], float]] = {
    "as it should be": ("near", lambda film: film, 1.0),
    "exposed too long": ("near", overexposed, 1.0),
    "25 frames a second": ("near", slow, 0.25),
    "in the hand": ("near", shaken, 1.0),
    "too far away": ("far", lambda film: film, 1.0),
    "before a bare wall": ("bare", lambda film: film, 1.0),
}
"""By name: where the cameras stand, what becomes of a film, and of its rate."""


def main(argv: list[str] | None = None) -> None:
    """Make what is missing, print the faults, write the sheet."""
    config = tyro.cli(FilmSchool, prog="python -m gof_benchmark.evidence.film_school", args=argv)
    spec = scene_spec.load(config.demo / "spec.json")
    datasets = {name: _filmed(change(spec), config, name) for name, change in PLACES.items()}
    tiles, usual = [], set()
    for name, (place, change, rate) in SET_UPS.items():
        films = [change(film) for film in _films(datasets[place])]
        folder = config.work / name.replace(" ", "_")
        videos = [_write(film, folder / f"cam_{c}.mp4", spec.clip.fps * rate) for c, film in enumerate(films)]
        found = [finding for finding in worst(look_over(videos)) if finding.about not in usual]
        print(f"\n{name}", *(f"  {f.verdict} {f.about}: {f.words}" for f in found), sep="\n", flush=True)
        usual = usual or {finding.about for finding in found if finding.verdict == "look"}  # of the good one
        tiles.append(_tile(films[1][-4], name, found if tiles else []))
    _sheet(tiles).save(config.out, quality=85, method=6)


def worst(findings: list[Finding]) -> list[Finding]:
    """Return what is not good, the worst camera of each kind, or an empty list; what is bad comes first."""
    found: dict[str, Finding] = {}
    for finding in sorted(findings, key=lambda f: ("bad", "look", "good").index(f.verdict)):
        if finding.verdict != "good":
            found.setdefault(finding.about, finding)
    return list(found.values())


def _filmed(spec: SceneSpec, config: FilmSchool, name: str) -> Dataset:
    folder = config.work / f"dataset_{name}"
    if not (folder / "dataset.json").is_file():
        file = config.work / f"{name}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        scene_spec.save(replace(spec, name=f"school_{name}", ground_truth=()), file)
        generate.main([str(file), "--fire-of", str(config.demo), "--out", str(folder)])
    return Dataset.open(folder)


def _films(dataset: Dataset) -> list[Film]:
    """Return what each of three cameras films: first the place, then the fire."""
    films, rng = [], np.random.default_rng(0)
    for c in range(3):
        fire = [dataset.image(c, k) for k in range(len(dataset.times_s))]
        film = np.array([dataset.static(c)] * FIRE_FREE + fire, np.float32)
        films.append(np.clip(film + rng.normal(0, NOISE, film.shape), 0, 1).astype(np.float32))
    return films


def _write(film: Film, path: Path, rate_hz: float) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    size = film.shape[2], film.shape[1]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, size)
    for frame in film:
        writer.write(np.rint(255 * np.clip(frame[..., ::-1], 0, 1)).astype(np.uint8))
    writer.release()
    return path


def _tile(frame: np.ndarray, name: str, found: list[Finding]) -> Image.Image:
    """Return a picture with its name above it, and its faults below."""
    picture = Image.fromarray(np.rint(255 * np.clip(frame, 0, 1)).astype(np.uint8))
    picture = picture.resize((240, round(240 * picture.height / picture.width)), Image.Resampling.LANCZOS)
    small, large = (ImageFont.truetype(font_manager.findfont("DejaVu Sans"), px) for px in (TEXT_PX, TEXT_PX + 2))
    lines = [f"{SIGNS['good']} nothing to mend"] if not found else []
    for finding in found[:3]:
        lines += _wrapped(f"{SIGNS[finding.verdict]} {finding.words}", small)
    tile = Image.new("RGB", (picture.width, picture.height + (TEXT_PX + 3) * (LINES + 1) + 8), "white")
    draw = ImageDraw.Draw(tile)
    draw.text((0, 0), name, "black", large)
    tile.paste(picture, (0, TEXT_PX + 8))
    for row, line in enumerate(lines[:LINES]):
        at = (0, TEXT_PX + 12 + picture.height + row * (TEXT_PX + 3))
        draw.text(at, line, "#8a2a00" if found else "#1a6b1a", small)
    return tile


def _wrapped(text: str, font: ImageFont.FreeTypeFont) -> list[str]:
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if font.getlength(longer) > 240:
            lines.append(f"   {word}")
        else:
            lines[-1] = longer
    return lines


def _sheet(tiles: list[Image.Image]) -> Image.Image:
    width, height = tiles[0].width + GAP, max(tile.height for tile in tiles) + GAP
    sheet = Image.new("RGB", (COLUMNS * width - GAP, -(-len(tiles) // COLUMNS) * height - GAP), "white")
    for k, tile in enumerate(tiles):
        sheet.paste(tile, (k % COLUMNS * width, k // COLUMNS * height))
    return sheet


if __name__ == "__main__":
    main()
