"""`gof ingest`: videos of a fire by fixed cameras -> a dataset that `gof reconstruct` reads."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal, get_args

import tyro

from gof.capture.recognise import BoardUnclear, first_frames, recognise, require_strips
from gof.capture.template import BoardTemplate
from gof.capture.times import FILE
from gof.commands import capture_sync
from gof.commands.each import folder_of_each, run_each
from gof.commands.everywhere import may_overwrite, next_to, require_writable
from gof.commands.read import Degrees, Metres, Millimetres, Pixels, read_options
from gof.core.costs import StageLog
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.dataset.poses import UpReport
from gof.footage.containers import focal_35mm
from gof.footage.folders import has_pictures, videos_of_take
from gof.footage.lens import Turn
from gof.footage.videos import require_different, stated_fps
from gof.host.options import require_all_positive, require_number, require_positive
from gof.ingest.accelerometer import read_tilt
from gof.ingest.fire_free import PlateKind, PlateOptions
from gof.ingest.focal import is_findable, phones_in_words
from gof.ingest.footage import Footage
from gof.ingest.frame_times import Timing
from gof.ingest.given_rig import known_rig, require_sketched, rig_sketch
from gof.ingest.marked_points import read_points
from gof.ingest.pipeline import Ingested, is_made_of, make_dataset, require_new
from gof.ingest.place import require_no_more
from gof.ingest.plates import MOST_FIRE_LEFT, find_plates
from gof.ingest.pose_clues import PoseOptions, Solver
from gof.ingest.published import PublishedFootage, is_published
from gof.ingest.up import UpChoice

MOST_FOV_DEG = 170.0
NO_HEIGHT = "--flame-height-m: only for a single camera whose pose is not known; leave it out"
SYNC = "sync"  # word of --times, and the dataset's folder for what it finds
TAGGED = ("auto", "accelerometer")  # ways up that ask the files' sensors


@dataclass
class IngestConfig:
    """Make a dataset from videos of a fire by fixed cameras: pictures, fire-free backgrounds (plates), camera poses,
    frame times.

    Examples:
      gof ingest cam_0.mp4 cam_1.mp4 cam_2.mp4 --times sync/times.json --cameras cameras.json
      gof ingest a.mp4 b.mp4 c.mp4 --times 240 --start 0 7 0 --fov 65 --baseline-m 1.2 --out data/mine
      gof ingest takes/1 takes/2 --times sync --cameras cameras.json --out data/takes      data/takes/1 and data/takes/2

    Poses come from the plates by structure from motion; where that fails or contradicts the board, from the sync
    board's marker or from points given with --points. Frames are paired by time: cameras may differ in rate and drop
    frames.
    """

    FIRST: ClassVar = ("out", "times", "cameras", "fov", "start", "plates", "max_size", "marker_mm")

    videos: tyro.conf.Positional[Annotated[list[Path], tyro.conf.arg(metavar="VIDEO ...")]]
    """One video or folder of pictures per camera, of one fire (of a single one depth is a guess); or folders, each with
    the videos of one take; or one scenes/ID folder of the authors' public data set (fire_actioncam), which brings its
    own cameras and times."""
    out: Path | None = None
    """Folder of the dataset to write. Default: beside the first video, named after it: cam_0_dataset. Several
    takes have folders of their names in it."""
    times: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FILE|sync|FPS|stamps")] = ()
    """When the frames were taken: times.json of `gof capture sync` for these videos in this order; "sync" makes it, by
    the board, the films' sound or the flames' light; or the true capture rate, one for all cameras or one each; or
    "stamps", where the files' time stamps are true seconds (a phone's variable rate, not slow motion) and the films
    begin together."""
    cameras: Path | None = None
    """JSON: {"cameras": [{"width", "height", "K", "distortion"?, "world_to_camera"?}, ...]} of the pictures as stored,
    in the videos' order, or one entry for all. With world_to_camera (of the upright picture, metres) for all, poses are
    not solved."""
    fov: Degrees | None = None
    """Horizontal field of view of the stored pictures, for all cameras, when there is no --cameras. When not given, the
    matches of three cameras or more tell it, or the files. A phone stores an upright video lying, with a rotation tag:
    then it is along the long side."""
    turn: tuple[Turn | Literal["auto"], ...] = ("auto",)
    """Turn that makes the stored pictures upright, one for all or one each; "auto": by the file's rotation tag (phones
    write it)."""
    plates: Annotated[str, tyro.conf.arg(metavar="steady|minimum|FOLDER")] = "steady"
    """The fire-free picture of each camera. "steady": per pixel, the darkest value where fire passed, else the median;
    "minimum": the darkest everywhere; steady:200 or minimum:200: of so many frames around the clip (--start, --frames),
    which may show what the fire hides all through the clip; or a folder with a fire-free picture or film of each
    camera, cam_0.png or cam_0.mp4 ..., as stored. Held-out frames are never used."""
    points: Path | None = None
    """JSON of correspondences by hand, see docs/ingest.md; points with xyz also give the scale."""
    board: str = "auto"
    """Sync board in the pictures: "auto" recognises a built-in one (gof_board, paper_rig); or its name, or the JSON
    file of your own; "none" does not look. A board that gave --times is masked, unless "none"."""
    marker_mm: Millimetres | None = None
    """Side of the board's marker: gives the scale."""
    baseline_m: Metres | None = None
    """Distance between the first and the last camera: gives the scale."""
    flame_height_m: Metres | None = None
    """For a single camera: height of the flame from its foot to its highest tip; gives the scale."""
    poses: Solver = "auto"
    """"features": structure from motion; "points": board or --points, refined with features; "auto": the first that
    holds."""
    rig: Annotated[Path | None, tyro.conf.arg(metavar="DATASET|SKETCH")] = None
    """Dataset made from another clip of the same rig. Its poses are used if the still pictures show that no camera
    moved since, and no other evidence contradicts them. Or, where nothing but the flame is seen, a sketch of the rig:
    "3 in a row, 0.5 m apart, 2 m away", or "3 in an arc, 10 degrees apart, 2 m away". The cameras stand at one height,
    in the videos' order from left to right, look at the flame's middle, and are found from the flame itself."""
    with_clip: list[Path] = field(default_factory=list)
    """Folders of more clips of the same rig, with videos of the same names: features and boards of all clips solve the
    poses together. A take that is named here, too, is left out for itself."""
    up: UpChoice = "auto"
    """Direction of Z: "points" of --points that mark what is upright or level, the cameras' "accelerometer" (GoPro),
    "edges" of upright things (posts, walls), the sync "board" standing upright, the "cameras" held level on average;
    "auto": the first of points, accelerometers (two that agree), edges (if they agree) and cameras that gives one."""
    max_size: Pixels | None = None
    """The dataset's pictures with a longer side are shrunk to it; poses are always solved at full size."""
    start: tuple[int, ...] = (0,)
    """First frame of the first camera to use; or, where no times.json is given, a frame of each camera that was taken
    at the same moment, as --start 0 7 0."""
    frames: int | None = None
    """Use only so many frames."""

    def timing(self, out: Path) -> Timing:
        """Return the times by --times, and the frames to use; "sync" is a file beside the dataset `out`. Raises
        GofError: it is neither a file, nor rates, nor "sync", nor "stamps"."""
        times, rates, stamps = read_times((str(out / SYNC / FILE),) if self.times == (SYNC,) else self.times)
        return Timing(times, rates, stamps, self.start, self.frames, self.board != "none")

    def plate_options(self) -> PlateOptions:
        """Return the plates' source by --plates. Raises GofError: a number of frames that is none."""
        kind, colon, frames = self.plates.partition(":")
        kinds = get_args(PlateKind)
        if kind not in kinds:
            return PlateOptions(folder=Path(self.plates))
        if colon and not frames.isdecimal():
            raise GofError(f"--plates {self.plates}: write a number of frames behind the colon, as {kind}:200")
        require_number("--plates", int(frames) if colon else None, least=1)
        return PlateOptions(kinds[kinds.index(kind)], None, int(frames) if colon else None)


