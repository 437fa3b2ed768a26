"""A minute's look at footage before the long work: what will spoil it, in figures, and how to film it better."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gof.capture.boardless import synchronise_without_board
from gof.capture.recognise import AUTO, BoardUnclear, first_frames, recognise
from gof.core.errors import DataFormatError, GofError
from gof.footage.chapters import chapters_before
from gof.footage.flame_mask import flame_mask
from gof.footage.lens import turned
from gof.footage.steadying import FrameCorrection, look, steady
from gof.footage.videos import VideoInfo, chapters_in_words, chosen_frames, read_info, require_different
from gof.ingest.agreement import TURN_OF_TAG, other_notes
from gof.ingest.common_views import weakest_link
from gof.ingest.over_time import LUMA, darkest
from gof.ingest.plates import MOST_FIRE_LEFT, fire_left, fire_reached

PAIRS = 32  # of neighbouring frames, all over the film, that are looked at
LONGEST_PX = 480  # size at which they are
STANDS = 20  # of these frames, in which shake and exposure are measured: both show in any of them
CLIPPED = 250  # of 255, in red and green: there colour and brightness are lost
NO_FLAME = 2e-4  # share of the picture
CHANCE, ENOUGH = 30, 200  # features that two cameras share: of different places up to 25; below 200 no poses were found
BARE = 200  # features of a picture, below which nothing behind the fire has a pattern
EDGE = 0.02  # share of a side of the picture in which the flame is cut off
Verdict = Literal["good", "look", "bad"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        about: the thing: "exposure", "rate", ...   camera: the video's name; empty: all of them together.
        figure: what was measured, in the unit that `words` say; None: nothing.
        words: a plain sentence.   remedy: what to do; empty where all is good.
    """

    about: str
    camera: str
    verdict: Verdict
    figure: float | None
    words: str
    remedy: str = ""


def graded(about: str, camera: str, figure: float, limits: tuple[float, float], words: str, remedy: str) -> Finding:
    """Return a finding that is good up to the first limit and bad beyond the second."""
    verdict: Verdict = "good" if figure <= limits[0] else "look" if figure <= limits[1] else "bad"
    return Finding(about, camera, verdict, round(float(figure), 5), words, "" if verdict == "good" else remedy)


def look_over(videos: list[Path]) -> list[Finding]:
    """Return what was found in each video, then what they have in common.

    Raises:
        DataFormatError: a video cannot be read, or is given twice.
    """
    require_different(videos)
    infos = [read_info(video) for video in videos]
    looks = [of_camera(info) for info in infos]
    found = [finding for findings, _ in looks for finding in findings]
    whole = {chapters_in_words(info) for info in infos if chapters_before(info.path)[0] == 1}
    notes = other_notes(infos, False)
    found += [Finding("files", "", "good" if note in whole else "look", None, note) for note in notes]
    if len(videos) == 1:
        return found
    return [*found, _angle([plate for _, plate in looks], [info.path.name for info in infos]), clocks(videos)]


# ---- one camera ------------------------------------------------------------------------------------------------------


def of_camera(info: VideoInfo) -> tuple[list[Finding], np.ndarray]:
    """Return what one video shows and its file says, and (h, w, 3) uint8 of what is behind the fire."""
    name, numbers = info.path.name, _numbers(info.frames or 0)
    frames = _small(info, numbers)
    stands = _stands(frames, name, numbers, info)
    if any(finding.about == "shake" and finding.verdict != "good" and finding.figure for finding in stands):
        frames = _held_still(frames, name, numbers)  # or a hand's moves would count as the flame's
    plate = darkest(frames)
    masks = np.array([flame_mask(frame.astype(np.float32) / 255, plate.astype(np.float32) / 255) for frame in frames])
    found = [*_file(info), *stands]
    if masks.mean() < NO_FLAME:
        words = f"no flame is seen in {len(frames)} frames"
        remedy = "is it the right film? In a dark or white flame red must outshine what is behind it"
        return [Finding("flame", name, "bad", round(float(masks.mean()), 6), words, remedy), *found], plate
    return [*_flame(frames, masks, plate, name), _speed(frames, masks, plate, numbers, name), *found], plate


def _numbers(count: int) -> np.ndarray:
    """Return numbers of the frames that are looked at: pairs of neighbours."""
    first = np.unique(np.linspace(0, max(count - 2, 0), PAIRS).astype(int))
    return np.unique(np.minimum(np.r_[first, first + 1], count - 1))


