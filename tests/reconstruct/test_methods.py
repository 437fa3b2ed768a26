"""The paper's method against its printed numbers: rates, masks, hull, and the flow to the next frame."""

from dataclasses import replace

import numpy as np
import pytest

from gof.reconstruct.methods import OURS, PAPER, rates_in_voxels
from gof.reconstruct.observation import flow_masks, velocity_ahead
from gof.reconstruct.voxels import carve
from tests.conftest import arc, look_at
from tests.reconstruct.test_voxels import ball


def test_the_papers_rates_are_3dgs_at_the_cameras_extent():
    """Two cameras 2 m apart: their middle is 1 m from each, 3DGS' extent 1.1 m. Rates per ms at 400 Hz."""
    cameras = [look_at(f"cam_{x}", (x, -3, 1), (0, 0, 1), 36, 64, 80.0) for x in (-1, 1)]
    rates = rates_in_voxels(PAPER.rates, cameras, voxel_size=0.02)
    assert np.multiply(rates.position, 0.02) == pytest.approx([1.6e-4 * 1.1, 1.6e-6 * 1.1])
    per_ms = rates.velocity * 0.02 / 2.5
    assert per_ms == pytest.approx(1e-2 * 1.6e-4 * 1.1), "1e-2 of the position's"
    assert rates.t_mu * 2.5 == pytest.approx(0.01), "ms"
    again = rates_in_voxels(replace(PAPER, flow_masks=False).rates, cameras, 0.02)
    assert again == rates == rates_in_voxels(rates, cameras, 0.02), "of any method; and once is enough"
    assert rates_in_voxels(OURS.rates, cameras, 0.02) is OURS.rates


def test_masks_are_where_more_than_half_a_pixel_moves_and_ten_more_pixels_across():
    flow = np.zeros((1, 1, 40, 40, 2), np.float32)
    flow[..., 20, 20, :] = 0.6 / 0.01, 0.0
    flow[..., 10, 10, :] = 0.4 / 0.01, 0.0
    flow[..., 30, 30, :] = np.nan
    moving, grown = flow_masks(flow, frame_time_s=0.01)
    assert np.argwhere(moving[0, 0]).tolist() == [[20, 20]]
    assert grown[0, 0].sum() == 9 * 9 and grown[0, 0, 16:25, 16:25].all(), "twice by 5x5"


def test_flow_is_to_the_next_frame_or_from_the_last_where_that_is_held_out():
    def flow(first, second, before=None):
        return np.full((*first.shape, 2), float(second[0, 0]) - float(first[0, 0]), np.float32)

    pictures = {k: np.full((2, 2), k * k) for k in (0, 1, 2, 4)}  # 1, 3 and 5 levels from frame to frame
    at = velocity_ahead(flow)
    times = 0.1 * np.arange(5)
    assert at(pictures, times, 1)[0, 0, 0] == pytest.approx(30), "ahead, not the mean of both ways"
    assert at(pictures, times, 2)[0, 0, 0] == pytest.approx(30), "frame 3 is held out"
    assert np.isnan(at(pictures, times, 4)).all(), "no neighbour"


def test_two_cameras_are_enough_for_the_papers_hull():
    cameras = arc(3)
    masks, _ = ball(cameras)
    rows = np.flatnonzero(masks[2].any(1))
    masks[2, : int(rows.mean())] = False  # the third camera sees the lower half only

    def volume(vetoes):  # of the hull within the ball
        kept = carve(cameras, masks[None], 48, vetoes=vetoes)
        return (np.linalg.norm(kept.center - [0, 0, 1], axis=1) < 0.2).sum() * kept.voxel_size**3

    whole = 4 / 3 * np.pi * 0.2**3
    assert volume(False) == pytest.approx(whole, rel=0.05) and volume(True) < 0.7 * whole
