"""From videos of a fire by fixed cameras to a dataset that `gof reconstruct` reads, stage by stage."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.core.cameras import Camera
from gof.core.costs import StageLog
from gof.core.description import FILE as DATASET
from gof.core.drafts import remove
from gof.core.errors import DataFormatError, GofError
from gof.core.files import only_run_in
from gof.dataset import DatasetDescription, Splits
from gof.dataset.poses import FILE as POSES
from gof.dataset.poses import Poses
from gof.footage.steadying import by_number, look, steady
from gof.footage.videos import fingerprint
from gof.host.terminal import progress_bar
from gof.ingest.fire_free import FireFree, PlateOptions, make_plates, outside
from gof.ingest.flame_features import Moments, match_flames
from gof.ingest.footage import (
    Footage,
    PreparedClip,
    StoredView,
    camera_entries,
    resized,
    stored_view,
    write_picture,
    write_pictures,
)
from gof.ingest.frame_times import FrameTimes, Timing
from gof.ingest.over_time import darkest
from gof.ingest.place import Placed, place_alone, place_from_sketch
from gof.ingest.pose_clues import PoseClues, PoseOptions
from gof.ingest.published import CAMERAS_FILE, is_published

WRITTEN = ("cameras", "static", "depth", "points.ply", POSES, CAMERAS_FILE)  # names in the folder, but for records
GIVEN = ("", "--fov", "--cameras")  # sources of lenses that a user has named, or footage that brings its own
COSTS = "costs.json"
UNFINISHED = ".unfinished-ingest"  # costs so far; while it is there, files without a dataset are an unfinished run's


@dataclass(frozen=True)
class Ingested:
    """The finished dataset's folder, what its poses.json says, and what else a user should know, in words.

    Attributes:
        fire_left: share of each camera's plate that is still fire.
        fire_left_by_clip: the same of plates from the clip's own frames; None where they were made of nothing else.
        lens: which lenses were found, in words; None where they are given.
    """

    folder: Path
    poses: Poses
    fire_left: dict[str, float]
    fire_left_by_clip: dict[str, float] | None = None
    notes: tuple[str, ...] = ()
    lens: str | None = None


def require_new(out: Path, overwrite: bool = False) -> None:
    """Make sure that a dataset can be made in a folder.

    Args:
        overwrite: one that was made from footage is replaced.
    Raises:
        GofError: the folder holds a dataset, or files of a dataset's names that no unfinished run left.
    """
    if (out / DATASET).exists():
        replaceable = footage_of(out) is not None
        if overwrite and replaceable:
            return
        remedy = ", or replace it with --overwrite" if replaceable else " or remove it"
        raise GofError(f"{out}: already holds a dataset; choose another --out{remedy}")
    stray = _written_in(out)
    if stray and not (out / UNFINISHED).is_file():
        raise GofError(
            f"{out}: holds {', '.join(stray)}, with which a dataset would mix, and no unfinished run left them; choose "
            "another --out, or move them away"
        )


def _written_in(out: Path) -> list[str]:
    return [name for name in WRITTEN if (out / name).exists() or (out / name).is_symlink()]


def footage_of(out: Path) -> list[str] | None:
    """Return what tells the footage of a finished dataset: fingerprints of its videos, or the name of its published
    scene; None where there is no dataset made from footage."""
    try:
        made_by = DatasetDescription.read(out).provenance
    except DataFormatError:
        return None
    if "footage" not in made_by:
        return None
    if "scene" in made_by:
        return [str(made_by["scene"])]
    videos = made_by.get("videos")
    return [str(v.get("fingerprint")) for v in (videos if isinstance(videos, list) else []) if isinstance(v, dict)]


def is_made_of(out: Path, videos: Sequence[Path]) -> bool:
    """Return whether a finished dataset was made of these videos, wherever they lie now; other options may differ.

    Raises DataFormatError: a video is absent.
    """
    if (known := footage_of(out)) is None:
        return False
    return known == ([videos[0].name] if is_published(list(videos)) else [fingerprint(video) for video in videos])


def clear(out: Path) -> None:
    """Remove the dataset that a run replaces, or what one that was cut off left in the folder.

    Its pictures may be of other frames, or of another size; none of them may get into the next dataset.
    """
    for name in (DATASET, COSTS, *_written_in(out)):
        remove(out / name)


def make_dataset(
    out: Path,
    footage: Footage,
    timing: Timing,
    pose_options: PoseOptions,
    plate: PlateOptions,
    max_size: int | None = None,
    others: tuple[Footage, ...] = (),
    overwrite: bool = False,
) -> Ingested:
    """Write a dataset. Plates and poses are made from training frames only, and the dataset says so.

    Args:
        out: folder of the dataset.
        max_size: px; the dataset's pictures with a longer side are shrunk to it. Poses are always solved at full size.
        others: more clips of the same rig; their features and boards help to find the poses, and they may show what
            burns all the time in this one.
        overwrite: replace a dataset in `out` that was made from footage, once all is known that is to be written.
    Raises:
        GofError: `out` holds a dataset already, or files that it would mix with; another run is at work there; see
            the stages for what can be wrong with footage, times and poses.
    """
    require_new(out, overwrite)
    footage.require_fitting(pose_options)
    for given in (*footage.videos, *([plate.folder] if plate.folder else [])) if overwrite else ():
        if given.resolve().is_relative_to(out.resolve()):
            raise GofError(f"{given}: lies in {out}, which --overwrite replaces; move it elsewhere first")

    with only_run_in(out):
        require_new(out, overwrite)
        if not (out / DATASET).exists():
            clear(out)
        (out / UNFINISHED).unlink(missing_ok=True)
        made = _make(out, footage, timing, pose_options, plate, max_size, others)
        (out / UNFINISHED).replace(out / COSTS)
        return made


def _make(
    out: Path,
    footage: Footage,
    timing: Timing,
    pose_options: PoseOptions,
    plate: PlateOptions,
    max_size: int | None,
    others: tuple[Footage, ...],
) -> Ingested:
    """As `make_dataset`, in a folder that is this run's alone and holds at most a dataset that is to be replaced."""
    log = StageLog(out / UNFINISHED)
    read = _read_clips(footage, timing, plate, log)
    fire_free, clues = _remove_fire(footage, read, plate, others, pose_options, log)
    placed = _find_poses(out.name, footage, read, fire_free, clues, pose_options, log)
    footage = footage.seen_through(placed.lenses)
    cameras = placed_cameras(footage, read.times, placed)
    stored = [stored_view(camera, pixels, max_size) for camera, pixels in zip(cameras, fire_free.pictures, strict=True)]
    poses = Poses.of(placed.report, placed.points)
    made_by = _tell_provenance(footage, read, fire_free, plate, placed, others)
    boards = [footage.board_mask(c, board) for c, board in enumerate(read.times.boards or [None] * len(read.clips))]
    made_from = derived_files(stored, placed, plate.folder is None)
    clear(out)
    with log.measure("write"), watched("write", read.clips) as seen:
        for view, clip, board in zip(stored, seen, boards, strict=True):
            write_pictures(out, view, clip)
            if board is not None:
                write_picture(out / view.board_mask, resized(board, view.camera)[..., None])
        poses.write(out)
        footage.write_beside(out)
        entries = camera_entries(footage, read.times, stored, boards)
        DatasetDescription(
            out.name,
            tuple(read.times.time_s[0].tolist()),
            entries,
            read.splits,
            provenance=made_by,
            made_from=dict.fromkeys(made_from, read.splits.train),
        ).write(out)  # last: it says that the rest is there
    by_clip = fire_free.fire_left_by_clip
    return Ingested(
        out,
        poses,
        made_by["fire_left"],
        dict(zip(footage.names, by_clip, strict=True)) if by_clip else None,
        tuple(made_by["notes"]),
        None if footage.lens in GIVEN else footage.lens,
    )


