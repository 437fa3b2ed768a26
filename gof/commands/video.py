"""`gof video`: a result, or several side by side, as a film seen from anywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.foreign_options import ForeignOptions
from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.files import digest, write_json
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.scoring import is_flame_alone
from gof.host.options import require_number, require_positive
from gof.host.progress import progress_bar
from gof.host.terminal import console
from gof.io.importers import ImportOptions
from gof.look.encoder import STILL, require_film
from gof.look.film import FilmOptions, Recorded, fitted, make_film
from gof.look.panels import Panel, Subject
from gof.look.path import Clock, Journey, Shot, Way, clock, orbit, shots, stay, through
from gof.look.player.opened import Opened, dataset_beside, middle_of, open_moving, time_span
from gof.look.player.page import front_camera

MOST_HEIGHT = 2160


@dataclass
class VideoConfig:
    """Write a film of a result: picture, depth, velocity and shrunken Gaussians, from views that no camera took.

    The camera goes round the flame, flies from camera to camera, or stays; the clip plays in slow motion, stands still,
    or stops on its way while the camera flies ("bullet"). Several results are shown under each other with one camera,
    one clock and one scale. A run that was stopped goes on where it was.

    What people type:
      gof video out/demo                                            once around a demo's flame
      gof video out/fire --dataset data/fire --time bullet          plays, stops, turns, plays on
      gof video out/fire --dataset data/fire --path camera --recorded       beside what was filmed
      gof video out/fire out/other.ply --names ours theirs --dataset data/fire --panels rgb velocity
      gof video out/fire out/other.ply --dataset data/fire --path camera --recorded --panels rgb error --out grid.png

    Behind a flame is what is known there: a still scene of the result's own or of --scene; from a camera of the dataset
    its plate (a picture of that one view); else nothing, which is black. The command prints which.
    """

    results: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RESULT ...")]]
    """Folders of `gof reconstruct`, or files of any method of docs/importers.md, in one world and on one clock."""
    other_method: tyro.conf.OmitArgPrefixes[ForeignOptions]
    dataset: Path | None = None
    """Dataset folder: its cameras, frame times and plates; default: the one in a demo's folder."""
    out: Path | None = None
    """Film to write (.webm, .mp4, .webp), or a .png of the instant --stop; default: film.webm beside the result."""
    path: Way = "orbit"
    """Where the camera goes: around the flame; through the dataset's cameras and back; or it stays in one."""
    time: Clock = "play"
    """What time does: plays; stands still (freeze); plays, stops while the camera goes its way, plays on (bullet)."""
    panels: tuple[Panel, ...] = ("rgb", "depth", "velocity", "reduced")
    """What is shown side by side; `error` is the difference to what was recorded, black 0, bright 0.5 or more."""
    recorded: bool = False
    """With --path camera: a panel with what that camera recorded."""
    camera: str | None = None
    """Name of the camera that stays or goes around; default: the middle one."""
    slow: float = 10.0
    """Slow motion: seconds of film for one second of the clip."""
    seconds: float = 6.0
    """How long time stands still, with --time freeze or bullet."""
    stop: float | None = None
    """Where time stands still, in seconds on the dataset clock; default: the middle of the clip."""
    degrees: float = 360.0
    """How far around the flame the camera goes; with less than 360 it goes to both sides and back."""
    scene: Path | None = None
    """Still scene around results that are the flame alone: background.npz of `gof background`."""
    reduced: float = 0.3
    """Size of the Gaussians in the panel "reduced", as a factor."""
    height: int | None = None
    """Pixels of a panel; default: the camera's, at most 720."""
    fps: float = 30.0
    """Frames a second."""
    names: tuple[str, ...] = ()
    """What the results are called, in their order; default: their folders' names."""
    frame_time: float | None = None
    """Seconds between two frames, for results that count frames."""
    flame_only: bool = False
    """Say that other methods' results are flames without a room: they are drawn over a camera's plate, as ours are."""
    keep_frames: bool = False
    """Leave the frames as PNGs in the folder OUT.frames."""
    json: Path | None = None
    """Also write size, frames and scales to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof video`."""
    config = tyro.cli(VideoConfig, prog="gof video", args=argv)
    _check(config)
    options = config.other_method.options(config.frame_time)
    names = config.names or (None,) * len(config.results)
    results = [open_moving(path, options, name) for path, name in zip(config.results, names, strict=True)]
    folder = config.dataset or dataset_beside(config.results[0])
    dataset = None if folder is None else Dataset.open(folder)
    out = config.out or _default_out(config.results[0])
    span = _span(results, dataset)
    stop = (span[0] + span[1]) / 2 if config.stop is None else config.stop
    if not span[0] <= stop <= span[1]:
        raise GofError(f"--stop {stop:g}: the clip is from {span[0]:g} to {span[1]:g} s")
    number = camera_number(config.camera, dataset)
    journey = _journey(config, results, dataset, number, stop)
    if out.suffix.lower() == STILL:
        config = replace(config, time="freeze", seconds=1 / config.fps)
    times, along = clock(config.time, span, config.slow, config.seconds, config.fps, stop)
    film_shots = shots(journey, times, along)
    still = None if config.scene is None else _still_scene(config.scene, options)
    subjects, behind = _subjects(results, still, dataset, number, film_shots[0], config)
    recorded = _recorded(config, dataset, number)
    look = FilmOptions(config.panels, config.fps, config.reduced, config.keep_frames)
    with progress_bar("video") as progress:
        made_of = _made_of(config, results, dataset)
        film = make_film(out, subjects, film_shots, look, made_of, recorded, span[0], progress)
    terminal = console()
    for name, words in behind.items():
        terminal.print(f"behind {name}: {words}")
    if film.found:
        terminal.print(f"{film.found} of {film.frames} frames were there already")
    seconds = film.frames / config.fps
    length = "" if film.path.suffix == ".png" else f"{film.frames} frames, {seconds:.1f} s, "
    terminal.print(f"{film.path}: {length}{film.size[0]}x{film.size[1]} px")
    if config.json:
        write_json(config.json, _figures(film))
    return 0


