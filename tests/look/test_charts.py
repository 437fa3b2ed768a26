"""Charts: what is written on them, and where their points are, in files of all three formats and on pages."""

import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from gof.core.errors import GofError
from gof.evaluate.scores import AroundScore, FrameScore
from gof.look import charts, drawing
from gof.look.charts import (
    Point,
    accuracy_chart,
    around_chart,
    frame_chart,
    frame_times_chart,
    line_chart,
    stream_chart,
)
from gof.look.drawing import COLOURS
from tests.look.printed import curves, marks, texts

RISING = [(1.0, 10.0, "few"), (10.0, 100.0, "more"), (100.0, 1000.0, "")]
FALLING = [(2.0, 700.0, ""), (0.0, 5.0, "on no logarithmic axis"), (50.0, np.nan, "unknown"), (50.0, 20.0, "")]


def svg(tmp_path, lines, **how) -> str:
    line_chart("Error against time", "seconds", "error, px", lines, **how).write(tmp_path / "chart.svg")
    return (tmp_path / "chart.svg").read_text()


def test_a_chart_says_its_units_and_its_points_are_where_they_belong(tmp_path):
    drawn = svg(tmp_path, {"rising": RISING, "_$ of $ ones": FALLING})
    said = texts(drawn)
    for words in ("Error against time", "seconds", "error, px", "rising", "$ of $ ones", "few", "more"):
        assert said.count(words) == 1, (words, said)
    for tick in ("1", "2", "5", "10", "100", "1000"):
        assert tick in said
    assert not {"unknown", "on no logarithmic axis"} & set(said)
    rising, falling = marks(drawn).values()
    x, y = np.array(rising).T
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=1e-3), "decades are as wide as each other"
    assert y[0] - y[1] == pytest.approx(y[1] - y[2], abs=1e-3) and y[0] > y[2]
    assert len(falling) == 2
    assert falling[0][0] - x[0] == pytest.approx(np.log10(2) * (x[1] - x[0]), abs=1e-3)
    (line,) = curves(drawn, COLOURS[0])
    assert np.allclose(line, rising, atol=1e-3), "a line through its marks"


def test_an_axis_that_is_not_logarithmic_shows_zero_and_below(tmp_path):
    drawn = svg(tmp_path, {"similarity": [(1.0, -0.5, ""), (10.0, 0.0, ""), (100.0, 0.5, "")]}, log="x")
    (points,) = marks(drawn).values()
    x, y = np.array(points).T
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=1e-3) and y[0] - y[1] == pytest.approx(y[1] - y[2], abs=1e-3)
    assert {"0.0", "100"} <= set(texts(drawn))


def test_a_bar_goes_a_spread_up_and_down(tmp_path):
    points = [Point(1.0, 1.0), Point(10.0, 2.0, spread=0.5)]
    drawn = svg(tmp_path, {"mean": points}, log="x")
    ((x, one), (x_bar, two)) = next(iter(marks(drawn).values()))
    line, bar = sorted(curves(drawn, COLOURS[0]), key=lambda c: c[0][0])
    assert np.allclose(line, [(x, one), (x_bar, two)], atol=1e-3)
    (low_x, low), (high_x, high) = bar
    assert low_x == high_x == pytest.approx(x_bar, abs=1e-3)
    assert low - two == pytest.approx((one - two) / 2, abs=1e-3) == two - high


def test_a_long_line_has_no_marks_and_more_lines_than_colours_are_told_apart_by_dashes(tmp_path):
    many = {f"line {k}": [(1.0, k + 1.0, ""), (2.0, k + 1.0, "")] for k in range(len(COLOURS) + 1)}
    drawn = svg(tmp_path, many)
    assert len(curves(drawn, COLOURS[0])) == 2 and drawn.count("stroke-dasharray") == 2, "line and legend"
    assert all(name in texts(drawn) for name in many)
    long = svg(tmp_path, {"law": [(float(v), float(v), "") for v in np.geomspace(1, 9, 60)]})
    assert marks(long) == {} and len(curves(long, COLOURS[0])) == 1


