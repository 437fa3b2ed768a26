"""Image files of the dataset, through the OpenImageIO library that Blender ships."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np

from ..core.files import atomic_path

try:
    import OpenImageIO as oiio
except ModuleNotFoundError:  # the bpy wheel does not put Blender's own Python packages on the path
    python = Path(bpy.__file__).resolve().parents[3] / "python" / "lib"
    sys.path.extend(str(folder) for folder in [*python.glob("python3*/site-packages"), python / "site-packages"])
    import OpenImageIO as oiio

EXPANSION = 2100  # deflate packs zeros 1032 times, and halves become floats
EXR_CHANNELS = ("R", "G", "B", "A", "Z", "flame.R", "flame.G", "flame.B")


MEDIA = {"OPEN_EXR_MULTILAYER": "MULTI_LAYER_IMAGE", "FFMPEG": "VIDEO"}


def set_format(settings: bpy.types.ImageFormatSettings, file_format: str) -> None:
    """Choose the file format of renders; from Blender 5.0 on its kind of media has to be chosen first."""
    if hasattr(settings, "media_type"):
        settings.media_type = MEDIA.get(file_format, "IMAGE")
    settings.file_format = file_format


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Channels of an EXR by name, each float32 (H, W). Raises OSError if the file cannot be read."""
    pixels, names = _read(path)
    return {name: pixels[..., index] for index, name in enumerate(names)}


def write_exr(path: Path, beauty: np.ndarray, depth: np.ndarray, flame: np.ndarray) -> None:
    """Write one image in the dataset's layout, atomically.

    Args:
        beauty: (H, W, 4) linear RGBA.
        depth: (H, W) distance along the viewing direction in metres, 1e10 where nothing is.
        flame: (H, W, 3) light emitted by the flame alone, linear.
    Colours are stored as half, depth as float.
    """
    pixels = np.concatenate([np.clip(beauty, -65504, 65504), depth[..., None], np.clip(flame, -65504, 65504)], axis=-1)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], oiio.HALF)
    spec.channelnames = EXR_CHANNELS
    spec.channelformats = tuple(oiio.TypeDesc("float" if name == "Z" else "half") for name in EXR_CHANNELS)
    spec.attribute("compression", "zip")
    _write(path, spec, pixels)


def write_flow_exr(path: Path, flow: np.ndarray, weight: np.ndarray) -> None:
    """Write optical flow (H, W, 2) in pixels per frame, right and down, and its weight (H, W), as float, atomically."""
    pixels = np.concatenate([flow, weight[..., None]], axis=-1).astype(np.float32)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, oiio.FLOAT)
    spec.channelnames = ("flow.X", "flow.Y", "weight")
    spec.attribute("compression", "zip")
    _write(path, spec, pixels)


def write_mask_png(path: Path, mask: np.ndarray) -> None:
    """Write an (H, W) boolean mask as 8-bit grey, 255 where true, atomically."""
    spec = oiio.ImageSpec(mask.shape[1], mask.shape[0], 1, oiio.UINT8)
    _write(path, spec, (mask * np.uint8(255))[..., None])


def read_png(path: Path) -> np.ndarray:
    """Return (H, W, C) uint8. Raises OSError if the file cannot be read."""
    pixels, _ = _read(path, oiio.UINT8)
    return pixels


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write (H, W, 3) uint8, atomically."""
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], oiio.UINT8)
    _write(path, spec, pixels)


def opens(path: Path) -> bool:
    """Return whether an image file exists and every pixel of it can be decoded to a finite value."""
    if not path.is_file():
        return False
    try:
        pixels, _ = _read(path)
    except OSError:
        return False
    return bool(np.isfinite(pixels).all())


def _read(path: Path, kind=oiio.FLOAT) -> tuple[np.ndarray, list[str]]:
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise OSError(f"{path}: {oiio.geterror()}")
    parts, names = [], []
    try:
        while image.seek_subimage(len(parts), 0):  # Blender 5.0 on writes one part a pass, of equal sizes
            if image.spec().image_pixels() * image.spec().nchannels * 4 > EXPANSION * path.stat().st_size:
                raise OSError(
                    f"{path}: announces {image.spec().width}x{image.spec().height} pixels, more than the file can hold"
                )
            parts.append(image.read_image(len(parts), 0, 0, image.spec().nchannels, kind))
            if parts[-1] is None:
                raise OSError(f"{path}: {image.geterror()}")
            try:
                names += image.spec().channelnames
            except UnicodeDecodeError as error:
                raise OSError(f"{path}: names of its channels are damaged ({error})") from error
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1), names
    finally:
        image.close()


def _write(path: Path, spec: oiio.ImageSpec, pixels: np.ndarray) -> None:
    with atomic_path(path) as draft:
        image = oiio.ImageOutput.create(str(draft))
        if image is None:
            raise OSError(f"{path}: {oiio.geterror()}")
        done = image.open(str(draft), spec) and image.write_image(np.ascontiguousarray(pixels))
        done = image.close() and done
        if not done:
            raise OSError(f"{path}: {image.geterror()}")
