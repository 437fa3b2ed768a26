"""PSNR and SSIM by hand, and against the implementations others use."""

import numpy as np
import pytest

from gof.core.errors import GofError, NonFiniteError
from gof.evaluate.image import C1, psnr, ssim, ssim_map


def pair(h=40, w=52, noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(size=(h, w, 3))
    return np.clip(truth + rng.normal(size=truth.shape) * noise, 0, 1), truth


def test_psnr_by_hand():
    truth = np.zeros((4, 5, 3))
    assert psnr(truth + 0.1, truth) == pytest.approx(20)
    assert psnr(truth, truth) == 100.0, "a perfect picture counts in a mean"
    half = truth.copy()
    half[:2] = 0.1
    mask = np.zeros((4, 5))
    mask[:2] = 1
    assert psnr(half, truth, mask) == pytest.approx(20) and psnr(half, truth) == pytest.approx(20 + 10 * np.log10(2))
    assert psnr(half, truth, 0 * mask) is None and ssim(half, truth, 0 * mask) is None


def test_ssim_by_hand():
    image, truth = pair()
    assert ssim(truth, truth) == pytest.approx(1, abs=1e-12)
    a, b = np.full((30, 30, 1), 0.5), np.full((30, 30, 1), 0.25)  # flat: variances vanish, only luminance is left
    assert ssim_map(a, b)[15, 15, 0] == pytest.approx((2 * 0.5 * 0.25 + C1) / (0.25 + 0.0625 + C1))
    assert ssim(image, truth) == pytest.approx(ssim(truth, image))
    assert np.isfinite(ssim_map(np.zeros((20, 20, 3)), np.zeros((20, 20, 3)))).all()


def test_masked_ssim_looks_at_the_mask_only():
    image, truth = pair(noise=0)
    image = image.copy()
    image[:, :20] = 0
    mask = np.zeros(image.shape[:2])
    mask[:, 30:] = 1  # farther than a window's reach from the damage
    assert ssim(image, truth, mask) == pytest.approx(1, abs=1e-12) and ssim(image, truth, 1 - mask) < 0.6


def test_masks_are_weights():
    image, truth = pair()
    rng = np.random.default_rng(1)
    mask = rng.uniform(size=image.shape[:2])
    mse = (mask[..., None] * (image - truth) ** 2).sum() / (3 * mask.sum())
    assert psnr(image, truth, mask) == pytest.approx(-10 * np.log10(mse))


def test_bad_input_is_named():
    image, truth = pair()
    with pytest.raises(GofError, match="shapes"):
        psnr(image[:-1], truth)
    with pytest.raises(GofError, match="mask"):
        psnr(image, truth, np.ones((3, 3)))
    image[3, 3, 0] = np.nan
    with pytest.raises(NonFiniteError, match="image"):
        ssim(image, truth)


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.3])
@pytest.mark.long
def test_against_torchmetrics_and_pytorch_msssim(noise):
    torch = pytest.importorskip("torch")
    metrics = pytest.importorskip("torchmetrics.functional.image", reason="torchmetrics is not installed")
    msssim = pytest.importorskip("pytorch_msssim", reason="pytorch-msssim is not installed")
    image, truth = pair(noise=noise, seed=3)
    image[10:20, 10:20] *= 0.5
    a, b = (torch.from_numpy(np.moveaxis(x, -1, 0)[None]) for x in (image, truth))
    assert psnr(image, truth) == pytest.approx(float(metrics.peak_signal_noise_ratio(a, b, data_range=1.0)), abs=1e-5)
    ours = ssim_map(image, truth)[
        5:-5, 5:-5
    ].mean()  # they differ at the border: complete windows, or mirrored pictures
    _, theirs = metrics.structural_similarity_index_measure(a, b, data_range=1.0, return_full_image=True)
    assert ours == pytest.approx(float(theirs[..., 5:-5, 5:-5].mean()), abs=1e-6)
    assert ours == pytest.approx(float(msssim.ssim(a, b, data_range=1.0)), abs=1e-6)
