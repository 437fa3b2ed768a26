"""Fine noise: Mantaflow's curl noise adds detail to flame and smoke below the cell size of the flow.

Kim et al. 2008, "Wavelet Turbulence for Fluid Simulation": the curl of a wavelet noise, which has no divergence, as
strong as the flow's small eddies and carried along by it. The velocity stays that of the coarse grid: the added detail
moves with it, but its own swirl is not in the ground truth. `gof_benchmark.evidence.noise_truth` measures how much.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...core.checked_json import require

CHANGES_BAKE = True
BEYOND_VELOCITY = True


@dataclass(frozen=True)
class Settings:
    scale: int = 2
    """Cells of detail per cell of the flow, along each side."""
    strength: float = 1.0
    """Strength of the noise."""
    size: float = 2.0
    """Size of the largest swirl, in cells of the flow."""

    def __post_init__(self):
        require(2 <= self.scale <= 8, "effects.fine_noise.scale", "between 2 and 8", self.scale)
