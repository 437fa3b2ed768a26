"""Board templates: files, the printable drawing, and the marker in it."""

import json
import xml.etree.ElementTree as ET
from importlib.resources import files

import cv2
import numpy as np
import pytest

from gof.capture.ring_board import load_board
from gof.capture.template import BoardTemplate, draw_svg
from gof.commands.cli import main as gof
from gof.core.errors import DataFormatError


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
        (lambda d: d["marker"].update(id=2**40), "'marker.id' must be 0 to 49"),
        (lambda d: d["marker"].update(id=2**70), "id"),
        (lambda d: d["marker"].update(id=-1), "'marker.id' must be 0 to 49"),
        (lambda d: d["marker"].update(side_m=1e-320), "'marker.side_m' must be"),
        (lambda d: d["marker"].update(side_m=-0.06), "'marker.side_m' must be"),
        (lambda d: d["leds"][3].update(xy=[1e308, 0]), "'leds' has a place"),
        (lambda d: d["strips"][0].update(ends=[[0, 0], [0, -1e9]]), "'strips' has a place"),
        (lambda d: d.update(outline=[[0, 0], [1, 0]]), "'outline' must have three"),
        (lambda d: d.update(disambiguation_lead=3.0), "'disambiguation_lead' must be"),
        (lambda d: d["leds"].extend({"bit": b, "xy": [0, 0]} for b in range(15, 40)), "24 Gray bits at most"),
    ],
)
def test_malformed_templates_are_refused(tmp_path, change, message):
    d = json.loads((files("gof.capture") / "gof_board.json").read_text())
    change(d)
    (tmp_path / "t.json").write_text(json.dumps(d))
    with pytest.raises(DataFormatError, match=message):
        BoardTemplate.load(tmp_path / "t.json")


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda d: d["ring"].update(count=10**9), "'ring.count' must be 8 to 1000"),
        (lambda d: d["ring"].update(count=7), "'ring.count' must be 8 to 1000"),
        (lambda d: d["ring"].update(radius=1e308), "'ring.radius' must be"),
        (lambda d: d["ring"].update(step_us=1e-300), "'ring.step_us'"),
        (lambda d: d["ring"].update(centre=[1e308, 0]), "has a place"),
        (lambda d: d["counter"].update(step=[1e308, 0]), "has a place"),
        (lambda d: d.update(marker_corner=[-1e308, 0]), "has a place"),
        (lambda d: d.update(corners=[[0, 1e300]]), "'corners' has a place"),
        (lambda d: d["marker"].update(side_m=5e-324), "'marker.side_m' must be"),
    ],
)
def test_malformed_ring_boards_are_refused(tmp_path, change, message):
    d = json.loads((files("gof.capture") / "rocsync.json").read_text())
    change(d)
    (tmp_path / "t.json").write_text(json.dumps(d))
    with pytest.raises(DataFormatError, match=message):
        load_board(tmp_path / "t.json")


def test_odd_names_and_sizes_make_a_whole_drawing_or_none(tmp_path):
    d = json.loads((files("gof.capture") / "gof_board.json").read_text())
    (tmp_path / "t.json").write_text(json.dumps(d | {"name": "a<b>&c"}))
    draw = ["capture", "draw", "--out", str(tmp_path / "t.svg"), "--overwrite", "--board", str(tmp_path / "t.json")]
    assert gof(draw) == 0
    title = next(e for e in ET.fromstring((tmp_path / "t.svg").read_text()) if e.tag.endswith("title"))
    assert title.text.startswith("LED board a<b>&c, marker side 60 mm")
    for size in ("1e308", "nan", "0", "-3"):
        assert gof([*draw, "--marker-mm", size]) == 1
    target = ["capture", "target", "--out", str(tmp_path / "t.pdf")]
    assert gof([*target, "--square-mm", "1e308", "--charuco-mm", "1e307"]) == 1
    assert not (tmp_path / "t.pdf").exists()