@dataclass(frozen=True)
class ReadClips:
    """The cameras' clips on one clock, steadied, and the frames of them that may be learned from."""

    times: FrameTimes
    splits: Splits
    steadied: SteadiedClips

    @property
    def clips(self) -> list[PreparedClip]:
        return self.steadied.clips

    @property
    def beyond(self) -> list[PreparedClip]:
        return self.steadied.beyond

    @property
    def known(self) -> list[PreparedClip]:
        """All that a method may learn from."""
        return [clip.only(self.splits.train) for clip in self.clips]


def _read_clips(footage: Footage, timing: Timing, plate: PlateOptions, log: StageLog) -> ReadClips:
    """Find the frames' times, and what to do to the pictures."""
    with log.measure("read") as figures:
        times = footage.frame_times(timing)
        clips = footage.clips(times.frames)
        splits = footage.splits(len(clips[0]))
        steadied = steadied_clips(footage, clips, outside(footage, times.frames, plate), splits.train)
        figures.update(cameras=len(steadied.clips), frames=len(steadied.clips[0]))
    return ReadClips(times, splits, steadied)


def _remove_fire(
    footage: Footage,
    read: ReadClips,
    plate: PlateOptions,
    others: tuple[Footage, ...],
    pose_options: PoseOptions,
    log: StageLog,
) -> tuple[FireFree, list[PoseClues]]:
    """Make the plates, for which the rig's other clips are read: their clues to the poses are returned with them."""
    known, beyond = read.known, read.beyond
    with log.measure("plates") as figures:
        figures["plate"] = plate.source
        clues = [clues_of(other, pose_options) for other in others]
        passes = [plate.passes] * len(known) + [1] * len(beyond)
        with watched("plates", [*known, *beyond], passes) as seen:
            elsewhere = [[other.plates[c] for other in clues] for c in range(len(known))]
            fire_free = make_plates(footage, seen[: len(known)], seen[len(known) :], elsewhere, plate)
        figures["fire_left"] = fire_free.fire_left
    return fire_free, clues


