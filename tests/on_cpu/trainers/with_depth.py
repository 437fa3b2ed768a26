"""A trainer of our own that calls what 4DGS (Wu) calls, in the same way: deformed Gaussians, a loader."""

import math
import sys
from tkinter import W

import mmcv
import open3d
import torch
from diff_gaussian_rasterization import GaussianRasterizationSettings, GaussianRasterizer
from simple_knn._C import distCUDA2
from torch.utils.data import DataLoader
from toy import camera

config = mmcv.Config.fromfile(sys.argv[1]) if len(sys.argv) > 1 else None
torch.cuda.empty_cache()
torch.manual_seed(0)
torch.cuda.manual_seed_all(0)
torch.cuda.set_device(torch.device("cuda:0"))
view = camera()
xyz = torch.nn.Parameter(torch.randn(200, 3, device="cuda") * 0.4)
scaling = torch.nn.Parameter(torch.log(torch.sqrt(distCUDA2(xyz.detach().float().cuda())))[..., None].repeat(1, 3))
rotation = torch.nn.Parameter(torch.tensor([1.0, 0, 0, 0], device="cuda").repeat(200, 1))
opacity = torch.nn.Parameter(torch.zeros(200, 1, device="cuda"))
features = torch.nn.Parameter(torch.zeros(200, 16, 3, device="cuda"))
network = torch.nn.Sequential(torch.nn.Linear(4, 16), torch.nn.ReLU(), torch.nn.Linear(16, 3)).to("cuda")
optimizer = torch.optim.Adam([xyz, scaling, rotation, opacity, features, *network.parameters()], lr=0.01, eps=1e-15)
background = torch.tensor([0, 0, 0], dtype=torch.float32, device="cuda")
begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
loader = iter(DataLoader([(view, k / 60) for k in range(60)], batch_size=1, num_workers=16, collate_fn=list))
losses, seen = [], torch.zeros(200, 1, device="cuda")
for batch in loader:
    begin.record()
    camera_now, time = batch[0]
    screenspace = torch.zeros_like(xyz, dtype=xyz.dtype, requires_grad=True, device="cuda") + 0
    screenspace.retain_grad()
    settings = GaussianRasterizationSettings(
        image_height=int(camera_now.image_height),
        image_width=int(camera_now.image_width),
        tanfovx=math.tan(camera_now.FoVx * 0.5),
        tanfovy=math.tan(camera_now.FoVy * 0.5),
        bg=background,
        scale_modifier=1.0,
        viewmatrix=camera_now.world_view_transform.cuda(),
        projmatrix=camera_now.full_proj_transform.cuda(),
        sh_degree=0,
        campos=camera_now.camera_center.cuda(),
        prefiltered=False,
        debug=False,
    )
    moved = xyz + 0.1 * network(torch.cat([xyz, torch.tensor(time).to(xyz.device).repeat(200, 1)], 1))
    image, radii, depth = GaussianRasterizer(raster_settings=settings)(
        means3D=moved,
        means2D=screenspace,
        shs=features,
        colors_precomp=None,
        opacities=torch.sigmoid(opacity),
        scales=torch.exp(scaling),
        rotations=torch.nn.functional.normalize(rotation),
        cov3D_precomp=None,
    )
    loss = (image - camera_now.original_image.cuda()).abs().mean()
    loss.backward()
    visible = radii > 0
    seen[visible] += torch.norm(screenspace.grad[visible, :2], dim=-1, keepdim=True)
    end.record()
    assert begin.elapsed_time(end) >= 0 and torch.cuda.max_memory_allocated() > 0
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)
    losses.append(loss.item())
assert seen.max() > 0 and depth.max() > 0
assert losses[-1] < 0.5 * losses[0], losses
torch.save(network.state_dict(), "network.pth")
network.load_state_dict(torch.load("network.pth", map_location="cuda"))
print(f"trained {len(losses)} steps", W is not None, open3d is not None)
