"""Draw Gaussians with gsplat's call and fit them to a picture with PyTorch, on the CPU.

python docs/examples/optimise_with_torch.py out
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import gof

out = Path(sys.argv[1])
gof.unpack_sample(out)
dataset = gof.open_dataset(out / "fire")
camera, picture = dataset.cameras[1], dataset.image(1, 0)  # (H, W, 3) in 0..1

torch.manual_seed(0)
means = torch.randn(3000, 3) * torch.tensor([0.1, 0.1, 0.25]) + torch.tensor([0, 0, 0.4])  # (N, 3) m
means.requires_grad_()
log_scales = torch.full((3000, 3), -4.0, requires_grad=True)
logits = torch.full((3000,), -2.0, requires_grad=True)
colors = torch.full((3000, 3), 0.5, requires_grad=True)
quats = torch.tensor([[1.0, 0, 0, 0]]).expand(3000, 4)
viewmats = torch.tensor(camera.world_to_camera, dtype=torch.float32)[None]  # (C, 4, 4)
Ks = torch.tensor(camera.K, dtype=torch.float32)[None]  # (C, 3, 3) px
target, plate = torch.tensor(picture), torch.tensor(dataset.static(1))

optimizer = torch.optim.Adam([means, log_scales, logits, colors], lr=0.01)
for step in range(100):
    image, alpha, info = gof.render.rasterize(
        means, quats, log_scales.exp(), logits.sigmoid(), colors, viewmats, Ks, camera.width, camera.height
    )
    drawn = image[0] + (1 - alpha[0]) * plate  # (H, W, 3)
    loss = (drawn - target).abs().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    if step % 25 == 0:
        print(f"step {step:3d}: L1 {loss.item():.4f}")
print(f"      end: L1 {loss.item():.4f}")
side_by_side = np.concatenate([picture, drawn.detach().numpy()], axis=1)
Image.fromarray((255 * side_by_side.clip(0, 1)).round().astype(np.uint8)).save(out / "optimise_with_torch.png")