def test_values_within_one_decade_have_numbers_on_their_axis(tmp_path):
    drawn = svg(tmp_path, {"flat": [(310.0, 0.61, ""), (330.0, 0.64, "")]})
    numbers = [float(words) for words in texts(drawn) if re.fullmatch(r"[\d.]+", words)]
    assert {310, 320, 330} <= set(numbers) and {0.6, 0.62, 0.64} <= set(numbers)


def test_the_chart_is_white_in_every_format_so_that_it_reads_on_a_dark_page(tmp_path):
    for suffix in ("png", "pdf"):
        line_chart("t", "x, m", "y, m", {"one": RISING}).write(tmp_path / f"chart.{suffix}")
    picture = cv2.imread(str(tmp_path / "chart.png"), cv2.IMREAD_UNCHANGED)
    assert (picture[0, 0] == 255).all() and (picture.reshape(-1, picture.shape[2])[:, :3] != 255).any()
    assert b"/FontFile2" in (tmp_path / "chart.pdf").read_bytes()
    assert re.search(r'id="patch_1">\s*<path [^>]*style="fill: #ffffff"', svg(tmp_path, {"one": RISING}))
    with pytest.raises(GofError, match=r"chart\.jpg: a figure is a \.pdf, \.svg, \.png"):
        line_chart("t", "x", "y", {"one": RISING}).write(tmp_path / "chart.jpg")


def test_nothing_to_draw_is_an_empty_chart(tmp_path):
    assert "error, px" in texts(svg(tmp_path, {"none": [(0.0, 1.0, "")]}))


def test_no_words_leave_the_figure(tmp_path):
    """Small numbers have many figures, the last points' labels stand left of their marks, and long names are folded."""
    points = [Point(1.0, 1e-4, "first"), Point(100.0, 1.0, "a long label of the last point")]
    line_chart("t", "x, m", "relative error", {"one": points}).write(tmp_path / "c.png")
    long = "A method of M. Ammann, with words and words and MORE WORDS for its name, as wide as its authors like"
    accuracy_chart("l2", [(long, 10.0, 0.5), ("b", 20.0, 0.3)], 0.6).write(tmp_path / "a.png")
    pictures = [cv2.imread(str(tmp_path / name), cv2.IMREAD_GRAYSCALE) for name in ("c.png", "a.png")]
    for border in (edge for p in pictures for edge in (p[:, :3], p[:, -3:], p[:3], p[-3:])):
        assert border.min() == 255


# ---------------------------------------------------------------- scores


def test_accuracy_has_names_as_they_are_and_its_points_where_they_belong(tmp_path):
    names = (
        "cheap $1 and $2",
        "_hidden",
        "a name so long that it cannot be printed in a single line of a narrow legend, even if one tries to",
    )
    points = list(zip(names, (10.0, 100.0, 1000.0), (0.5, 0.4, 0.45), strict=True))
    chart = accuracy_chart("l2", points, 0.6)
    chart.write(tmp_path / "a.svg")
    chart.write(tmp_path / "a.pdf")
    svg = (tmp_path / "a.svg").read_text()
    said = texts(svg)
    for words in ("cheap $1 and $2", "hidden", "seconds to train", "DVE L2 (lower is better)", "10", "100", "1000"):
        assert words in said, (words, said)
    x, y = np.concatenate(list(marks(svg).values())).T
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], rel=1e-3), "decades are as wide as each other"
    assert (y[0] - y[1]) / (y[2] - y[1]) == pytest.approx((0.5 - 0.4) / (0.45 - 0.4), rel=1e-2)
    (front,) = curves(svg, charts.FRONT)
    assert (min(front)[1], max(front)[1]) == pytest.approx((y[0], y[1]), abs=0.01), "the third is beaten in both"
    assert max(front)[0] == pytest.approx(x[1], abs=0.01)
    assert b"/FontFile2" in (tmp_path / "a.pdf").read_bytes()


