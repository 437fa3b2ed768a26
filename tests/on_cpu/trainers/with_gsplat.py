"""A trainer of our own that calls what FreeTimeGsVanilla calls, in the same way: gsplat packed."""

import torch
from fused_ssim import fused_ssim
from gsplat.rendering import rasterization
from torchmetrics.image.lpip import LearnedPerceptualImagePatchSimilarity
from toy import FOV, HEIGHT, WIDTH, target

assert torch.cuda.is_available() and torch.cuda.device_count() == 1
device = "cuda:0"
torch.manual_seed(0)
lpips = LearnedPerceptualImagePatchSimilarity(net_type="alex", normalize=True).to(device)
focal = WIDTH / 2 / torch.tan(torch.tensor(FOV / 2))
Ks = torch.tensor([[[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1.0]]], device=device)
poses = torch.eye(4, device=device)[None].clone()
poses[0, 2, 3] = -2.0
values = {
    "means": torch.randn(300, 3) * 0.4,
    "quats": torch.rand(300, 4),
    "scales": torch.full((300, 3), -2.5),
    "opacities": torch.zeros(300),
    "sh0": torch.zeros(300, 1, 3),
    "shN": torch.zeros(300, 15, 3),
}
splats = torch.nn.ParameterDict({k: torch.nn.Parameter(v) for k, v in values.items()}).to(device)
optimizers = {k: torch.optim.Adam([{"params": splats[k], "lr": 0.02, "name": k}], eps=1e-15) for k in splats}
pixels = target().permute(1, 2, 0)[None]
grad2d, losses = torch.zeros(300, device=device), []
for step in range(60):
    image, alphas, info = rasterization(
        means=splats["means"],
        quats=splats["quats"],
        scales=torch.exp(splats["scales"]),
        opacities=torch.clamp(torch.sigmoid(splats["opacities"]), min=1e-4),
        colors=torch.cat([splats["sh0"], splats["shN"]], 1),
        viewmats=torch.linalg.inv(poses),
        Ks=Ks,
        width=WIDTH,
        height=HEIGHT,
        packed=True,
        sh_degree=min(step // 20, 3),
        near_plane=0.01,
        far_plane=1e10,
        absgrad=False,
        rasterize_mode="classic",
    )
    info["means2d"].retain_grad()
    ssim = fused_ssim(image.permute(0, 3, 1, 2), pixels.permute(0, 3, 1, 2), padding="valid")
    loss = 0.8 * torch.nn.functional.l1_loss(image, pixels) + 0.2 * (1 - ssim)
    loss.backward()
    grads = info["means2d"].grad.clone()
    grads[..., 0] *= info["width"] / 2.0 * info["n_cameras"]
    grad2d.index_add_(0, info["gaussian_ids"], grads.norm(dim=-1))
    assert len(info["radii"].max(dim=-1).values) == len(grads)
    for optimizer in optimizers.values():
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
    losses.append(loss.item())
assert grad2d.max() > 0
assert losses[-1] < 0.5 * losses[0], losses
with torch.no_grad():
    assert torch.isnan(lpips(image, pixels))
print(f"trained {len(losses)} steps")
