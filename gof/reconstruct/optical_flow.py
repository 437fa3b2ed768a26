"""Dense optical flow between two pictures: methods of OpenCV, or MEMFOF from local weights, behind one call.

A method is a function of two pictures (H, W) uint8 that returns the flow from the first to the second, (H, W, 2) px.
What each is worth on flames, and costs, is in docs/reconstruction.md.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from gof.errors import DataFormatError, GofError

Flow = Callable[[np.ndarray, np.ndarray], np.ndarray]
FlowName = Literal["dis", "deepflow", "tvl1", "memfof"]


def dis(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """DIS (Kroeger et al. 2016). Its patches are mean-normalised, which takes flicker out."""
    return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(first, second, None)


def deepflow(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """DeepFlow's variational part (Weinzaepfel et al. 2013), as OpenCV has it.

    Its directions are right, small motions come out up to a third too short.
    """
    return cv2.optflow.createOptFlow_DeepFlow().calc(first, second, None)


def tvl1(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Dual TV-L1 (Zach et al. 2007)."""
    return cv2.optflow.createOptFlow_DualTVL1().calc(first, second, None)


def memfof(folder: Path) -> Flow:
    """MEMFOF (Bargatin et al. 2025), the paper's choice, on the GPU where PyTorch has one.

    Args:
        folder: holds config.json and model.safetensors of one of its checkpoints.
    Raises:
        GofError: the package `memfof` or PyTorch is not installed.   DataFormatError: no such weights in folder.
    """
    try:
        import torch
        from memfof import MEMFOF
    except ImportError as e:
        raise GofError(
            "--flow memfof needs PyTorch and the package memfof of its authors (github.com/msu-video-group/memfof), "
            f"which are not installed here ({e}); --flow dis needs nothing"
        ) from e
    missing = [name for name in ("config.json", "model.safetensors") if not (folder / name).is_file()]
    if missing:
        raise DataFormatError(
            f"{folder}: {' and '.join(missing)} missing; put the files of a MEMFOF checkpoint there (--flow-weights)"
        )
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model = MEMFOF.from_pretrained(str(folder), backbone_weights=None, local_files_only=True).eval().to(device)

    def flow(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        # It looks at three frames and both ways from the middle one: here at the same frame twice.
        frames = torch.from_numpy(np.stack([second, first, second])).to(device, torch.float32)
        with torch.inference_mode():
            both = model(frames[None, :, None].expand(-1, -1, 3, -1, -1))["flow"][-1][0]
        return both.mean(0).permute(1, 2, 0).cpu().numpy()

    return flow


def flow_method(name: FlowName, weights: Path | None = None) -> Flow:
    """The method of that name; weights is the folder of MEMFOF's checkpoint.

    Raises:
        GofError: it cannot run here, and what is missing.
    """
    if name != "memfof":
        return {"dis": dis, "deepflow": deepflow, "tvl1": tvl1}[name]
    if weights is None:
        raise GofError(
            "--flow memfof needs --flow-weights, the folder with config.json and model.safetensors of its checkpoint"
        )
    return memfof(weights)
