"""Damage to files, random but repeatable: what disks, networks, editors and enemies do to them."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

NUMBERS = (
    0,
    1,
    -1,
    255,
    2**31 - 1,
    2**32,
    2**63,
    10**18,
    -(10**18),
    0.5,
    1e-320,
    3e38,
    1e300,
    float("nan"),
    float("inf"),
    -float("inf"),
)
STRINGS = (
    "",
    "x",
    "x" * 5000,
    "NaN",
    "1e999",
    "../../../etc/passwd",
    "/etc/passwd",
    "a\0b",
    "\ud800",
    "{frame:0999999999d}",
    "{other}",
    "{frame.real.imag}",
    "{",
    "ü",
)
VALUES = (*NUMBERS, *STRINGS, None, True, [], {}, [[]], [1, "a", None], {"name": 3})
TYPES = ("<f2", "<f8", ">f4", "<i8", "|u1", "|b1", "<c8", "<U4", "|S3", "<M8[s]", "|V7", "|O")
SHAPES = ((), (0,), (1,), (10**18, 3), (2**28, 3), (2**63, 2**63), (3, 0, 2**62), (2,) * 40)


@dataclass(frozen=True)
class Instead:
    """What stands where a file was: a "link", a "folder", a "pipe", or "nothing"."""

    kind: Literal["link", "folder", "pipe", "nothing"]
    target: str = ""  # of a link: absolute, or from the sample's folder


def put(file: Path, content: bytes | Instead, root: Path) -> None:
    """Give a file another content, or put something else in its place; what it led to stays as it was.

    Args:
        root: the sample's folder.
    """
    if file.is_dir() and not file.is_symlink():
        file.rmdir()
    file.unlink(missing_ok=True)
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif content.kind == "link":
        file.symlink_to(root / content.target)
    elif content.kind == "folder":
        file.mkdir()
    elif content.kind == "pipe":
        os.mkfifo(file)


Injury = Callable[[bytes, np.random.Generator], "bytes | Instead"]


def damaged(name: str, data: bytes, rng: np.random.Generator, injury: Injury | None = None) -> bytes | Instead:
    """A copy of a file's content with one to three injuries, or with one of a kind that is asked for.

    Those that keep the format's checksums right come as often as others.
    """
    if injury:
        return injury(data, rng)
    kind = next((f for suffix, f in WITHIN.items() if name.endswith(suffix)), None)
    for _ in range(rng.integers(1, 4)):
        try:
            data = kind(data, rng) if kind and rng.random() < 0.7 else raw(data, rng)
        except Exception:  # it is too broken already for an injury within its format
            data = raw(data, rng)
    return data


def raw(data: bytes, rng: np.random.Generator) -> bytes:
    """An injury to the bytes, whatever they mean."""
    if not data:
        return rng.bytes(rng.integers(0, 100))
    a, b = sorted(rng.integers(0, len(data) + 1, 2))
    match rng.integers(8):
        case 0:
            return data[:a]
        case 1:
            return data[:a] + data[b:]
        case 2:
            return data[:b] + data[a:]
        case 3:
            return data[:a] + rng.bytes(min(b - a, 64)) + data[b:]
        case 4:
            return data[:a] + bytes(min(b - a, 64)) + data[a + min(b - a, 64) :]
        case 5:
            number = NUMBERS[rng.integers(len(NUMBERS))]
            word = (
                struct.pack("<f", np.float32(number))
                if rng.random() < 0.5
                else struct.pack("<q", int(np.clip(np.nan_to_num(number), -(2**62), 2**62)))
            )
            return data[:a] + word + data[a + len(word) :]
        case 6:
            return text(data, rng)
    out = bytearray(data)
    for place in rng.integers(0, len(out), rng.integers(1, 9)):
        out[place] ^= 1 << int(rng.integers(8))
    return bytes(out)


def text(data: bytes, rng: np.random.Generator) -> bytes:
    """A number or a word of the first 64 kB becomes another one."""
    words = list(re.finditer(rb"[-+.\w]+", data[:65536]))
    if not words:
        return data
    word = words[rng.integers(len(words))]
    other = (
        words[rng.integers(len(words))][0] if rng.random() < 0.5 else str(NUMBERS[rng.integers(len(NUMBERS))]).encode()
    )
    return data[: word.start()] + other + data[word.end() :]


def _json(data: bytes, rng: np.random.Generator) -> bytes:
    """A value somewhere inside becomes another, goes, or changes places."""
    root = [json.loads(data)]
    node, key = root, 0
    while isinstance(node[key], (dict, list)) and node[key] and (node is root or rng.random() < 0.8):
        node = node[key]
        keys = list(node) if isinstance(node, dict) else range(len(node))
        key = keys[rng.integers(len(keys))]
    match rng.integers(5):
        case 0 if node is not root:
            del node[key]
        case 1 if isinstance(node[key], (int, float)) and not isinstance(node[key], bool):
            node[key] = NUMBERS[rng.integers(len(NUMBERS))]
        case 2 if isinstance(node[key], list) and node[key]:
            node[key] = node[key] * 2 if rng.random() < 0.5 else node[key][::-1]
        case 3 if isinstance(node, dict):
            node[key + "x"] = node[key]
        case _:
            node[key] = VALUES[rng.integers(len(VALUES))]
    return json.dumps(root[0]).encode() if root else b""


def _npz(data: bytes, rng: np.random.Generator) -> bytes:
    """An array goes, changes its values, type or shape, or its header lies; the archive's checksums stay right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = list(members)[rng.integers(len(members))]
    array = np.load(io.BytesIO(members[name]), allow_pickle=False)
    header = np.lib.format.header_data_from_array_1_0(array)
    body = array.tobytes()
    match rng.integers(6):
        case 0:
            members.pop(name)
            header = None
        case 1 | 2:
            values = array.astype("f4" if array.dtype.kind in "bUS" else array.dtype).ravel()
            values[rng.integers(len(values))] = NUMBERS[rng.integers(len(NUMBERS))]
            body, header["descr"], header["shape"] = (
                values.tobytes(),
                values.dtype.str,
                values.shape if array.dtype.kind == "U" else array.shape,
            )
        case 3:
            header["descr"] = TYPES[rng.integers(len(TYPES))]
        case 4:
            header["shape"] = SHAPES[rng.integers(len(SHAPES))]
        case 5:
            array = array[None] if rng.random() < 0.5 else array.ravel()[: rng.integers(array.size + 1)]
            header, body = np.lib.format.header_data_from_array_1_0(array), array.tobytes()
    if header:
        out = io.BytesIO()
        np.lib.format.write_array_header_1_0(out, header)
        members[name] = out.getvalue() + body
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED if rng.random() < 0.3 else zipfile.ZIP_STORED) as archive:
        for key, value in members.items():
            archive.writestr(key, value)
    return out.getvalue()


