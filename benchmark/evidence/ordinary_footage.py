"""Videos as phones, cheap cameras and broken copies leave them: what does `gof ingest` make of each?

    python -m gof_benchmark.evidence.ordinary_footage CLIP [--out OUT] [--fps 400] [--fov 35.53] [--marker-m 0.06]

Takes about 8 min. Needs ffmpeg and the paper's clips.

CLIP holds cam_0.mp4, cam_1.mp4 and cam_2.mp4 of a fire (docs/ingest.md: the paper's capture_05/scene_0006). ffmpeg
makes the variants. Whether frames were paired rightly is not taken from the clocks: every picture of the dataset is
looked up in the original videos, so the last column counts original frames between pictures that were paired. Started
again with the same options, it goes on after the last row that it finished; another OUT begins anew.

With --flame only what three phones in three hands leave is made, of every third frame at half the size, and a small
flame of each: the column before the last has the flame's PSNR on held-out pictures, against the row's own pictures.
"""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro

from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.errors import DataFormatError, MissingDependencyError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.footage.videos import stored_frames
from gof.host.processes import python_command

CAMERAS = ("cam_0", "cam_1", "cam_2")
LOOK_UP = (48, 85)  # px: size at which pictures are looked up
GONE = "not(eq(n,20)+eq(n,21)+eq(n,30))"  # three frames are missing
QUICK = ("--max-size", "214", "--plates", "minimum")
SLOWING = "(N/30+0.004*N*N/100)/TB"  # from 30 to about 24 frames a second
TO_HLG = "zscale=tin=iec61966-2-1:min=smpte170m:pin=bt709:t=arib-std-b67:m=bt2020nc:p=bt2020:npl=203"
FLAME = ("--preset", "toy", "--max-size", "214", "--gaussians", "3000", "--steps", "100", "--no-flow-prior")
THINNED = 3
SHAKE, DRIFT = 2 / 480, 0.4  # of a hand, to either side, of the width; of the exposure's light, from end to end
LYING = ["-vf", "transpose=2"]  # as a phone stores an upright video


@dataclass
class OrdinaryFootage:
    """Every variant of a clip through `gof ingest`."""

    clip: tyro.conf.Positional[Path]
    """Folder with cam_0.mp4, cam_1.mp4, cam_2.mp4."""
    out: Path = Path("out/ordinary_footage")
    """Folder for videos and datasets."""
    fps: float = 400.0
    """True rate of the clip."""
    fov: float = 35.53
    """Its horizontal field of view, degrees."""
    marker_m: float = 0.06
    """Side of the board's marker, m."""
    frames: int = 24
    """Frames per dataset where a variant does not say: few, as only the reading is looked at."""
    only: str = ""
    """Only variants whose name holds this text."""
    flame: bool = False
    """Only what phones leave, of every third frame at half the size, each with a flame."""


@dataclass(frozen=True)
class FootageVariant:
    """One treatment of the videos, and the way they are given to `gof ingest`.

    Attributes:
        changes: ffmpeg's options per camera that is encoded again.
        after: what is done to a camera's finished file.
        options: of `gof ingest`; "TIMES" stands for the times.json of `gof capture sync`.
        given: the cameras whose videos are given, in this order.
        all_frames: whether no --frames is given.
        pictures: one of `CHANGED`, by which all cameras' pictures are changed first.
        sync: options of `gof capture sync`.
        phones: whether it is a row of --flame.
    """

    name: str
    options: tuple[str, ...]
    changes: dict[str, list[str]] = field(default_factory=dict)
    after: dict[str, str] = field(default_factory=dict)
    given: tuple[int, ...] = (0, 1, 2)
    all_frames: bool = False
    pictures: str = ""
    sync: tuple[str, ...] = ()
    phones: bool = False


