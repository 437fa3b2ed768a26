"""Malice instead of chance: names, links and archives that lead elsewhere, and cameras and clocks that cannot be."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator

import numpy as np

from tests.reliability.damage import Instead, raw

# Parts of names that lead somewhere, or act somewhere: on disks, in shells, terminals, tables and pages.
NAME_PARTS = (
    "..",
    ".",
    "",
    "~",
    "link",
    "secret.png",
    "outside",
    "dataset",
    "cameras",
    "cam_0",
    "tmp",
    "dev",
    "zero",
    "etc",
    "passwd",
    "gof-escaped",
    "CON",
    "nul.png",
    "COM1",
    "C:",
    "a\\b",
    "..\\..\\x",
    "a\0b",
    "a\nb",
    "\r",
    "\x1b]0;owned\x07",
    "\x9b2J",
    "\u202egnp",
    "\ud800",
    "\udcff",
    "-rf",
    "--overwrite",
    "=HYPERLINK(1)",
    "+1",
    "@SUM(A1)",
    "\t=1",
    "[/b]",
    "[link=file:///etc/passwd]",
    "<script>alert(1)</script>",
    "{frame:0999999999d}",
    "{frame:06d}",
    "{0.__class__}",
    "%s",
    "*",
    "|",
    "x" * 300,
    "trailing. ",
)
NAMES = (
    "/dev/zero",
    "/dev/stdin",
    "/proc/self/environ",
    "/etc/passwd",
    "/tmp/gof-escaped",
    "../outside/secret.png",
    "../../outside/secret.png",
    "link/secret.png",
    "../gof-escaped",
    "secret.png",
    "a/" * 3000,
)
# Where links lead that stand in place of a file; from the sample's folder.
TARGETS = (
    "outside/secret.png",
    "outside",
    "outside/absent",
    "dataset",
    "dataset/dataset.json",
    "dataset/link/secret.png",
    "/dev/zero",
    "/dev/null",
    "/dev/stdin",
    "/etc/passwd",
    "/proc/self/mem",
    "/proc/self/environ",
    "/proc/self/fd/0",
    "/",
)
KINDS = (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE, tarfile.DIRTYPE)
KINDS += (tarfile.CONTTYPE, tarfile.GNUTYPE_SPARSE, tarfile.GNUTYPE_LONGNAME, tarfile.XHDTYPE, b"Z")


# ---------------------------------------------------------------- names


def renamed(data: bytes, rng: np.random.Generator) -> bytes:
    """A text somewhere inside JSON becomes a name that leads or acts somewhere."""
    root = [json.loads(data)]
    places = [place for place in _places(root) if isinstance(place[0][place[1]], str)]
    for at in rng.choice(len(places), rng.integers(1, 3)):
        node, key = places[at]
        node[key] = name(rng) + ("", "", ".png", "{frame:06d}.png")[rng.integers(4)]
    return json.dumps(root[0]).encode()


def name(rng: np.random.Generator) -> str:
    """One that leads or acts somewhere."""
    parts = [NAME_PARTS[i] for i in rng.integers(len(NAME_PARTS), size=rng.integers(1, 5))]
    return NAMES[rng.integers(len(NAMES))] if rng.random() < 0.3 else "/".join(parts)


def instead(data: bytes, rng: np.random.Generator) -> Instead:
    """Something that is no file stands in its place."""
    kind = ("link", "link", "link", "folder", "pipe", "nothing")[rng.integers(6)]
    return Instead(kind, TARGETS[rng.integers(len(TARGETS))] if kind == "link" else "")


def packed(data: bytes, rng: np.random.Generator) -> bytes:
    """An archive with a member that leads elsewhere, is no file, is there twice, or is not as it was."""
    with tarfile.open(fileobj=io.BytesIO(data)) as tar:
        members = [(member, tar.extractfile(member).read()) for member in tar.getmembers()]
    i = int(rng.integers(len(members)))
    member, content = members[i]
    root, _, inside = member.name.partition("/")
    match rng.integers(7):
        case 0:
            member.name = name(rng)
        case 1:
            member.name = f"{root}/{name(rng)}"
        case 2:
            member.type, member.linkname = KINDS[rng.integers(len(KINDS))], name(rng)
        case 3:  # a link, and then a file through it
            link = tarfile.TarInfo(f"{root}/way")
            link.type, link.linkname = tarfile.SYMTYPE, "../../../outside"
            members.insert(0, (link, b""))
            member.name = f"{root}/way/{inside.rpartition('/')[2]}"
        case 4:
            members.append((member, raw(content, rng)))
        case 5:
            member.pax_headers = {"path": name(rng), "size": str(10 ** int(rng.integers(1, 20)))}
        case 6:
            members[i] = member, raw(content, rng)
    try:
        return _tar(members)
    except (ValueError, OverflowError, tarfile.TarError):  # even tarfile will not write it
        return raw(data, rng)


def _tar(members: list[tuple[tarfile.TarInfo, bytes]]) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT, errors="surrogatepass") as tar:
        for member, content in members:
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return out.getvalue()


# ---------------------------------------------------------------- what cannot be


def impossible(data: bytes, rng: np.random.Generator) -> bytes:
    """A dataset.json of plausible types whose cameras or clocks cannot be as it says."""
    about = json.loads(data)
    cameras = about["cameras"]
    one = cameras[rng.integers(len(cameras))]
    much = float(10.0 ** rng.uniform(3, 9))
    match rng.integers(6):
        case 0:
            one["K"][0][0] = one["K"][1][1] = one["K"][0][0] * much ** int(rng.choice([-1, 1]))
        case 1:
            one["row_time_s"] = -abs(one["row_time_s"]) * much if rng.random() < 0.5 else much
        case 2:
            one["time_s"] = [t + rng.choice([-1, 1]) * rng.uniform(20, 1e6) for t in one["time_s"]]
        case 3:  # one place for all
            for camera in cameras:
                camera["world_to_camera"] = cameras[0]["world_to_camera"]
        case 4:
            one["world_to_camera"] = np.linalg.inv(one["world_to_camera"]).tolist()
        case 5:  # OpenGL's axes
            for camera in cameras:
                camera["world_to_camera"] = (np.diag([1.0, -1, -1, 1]) @ camera["world_to_camera"]).tolist()
    return json.dumps(about).encode()


def _places(node: list | dict) -> Iterator[tuple[list | dict, int | str]]:
    """Every (container, key) inside."""
    for key in list(node) if isinstance(node, dict) else range(len(node)):
        yield node, key
        if isinstance(node[key], (list, dict)):
            yield from _places(node[key])
