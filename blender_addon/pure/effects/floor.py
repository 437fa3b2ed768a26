"""Floor: the bottom of the domain is a solid ground, as under most real fires.

Without it all six sides of the domain are open, and the rising flame draws air in through the bottom too: the gas
already rises when it comes to the burner.
"""

from __future__ import annotations

from dataclasses import dataclass

CHANGES_BAKE = True


@dataclass(frozen=True)
class Settings:
    pass
