"""What a film's code values mean: curves against their published values, whole files against ffmpeg's zscale."""

import shutil
import subprocess

import cv2
import numpy as np
import pytest

from gof.footage.colour import Colour, hlg_light, pq_light
from gof.footage.videos import colour_of, read_info, stored_frames
from gof.ingest.agreement import other_notes
from tests.videos import numbered, write_video

NEEDS_FFMPEG = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
BLOCK, ROWS, COLUMNS = 32, 6, 8
CURVES = {"arib-std-b67": 18, "smpte2084": 16}
LUMA = {"bt2020nc": (0.2627, 0.0593), "bt709": (0.2126, 0.0722)}


@pytest.mark.parametrize(
    ("light", "code", "expected"),
    [
        (hlg_light, 0.75, 203),  # BT.2408, table 1: SDR's white
        (hlg_light, 1.0, 1000),
        (hlg_light, 0.38, 26),  # a grey card of 18 %
        (pq_light, 0.58, 203),
        (pq_light, 0.38, 26),
        (pq_light, 1.0, 10_000),
        (pq_light, 0.5081, 100),
    ],
)
def test_the_curves_have_their_published_values(light, code, expected):
    np.testing.assert_allclose(light(np.full(3, code)), expected, rtol=0.02)


def film(path, codes, curve, matrix="bt2020nc", primaries="bt2020"):
    """Blocks of R'G'B' (6, 8, 3) in [0, 1] as lossless HEVC of 10 bits, by the matrix's own definition."""
    red, blue = LUMA[matrix]
    luma = codes @ np.array([red, 1 - red - blue, blue])
    planes = luma, (codes[..., 2] - luma) / (2 - 2 * blue), (codes[..., 0] - luma) / (2 - 2 * red)
    raw = b""
    for plane, (scale, offset, side) in zip(
        planes, ((219, 16, BLOCK), (224, 128, BLOCK // 2), (224, 128, BLOCK // 2)), strict=True
    ):
        values = np.rint(4 * (plane * scale + offset)).astype("<u2")
        raw += np.kron(values, np.ones((side, side), values.dtype)).tobytes()
    tags = ["-color_primaries", primaries, "-color_trc", curve, "-colorspace", matrix, "-color_range", "tv"]
    command = f"ffmpeg -v error -y -f rawvideo -pix_fmt yuv420p10le -s {COLUMNS * BLOCK}x{ROWS * BLOCK} -i -".split()
    command += ["-c:v", "libx265", "-x265-params", "lossless=1:log-level=error", *tags, str(path)]
    done = subprocess.run(command, input=raw, capture_output=True)
    if done.returncode and b"libx265" in done.stderr:
        pytest.skip("this ffmpeg has no libx265")
    assert not done.returncode, done.stderr.decode()
    return path


def blocks(picture):
    """The middles of the blocks, as numbers."""
    return picture[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK].astype(float)


def by_zscale(path):
    """(H, W, 3) uint8 by ffmpeg: light with 203 cd/m2 = 1, Rec. 709, its own Möbius curve, sRGB."""
    steps = (
        "zscale=t=linear:npl=203:m=gbr",
        "format=gbrpf32le",
        "zscale=p=709",
        f"tonemap=mobius:param=0.7:peak={1000 / 203}:desat=0",
        "zscale=t=iec61966-2-1:m=gbr:r=full",
        "format=rgb24",
    )
    command = ["ffmpeg", "-v", "error", "-i", str(path), "-frames:v", "1", "-vf", ",".join(steps)]
    done = subprocess.run([*command, "-f", "rawvideo", "-"], capture_output=True)
    if b"No such filter" in done.stderr:
        pytest.skip("this ffmpeg has no zscale")
    assert not done.returncode, done.stderr.decode()
    return np.frombuffer(done.stdout, np.uint8).reshape(ROWS * BLOCK, COLUMNS * BLOCK, 3)


@NEEDS_FFMPEG
@pytest.mark.parametrize("suffix", ["mp4", "mov", "mkv"])
@pytest.mark.parametrize("curve", CURVES)
def test_hdr_films_are_read_as_zscale_reads_them(tmp_path, curve, suffix):
    """PQ: all colours. HLG: greys, as zscale takes its gamma of 1.2 channel by channel, and BT.2100 of the
    luminance."""
    rng = np.random.default_rng(0)
    grey = np.repeat(np.linspace(0, 1 if curve == "arib-std-b67" else 0.75, ROWS * COLUMNS), 3)
    codes = grey.reshape(ROWS, COLUMNS, 3)
    if curve == "smpte2084":
        codes = np.clip(codes + rng.uniform(-0.08, 0.08, codes.shape), 0.1, 0.7)
    path = film(tmp_path / f"hdr.{suffix}", codes, curve)
    assert colour_of(path) == Colour(9, CURVES[curve], 9)
    info = read_info(path)
    assert (info.colour, info.bits) == ({18: "HLG", 16: "PQ"}[CURVES[curve]], 10)
    assert f"is HDR ({info.colour}) and is read as such" in other_notes([info], False)[0]
    off = np.abs(blocks(next(iter(stored_frames(path)))) - blocks(by_zscale(path)))
    assert off.max() <= 10 and off.mean() < 1.5
    as_sdr = cv2.cvtColor(cv2.VideoCapture(str(path)).read()[1], cv2.COLOR_BGR2RGB)
    assert np.abs(blocks(as_sdr) - blocks(by_zscale(path))).mean() > 10, "it matters"


@NEEDS_FFMPEG
def test_a_film_of_rec_709_gives_back_its_colours(tmp_path):
    """OpenCV alone decodes it as Rec. 601."""
    codes = np.random.default_rng(0).uniform(0.2, 0.8, (ROWS, COLUMNS, 3))
    path = film(tmp_path / "a.mp4", codes, "bt709", "bt709", "bt709")
    assert np.abs(blocks(next(iter(stored_frames(path)))) - 255 * codes).max() < 4
    as_601 = cv2.cvtColor(cv2.VideoCapture(str(path)).read()[1], cv2.COLOR_BGR2RGB)
    assert np.abs(blocks(as_601) - 255 * codes).max() > 10
    assert read_info(path).colour == "SDR"


@NEEDS_FFMPEG
def test_deep_films_that_name_no_curve_get_a_line_that_names_it(tmp_path):
    path = film(tmp_path / "a.mp4", np.full((ROWS, COLUMNS, 3), 0.5), "unknown", primaries="unknown")
    info = read_info(path)
    assert info.colour == "" and info.bits == 10
    note = other_notes([info], False)[0]
    assert "does not say its curve" in note
    line = note.split("copy: ")[1].split(" (HLG")[0].split()
    subprocess.run([line[0], "-v", "error", *line[1:]], check=True)
    assert colour_of(tmp_path / "a_hlg.mp4") == Colour(9, 18, 9)


def test_films_that_say_nothing_are_read_as_before(tmp_path):
    path = write_video(tmp_path / "a.mp4", numbered(3))
    pictures = list(stored_frames(path))
    video = cv2.VideoCapture(str(path))
    for picture in pictures:
        np.testing.assert_array_equal(picture, cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2RGB))
    assert read_info(path).colour == ""
