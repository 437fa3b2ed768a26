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
