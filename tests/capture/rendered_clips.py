"""Rendered clips of the LED board, whose times are known: encoded, read as a video is, and compared."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gof.capture.decode import CameraTimes, DecodeOptions, decode
from gof.capture.locate import Summary, locate
from gof.capture.signals import make_signals, read_signals, sample_frame
from gof.capture.template import BoardTemplate
from gof.core.errors import GofError
from tests.capture.synthetic import SyntheticShot, render, write_video


def measure(
    shot: SyntheticShot,
    template: BoardTemplate,
    frames: int = 96,
    codec: str | None = None,
    options: DecodeOptions | None = None,
    samples: int = 96,
) -> dict[str, float]:
    """Render, encode, decode, compare.

    Args:
        codec: None; "mp4v"; "h264 CRF" (with ffmpeg); "jpeg Q" for single pictures of that quality.
    Returns:
        see `errors`; the size of the encoded frames, and the seconds spent on reading and on decoding.
    Raises:
        GofError: not decodable.
    """
    truth, kilobytes = shot.times(frames), float("nan")
    if codec and not codec.startswith("jpeg"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "shot.mp4"
            if codec.startswith("h264"):
                write_h264(path, render(shot, template, frames), int(codec.split()[1]))
            else:
                write_video(path, render(shot, template, frames), codec)
            kilobytes = path.stat().st_size / 1e3 / frames
            start = time.perf_counter()
            signals = read_signals(path, template)
    else:
        pictures = list(render(shot, template, frames))
        if codec:
            packed = [_jpeg(p, int(codec.split()[1])) for p in pictures]
            kilobytes = float(np.mean([len(p) for p in packed])) / 1e3
            pictures = [_unpack(p) for p in packed]
        start = time.perf_counter()
        signals = signals_of(pictures, template, samples)
    read = time.perf_counter()
    times = decode(signals, template, options or DecodeOptions(shot.period))
    return errors(times, truth, shot) | {
        "kb_per_frame": kilobytes,
        "read_s": read - start,
        "decode_s": time.perf_counter() - read,
    }


def signals_of(pictures: list[np.ndarray], template: BoardTemplate, samples: int = 96):
    """`read_signals` of pictures in memory."""
    summary = Summary()
    for picture in pictures:
        summary.add(picture)
    board = locate(summary, template, samples)
    strips, leds = zip(*(sample_frame(p, board) for p in pictures), strict=True)
    height, width = pictures[0].shape[:2]
    return make_signals(np.stack(strips), np.stack(leds), (width, height), board)


def write_h264(path: Path, pictures: Iterator[np.ndarray], crf: int) -> None:
    """Encode grey pictures with ffmpeg's libx264, 4:2:0, at a constant rate factor.

    Raises:
        GofError: there is no ffmpeg.
    """
    if not shutil.which("ffmpeg"):
        raise GofError("needs ffmpeg")
    first = next(pictures)
    size = f"{first.shape[1]}x{first.shape[0]}"
    command = (
        f"ffmpeg -v error -y -f rawvideo -pix_fmt gray -s {size} -r 30 -i - -c:v libx264 -crf {crf} -pix_fmt yuv420p"
    )
    with subprocess.Popen([*command.split(), str(path)], stdin=subprocess.PIPE) as process:
        for picture in (first, *pictures):
            process.stdin.write(picture.tobytes())
        process.stdin.close()
    if process.returncode:
        raise GofError(f"ffmpeg failed ({process.returncode})")


def _jpeg(picture: np.ndarray, quality: int) -> np.ndarray:
    import cv2

    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]


def _unpack(packed: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)


def errors(times: CameraTimes, truth: np.ndarray, shot: SyntheticShot) -> dict[str, float]:
    """Errors of decoded times (us) against the truth, bias included.

    Of the fused times, and of single frames' own measurements (frames that were left out do not count there).
    """
    fused = times.time_us - truth
    single = (times.measured_us - truth)[times.used]
    return {
        "fused_rms_us": float(np.sqrt(np.mean(fused**2))),
        "single_rms_us": float(np.sqrt(np.mean(single**2))),
        "bias_us": float(fused.mean()),
        "stated_us": float(times.sigma_us.mean()),
        "left_out": int((~times.used).sum()),
        "row_time_error_us": times.row_time_us - shot.row_time,
        "exposure_us": times.exposure_us or float("nan"),
    }