def read_times(words: tuple[str, ...]) -> tuple[Path | None, tuple[float, ...], bool]:
    """Return a file of times, rates in frames per second, and whether the files' own stamps hold: one of the three, or
    none.

    Raises:
        GofError: the words are none of these.
    """
    if words == ("stamps",):
        return None, (), True
    try:
        return None, tuple(map(float, words)), False
    except ValueError:
        if len(words) == 1:
            return Path(words[0]), (), False
    raise GofError(
        f"--times {' '.join(words)}: give one times.json of 'gof capture sync', rates in frames per second, sync, or "
        "stamps"
    )


def ingest(config: IngestConfig) -> Ingested:
    """Make the dataset. Raises GofError as `make_dataset`, or for a number that is none."""
    require_number("--fov", config.fov, above=0, most=MOST_FOV_DEG)
    require_positive("--marker-mm", config.marker_mm)
    require_positive("--baseline-m", config.baseline_m)
    require_positive("--flame-height-m", config.flame_height_m)
    require_number("--max-size", config.max_size, least=16)
    require_number("--frames", config.frames, least=1)
    for start in config.start:
        require_number("--start", start, least=0)
    out = config.out or _default_out(config.videos)
    timing, plate = config.timing(out), config.plate_options()
    require_all_positive("--times", timing.fps)
    require_new(out, may_overwrite())
    if not is_published(config.videos):
        timing.require_one_way()  # now: reading the footage may take minutes
    if plate.folder is not None and not is_published(config.videos):  # now, as the times are
        find_plates(plate.folder, [f"cam_{c}" for c in range(len(config.videos))])
    require_fitting(config, timing)
    footage = open_footage(config)
    if config.times == (SYNC,) and not is_published(config.videos):
        (out / SYNC / FILE).unlink(missing_ok=True)  # of a run that was cut off, perhaps of other videos
        capture_sync.find_clocks(capture_sync.SyncConfig(config.videos, out / SYNC, config.board, report=False))
    sketch = None if config.rig is None else rig_sketch(config.rig)
    if sketch is not None:
        require_sketched(sketch, footage, config.poses)
    if config.flame_height_m is not None and (len(footage.videos) > 1 or footage.world_to_camera is not None):
        raise GofError(NO_HEIGHT)
    pose_options = PoseOptions(
        solver=config.poses,
        by_hand=tuple(read_points(config.points, footage.names)) if config.points else (),
        board=board_in(config.board, footage.videos),
        marker_m=None if config.marker_mm is None else config.marker_mm / 1000,
        baseline_m=config.baseline_m,
        flame_height_m=config.flame_height_m,
        rig=known_rig(config.rig, footage) if config.rig and sketch is None else None,
        sketch=sketch,
        up=config.up,
        tilts=tuple(map(read_tilt, footage.videos, footage.turns)) if config.up in TAGGED else (),
    )
    return make_dataset(
        out,
        footage,
        timing,
        pose_options,
        plate,
        max_size=config.max_size,
        others=tuple(footage.other(clip_videos(footage.videos, folder)) for folder in config.with_clip),
        overwrite=may_overwrite(),
    )


