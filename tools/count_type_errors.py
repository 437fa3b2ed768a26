"""Type errors of the packages beside `gof`, counted: a change may only lower their numbers. `gof` itself has none.

python -m tools.count_type_errors
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from tools.import_graph import FOLDERS, ROOT

MOST = {"gof_benchmark": 69, "gof_blender": 212}  # lower them when errors go
NOT_COUNTED = "(evidence|training)/"  # not installed
CACHE = ROOT / ".mypy_cache" / "beside"


def errors() -> list[str]:
    """Return mypy's errors; it finds a package by its folder's name, so links stand for the installed names."""
    words = ["--config-file=", "--follow-imports=silent", "--ignore-missing-imports", f"--cache-dir={CACHE}"]
    words += ["--exclude", NOT_COUNTED, *(word for name in MOST for word in ("-p", name))]
    with tempfile.TemporaryDirectory() as links:
        for name, folder in FOLDERS.items():
            (Path(links) / name).symlink_to(ROOT / folder, target_is_directory=True)
        done = subprocess.run([sys.executable, "-m", "mypy", *words], cwd=links, capture_output=True, text=True)
    if done.returncode > 1:
        raise SystemExit(done.stdout + done.stderr)
    return [line for line in done.stdout.splitlines() if ": error:" in line]


def main() -> int:
    """Compare each package's number with the most that it may have."""
    found, status = errors(), 0
    for name, most in MOST.items():
        own = [line for line in found if line.startswith(f"{name}/")]
        if len(own) > most:
            print("\n".join(own))
            status = 1
        print(f"{name}: {len(own)} type errors, at most {most}")
    return status


if __name__ == "__main__":
    sys.exit(main())
