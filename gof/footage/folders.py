"""Folders of footage: one camera's pictures, which they are and in which order; or the videos of a take."""

from __future__ import annotations

from pathlib import Path

from gof.core.errors import DataFormatError
from gof.core.numbered import frame_of, is_hidden, number_files
from gof.footage.chapters import without_later

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
UNREAD = frozenset(
    ".heic .heif .avif .webp .gif .jp2 .jxl .jfif .tga .ppm .pgm .pnm .dpx .psd .exr .hdr .raw .dng .cr2 .cr3 .nef "
    ".arw .raf .orf .rw2 .pef .srw".split()
)  # pictures that are not read from a folder
VIDEOS = frozenset(".mp4 .mov .m4v .mkv .avi .webm .mts .m2ts .ts .mxf".split())  # what cameras and phones write


def picture_files(folder: Path) -> list[Path]:
    """Return the pictures of a folder as one sequence, in the order of their frames' numbers.

    Raises:
        DataFormatError: there is none; they are not one sequence (see `number_files`); a frame of it is in a format
            that is not read.
    """
    return [file for _, file in numbered_pictures(folder)]


def numbered_pictures(folder: Path) -> list[tuple[int, Path]]:
    """As `picture_files`, with the frames' numbers."""
    found = number_files(loose_pictures(folder))
    if len(found) > 1:
        name, known = (frame_of(found[0][1]) or ("", 0, ""))[0], {number for number, _ in found}
        for file in sorted(Path(folder).iterdir()):
            other = None if is_hidden(file) or file.is_dir() else frame_of(file)
            if other and f"{other[0]}.".startswith(f"{name}.") and other[1] not in known:
                raise DataFormatError(
                    f"{file}: by its name a frame between the folder's pictures, in a format that is not read; make it "
                    f"one of {', '.join(PICTURES)}, or keep it elsewhere"
                )
    return found


def loose_pictures(folder: Path) -> list[Path]:
    """Return the pictures of a folder in the order of their names, which need not be a sequence.

    Raises:
        DataFormatError: there is none; a picture is in a format that is not read, and in no other one beside it.
    """
    files = sorted(f for f in Path(folder).iterdir() if not is_hidden(f) and not f.is_dir())
    pictures = [f for f in files if f.suffix.lower() in PICTURES]
    stems = {f.stem for f in pictures}
    unread = [f for f in files if f.suffix.lower() in UNREAD and f.stem not in stems]
    if unread:
        raise DataFormatError(
            f"{unread[0]}: {len(unread)} of the folder's pictures are in formats that are not read; convert them to "
            f"one of {', '.join(PICTURES)}, all of one size, or keep them elsewhere"
        )
    if not pictures:
        listed = ", ".join(f.name for f in files[:3]) + (", ..." if len(files) > 3 else "") or "nothing"
        raise DataFormatError(f"{folder}: no pictures ({', '.join(PICTURES)}) in this folder; there is {listed}")
    return pictures


def videos_of_take(folder: Path) -> list[Path]:
    """Return the videos of a folder that has one for each camera, by name, of several chapters of one recording the
    first; none where it also holds pictures."""
    return [] if has_pictures(folder) else without_later([f for f in _files_in(folder) if f.suffix.lower() in VIDEOS])


def has_pictures(folder: Path) -> bool:
    """Return whether pictures lie in a folder, readable ones or not."""
    return any(f.suffix.lower() in {*PICTURES, *UNREAD} for f in _files_in(folder))


def _files_in(folder: Path) -> list[Path]:
    return sorted(f for f in Path(folder).iterdir() if not is_hidden(f) and not f.is_dir())