def variants(config: OrdinaryFootage) -> list[FootageVariant]:
    """Return the rows of the table."""
    rate, half = f"{config.fps:g}", f"{config.fps / 2:g}"
    fov, board = ("--fov", f"{config.fov:g}"), ("--marker-mm", f"{1000 * config.marker_m:g}")
    usual = ("--times", rate, *fov, *board)
    halved = {"cam_1": ["-vf", "select='not(mod(n,2))',setpts=N/(15*TB)", "-r", "15"]}
    gone = {"cam_1": ["-vf", f"select='{GONE}'", "-fps_mode", "vfr"]}
    late = {"cam_1": ["-vf", "select='gte(n,7)',setpts=N/(30*TB)"]}
    twice = {"cam_1": ["-vf", f"select='{GONE}'", "-fps_mode", "cfr", "-r", "30"]}
    heard = {"after": dict.fromkeys(CAMERAS, "sound"), "sync": ("--board", "none"), "phones": True}
    slow = {
        c: ["-vf", f"settb=1/15360,setpts='{SLOWING}'", "-fps_mode", "vfr", "-enc_time_base", "1/15360"]
        for c in CAMERAS
    }
    hevc = ["-c:v", "libx265", "-preset", "ultrafast", "-pix_fmt", "yuv420p10le"]
    return [
        FootageVariant("as filmed", usual, phones=True),
        FootageVariant("no board in the pictures", ("--times", rate, *fov, "--board", "none"), phones=True),
        FootageVariant("HEVC, 10 bits, HLG", usual, {c: [*hevc, "-vf", TO_HLG] for c in CAMERAS}, phones=True),
        FootageVariant("hands: shake of 0.4 % of the width", usual, pictures="shake", phones=True),
        FootageVariant("exposure drifts by 40 % of its light", usual, pictures="drift", phones=True),
        FootageVariant("both", usual, pictures="both", phones=True),
        FootageVariant("cam_1 shows 3 frames twice", usual, twice, phones=True),
        FootageVariant("no board, sound, cam_1 begins 7 frames late", ("TIMES", *usual[2:]), late, **heard),
        FootageVariant("2 cameras", usual, given=(0, 1)),
        FootageVariant("1 camera", usual, given=(0,)),
        FootageVariant("cam_0's file twice", usual, given=(0, 0, 2)),
        FootageVariant("times.json, videos in another order", ("TIMES", *usual[2:]), given=(0, 2, 1)),
        FootageVariant("cam_1 begins 7 frames late", usual, late, all_frames=True),
        FootageVariant("the same, `--start 7 0 7`", (*usual, "--start", "7", "0", "7"), late),
        FootageVariant("cam_1 has 60 of 100 frames", usual, {"cam_1": ["-frames:v", "60"]}, all_frames=True),
        FootageVariant("the same, `--frames 24`", usual, {"cam_1": ["-frames:v", "60"]}),
        FootageVariant("cam_1's file is cut off", usual, after={"cam_1": "cut"}, all_frames=True),
        FootageVariant("cam_1 at half the rate, one rate for all", usual, halved, all_frames=True),
        FootageVariant(f"the same, `--times {rate} {half} {rate}`", ("--times", rate, half, rate, *usual[2:]), halved),
        FootageVariant("the same, times.json", ("TIMES", *usual[2:]), halved),
        FootageVariant("cam_1 lacks 3 frames (variable rate)", usual, gone),
        FootageVariant("the same, times.json", ("TIMES", *usual[2:]), gone),
        FootageVariant("all slow down (variable rate)", usual, slow, all_frames=True),
        FootageVariant("variable rate, `--times stamps`", ("--times", "stamps", *usual[2:]), slow, phones=True),
        FootageVariant("cam_1 smaller", usual, {"cam_1": ["-vf", "scale=iw*2/3:-2"]}, phones=True),
        FootageVariant("HEVC, 10 bits", usual, {c: hevc for c in CAMERAS}),
        *_lying_phones(config),
        FootageVariant("wrong --fov, board", ("--times", rate, "--fov", "60", *board)),
        FootageVariant("wrong --fov, no board", ("--times", rate, "--fov", "60", "--board", "none")),
    ]