def _find_poses(
    name: str,
    footage: Footage,
    read: ReadClips,
    fire_free: FireFree,
    others: list[PoseClues],
    options: PoseOptions,
    log: StageLog,
) -> Placed:
    """Place the cameras by the dataset's own clip and the clues of the rig's `others`."""
    known = read.known
    reads = (options.board is not None) + (options.sketch is not None)
    with log.measure("poses") as figures:
        with watched("poses: read", known, [1 + reads] * len(known)) as seen:
            clues = PoseClues.of(name, seen, fire_free.lowest, options)
            if len(seen) == 1 and footage.world_to_camera is None:
                placed = place_alone(seen[0], fire_free.pictures[0], footage.upright_lenses[0], clues, options)
            elif options.sketch is not None:
                placed = _place_by_sketch(footage, read, seen, fire_free, clues, options)
            else:
                placed = footage.place([clues, *others], options)
        figures.update(method=placed.report.method, points=len(placed.points))
    return placed


def _place_by_sketch(
    footage: Footage,
    read: ReadClips,
    seen: list[PreparedClip],
    fire_free: FireFree,
    clues: PoseClues,
    options: PoseOptions,
) -> Placed:
    """Place the cameras by a sketch and the flame in the frames that may be learned from."""
    train, times, lenses = np.array(read.splits.train), read.times, footage.upright_lenses
    views = [
        Camera(name, lens.width, lens.height, lens.K, np.eye(4), row_time_s, readout)
        for name, lens, row_time_s, readout in zip(footage.names, lenses, times.row_time_s, times.readout, strict=True)
    ]
    moments = Moments.of(train, [time_s[train] for time_s in times.time_s], views)
    flame = match_flames(seen, fire_free.pictures, views, moments)
    return place_from_sketch(flame, lenses, footage.names, clues, options)


def _tell_provenance(
    footage: Footage,
    read: ReadClips,
    fire_free: FireFree,
    plate: PlateOptions,
    placed: Placed,
    others: tuple[Footage, ...],
) -> dict:
    """Return what the dataset's description says of its making."""
    beyond = read.beyond
    plate_frames = {name: len(a) + len(b) for name, a, b in zip(footage.names, read.known, beyond, strict=bool(beyond))}
    return {
        "footage": [video.name for video in footage.videos],
        "plate": plate.source,
        "fire_left": dict(zip(footage.names, fire_free.fire_left, strict=True)),
        **({"plate_frames": plate_frames} if beyond else {}),
        "clock": read.times.source,
        "notes": [*footage.notes, *read.times.notes, *read.steadied.notes],
        "steadied": dict(zip(footage.names, read.steadied.figures, strict=True)),
        "mask": "estimated from the plates",
        "scale": placed.report.scale,
        **({"rig_clips": [other.videos[0].parent.name for other in others]} if others else {}),
        **footage.provenance,
    }


