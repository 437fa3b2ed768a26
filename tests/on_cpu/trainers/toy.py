"""What the look-alike trainers share: a camera, a target picture, and cameras as row-vector matrices."""

import math
from types import SimpleNamespace

import torch

WIDTH, HEIGHT, FOV = 24, 32, 0.8


def camera():
    fovy = 2 * math.atan(math.tan(FOV / 2) * HEIGHT / WIDTH)
    view = torch.eye(4)
    view[2, 3] = 2.0
    near, far = 0.01, 100.0
    clip = torch.zeros(4, 4)
    clip[0, 0], clip[1, 1] = 1 / math.tan(FOV / 2), 1 / math.tan(fovy / 2)
    clip[2, 2], clip[2, 3], clip[3, 2] = far / (far - near), -far * near / (far - near), 1.0
    world_view = view.T.to("cuda")
    return SimpleNamespace(
        image_height=HEIGHT,
        image_width=WIDTH,
        FoVx=FOV,
        FoVy=fovy,
        world_view_transform=world_view,
        full_proj_transform=(world_view.unsqueeze(0).bmm(clip.T.unsqueeze(0).cuda())).squeeze(0),
        camera_center=world_view.inverse()[3, :3],
        original_image=target(),
    )


def target():
    y, x = torch.meshgrid(torch.linspace(-1, 1, HEIGHT), torch.linspace(-1, 1, WIDTH), indexing="ij")
    disc = torch.exp(-3 * (x**2 + (y - 0.2) ** 2))
    return torch.stack([disc, 0.6 * disc, 0.2 * disc]).to("cuda:0", non_blocking=True)
