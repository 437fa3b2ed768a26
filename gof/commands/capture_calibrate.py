"""`gof capture calibrate`: footage of the ChArUco target -> intrinsics of every camera, for `gof ingest --cameras`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from gof.capture.calibration import Calibration, calibrate, sharpest
from gof.capture.charuco import Charuco
from gof.commands.capture_target import CharucoOptions
from gof.commands.everywhere import require_free, require_writable, write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError
from gof.core.records import write_record
from gof.footage.lens import CamerasFile
from gof.footage.videos import chapter_lines, distinct_names, stated_frames, stored_frames
from gof.host.options import require_number
from gof.host.terminal import progress_bar


@dataclass(frozen=True)
class CalibrateConfig:
    """Calibrate the intrinsics of every camera from footage of the ChArUco target (`gof capture target` draws it).

    Examples:
      gof capture calibrate c0.mp4 c1.mp4 c2.mp4 --out cameras.json

    Film in the mode the fire will be filmed in: same resolution, rate, zoom and stabilisation off. Move the target
    slowly for about 20 seconds: near, far, tilted all ways, out to the corners of the picture. The file goes to
    gof ingest --cameras.
    """

    footage: tyro.conf.Positional[Annotated[list[Path], tyro.conf.arg(metavar="VIDEO ...")]]
    """One video or folder of photos per camera, in the order of the fire's videos."""
    out: Path | None = None
    """JSON file to write. Default: cameras.json beside the first video; one that is there is kept."""
    charuco: tyro.conf.OmitArgPrefixes[CharucoOptions] = field(default_factory=CharucoOptions)
    views: int = 40
    """Frames of a video to use, up to twice as many: the sharpest one of each stretch. Photos are all used."""


def main(argv: list[str]) -> int:
    """Calibrate every camera and write the file."""
    config = read_options(CalibrateConfig, "capture calibrate", argv)
    out = config.out or require_writable(config.footage[0].absolute().parent) / "cameras.json"
    require_free(out)
    require_number("--views", config.views, least=1)
    target = config.charuco.target()
    target.pattern()  # impossible sizes are refused before anything is read
    for line in chapter_lines(config.footage):
        print(line)
    cameras = []
    for name, path in zip(distinct_names(config.footage), config.footage, strict=True):
        found = calibrate_footage(name, path, target, config.views)
        print(describe(name, found))
        for warning in found.warnings():
            print(f"warning: {name}: {warning}")
        cameras.append(found.camera(name))
    file = CamerasFile(tuple(cameras))
    write_record(out, file)
    print(f"wrote {out}; next: gof ingest VIDEO... --cameras {out}")
    write_figures(file)
    return 0


def calibrate_footage(name: str, path: Path, target: Charuco, views: int) -> Calibration:
    """Calibrate one camera under progress bars. Raises GofError that names the footage."""
    stated = stated_frames(path) or 0
    with progress_bar(f"read {name}") as update:
        frames = (update(k, max(k, stated)) or frame for k, frame in enumerate(stored_frames(path, in_time=False), 1))
        pictures = sharpest(frames, stated if path.is_dir() else views)
    with progress_bar(f"find the target in {name}") as update:
        try:
            return calibrate(pictures, target, lambda done: update(done, len(pictures)))
        except GofError as e:
            raise GofError(f"{path}: {e}") from e


def describe(name: str, found: Calibration) -> str:
    """Return one line of figures."""
    (fx, _, cx), (_, fy, cy) = found.lens.K[:2]
    layout = ", target drawn as by OpenCV before 4.6" if found.old_layout else ""
    return (
        f"{name}: focal {fx:.1f}, {fy:.1f} +- {found.focal_sigma_px:.1f} px, centre {cx:.1f}, {cy:.1f}, "
        f"corners within {found.rms_px:.3f} px rms in {found.views} views over {found.coverage:.0%} of the picture"
        f"{layout}"
    )
