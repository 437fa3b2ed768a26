"""The chart of lines: what is written on it, and where its points are, in all three formats."""

import re

import cv2
import numpy as np
import pytest

from gof.core.errors import GofError
from gof.look import line_chart
from tests.look.printed import curves, marks, texts

pytest.importorskip("matplotlib", reason="the extra 'figures' is not installed")

RISING = [(1.0, 10.0, "few"), (10.0, 100.0, "more"), (100.0, 1000.0, "")]
FALLING = [(2.0, 700.0, ""), (0.0, 5.0, "on no logarithmic axis"), (50.0, np.nan, "unknown"), (50.0, 20.0, "")]


def svg(tmp_path, lines, **how) -> str:
    line_chart.write(tmp_path / "chart.svg", "Error against time", "seconds", "error, px", lines, **how)
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
    (line,) = curves(drawn, line_chart.COLOURS[0])
    assert np.allclose(line, rising, atol=1e-3), "a line through its marks"


def test_an_axis_that_is_not_logarithmic_shows_zero_and_below(tmp_path):
    drawn = svg(tmp_path, {"similarity": [(1.0, -0.5, ""), (10.0, 0.0, ""), (100.0, 0.5, "")]}, log="x")
    (points,) = marks(drawn).values()
    x, y = np.array(points).T
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=1e-3) and y[0] - y[1] == pytest.approx(y[1] - y[2], abs=1e-3)
    assert {"0.0", "100"} <= set(texts(drawn))


def test_a_bar_goes_a_spread_up_and_down(tmp_path):
    points = [line_chart.Point(1.0, 1.0), line_chart.Point(10.0, 2.0, spread=0.5)]
    drawn = svg(tmp_path, {"mean": points}, log="x")
    ((x, one), (x_bar, two)) = next(iter(marks(drawn).values()))
    line, bar = sorted(curves(drawn, line_chart.COLOURS[0]), key=lambda c: c[0][0])
    assert np.allclose(line, [(x, one), (x_bar, two)], atol=1e-3)
    (low_x, low), (high_x, high) = bar
    assert low_x == high_x == pytest.approx(x_bar, abs=1e-3)
    assert low - two == pytest.approx((one - two) / 2, abs=1e-3) == two - high


def test_a_long_line_has_no_marks_and_more_lines_than_colours_are_told_apart_by_dashes(tmp_path):
    many = {f"line {k}": [(1.0, k + 1.0, ""), (2.0, k + 1.0, "")] for k in range(len(line_chart.COLOURS) + 1)}
    drawn = svg(tmp_path, many)
    assert len(curves(drawn, line_chart.COLOURS[0])) == 2 and drawn.count("stroke-dasharray") == 2, "line and legend"
    assert all(name in texts(drawn) for name in many)
    long = svg(tmp_path, {"law": [(float(v), float(v), "") for v in np.geomspace(1, 9, 60)]})
    assert marks(long) == {} and len(curves(long, line_chart.COLOURS[0])) == 1


def test_values_within_one_decade_have_numbers_on_their_axis(tmp_path):
    drawn = svg(tmp_path, {"flat": [(310.0, 0.61, ""), (330.0, 0.64, "")]})
    numbers = [float(words) for words in texts(drawn) if re.fullmatch(r"[\d.]+", words)]
    assert {310, 320, 330} <= set(numbers) and {0.6, 0.62, 0.64} <= set(numbers)


def test_the_chart_is_white_in_every_format_so_that_it_reads_on_a_dark_page(tmp_path):
    for suffix in ("png", "pdf"):
        line_chart.write(tmp_path / f"chart.{suffix}", "t", "x, m", "y, m", {"one": RISING})
    picture = cv2.imread(str(tmp_path / "chart.png"), cv2.IMREAD_UNCHANGED)
    assert (picture[0, 0] == 255).all() and (picture.reshape(-1, picture.shape[2])[:, :3] != 255).any()
    assert b"/FontFile2" in (tmp_path / "chart.pdf").read_bytes()
    assert re.search(r'id="patch_1">\s*<path [^>]*style="fill: #ffffff"', svg(tmp_path, {"one": RISING}))
    with pytest.raises(GofError, match=r"chart\.jpg: a figure is a \.pdf, \.svg, \.png"):
        line_chart.write(tmp_path / "chart.jpg", "t", "x", "y", {"one": RISING})


def test_nothing_to_draw_is_an_empty_chart(tmp_path):
    assert "error, px" in texts(svg(tmp_path, {"none": [(0.0, 1.0, "")]}))


def test_no_words_leave_the_figure(tmp_path):
    """Small numbers have many figures, and the last points' labels stand left of their marks."""
    points = [line_chart.Point(1.0, 1e-4, "first"), line_chart.Point(100.0, 1.0, "a long label of the last point")]
    line_chart.write(tmp_path / "c.png", "t", "x, m", "relative error", {"one": points})
    picture = cv2.imread(str(tmp_path / "c.png"), cv2.IMREAD_GRAYSCALE)
    for border in (picture[:, :3], picture[:, -3:], picture[:3], picture[-3:]):
        assert border.min() == 255
