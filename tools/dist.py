"""Make what a release offers: wheel, source archive, the add-on's zip and the sample, with SHA256SUMS.

    python tools/dist.py [--out DIR]          what `make dist` runs; needs setuptools 77 or newer

Wheel and zips have the same bytes each time.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import build_addon
import install_matrix

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "gof/sample/sample.zip"  # for who has Blender and no gof


def make(folder: Path) -> list[Path]:
    """Write the files of a release into `folder`; they, and SHA256SUMS last."""
    os.environ["SOURCE_DATE_EPOCH"] = time_of_last_change()  # the times in the archives
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        built = [Path(shutil.move(path, folder / path.name)) for path in install_matrix.build(Path(work))]
    built.append(build_addon.build(folder))
    sample = folder / f"{build_addon.NAME}_sample-{build_addon.version()}.zip"
    built.append(Path(shutil.copyfile(SAMPLE, sample)))
    sums = folder / "SHA256SUMS"
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(built)]
    sums.write_text("".join(lines), encoding="utf-8")
    return [*sorted(built), sums]


def time_of_last_change() -> str:
    done = subprocess.run(["git", "log", "-1", "--format=%ct"], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the files")
    for path in make(parser.parse_args().out):
        print(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
