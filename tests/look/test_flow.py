"""`gof flow` against blobs whose motion in the picture is a formula, and its files against other readers."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.commands.evaluate import main as evaluate_main
from gof.commands.flow import main
from gof.commands.leaderboard import main as leaderboard_main
from gof.core.cameras import Camera
from gof.core.errors import DataFormatError, GofError
from gof.core.flow import FlowErrors, read_flow, write_flow
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from tests.conftest import write_dataset

WIDTH, HEIGHT, F = 96, 64, 100.0
STEP = 0.02  # s from frame to frame
# In camera axes (right, down, ahead), m and m/s: where each blob is at time 0, and how it moves.
PLACES = np.array([[-0.5, -0.3, 2.0], [0.5, -0.2, 2.5], [0.0, 0.35, 1.8]])
VELOCITIES = np.array([[0.6, 0.2, 0.0], [-0.9, 0.5, 0.7], [0.3, -1.1, -0.8]])


def cameras():
    """One looks along +y from the origin, world Z up; one stands half a metre to the right of it."""
    axes = np.array([[1, 0, 0], [0, 0, -1.0], [0, 1, 0]])
    K = [[F, 0, WIDTH / 2], [0, F, HEIGHT / 2], [0, 0, 1]]
    poses = [np.eye(4), np.eye(4)]
    for pose, right in zip(poses, (0, 0.5), strict=True):
        pose[:3, :3], pose[:3, 3] = axes, [-right, 0, 0]
    return [Camera(f"cam_{k}", WIDTH, HEIGHT, K, pose) for k, pose in enumerate(poses)]


def blobs(**changes) -> TransientGaussians:
    world = np.array([[1, 0, 0], [0, 0, 1.0], [0, -1, 0]])  # camera axes to world
    n = len(PLACES)
    values = {
        "position": PLACES @ world.T,
        "velocity": VELOCITIES @ world.T,
        "t_mu": np.zeros(n),
        "t_sigma": np.full(n, np.inf),
        "scale": np.full((n, 3), 0.04),
        "rotation": np.tile([1.0, 0, 0, 0], (n, 1)),
        "opacity": np.full(n, 0.7),
        "color": np.ones((n, 3)),
        "dynamic": np.ones(n, bool),
    }
    return TransientGaussians(**values | changes)


def pixel(blob: int, right: float, time_s: float) -> np.ndarray:
    """The pinhole's formula, (2,) px."""
    x, y, z = PLACES[blob] + time_s * VELOCITIES[blob] - [right, 0, 0]
    return np.array([F * x / z + WIDTH / 2, F * y / z + HEIGHT / 2])


def per_frame(blob: int, right: float, time_s: float) -> np.ndarray:
    """Its derivative times the frame's time, (2,) px: f (v_x - x/z v_z) / z."""
    x, y, z = PLACES[blob] + time_s * VELOCITIES[blob] - [right, 0, 0]
    vx, vy, vz = VELOCITIES[blob]
    return F * STEP / z * np.array([vx - x / z * vz, vy - y / z * vz])


def around(blob: int, right: float, time_s: float, radius: float) -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return np.hypot(*(np.stack([x, y]) - pixel(blob, right, time_s)[:, None, None])) < radius


@pytest.fixture
def dataset(tmp_path):
    """Two cameras, three frames, masks of the three blobs, and their true motion by the formula."""
    views = cameras()
    masks = np.zeros((3, 2, HEIGHT, WIDTH))
    for k in range(3):
        for c, right in enumerate((0, 0.5)):
            truth = np.zeros((HEIGHT, WIDTH, 2))
            for blob in range(3):
                here = around(blob, right, k * STEP, 3)
                truth[here], masks[k, c][here] = per_frame(blob, right, k * STEP), 1
            path = tmp_path / f"data/cameras/cam_{c}/flow/{k:06d}.exr"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_flow(path, truth, masks[k, c])
    pictures = np.zeros((3, 2, HEIGHT, WIDTH, 3))
    folder = write_dataset(
        tmp_path / "data", views, pictures, pictures[0], STEP * np.arange(3), masks=masks, test_frames=(1,)
    )
    description = Dataset.open(folder).description
    entries = [replace(e, flow=f"cameras/{e.name}/flow/{{frame:06d}}.exr") for e in description.cameras]
    replace(description, cameras=tuple(entries)).write(folder)
    return folder


def run(tmp_path, dataset, gaussians, *options) -> dict:
    gaussians.save(tmp_path / "mine.npz")
    words = [str(tmp_path / "mine.npz"), "--dataset", str(dataset), "--out", str(tmp_path / "out"), "--overwrite"]
    assert main([*words, *options, "--json", str(tmp_path / "figures.json")]) == 0
    return json.loads((tmp_path / "figures.json").read_text())


