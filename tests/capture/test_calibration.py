"""Intrinsics from rendered ChArUco views, the printed target, the board's mask, the sensor table."""

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.capture.annotate import annotate
from gof.capture.board_mask import board_mask, outlines_of
from gof.capture.calibration import calibrate, sharpest
from gof.capture.charuco import POINTS_PER_MM, Charuco, draw_pdf, draw_svg, page
from gof.capture.locate import Summary, locate
from gof.capture.sync import sensor
from gof.capture.template import BoardTemplate
from gof.commands.cli import main as gof
from gof.core.errors import DataFormatError, GofError
from gof.core.records import write_record
from gof.dataset import Dataset, DatasetDescription
from gof.footage.lens import CalibratedCamera, CamerasFile, Lens, read_cameras
from tests.capture.synthetic import SyntheticShot, render, write_video
from tests.conftest import look_at, write_dataset

pytestmark = pytest.mark.long

TARGET = Charuco()
TRUE = Lens(
    640, 360, np.array([[560.0, 0, 326], [0, 561.0, 177], [0, 0, 1]]), np.array([-0.25, 0.06, 0.0005, -0.0005, 0.0])
)
SHOT = SyntheticShot(width=400, height=560, marker_px=42, centre=(0.48, 0.72), noise=0)
BOARD = BoardTemplate.load("gof_board")


def charuco_views(count=16, tilt=0.8, fine=4):
    """(grey picture, R, t) of the target through TRUE: each of fine x fine points of a pixel is traced to its plane."""
    texture = TARGET.pattern().generateImage((1400, 1000), marginSize=0)
    rng = np.random.default_rng(3)
    grid = (np.stack(np.meshgrid(np.arange(640 * fine), np.arange(360 * fine)), -1).reshape(-1, 1, 2) + 0.5) / fine
    rays = cv2.undistortPointsIter(grid, TRUE.K, TRUE.distortion, None, None, (3, 100, 1e-9)).reshape(-1, 2)
    rays = np.column_stack([rays, np.ones(len(rays))])
    for _ in range(count):
        R = cv2.Rodrigues(rng.uniform(-tilt, tilt, 3))[0]
        t = np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.06, 0.06), rng.uniform(0.3, 0.4)]) - R @ [0.14, 0.1, 0]
        p = rays @ np.linalg.inv(np.column_stack([R[:, :2], t])).T
        maps = (p[:, :2] / p[:, 2:] * 5000 - 0.5).astype(np.float32).reshape(360 * fine, 640 * fine, 2)
        view = cv2.remap(texture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderValue=90)
        yield cv2.GaussianBlur(cv2.resize(view, (640, 360), interpolation=cv2.INTER_AREA), (0, 0), 0.7), R, t


@pytest.fixture(scope="module")
def views():
    return list(charuco_views())


def test_corners_have_pixel_centres_at_integer_and_a_half(views):
    """OpenCV changed this convention between versions; the principal point would be half a pixel off."""
    errors = []
    for picture, R, t in views:
        points, pixels = TARGET.corners(picture)
        truth = cv2.projectPoints(points.astype(np.float64), cv2.Rodrigues(R)[0], t, TRUE.K, TRUE.distortion)[0]
        errors.append((pixels - truth)[:, 0])
    errors = np.concatenate(errors)
    assert np.abs(errors.mean(0)).max() < 0.03 and errors.std() < 0.1


def test_charuco_intrinsics_are_recovered(views):
    found = calibrate((picture for picture, _, _ in views), TARGET)
    assert found.views >= 12 and found.rms_px < 0.1 and found.coverage > 0.7
    np.testing.assert_allclose(found.lens.K[[0, 1], [0, 1]], [560, 561], atol=1)
    np.testing.assert_allclose(found.lens.K[:2, 2], [326, 177], atol=0.7)
    # The stated uncertainty is of the size of the error.
    assert np.abs(found.lens.K[0, 0] - 560) < 4 * found.focal_sigma_px < 2
    # Coefficients trade off; what all of them together do to the picture, out to its corners, must agree.
    x, y = np.meshgrid(np.linspace(-0.55, 0.55, 9), np.linspace(-0.3, 0.3, 7))
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 1, 3)
    a, b = (cv2.projectPoints(rays, np.zeros(3), np.zeros(3), c.K, c.distortion)[0] for c in (found.lens, TRUE))
    assert np.abs(a - b).max() < 0.6


