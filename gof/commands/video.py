"""`gof video`: a result, or several side by side, as a film seen from anywhere."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gof.commands.everywhere import beside, require_free, write_figures
from gof.commands.read import Pixels, Rate, Results, named, read_options
from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.files import digest, read_json, stamp
from gof.core.gaussians import TransientGaussians
from gof.core.records import convert_json
from gof.dataset import Dataset
from gof.dataset.leaks import print_of_others
from gof.dataset.plates import background
from gof.evaluate.scoring import is_flame_alone
from gof.host.options import require_number, require_positive
from gof.host.terminal import console, progress_bar
from gof.io.importers import ImportOptions
from gof.io.importers.sidecar import with_sidecar
from gof.look.animation import CODES, STILL, require_film
from gof.look.film import FRAMES, FilmOptions, Recorded, fitted, is_begun, make_film
from gof.look.panels import Panel, Subject
from gof.look.path import Clock, Journey, Shot, Way, clock, orbit, say_what_is_a_guess, shots, stay, through
from gof.look.player.opened import Opened, dataset_beside, measured_alike, middle_of, open_moving, time_span
from gof.look.player.page import front_camera

MOST_SIZE = 4096
UNKNOWN = (
    "nothing, so black: another method's Gaussians may be the whole scene; if they are a flame alone, write it down: "
    "gof convert RESULT --flame-only"
)


@dataclass(frozen=True)
class FilmStyle:
    """The look of a film beyond its panels: fields of `--style`."""

    recorded: bool = False
    """With --camera-path camera: a panel with what that camera recorded."""
    camera: str | None = None
    """Name of the camera that stays or goes around; default: the middle one."""
    slow: float = 10.0
    """Slow motion: seconds of film for one second of the clip."""
    seconds: float = 6.0
    """Seconds of film for which time stands still, with --mode freeze or bullet."""
    stop: float | None = None
    """Time at which the clip stands still, in seconds on the dataset clock; default: the middle of the clip."""
    degrees: float = 360.0
    """Angle that the camera goes around the flame; below 360 degrees it goes to both sides and back."""
    scene: str | None = None
    """Still scene around results that are the flame alone: background.npz of `gof background`."""
    reduced: float = 0.3
    """Size of the Gaussians in the panel "reduced", as a factor."""
    keep_frames: bool = False
    """Leave the frames as PNGs in the folder OUT.frames."""

    def __post_init__(self):
        for name in ("slow", "seconds", "reduced"):
            require_positive(f"--style {name}", getattr(self, name))
        require_number("--style degrees", self.degrees, least=0, most=360)
        require_number("--style stop", self.stop)

    @classmethod
    def read(cls, words: tuple[str, ...]) -> FilmStyle:
        """Return the style that words KEY=VALUE and JSON files say; later ones replace what earlier ones said.

        Raises:
            GofError: a word is neither; a field that there is not, or a value that it cannot have (names it).
        """
        fields_given: dict = {}
        for word in words:
            key, equals, value = word.partition("=")
            if Path(word).suffix == ".json":
                found = read_json(Path(word))
                convert_json(cls, found, word)
                fields_given |= found
            elif equals or key in cls.__dataclass_fields__:
                fields_given[key] = _value(value) if equals else True
            else:
                raise GofError(f"--style {word}: give a .json file, or KEY=VALUE; gof video --help-all lists the keys")
        return convert_json(cls, fields_given, "--style")


def _value(word: str) -> bool | float | str:
    """Return a value as JSON has it."""
    known = {"yes": True, "true": True, "no": False, "false": False}
    if word.lower() in known:
        return known[word.lower()]
    try:
        return float(word)
    except ValueError:
        return word


@dataclass
class VideoConfig:
    """Write a film of a result: picture, depth, velocity and shrunken Gaussians, from views that no camera took.

    Examples:
      gof video out/demo                                            once around a demo's flame
      gof video out/fire --dataset data/fire --mode bullet          plays, stops, turns, plays on
      gof video out/fire --dataset data/fire --camera-path camera --style recorded       beside what was filmed
      gof video ours=out/fire theirs=out/other.ply --dataset data/fire --panels rgb velocity --style slow=20
      gof video out/fire --dataset data/fire --camera-path camera --style recorded --panels rgb error --out grid.png

    The camera goes round the flame, flies from camera to camera, or stays; the clip plays in slow motion, stands still,
    or stops on its way while the camera flies ("bullet"). Several results are shown under each other with one camera,
    one clock and one scale. A run that was stopped goes on where it was.

    Behind a flame is what is known there: a still scene of the result's own or of the style's; from a camera of the
    dataset its plate (a picture of that one view); else nothing, which is black. The command prints which.
    """

    MORE: ClassVar = {"keys of --style": FilmStyle}

    results: Results
    """Folders of `gof reconstruct`, or files of any method of docs/importers.md, in one world and on one clock; the
    name is what people read, default: the folder's."""
    dataset: Path | None = None
    """Dataset folder: its cameras, frame times and plates; default: the one in a demo's folder."""
    out: Path | None = None
    """Film to write (.webm, .mp4, .webp), or a .png of the instant where time stops; default: film.webm beside the
    result. A film that was stopped goes on."""
    camera_path: Way = "orbit"
    """Path of the camera: around the flame; through the dataset's cameras and back; or it stays in one."""
    mode: Clock = "play"
    """Course of time: plays; stands still (freeze); plays, stops while the camera goes its way, plays on (bullet)."""
    panels: tuple[Panel, ...] = ("rgb", "depth", "velocity", "reduced")
    """Panels side by side; `error` is the difference to what was recorded, black 0, bright 0.5 or more."""
    max_size: Pixels | None = None
    """Longer side of a panel; default: the camera's size, at most 720 high."""
    fps: Rate = 30.0
    """Frames per second of the film."""
    style: Annotated[tuple[str, ...], tyro.conf.arg(metavar="KEY=VALUE|FILE.json")] = ()
    """Look of the film: recorded, camera, slow, seconds, stop, degrees, scene, reduced, keep_frames (see
    --help-all)."""


