"""Score an own method that is a function of time: nothing has to be written to a file first.

python docs/examples/my_own_method.py out
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import gof

out = Path(sys.argv[1])
gof.unpack_sample(out)
dataset = gof.open_dataset(out / "fire")

rng = np.random.default_rng(0)
start = rng.normal([0, 0, 0.4], [0.05, 0.05, 0.15], (2000, 3))  # m


def state(time_s: float) -> gof.State:
    """2000 Gaussians that rise at 1.5 m/s; put your own numbers here."""
    return gof.State(
        position=start + [0, 0, 1.5 * time_s],
        opacity=np.full(2000, 0.3),
        scale=np.full((2000, 3), 0.02),
        rotation=np.tile([1.0, 0, 0, 0], (2000, 1)),
    )


scores = gof.evaluate(gof.Motion(state), dataset, images=False)
print(f"L2 {scores.dve.l2:.3f}, cosine similarity {scores.dve.cos_sim:.3f}")

names = ["mine", *scores.trivial_baselines]
plt.figure(figsize=(5, 3))
plt.barh(names[::-1], [c.l2 for c in (scores.dve, *scores.trivial_baselines.values())][::-1])
plt.xlabel("relative L2 of velocity (lower is better)")
plt.savefig(out / "my_own_method.png", dpi=120, bbox_inches="tight")