def _small(info: VideoInfo, numbers: np.ndarray) -> np.ndarray:
    """Return (N, h, w, 3) uint8 upright pictures of at most `LONGEST_PX`."""
    import cv2

    scale = min(1.0, LONGEST_PX / max(info.width, info.height))
    size = (round(info.width * scale), round(info.height * scale))
    turn = TURN_OF_TAG[info.rotation_deg]
    pictures = chosen_frames(info.path, numbers.tolist())
    return np.array([turned(cv2.resize(p, size, interpolation=cv2.INTER_AREA), turn) for p in pictures])


def _flame(frames: np.ndarray, masks: np.ndarray, plate: np.ndarray, name: str) -> list[Finding]:
    """Return exposure, size, and whether every place is free of fire once."""
    flame = frames[masks]
    clipped = float(((flame[:, 0] >= CLIPPED) & (flame[:, 1] >= CLIPPED)).mean())
    often = masks.mean(0) > 0.1
    rows, columns = np.flatnonzero(often.any(1)), np.flatnonzero(often.any(0))
    tall = (np.ptp(rows) + 1) / often.shape[0] if len(rows) else 0.0
    wide = (np.ptp(columns) + 1) / often.shape[1] if len(columns) else 0.0
    sides = {"top": masks[:, 0], "left": masks[:, :, 0], "right": masks[:, :, -1]}
    cut = {side: float((edge.mean(1) > EDGE).mean()) for side, edge in sides.items()}
    worst = max(cut, key=cut.__getitem__)
    left = fire_left(plate, fire_reached(frames, plate))
    return [
        graded(
            "exposure",
            name,
            clipped,
            (0.1, 0.3),
            f"{clipped:.0%} of the flame is clipped, without colour or brightness",
            "lock a shorter exposure, by two stops or more, until the flame's heart is yellow and not white",
        ),
        graded(
            "size",
            name,
            -max(tall, wide),
            (-0.25, -0.12),
            f"the flame takes {wide:.0%} of the picture's width and {tall:.0%} of its height",
            "go nearer or zoom in (all cameras alike), so that the highest flames nearly fill the picture",
        ),
        graded(
            "frame",
            name,
            cut[worst],
            (0.05, np.inf),
            f"the flame is cut off at the {worst} in {cut[worst]:.0%} of the frames"
            if cut[worst]
            else "nothing is cut off",
            "leave room around the highest flames",
        ),
        graded(
            "plate",
            name,
            left,
            (MOST_FIRE_LEFT, 5 * MOST_FIRE_LEFT),  # where gof ingest warns, and where little of the plate is right
            f"{left:.2%} of the picture never shows what is behind the fire",
            "film the place for some seconds without fire from the same tripod, and give gof ingest --plates FOLDER",
        ),
    ]


def _speed(frames: np.ndarray, masks: np.ndarray, plate: np.ndarray, numbers: np.ndarray, name: str) -> Finding:
    """Return how unlike neighbouring frames' flames are: 1 - correlation of their light above the plate."""
    unlike = []
    for k in np.flatnonzero(np.diff(numbers) == 1):
        where = masks[k] | masks[k + 1]
        if where.sum() > 20:
            dark = plate[where].astype(np.float32) @ LUMA
            a, b = (np.maximum(frames[n][where].astype(np.float32) @ LUMA - dark, 0) for n in (k, k + 1))
            unlike.append(1 - float(np.corrcoef(a, b)[0, 1]) if a.std() > 0 and b.std() > 0 else 1.0)
    figure = float(np.median(unlike)) if unlike else 1.0
    return graded(
        "rate",
        name,
        figure,
        (0.2, 0.45),  # eight clips at 400 a second have 0.07 to 0.16, every 13th frame of theirs 0.6 to 0.8
        f"the flame of a frame is {1 - figure:.0%} like that of the next one",
        "film at a higher rate (slow motion: 120 or 240 frames per second), or a larger, slower fire",
    )


def _held_still(frames: np.ndarray, name: str, numbers: np.ndarray) -> np.ndarray:
    """Return the (N, h, w, 3) uint8 frames without the camera's moves, as far as `gof ingest` puts them right."""
    place = len(frames) // 2
    try:
        found = steady(look(frames, frames[place], place), np.arange(len(frames)), name, numbers)
    except DataFormatError:
        return frames
    moves = [FrameCorrection(correction.matrix, None, frames[place]) for correction in found.frames]
    return np.array([move.applied(frame) for move, frame in zip(moves, frames, strict=True)]) if moves else frames


