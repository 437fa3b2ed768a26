"""Board templates: files, the printable drawing, and the marker in it."""

import json
import xml.etree.ElementTree as ET
from importlib.resources import files

import cv2
import numpy as np
import pytest

from gof.capture.template import BoardTemplate, draw_svg
from gof.errors import DataFormatError


@pytest.mark.parametrize("name, leds", [("gof_board", 16), ("paper_rig", 15)])
def test_templates_and_their_drawings(name, leds):
    board = BoardTemplate.load(name)
    assert len(board.led_xy) == leds and board.gray_bits == leds - 1
    svg = ET.fromstring(draw_svg(board, 60.0))
    tags = [e.tag.split("}")[1] for e in svg]
    assert tags.count("circle") == leds and tags.count("line") == 5 and tags.count("rect") == 36
    assert float(svg.get("width")[:-2]) == pytest.approx(
        60 * (np.ptp(np.vstack([board.outline, board.strip_ends.reshape(-1, 2)])[:, 0]) + 0.4), rel=1e-3
    )


def test_drawn_marker_is_the_one_that_is_looked_for():
    """Paint the drawing's squares and detect the marker in them."""
    board = BoardTemplate.load("gof_board")
    svg = ET.fromstring(draw_svg(board, 60.0))
    image = np.full((520, 520), 17, np.uint8)
    rects = [e for e in svg if e.tag.endswith("rect")]
    x0, y0 = (min(float(e.get(a)) for e in rects) for a in "xy")
    for e in rects:
        x, y, s = (float(e.get("x")) - x0) * 5 + 100, (float(e.get("y")) - y0) * 5 + 100, float(e.get("width")) * 5
        image[round(y) : round(y + s), round(x) : round(x + s)] = 255 if e.get("fill") == "#fff" else 17
    _, ids, _ = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)).detectMarkers(
        255 - image
    )
    assert ids.ravel().tolist() == [0]


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda d: d.pop("strips"), "strips"),
        (lambda d: d["strips"].pop(), "five"),
        (lambda d: d["leds"].pop(3), "each Gray bit"),
        (lambda d: d.update(schema="x"), "gof-led-board"),
    ],
)
def test_malformed_templates_are_refused(tmp_path, change, message):
    d = json.loads((files("gof.capture") / "gof_board.json").read_text())
    change(d)
    (tmp_path / "t.json").write_text(json.dumps(d))
    with pytest.raises(DataFormatError, match=message):
        BoardTemplate.load(tmp_path / "t.json")
