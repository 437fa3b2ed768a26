"""`gof capture`: lists its parts and loads only the part that is run."""

from __future__ import annotations

from gof.commands import run_part

PARTS = {
    "board": ("gof.commands.capture_board", "find, set, start, stop, test and monitor the LED board"),
    "sync": (
        "gof.commands.capture_sync",
        "footage of the board -> the time of every row of every frame (times.json, plots)",
    ),
    "calibrate": ("gof.commands.capture_calibrate", "footage of the ChArUco target -> intrinsics of every camera"),
    "check-footage": ("gof.commands.capture_check_footage", "films of a fire -> what will spoil them, in a minute"),
    "annotate": ("gof.commands.capture_annotate", "dataset of gof ingest -> soft masks of the board"),
    "draw": ("gof.commands.capture_draw", "LED board template -> printable SVG"),
    "target": ("gof.commands.capture_target", "ChArUco target -> printable PDF or SVG"),
}

HELP = """\
gof capture - the camera rig: LED board, sub-frame times from footage, calibration.

usage: gof capture PART [OPTIONS]        gof capture PART --help explains one part

{parts}

a session:
  gof capture target --out charuco.pdf                        print at 100 %, glue on something flat
  gof capture calibrate c0.mp4 c1.mp4 c2.mp4 --out cameras.json
  gof capture board find
  gof capture board start                                     the board runs; film it with every camera
  gof capture check-footage cam_0.mp4 cam_1.mp4 cam_2.mp4     is it worth the work? while you can film again
  gof capture sync cam_0.mp4 cam_1.mp4 cam_2.mp4 --out sync   sync/times.json, sync/residuals_cam_0.png ...
  gof ingest cam_0.mp4 cam_1.mp4 cam_2.mp4 --times sync/times.json --cameras cameras.json --out data/fire
  gof reconstruct data/fire --out out/fire
"""


def main(argv: list[str]) -> int:
    """Run one part of `gof capture`."""
    return run_part("capture", PARTS, HELP, argv)
