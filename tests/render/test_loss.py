"""The fused L1 + SSIM loss against its numpy float64 twin and scikit-free first principles."""

import numpy as np
import pytest

from gof.core.errors import DataFormatError

dr = pytest.importorskip("drjit")

from gof.render import Target, l1_ssim, reference  # noqa: E402
from gof.render.backend import floats  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")


def pair(shape, seed=0):
    r = np.random.default_rng(seed)
    x = r.random(shape)
    y = np.clip(x + 0.2 * r.normal(size=shape), 0, 1)
    return x.astype(np.float32).astype(float), y.astype(np.float32).astype(float)


def planes(x):
    return [floats(x[..., k]) for k in range(x.shape[2])]


@pytest.mark.parametrize("square", [0.0, 4.0])
@pytest.mark.parametrize(
    "shape, masked",
    [((20, 23, 3), False), ((16, 32, 3), True), ((1, 1, 1), False), ((13, 5, 8), True), ((70, 9, 2), False)],
)
def test_value_and_gradient_equal_twin(shape, masked, square):
    x, y = pair(shape)
    mask = np.random.default_rng(1).random(shape[:2]) if masked else None
    p = planes(x)
    dr.enable_grad(p)
    loss = l1_ssim(p, Target(y, mask), 0.2, square)
    dr.backward(3 * loss)
    assert abs(loss[0] - reference.l1_ssim(x, y, 0.2, mask, square)) < 1e-6
    got = np.stack([np.broadcast_to(dr.grad(c).numpy(), shape[0] * shape[1]).reshape(shape[:2]) for c in p], -1)
    r = np.random.default_rng(2)
    for _ in range(25):
        pick = tuple(r.integers(0, n) for n in shape)
        ends = []
        for sign in (1, -1):
            moved = x.copy()
            moved[pick] += sign * 1e-6
            ends.append(reference.l1_ssim(moved, y, 0.2, mask, square))
        assert abs(got[pick] - 3 * (ends[0] - ends[1]) / 2e-6) < 1e-5 * np.abs(got).max()


def test_equal_images_cost_nothing_and_pull_nowhere():
    x, _ = pair((30, 30, 3))
    p = planes(x)
    dr.enable_grad(p)
    loss = l1_ssim(p, x)
    dr.backward(loss)
    assert abs(loss[0]) < 1e-6
    assert all(np.abs(dr.grad(c).numpy()).max() < 1e-7 for c in p)


def test_constant_images_have_finite_gradient():
    p = planes(np.zeros((12, 12, 3)))
    dr.enable_grad(p)
    dr.backward(l1_ssim(p, np.zeros((12, 12, 3))))
    assert all(np.isfinite(dr.grad(c).numpy()).all() for c in p)


def test_weights_of_the_parts():
    x, y = pair((15, 18, 3))
    assert abs(l1_ssim(planes(x), y, 0.0, 2.0)[0] - (np.abs(x - y).mean() + 2 * ((x - y) ** 2).mean())) < 1e-6
    assert abs(l1_ssim(planes(x), y, 0.0)[0] - np.abs(x - y).mean()) < 1e-6
    both = [l1_ssim(planes(x), y, w)[0] for w in (0.0, 0.3, 1.0)]
    assert abs(both[1] - (0.7 * both[0] + 0.3 * both[2])) < 1e-6


def test_errors_name_what_disagrees():
    x, y = pair((8, 9, 3))
    with pytest.raises(DataFormatError, match="2 channels"):
        l1_ssim(planes(x)[:2], y)
    with pytest.raises(DataFormatError, match="mask"):
        Target(y, np.zeros((8, 9)))


def together(x):
    """Return the planes of (K, H, W, D) pictures."""
    return [floats(x[..., c]) for c in range(x.shape[-1])]


def value_and_gradient(x, target, **weights):
    """Return the loss, and its gradient in the shape of x: one picture (H, W, D) or several (K, H, W, D)."""
    p = together(x)
    dr.enable_grad(p)
    loss = l1_ssim(p, target, **weights)
    dr.backward(loss)
    return loss[0], np.stack([dr.grad(c).numpy().reshape(x.shape[:-1]) for c in p], -1)


# With two threads the native kernels split a picture of the second size and none of the others.
SEVERAL = [(3, 13, 21, 3), (3, 40, 21, 1), (4, 3, 2, 2), (2, 1, 1, 1)]


@pytest.mark.parametrize("shape", SEVERAL)
def test_several_pictures_cost_their_mean(shape):
    x, y = pair(shape)
    value, gradient = value_and_gradient(x, Target(y), square_weight=0.5)
    want = np.mean([reference.l1_ssim(a, b, square_weight=0.5) for a, b in zip(x, y, strict=True)])
    assert abs(value - want) < 1e-6
    alone = [value_and_gradient(a, Target(b), square_weight=0.5)[1] for a, b in zip(x, y, strict=True)]
    assert np.abs(gradient - np.stack(alone) / len(x)).max() < 1e-6 * np.abs(gradient).max()