# ---------------------------------------------------------------- what was asked


def _check(config: VideoConfig) -> None:
    if not config.results:
        raise GofError("name a result: a folder of `gof reconstruct`, or a file of a method")
    if config.names and len(config.names) != len(config.results):
        raise GofError(f"--names: {len(config.names)} names for {len(config.results)} results; give one for each")
    if not config.panels:
        raise GofError("--panels: name at least one of rgb, depth, velocity, reduced, error")
    for flag, value in (("--slow", config.slow), ("--seconds", config.seconds), ("--reduced", config.reduced)):
        require_positive(flag, value)
    require_number("--degrees", config.degrees, least=0, most=360)
    require_number("--fps", config.fps, least=1, most=240)
    require_number("--height", config.height, least=16, most=MOST_HEIGHT)
    require_number("--stop", config.stop)
    if "error" in config.panels and not config.recorded:
        raise GofError("--panels error: an error is against what was recorded; add --recorded")
    if config.recorded and config.path != "camera":
        raise GofError("--recorded: only a camera that stays has recorded what it shows; add --path camera")
    if config.out is not None:
        require_film(config.out)


def _default_out(result: Path) -> Path:
    return result / "film.webm" if result.is_dir() else result.with_name("film.webm")


def _span(results: list[Opened], dataset: Dataset | None) -> tuple[float, float]:
    spans = [time_span(result.gaussians, dataset) for result in results]
    return min(first for first, _ in spans), max(last for _, last in spans)


def camera_number(name: str | None, dataset: Dataset | None) -> int | None:
    """Of the dataset's camera of that name, by default the middle one; None without a dataset."""
    if dataset is None:
        if name is not None:
            raise GofError(f"--camera {name}: cameras are a dataset's; add --dataset")
        return None
    known = [camera.name for camera in dataset.cameras]
    if name is not None and name not in known:
        raise GofError(f"--camera {name}: the dataset has {', '.join(known)}")
    return len(known) // 2 if name is None else known.index(name)


def _journey(
    config: VideoConfig, results: list[Opened], dataset: Dataset | None, number: int | None, time_s: float
) -> Journey:
    middle, reach = middle_of(results[0].gaussians.state_at(time_s), time_s)
    if dataset is None:
        if config.path != "orbit":
            raise GofError(f"--path {config.path}: cameras are a dataset's; add --dataset, or take --path orbit")
        return orbit(_sized(front_camera(middle, reach), config.height), middle, config.degrees)
    if config.path == "cameras":
        return through([_sized(camera, config.height) for camera in dataset.cameras])
    camera = _sized(dataset.cameras[number], config.height)
    return stay(camera) if config.path == "camera" else orbit(camera, middle, config.degrees)


def _sized(camera: Camera, height: int | None) -> Camera:
    """The camera for panels of that height, in whole pixels."""
    height = min(camera.height, 720) if height is None else height
    return camera.scaled(max(1, round(camera.width * height / camera.height)), height)


def _still_scene(path: Path, options: ImportOptions) -> TransientGaussians:
    gaussians = open_moving(path, options).gaussians
    if not isinstance(gaussians, TransientGaussians) or gaussians.dynamic.all():
        raise GofError(f"--scene {path}: holds nothing that stands still; `gof background DATASET` makes such a file")
    return gaussians[~gaussians.dynamic]


def _subjects(
    results: list[Opened],
    still: TransientGaussians | None,
    dataset: Dataset | None,
    number: int | None,
    first: Shot,
    config: VideoConfig,
) -> tuple[list[Subject], dict[str, str]]:
    """The results with what lies behind them, and the latter in words by name."""
    subjects, words = [], {}
    for result in results:
        plate, scene = None, None
        if not result.gaussians.dynamic.all():
            said = "its own still scene"
        elif still is not None:
            scene, said = still, "the still scene of --scene"
        elif not is_flame_alone(result.gaussians, result.method, config.flame_only):
            said = "nothing, so black: another method's Gaussians may be the whole scene (else --flame-only)"
        elif config.path == "camera":
            plate = fitted(background(dataset, number, result.path), first.camera.width, first.camera.height)
            said = f"the plate of {dataset.cameras[number].name}"
        else:
            said = "nothing, so black (a still scene is made by `gof background`, and named with --scene)"
        subjects.append(Subject(result.name, result.gaussians, scene, plate))
        words[result.name] = said
    return subjects, words


def _recorded(config: VideoConfig, dataset: Dataset | None, number: int | None) -> Recorded | None:
    return Recorded(dataset, number) if config.recorded else None


def _made_of(config: VideoConfig, results: list[Opened], dataset: Dataset | None) -> str:
    """Which files the film is of, by their content, and how they were read."""
    files = [result.path for result in results] + ([config.scene] if config.scene else [])
    digests = [digest(file) if file.is_file() else str(file.resolve()) for file in files]
    plates = "" if dataset is None else dataset.identity()
    return " ".join([*digests, plates, repr(config.other_method), repr(config.frame_time), str(config.flame_only)])


def _figures(film) -> dict:
    return {
        "film": str(film.path),
        "bytes": film.path.stat().st_size,
        "frames": film.frames,
        "size": list(film.size),
        "speed_m_per_s": film.scales.speed,
        "depth_m": [film.scales.near, film.scales.far],
    }