def warped_views(board, folder, count=12, pixels=60):
    """Pictures of 640x360, focal length 560 px, of an OpenCV board with squares of 40 mm, in a folder."""
    folder.mkdir()
    columns, rows = board.getChessboardSize()
    image = board.generateImage((columns * pixels, rows * pixels), marginSize=0)
    image = cv2.copyMakeBorder(image, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    height, width = image.shape
    K, scale, rng = np.array([[560.0, 0, 320], [0, 560, 180], [0, 0, 1]]), 0.04 / pixels, np.random.default_rng(1)
    for k in range(count):
        R = cv2.Rodrigues(np.array([*rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.3, 0.3)]))[0]
        t = np.array([rng.uniform(-0.06, 0.06), rng.uniform(-0.03, 0.03), rng.uniform(0.42, 0.6)])
        to_board = np.array([[scale, 0, -scale * width / 2], [0, scale, -scale * height / 2], [0, 0, 1]])
        H = K @ np.column_stack([R[:, :2], t]) @ to_board
        view = cv2.warpPerspective(image, H, (640, 360), flags=cv2.INTER_AREA, borderValue=90)
        cv2.imwrite(str(folder / f"{k:03d}.png"), view)
    return str(folder)


def opencv_board(columns, rows, dictionary=cv2.aruco.DICT_4X4_50, old=False):
    board = cv2.aruco.CharucoBoard((columns, rows), 0.04, 0.03, cv2.aruco.getPredefinedDictionary(dictionary))
    board.setLegacyPattern(old)  # OpenCV's own word for the layout before 4.6
    return board


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("rows", [6, 5])
def test_targets_of_either_layout_are_read(old, rows, tmp_path, capsys):
    pictures = warped_views(opencv_board(7, rows, old=old), tmp_path / "views")
    size = ["--squares", f"7x{rows}"]
    assert gof(["capture", "calibrate", pictures, *size, "--out", str(tmp_path / "lens.json")]) == 0
    camera = json.loads((tmp_path / "lens.json").read_text())["cameras"][0]
    assert camera["K"][0][0] == pytest.approx(560, abs=4) and camera["rms_px"] < 0.4
    assert ("OpenCV before 4.6" in capsys.readouterr().out) == (old and rows == 6)


@pytest.mark.parametrize(
    "board, remedy",
    [
        (opencv_board(5, 7), "it looks like --squares 5x7"),
        (opencv_board(7, 5, cv2.aruco.DICT_5X5_1000), "its markers are of DICT_5X5_1000"),
        (opencv_board(9, 7), "markers up to number 30 are seen, and 7 x 5 squares have 17"),
    ],
)
def test_what_another_target_looks_like_is_said(board, remedy, tmp_path, capsys):
    pictures = warped_views(board, tmp_path / "views", 8, 36)
    assert gof(["capture", "calibrate", pictures, "--out", str(tmp_path / "lens.json")]) == 1
    said = capsys.readouterr().err
    assert remedy in said and not (tmp_path / "lens.json").exists()


def test_odd_figures_of_a_lens_are_said_and_impossible_ones_refused(views):
    """Stretched and cropped pictures have other lenses: closed form. A target that bends fits none."""
    pictures = [picture for picture, _, _ in views]
    stretched = calibrate((cv2.resize(p, (640, 480)) for p in pictures), TARGET)
    assert stretched.lens.K[1, 1] / stretched.lens.K[0, 0] == pytest.approx(4 / 3, rel=0.02)
    assert "the focal lengths differ" in " ".join(stretched.warnings())
    cropped = calibrate((np.ascontiguousarray(p[:, :460]) for p in pictures), TARGET)
    assert "beside its middle" in " ".join(cropped.warnings())
    assert not any("beside" in text or "differ" in text for text in calibrate(pictures, TARGET).warnings())
    x, y = np.meshgrid(np.arange(640, dtype=np.float32), np.arange(360, dtype=np.float32))
    waves = [(np.sin(y / 60 + k), np.sin(x / 50 + 2 * k)) for k in range(len(pictures))]
    bent = (cv2.remap(p, x + 6 * a, y + 6 * b, cv2.INTER_LINEAR) for p, (a, b) in zip(pictures, waves, strict=True))
    with pytest.raises(GofError, match="miss every lens by [3-9]"):
        calibrate(bent, TARGET)