def main(argv: list[str]) -> int:
    """Run `gof video`."""
    config = read_options(VideoConfig, "video", argv)
    style = FilmStyle.read(config.style)
    _check(config, style)
    results = [open_moving(path, name=name) for name, path in named(config.results)]
    first = named(config.results)[0][1]
    folder = config.dataset or dataset_beside(first)
    dataset = None if folder is None else Dataset.open(folder)
    results = measured_alike(results, dataset)
    print_of_others((result.path for result in results), dataset)
    out = config.out or beside(first, "film.webm")
    span = _span(results, dataset)
    stop = (span[0] + span[1]) / 2 if style.stop is None else style.stop
    if not span[0] <= stop <= span[1]:
        raise GofError(f"--style stop={stop:g}: the clip is from {span[0]:g} to {span[1]:g} s")
    if dataset is None and style.camera is not None:
        raise GofError(f"--style camera {style.camera}: cameras are a dataset's; add --dataset")
    view = None if dataset is None else Recorded(dataset, camera_number(style.camera, dataset, "--style camera"))
    journey = _journey(config, style, results, view, stop)
    mode, seconds = config.mode, style.seconds
    if out.suffix.lower() == STILL:
        mode, seconds = "freeze", 1 / config.fps
    times, along = clock(mode, span, style.slow, seconds, config.fps, stop)
    film_shots = shots(journey, times, along)
    if dataset is not None:
        film_shots = say_what_is_a_guess(film_shots, dataset.cameras)
    still = None if style.scene is None else _still_scene(Path(style.scene), results[0])
    subjects, behind = _subjects(results, still, view, film_shots[0], config)
    look = FilmOptions(config.panels, config.fps, style.reduced, style.keep_frames)
    with progress_bar("video") as progress:
        made_of = _made_of(style, results, dataset)
        film = make_film(out, subjects, film_shots, look, made_of, view if style.recorded else None, span[0], progress)
    terminal = console()
    for name, words in behind.items():
        terminal.print(f"behind {name}: {words}")
    if film.found:
        terminal.print(f"{film.found} of {film.frames} frames were there already")
    seconds = film.frames / config.fps
    length = "" if film.path.suffix == ".png" else f"{film.frames} frames, {seconds:.1f} s, "
    terminal.print(f"{film.path}: {length}{film.size[0]}x{film.size[1]} px")
    write_figures(_figures(film))
    return 0


# ---------------------------------------------------------------- what is wanted


def _check(config: VideoConfig, style: FilmStyle) -> None:
    named(config.results)
    if not config.panels:
        raise GofError("--panels: name at least one of rgb, depth, velocity, reduced, error")
    require_number("--fps", config.fps, least=1, most=240)
    require_number("--max-size", config.max_size, least=16, most=MOST_SIZE)
    if "error" in config.panels and not style.recorded:
        raise GofError("--panels error: needs the recorded picture to compare with; add --style recorded")
    if style.recorded and config.camera_path != "camera":
        raise GofError("--style recorded: needs a camera that stays where it recorded; add --camera-path camera")
    if config.out is not None:
        require_film(config.out)
        if not is_begun(config.out):
            require_free(config.out)