def _png(data: bytes, rng: np.random.Generator) -> bytes:
    """A chunk is injured, doubled or left out; the checksums stay right."""
    chunks, at = [], 8
    while at < len(data):
        size = struct.unpack_from(">I", data, at)[0]
        chunks.append([data[at + 4 : at + 8], data[at + 8 : at + 8 + size]])
        at += 12 + size
    i = rng.integers(len(chunks))
    match rng.integers(5):
        case 0:
            del chunks[i]
        case 1:
            chunks.insert(i, chunks[i])
        case 2:
            size = struct.pack(
                ">2I", *(int(n) for n in rng.choice([0, 1, 30, 64, 10**4, 10**6, 2**31 - 1, 2**32 - 1], 2))
            )
            chunks[0][1] = size + chunks[0][1][8:]
        case 3:
            chunks[0][1] = chunks[0][1][:8] + rng.bytes(5)
        case 4:
            chunks[i][1] = (
                zlib.compress(raw(zlib.decompress(chunks[i][1]), rng))
                if chunks[i][0] == b"IDAT"
                else raw(chunks[i][1], rng)
            )
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def _exr(data: bytes, rng: np.random.Generator) -> bytes:
    """A number of the header becomes another."""
    place = int(rng.integers(min(len(data), 600)))
    return (
        data[:place]
        + struct.pack("<i", int(rng.choice([0, 1, -1, 30, 10**4, 10**6, 2**31 - 1, -(2**31)])))
        + data[place + 4 :]
    )


def _gzip(data: bytes, rng: np.random.Generator) -> bytes:
    """The content is injured under a right checksum."""
    return gzip.compress(raw(gzip.decompress(data), rng), 1)


def _frames(data: bytes, rng: np.random.Generator) -> bytes:
    """A frame of the serial protocol is left out, repeated, or carries an injured payload under a right checksum."""
    from gof.capture.protocol import decode_frame, encode_frame

    frames = [frame for frame in data.split(b"\0") if frame]
    i = rng.integers(len(frames))
    match rng.integers(3):
        case 0:
            del frames[i]
        case 1:
            frames.insert(rng.integers(len(frames)), frames[i])
        case 2:
            frames[i] = encode_frame(raw(decode_frame(frames[i]), rng)[:64])[:-1]
    return b"\0".join(frames) + b"\0"


WITHIN: dict[str, Injury] = {
    ".json": _json,
    ".npz": _npz,
    ".png": _png,
    ".ply": text,
    ".txt": text,
    ".exr": _exr,
    "c/0/0/0/0/0": _gzip,
    "c/1/0/0/0": _gzip,
    ".frames": _frames,
}
