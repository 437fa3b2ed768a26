"""Dense optical flow between two pictures: methods of OpenCV, or MEMFOF from local weights, behind one call.

notebook/choices.md says what each is worth on flames, and costs.
"""

from __future__ import annotations

from pathlib import Path
from threading import Lock
from typing import Any, Literal, Protocol

import cv2
import numpy as np

from gof.core.errors import DataFormatError, GofError

FlowName = Literal["dis", "deepflow", "tvl1", "memfof"]


class FlowMethod(Protocol):
    """A way to find optical flow; several threads may call it at once."""

    def __call__(self, first: np.ndarray, second: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
        """(H, W, 2) px from the first picture to the second.

        Args:
            first, second: (H, W) or (H, W, 3) RGB uint8.
            before: the picture as long before the first as the second is after it, for methods that look at three; None
                where there is none.
        """


def dis(first: np.ndarray, second: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """DIS (Kroeger et al. 2016). Its patches are mean-normalised, which takes flicker out."""
    return _by_opencv(cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM), first, second)


def deepflow(first: np.ndarray, second: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """DeepFlow's variational part (Weinzaepfel et al. 2013), as OpenCV has it.

    Its directions are right, small motions come out up to a third too short.
    """
    return _by_opencv(cv2.optflow.createOptFlow_DeepFlow(), first, second)


def tvl1(first: np.ndarray, second: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """Dual TV-L1 (Zach et al. 2007)."""
    return _by_opencv(cv2.optflow.createOptFlow_DualTVL1(), first, second)


def _by_opencv(method: Any, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return method.calc(_grey(first), _grey(second), None)  # OpenCV's own types do not know that None starts from rest


def _grey(picture: np.ndarray) -> np.ndarray:
    return picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)


def memfof(folder: Path) -> FlowMethod:
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
    alone = Lock()  # the pictures of one call can fill a GPU's memory

    def flow(first: np.ndarray, second: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
        # It looks at three consecutive frames and both ways from the middle one; a clip begins with its first frame
        # twice (authors of the paper).
        frames = [_rgb(picture) for picture in (first if before is None else before, first, second)]
        with alone, torch.inference_mode():
            clip = torch.from_numpy(np.stack(frames)).permute(0, 3, 1, 2).to(device, torch.float32)
            ahead = model(clip[None])["flow"][-1][0, 1]
            return ahead.permute(1, 2, 0).cpu().numpy()

    return flow


def _rgb(picture: np.ndarray) -> np.ndarray:
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, -1)


def flow_method(name: FlowName, weights: Path | None = None) -> FlowMethod:
    """Return the method of that name; weights is the folder of MEMFOF's checkpoint.

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
