"""Type errors of the packages beside `gof`, counted: a change may only lower their numbers. `gof` itself has none.

python -m tools.count_type_errors
"""

from __future__ import annotations

import subprocess
import sys

from tools.import_graph import FOLDERS, ROOT

MOST = {"gof_benchmark": 69, "gof_blender": 212}  # lower them when errors go
NOT_COUNTED = "(evidence|training)/"  # not installed
PLACE = ROOT / "build" / "types"


def errors() -> list[str]:
    """Return mypy's errors; it finds a package by its folder's name, so links of the installed names stand in build."""
    PLACE.mkdir(parents=True, exist_ok=True)
    for name, folder in FOLDERS.items():
        if not (PLACE / name).exists():
            (PLACE / name).symlink_to(ROOT / folder, target_is_directory=True)
    words = ["--config-file=", "--follow-imports=silent", "--ignore-missing-imports", "--cache-dir=cache"]
    words += ["--exclude", NOT_COUNTED, *(word for name in MOST for word in ("-p", name))]
    done = subprocess.run([sys.executable, "-m", "mypy", *words], cwd=PLACE, capture_output=True, text=True)
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
