"""A dataset as one archive for a data host: its files, their checksums, and a card that says what it is.

    NAME.tar               NAME/SHA256SUMS, NAME/README.md (the card), and the dataset's files
    NAME.tar.sha256        of the archive, as `sha256sum` writes it

A tar, not compressed, because pictures and grids are; its members are sorted and without owners, so that the same files
make the same archive. Times of change go with the files, to the nanosecond: results know their dataset by them
(`gof.core.files`). Work files (.cache) stay out.
"""

from __future__ import annotations

import hashlib
import html
import io
import json
import os
import re
import shutil
import tarfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from gof.core.drafts import whole_folder
from gof.core.errors import DataFormatError, GofError
from gof.core.fields import GridSequence, open_array
from gof.core.files import atomic_path, is_name, is_relative_path, path_in
from gof.dataset.dataset import Dataset


@dataclass(frozen=True)
class VelocityFingerprint:
    """The fingerprint of a velocity store.

    Attributes:
        sha256: of its times, its grid and its values.
        rms_m_s: root-mean-square speed of every frame over all cells.
    """

    sha256: str
    rms_m_s: tuple[float, ...]

    @classmethod
    def of(cls, dataset: Dataset) -> VelocityFingerprint:
        """Read every frame. Raises DataFormatError: the dataset has no true velocity, or it is damaged."""
        store = dataset.velocity
        state = hashlib.sha256()
        state.update(np.round(store.times_s, 9).astype("<f8").tobytes())
        state.update(np.round(store.index_to_world, 9).astype("<f8").tobytes())
        speeds = []
        for time_s in store.times_s:
            values = store.at(float(time_s)).velocity
            state.update(f"{values.shape}".encode())
            state.update((values + 0).astype("<f4").tobytes())  # + 0: of the two zeros only one
            speeds.append(float(np.sqrt(np.square(values.astype(np.float64)).sum(-1).mean())))
        return cls(state.hexdigest(), tuple(round(speed, 6) for speed in speeds))

    def differs(self, recorded: VelocityFingerprint) -> str:
        """In what this truth is another than the recorded one; empty where it is the same."""
        if self.sha256 == recorded.sha256:
            return ""
        if len(self.rms_m_s) != len(recorded.rms_m_s):
            return f"it has {len(self.rms_m_s)} frames, the recorded one {len(recorded.rms_m_s)}"
        ours, theirs = np.array(self.rms_m_s), np.array(recorded.rms_m_s)
        off = float(np.max(np.abs(ours - theirs) / np.maximum(theirs, 1e-9)))
        return f"its velocities are not those to the bit; the speed of a frame differs by at most {off:.2%}"


SUMS, CARD = "SHA256SUMS", "README.md"
BLOCK = 2**20
CARD_HEAD = "---\nlicense: "  # that a card of ours begins with
OWN_WORDS = "\n<!-- below: README.md of the authors -->\n\n"
HEAD = 2**14  # characters of a card in which its credit stands
MOST_SUMS = 2**26  # bytes of checksums that a reader believes
LATEST_NS = 2**32 * 10**9  # of the year 2106: what file systems keep

Progress = Callable[[int, int], None]  # bytes done, bytes in all


def files_of(folder: Path) -> list[str]:
    """Return names of a dataset's files, relative and sorted. Hidden files and folders are work files, and left out.

    Raises:
        DataFormatError: one is a link, or has a name that other systems refuse.
    """
    found = []
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = Path(place) / name
            relative = path.relative_to(folder).as_posix()
            if name.startswith(".") or relative in (SUMS, CARD):
                continue
            if path.is_symlink() or not path.is_file() or not is_relative_path(relative):
                raise DataFormatError(
                    f"{path}: not a plain file with a name that every system takes; it cannot be packed"
                )
            found.append(relative)
    return sorted(found)


