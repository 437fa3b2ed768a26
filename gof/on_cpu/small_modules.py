"""Stand-ins for small compiled, renamed or absent modules, one function each."""

from __future__ import annotations

import runpy
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
from scipy.spatial import cKDTree

from gof.core.errors import MissingDependencyError
from gof.render.ssim import C1, C2, REACH, SIGMA_PX


def stand_in(name: str, **contents: Any) -> ModuleType:
    """Return a module of this name that holds these contents."""
    found = ModuleType(name)
    vars(found).update(contents)
    return found


def simple_knn() -> ModuleType:
    """`simple_knn._C`: `distCUDA2`."""
    return stand_in("simple_knn._C", distCUDA2=mean_squared_distance)


def mean_squared_distance(points):
    """Return (N,) the mean of the squared distances from each of the points (N, 3) to its three nearest others."""
    place = points.detach().double().numpy()
    near = min(4, len(place))
    distance = cKDTree(place).query(place, k=near)[0].reshape(len(place), near)[:, 1:]
    return torch.as_tensor((distance**2).sum(1) / max(near - 1, 1)).to(points.dtype)


def fused_ssim() -> ModuleType:
    """`fused_ssim`: its function of the same name."""
    return stand_in("fused_ssim", fused_ssim=mean_ssim)


def mean_ssim(img1, img2, padding: str = "same", train: bool = True):
    """Return mean SSIM of pictures (B, C, H, W): 11 px Gaussian window, zeros outside; "valid" leaves 5 px at the edge
    out."""
    if padding not in ("same", "valid"):
        raise ValueError(f"fused_ssim: padding is '{padding}'; 'same' or 'valid'")
    channels = img1.shape[1]
    offset = torch.arange(-REACH, REACH + 1, dtype=img1.dtype)
    weight = torch.exp(-0.5 * (offset / SIGMA_PX) ** 2)
    weight = (weight / weight.sum()).repeat(channels, 1, 1, 1)

    def blur(image):
        across = torch.nn.functional.conv2d(image, weight, padding=(0, REACH), groups=channels)
        return torch.nn.functional.conv2d(across, weight.mT, padding=(REACH, 0), groups=channels)

    mean1, mean2 = blur(img1), blur(img2)
    var1, var2 = blur(img1 * img1) - mean1**2, blur(img2 * img2) - mean2**2
    both = blur(img1 * img2) - mean1 * mean2
    ssim = (2 * mean1 * mean2 + C1) * (2 * both + C2) / ((mean1**2 + mean2**2 + C1) * (var1 + var2 + C2))
    edge = REACH if padding == "valid" else 0
    return ssim[:, :, edge : ssim.shape[2] - edge, edge : ssim.shape[3] - edge].mean()


def mmcv() -> ModuleType:
    """`mmcv` of before version 2: `Config.fromfile`. (Its successor's package brings another OpenCV over ours.)"""
    return stand_in("mmcv", Config=stand_in("Config", fromfile=read_settings))


def read_settings(path) -> dict[str, Any]:
    """Return the names that a settings file in Python defines, over those of its `_base_` file or files.

    Dictionaries are merged name by name; one with `_delete_=True` replaces the older one.
    """
    defined = {name: value for name, value in runpy.run_path(str(path)).items() if not name.startswith("__")}
    bases = defined.pop("_base_", [])
    read: dict[str, Any] = {}
    for base in [bases] if isinstance(bases, str) else bases:
        read = _merged(read, read_settings(Path(path).parent / base))
    return _merged(read, {name: value for name, value in defined.items() if not isinstance(value, ModuleType)})


def _merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    merged = dict(old)
    for name, value in new.items():
        if isinstance(value, dict):
            rest = {key: entry for key, entry in value.items() if key != "_delete_"}
            older = merged.get(name)
            value = _merged(older if isinstance(older, dict) and not value.get("_delete_") else {}, rest)
        merged[name] = value
    return merged


def kornia() -> ModuleType:
    """`kornia`: `create_meshgrid` in pixels."""
    return stand_in("kornia", create_meshgrid=pixel_grid)


def pixel_grid(height: int, width: int, normalized_coordinates: bool = True, device=None, dtype=None):
    """Return (1, height, width, 2) x and y of every pixel, from 0."""
    if normalized_coordinates:
        raise ValueError("create_meshgrid: only normalized_coordinates=False is made here")
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([columns, rows], -1)[None].to(dtype or torch.float32)


class Unused(ModuleType):
    """A module that the script imports and does not use; using it is an error that says so."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Nothing(f"{self.__name__}.{name}")


class Nothing:
    """Something of an `Unused` module: it has a name and can be imported, no more."""

    def __init__(self, name: str):
        self._name = name

    def __call__(self, *args, **kwargs):
        raise MissingDependencyError(f"{self._name} has no stand-in; docs/baselines.md lists settings without it")

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Nothing(f"{self._name}.{name}")


class NoPerceptualLoss(torch.nn.Module):
    """LPIPS where its network's weights are not at hand: NaN as a score; in a loss, NaN would end the training."""

    def __init__(self, *args, **kwargs):
        super().__init__()

    def forward(self, *images):
        if torch.is_grad_enabled() and any(image.requires_grad for image in images):
            raise MissingDependencyError("LPIPS is left out (--without-lpips) and is no loss: set its weight to 0")
        return torch.tensor(float("nan"))

    update = forward

    def compute(self):
        return torch.tensor(float("nan"))

    def reset(self):
        pass