def _lying_phones(config: OrdinaryFootage) -> list[FootageVariant]:
    """Return the rows of phones that lie on their side, with the tag that says so and without."""
    lying = {c: LYING for c in CAMERAS}
    tag = dict.fromkeys(CAMERAS, "tag")
    fov = np.rad2deg(2 * np.arctan(np.tan(np.deg2rad(config.fov) / 2) * 854 / 480))
    usual = ("--times", f"{config.fps:g}", "--fov", f"{fov:.4g}", "--marker-mm", f"{1000 * config.marker_m:g}")
    return [
        FootageVariant(
            "phones: lying, with rotation tag",
            usual,
            lying,
            tag,
            phones=True,
        ),
        FootageVariant(
            "the same, cam_1's tag is lost",
            usual,
            lying,
            {"cam_0": "tag", "cam_2": "tag"},
        ),
        FootageVariant(
            "the same, `--turn clockwise`",
            (*usual, "--turn", "clockwise"),
            lying,
            {"cam_0": "tag", "cam_2": "tag"},
        ),
    ]


# ---- videos ----------------------------------------------------------------------------------------------------------


def ffmpeg(*words: str) -> None:
    """Run it. Raises MissingDependencyError: it is not installed."""
    if shutil.which("ffmpeg") is None:
        raise MissingDependencyError("this script makes its videos with ffmpeg; install it from your system's packages")
    subprocess.run(["ffmpeg", "-v", "error", "-y", *words], check=True)