def test_scores_of_frames_have_gaps_and_levels(tmp_path):
    times_s, values = (1.0, 1.1, 1.2, 1.4), (0.5, None, 1.0, 2.0)
    frames = tuple(FrameScore(t, l2, 0.9, 10, 0) for t, l2 in zip(times_s, values, strict=True))
    scores = SimpleNamespace(
        dve=SimpleNamespace(frames=frames), trivial_baselines={"constant": SimpleNamespace(l2=0.75)}
    )
    frame_chart(scores).write(tmp_path / "l2.svg")
    svg = (tmp_path / "l2.svg").read_text()
    line = re.search(r'<path d="([^"]*)"[^>]*stroke: #c2410c', svg)[1]
    assert line.count("M") == 2, "cut where a frame has no score"
    places = np.array(marks(svg)["#c2410c"])
    assert len(places) == 3
    np.testing.assert_allclose(np.diff(places[:, 0]) / np.ptp(places[:, 0]), [0.5, 0.5], atol=1e-3)  # 1.0, 1.2, 1.4 s
    np.testing.assert_allclose(np.diff(places[:, 1]) / np.ptp(places[:, 1]), [-1 / 3, -2 / 3], atol=1e-3)
    assert {"standing still", "one constant vector", "time (ms)"} <= set(texts(svg))
    assert frame_chart(SimpleNamespace(dve=SimpleNamespace(frames=frames[:2]), trivial_baselines={})) is None


def test_scores_from_all_around_are_at_their_angles_and_the_line_is_their_mean(tmp_path):
    views = [("a", 0.0, 30.0), ("b", 45.0, 24.0), ("c", 45.2, 20.0), ("d", 90.0, 20.0), ("no flame", 135.0, None)]
    scores = SimpleNamespace(around=[AroundScore(camera=n, angle_deg=a, pictures=1, psnr_flame=p) for n, a, p in views])
    around_chart(scores).write(tmp_path / "around.svg")
    svg = (tmp_path / "around.svg").read_text()
    places = np.array(marks(svg)["#c2410c"])
    np.testing.assert_allclose(np.diff(places[:, 0]) / np.ptp(places[:, 0]), [0.5, 0.2 / 90, 44.8 / 90], atol=2e-3)
    np.testing.assert_allclose(np.diff(places[:, 1]) / np.ptp(places[:, 1]), [0.6, 0.4, 0], atol=2e-3)  # y downwards
    line = np.array(curves(svg, "#c2410c")[0])
    assert line[1, 1] == pytest.approx(places[1:3, 1].mean(), abs=0.01) and len(line) == 3
    assert around_chart(SimpleNamespace(around=())) is None


# ---------------------------------------------------------------- streams


def rotation(n=60):
    """Density of a disc of 20 cells, and a solid rotation about its middle."""
    x, y = np.meshgrid(np.arange(n) + 0.5 - n / 2, np.arange(n) + 0.5 - n / 2, indexing="ij")
    return (np.hypot(x, y) < 20).astype(float), np.stack([-y, x], -1)


def test_streams_follow_a_known_flow_where_there_is_something():
    """Solid rotation: lines stay on circles and go round the right way; nothing is drawn where nothing is."""
    density, flow = rotation()
    (axes,) = stream_chart("rotation", density, flow, cell_m=0.01)._drawn().axes
    (lines,) = axes.collections
    pieces = np.array(lines.get_segments()) - 30  # (N, 2, 2)
    assert len(pieces) > 500
    radius = np.linalg.norm(pieces, axis=-1)
    assert radius.max() < 22 and np.abs(np.diff(radius, axis=1)).max() < 0.1
    arrows = [patch for patch in axes.patches if type(patch).__name__ == "FancyArrowPatch"]
    assert len(arrows) > 5
    for arrow in arrows:
        (x0, y0), (x1, y1) = np.array(arrow._posA_posB) - 30
        assert x0 * y1 - y0 * x1 > 0, "against the clock"
    (bar,) = axes.lines
    assert np.ptp(bar.get_xdata()) == pytest.approx(20), "0.2 m, where 60 cells are 0.6 m"
    assert not stream_chart("still", density, 0 * flow, cell_m=0.01)._drawn().axes[0].collections


# ---------------------------------------------------------------- a camera's times