def pack(dataset: Dataset, out: Path, licence: str, authors: tuple[str, ...], progress: Progress | None = None) -> Path:
    """Write `out`/NAME.tar and its checksum, NAME being the dataset's folder; the archive.

    Args:
        licence: under which others may use it, as data hosts name it ("CC-BY-4.0").
        authors: who made it.
    Raises:
        GofError: licence or authors are empty, or the archive would lie in the dataset.
        DataFormatError: a file is absent that dataset.json names, a grid has lost frames, or see `files_of`.
    """
    if not licence.strip() or not authors:
        raise GofError("a packed dataset states its authors and its licence: give both")
    root = dataset.path.resolve()
    if out.resolve().is_relative_to(root):
        raise GofError(f"{out}: is inside the dataset that is packed; choose another --out")
    dataset.require_files()
    for grid in sorted((root / "grids").glob("*.zarr")):
        GridSequence(open_array(grid))
    names, own_words = files_of(root), _own_words(root / CARD)
    total = sum((root / name).stat().st_size for name in names)
    newest = max((root / name).stat().st_mtime_ns for name in names)
    done, sums = 0, {}
    archive = out / f"{root.name}.tar"
    with atomic_path(archive) as temporary, tarfile.open(temporary, "w", format=tarfile.PAX_FORMAT) as tar:
        for name in names:
            with (root / name).open("rb") as file:
                counted = _Counted(file)
                status = os.fstat(file.fileno())
                tar.addfile(_member(f"{root.name}/{name}", status.st_size, status.st_mtime_ns), counted)
            sums[name] = counted.digest
            done += counted.size
            if progress:
                progress(done, total)
        about = (card(dataset, licence, authors, total) + own_words).encode()
        sums[CARD] = hashlib.sha256(about).hexdigest()
        listed = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items())).encode()
        for name, content in ((CARD, about), (SUMS, listed)):
            tar.addfile(_member(f"{root.name}/{name}", len(content), newest), io.BytesIO(content))
    with archive.open("rb") as file, atomic_path(out / f"{archive.name}.sha256") as temporary:
        temporary.write_text(f"{_digest(file)}  {archive.name}\n", encoding="utf-8")
    return archive


def unpack(archive: Path, out: Path, progress: Progress | None = None) -> Path:
    """Open an archive of `pack` into `out`/NAME, every file compared with its checksum; the dataset's folder.

    Nothing is left there unless all of it is right.

    Raises:
        DataFormatError: not such an archive, damaged or cut off, a file is not as its checksum says, is missing, or is
            not listed (named), or something in it is not a plain file inside NAME.
        GofError: `out`/NAME exists.
    """
    beside = archive.with_name(f"{archive.name}.sha256")
    if beside.is_file():
        with archive.open("rb") as file:
            if beside.read_text(encoding="utf-8", errors="replace").split()[:1] != [_digest(file)]:
                raise DataFormatError(f"{archive}: is not as {beside.name} says; download it again")
    try:
        with tarfile.open(archive, "r:") as tar:
            name = _root_of(archive, tar)
            target = path_in(out, name)
            if target.exists():
                raise GofError(f"{target}: exists; move it away, or choose another --out")
            with whole_folder(target) as draft:
                found = _extract(archive, tar, name, draft, progress)
                _compare(archive, draft, found)
                Dataset.open(draft)
    except FileNotFoundError as e:
        raise DataFormatError(f"{archive}: no such file") from e
    except (tarfile.TarError, EOFError, ValueError, OverflowError) as e:  # headers that lie bring the last two
        raise DataFormatError(f"{archive}: not a tar archive, or cut off ({e}); download it again") from e
    return target


def verify(folder: Path) -> int:
    """Compare the files of an unpacked dataset with its checksums; how many there are.

    Raises:
        DataFormatError: no SHA256SUMS, or a file differs, is missing, or is not listed (named).
    """
    found = {}
    for name in [*files_of(folder), CARD]:
        if (folder / name).is_file():
            with (folder / name).open("rb") as file:
                found[name] = _digest(file)
    _compare(folder, folder, found)
    return len(found)


