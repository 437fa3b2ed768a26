"""Depth, change between frames, FLIP and LPIPS."""

import sys
import types
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError, MissingDependencyError, NonFiniteError
from gof.dataset import Dataset
from gof.evaluate import Extras, evaluate
from gof.evaluate.depth import read_depth, rmse_depth
from gof.evaluate.image import TRUNK, flip, lpips, temporal_l2
from tests.evaluate.synthetic_flame import flame_dataset


def test_depth_up_to_a_linear_map():
    rng = np.random.default_rng(0)
    truth, noise = rng.uniform(2, 5, (20, 30)), 0.1 * rng.normal(size=(20, 30))
    got = rmse_depth((truth - 7) / -3, truth)  # an inverse depth, even
    assert got.rmse == pytest.approx(0, abs=1e-9) and (got.scale, got.shift) == (pytest.approx(-3), pytest.approx(7))
    depth = truth + noise
    A = np.stack([depth.ravel(), np.ones(depth.size)], 1)
    x, *_ = np.linalg.lstsq(A, truth.ravel(), rcond=None)
    got = rmse_depth(depth, truth)
    assert got.rmse == pytest.approx(np.sqrt(np.mean((A @ x - truth.ravel()) ** 2)), rel=1e-9)
    assert rmse_depth(np.full_like(truth, 4), truth).rmse == pytest.approx(truth.std())
    half = (np.arange(30) < 15) * np.ones((20, 1))
    broken = np.where(half > 0, truth, np.nan)
    assert rmse_depth(broken, truth, half).rmse == pytest.approx(0, abs=1e-9)
    assert rmse_depth(depth, truth, 0 * half) is None
    with pytest.raises(NonFiniteError, match="depth"):
        rmse_depth(broken, truth)
    with pytest.raises(GofError, match="shapes"):
        rmse_depth(depth[1:], truth)


def test_change_between_frames():
    rng = np.random.default_rng(1)
    a, b = rng.random((2, 16, 16, 3))
    assert temporal_l2((a, b), (a, b)) == 0
    assert temporal_l2((0.5 * a, 0.5 * a), (a, b)) == pytest.approx(1)  # frozen
    assert temporal_l2((a + 0.3, b + 0.3), (a, b)) == pytest.approx(
        0, abs=1e-12
    )  # a wrong but steady brightness is no flicker
    assert temporal_l2((b, a), (a, b)) == pytest.approx(2)  # backwards
    assert temporal_l2((a, b), (a, a)) is None
    mask = np.zeros((16, 16))
    mask[:8] = 1
    changed = b.copy()
    changed[8:] = 0
    assert temporal_l2((a, changed), (a, b), mask) == 0


def test_flip_or_its_absence():
    pytest_image = np.random.default_rng(2).random((40, 50, 3))
    try:
        import flip_evaluator
    except ImportError:
        with pytest.raises(MissingDependencyError, match=r"flip_evaluator: .*gaussians-on-fire\[scores\]"):
            flip(pytest_image, pytest_image)
        return
    truth = np.random.default_rng(3).random((40, 50, 3))
    _, theirs, _ = flip_evaluator.evaluate(truth.astype(np.float32), pytest_image.astype(np.float32), "LDR")
    assert flip(pytest_image, truth) == pytest.approx(theirs, abs=1e-4) and flip(truth, truth) == pytest.approx(
        0, abs=1e-6
    )
    left = np.zeros((40, 50))
    left[:, :25] = 1
    both = (flip(pytest_image, truth, left) + flip(pytest_image, truth, 1 - left)) / 2
    assert both == pytest.approx(theirs, abs=1e-4)