def shaken(k: int, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return (3, 3) pixels of a frame to those of one that a hand held: turns of the camera, nearly shifts."""
    x, y = size[0] * rng.uniform(-SHAKE, SHAKE, 2)
    angle = rng.uniform(-0.001, 0.001)
    c, s = np.cos(angle), np.sin(angle)
    middle = np.array([[1, 0, size[0] / 2], [0, 1, size[1] / 2], [0, 0, 1]])
    return (
        np.array([[1, 0, x], [0, 1, y], [0, 0, 1]])
        @ middle
        @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        @ np.linalg.inv(middle)
    )


def changed(kind: str, source: Path, video: Path) -> None:
    """Write a video as a hand, or an automatic exposure, would have filmed it."""
    import cv2

    rng, frames = np.random.default_rng(len(source.stem) + ord(source.stem[-1])), list(stored_frames(source))
    height, width = frames[0].shape[:2]
    command = ["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    command += ["-r", "30", "-i", "-", "-c:v", "libx264", "-crf", "10", "-pix_fmt", "yuv420p", str(video)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as program:
        for k, frame in enumerate(frames):
            picture = frame
            if kind in ("drift", "both"):
                gain = 1 + DRIFT * (k / (len(frames) - 1) - 0.5)
                light = np.clip(gain * srgb_to_linear(np.arange(256) / 255), 0, 1)
                picture = cv2.LUT(picture, np.uint8(np.rint(255 * linear_to_srgb(light))))
            if kind in ("shake", "both"):
                matrix, edge = shaken(k, (width, height), rng), cv2.BORDER_REFLECT_101
                picture = cv2.warpPerspective(picture, matrix, (width, height), flags=cv2.INTER_CUBIC, borderMode=edge)
            program.stdin.write(picture.tobytes())


def with_sound(video: Path, begins_s: float) -> None:
    """Give a film the sound of a fire that crackles, from this moment of it on, with a microphone's own noise."""
    rate, rng = 16_000, np.random.default_rng(0)
    fire = rng.normal(0, 1, 8 * rate) * (0.05 + (rng.random(8 * rate) < 2e-3) * 4)
    own = np.random.default_rng(ord(video.stem[-1])).normal(0, 0.05, 8 * rate)
    heard = (fire + own)[round(begins_s * rate) :].astype(np.float32)
    silent = video.replace(video.with_name(f"{video.stem}_silent.mp4"))
    command = ["ffmpeg", "-v", "error", "-y", "-i", str(silent), "-f", "f32le", "-ar", str(rate), "-ac", "1", "-i", "-"]
    command += ["-c:v", "copy", "-c:a", "aac", "-shortest", str(video)]
    subprocess.run(command, input=heard.tobytes(), check=True)


def thinned(clip: Path, folder: Path) -> Path:
    """Return a folder with the clip's videos at half their size, of every `THINNED`-th frame."""
    folder.mkdir(parents=True, exist_ok=True)
    size = f"select='not(mod(n,{THINNED}))',setpts=N/(30*TB),crop=iw:floor(ih/4)*4,scale=iw/2:ih/2:flags=area"
    for name in CAMERAS:
        out = str(folder / f"{name}.mp4")
        ffmpeg("-i", str(clip / f"{name}.mp4"), "-vf", size, "-r", "30", "-c:v", "libx264", "-crf", "6", out)
    return folder


def make_videos(variant: FootageVariant, config: OrdinaryFootage, folder: Path) -> list[Path]:
    """Return the variant's videos, each camera's once."""
    folder.mkdir(parents=True, exist_ok=True)
    videos = []
    for name in (CAMERAS[c] for c in sorted(set(variant.given))):
        source, video = str(config.clip / f"{name}.mp4"), folder / f"{name}.mp4"
        after = variant.after.get(name)
        change = variant.changes.get(name)
        if variant.pictures:
            changed(variant.pictures, Path(source), video)
        elif change is None:
            copied = ["-movflags", "+faststart"] if after == "cut" else []
            ffmpeg("-i", source, "-c", "copy", *copied, str(video))
        else:
            codec = [] if "-c:v" in change else ["-c:v", "libx264"]
            quiet = ["-x265-params", "log-level=error"] if "libx265" in change else []
            ffmpeg("-i", source, *change, *codec, *quiet, "-crf", "10", str(video))
        if after == "cut":  # as a copy that broke off
            video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
        if after == "tag":
            video.write_bytes(tagged_clockwise(video.read_bytes()))
        if after == "sound":
            with_sound(video, 7 / 30 if change else 0.0)
        videos.append(video)
    return videos


def tagged_clockwise(data: bytes) -> bytes:
    """Return an MP4 file of one track with the rotation tag of a phone held upright: players turn it clockwise by 90
    degrees.

    The tag is the matrix in the track's header, `tkhd` (ISO/IEC 14496-12, 8.3.2): a, b, u, c, d, v, x, y, w, by which a
    point (p, q) goes to (a p + c q + x, b p + d q + y). Written here because only ffmpeg 6 and later write it.
    """
    start = data.index(b"tkhd") + 4
    matrix = start + (52 if data[start] == 1 else 40)  # version 1 has longer times
    plain = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    if data.count(b"tkhd") != 1 or data[matrix : matrix + 36] != plain:
        raise DataFormatError("not one track that lies as it is stored")
    height = struct.unpack_from(">i", data, matrix + 40)[0]  # 16.16, as all but u, v and w
    turned = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, height, 0, 1 << 30)
    return data[:matrix] + turned + data[matrix + 36 :]


# ---- what comes out --------------------------------------------------------------------------------------------------