def require_fitting(config: IngestConfig, timing: Timing) -> None:
    """Raise GofError: an option is for another number of cameras, or names a dataset or a clip that is not there. It
    reads no video, which may take minutes."""
    sketch = None if config.rig is None else rig_sketch(config.rig)
    if config.rig is not None and sketch is None:
        Dataset.open(config.rig)
    if is_published(config.videos):
        return
    if sketch is not None and len(config.videos) > 1:
        sketch.centres(len(config.videos))
    timing.require_fitting(len(config.videos), made=config.times != (SYNC,))
    for folder in config.with_clip:
        clip_videos(config.videos, folder)
    if len(config.videos) > 1 and config.flame_height_m is not None:
        raise GofError(NO_HEIGHT)
    if len(config.videos) == 1 and config.cameras is None:
        require_no_more(config.points, config.marker_mm, config.baseline_m, config.rig, config.poses)


def _default_out(videos: list[Path]) -> Path:
    """Beside the first video, named after it."""
    return require_writable(videos[0].absolute().parent) / f"{videos[0].stem}_dataset"


def board_in(choice: str, videos: tuple[Path, ...]) -> BoardTemplate | None:
    """Return the sync board of these videos; None where none is looked for, seen, or known. Raises as `recognise`."""
    if choice == "none":
        return None
    try:
        found = recognise(choice, first_frames(list(videos)), rings=False)
    except BoardUnclear as e:
        print(f"note: no board helps to find the cameras: {e}", file=sys.stderr)
        return None
    return None if found is None else require_strips(found, "gof ingest")


