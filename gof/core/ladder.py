"""The ladder of presets: five names for how much work something is, the same in every command that has presets.

Each has a table of its own for what a name means: `gof_blender.pure.presets` for a dataset,
`gof.reconstruct.presets` for a reconstruction, `gof_benchmark.suite` for the benchmark; docs/presets.md has all of it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Literal, TypeVar, get_args

from .errors import GofError

Rung = Literal["toy", "preview", "standard", "large", "full"]
LADDER: tuple[Rung, ...] = get_args(Rung)
METAVAR = "|".join(LADDER)
FORMER = {"paper": "full"}  # old name -> rung, for one version

T = TypeVar("T")


def preset(name: str, known: Mapping[str, T], former: Mapping[str, T]) -> T:
    """Return the meaning of a name of the ladder; an old name works too, with a note on the error stream.

    Args:
        known: by rung.   former: by a name that is no rung any more, for one version.
    Raises:
        GofError: there is no such preset.
    """
    if name in FORMER:
        print(
            f"--preset {name} is now --preset {FORMER[name]}; the old name goes with the next version", file=sys.stderr
        )
        name = FORMER[name]
    if name in former:
        print(f"--preset {name} goes with the next version; there are {', '.join(LADDER)}", file=sys.stderr)
        return former[name]
    if name not in known:
        raise GofError(f"--preset {name}: there are {', '.join(LADDER)}")
    return known[name]
