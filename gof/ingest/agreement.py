"""Do videos of one fire say the same of themselves? What they must not differ in silently."""

from __future__ import annotations

from typing import Literal

import numpy as np

from gof.errors import DataFormatError, GofError
from gof.footage import VideoInfo
from gof.lens import Turn
from gof.numbered import missing_numbers, usual_step

MAX_MISSING = 0.1  # share of a folder's pictures that may be missing by their numbers
SAME_RATE = 0.02  # relative: 29.97 and 30 are one rate, 24 and 25 are not
TURN_OF_TAG: dict[int, Turn] = {0: "none", 90: "clockwise", 180: "half", 270: "counterclockwise"}


def turn_by_tags(videos: list[VideoInfo], asked: Turn | Literal["auto"]) -> Turn:
    """How to turn the stored pictures upright: as asked, or as the files' rotation tags say ("auto").

    Raises:
        GofError: the tags differ and nothing else is asked.
    """
    if asked != "auto":
        return asked
    tags = {video.rotation_deg for video in videos}
    if len(tags) > 1:
        each = ", ".join(f"{v.path.name} {v.rotation_deg or 'none'}" for v in videos)
        raise GofError(
            f"the files' rotation tags differ ({each}, degrees clockwise): was one copied by a program that drops the "
            "tag? If all pictures as stored lie the same way, say which with --turn none, clockwise, counterclockwise "
            "or half"
        )
    return TURN_OF_TAG[tags.pop()]


def require_whole(videos: list[VideoInfo], enough: bool) -> list[str]:
    """A note for each file that holds fewer frames than its container states.

    Args:
        enough: the user says how many frames are wanted, so a file that breaks off after them will do.
    Raises:
        DataFormatError: a file breaks off.
    """
    notes = []
    for video in videos:
        if not video.stated_frames or video.frames == video.stated_frames or video.stamps_s is None:
            continue
        counts = f"{video.frames} of the {video.stated_frames} frames that it states can be read"
        if video.breaks_off and not enough:
            raise DataFormatError(
                f"{video.path}: breaks off: {counts}. Copy it from the camera again; to use what is there, give "
                f"--frames {video.frames} or fewer"
            )
        notes.append(f"{video.path.name}: {counts}")
    return notes


def require_one_rate(videos: list[VideoInfo]) -> None:
    """Raises GofError: the containers' rates differ, so one --fps cannot be true of all."""
    rates = {video.path.name: 1 / video.usual_step_s for video in videos if video.usual_step_s}
    if rates and max(rates.values()) > (1 + SAME_RATE) * min(rates.values()):
        each = ", ".join(f"{name} {rate:.4g}" for name, rate in rates.items())
        raise GofError(
            f"the files differ in rate ({each} frames per second) and one --fps is given for all: give each its true "
            "rate, as --fps 400 200 400, or --stamps if the files' time stamps are true time"
        )


def require_one_length(videos: list[VideoInfo], clocks: list[np.ndarray]) -> None:
    """Raises GofError: clips of different length, so they need not begin together.

    Args:
        clocks: (N,) s of every video's frames.
    """
    lasts = [clock[-1] - clock[0] for clock in clocks]
    step = max(np.median(np.diff(clock)) if len(clock) > 1 else 0.0 for clock in clocks)
    if max(lasts) - min(lasts) > 0.5 * step:
        each = ", ".join(f"{video.path.name} {video.frames}" for video in videos)
        zeros = " ".join("0" for _ in videos)
        raise GofError(
            f"the clips differ in length (frames: {each}): do they begin together? If so, say how many frames to use, "
            f"as --frames {min(video.frames for video in videos)}; if not, give a frame of each that was taken at the "
            f"same moment, as --start {zeros}, or film the board and use 'gof capture sync'"
        )


def require_few_missing(video: VideoInfo) -> None:
    """Raises DataFormatError: more than `MAX_MISSING` of a folder's pictures are missing by their numbers."""
    numbers = list(video.numbers or ())
    count, which = missing_numbers(numbers)
    if count > MAX_MISSING * (count + len(numbers)):
        raise DataFormatError(
            f"{video.path}: of the pictures' numbers {numbers[0]} to {numbers[-1]}, {count} are missing ({which}): "
            "were files lost, or did the counter begin again? If the numbers do not count frames, name the pictures "
            "0001, 0002, ... in the order in which they were taken"
        )


def require_one_beginning(videos: list[VideoInfo]) -> None:
    """Raises GofError: folders whose pictures begin at different numbers, so that one may lack its first ones."""
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
    """What the numbers of pictures say of their clock, where it is not one after the other."""
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


def other_notes(videos: list[VideoInfo], one_fov: bool) -> list[str]:
    """What is no error and yet worth saying: more than 8 bits, other sizes."""
    notes = [
        f"{video.path.name}: {video.bits} bits per channel are read as 8; if it is HDR (HLG or PQ), convert it to SDR "
        "first, or colours are not what was seen"
        for video in videos
        if (video.bits or 8) > 8
    ]
    sizes = [f"{v.width}x{v.height}" for v in videos]
    if len(set(sizes)) > 1 and one_fov:
        notes.append(f"the videos differ in size ({', '.join(sizes)}) and --fov is taken for each of them")
    return notes