def test_a_wrong_view_is_left_out(views):
    pictures = [picture for picture, _, _ in views]
    bent = pictures[0].copy()
    bent[:, 320:] = cv2.warpAffine(pictures[0], np.float32([[1, 0, 0], [0, 1, 4]]), (640, 360))[:, 320:]
    found = calibrate([*pictures[1:], bent], TARGET)
    assert found.views <= len(pictures) - 1
    np.testing.assert_allclose(found.lens.K[[0, 1], [0, 1]], [560, 561], atol=1.5)


def test_views_from_one_direction_are_refused():
    for tilt in (0.0, 0.05):
        pictures = [picture for picture, _, _ in charuco_views(10, tilt=tilt, fine=1)]
        with pytest.raises(GofError, match=r"do not determine the focal length.*Tilt the target"):
            calibrate(pictures, TARGET)


def test_pictures_without_target_are_refused():
    with pytest.raises(GofError, match="0 of 9 pictures show at least 8 corners"):
        calibrate([np.full((90, 160), 128, np.uint8)] * 9, TARGET)
    with pytest.raises(GofError, match="one camera mode at a time"):
        calibrate([np.zeros((90, 160), np.uint8), np.zeros((80, 160), np.uint8)], TARGET)


def test_the_sharpest_of_equal_stretches_are_kept():
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 255, (40, 60, 3), dtype=np.uint8)

    def film(frames):
        for k in range(frames):
            picture = texture if k % 7 == 3 else cv2.GaussianBlur(texture, (0, 0), 2)
            picture = picture.copy()
            picture[:4, :4] = k  # which frame it is
            yield picture

    for frames in (1, 5, 9, 10, 50, 177):
        kept = sharpest(film(frames), 5)
        index = [int(p[0, 0]) for p in kept]
        assert min(5, frames) <= len(kept) < 10 and index == sorted(set(index))
        if frames >= 50:
            assert all(k % 7 == 3 for k in index[:-1])  # the last stretch may be cut short
            assert max(np.diff([0, *index, frames])) < 2 * frames / 4


def test_command_writes_what_gof_ingest_reads(views, tmp_path, capsys):
    (tmp_path / "photos").mkdir()
    for k, (picture, _, _) in enumerate(views):
        cv2.imwrite(str(tmp_path / f"photos/{k:02d}.png"), picture)
    write_video(tmp_path / "target.avi", (picture for picture, _, _ in views for _ in range(2)), "FFV1")
    out, footage = tmp_path / "cameras.json", [str(tmp_path / "photos"), str(tmp_path / "target.avi")]
    assert (
        gof(
            [
                "capture",
                "calibrate",
                *footage,
                "--out",
                str(out),
                "--views",
                "9",
                "--json",
                str(tmp_path / "figures.json"),
            ]
        )
        == 0
    )
    assert "photos: focal 5" in capsys.readouterr().out
    entries = json.loads(out.read_text())["cameras"]
    assert (
        [e["name"] for e in entries] == ["photos", "target"]
        and entries[0]["views"] == 16
        and 8 <= entries[1]["views"] < 18
    )
    for entry in entries:
        assert entry["K"][0][0] == pytest.approx(560, abs=1) and entry["rms_px"] < 0.1
    first, second = read_cameras(out, [out.with_name("a.mp4"), out.with_name("b.mp4")])
    assert first.name == "photos" and first.lens.width == 640 and len(second.lens.distortion) == 5
    assert gof(["capture", "calibrate", str(tmp_path / "photos"), "--out", str(out)]) == 1
    assert "--overwrite" in capsys.readouterr().err
    other = str(tmp_path / "other.json")
    assert gof(["capture", "calibrate", str(tmp_path / "photos"), "--squares", "11x5", "--out", other]) == 1
    error = capsys.readouterr().err
    assert "photos: " in error and "11 x 5 target" in error
    assert gof(["capture", "calibrate", str(tmp_path / "none.mp4"), "--out", other]) == 1
    assert "no such video" in capsys.readouterr().err
    assert gof(["capture", "calibrate", "--out", other]) == 1
    assert "name VIDEO" in capsys.readouterr().err


