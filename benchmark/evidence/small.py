"""How much work the reconstructions are that evidence compares with each other."""

from gof.reconstruct.presets import Effort

SMALL = Effort(iterations=800, gaussians=15_000, voxels=72, longest_side=160)
"""Under a minute each of two free cores on the demo."""
