"""`gof depth`: maps of single frames against the exact depth of drawn planes, and the score that they make possible."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gof.commands.cli import main
from gof.core.datum import Datum
from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom
from gof.dataset.poses import PoseReport, Poses
from gof.evaluate import Extras, evaluate
from gof.evaluate.depth import read_depth
from gof.ingest import depth as d
from gof.ingest.depth import write_frame_depths
from tests.conftest import write_dataset
from tests.ingest import scene
from tests.moved_dataset import moved_copy

pytestmark = pytest.mark.long

HELD_OUT = 1
NEARER = ((-0.7, -0.3, 0.6), (0.35, 0.2, 0), (0, 0, 0.5), 3)  # where a plane of the scene is in the held-out frame


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A dataset of two frames between which a plane comes 0.7 m nearer, and the true depth of every camera in both."""
    cameras = scene.cameras()
    frames = []
    for plane in (scene.PLANES[2], NEARER):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(scene, "PLANES", [*scene.PLANES[:2], plane, scene.PLANES[3]])
            frames.append([scene.draw(camera) for camera in cameras])
    images = np.array([[picture for picture, _ in views] for views in frames]) / 255
    folder = tmp_path_factory.mktemp("filmed") / "planes"
    moved = np.abs(images[0] - images[1]).max(-1) > 0.1
    masks = np.stack([np.zeros_like(moved), moved])
    write_dataset(folder, cameras, images, images[0], [0.0, 0.01], masks=masks, test_frames=[HELD_OUT])
    return folder, [[z for _, z in views] for views in frames]


@pytest.fixture(scope="module")
def maps(filmed, tmp_path_factory):
    out = tmp_path_factory.mktemp("maps")
    assert main(["depth", str(filmed[0]), "--out", str(out), "--json", str(out / "said.json")]) == 0
    return out


def test_maps_are_those_of_the_frame(filmed, maps):
    _, truth = filmed
    for c, camera in enumerate(scene.cameras()):
        found = read_depth(maps / "depth", camera.name, HELD_OUT)
        there = np.isfinite(truth[HELD_OUT][c])
        error = np.abs(found - truth[HELD_OUT][c])[there] / truth[HELD_OUT][c][there]
        assert np.isfinite(found).all() and np.median(error) < 0.01 and (error < 0.05).mean() > 0.75
        came = there & (truth[0][c] - truth[HELD_OUT][c] > 0.3)  # where the other frame's map would be wrong
        assert came.sum() > 1000
        assert np.median(np.abs(found - truth[HELD_OUT][c])[came]) < 0.05
        disparity = read_depth(maps / "disparity", camera.name, HELD_OUT)
        np.testing.assert_allclose(disparity * found, 1, rtol=1e-5)


def test_every_map_says_its_frame_and_what_is_there_is_kept(filmed, maps):
    folder, _ = filmed
    files = MadeFrom.read(maps).files
    assert files["depth/cam_0/000001.npy"] == (HELD_OUT,) and len(files) == 6
    kept = maps / "depth/cam_0/000001.npy"
    before = kept.stat().st_mtime_ns
    assert write_frame_depths(Dataset.open(folder), [HELD_OUT], maps) is None, "nothing was left to do"
    assert kept.stat().st_mtime_ns == before
    kept.unlink()
    assert 0.3 < write_frame_depths(Dataset.open(folder), [HELD_OUT], maps) <= 1
    assert kept.exists()


def test_maps_of_a_far_world_are_the_same(filmed, maps, tmp_path):
    """Its sparse points, which say how far depth may reach, lie at UTM coordinates as its cameras do."""
    folder, far, shift = tmp_path / "near", tmp_path / "far", (498_000.0, 5_213_000.0, 431.0)
    shutil.copytree(filmed[0], folder)
    seen = np.random.default_rng(0).uniform([-0.6, -0.4, 0], [0.6, 0.4, 1], (50, 3))
    Poses.of(PoseReport("features", "m"), seen).write(folder)
    moved_copy(folder, far, Datum(shift))
    Poses.of(PoseReport("features", "m"), seen + shift).write(far)
    dataset = Dataset.open(far)
    np.testing.assert_allclose(dataset.sparse_points() + dataset.datum.position, seen + shift, atol=1e-4)
    for each in (folder, far):
        write_frame_depths(Dataset.open(each), [HELD_OUT], tmp_path / f"maps_{each.name}")
    near_map, far_map = (read_depth(tmp_path / f"maps_{name}/depth", "cam_0", HELD_OUT) for name in ("near", "far"))
    assert (np.abs(far_map - near_map) < 0.01 * near_map).mean() > 0.99


def test_maps_of_another_dataset_are_not_taken_for_these(filmed, maps, tiny_dataset):
    with pytest.raises(GofError, match=r"other settings \(dataset differ\)"):
        write_frame_depths(Dataset.open(tiny_dataset), [2], maps)


def opaque(camera, depth, picture) -> TransientGaussians:
    """What a camera sees, as opaque moving Gaussians of a pixel's size."""
    points, colors = d.back_project(depth, picture, camera)
    size = camera.to_camera(points)[:, 2] / camera.K[0, 0] / 2
    n = len(points)
    return TransientGaussians(
        position=points,
        velocity=np.zeros((n, 3)),
        t_mu=np.full(n, 0.01),
        t_sigma=np.full(n, np.inf),
        scale=np.repeat(size[:, None], 3, 1),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.99),
        color=colors.astype(float),
        dynamic=np.ones(n, bool),
    )