def test_the_error_stands_in_the_scores_and_on_the_board(tmp_path, dataset, capsys):
    """A gas of half the blobs' speed is off by half the pinhole's formula, on the pixels of the held-out frame."""
    own = blobs()
    for name, gas in (("true", own.velocity), ("half", own.velocity / 2)):
        (tmp_path / name).mkdir()
        blobs(gas_velocity=gas).save(tmp_path / name / "result.npz")
        words = [str(tmp_path / name / "result.npz"), "--dataset", str(dataset), "--out", str(tmp_path / name)]
        assert evaluate_main(words) == 0
    assert "end-point error" in " ".join(capsys.readouterr().out.split())
    exact = [
        np.full(np.count_nonzero(around(blob, right, STEP, 3)), np.linalg.norm(per_frame(blob, right, STEP)))
        for blob in range(3)
        for right in (0, 0.5)
    ]
    expected = np.concatenate(exact).mean() / 2
    found = {name: json.loads((tmp_path / name / "scores.json").read_text())["flow"] for name in ("true", "half")}
    assert expected > 0.2 and found["half"]["result"]["epe_px"] == pytest.approx(expected, abs=0.01)
    assert found["true"]["result"]["epe_px"] < 0.01
    assert found["half"]["zero"]["epe_px"] == pytest.approx(2 * expected, rel=1e-5)
    assert found["half"]["result"]["pixels"] == sum(map(len, exact)) and found["half"]["pictures"] == 2
    assert leaderboard_main([str(tmp_path / "true"), str(tmp_path / "half"), "--out", str(tmp_path / "board")]) == 0
    assert "EPE" in capsys.readouterr().out
    rows = json.loads((tmp_path / "board/leaderboard.json").read_text())["rows"]
    assert [row["epe_px"] for row in rows] == [found[row["name"]]["result"]["epe_px"] for row in rows]
    assert "EPE (px)" in (tmp_path / "board/leaderboard.md").read_text()


def test_without_exact_motion_there_is_no_such_score(tmp_path, dataset):
    description = Dataset.open(dataset).description
    replace(description, cameras=tuple(replace(e, flow=None) for e in description.cameras)).write(dataset)
    blobs().save(tmp_path / "result.npz")
    assert evaluate_main([str(tmp_path / "result.npz"), "--dataset", str(dataset), "--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out/scores.json").read_text())["flow"] is None


def test_blobs_move_as_the_pinhole_says(tmp_path, dataset, capsys):
    figures = run(tmp_path, dataset, blobs(), "--all-frames", "--files", "exr", "flo", "png")
    for k in range(3):
        for c, right in enumerate((0, 0.5)):
            exr, weight = read_flow(tmp_path / f"out/cam_{c}/{k:06d}.exr")
            flo = cv2.readOpticalFlow(str(tmp_path / f"out/cam_{c}/{k:06d}.flo"))
            for blob in range(3):
                here = around(blob, right, k * STEP, 3)
                assert weight[here].min() > 0.05, "the blob is where the formula says"
                expected = per_frame(blob, right, k * STEP)
                assert np.abs(exr[here] - expected).max() < 0.01
                np.testing.assert_array_equal(flo[here], exr[here])
            assert (flo[weight == 0] > 1e9).all() and not exr[weight == 0].any()
            picture = cv2.imread(str(tmp_path / f"out/cam_{c}/{k:06d}.png"))
            assert picture.shape[0] == HEIGHT and picture.shape[1] >= 2 * WIDTH and picture.std() > 5
    scores = figures["scores"]
    assert scores["result"]["epe_px"] < 0.01 and scores["result"]["fl_all"] == 0 and scores["covered"] == 1
    assert scores["result"]["angular_deg"] < 0.2
    assert scores["zero"]["epe_px"] > 0.5 and scores["mean"]["epe_px"] > 0.5
    assert figures["frame_time_s"] == pytest.approx(STEP) and figures["pictures"] == 6
    assert "trivial: none" in capsys.readouterr().out


def test_the_formula_is_the_derivative_of_the_projection():
    h = 1e-6
    for blob in range(3):
        moved = (pixel(blob, 0.5, STEP + h) - pixel(blob, 0.5, STEP - h)) / (2 * h) * STEP
        np.testing.assert_allclose(per_frame(blob, 0.5, STEP), moved, atol=1e-6)


def test_errors_of_a_result_at_rest_are_those_of_no_motion(tmp_path, dataset):
    """Held-out frames alone; and what is missing from the picture says that nothing moves, and counts."""
    scores = run(tmp_path, dataset, blobs(velocity=np.zeros((3, 3))))["scores"]
    assert scores["result"] == pytest.approx(scores["zero"]) and scores["pictures"] == 2
    lost = run(tmp_path, dataset, blobs()[:1])["scores"]
    pixels = [np.count_nonzero(around(b, right, STEP, 3)) for b in range(3) for right in (0, 0.5)]
    motions = [np.linalg.norm(per_frame(b, right, STEP)) for b in range(3) for right in (0, 0.5)]
    assert lost["covered"] == pytest.approx(sum(pixels[:2]) / sum(pixels), abs=0.02)
    assert lost["result"]["epe_px"] == pytest.approx(np.dot(pixels[2:], motions[2:]) / sum(pixels), abs=0.02)
    assert lost["zero"]["epe_px"] == pytest.approx(np.dot(pixels, motions) / sum(pixels), rel=1e-5)


