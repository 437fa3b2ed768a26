"""The page of `gof share` in a real browser draws the flame of `gof.render`, asks nothing of the network, and how fast.

    python -m gof_benchmark.evidence.share_player RESULT DATASET

Takes about 1 min. Needs Chromium.

Opened from the disk in a headless Chromium, at the exact size of the dataset's cameras.
"""

from __future__ import annotations

import base64
import io
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import tyro
from PIL import Image

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.image import psnr
from gof.io.importers import ImportOptions
from gof.look.player.opened import open_result
from gof.look.player.page import in_words, share_page
from gof.render import render
from tests.browser import Browser, page_address

SCALES = (1, 2)  # of the cameras' size
FRAMES = 5  # of which the time is taken
SCREENS = ((180, 320), (390, 844), (1400, 900))


@dataclass
class Options:
    """Write the page of a result, draw it in Chromium at three times from two cameras, compare with `gof.render`."""

    result: tyro.conf.Positional[Path]
    """Folder of `gof reconstruct`, or a result's file."""
    dataset: tyro.conf.Positional[Path]
    """The dataset it was made from."""


def main(argv: list[str]) -> int:
    """Return the command line."""
    options = tyro.cli(Options, prog="python -m gof_benchmark.evidence.share_player", args=argv)
    result, dataset = open_result(options.result, ImportOptions()), Dataset.open(options.dataset)
    with tempfile.TemporaryDirectory() as folder:
        made = share_page([result], Path(folder) / "share.html", dataset)
        size = f"{made.gaussian_bytes[0] / 1e6:.2f} MB, the page {made.bytes / 1e6:.2f} MB"
        print(f"{len(result.gaussians):,} Gaussians with the true velocity, if it is known: {size}")
        print(f"quantised: {in_words(made.agreement[0])}")
        with Browser(*SCREENS[0]) as browser:
            browser.open(page_address(made.path, "bare=1&t=0&show=0"))
            compare(browser, result.gaussians, dataset)
            times(browser)
            print(f"console: {browser.errors or 'nothing'}; asked for: {len(browser.requests)} file, the page itself")
    return 0


def compare(browser: Browser, gaussians: TransientGaussians, dataset: Dataset) -> None:
    """Print a row a picture: over black, as the page shows a flame from where no camera stood."""
    length = dataset.times_s[-1] - dataset.times_s[0]
    print("camera        size        ms    PSNR dB   20 ms later dB")
    for camera in dataset.cameras[:2]:
        for scale in SCALES:
            large = camera.scaled(scale * camera.width, scale * camera.height)
            browser.resize(large.width, large.height)
            for share in (0.15, 0.45, 0.75):
                time_s = float(dataset.times_s[0] + share * length)
                picture = drawn(browser, large, share * length)
                own, later = (np.clip(render(gaussians, large, t)["color"], 0, 1) for t in (time_s, time_s + 0.02))
                size = f"{large.width}x{large.height}"
                print(
                    f"{camera.name:<12}  {size:<9}  {1e3 * share * length:5.1f}  {psnr(picture, own):8.1f}"
                    f"  {psnr(picture, later):8.1f}"
                )


def drawn(browser: Browser, camera: Camera, time_s: float) -> np.ndarray:
    """Return (H, W, 3) display values of the page's canvas; `time_s` since the clip's start."""
    browser.run(f"fromHash('bare=1&show=0&plate=0&cam={camera.name}&t={1e3 * time_s}')")
    data = base64.b64decode(browser.run("player.picture()", 300).split(",")[1])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")) / 255


def times(browser: Browser) -> None:
    """Print milliseconds a frame, sorted, drawn and waited for; without a GPU a CPU does its work."""
    asked = "drawer.gl.getExtension('WEBGL_debug_renderer_info')?.UNMASKED_RENDERER_WEBGL ?? drawer.gl.RENDERER"
    device = browser.run(f"drawer.gl.getParameter({asked})")
    print(f"frames of one result, {device}, with {psutil.getloadavg()[0]:.0f} processes at work here:")
    for width, height in SCREENS:
        browser.resize(width, height)
        browser.run("new Promise((done) => setTimeout(done, 300))")
        ms = browser.run(f"player.time({FRAMES})", 600)
        sort, shown = browser.run("[player.measured.sort, player.measured.shown]")
        print(f"  {width}x{height}: {ms:.0f} ms; of that sorting {sort:.1f} ms, {shown:,} Gaussians drawn")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