def test_the_score_of_depth_tells_a_right_surface_from_a_wrong_one(filmed, maps):
    """A result with the true surface, and one that has each picture on a slanted wall: RMSE in metres."""
    folder, truth = filmed
    dataset = Dataset.open(folder)

    alone = _alone(dataset, 1)  # Gaussians that each camera had placed by itself would be in the others' way

    def score(depth: np.ndarray) -> float:
        seen = opaque(alone.cameras[0], depth, dataset.image(1, HELD_OUT))
        return evaluate(seen, alone, extras=Extras(depth=maps / "depth")).rmse_depth

    true = truth[HELD_OUT][1]
    slanted = score(np.where(np.isfinite(true), 2 + np.linspace(0, 1, true.shape[1])[None], np.nan))
    right = score(true)
    assert right < 0.3, "m; a wall stands 2 m behind the plane that moved, and stereo is wrong at its edges"
    assert slanted > 2 * right


def test_maps_are_made_on_demand_as_gof_depth_makes_them(filmed, maps, tmp_path):
    folder, truth = filmed
    dataset = Dataset.open(folder)
    opaque(dataset.cameras[1], truth[HELD_OUT][1], dataset.image(1, HELD_OUT)).save(tmp_path / "r.npz")
    found = {}
    for name, asked in (("made", "make"), ("given", str(maps)), ("plain", str(maps / "depth"))):
        words = ["evaluate", str(tmp_path / "r.npz"), "--dataset", str(folder), "--published", asked]
        assert main([*words, "--out", str(tmp_path / name)]) == 0
        scores = json.loads((tmp_path / name / "scores.json").read_text())
        found[name] = scores["rmse_depth"], scores["published"]["rmse_depth_flame"]
    assert found["made"] == found["given"] and found["made"][0] > 0
    assert found["plain"] == (found["given"][0], None), "camera z alone says nothing of inverse depth"
    assert (tmp_path / "made/depth_maps/depth/cam_1").is_dir()


def _alone(dataset: Dataset, camera: int) -> Dataset:
    """The dataset with one of its cameras."""
    entry = dataset.description.cameras[camera]
    return replace(
        dataset, description=replace(dataset.description, cameras=(entry,)), cameras=[dataset.cameras[camera]]
    )


def test_a_frame_in_which_nothing_matches_is_an_error():
    with pytest.raises(GofError, match="no pixel has stereo depth"):
        d.complete(np.full((32, 24), np.nan), np.zeros((32, 24, 3), np.uint8))


def test_what_cannot_be_done_is_said(filmed, tmp_path, capsys):
    cameras = scene.cameras()[:1]
    one = np.full((2, 1, 320, 240, 3), 0.5)
    write_dataset(tmp_path / "one", cameras, one, one[0], [0.0, 0.01])
    assert main(["depth", str(tmp_path / "one"), "--out", str(tmp_path / "o")]) == 1
    assert "no frame is held out; give --all-frames" in capsys.readouterr().err
    assert main(["depth", str(tmp_path / "one"), "--out", str(tmp_path / "o"), "--all-frames"]) == 1
    assert "one camera has no stereo" in capsys.readouterr().err
    assert main(["depth", str(filmed[0]), "--out", str(tmp_path / "o"), "--weights", str(tmp_path)]) == 1
    assert "no config.json" in capsys.readouterr().err


def network(folder, seed: int):
    """A small Depth-Anything-V2 with random weights, in the files that its own library writes."""
    transformers = pytest.importorskip("transformers", reason="monocular depth needs transformers")
    torch = pytest.importorskip("torch")
    torch.manual_seed(seed)
    backbone = transformers.Dinov2Config(
        hidden_size=32,
        num_hidden_layers=4,
        num_attention_heads=2,
        image_size=56,
        patch_size=14,
        out_features=["stage1", "stage2", "stage3", "stage4"],
        reshape_hidden_states=False,
    )
    config = transformers.DepthAnythingConfig(
        backbone_config=backbone,
        reassemble_hidden_size=32,
        neck_hidden_sizes=[8, 16, 32, 32],
        fusion_hidden_size=16,
        head_hidden_size=8,
    )
    transformers.DepthAnythingForDepthEstimation(config).save_pretrained(folder)
    size = {"height": 56, "width": 56}
    transformers.DPTImageProcessor(size=size, ensure_multiple_of=14, keep_aspect_ratio=True).save_pretrained(folder)
    return folder


def test_the_networks_map_is_in_metres_by_stereo(filmed, tmp_path):
    """Through the real library: what the network says is kept as it is; in metres it is a line of it in 1/m."""
    picture = np.uint8(255 * Dataset.open(filmed[0]).image(0, HELD_OUT))
    stereo = np.where(np.random.default_rng(0).random(picture.shape[:2]) < 0.3, filmed[1][HELD_OUT][0], np.nan)
    found = None
    for seed in range(12):  # a network that has learnt nothing may say the opposite of near: that is refused
        try:
            weights = network(tmp_path / str(seed), seed)
            relative = d.monocular(picture, weights)
            found = d._by_network(stereo, picture, weights)
            break
        except GofError as e:
            assert "falls where stereo says nearer" in str(e) or "constant" in str(e)
    assert found is not None
    np.testing.assert_array_equal(found.disparity, np.maximum(relative, 0))
    assert relative.shape == picture.shape[:2] and np.ptp(relative) > 0
    free = found.depth < 1.9 * np.nanmax(stereo)
    line = np.polyfit(found.disparity[free], 1 / found.depth[free].astype(float), 1)
    np.testing.assert_allclose(np.polyval(line, found.disparity[free]), 1 / found.depth[free], rtol=1e-3)
    known = np.isfinite(stereo)
    assert abs(np.median(1 / found.depth[known]) - np.median(1 / stereo[known])) < 0.5 * np.median(1 / stereo[known])