def _stands(frames: np.ndarray, name: str, numbers: np.ndarray, info: VideoInfo) -> list[Finding]:
    """Return shake and exposure's drift, by what stands still."""
    tripod = "put the camera on a tripod and release it without touching it"
    lock = "lock exposure and white balance by hand"
    every = max(1, len(frames) // STANDS)
    frames, numbers = frames[::every], numbers[::every]
    place = len(frames) // 2
    try:
        found = steady(look(frames, frames[place], place), np.arange(len(frames)), name, numbers)
    except DataFormatError as e:
        return [Finding("shake", name, "bad", None, str(e).removeprefix(f"{name}: "), tripod)]
    width = frames.shape[2]
    share = float(found.moved_px.max()) / width
    if found.points == 0:
        words = "too little stands still in the picture to tell whether the camera does"
        shake = Finding("shake", name, "look", None, words, "let something lit and patterned stand beside the fire")
    else:
        words = f"the camera moves by up to {share:.2%} of the picture's width"
        shake = graded("shake", name, share, (0.0015, 0.01), words, f"{tripod}; gof ingest puts up to 2 % right")
    gain = found.gain.mean(1)
    change = float(gain.max() / gain.min() - 1)
    notes = [note.removeprefix(f"{name}: ") for note in found.notes if "change" in note or "flicker" in note]
    if change == 0 and notes:
        return [shake, Finding("light", name, "look", None, notes[0], lock)]
    words = f"the exposure changes by {change:.0%}"
    return [shake, graded("light", name, change, (0.03, 0.5), words, f"{lock}; gof ingest puts such changes right")]


def _file(info: VideoInfo) -> list[Finding]:
    """Return what the file says of its frames: repeats, and an uneven rate."""
    name, found = info.path.name, []
    count, stamps = info.frames or 0, info.stamps_s
    share = len(info.repeated) / max(count, 1)
    if share:
        words = f"{len(info.repeated)} of {count} frames show the one before again"
        remedy = "give the camera's own file, not one that an app or a program has exported"
        found.append(graded("repeats", name, share, (0.0, 0.1), words, remedy))
    if info.usual_step_s and stamps is not None and count > 2:
        steps = np.diff(stamps) / info.usual_step_s
        uneven = float(np.quantile(np.abs(steps - np.rint(steps).clip(1)), 0.9))
        how = "evenly" if uneven <= 0.05 else "unevenly"
        words = f"frames come {how}, by the file {1 / info.usual_step_s:.4g} per second"
        remedy = "lock the rate (no automatic frame rate in low light), or give gof ingest --times stamps"
        found.append(graded("times", name, uneven, (0.05, 1.0), words, remedy))
    return found


# ---- together --------------------------------------------------------------------------------------------------------


def _angle(plates: list[np.ndarray], names: list[str]) -> Finding:
    """Return whether the cameras see enough in common to be placed by it."""
    link = weakest_link(plates)
    a, b = (names[c] for c in link.cameras)
    words = f"{a} and {b} see {link.shared} things alike behind the fire"
    if link.shared < CHANCE:
        words += ", no more than pictures of different places do"
    pattern = "put bricks, gravel or printed paper behind the fire"
    if link.features < BARE:
        words += f"; one of them shows hardly any pattern ({link.features} places)"
        remedy = f"{pattern}, all over the picture"
    else:
        remedy = f"stand neighbouring cameras about 10 degrees apart, as seen from the fire, and {pattern}"
    remedy += "; else film the sync board whole in every view, or mark points for gof ingest --points"
    return graded("angle", "", -link.shared, (-ENOUGH, -CHANCE), words, remedy)


def clocks(videos: list[Path]) -> Finding:
    """Return whether `gof capture sync` finds how the films' clocks lie, and by what."""
    clap = "clap once in sight and hearing of all cameras, or film a sync board (gof capture draw)"
    try:
        board = recognise(AUTO, first_frames(list(videos)))
    except BoardUnclear as e:
        return Finding("sync", "", "look", None, str(e), clap)
    if board is not None:
        return Finding("sync", "", "good", None, f"the board {board.name} is seen: gof capture sync reads its clock")
    try:
        take, _ = synchronise_without_board(list(videos), [None] * len(videos))
    except GofError as e:
        return Finding("sync", "", "bad", None, f"no board is seen, and {e}", clap)
    known = [camera.times for camera in take.cameras if camera.times is not None]
    off_s = max(times.systematic_us for times in known) * 1e-6
    by = "the films' sound" if known[0].clock == "sound" else "the flames' light"
    step_s = max(times.frame_interval_us for times in known) * 1e-6
    words = f"the films' clocks are found by {by}, to {1000 * off_s:.1f} ms, {off_s / step_s:.1f} frames"
    return graded("sync", "", off_s / step_s, (0.3, 2.0), words, clap)


def summary(found: list[Finding]) -> dict:
    """Return the figures of --json."""
    worst = next((v for v in ("bad", "look") if any(f.verdict == v for f in found)), "good")
    return {"verdict": worst, "findings": [asdict(finding) for finding in found]}
