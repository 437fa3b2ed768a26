"""Score a finished result against a fire whose velocity is known, and draw its error frame by frame.

python docs/examples/score_a_result.py out
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import gof

out = Path(sys.argv[1])
gof.unpack_sample(out)

dataset = gof.open_dataset(out / "fire")
scores = gof.evaluate(out / "result", dataset, images=False)
print(f"L2 {scores.dve.l2:.3f}, cosine similarity {scores.dve.cos_sim:.3f}")
print(f"the best constant vector: L2 {scores.trivial_baselines['constant'].l2:.3f}")

frames = [frame for frame in scores.dve.frames if frame.l2 is not None]
plt.figure(figsize=(5, 3))
plt.plot([frame.time_s for frame in frames], [frame.l2 for frame in frames], marker="o")
plt.xlabel("time (s)")
plt.ylabel("relative L2 of velocity")
plt.axhline(scores.trivial_baselines["constant"].l2, color="grey", linestyle="--", label="the best constant vector")
plt.ylim(0, 1)
plt.legend()
plt.savefig(out / "score_a_result.png", dpi=120, bbox_inches="tight")