@pytest.mark.parametrize("slot", [np.array([1, 0]), None])
def test_residuals_are_where_they_were_measured_and_left_out_frames_are_hollow(tmp_path, slot):
    times = SimpleNamespace(
        time_us=np.array([1000.0, 2000.0, 3000.0, 4000.0]),
        measured_us=np.array([1000.0, 2003.0, 2980.0, 4000.0]),
        used=np.array([True, True, False, True]),
        **{"rms_us": 1.5, "max_us": 3.0, "interval_us": 1000.0, "row_time_us": 7.0, "readout": "down"},
        curve=np.array([[0, 1, 0, 0.0], [0, 0, 1, 0]])[: 1 if slot is None else 2],
        faults=["$what$ it is"],
    )
    chart = frame_times_chart("cam_0", times, slot, 4000.0)
    above, below = chart._drawn().axes
    kept, left_out = above.lines[:2]
    assert kept.get_xdata().tolist() == [0, 1, 3] and kept.get_ydata().tolist() == [0, 3, 0]
    assert left_out.get_markerfacecolor() == "none" and left_out.get_ydata().tolist() == [-10], "at the border"
    said = [text.get_text() for text in below.texts]
    assert "fault: $what$ it is" in said and ("slot 1" in said) == (slot is not None)
    assert below.lines[0].get_xdata().tolist() == [0, 1, 2, 3], "ms"
    chart.write(tmp_path / "a.png")
    assert cv2.imread(str(tmp_path / "a.png")) is not None


# ---------------------------------------------------------------- on a page


def on_a_page() -> str:
    return accuracy_chart("l2", [("one & <b>", 10.0, 0.5), ("two", 30.0, 0.4)]).svg()


def test_a_chart_on_a_page_is_named_text_with_its_numbers_at_the_marks():
    root = ElementTree.fromstring(on_a_page().replace("<svg", '<svg xmlns:xlink="xlink"', 1))
    assert root.get("role") == "img" and root.get("aria-label") == "DVE L2 (lower is better)"
    said = [element.text for element in root.iter("text")]
    assert {"one & <b>", "seconds to train", "DVE L2 (lower is better)", "10"} <= set(said), "letters are text"
    tips = [element.text for element in root.iter("title")]
    assert tips == ["one & <b>, DVE L2 0.500, 10 s", "two, DVE L2 0.400, 30 s"]
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(set(ids)) == len(ids) and all(re.match(r"[mp][0-9a-f]+$", one) for one in ids), "definitions only"
    assert "font-family" not in on_a_page(), "the page's own"


def test_every_colour_of_a_chart_has_one_for_dark_pages():
    svg = on_a_page()
    body = svg.partition("</style>")[2]
    for colour in set(re.findall(r"#[0-9a-f]{6}\b", body)) - {charts.FRONT}:
        assert body.count(colour) == body.count(f"var(--{colour[1:]}, {colour})")
        assert f"--{colour[1:]}: {drawing.DARK[colour]}" in svg

    def luminance(colour):
        parts = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722)

    for light, dark in drawing.DARK.items():
        if light != drawing.GRID:  # WCAG 2, 1.4.11: graphics have a contrast of 3 to their ground
            assert 1.05 / (luminance(light) + 0.05) > 3 and (luminance(dark) + 0.05) / 0.05 > 3  # on black


def test_the_same_chart_is_the_same_bytes_whatever_the_users_settings_are(tmp_path):
    import matplotlib

    chart = line_chart("t", "x", "y", {"one": RISING})
    for kind in ("svg", "pdf", "png"):
        chart.write(tmp_path / f"a.{kind}")
        with matplotlib.rc_context({"font.size": 20, "axes.grid": True, "figure.facecolor": "red"}):
            chart.write(tmp_path / f"b.{kind}")
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
    assert on_a_page() == on_a_page()


def test_threads_draw_what_one_thread_draws():
    """Pages and files have other settings, which are the process's: one at a time."""
    chart = line_chart("t", "x", "y", {"one": RISING})
    alone = chart.svg()
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: chart.svg(), range(8))) == {alone}


def test_drawing_asks_for_no_window_and_starting_for_no_matplotlib():
    code = (
        "import sys; from gof.look.charts import line_chart; assert 'matplotlib' not in sys.modules; "
        "line_chart('t', 'x', 'y', {'a': [(1, 2, '')]}).svg(); assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