@dataclass(frozen=True)
class SteadiedClips:
    """Clips, and frames beyond them, that are brought to one place and exposure; what was found, in figures per camera
    and in words."""

    clips: list[PreparedClip]
    beyond: list[PreparedClip]
    figures: list[dict]
    notes: list[str]


def steadied_clips(
    footage: Footage, clips: list[PreparedClip], beyond: list[PreparedClip], train: Sequence[int]
) -> SteadiedClips:
    """Return the clips as cameras that neither move nor change their exposure would have filmed them.

    Args:
        beyond: frames outside the clips, per camera; empty: none are used.
        train: places of the frames that say what stands still.
    Raises:
        DataFormatError: a camera moves too much.
    """
    numbers = [np.union1d(clip.frames, more.frames) for clip, more in zip(clips, beyond or clips, strict=True)]
    everything = footage.clips(numbers)
    known = [np.searchsorted(n, np.array(clip.frames)[list(train)]) for n, clip in zip(numbers, clips, strict=True)]
    found = []
    with watched("what stands still", everything) as seen:
        for clip, places, video in zip(seen, known, footage.videos, strict=True):
            place = int(places[len(places) // 2])
            reference = next(iter(replace(clip, frames=clip.frames[place : place + 1], watch=lambda: None)))
            found.append(steady(look(clip, reference, place), places, video.name, np.array(clip.frames)))
    by_camera = [by_number(n, each) for n, each in zip(numbers, found, strict=True)]
    return SteadiedClips(
        [replace(clip, corrections=c) for clip, c in zip(clips, by_camera, strict=True)],
        [replace(clip, corrections=c) for clip, c in zip(beyond, by_camera, strict=bool(beyond))],
        [each.figures for each in found],
        [note for each in found for note in each.notes],
    )


@contextmanager
def watched(title: str, clips: list[PreparedClip], passes: list[int] | None = None) -> Iterator[list[PreparedClip]]:
    """Provide the clips, with a progress bar over all their frames; each clip is read so many times, once by
    default."""
    total, done = sum(n * len(clip) for n, clip in zip(passes or [1] * len(clips), clips, strict=True)), 0
    with progress_bar(title) as update:

        def count() -> None:
            nonlocal done
            done += 1
            update(done, max(done, total))

        yield [replace(clip, watch=count) for clip in clips]


def derived_files(stored: list[StoredView], placed: Placed, plates_of_clip: bool) -> list[str]:
    """Return names of the dataset's files that are computed from the clip's training frames, masks of single frames
    aside."""
    files = [view.static for view in stored] if plates_of_clip else []
    files += [POSES] if placed.report.method in ("features", "points", "sketch", "one camera") else []
    return files


def clues_of(footage: Footage, options: PoseOptions) -> PoseClues:
    """Return clues to the poses from another clip of the rig. Still things need no times: all frames are used."""
    name = footage.videos[0].parent.name
    everything = footage.all_clips()
    everything = steadied_clips(footage, everything, [], range(min(map(len, everything)))).clips
    with watched(f"read {name}", everything, [2 + (options.board is not None)] * len(everything)) as clips:
        return PoseClues.of(name, clips, [darkest(clip) for clip in clips], options)


# ---- cameras ---------------------------------------------------------------------------------------------------------


def placed_cameras(footage: Footage, times: FrameTimes, placed: Placed) -> list[Camera]:
    """Return the cameras of the prepared pictures at full size."""
    return [
        Camera(name, lens.width, lens.height, lens.K, pose, row_time_s, readout)
        for name, lens, pose, row_time_s, readout in zip(
            footage.names,
            footage.upright_lenses,
            placed.world_to_camera,
            times.row_time_s,
            times.readout,
            strict=True,
        )
    ]