@pytest.mark.parametrize("shape", SEVERAL)
def test_several_pictures_share_the_sum_of_their_masks(shape):
    x, y = pair(shape)
    mask = np.random.default_rng(1).random(shape[:3])
    mask[1] *= 5
    mask[0] = 0
    value, gradient = value_and_gradient(x, Target(y, mask), square_weight=0.5)
    share = mask.sum((1, 2)) / mask.sum()
    want = [reference.l1_ssim(a, b, mask=m, square_weight=0.5) for a, b, m in zip(x, y, mask, strict=True)]
    assert abs(value - share @ want) < 1e-6
    assert not gradient[0].any()
    for k in range(1, len(x)):
        alone = value_and_gradient(x[k], Target(y[k], mask[k]), square_weight=0.5)[1]
        assert np.abs(gradient[k] - share[k] * alone).max() < 1e-6 * np.abs(gradient).max()


@pytest.mark.parametrize("shape", SEVERAL[:2])
def test_a_picture_has_no_part_in_its_neighbours(shape):
    x, y = pair(shape)
    before = value_and_gradient(x, Target(y))[1]
    x[1], y[1] = 1 - x[1], 0.5 * y[1]
    after = value_and_gradient(x, Target(y))[1]
    assert (before[1] != after[1]).any()
    assert (before[[0, 2]] == after[[0, 2]]).all()


@pytest.mark.parametrize("masked", [False, True])
def test_one_of_several_is_one(masked):
    x, y = pair((13, 21, 3))
    mask = np.random.default_rng(1).random((13, 21)) if masked else None
    value, gradient = value_and_gradient(x, Target(y, mask))
    again = value_and_gradient(x[None], Target(y[None], mask[None] if masked else None))
    assert value == again[0]
    assert (gradient == again[1][0]).all()
    assert value_and_gradient(x[None], y[None])[0] == value_and_gradient(x, y)[0]


@pytest.mark.parametrize(
    "pictures, channels, threads, parts_of_a_picture",
    [(1, 3, 1, 1), (1, 3, 2, 2), (1, 8, 2, 2), (3, 3, 2, 1), (3, 3, 4, 1), (3, 3, 8, 2), (3, 1, 8, 6)],
)
def test_parts_of_the_work_change_nothing(kernels, monkeypatch, pictures, channels, threads, parts_of_a_picture):
    if kernels != "native":
        pytest.skip("Dr.Jit divides the work itself")
    from gof.render.native import loss

    x, y = pair((pictures, 50, 21, channels))
    target = Target(y)
    monkeypatch.setattr(loss, "thread_count", lambda: 1)
    value, gradient = value_and_gradient(x, target)
    monkeypatch.setattr(loss, "thread_count", lambda: threads)
    assert len(target.moments.parts()) == pictures * channels * parts_of_a_picture
    again = value_and_gradient(x, target)
    assert value == again[0]
    assert (gradient == again[1]).all()


@pytest.mark.parametrize("first, second", [(2, 3), (3, 2)])
def test_targets_of_other_numbers_of_pictures_share_no_weight(first, second):
    """Weights of unmasked targets are kept by size."""
    for n in (first, second):
        x, y = pair((n, 6, 7, 2))
        want = np.mean([reference.l1_ssim(a, b) for a, b in zip(x, y, strict=True)])
        assert abs(value_and_gradient(x, Target(y))[0] - want) < 1e-6


def test_errors_name_the_shapes_of_several():
    x, y = pair((3, 8, 9, 2))
    with pytest.raises(DataFormatError, match="2 channels of 72 pixels; target is 3 pictures of 9x8 with 2 channels"):
        l1_ssim(together(x[0]), y)
    with pytest.raises(DataFormatError, match="2 channels of 216 pixels; target is 9x8 with 2 channels"):
        l1_ssim(together(x), y[0])
    with pytest.raises(DataFormatError, match=r"mask has shape \(8, 9\) .* expected \(3, 8, 9\)"):
        Target(y, np.ones((8, 9)))
    with pytest.raises(DataFormatError, match=r"mask has shape \(3, 8, 9\) .* expected \(8, 9\)"):
        Target(y[0], np.ones((3, 8, 9)))
    for shape in ((8, 9), (1, 3, 8, 9, 2), (0, 8, 9, 2)):
        with pytest.raises(DataFormatError, match=r"expected \(H, W, D\) or \(K, H, W, D\)"):
            Target(np.zeros(shape))