def test_a_wall_hides_motion_and_has_none(tmp_path, dataset):
    """A still Gaussian before the first blob and one behind it: the flame's pixels move as the flame does."""
    g = blobs()
    still = replace(
        g[[0, 0]],
        position=g.position[[0, 0]] * [[0.8], [1.3]],
        dynamic=np.zeros(2, bool),
        velocity=np.full((2, 3), 5.0),
        scale=np.full((2, 3), 0.1),
    )
    figures = run(tmp_path, dataset, TransientGaussians.concatenate([g, still]), "--cameras", "cam_0", "--all-frames")
    flow, weight = read_flow(tmp_path / "out/cam_0/000000.exr")
    here = around(0, 0, 0, 3)
    assert np.abs(flow[here] - per_frame(0, 0, 0)).max() < 0.01
    assert weight[here].max() < 0.35, "what is before it takes its part"
    assert figures["scores"]["result"]["epe_px"] < 0.01 and figures["pictures"] == 3


def test_without_true_motion_the_files_are_all_there_is(tmp_path, tiny_dataset, capsys):
    assert run(tmp_path, tiny_dataset, blobs())["scores"] is None
    assert "no errors" in capsys.readouterr().out
    for words, said in (
        (["--cameras", "cam_9"], "--cameras cam_9: .* has cam_0, cam_1"),
        (["--cameras", "cam_1", "--out", str(tmp_path / "out")], "is there already"),
    ):
        with pytest.raises(GofError, match=said):
            main([str(tmp_path / "mine.npz"), "--dataset", str(tiny_dataset), *words])


def test_damaged_truth_is_named(tmp_path, dataset):
    path = dataset / "cameras/cam_1/flow/000001.exr"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(DataFormatError, match=r"cam_1/flow/000001\.exr: .*cut off|damaged"):
        run(tmp_path, dataset, blobs())
    write_flow(path, np.zeros((3, 4, 2)), np.ones((3, 4)))
    with pytest.raises(DataFormatError, match="its camera has"):
        run(tmp_path, dataset, blobs())


def test_errors_by_hand():
    """Off by 5 px of 12 to the right: over 3 px and 5 %. Off by 4 of 100: over 3 px, not 5 %. The third is right."""
    errors = FlowErrors()
    errors.add(np.array([[12.0, 5.0], [104.0, 0.0]]), np.array([[12.0, 0.0], [100.0, 0.0]]))
    errors.add(np.array([[1.0, 0.0]]), np.array([[1.0, 0.0]]))
    score = errors.score()
    assert score.epe_px == pytest.approx((5 + 4 + 0) / 3) and score.fl_all == pytest.approx(1 / 3)
    first = np.degrees(np.arccos((144 + 1) / np.sqrt(170 * 145)))
    second = np.degrees(np.arctan(104) - np.arctan(100))
    assert score.angular_deg == pytest.approx((first + second) / 3)
    with pytest.raises(GofError, match="no pixel"):
        FlowErrors().score()


def test_a_flow_of_the_dataset_is_read_by_its_channels(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")  # with it the generator's files are proved to be read
    rng = np.random.default_rng(0)
    wanted = {name: rng.normal(size=(37, 50)).astype(np.float32) for name in ("flow.X", "flow.Y")}
    wanted["weight"] = rng.random((37, 50)).astype(np.float32)
    for compression in (OpenEXR.NO_COMPRESSION, OpenEXR.ZIPS_COMPRESSION, OpenEXR.ZIP_COMPRESSION):
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, dict(wanted)).write(str(tmp_path / "theirs.exr"))
        flow, weight = read_flow(tmp_path / "theirs.exr")
        np.testing.assert_array_equal(flow, np.stack([wanted["flow.X"], wanted["flow.Y"]], -1))
        np.testing.assert_array_equal(weight, wanted["weight"])
    write_flow(tmp_path / "ours.exr", flow, weight, {"unit": "px"})
    theirs = OpenEXR.File(str(tmp_path / "ours.exr"), separate_channels=True)
    for name, values in wanted.items():
        np.testing.assert_array_equal(theirs.channels()[name].pixels, values)
    assert theirs.header()["unit"] == "px"
    OpenEXR.File({"compression": OpenEXR.PIZ_COMPRESSION}, dict(wanted)).write(str(tmp_path / "piz.exr"))
    with pytest.raises(DataFormatError, match="compression 4"):
        read_flow(tmp_path / "piz.exr")
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, {"Z": wanted["weight"]}).write(str(tmp_path / "z.exr"))
    with pytest.raises(DataFormatError, match=r"no channel flow\.X"):
        read_flow(tmp_path / "z.exr")
