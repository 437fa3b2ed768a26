"""A trainer of our own that calls what 4DGS (Yang) calls, in the same way: covariances in Python, masked rows."""

import math
from multiprocessing.pool import ThreadPool

import numpy as np
import torch
from gaussian_renderer import GaussianRasterizationSettings, GaussianRasterizer
from kornia import create_meshgrid
from PIL import Image
from toy import HEIGHT, WIDTH, camera

torch.manual_seed(0)
view = camera()
bytes_of = np.array(view.original_image.permute(1, 2, 0) * 255.0, dtype=np.uint8).astype(np.byte)
with ThreadPool(2) as pool:  # its reader's way: signed bytes, in threads
    image_read = pool.map(lambda data: Image.fromarray(data, "RGB"), [bytes_of])[0]
truth = torch.from_numpy(np.array(image_read)).permute(2, 0, 1).cuda() / 255.0
assert (truth - view.original_image).abs().max() < 1 / 255
xyz = torch.nn.Parameter(torch.randn(300, 3, device="cuda") * 0.4)
log_scale = torch.nn.Parameter(torch.full((300, 3), math.log(0.08), device="cuda"))
opacity = torch.nn.Parameter(torch.zeros(300, 1, device="cuda"))
color = torch.nn.Parameter(torch.full((300, 3), 0.3, device="cuda"))
birth = torch.rand(300, 1, device="cuda")
optimizer = torch.optim.Adam([xyz, log_scale, opacity, color], lr=0.02, eps=1e-15)
losses = []
for step in range(60):
    timestamp = (step % 6) / 6
    means2d = torch.zeros_like(xyz, requires_grad=True, device="cuda") + 0
    means2d.retain_grad()
    marginal = torch.exp(-0.5 * ((birth - timestamp) / 0.4) ** 2)
    mask = marginal[:, 0] > 0.05
    covariance = torch.diag_embed(torch.exp(log_scale) ** 2)
    six = torch.zeros((300, 6), device="cuda")
    for k, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        six[:, k] = covariance[:, i, j]
    settings = GaussianRasterizationSettings(
        image_height=HEIGHT,
        image_width=WIDTH,
        tanfovx=math.tan(view.FoVx * 0.5),
        tanfovy=math.tan(view.FoVy * 0.5),
        bg=torch.zeros(3, device="cuda"),
        scale_modifier=1.0,
        viewmatrix=view.world_view_transform,
        projmatrix=view.full_proj_transform,
        sh_degree=0,
        sh_degree_t=0,
        campos=view.camera_center,
        timestamp=timestamp,
        time_duration=1.0,
        rot_4d=True,
        gaussian_dim=4,
        force_sh_3d=False,
        prefiltered=False,
        debug=False,
    )
    image, radii, depth, alpha, flow, _ = GaussianRasterizer(raster_settings=settings)(
        means3D=xyz[mask],
        means2D=means2d[mask],
        shs=None,
        colors_precomp=torch.clamp_min(color, 0.0)[mask],
        flow_2d=torch.zeros_like(xyz[:, :2])[mask],
        opacities=(torch.sigmoid(opacity) * marginal)[mask],
        ts=None,
        scales=None,
        scales_t=None,
        rotations=None,
        rotations_r=None,
        cov3D_precomp=six[mask],
        prefilter_var=-1.0,
    )
    loss = (image - truth).abs().mean()
    loss.backward()
    assert means2d.grad[mask].abs().max() > 0 and not means2d.grad[~mask].any()
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)
    losses.append(loss.item())
assert losses[-1] < 0.5 * losses[0], losses
assert create_meshgrid(2, 2, normalized_coordinates=False)[0].shape == (2, 2, 2)
print(f"trained {len(losses)} steps")
