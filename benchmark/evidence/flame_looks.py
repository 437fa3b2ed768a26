"""How much pictures of our flames look like filmed ones: their colours, their texture, and their flicker.

    python -m gof_benchmark.evidence.flame_looks DATASET... --clips CLIPS

Takes about 1 min. Needs the paper's clips.

For each fire, in the pixels where its flame is: a histogram of display colours; the power of the picture's changes over
cycles per flame height; the power of the whole flame's light over frequency. Printed are the distances to the filmed
fires' mean, and what one filmed fire has to the mean of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro

from gof.core.colour import srgb_to_linear
from gof.core.errors import DataFormatError
from gof.footage.flame_mask import flame_mask
from gof.footage.videos import stored_frames
from gof.look.charts import line_chart
from gof_benchmark.fires import measures
from gof_blender.pure import spec as scene_spec

EVERY = 4  # frame whose colours and texture are taken
BINS = 8  # of the histogram, a colour
ALWAYS = 0.7  # red of what burns in every frame, display value; so much that half of it is missing in blue
HEIGHT_PX = 128  # that every flame is scaled to
CYCLES = np.arange(4, 33)  # per flame height
FLICKER_HZ = np.arange(10.0, 41.0, 2.5)


@dataclass(frozen=True)
class FlameLooks:
    """Compare the looks of generated flames with those of filmed ones."""

    pictures: tyro.conf.Positional[tuple[Path, ...]]
    """Datasets: folders with cameras/*/rgb and cameras/*/mask."""
    clips: Path
    """Folder under which the videos of filmed fires lie."""
    clip_rate_hz: float = 400.0
    """At which they were filmed."""
    charts: Path | None = None
    """Draw the curves into this folder."""


@dataclass(frozen=True)
class Looks:
    """One fire's looks: (BINS^3,) shares of colours, (C,) log10 power at CYCLES, (F,) log10 power at FLICKER_HZ or
    NaN."""

    name: str
    colours: np.ndarray
    texture: np.ndarray
    flicker: np.ndarray


def looks(name: str, views: list[tuple[list[np.ndarray], list[np.ndarray]]], rate_hz: float) -> Looks:
    """Return those of views (pictures (H, W, 3) uint8 RGB, masks (H, W) bool).

    Raises:
        DataFormatError: no view shows any flame.
    """
    shown = [(picture, mask) for pictures, masks in views for picture, mask in zip(pictures, masks, strict=True)]
    shown = [(picture, mask) for picture, mask in shown[::EVERY] or shown if mask.any()]
    if not shown:
        raise DataFormatError(f"{name}: no flame is seen in its pictures")
    pixels = np.concatenate([picture[mask] for picture, mask in shown])
    histogram, _ = np.histogramdd(pixels, BINS, [(0, 256)] * 3)
    flicker = [_flicker(pictures, masks, rate_hz) for pictures, masks in views]
    return Looks(
        name,
        histogram.ravel() / histogram.sum(),
        np.nanmean([_texture(picture, mask) for picture, mask in shown], axis=0),
        np.mean(flicker, axis=0),
    )


def _texture(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return (C,) log10 of the power of the picture's gamma-coded luminance at CYCLES per flame height, over their
    sum."""
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32) * mask
    crop = grey[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    scale = HEIGHT_PX / crop.shape[0]
    size = (max(round(crop.shape[1] * scale), 8), HEIGHT_PX)
    crop = cv2.resize(crop, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    window = np.hanning(size[1])[:, None] * np.hanning(size[0])
    square = np.zeros((256, max(256, size[0])))
    square[: size[1], : size[0]] = (crop - crop.mean()) * window
    power = np.abs(np.fft.fft2(square)) ** 2
    cycles = np.hypot(np.fft.fftfreq(square.shape[0])[:, None] * HEIGHT_PX, np.fft.fftfreq(square.shape[1]) * HEIGHT_PX)
    ring = np.array([power[np.abs(cycles - c) <= 0.75].sum() for c in CYCLES])
    return np.log10(np.maximum(ring / ring.sum(), 1e-12))


def _flicker(pictures: list[np.ndarray], masks: list[np.ndarray], rate_hz: float) -> np.ndarray:
    """Return (F,) log10 of the relative power of the flame's light, 1/Hz; NaN if the clip cannot tell."""
    if len(pictures) < 12 or rate_hz < 80 or len(pictures) / rate_hz < 0.15:
        return np.full(len(FLICKER_HZ), np.nan)
    light = np.array(
        [(srgb_to_linear(picture[mask] / 255.0)).sum() for picture, mask in zip(pictures, masks, strict=True)]
    )
    frequency, power = measures.spectrum(np.arange(len(light)) / rate_hz, light / light.mean())
    return np.log10(np.maximum(np.interp(FLICKER_HZ, frequency, power), 1e-12))


def of_clip(folder: Path, rate_hz: float) -> Looks:
    """Return those of a folder with a video a camera; LEDs of a board are white, hence no flame."""
    views = []
    for video in sorted(folder.glob("*.mp4")):
        pictures = [np.asarray(frame) for frame in stored_frames(video)]
        darkest = np.min(pictures, axis=0) / 255
        always = (darkest[..., 0] > ALWAYS) & (darkest[..., 0] - darkest[..., 2] > ALWAYS / 2)
        darkest[always] = 0
        masks = [flame_mask(picture / 255, darkest, grow_px=1) for picture in pictures]
        views.append((pictures, masks))
    return looks(f"{folder.parent.name}/{folder.name}", views, rate_hz)


def of_dataset(folder: Path) -> Looks:
    """Return those of a dataset, also an unfinished one of which only the pictures are there."""
    rate_hz = scene_spec.load(folder / "spec.json").clip.fps
    views = []
    for camera in sorted((folder / "cameras").iterdir()):
        names = [path.name for path in sorted((camera / "rgb").glob("*.png"))]
        pictures = [cv2.imread(str(camera / "rgb" / name))[..., ::-1] for name in names]
        masks = [cv2.imread(str(camera / "mask" / name), cv2.IMREAD_GRAYSCALE) > 0 for name in names]
        views.append(([np.ascontiguousarray(picture) for picture in pictures], masks))
    return looks(folder.name, views, rate_hz)


def distances(one: Looks, others: list[Looks]) -> tuple[float, float, float]:
    """Return (share of pixels of other colours, rms of log10 power of texture, and of flicker) to the mean of
    others."""
    colours = np.abs(one.colours - np.mean([other.colours for other in others], axis=0)).sum() / 2
    texture = one.texture - np.mean([other.texture for other in others], axis=0)
    flicker = one.flicker - np.nanmean([other.flicker for other in others], axis=0)
    return float(colours), float(np.sqrt((texture**2).mean())), float(np.sqrt((flicker**2).mean()))


def draw(generated: list[Looks], filmed: list[Looks], folder: Path) -> None:
    """Draw the three curves, each with the filmed fires' mean: colours as mean green by red, texture, flicker."""
    folder.mkdir(parents=True, exist_ok=True)
    kinds = ("colours", "texture", "flicker")
    mean = Looks("filmed fires, mean", *(np.nanmean([getattr(f, k) for f in filmed], axis=0) for k in kinds))
    charts = (
        ("colours", "colours of the flame's pixels", "red, 0 to 255", "mean green, 0 to 255", _green_by_red),
        ("texture", "texture", "cycles per flame height", "share of power", lambda one: (CYCLES, 10**one.texture)),
        ("flicker", "flicker", "frequency, Hz", "power of the light, 1/Hz", lambda one: (FLICKER_HZ, 10**one.flicker)),
    )
    for name, title, x_label, y_label, curve in charts:
        lines = {
            one.name.replace("_", " "): [(float(x), float(y), "") for x, y in zip(*curve(one), strict=True) if y > 0]
            for one in [mean, *generated]
        }
        lines = {name: points for name, points in lines.items() if points}
        line_chart(title, x_label, y_label, lines, log="" if name == "colours" else "xy").write(
            folder / f"flame_looks_{name}.svg"
        )


def _green_by_red(one: Looks) -> tuple[np.ndarray, np.ndarray]:
    """Return (BINS,) red of pixels and the mean green of those; 0 where there are next to none."""
    centres = (np.arange(BINS) + 0.5) * 256 / BINS
    by_red_and_green = one.colours.reshape(BINS, BINS, BINS).sum(2)
    count = by_red_and_green.sum(1)
    return centres, np.divide(by_red_and_green @ centres, count, out=np.zeros(BINS), where=count > 0.01)


def main(argv: list[str] | None = None) -> None:
    """Print the table, and draw."""
    config = tyro.cli(FlameLooks, prog="python -m gof_benchmark.evidence.flame_looks", args=argv)
    folders = sorted({video.parent for video in config.clips.glob("**/*.mp4")})
    if len(folders) < 2:
        raise SystemExit(f"{config.clips}: two or more folders with videos are needed")
    filmed = [of_clip(folder, config.clip_rate_hz) for folder in folders]
    generated = [of_dataset(folder) for folder in config.pictures]
    print("| fire | pixels of other colours | texture, log10 rms | flicker, log10 rms |", "|---|---|---|---|", sep="\n")
    among = [distances(item, [other for other in filmed if other is not item]) for item in filmed]
    for item, row in zip(filmed, among, strict=True):
        print(f"| {item.name} (to the other filmed ones) |", *_cells(row))
    for item in generated:
        print(f"| {item.name} |", *_cells(distances(item, filmed)))
    print("| filmed fires, to each other |", *(f"{min(x):.2f} to {max(x):.2f} |" for x in zip(*among, strict=True)))
    if config.charts:
        draw(generated, filmed, config.charts)


def _cells(row: tuple[float, ...]) -> list[str]:
    return [f"{value:.2f} |" if np.isfinite(value) else "- |" for value in row]


if __name__ == "__main__":
    main()
