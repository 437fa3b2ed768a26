"""Clocks of films without any board: synthetic sound of known lag, drift and noise, and real files with sound."""

import json
import shutil
import subprocess
import wave

import cv2
import numpy as np
import pytest

from gof.capture.boardless import RATE, by_light, by_sound, synchronise_without_board
from gof.capture.flame_clock import Offset, read_light
from gof.capture.sound_clock import NoSoundClock, find_lag
from gof.capture.times import FrameTimesFile
from gof.commands import cli
from gof.core.errors import GofError
from gof.core.records import read_record

NEEDS_FFMPEG = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")


def crackle(seconds, offset_s, drift, snr_db, seed):
    """A fire's crackle as one microphone has it: bursts at times known beforehand, heard at (t - offset) / (1 + drift),
    under noise of the microphone's own."""
    rng = np.random.default_rng(7)
    count = int(40 * (seconds + 4))
    shape = rng.uniform(0, seconds + 4, count), rng.exponential(1, count), rng.uniform(400, 3500, count)
    sound = np.zeros(int(seconds * RATE))
    for t, loud, pitch, width in zip(*shape, rng.uniform(0.0005, 0.003, count), strict=True):
        heard = (t - offset_s) / (1 + drift)
        k = np.arange(max(int((heard - 5 * width) * RATE), 0), min(int((heard + 5 * width) * RATE) + 1, len(sound)))
        x = k / RATE - heard
        sound[k] += loud * np.exp(-0.5 * (x / width) ** 2) * np.cos(2 * np.pi * pitch * x)
    noise = np.random.default_rng(seed).normal(size=len(sound))
    return (sound + noise * sound.std() * 10 ** (-snr_db / 20)).astype(np.float32)


@pytest.mark.parametrize("length_s, other_s, begins_s", [(12.2, 3.4, 8.8), (28.5, 14.0, 20.5), (14.0, 28.5, -12.0)])
def test_a_film_that_begins_late_in_a_long_one_is_not_taken_round_the_end(length_s, other_s, begins_s):
    whole = crackle(45.0, 0, 0, 20, 1)
    first, second = max(-begins_s, 0.0), max(begins_s, 0.0)
    films = [
        whole[round(start * RATE) :][: round(length * RATE)] for start, length in ((first, length_s), (second, other_s))
    ]
    assert find_lag(*films, RATE).lag_s == pytest.approx(begins_s, abs=0.005)


@pytest.mark.parametrize(
    ("seconds", "offset_s", "drift", "snr_db"),
    [(3.0, 0.137031, 0, 10), (8.0, 1.23456, 0, 0), (24.0, 2.001, 50e-6, 0), (24.0, 0.5, -80e-6, -8)],
)
def test_sound_tells_lag_and_drift_under_noise(seconds, offset_s, drift, snr_db):
    found = find_lag(crackle(seconds, 0, 0, snr_db, 1), crackle(seconds, offset_s, drift, snr_db, 2), RATE)
    middle = seconds / 2
    error = abs(found.lag_s + found.drift * middle - offset_s - drift * middle)
    assert error < 1e-4 and error < 5 * found.sigma_s
    assert abs(found.drift - drift) < 5e-6


@pytest.mark.parametrize("seconds", [1, 4, 20])
def test_sounds_of_two_takes_are_refused(seconds):
    one, two = (np.random.default_rng(k).normal(size=seconds * RATE).astype(np.float32) for k in range(2))
    with pytest.raises(NoSoundClock, match="do not agree"):
        find_lag(one, two, RATE)


def test_a_track_that_agrees_with_none_is_named():
    a, b = crackle(4, 0, 0, 10, 1), crackle(4, 0.2, 0, 10, 2)
    fits = by_sound(["a", "b", "c"], [a, b, crackle(4, 0.35, 0, 10, 3)])
    np.testing.assert_allclose([fit.offset_s for fit in fits], [0, 0.2, 0.35], atol=1e-4)
    with pytest.raises(NoSoundClock, match="a and c"):
        by_sound(["a", "b", "c"], [a, b, np.random.default_rng(0).normal(size=4 * RATE)])


