"""Compare what the files of one fire state about themselves, where a silent difference would do harm."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Literal

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.core.numbered import missing_numbers, usual_step
from gof.footage.lens import Turn
from gof.footage.videos import VideoInfo, chapters_in_words

MAX_MISSING = 0.1  # share of a folder's pictures that may be missing by their numbers
CLOCKS_DIFFER_S = 60  # cameras' clocks are set by hand
SAME_RATE = 0.02  # relative: 29.97 and 30 are one rate, 24 and 25 are not
SQUARE = 1e-3  # by which a pixel's width and height may differ
TURN_OF_TAG: dict[int, Turn] = {0: "none", 90: "clockwise", 180: "half", 270: "counterclockwise"}


def turns_by_tags(
    videos: list[VideoInfo], asked: Turn | Literal["auto"] | Sequence[Turn | Literal["auto"]]
) -> tuple[Turn, ...]:
    """Return how to turn each video's stored pictures upright: as asked, or as its rotation tag says ("auto").

    Args:
        asked: one for all, or one each.
    Raises:
        GofError: another number of turns than of videos; by tags that differ some pictures stand and some lie, so that
            one may have lost its tag.
    """
    asked = (asked,) if isinstance(asked, str) else asked
    if len(asked) not in (1, len(videos)):
        raise GofError(f"--turn: give one value for all videos, or one for each of the {len(videos)}")
    each = list(asked) * (len(videos) if len(asked) == 1 else 1)
    turns: list[Turn] = [
        TURN_OF_TAG[video.rotation_deg] if turn == "auto" else turn for video, turn in zip(videos, each, strict=True)
    ]
    shapes = [_upright_shape(video, turn) for video, turn in zip(videos, turns, strict=True)]
    by_tag = [video for video, turn in zip(videos, each, strict=True) if turn == "auto"]
    if len({video.rotation_deg for video in by_tag}) > 1 and {"stands", "lies"} <= set(shapes):
        tags = "; ".join(
            f"{v.path.name}: tag {v.rotation_deg or 'none'}, so its picture {shape}"
            for v, shape in zip(videos, shapes, strict=True)
        )
        raise GofError(
            f"the files' rotation tags differ, and so do their pictures ({tags}): was one copied by a program that "
            "drops the tag? Say how each is turned upright, in the videos' order, as --turn "
            f"{' '.join(turns)} (none, clockwise, counterclockwise, half)"
        )
    return tuple(turns)


def _upright_shape(video: VideoInfo, turn: Turn) -> str:
    """Return "stands", "lies" or "is square" of the pictures once they are turned."""
    width, height = (video.width, video.height) if turn in ("none", "half") else (video.height, video.width)
    return "is square" if width == height else "stands" if height > width else "lies"


def require_square_pixels(videos: list[VideoInfo]) -> None:
    """Raise DataFormatError: a file's pixels are not square, so that one field of view does not say the lens."""
    for video in videos:
        if abs(video.pixel_aspect - 1) > SQUARE:
            path = video.path
            copy = shlex.quote(str(path.with_name(f"{path.stem}_square.mp4")))
            raise DataFormatError(
                f"{path}: its pixels are not square ({video.pixel_aspect:.4g} times as wide as high), so --fov does "
                f"not say the lens. Make them square: ffmpeg -i {shlex.quote(str(path))} -vf scale=iw*sar:ih,setsar=1 "
                f"-c:v libx264 -crf 12 {copy}; or give --cameras with the K of the pictures as stored"
            )


def _clock_notes(videos: list[VideoInfo]) -> list[str]:
    """Return the times at which the files began, by their own statement, where they differ."""
    notes = []
    starts = [video.start_s for video in videos]
    steps = [video.usual_step_s for video in videos if video.usual_step_s]
    if steps and max(starts) - min(starts) > 0.5 * min(steps):
        each = ", ".join(f"{video.path.name} {video.start_s:.3f} s" for video in videos)
        notes.append(
            f"the first pictures are at different times of the files' own clocks ({each}); unless --times or --start "
            "says otherwise, they are taken as of one moment"
        )
    made = [video.made_s for video in videos if video.made_s is not None]
    if made and len(made) == len(videos):
        longest = max((video.frames or 0) * (video.usual_step_s or 0) for video in videos)
        if max(made) - min(made) > longest + CLOCKS_DIFFER_S:
            notes.append(
                f"by their own clocks the files were made {max(made) - min(made)} s apart: are they of one take?"
            )
    return notes