@pytest.mark.parametrize("target", [TARGET, Charuco(5, 8, 24.0, 18.0), Charuco(11, 8, 60.0, 45.0)])
def test_drawings_are_the_target_at_true_size(target, tmp_path):
    """Paint the squares of PDF and SVG at one pixel per marker cell; OpenCV draws the same pattern."""
    cell = target.marker_mm / 6
    w, h = (round(s / cell) for s in target.size_mm)
    truth = target.pattern().generateImage((w, h), marginSize=0)
    _, width, height = page(target)
    x0, y0 = (width - target.size_mm[0]) / 2, (height - target.size_mm[1]) / 2

    def paint(squares):
        image = np.full((h, w), 255, np.uint8)
        for x, y, side, black in squares:
            x, y, n = round((x - x0) / cell), round((y - y0) / cell), round(side / cell)
            image[y : y + n, x : x + n] = 0 if black else 255
        return image

    k = POINTS_PER_MM
    pdf = draw_pdf(target).decode()
    found = re.findall(r"^([01]) g (\S+) (\S+) (\S+) \S+ re f$", pdf, re.M)
    from_pdf = [(float(x) / k, height - float(y) / k - float(s) / k, float(s) / k, g == "0") for g, x, y, s in found]
    svg = [e.attrib for e in ET.fromstring(draw_svg(target)) if e.tag.endswith("rect")][1:]
    from_svg = [(float(e["x"]), float(e["y"]), float(e["width"]), e["fill"] == "#000") for e in svg]
    np.testing.assert_array_equal(paint(from_pdf), truth)
    np.testing.assert_array_equal(paint(from_svg), truth)
    assert f"MediaBox [0 0 {k * width:.4f} {k * height:.4f}]" in pdf
    start = int(re.search(r"startxref\n(\d+)", pdf).group(1))
    offsets = [int(o) for o in re.findall(r"^(\d{10}) 00000 n", pdf[start:], re.M)]
    assert pdf[start:].startswith("xref") and all(pdf[o:].startswith(f"{i} 0 obj") for i, o in enumerate(offsets, 1))


def test_target_command(tmp_path, capsys):
    assert gof(["capture", "target", "--out", str(tmp_path / "t.pdf"), "--json", str(tmp_path / "t.json")]) == 0
    assert json.loads((tmp_path / "t.json").read_text())["paper"] == "A4"
    assert "A4, 297 x 210 mm" in capsys.readouterr().out and (tmp_path / "t.pdf").read_bytes().startswith(b"%PDF")
    assert gof(["capture", "target", "--out", str(tmp_path / "t.png")]) == 1
    assert "a .pdf or an .svg" in capsys.readouterr().err
    assert gof(["capture", "target", "--out", str(tmp_path / "t.pdf"), "--charuco-mm", "50"]) == 1
    assert "smaller than its squares" in capsys.readouterr().err
    assert gof(["capture", "target", "--out", str(tmp_path / "t.svg"), "--squares", "15x15"]) == 1
    assert "50 markers" in capsys.readouterr().err


@pytest.fixture(scope="module")
def pictures():
    return list(render(SHOT, BOARD, 12))


def test_board_mask_covers_every_light_and_leaves_the_rest(pictures):
    summary = Summary()
    for p in pictures:
        summary.add(p)
    found = locate(summary, BOARD)
    mask = board_mask(outlines_of(found, BOARD), found.marker_px, (400, 560))
    flicker = np.ptp(np.stack(pictures).astype(np.int16), axis=0)
    assert (flicker * (1 - mask / 255)).max() <= 2  # nothing that flickers keeps weight
    assert (mask == 0).mean() > 0.3 and ((mask > 0) & (mask < 255)).any() and mask.dtype == np.uint8


def annotated(folder, pictures):
    """A dataset of one camera with board and one without."""
    cameras = [look_at(f"cam_{c}", (0.3 * c, -3, 1), (0, 0, 1), 400, 560, 500.0) for c in range(2)]
    grey = np.stack([[p, np.full_like(p, 90)] for p in pictures])[..., None].repeat(3, -1) / 255
    return write_dataset(folder, cameras, grey, grey[0], 0.0025 * np.arange(len(pictures)))


def test_annotate_with_the_datasets_own_pictures(pictures, tmp_path, capsys):
    folder = annotated(tmp_path / "data", pictures)
    assert gof(["capture", "annotate", str(folder), "--board", "gof_board"]) == 0
    text = capsys.readouterr().out
    assert "cam_0: board mask" in text and "cam_1: no board mask: marker 0" in text
    with_board, without = Dataset.open(folder).description.cameras
    assert with_board.board_mask == "cameras/cam_0/board_mask.png" and without.board_mask is None
    mask = cv2.imread(str(folder / with_board.board_mask), cv2.IMREAD_UNCHANGED)
    assert mask.shape == (560, 400) and mask.dtype == np.uint8 and mask.max() == 255 and mask.min() == 0
    flicker = np.ptp(np.stack(pictures).astype(np.int16), axis=0)
    assert mask[flicker > 30].min() == 255