def require_what_no_file_says(config: IngestConfig, argv: list[str]) -> None:
    """Raise GofError: times or lenses are not given. Names all that is missing, and a whole command that has it."""
    if is_published(config.videos):
        return
    missing, more, hint = [], [], ""
    if not config.times:
        missing.append(
            "when the frames were taken: --times with the true capture rate, with times.json of 'gof capture sync', "
            "with 'sync' (by board, sound or flame), or with 'stamps' (the files' own time stamps, as phones write "
            "them)"
        )
        require_different(config.videos[:1])
        rate = stated_fps(config.videos[0]) or 30.0  # the file's, which may be that of playback
        more += ["--times", f"{rate:.6g}"]
    stated = [focal_35mm(video) if video.is_file() else None for video in config.videos]
    if config.cameras is None and config.fov is None and not is_findable(stated):
        missing.append(
            "through which lenses, which only three cameras or more find by themselves: --fov with the horizontal "
            "field of view in degrees, or --cameras cameras.json of 'gof capture calibrate'"
        )
        more += ["--fov", "70"]
        hint = f". {phones_in_words()}"
    if missing:
        command = shlex.join(["gof", "ingest", *argv, *more])
        raise GofError(f"no file says {'; nor '.join(missing)}{hint}. With your own numbers: {command}")


def clip_videos(own: Sequence[Path], folder: Path) -> list[Path]:
    """Return the videos of another clip by the cameras of `own`. Raises GofError: one is missing, or it is this
    clip."""
    videos = [folder / video.name for video in own]
    if any(video.exists() and video.samefile(mine) for video, mine in zip(videos, own, strict=True)):
        raise GofError(
            f"--with-clip {folder}: is this clip itself; its held-out frames must not be used for backgrounds. "
            "For frames outside the clip use --plates steady:200"
        )
    if len(set(videos)) < len(videos):
        raise GofError("--with-clip: this clip's videos share a name; put each clip's videos into a folder of its own")
    for video in videos:
        if not video.exists():
            raise GofError(f"--with-clip {folder}: no {video.name} there; give its videos the names of this clip's")
    return videos


def open_footage(config: IngestConfig) -> Footage:
    """Return the footage with what is known of its cameras. Raises GofError as `Footage.open`,
    `PublishedFootage.read`."""
    if not is_published(config.videos):
        return Footage.open(config.videos, config.turn, config.cameras, config.fov)
    if config.cameras is not None or config.fov is not None:
        raise GofError(f"{config.videos[0]}: the scene brings its cameras; leave out --cameras and --fov")
    if len(set(config.turn)) > 1:
        raise GofError(f"{config.videos[0]}: the scene's cameras lie alike; give one --turn")
    turn = "none" if config.turn[0] == "auto" else config.turn[0]  # their lenses say how pictures lie
    return PublishedFootage.read(config.videos[0], turn, config.baseline_m)


def up_in_words(up: UpReport) -> str:
    """Return the source of Z, for people."""
    if up.source == "cameras":
        return "up: the cameras' mean up, right if they were level; nothing else shows the vertical (see --up)"
    source = {
        "points": "the marked points",
        "accelerometer": "the cameras' accelerometers",
        "edges": f"{up.edges} edges",
        "board": "the board, taken to stand upright",
    }[up.source]
    spread = "" if up.spread_deg is None else f", spread {up.spread_deg:.1f} degrees"
    return f"up: from {source}{spread}; {up.lean_deg:.1f} degrees from the cameras' mean up"


def fire_left_in_words(left: dict[str, float], by_clip: dict[str, float] | None = None) -> str:
    """Return the cleanness of the plates, and of ones from the clip's own frames, for people."""
    was = {name: f" (from the clip alone {share:.1%})" for name, share in (by_clip or {}).items()}
    each = (f"{name} {share:.1%}{was.get(name, '')}" for name, share in left.items())
    words = f"fire left in the plates: {', '.join(each)}"
    if max(left.values()) <= MOST_FIRE_LEFT:
        return words
    return (
        f"{words}; more than {MOST_FIRE_LEFT:.0%} of the picture never shows what is behind the fire: give plates "
        "filmed without fire (--plates FOLDER), a longer part of the videos (--plates steady:200), or more clips of "
        "the same rig (--with-clip)"
    )


