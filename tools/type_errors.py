"""Count mypy's errors in `gof` (but `gof/render`, whose kernels no checker understands): the count may only fall.

python tools/type_errors.py          fail if a room has more errors than type_errors.json says, or a strict file any
python tools/type_errors.py --write  write the counts down, after mending some
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COUNTS = ROOT / "tools" / "type_errors.json"
STRICT = re.compile(  # not one error: scoring and the clocks of cameras
    r"gof/(evaluate/(scoring|scores|sequence|dve_frame|emission|expectation|grid_quadrature|quadrature|image|depth"
    r"|image_scores|intervals|leaderboard|authors_figures|trivial_baselines|eddy_time)|capture/sync)\.py"
)
ERROR = re.compile(r"^(gof/[\w/]+\.py):\d+: error: ")


def errors() -> list[str]:
    """Return mypy's errors, a line each (the rules: [tool.mypy] in pyproject.toml)."""
    done = subprocess.run([sys.executable, "-m", "mypy"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise SystemExit(f"mypy failed:\n{done.stdout}{done.stderr}")
    return [line for line in done.stdout.splitlines() if ERROR.match(line)]


def by_room(lines: list[str]) -> dict[str, int]:
    """Return the number of errors of each room."""
    return dict(sorted(Counter("/".join(line.split("/")[:2]) for line in lines).items()))


def complaints(lines: list[str], allowed: dict[str, int]) -> list[str]:
    """Return the places that got worse: errors of strict files, and rooms with more errors than written down."""
    found = [line for line in lines if STRICT.match(line)]
    for room, count in by_room(lines).items():
        if count > allowed.get(room, 0):
            own = [line for line in lines if line.startswith(f"{room}/")]
            found += [*own, f"{room}: {count} type errors, {allowed.get(room, 0)} are allowed (tools/type_errors.json)"]
    return found


def main() -> int:
    """Compare, or write down."""
    lines = errors()
    if "--write" in sys.argv[1:]:
        COUNTS.write_text(json.dumps(by_room(lines), indent=1) + "\n", encoding="utf-8")
    worse = complaints(lines, json.loads(COUNTS.read_text(encoding="utf-8")))
    print(
        "\n".join([*worse, f"{len(lines)} type errors in gof; python tools/type_errors.py --write after mending some"])
    )
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
