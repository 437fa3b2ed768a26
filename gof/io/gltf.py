"""GLB with the glTF extension KHR_gaussian_splatting: the Gaussians of an instant, and how they move (docs/formats.md).

glTF's world has Y up: (x, y, z) here is (x, z, -y) there. Everything is turned before it is written, harmonics too, so
that no viewer has to. The format follows the extension's published text (release candidate of 2026).
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

import gof
from gof.core.colour import srgb_to_linear
from gof.core.errors import DataFormatError, require_finite
from gof.core.files import atomic_path
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0, plain_color
from gof.core.similarity import Y_UP

EXTENSION = "KHR_gaussian_splatting"
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
FLOAT, UNSIGNED_SHORT = 5126, 5123
ARRAY_BUFFER, POINTS = 34962, 0
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


def save(gaussians: TransientGaussians, path: Path, time_s: float, source: str = "") -> list[str]:
    """Write all Gaussians in their state at a time, with what is needed to move them to any other.

    Args:
        time_s: seconds on the dataset clock.   source: how the result was made.
    Returns:
        Notes on what a viewer that keeps to the extension's text will draw otherwise than `gof.render`, in words.
    Raises:
        DataFormatError: there is no Gaussian.   NonFiniteError: a value is beyond what a float32 can hold.
    """
    if not len(gaussians):
        raise DataFormatError(f"{path}: the result holds no Gaussian, and glTF allows no empty list of points")
    g = gaussians.transformed(Y_UP)
    columns = _columns(g, time_s)
    for name, values in columns.items():
        require_finite(name, values, "a GLB of float32")
    accessors: list[dict[str, Any]] = []
    views: list[dict[str, int]] = []
    attributes: dict[str, int] = {}
    parts, start = [], 0
    for name, values in columns.items():
        data = np.ascontiguousarray(values).tobytes()
        attributes[name] = len(accessors)
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(data), "target": ARRAY_BUFFER})
        accessors.append(_accessor(name, values, len(views) - 1))
        parts.append(data)
        start += len(data)
    primitive = {
        "attributes": attributes,
        "mode": POINTS,
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
        "extras": {"transient": {"version": 1, "time_s": float(time_s)} | ({"emissive": True} if g.emissive else {})},
    }
    content = {
        "asset": {"version": "2.0", "generator": f"gof {gof.__version__}"}
        | ({"extras": {"source": source}} if source else {}),
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "flame"}],
        "meshes": [{"primitives": [primitive], "name": "transient Gaussians"}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
    with atomic_path(path) as temporary:
        temporary.write_bytes(_glb(content, b"".join(parts)))
    return _losses(gaussians)


def _columns(g: TransientGaussians, time_s: float) -> dict[str, np.ndarray]:
    """Attributes by name, each (N,) or (N, K); every row is a whole number of four bytes."""
    position, opacity = g.at(time_s)
    sh = (g.color[:, None] - 0.5) / C0 if g.color.ndim == 2 else g.color
    harmonics = {
        f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{m}": sh[:, degree**2 + m].astype("<f4")
        for degree in range(round(sh.shape[1] ** 0.5))
        for m in range(2 * degree + 1)
    }
    rotation = g.rotation.astype(np.float64)
    rotation /= np.linalg.norm(rotation, axis=-1, keepdims=True)
    fallback = np.column_stack([srgb_to_linear(np.clip(plain_color(g.color), 0, 1)), opacity])
    always = ~(g.dynamic & np.isfinite(g.t_sigma))
    return {
        "POSITION": position.astype("<f4"),
        "COLOR_0": np.rint(np.clip(fallback, 0, 1) * 65535).astype("<u2"),
        f"{EXTENSION}:ROTATION": rotation[:, [1, 2, 3, 0]].astype("<f4"),
        f"{EXTENSION}:SCALE": g.scale.astype("<f4"),
        f"{EXTENSION}:OPACITY": opacity.astype("<f4"),
        **harmonics,
        "_VELOCITY": np.where(g.dynamic[:, None], g.velocity, 0).astype("<f4"),
        **({} if g.gas_velocity is None else {"_GAS_VELOCITY": g.moving_gas.astype("<f4")}),
        "_T_MU": np.where(always, 0, g.t_mu).astype("<f4"),
        "_T_SIGMA": np.where(always, 0, g.t_sigma).astype("<f4"),
        "_PEAK_OPACITY": g.opacity.astype("<f4"),
    }


def _accessor(name: str, values: np.ndarray, view: int) -> dict[str, Any]:
    short = values.dtype.itemsize == 2
    accessor = {
        "bufferView": view,
        "componentType": UNSIGNED_SHORT if short else FLOAT,
        "count": len(values),
        "type": TYPES[1 if values.ndim == 1 else values.shape[1]],
    }
    if short:
        accessor["normalized"] = True
    if name == "POSITION":  # glTF asks for its bounds
        accessor |= {"min": values.min(0).astype(float).tolist(), "max": values.max(0).astype(float).tolist()}
    return accessor


def _glb(content: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<III", MAGIC, 2, 12 + len(chunks)) + chunks


def _losses(g: TransientGaussians) -> list[str]:
    """Return the extension's text has colours below 0 drawn as 0; what optimisation made darker than black is lost."""
    dark = (plain_color(g.color) < 0).any(-1).mean()
    return (
        [f"{dark:.0%} of the Gaussians have a colour below 0, which KHR_gaussian_splatting draws as 0"] if dark else []
    )