def takes_of(config: IngestConfig) -> dict[Path, IngestConfig]:
    """Return what to make of each take, where every word names a folder with one's videos; else of the videos.

    Raises:
        GofError: some words name a take and others do not; an option holds for one take only; two takes have one name.
    """
    words = config.videos
    videos = {word: found for word in words if (found := _footage_in(word))}
    if len(videos) < len(set(words)):
        require_no_take(words)
        return {words[0]: config}
    if len(words) > 1:
        times, _, _ = read_times(() if config.times == (SYNC,) else config.times)
        for option, given in (
            ("--times FILE", times is not None),
            ("--points", config.points is not None),
            ("--start", len(config.start) > 1),
        ):
            if given:
                raise GofError(f"{option}: holds for one take, and here are {len(words)}; give them one by one")
    place = folder_of_each(words, config.out)
    return {
        folder: replace(
            config,
            videos=videos[folder],
            out=place(folder) or next_to(folder, "_dataset"),
            with_clip=[clip for clip in config.with_clip if clip.resolve() != folder.resolve()],
        )
        for folder in words
    }


def _footage_in(word: Path) -> list[Path]:
    """Return the footage of a take's folder; none where the word is no such folder."""
    if not word.is_dir():
        return []
    return [word] if is_published([word]) else videos_of_take(word)


def require_no_take(words: list[Path]) -> None:
    """Make sure that videos or folders of pictures, one for each camera, are not mixed with folders of takes.

    Raises:
        GofError: they are, or a folder holds folders of takes (names the word that is wrong).
    """
    for word in words:
        bare = word.is_dir() and not _footage_in(word) and not has_pictures(word)
        if within := sorted(folder for folder in word.iterdir() if _footage_in(folder)) if bare else []:
            raise GofError(f"{word}: holds folders with videos, as {within[0].name}; give these: {word}/*")
    takes = [word for word in words if _footage_in(word)]
    if not takes:
        return
    other = next(word for word in words if word not in takes)
    if not other.exists():
        wrong = "no such folder"
    elif other.is_file():
        wrong = "is a file"
    else:
        wrong = "holds pictures" if has_pictures(other) else "holds no videos"
    raise GofError(
        f"{other}: {wrong}, but {takes[0]} is a folder with the videos of a take: give folders with nothing but the "
        "videos of one take each, or one video or folder of pictures for each camera"
    )


def main(argv: list[str]) -> int:
    """`gof ingest VIDEO... [--out DATASET]`; see --help."""
    config = read_options(IngestConfig, "ingest", argv)
    takes = takes_of(config)
    for take in takes.values():
        require_what_no_file_says(take, argv)
    make = ingest_one if len(takes) == 1 else ingest_unless_there
    return run_each(list(takes), lambda folder: make(takes[folder]))


def ingest_unless_there(config: IngestConfig) -> dict:
    """Make one of several datasets, as `ingest_one`; one that is finished and made of the same videos is kept."""
    out = config.out or _default_out(config.videos)
    if may_overwrite() or not is_made_of(out, config.videos):
        return ingest_one(config)
    print(f"{out}: is there already, made of these videos; --overwrite makes it anew")
    return {"dataset": str(out)}


def ingest_one(config: IngestConfig) -> dict:
    """Make a dataset, print how it was made, and return the figures of --json."""
    result = ingest(config)
    report = result.poses.report
    stages = StageLog(result.folder / "costs.json").stages()
    for stage in stages:
        print(f"{stage.name:<8} {stage.seconds:7.1f} s {stage.peak_mb:6.0f} MB")
    if result.lens is not None:
        print(f"lens: {result.lens}")
    print(f"poses from {report.method}; scale: {report.scale}")
    for other, shifts in (report.moved or {}).items():
        print(f"same rig as {other}: its pictures lie within {max(shifts.values()):.2f} px of these")
    if report.up is not None:
        print(up_in_words(report.up))
    print(fire_left_in_words(result.fire_left, result.fire_left_by_clip))
    for note in (*result.notes, *report.notes):
        print(f"note: {note}")
    print(f"dataset -> {result.folder}; next: gof reconstruct {result.folder}")
    return {
        "dataset": str(result.folder),
        "lens": result.lens,
        "notes": result.notes,
        "poses": asdict(report),
        "stages": [asdict(s) for s in stages],
    }
