"""Read the result of any known method and look at its Gaussians as numpy arrays.

python docs/examples/read_a_result.py out
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import gof

out = Path(sys.argv[1])
gof.unpack_sample(out)

imported = gof.read_result(out / "result")  # a file or a folder; which method it is from is found out
flame = imported.gaussians
print(f"read as {imported.method}: {len(flame)} Gaussians")
for name in ("position", "velocity", "scale", "t_mu", "t_sigma", "opacity"):
    print(f"{name:<10}", getattr(flame, name).shape)

speed = (flame.velocity[:, 2], flame.position[:, 2])
plt.figure(figsize=(4, 4))
plt.plot(*speed, ".", markersize=1, alpha=0.3)
plt.xlabel("upward velocity (m/s)")
plt.ylabel("height (m)")
plt.savefig(out / "read_a_result.png", dpi=120, bbox_inches="tight")