def _span(results: list[Opened], dataset: Dataset | None) -> tuple[float, float]:
    spans = [time_span(result.gaussians, dataset) for result in results]
    return min(first for first, _ in spans), max(last for _, last in spans)


def camera_number(name: str | None, dataset: Dataset, option: str = "--camera") -> int:
    """Return the number of the dataset's camera of that name, by default the middle one."""
    known = [camera.name for camera in dataset.cameras]
    if name is not None and name not in known:
        raise GofError(f"{option} {name}: the dataset has {', '.join(known)}")
    return len(known) // 2 if name is None else known.index(name)


def _journey(
    config: VideoConfig, style: FilmStyle, results: list[Opened], view: Recorded | None, time_s: float
) -> Journey:
    middle, reach = middle_of(results[0].gaussians.state_at(time_s), time_s)
    if view is None:
        if config.camera_path != "orbit":
            raise GofError(f"--camera-path {config.camera_path}: cameras are a dataset's; add --dataset, or take orbit")
        return orbit(_sized(front_camera(middle, reach), config.max_size), middle, style.degrees)
    if config.camera_path == "cameras":
        return through([_sized(camera, config.max_size) for camera in view.dataset.cameras])
    camera = _sized(view.dataset.cameras[view.camera], config.max_size)
    return stay(camera) if config.camera_path == "camera" else orbit(camera, middle, style.degrees)


def _sized(camera: Camera, max_size: int | None) -> Camera:
    """Return the camera for panels of that longer side, in whole pixels."""
    height = min(camera.height, 720)
    if max_size is not None:
        height = max(1, round(camera.height * max_size / max(camera.width, camera.height)))
    return camera.scaled(max(1, round(camera.width * height / camera.height)), height)


def _still_scene(path: Path, flame: Opened) -> TransientGaussians:
    """Return what stands still in a file, measured from the flame's datum."""
    gaussians = open_moving(path).gaussians
    datum = flame.gaussians.datum if isinstance(flame.gaussians, TransientGaussians) else None
    if datum is not None:
        gaussians = gaussians.measured_from(datum)
    if not isinstance(gaussians, TransientGaussians) or gaussians.dynamic.all():
        raise GofError(
            f"--style scene={path}: holds nothing that stands still; `gof background DATASET` makes such a file"
        )
    return gaussians[~gaussians.dynamic]


def _subjects(
    results: list[Opened],
    still: TransientGaussians | None,
    view: Recorded | None,
    first: Shot,
    config: VideoConfig,
) -> tuple[list[Subject], dict[str, str]]:
    """Return the results with what lies behind them, and the latter in words by name."""
    subjects, words = [], {}
    for result in results:
        plate, scene = None, None
        if not result.gaussians.dynamic.all():
            backdrop = "its own still scene"
        elif still is not None:
            scene, backdrop = still, "the still scene of --style scene"
        elif not is_flame_alone(result.gaussians, result.method, result.flame_only):
            backdrop = UNKNOWN
        elif config.camera_path == "camera" and view is not None:
            plate = fitted(background(view.dataset, view.camera, result.path), first.camera.width, first.camera.height)
            backdrop = f"the plate of {view.dataset.cameras[view.camera].name}"
        else:
            backdrop = (
                "nothing, so black (a still scene is made by `gof background`, and named with --style scene=FILE)"
            )
        subjects.append(Subject(result.name, result.gaussians, scene, plate))
        words[result.name] = backdrop
    return subjects, words


def _made_of(style: FilmStyle, results: list[Opened], dataset: Dataset | None) -> str:
    """Return which files the film is of, and how they were read: results, their own plates, worlds, a still scene."""
    options = [with_sidecar(result.path, ImportOptions())[0] for result in results]
    files = [path for result in results for path in (result.path, result.path.absolute().parent / "plates")]
    files += [Path(style.scene)] if style.scene else []
    files += [own.world for own in options if own.world is not None]
    plates = "" if dataset is None else dataset.identity()
    return " ".join([*map(_identity, files), plates, repr(options)])


def _identity(path: Path) -> str:
    """Return what changes with a file's content, or with the sizes and times of a folder's files, but for films."""
    if path.is_file():
        return digest(path)
    own = [file for file in path.rglob("*") if file.suffix not in CODES and file.parent.suffix != FRAMES]
    return f"{path.resolve()} {stamp(path, [file.relative_to(path).as_posix() for file in own if file.is_file()])}"


def _figures(film) -> dict:
    return {
        "film": str(film.path),
        "bytes": film.path.stat().st_size,
        "frames": film.frames,
        "size": list(film.size),
        "speed_m_per_s": film.scales.speed,
        "depth_m": [film.scales.near, film.scales.far],
    }