def alexnet():
    """The convolutional part of AlexNet by torch.nn modules, in torchvision's order."""
    from torch import nn

    return nn.Sequential(
        nn.Conv2d(3, 64, 11, 4, 2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(64, 192, 5, padding=2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(192, 384, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(384, 256, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(256, 256, 3, padding=1),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
    )


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with AlexNet's file: the names and shapes of the published one, and random values.

    torchvision, which has AlexNet's layers, is stood in for where it does not load beside this PyTorch's build.
    """
    torch = pytest.importorskip("torch")
    theirs = pytest.importorskip("torchmetrics.functional.image.lpips")
    folder, generator = tmp_path_factory.mktemp("weights"), torch.Generator().manual_seed(0)
    state = {f"features.{name}": torch.zeros_like(value) for name, value in alexnet().state_dict().items()}
    for name, value in state.items():
        spread = value[0].numel() ** -0.5 if value.ndim > 1 else 1
        state[name] = torch.randn(value.shape, generator=generator) * spread
    torch.save(state | {"classifier.6.bias": torch.zeros(1000)}, folder / TRUNK)
    with pytest.MonkeyPatch.context() as patched:
        try:
            import torchvision  # noqa: F401
        except (ImportError, RuntimeError):
            patched.setitem(sys.modules, "torchvision", types.ModuleType("torchvision"))
            patched.setattr(theirs, "_get_tv_model_features", lambda net, pretrained: alexnet())
        yield folder


def test_lpips_is_the_published_definition_on_the_file_that_was_given(weights):
    """Written out: features of both pictures, of unit length at every pixel, squared differences, weighted by the heads
    that torchmetrics ships."""
    torch, theirs = pytest.importorskip("torch"), pytest.importorskip("torchmetrics.functional.image.lpips")
    features = alexnet()
    state = torch.load(weights / TRUNK)
    features.load_state_dict({k.removeprefix("features."): v for k, v in state.items() if k.startswith("features")})
    heads = torch.load(Path(theirs.__file__).parent / "lpips_models" / "alex.pth", "cpu", weights_only=True)
    rng = np.random.default_rng(4)
    a, b = rng.random((2, 64, 70, 3))

    def layers(image):
        x = torch.tensor(2 * image - 1, dtype=torch.float32).permute(2, 0, 1)[None]
        x = (x - torch.tensor([-0.030, -0.088, -0.188])[:, None, None]) / torch.tensor([0.458, 0.448, 0.450])[
            :, None, None
        ]
        found = []
        for k, module in enumerate(features):
            x = module(x)
            if k in (1, 4, 7, 9, 11):
                found.append(x / (x.norm(dim=1, keepdim=True) + 1e-10))
        return found

    with torch.no_grad():
        expected = sum(
            float((heads[f"lin{i}.model.1.weight"][0] * (p - q) ** 2).sum(1).mean())
            for i, (p, q) in enumerate(zip(layers(a), layers(b), strict=True))
        )
    assert expected > 0.01
    assert lpips(a, b, weights) == pytest.approx(expected, rel=1e-4) and lpips(a, a, weights) == 0
    with pytest.raises(DataFormatError, match="32 px"):
        lpips(a[:20], b[:20], weights)


def test_absent_and_wrong_weights_are_named(weights, tmp_path):
    torch = pytest.importorskip("torch")
    image = np.zeros((40, 40, 3))
    with pytest.raises(MissingDependencyError, match=f"{TRUNK} is absent.*downloads nothing"):
        lpips(image, image, tmp_path)
    state = torch.load(weights / TRUNK)
    for number, wrong in enumerate(
        (
            {"features.0.weight": torch.zeros(1)},
            state | {"features.3.weight": torch.zeros(2, 2)},
            {name: value for name, value in state.items() if name != "features.10.bias"},
        )
    ):
        (tmp_path / str(number)).mkdir()
        torch.save(wrong, tmp_path / str(number) / TRUNK)
        with pytest.raises(DataFormatError, match=f"{number}.{TRUNK}: not the weights of torchvision's AlexNet"):
            lpips(image, image, tmp_path / str(number))


@pytest.mark.long
def test_all_of_them_in_evaluate(tmp_path, weights):
    truth = flame_dataset(tmp_path / "data")
    dataset = Dataset.open(tmp_path / "data")
    from gof.render import render

    for c in dataset.cameras:
        (tmp_path / "depth" / c.name).mkdir(parents=True)
        for k in dataset.test_frames:
            np.save(
                tmp_path / "depth" / c.name / f"{k:06d}.npy",
                2 * render(truth, c, float(dataset.times_s[k]))["depth"] + 1,
            )
    scores = evaluate(truth, dataset, extras=Extras(weights, tmp_path / "depth"))
    assert scores.rmse_depth < 1e-4 and scores.lpips < scores.lpips_plate / 5
    assert scores.temporal_l2 < 0.1 and scores.temporal_l2_plate == 1
    still = type(truth)(
        **{n: getattr(truth, n) for n in truth.__dataclass_fields__}
        | {"velocity": 0 * truth.velocity, "t_sigma": np.full(len(truth), np.inf)}
    )
    frozen = evaluate(still, dataset)
    assert frozen.temporal_l2 == pytest.approx(1, abs=1e-3) and any("LPIPS" in a for a in frozen.images.absent)
    (tmp_path / "depth" / dataset.cameras[0].name / "000004.npy").unlink()
    with pytest.raises(DataFormatError, match=r"000004\.npy"):
        read_depth(tmp_path / "depth", dataset.cameras[0].name, 4)