def test_annotate_with_distorted_footage(pictures, tmp_path, capsys):
    """The mask is found in the stored (landscape, distorted) pictures and prepared as they are."""
    folder = annotated(tmp_path / "data", pictures)
    description = DatasetDescription.read(folder)
    turned = tuple(replace(entry, roll_deg=90.0) for entry in description.cameras)
    replace(description, cameras=turned).write(folder)
    (tmp_path / "stored").mkdir()
    for k, p in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"stored/{k:02d}.png"), cv2.rotate(p, cv2.ROTATE_90_COUNTERCLOCKWISE))
    camera = CalibratedCamera(560, 400, ((500, 0, 280), (0, 500, 200), (0, 0, 1)), (-0.2, 0.03, 0, 0))
    write_record(tmp_path / "cameras.json", CamerasFile((camera,)))
    command = ["capture", "annotate", str(folder), "--board", "gof_board"]
    command += ["--footage", str(tmp_path / "stored"), str(tmp_path / "stored"), "--cameras"]
    assert gof([*command, str(tmp_path / "cameras.json")]) == 0
    # Where a pixel of the undistorted, upright picture was before undistortion, by OpenCV's camera model.
    x, y = np.meshgrid(np.arange(560) + 0.5, np.arange(400) + 0.5)
    rays = np.stack([(x - 280) / 500, (y - 200) / 500, np.ones_like(x)], -1).reshape(-1, 1, 3)
    still = np.zeros(3)
    stored_xy = cv2.projectPoints(rays, still, still, np.array(camera.K, float), np.array(camera.distortion))[0]
    stored_xy = (stored_xy.reshape(400, 560, 2) - 0.5).astype(np.float32)
    flicker = np.ptp(np.stack(pictures).astype(np.int16), axis=0).astype(np.float32)
    flicker = cv2.rotate(flicker, cv2.ROTATE_90_COUNTERCLOCKWISE)
    flicker = cv2.rotate(
        cv2.remap(flicker, stored_xy[..., 0], stored_xy[..., 1], cv2.INTER_LINEAR), cv2.ROTATE_90_CLOCKWISE
    )
    for entry in Dataset.open(folder).description.cameras:
        mask = cv2.imread(str(folder / entry.board_mask), cv2.IMREAD_UNCHANGED)
        assert mask.shape == flicker.shape and mask[flicker > 30].min() == 255 and (mask == 0).mean() > 0.3
    write_record(tmp_path / "small.json", CamerasFile((replace(camera, width=100),)))
    assert gof([*command, str(tmp_path / "small.json")]) == 1
    assert "is 560x400, its lens 100x400" in capsys.readouterr().err


def test_annotate_keeps_everything_else_in_the_description(pictures, tmp_path):
    """Also what it does not know of: a novel view, provenance, own times."""
    folder = annotated(tmp_path / "data", pictures)
    before = DatasetDescription.read(folder)
    late = replace(before.cameras[0], time_s=tuple(t + 0.001 for t in before.time_s))
    novel = replace(before.cameras[1], name="novel", role="eval")
    before = replace(before, cameras=(late, before.cameras[1], novel), provenance={"camera": "GoPro"})
    before.write(folder)
    notes = annotate(Dataset.open(folder), BOARD)
    assert list(notes) == ["cam_0", "cam_1"]
    after = DatasetDescription.read(folder)
    first = replace(after.cameras[0], board_mask=None)
    assert after.cameras[0].board_mask
    assert set(after.made_from) == {camera.board_mask for camera in after.cameras if camera.board_mask}
    assert replace(after, cameras=(first, *after.cameras[1:]), made_from=before.made_from) == before


def test_sensor_table():
    gopro = sensor("gopro_hero13_720p400")
    assert gopro.row_time_us == 2.85 and gopro.image_row_time_us(480) == pytest.approx(2.85 * 1.5)
    with pytest.raises(DataFormatError, match="gopro_hero13_720p400"):
        sensor("pinhole")