# ---- files -----------------------------------------------------------------------------------------------------------

FPS, FRAMES = 60, 120
WIDTH, HEIGHT = 96, 128
TONGUES, HEIGHTS = np.random.default_rng(5).uniform(-1, 1, (2, 100))


def flame_at(time_s, shift=0):
    """A flame whose tongues rise and whose height changes, both without a period, as a picture."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    risen = np.interp(y + 160 * time_s, np.arange(0, 8 * len(TONGUES), 8), TONGUES)
    height = 45 + 22 * np.interp(time_s, np.arange(0, 0.05 * len(HEIGHTS), 0.05), HEIGHTS)
    tongues = 0.6 + 0.4 * risen * np.sin(13.3 * time_s + 0.1 * y)
    glow = np.exp(-0.5 * ((x - 48 - shift) / 9.0) ** 2) * np.clip((y - (110 - height)) / 14, 0, 1) * (y < 110) * tongues
    return np.uint8(np.clip(np.stack([255 * glow, 160 * glow**2, 40 * glow**3], -1) + 20, 0, 255))


def film(folder, number, begins_s, sound_s=None, fps=FPS):
    """A film that begins at `begins_s` of the take; with sound from `sound_s` on."""
    pictures = folder / f"silent_{number}.mp4"
    writer = cv2.VideoWriter(str(pictures), cv2.VideoWriter_fourcc(*"mp4v"), fps, (WIDTH, HEIGHT))
    for k in range(int(FRAMES * fps / FPS)):
        writer.write(flame_at(begins_s + k / fps, 3 * number)[..., ::-1])
    writer.release()
    if sound_s is None:
        return pictures
    track = folder / f"{number}.wav"
    with wave.open(str(track), "wb") as file:
        file.setnchannels(1), file.setsampwidth(2), file.setframerate(RATE)
        heard = crackle(FRAMES / FPS, sound_s, 0, 5, number)
        file.writeframes((heard / np.abs(heard).max() * 30000).astype("<i2").tobytes())
    path = folder / f"cam_{number}.mp4"
    command = ["ffmpeg", "-v", "error", "-y", "-i", str(pictures), "-i", str(track), "-c:v", "copy", "-c:a", "aac"]
    subprocess.run([*command, "-b:a", "64k", str(path)], check=True)
    return path


def starts(folder):
    """The films' first times in ms after the first one's, and the clocks."""
    cameras = read_record(FrameTimesFile, folder / "times.json").cameras
    first = [camera.times.frames[0].time_s for camera in cameras]
    return 1000 * (np.array(first) - first[0]), {camera.times.clock for camera in cameras}


@pytest.mark.parametrize("board", ["none", "auto"])
def test_options_for_a_board_are_refused_without_one(tmp_path, board, capsys):
    videos = [film(tmp_path, k, t) for k, t in enumerate([1.0, 1.2])]
    sync = ["capture", "sync", *map(str, videos), "--out", str(tmp_path / "s"), "--board", board]
    for given in (["--row-time", "9.5"], ["--readout", "down"], ["--tick-us", "410"], ["--no-estimate"]):
        assert cli.main([*sync, *given]) == 1
        assert f"{given[0]}: for the light of a board's lamps, and" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


@NEEDS_FFMPEG
def test_three_phones_without_a_board_are_synchronised_by_sound(tmp_path, capsys):
    begins = [1.0, 1.2137, 0.9511]
    videos = [film(tmp_path, k, t, t) for k, t in enumerate(begins)]
    assert cli.main(["capture", "sync", *map(str, videos), "--out", str(tmp_path / "s"), "--no-report"]) == 0
    said = capsys.readouterr().out
    found, clocks = starts(tmp_path / "s")
    assert clocks == {"sound"} and "clocks by the films' sound" in said and "which agrees" in said
    np.testing.assert_allclose(found, 1000 * (np.array(begins) - begins[0]), atol=1.0)


@NEEDS_FFMPEG
def test_sound_that_the_flames_contradict_is_said(tmp_path, capsys):
    videos = [film(tmp_path, 0, 1.0, 1.0), film(tmp_path, 1, 1.2, 1.4)]
    assert cli.main(["capture", "sync", *map(str, videos), "--out", str(tmp_path / "s"), "--no-report"]) == 0
    assert "CONTRADICTS" in capsys.readouterr().out


def test_silent_films_are_synchronised_by_their_flames(tmp_path, capsys):
    begins = [1.0, 1.2137, 0.9511]
    videos = [film(tmp_path, k, t, fps=fps) for k, (t, fps) in enumerate(zip(begins, (60, 60, 30), strict=True))]
    assert cli.main(["capture", "sync", *map(str, videos), "--out", str(tmp_path / "s"), "--no-report"]) == 0
    said = capsys.readouterr().out
    found, clocks = starts(tmp_path / "s")
    assert clocks == {"flame"} and "clocks by the flames' light" in said and "ESTIMATED" in said
    np.testing.assert_allclose(found, 1000 * (np.array(begins) - begins[0]), atol=1000 / 60)


def test_ingest_finds_the_clocks_itself(tmp_path, capsys):
    """The first film began 0.2 s before the second: its frame 12 is the first of the dataset."""
    videos = [film(tmp_path, 0, 1.0), film(tmp_path, 1, 1.2)]
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = -0.5
    K = [[150, 0, WIDTH / 2], [0, 150, HEIGHT / 2], [0, 0, 1]]
    known = [{"width": WIDTH, "height": HEIGHT, "K": K, "world_to_camera": pose.tolist()} for pose in poses]
    (tmp_path / "cameras.json").write_text(json.dumps({"cameras": known}))
    words = ["--times", "sync", "--cameras", str(tmp_path / "cameras.json"), "--out", str(tmp_path / "set")]
    assert cli.main(["ingest", *map(str, videos), *words, "--frames", "20"]) == 0
    assert "clocks by the flames' light" in capsys.readouterr().out
    assert starts(tmp_path / "set" / "sync")[1] == {"flame"}
    shown = cv2.imread(str(tmp_path / "set" / "cameras" / "cam_0" / "rgb" / "000000.png"))[..., ::-1].astype(float)
    apart = [np.abs(shown - flame_at(1.0 + k / FPS)).mean() for k in range(30)]
    assert abs(int(np.argmin(apart)) - 12) <= 1


def test_light_that_agrees_with_nothing_is_refused_by_name(tmp_path, capsys):
    dark = tmp_path / "dark.mp4"
    writer = cv2.VideoWriter(str(dark), cv2.VideoWriter_fourcc(*"mp4v"), FPS, (WIDTH, HEIGHT))
    for _ in range(FRAMES):
        writer.write(np.full((HEIGHT, WIDTH, 3), 20, np.uint8))
    writer.release()
    assert cli.main(["capture", "sync", str(film(tmp_path, 0, 1.0)), str(dark), "--out", str(tmp_path / "s")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "silent_0 and dark: the flames' light does not agree" in said and "--start 0 7 0" in said


def test_one_film_alone_is_refused(tmp_path):
    with pytest.raises(GofError, match="one film alone"):
        synchronise_without_board([film(tmp_path, 0, 1.0)], [None])


def test_lights_of_two_rates_close(tmp_path):
    videos = [film(tmp_path, 0, 1.0), film(tmp_path, 1, 1.1, fps=30)]
    own = [np.arange(FRAMES) / FPS, np.arange(FRAMES // 2) / 30]
    fits = by_light(["a", "b"], own, [read_light(video) for video in videos])
    assert fits[1].offset_s == pytest.approx(0.1, abs=1 / 60)


def test_flames_that_agree_less_are_told_apart_less_surely():
    sure, unsure, none = (Offset(0.0, agreement, 0.1).error_frames for agreement in (1.0, 0.2, 0.0))
    assert sure == pytest.approx(0.25), "the shutter's way over the picture is not seen"
    assert unsure == pytest.approx(1.01, abs=0.005), "0.2 and 0.2 cancel: the root of 0.96 and 0.0625"
    assert 100 < none < np.inf
