"""CGVQM against its definition written with torch.nn modules; files in the real layout, with random values."""

import os
import pickle
from itertools import pairwise

import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError, MissingDependencyError, NonFiniteError
from gof.evaluate.video import CHANNELS, HEADS, TRUNK, VideoQuality, available, clip_length, trunk_shapes

pytestmark = pytest.mark.long

torch = pytest.importorskip("torch")
nn = torch.nn


def cgvqm(frames, pair, clip, weights, name="cgvqm_2"):
    """Quality of a video whose frame k and its truth are pair(k)."""
    video = VideoQuality([name], clip, weights)
    for k in range(frames):
        video.add(*pair(k))
    return video.scores()[name]


def convolution(before, after, kernel, stride, padding, *rest):
    return nn.Sequential(nn.Conv3d(before, after, kernel, stride, padding, bias=False), nn.BatchNorm3d(after), *rest)


class Block(nn.Module):
    def __init__(self, before, after, stride):
        super().__init__()
        self.conv1, self.conv2 = convolution(before, after, 3, stride, 1, nn.ReLU()), convolution(after, after, 3, 1, 1)
        self.downsample = convolution(before, after, 1, stride, 0) if stride > 1 else None

    def forward(self, x):
        return torch.relu(self.conv2(self.conv1(x)) + (x if self.downsample is None else self.downsample(x)))


class Network(nn.Module):
    """R3D-18 as published, with torchvision's names."""

    def __init__(self):
        super().__init__()
        self.stem = convolution(3, 64, (3, 7, 7), (1, 2, 2), (1, 3, 3), nn.ReLU())
        for level, (before, after) in enumerate(pairwise(CHANNELS[1:]), 1):
            setattr(
                self,
                f"layer{level}",
                nn.Sequential(Block(before, after, 2 if level > 1 else 1), Block(after, after, 1)),
            )
        self.fc = nn.Linear(512, 400)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    torch.manual_seed(0)
    folder, network = tmp_path_factory.mktemp("cgvqm"), Network().eval()
    for module in network.modules():
        if isinstance(module, nn.BatchNorm3d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 2)
            module.weight.data.uniform_(0.5, 1.5)
            module.bias.data.normal_(0, 0.1)
    torch.save(network.state_dict(), folder / TRUNK)
    for name, levels in HEADS.values():
        (folder / name).write_bytes(pickle.dumps((torch.randn(1, sum(CHANNELS[:levels]), 1, 1, 1), torch.tensor(7.0))))
    return folder, network


def by_definition(network, head, levels, video, truth, clip, patch):
    """Clip by clip and patch by patch, as the paper's feature distance."""
    weight, gain = head
    split = torch.split(weight.abs(), CHANNELS[:levels], 1)
    x, y = (
        torch.tensor(np.ascontiguousarray(np.moveaxis(v, -1, 0)), dtype=torch.float32)[None] for v in (video, truth)
    )
    mean, std = (
        torch.tensor([0.43216, 0.394666, 0.37645]).view(1, 3, 1, 1, 1),
        torch.tensor([0.22803, 0.22145, 0.216989]).view(1, 3, 1, 1, 1),
    )
    errors = []
    for t in range(0, x.shape[2], clip):
        for h in range(0, x.shape[3], patch[0]):
            for w in range(0, x.shape[4], patch[1]):
                a, b = (((v - mean) / std)[:, :, t : t + clip, h : h + patch[0], w : w + patch[1]] for v in (x, y))
                error = (split[0] * ((a - b) ** 2).mean((2, 3, 4), keepdim=True)).sum()
                for level, stage in enumerate(
                    [network.stem, network.layer1, network.layer2, network.layer3, network.layer4][: levels - 1], 1
                ):
                    a, b = stage(a), stage(b)
                    difference = nn.functional.normalize(a, dim=1, eps=1e-10) - nn.functional.normalize(
                        b, dim=1, eps=1e-10
                    )
                    error = error + (split[level] * (difference**2).mean((2, 3, 4), keepdim=True)).sum()
                errors.append(float(gain * error))
    return 100 - np.mean(errors)