def gof(*words: str) -> tuple[int, str]:
    """Run the command line; exit status and what it said."""
    done = subprocess.run(python_command("-m", "gof", *words), capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def run(
    variant: FootageVariant, config: OrdinaryFootage, originals: list[np.ndarray], number: int
) -> tuple[str, str, str]:
    """Return the output of `gof ingest` on the variant, its flame's dB, and the distance of its pairs in original
    frames."""
    folder = config.out / f"{number:02d}"
    shutil.rmtree(folder, ignore_errors=True)
    videos = make_videos(variant, config, folder / "videos")
    words = []
    for option in variant.options:
        if option != "TIMES":
            words.append(option)
            continue
        status, said = gof("capture", "sync", *map(str, videos), "--out", str(folder / "sync"), *variant.sync)
        if status:
            return f"sync: {last_line(said)}", "", ""
        words += ["--times", str(folder / "sync" / "times.json")]
    frames = () if variant.all_frames or config.flame else ("--frames", str(config.frames))
    made = folder / "set"
    summary = folder / "summary.json"
    given = [str(folder / "videos" / f"{CAMERAS[c]}.mp4") for c in variant.given]
    size = () if config.flame else QUICK
    status, said = gof("ingest", *given, "--out", str(made), *size, *words, *frames, "--json", str(summary))
    if status:
        return f"refused: {last_line(said)}", "", ""
    content = json.loads(summary.read_text(encoding="utf-8"))
    apart = pairs_apart(Dataset.open(made), [originals[c] for c in variant.given])
    notes = "; ".join([*content["notes"], *content["poses"]["notes"]]) or "nothing to say"
    poses = content["poses"]["method"]
    return f"made, poses by {poses}: {notes}", flame_of(made, folder) if config.flame else "", f"{apart:d}"


def flame_of(dataset: Path, folder: Path) -> str:
    """Return the PSNR of a small flame on held-out pictures, dB, or why there is none."""
    figures = folder / "flame.json"
    status, said = gof("reconstruct", str(dataset), "--out", str(folder / "flame"), *FLAME, "--json", str(figures))
    if status:
        return f"refused: {last_line(said)}"
    return f"{json.loads(figures.read_text(encoding='utf-8'))['held_out']['psnr_flame']:.1f} dB"


def last_line(said: str) -> str:
    """Return the error, without progress bars; folders are cut."""
    lines = [line for line in said.splitlines() if line.strip() and "━" not in line]
    where = next((k for k, line in enumerate(lines) if line.startswith(("gof", "error", "Error"))), len(lines) - 1)
    text = " ".join(line.strip() for line in lines[where:]).removeprefix("gof ingest: ")
    return " ".join(Path(word).name if word.startswith("/") else word for word in text.split())


def small(picture: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.resize(picture, LOOK_UP, interpolation=cv2.INTER_AREA).astype(np.float32)


def pairs_apart(dataset: Dataset, originals: list[np.ndarray]) -> int:
    """Return most original frames between the pictures of a moment: what each shows is looked up in the original
    videos."""
    numbers = [
        [
            int(((small(np.uint8(np.rint(255 * dataset.image(c, k)))) - originals[c]) ** 2).mean((1, 2, 3)).argmin())
            for k in range(len(dataset.times_s))
        ]
        for c in range(len(dataset.cameras))
    ]
    return int(np.ptp(np.array(numbers), axis=0).max())


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(OrdinaryFootage, prog="python -m gof_benchmark.evidence.ordinary_footage", args=argv)
    if config.flame:
        config.clip, config.fps = thinned(config.clip, config.out / "thinned"), config.fps / THINNED
    originals = [np.stack([small(p) for p in stored_frames(config.clip / f"{name}.mp4")]) for name in CAMERAS]
    print("| footage | what `gof ingest` does | flame | original frames between paired pictures, at most |")
    print("|---|---|---|---|")
    for number, variant in enumerate(variants(config)):
        if config.only in variant.name and variant.phones >= config.flame:
            known = config.out / f"{number:02d}" / "row.json"
            asked = [variant.name, *variant.options, list(variant.given), str(config.clip), config.frames, config.flame]
            row = json.loads(known.read_text(encoding="utf-8")) if known.is_file() else {}
            if row.get("asked") != asked:
                outcome, flame, apart = run(variant, config, originals, number)
                row = {"asked": asked, "outcome": outcome, "flame": flame, "apart": apart}
                write_json(known, row)
            print(f"| {variant.name} | {row['outcome']} | {row['flame']} | {row['apart']} |", flush=True)


if __name__ == "__main__":
    main()
