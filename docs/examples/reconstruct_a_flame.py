"""Reconstruct a flame from its three videos, and look at it from the middle camera.

python docs/examples/reconstruct_a_flame.py out     # a minute on two CPU cores
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import gof

out = Path(sys.argv[1])
gof.unpack_sample(out)
dataset = gof.open_dataset(out / "fire")

reconstruction = gof.reconstruct(dataset, out / "flame", preset="preview", steps=300, gaussians=6000)
flame = gof.read_result(reconstruction.path).gaussians
print(f"{len(flame)} Gaussians, rising at {np.median(flame.velocity[flame.dynamic, 2]):.2f} m/s")

camera, frame = dataset.cameras[1], dataset.test_frames[0]
drawn = gof.render.render(flame, camera, time_s=dataset.times_s[frame], background=dataset.static(1))
side_by_side = np.concatenate([dataset.image(1, frame), drawn["color"]], axis=1)
Image.fromarray((255 * side_by_side.clip(0, 1)).round().astype(np.uint8)).save(out / "reconstruct_a_flame.png")
