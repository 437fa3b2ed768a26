"""How real are these fires? `python -m gof_benchmark.solvers.how_real GRIDS...` compares them with known laws."""

from __future__ import annotations

import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from gof.errors import GofError
from gof.files import write_json
from gof_benchmark.solvers.grids import FireGrids
from gof_benchmark.solvers.physics import Plausibility, plausibility


@dataclass
class HowReal:
    """Print each fire's speed, flame height, puffing and heat beside what real fires are known to do.

    The laws and their sources: `gof_benchmark/solvers/physics.py`. They are of free pool fires in still air: a jet
    and a fire in wind leave them for a reason, and the table then says by how much.
    """

    grids: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of fires (schema gof-fire), for example fires/pool_methane/grids."""
    json: Path | None = None
    """Also write the table to this file."""


def table(rows: list[Plausibility]) -> str:
    """Markdown: one line a fire."""
    head = (
        "fire",
        "heat / nominal, kW",
        "axis speed / McCaffrey",
        "its exponent (0.5)",
        "plateau / McCaffrey",
        "light's speed / McCaffrey",
        "its exponent",
        "flame height (Heskestad), m",
        "puffing (1.5/sqrt(D)), Hz",
        "hottest, K",
        "fastest, m/s",
        "CPU s",
    )
    lines = [" | ".join(head), " | ".join("---" for _ in head)]
    for r in rows:
        cells = (
            r.name,
            f"{r.heat_kw:.1f} / {r.heat_nominal_kw:.1f}",
            f"{r.rise_ratio:.2f}",
            f"{r.rise_exponent:.2f}",
            f"{r.plateau_ratio:.2f}",
            f"{r.light_ratio:.2f}",
            f"{r.light_exponent:.2f}",
            f"{r.height_m:.2f} ({r.height_law_m:.2f})",
            f"{r.puffing_hz:.1f} +- {r.puffing_resolution_hz / 2:.1f} ({r.puffing_law_hz:.1f})",
            f"{r.hottest_k:.0f}",
            f"{r.fastest_m_s:.1f}",
            f"{r.cpu_s:.0f}",
        )
        lines.append(" | ".join(cells))
    return "\n".join(f"| {line} |" for line in lines)


def main(argv: list[str] | None = None) -> int:
    config = tyro.cli(HowReal, prog="python -m gof_benchmark.solvers.how_real", args=argv)
    try:
        rows = [plausibility(FireGrids.open(path)) for path in config.grids]
    except (GofError, ValueError) as e:
        print(f"how_real: {e}", file=sys.stderr)
        return 1
    print(table(rows))
    if config.json:
        finite = [
            {k: v if v == v and v not in (math.inf, -math.inf) else None for k, v in asdict(r).items()} for r in rows
        ]
        write_json(config.json, {"schema": "gof-how-real", "version": 1, "fires": finite})
    return 0


if __name__ == "__main__":
    sys.exit(main())