@pytest.mark.parametrize("name", list(HEADS))
def test_against_the_network_built_from_modules(model, name):
    folder, network = model
    file, levels = HEADS[name]
    rng = np.random.default_rng(0)
    truth = rng.random((6, 32, 24, 3))
    video = np.clip(truth + 0.2 * rng.normal(size=truth.shape), 0, 1)
    head = pickle.loads((folder / file).read_bytes())
    with torch.no_grad():
        expected = by_definition(network, head, levels, video, truth, 3, (8, 6))
    got = cgvqm(6, lambda k: (video[k], truth[k]), 3, folder, name)
    assert got == pytest.approx(expected, rel=1e-4) and got < 100
    assert cgvqm(6, lambda k: (truth[k], truth[k]), 3, folder, name) == 100


def test_all_heads_in_one_pass_as_each_alone(model):
    folder, _ = model
    rng = np.random.default_rng(2)
    video, truth = rng.random((2, 5, 16, 16, 3))
    together = VideoQuality(list(HEADS), 2, folder)
    for image, true in zip(video, truth, strict=True):
        together.add(image, true)
    alone = {name: cgvqm(5, lambda k: (video[k], truth[k]), 2, folder, name) for name in HEADS}
    assert together.scores() == pytest.approx(alone, rel=1e-6) and alone["cgvqm_2"] != alone["cgvqm_5"]


def test_every_frame_is_drawn_once_for_all_scores(model, tmp_path, monkeypatch):
    """Held-out pictures, the change to the next frame and two CGVQMs look at the same drawings."""
    from gof import render
    from gof.dataset import Dataset
    from gof.evaluate import Extras, evaluate
    from tests.evaluate.synthetic_flame import flame_dataset

    truth = flame_dataset(tmp_path / "data", velocity=False)
    dataset, draw, drawn = Dataset.open(tmp_path / "data"), render.render, []
    monkeypatch.setattr(render, "render", lambda g, c, t, **k: drawn.append((c.name, t)) or draw(g, c, t, **k))
    scores = evaluate(truth, dataset, extras=Extras(model[0]))
    assert scores.cgvqm_2 is not None and scores.cgvqm_5 is not None and scores.temporal_l2 is not None
    assert sorted(drawn) == sorted((c.name, t) for c in dataset.cameras for t in dataset.times_s.tolist())


def test_sizes_that_do_not_divide_are_padded_with_the_last_value(model):
    """9 frames in clips of 4, 18 x 11 px in patches of 4 x 2: as if the last frame, row and column were repeated."""
    folder, network = model
    rng = np.random.default_rng(1)
    video, truth = rng.random((2, 9, 18, 11, 3))
    grown = [np.pad(v, ((0, 3), (0, 2), (0, 1), (0, 0)), mode="edge") for v in (video, truth)]
    with torch.no_grad():
        expected = by_definition(network, pickle.loads((folder / "cgvqm-2.pickle").read_bytes()), 3, *grown, 4, (4, 2))
    assert cgvqm(9, lambda k: (video[k], truth[k]), 4, folder) == pytest.approx(expected, rel=1e-5)


def test_it_sees_time(model):
    """What scores of single frames cannot tell apart: the same error in every frame, steady or of alternating sign."""
    folder, _ = model
    truth = np.full((8, 32, 32, 3), 0.5)
    pattern = 0.1 * np.sign(np.random.default_rng(3).normal(size=(32, 32, 3)))
    steady, flicker = (cgvqm(8, lambda k, s=s: (truth[k] + s**k * pattern, truth[k]), 8, folder) for s in (1, -1))
    assert abs(steady - flicker) > 5e-3


def test_clips_last_a_second():
    assert [clip_length(t) for t in (0.04, 0.01, 0.5, 3.0, 0.0)] == [25, 30, 2, 1, 30]


class Attack:
    def __reduce__(self):
        return os.mkdir, ("attacked",)