def require_whole(videos: list[VideoInfo], enough: bool) -> list[str]:
    """Return a note for each file that holds fewer frames than its container states.

    Args:
        enough: the user says how many frames are wanted, so a file that breaks off after them will do.
    Raises:
        DataFormatError: a file breaks off.
    """
    notes = []
    for video in videos:
        if not video.stated_frames or (video.frames or 0) >= video.stated_frames or video.stamps_s is None:
            continue
        counts = f"{video.frames} of the {video.stated_frames} frames that it states can be read"
        if video.breaks_off and not enough:
            where = f" (in {video.chapters[-1]})" if video.chapters else ""
            raise DataFormatError(
                f"{video.path}: breaks off{where}: {counts}. Copy it from the camera again; to use what is there, give "
                f"--frames {video.frames} or fewer"
            )
        notes.append(f"{video.path.name}: {counts}")
    return notes


def require_one_rate(videos: list[VideoInfo]) -> None:
    """Raise GofError: the containers' rates differ, so one rate cannot be true of all."""
    rates = {video.path.name: 1 / video.usual_step_s for video in videos if video.usual_step_s}
    if rates and max(rates.values()) > (1 + SAME_RATE) * min(rates.values()):
        each = ", ".join(f"{name} {rate:.4g}" for name, rate in rates.items())
        raise GofError(
            f"the files differ in rate ({each} frames per second) and one rate is given for all: give each its true "
            "rate, as --times 400 200 400, or --times stamps if the files' time stamps are true time"
        )


def require_one_length(videos: list[VideoInfo], clocks: list[np.ndarray]) -> None:
    """Raise GofError: clips of different length, so they need not begin together.

    Args:
        clocks: (N,) s of every video's frames.
    """
    lasts = [clock[-1] - clock[0] for clock in clocks]
    step = max(np.median(np.diff(clock)) if len(clock) > 1 else 0.0 for clock in clocks)
    if max(lasts) - min(lasts) > 0.5 * step:
        each = ", ".join(f"{video.path.name} {video.frames}" for video in videos)
        zeros, fewest = " ".join("0" for _ in videos), min(video.frames or 0 for video in videos)
        raise GofError(
            f"the clips differ in length (frames: {each}): do they begin together? If so, say how many frames to use, "
            f"as --frames {fewest}; if not, give a frame of each that was taken at the "
            f"same moment, as --start {zeros}, or film the board and use 'gof capture sync'"
        )


def require_few_missing(video: VideoInfo) -> None:
    """Raise DataFormatError: more than `MAX_MISSING` of a folder's pictures are missing by their numbers."""
    numbers = list(video.numbers or ())
    count, which = missing_numbers(numbers)
    if count > MAX_MISSING * (count + len(numbers)):
        raise DataFormatError(
            f"{video.path}: of the pictures' numbers {numbers[0]} to {numbers[-1]}, {count} are missing ({which}): "
            "were files lost, or did the counter begin again? If the numbers do not count frames, name the pictures "
            "0001, 0002, ... in the order in which they were taken"
        )


def require_few_repeats(video: VideoInfo) -> None:
    """Raise DataFormatError: more than `MAX_MISSING` of a film's frames show the one before them again."""
    if len(video.repeated) > MAX_MISSING * (video.frames or 0):
        path = video.path
        finding = (
            f"{path}: {len(video.repeated)} of its {video.frames} frames show the one before them again (first frame "
            f"{video.repeated[0]}): was it converted to another rate?"
        )
        if video.numbers is not None:
            raise DataFormatError(
                f"{finding} Take the pictures out of the camera's own file, as they are: ffmpeg -i FILM -fps_mode "
                "passthrough %06d.png; or remove the repeats: a missing number is a gap in time"
            )
        copy = shlex.quote(str(path.with_name(f"{path.stem}_once{path.suffix}")))
        raise DataFormatError(
            f"{finding} Give the camera's own file, or leave the repeats "
            f"out: ffmpeg -i {shlex.quote(str(path))} -vf mpdecimate -fps_mode vfr -c:v libx264 -crf 12 {copy}, with "
            "--times stamps"
        )


