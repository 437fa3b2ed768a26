"""PLY files as the tests need them, written and read here in the plainest way, without `gof.core.ply_file`."""

from pathlib import Path

import numpy as np

WORDS = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}


def write_ply(path: Path, vertex: np.ndarray, order="<", comments=()) -> Path:
    """A structured array as the element "vertex" of a binary file."""
    kinds = [(name, vertex.dtype[name].str[1:]) for name in vertex.dtype.names]
    lines = ["ply", f"format binary_{'little' if order == '<' else 'big'}_endian 1.0"]
    lines += [f"comment {comment}" for comment in comments] + [f"element vertex {len(vertex)}"]
    lines += [f"property {WORDS[kind]} {name}" for name, kind in kinds] + ["end_header", ""]
    rows = vertex.astype([(name, order + kind) for name, kind in kinds])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(lines).encode() + rows.tobytes())
    return path


def read_ply(path: Path) -> tuple[np.ndarray, list[str]]:
    """The vertices and comments of a binary little-endian file with no other element and no lists."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kinds = {word: kind for kind, word in WORDS.items()}
    properties = [line.split() for line in lines if line.startswith("property ")]
    dtype = np.dtype([(name, "<" + kinds[word]) for _, word, name in properties])
    (count,) = (int(line.split()[2]) for line in lines if line.startswith("element "))
    assert len(body) == count * dtype.itemsize
    return np.frombuffer(body, dtype).copy(), [line[8:] for line in lines if line.startswith("comment ")]
