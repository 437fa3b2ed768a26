"""The sound of a film, decoded by the program ffmpeg: OpenCV reads pictures only."""

from __future__ import annotations

import shutil
from pathlib import Path
from subprocess import PIPE

import numpy as np

from gof.core.errors import GofError
from gof.host.processes import run

RATE = 16_000  # samples per second that are read: a clap and a fire's crackle lie below 8 kHz


class NoSound(GofError):
    """A film has no sound that can be read."""


def read_sound(path: Path) -> np.ndarray:
    """Return (N,) float32: all channels' mean at RATE, from zero of the file's own clock on, on which its pictures lie.

    Raises:
        NoSound: no ffmpeg on this machine, or no sound that it can decode.
    """
    if (program := shutil.which("ffmpeg")) is None:
        raise NoSound("the program ffmpeg, which decodes sound, is not on this machine's PATH")
    command = [program, "-v", "error", "-nostdin", "-i", str(path.absolute()), "-vn", "-ac", "1"]
    command += ["-af", "aresample=async=1:first_pts=0", "-ar", str(RATE), "-f", "f32le", "-"]
    done = run(command, stdout=PIPE, stderr=PIPE)
    sound = np.frombuffer(done.stdout[: len(done.stdout) // 4 * 4], "<f4")
    if done.returncode or not sound.any():
        raise NoSound(f"{path.name}: has no sound, or a silent one")
    return sound