# ---------------------------------------------------------------- reading


def _root_of(archive: Path, tar: tarfile.TarFile) -> str:
    """Return the one folder that everything lies in."""
    first = tar.next()
    name = "" if first is None else first.name.partition("/")[0]
    if not is_name(name) or name.startswith("."):
        raise DataFormatError(f"{archive}: not an archive of 'gof pack'")
    return name


def _extract(archive: Path, tar: tarfile.TarFile, root: str, draft: Path, progress: Progress | None) -> dict[str, str]:
    """Write every member into the draft; its digests by name."""
    found: dict[str, str] = {}
    for member in tar.getmembers():
        inside, _, name = member.name.partition("/")
        source = tar.extractfile(member) if member.isreg() and not member.issparse() else None
        if source is None or inside != root or not is_relative_path(name) or name.startswith(".") or name in found:
            raise DataFormatError(f"{archive}: {member.name[:200]!r} is not a plain file inside {root!r}, once")
        path = path_in(draft, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with source, path.open("wb") as out:
            counted = _Counted(source)
            shutil.copyfileobj(counted, out, BLOCK)
        if counted.size != member.size:
            raise DataFormatError(f"{archive}: {name} is cut off; download the archive again")
        found[name] = counted.digest
        if (changed_ns := _changed_ns(member)) is not None:
            os.utime(path, ns=(changed_ns, changed_ns))
        if progress:
            progress(member.offset_data + member.size, archive.stat().st_size)
    return found


def _changed_ns(member: tarfile.TarInfo) -> int | None:
    """When a packed file was last changed; None: the archive does not say, as those of version 0.2."""
    stated = re.fullmatch(r"(\d{1,10})(?:\.(\d{1,9})\d*)?", member.pax_headers.get("mtime", str(member.mtime)))
    if stated is None:
        return None
    changed_ns = int(stated[1]) * 10**9 + int((stated[2] or "").ljust(9, "0"))
    return changed_ns if 0 < changed_ns < LATEST_NS else None


def _compare(source: Path, folder: Path, found: dict[str, str]) -> None:
    """Raise DataFormatError: the digests are not those of the folder's SHA256SUMS (names the first file)."""
    path = folder / SUMS
    if not path.is_file() or path.stat().st_size > MOST_SUMS:
        raise DataFormatError(f"{source}: no {SUMS}; was it made by 'gof pack'?")
    lines = [line.split("  ", 1) for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    listed = {line[1]: line[0] for line in lines if len(line) == 2}
    ours = {name: digest for name, digest in found.items() if name != SUMS}
    for name in sorted(listed.keys() | ours.keys()):
        if listed.get(name) != ours.get(name):
            why = (
                "is missing"
                if name not in ours
                else "is not as its checksum says"
                if name in listed
                else "is not listed"
            )
            raise DataFormatError(f"{source}: {name} {why} ({SUMS}); it was damaged or changed, get it again")


# ---------------------------------------------------------------- writing


def _member(name: str, size: int, changed_ns: int) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o644
    member.mtime = changed_ns // 10**9  # for programs that read no more
    member.pax_headers = {"mtime": f"{changed_ns // 10**9}.{changed_ns % 10**9:09d}"}
    return member


def _digest(file: IO[bytes]) -> str:
    state = hashlib.sha256()
    while block := file.read(BLOCK):
        state.update(block)
    return state.hexdigest()


class _Counted:
    """A file that is digested while it is read."""

    def __init__(self, file: IO[bytes]):
        self._file, self._state, self.size = file, hashlib.sha256(), 0

    def read(self, size: int = -1) -> bytes:
        block = self._file.read(size)
        self._state.update(block)
        self.size += len(block)
        return block

    @property
    def digest(self) -> str:
        return self._state.hexdigest()


# ----------------------------------------------------------------
# A data card: what a packed dataset is, for people and for the fields that data hosts read.


def card(dataset: Dataset, licence: str, authors: tuple[str, ...], total: int) -> str:
    """Markdown under a YAML head.

    Args:
        total: bytes of the files.
    Raises:
        DataFormatError: the true velocity cannot be read.
    """
    facts = description_lines(dataset, total)
    made = dataset.description.provenance
    parts = [
        "---",
        f"license: {_quoted(licence.lower())}",
        f"pretty_name: {_quoted(dataset.description.name)}",
        "tags: [fire, gaussian-splatting, 4d, velocity, benchmark]",
        "---",
        f"# {_plain(dataset.description.name)}",
        "",
        f"Made by {_plain(', '.join(authors))}. Licence: {_plain(licence)}.",
        "",
        "| what | |",
        "|---|---|",
        *(f"| {what} | {_plain(found)} |" for what, found in facts.items()),
        "",
        "Frames of `splits.test` in dataset.json are held out: no method may use them, nor flow from or to them.",
        "",
        "## What made it",
        "",
        "```json",
        json.dumps(made, indent=1, sort_keys=True).replace("```", "'''"),
        "```",
        "",
        "## To open it",
        "",
        "    gof unpack ARCHIVE.tar --out data       every file is compared with its checksum",
        "    cd data/NAME && sha256sum -c SHA256SUMS  without gof",
        "",
    ]
    return "\n".join(parts)


def _own_words(path: Path) -> str:
    """Return a README.md of the dataset's authors, as it goes below the card: their words, or what an older card has of
    them.

    Raises:
        DataFormatError: it is a link, or holds no text.
    """
    if not path.exists() and not path.is_symlink():
        return ""
    if path.is_symlink() or not path.is_file():
        raise DataFormatError(f"{path}: not a plain file; it cannot be packed")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as e:
        raise DataFormatError(f"{path}: no text in UTF-8 ({e}); save it as such") from e
    _, marker, own = text.partition(OWN_WORDS)
    if text.startswith(CARD_HEAD):
        text = own if marker else ""
    return f"{OWN_WORDS}{text}" if text.strip() else ""


def description_lines(dataset: Dataset, total: int) -> dict[str, str]:
    """Return the facts that a reader wants first."""
    about = dataset.description
    sizes = sorted({f"{entry.width}x{entry.height}" for entry in about.cameras})
    roles = [entry.role for entry in about.cameras]
    held_out = ", ".join(map(str, about.splits.test))
    lines = {
        "kind": "simulated, with true velocities" if dataset.has_velocity else "a capture of a real fire",
        "cameras": f"{roles.count('train')} to train on, {roles.count('eval')} to evaluate; {', '.join(sizes)} pixels",
        "frames": f"{len(about.time_s)} over {about.time_s[-1] - about.time_s[0]:.4g} s; held out: {held_out}",
        "effects": ", ".join(about.effects) or "none",
        "size": f"{total / 1e6:.1f} MB",
    }
    if dataset.has_velocity:
        store = dataset.velocity
        cells = "x".join(map(str, store.resolution))
        lines["velocity"] = f"velocity.zarr, {cells} cells at {len(store)} times, m/s in world axes, at cell centres"
        lines["digest of the truth"] = (
            f"{VelocityFingerprint.of(dataset).sha256} (docs/benchmark.md says what it is of)"
        )
    return lines


def read_credit(folder: Path) -> str:
    """Return who made an unpacked dataset, and its licence, as its card says; empty where it has no such card."""
    path = folder / CARD
    if not path.is_file():
        return ""
    with path.open(encoding="utf-8", errors="replace") as file:
        found = re.search(r"^Made by .+\. Licence: .+\.$", file.read(HEAD), re.MULTILINE)
    return html.unescape(found[0].replace("\\|", "|")) if found else ""


def _quoted(text: str) -> str:
    return json.dumps(text).replace("<", "\\u003c")  # a JSON string is a YAML string; no tag on a host's page


def _plain(text: str) -> str:
    """On one line, and not the end of a cell."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