def test_nothing_in_a_head_is_executed(model, tmp_path, monkeypatch):
    folder, _ = model
    monkeypatch.chdir(tmp_path)
    os.link(folder / TRUNK, tmp_path / TRUNK)
    picture = np.zeros((16, 16, 3))
    for content, reason in (
        (pickle.dumps(Attack()), "no tensor"),
        (b"", "not the two tensors"),
        (pickle.dumps((torch.ones(5), torch.tensor(1.0))), "131"),
        (pickle.dumps((torch.full((131,), np.nan), torch.tensor(1.0))), "finite"),
    ):
        (tmp_path / "cgvqm-2.pickle").write_bytes(content)
        with pytest.raises(DataFormatError, match=reason):
            cgvqm(1, lambda k: (picture, picture), 1, tmp_path)
        from gof.evaluate import video

        video._head.cache_clear()
    assert not (tmp_path / "attacked").exists()


def test_absent_or_wrong_files_and_bad_pictures_are_named(model, tmp_path):
    folder, _ = model
    with pytest.raises(MissingDependencyError, match=TRUNK):
        available(tmp_path)
    assert available(folder) == ["cgvqm_2", "cgvqm_5"] and trunk_shapes()["layer2.0.downsample.0.weight"] == (
        128,
        64,
        1,
        1,
        1,
    )
    (tmp_path / "cgvqm-2.pickle").write_bytes((folder / "cgvqm-2.pickle").read_bytes())
    torch.save({"stem.0.weight": torch.zeros(1)}, tmp_path / TRUNK)
    with pytest.raises(DataFormatError, match="r3d_18"):
        cgvqm(1, lambda k: (np.zeros((8, 8, 3)),) * 2, 1, tmp_path)
    with pytest.raises(GofError, match="shapes"):
        cgvqm(1, lambda k: (np.zeros((8, 8, 3)), np.zeros((8, 9, 3))), 1, folder)
    with pytest.raises(NonFiniteError, match="image"):
        cgvqm(1, lambda k: (np.full((8, 8, 3), np.nan), np.zeros((8, 8, 3))), 1, folder)
    with pytest.raises(DataFormatError, match="4 x 4"):
        cgvqm(1, lambda k: (np.zeros((3, 8, 3)),) * 2, 1, folder)


def test_in_evaluate_with_the_board_faded_out(model, tmp_path):
    """The whole clip of every camera; noise on the sync board alone costs nothing."""
    import json

    import cv2

    from gof.dataset import Dataset
    from gof.evaluate import Extras, evaluate
    from tests.evaluate.synthetic_flame import flame_dataset

    folder, _ = model
    truth = flame_dataset(tmp_path / "data", velocity=False)
    (tmp_path / "weights").mkdir()
    for name in (TRUNK, "cgvqm-2.pickle"):
        os.link(folder / name, tmp_path / "weights" / name)
    extras = Extras(tmp_path / "weights")
    clean = evaluate(truth, Dataset.open(tmp_path / "data"), extras=extras)
    assert clean.cgvqm_2 > 95 and clean.cgvqm_5 is None and clean.costs["video"] > 0
    assert any(TRUNK not in reason and "LPIPS" in reason for reason in clean.images.absent)
    meta = json.loads((tmp_path / "data/dataset.json").read_text())
    for camera in meta["cameras"]:
        camera["board_mask"] = f"cameras/{camera['name']}/board_mask.png"
        cv2.imwrite(
            str(tmp_path / "data" / camera["board_mask"]), np.pad(np.full((20, 48), 255, np.uint8), ((60, 0), (0, 0)))
        )
        for k in range(9):
            path = str(tmp_path / "data" / camera["rgb"].format(frame=k))
            picture = cv2.imread(path)
            picture[60:] = np.random.default_rng(k).integers(0, 255, (20, 48, 3))
            cv2.imwrite(path, picture)
    noisy = evaluate(truth, Dataset.open(tmp_path / "data"), extras=extras)
    (tmp_path / "data/dataset.json").write_text(json.dumps(meta))
    masked = evaluate(truth, Dataset.open(tmp_path / "data"), extras=extras)
    assert noisy.cgvqm_2 < 95 < masked.cgvqm_2
