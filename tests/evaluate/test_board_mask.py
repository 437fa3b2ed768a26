"""The sync board's pixels do not count in scores of pictures, softly at its edge: closed forms through `evaluate`."""

import json

import cv2
import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.image import ssim_map
from tests.conftest import arc, random_gaussians, write_dataset

PLATE, ERROR = 64 / 255, 51 / 255


@pytest.fixture
def board(tmp_path):
    """A grey wall; a board (rows 40 on, columns 10 to 19, a soft row above) shines ERROR brighter in even frames."""
    cameras = arc(2)
    pictures = np.full((5, 2, 64, 36, 3), PLATE)
    pictures[::2, :, 39:, 10:20] += ERROR
    masks = np.zeros((5, 2, 64, 36), bool)
    masks[:, :, 30:, 15:] = True
    folder = write_dataset(
        tmp_path / "data",
        cameras,
        pictures,
        np.full((2, 64, 36, 3), PLATE),
        0.01 * np.arange(5),
        masks=masks,
        test_frames=[2],
    )
    covered = np.zeros((64, 36), np.uint8)
    covered[40:, 10:20], covered[39, 10:20] = 255, 102
    meta = json.loads((folder / "dataset.json").read_text())
    meta["cameras"][0]["board_mask"] = "cameras/cam_0/board_mask.png"
    cv2.imwrite(str(folder / "cameras/cam_0/board_mask.png"), covered)
    (folder / "dataset.json").write_text(json.dumps(meta))
    return folder, 1 - covered / 255


def test_weighted_scores_in_closed_form(board):
    folder, weight = board
    dataset = Dataset.open(folder)
    np.testing.assert_allclose(dataset.board_weight(0), weight, atol=1e-6)
    assert dataset.board_weight(1) is None
    g = random_gaussians(1)
    g.position[:] = [0, 50, 0]  # out of sight: the result shows the plate alone
    scores = evaluate(g, dataset)
    masked, whole = scores.images.pictures
    # only the soft row is left of the board: ten pixels of weight 0.6
    assert masked.psnr == pytest.approx(-10 * np.log10(ERROR**2 * 6 / weight.sum()), abs=1e-5)
    assert masked.psnr_flame == pytest.approx(-10 * np.log10(ERROR**2 * 3 / weight[30:, 15:].sum()), abs=1e-5)
    assert whole.psnr == pytest.approx(-10 * np.log10(ERROR**2 * 250 / (64 * 36)), abs=1e-5)
    assert masked.psnr_plate == pytest.approx(masked.psnr, abs=1e-5)
    error = ssim_map(np.full((64, 36, 3), PLATE), dataset.image(0, 2)).mean(-1)
    assert masked.ssim == pytest.approx((weight * error).sum() / weight.sum(), abs=1e-6) and masked.ssim > whole.ssim
    # nothing moves here; what the board's flicker is to the one camera, its soft row still is to the other
    assert masked.temporal_l2 == whole.temporal_l2 == pytest.approx(1, abs=1e-5)
    assert scores.images.board_share == pytest.approx((1 - weight).mean() / 2, abs=1e-6)


def test_hard_mask_hides_the_board_entirely(board):
    folder, _ = board
    cv2.imwrite(
        str(folder / "cameras/cam_0/board_mask.png"), np.pad(np.full((30, 20), 255, np.uint8), ((34, 0), (5, 11)))
    )
    g = random_gaussians(1)
    g.position[:] = [0, 50, 0]
    row = evaluate(g, Dataset.open(folder)).images.pictures[0]
    assert row.psnr == 100  # identical up to float32: what counts no higher
    assert row.ssim == pytest.approx(1, abs=1e-3) and row.temporal_l2 is None  # nothing that counts changes


def test_a_missing_or_wrong_mask_is_named(board):
    folder, _ = board
    path = folder / "cameras/cam_0/board_mask.png"
    cv2.imwrite(str(path), np.zeros((10, 10), np.uint8))
    with pytest.raises(DataFormatError, match=r"board_mask\.png: is 10x10"):
        Dataset.open(folder).board_weight(0)
    path.unlink()
    with pytest.raises(DataFormatError, match=r"board_mask\.png: no such file"):
        Dataset.open(folder).board_weight(0)