def require_one_beginning(videos: list[VideoInfo]) -> None:
    """Raise GofError: folders whose pictures begin at different numbers, so that one may lack its first ones."""
    first = {str(video.path): video.numbers[0] for video in videos if video.numbers}
    if len(set(first.values())) > 1:
        each = ", ".join(f"{path} {number}" for path, number in first.items())
        zeros = " ".join("0" for _ in videos)
        raise GofError(
            f"the pictures' numbers begin apart ({each}): are the first pictures of a folder lost? If the first ones "
            f"of all were taken together, say so with --start {zeros}; else give the place in its folder, from 0 on, "
            "of a picture of each that was"
        )


def number_notes(videos: list[VideoInfo]) -> list[str]:
    """Return a note on the clock by the numbers of pictures, where these do not follow each other."""
    notes = []
    for video in videos:
        numbers = list(video.numbers or ())
        step, (count, which) = usual_step(numbers), missing_numbers(numbers)
        if count:
            notes.append(f"{video.path.name}: {count} pictures are missing ({which}), taken as a gap in time")
        if step > 1:
            notes.append(
                f"{video.path.name}: the pictures' numbers go in steps of {step}; the rate is that of its pictures"
            )
    return notes


HDR = ("HLG", "PQ")


def _curve_note(video: VideoInfo) -> str:
    """Return what to do about a film of more than 8 bits whose file does not say its curve."""
    path = video.path
    copy = shlex.quote(str(path.with_name(f"{path.stem}_hlg{path.suffix}")))
    return (
        f"{path.name}: has {video.bits} bits per channel and does not say its curve; it is read as SDR. If it is HDR, "
        f"write it into a copy: ffmpeg -i {shlex.quote(str(path))} -c copy -color_primaries bt2020 -color_trc "
        f"arib-std-b67 -colorspace bt2020nc {copy} (HLG; smpte2084 for PQ)"
    )


def other_notes(videos: list[VideoInfo], one_fov: bool) -> list[str]:
    """Return what is no error and yet worth saying: HDR, other turns, sizes, pixels, chapters or clocks."""
    notes = [
        f"{video.path.name}: is HDR ({video.colour}) and is read as such: 203 cd/m2 are white, what is brighter is "
        "rolled off"
        for video in videos
        if video.colour in HDR
    ]
    if 0 < len(notes) < len(videos):
        notes.append(
            "HDR and SDR films are mixed: a phone brightens its SDR films in its own way, so the cameras' colours may "
            "differ; film alike where you can"
        )
    notes += [_curve_note(video) for video in videos if (video.bits or 8) > 8 and not video.colour]
    tags = [video.rotation_deg for video in videos]
    if len(set(tags)) > 1:
        each = ", ".join(f"{v.path.name} {v.rotation_deg or 'none'}" for v in videos)
        notes.append(f"the files' rotation tags differ ({each}, degrees clockwise): each is turned by its own")
    sizes = [f"{v.width}x{v.height}" for v in videos]
    if len(set(sizes)) > 1 and one_fov:
        notes.append(f"the videos differ in size ({', '.join(sizes)}) and --fov is taken for each of them")
    stretched = [video for video in videos if abs(video.pixel_aspect - 1) > SQUARE]
    notes += [
        f"{v.path.name}: its pixels are {v.pixel_aspect:.4g} times as wide as high; --cameras must say so in K"
        for v in stretched
    ]
    chapters = [words for video in videos if (words := chapters_in_words(video))]
    return [*notes, *chapters, *_clock_notes(videos)]
