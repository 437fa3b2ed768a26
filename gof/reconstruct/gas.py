"""The velocity of the gas at the places to which the optimisation has moved the Gaussians.

A seed gets the gas' velocity at its voxel and frame. The optimisation then moves it with the light, by a voxel and a
fifth of a frame: enough to leave the slow outer layer for the fast core. So the flow field is read once more, along
the path of the Gaussian while it shines.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import map_coordinates

from gof.core.gaussians import TransientGaussians
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.voxels import FlameVoxels

NOTHING = 1e-6  # share of known voxels and frames around a place below which nothing is known there


def look_up_gas(gaussians: TransientGaussians, field: FlowField) -> TransientGaussians:
    """Return the same Gaussians with the gas' velocity, and its standard deviation, in the mean over their lives.

    A life is weighted by its temporal opacity: two nodes of Gauss and Hermite, one `t_sigma` before `t_mu` and one
    after, or where the clip begins and ends.

    Args:
        gaussians: measured from where the field is measured from. Static ones rest; those that left everything that is
            known keep what they say of the gas.
    """
    clip = field.frames[0].time_s, field.frames[-1].time_s
    sigma = np.where(np.isfinite(gaussians.t_sigma), gaussians.t_sigma, 0).astype(np.float64)
    total, count, uncertainty = np.zeros((len(gaussians), 3)), np.zeros(len(gaussians)), np.zeros(len(gaussians))
    for time_s in (np.clip(gaussians.t_mu - sigma, *clip), np.clip(gaussians.t_mu + sigma, *clip)):
        way = (time_s - gaussians.t_mu)[:, None] * gaussians.velocity
        velocity, sd = gas_at(field, gaussians.position + way, time_s)
        found = np.isfinite(velocity).all(1)
        total[found] += velocity[found]
        uncertainty[found] += sd[found]
        count += found
    found, count = gaussians.dynamic & (count > 0), np.maximum(count, 1)
    return replace(
        gaussians,
        gas_velocity=np.where(found[:, None], total / count[:, None], gaussians.moving_gas),
        velocity_sd=np.where(found, uncertainty / count, gaussians.velocity_sd),
    )


def with_gas_of(field: FlowField, other: FlowField) -> FlowField:
    """Return the field with the gas of another of the same frames, which may stand on other voxels.

    A voxel around which the other has no velocity moves with its light, and its uncertainty is infinite.
    """
    frames = []
    for frame in field.frames:
        velocity, sd = gas_at(other, field.voxels.center, np.full(len(field.voxels.center), frame.time_s))
        known = np.isfinite(velocity).all(1)
        velocity = np.where(known[:, None], velocity, frame.light_velocity)
        frames.append(replace(frame, velocity=velocity, velocity_sd=np.where(known, sd, np.inf)))
    return replace(field, frames=tuple(frames))


def gas_at(field: FlowField, position: np.ndarray, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of the gas (N, 3) m/s and its standard deviation (N,) m/s at places (N, 3) m and times (N,) s.

    Linear between the centres of voxels and between frames, over those that know; before the first frame and after the
    last as in it. NaN where no neighbour knows the velocity, and inf where none knows how sure it is.
    """
    voxels = field.voxels
    place = (np.asarray(position, np.float64) - voxels.center[0]) / voxels.voxel_size + voxels.index[0]
    at = np.interp(time_s, [frame.time_s for frame in field.frames], np.arange(len(field.frames)))
    sums = np.zeros((len(place), 6))
    for f, frame in enumerate(field.frames):
        share = np.maximum(1 - np.abs(at - f), 0)
        near = np.flatnonzero(share)
        if len(near):
            sums[near] += share[near, None] * _between(voxels, _weighted(frame), place[near])
    known, sure = sums[:, 0], sums[:, 4]
    velocity, sd = np.full((len(place), 3), np.nan), np.full(len(place), np.inf)
    np.divide(sums[:, 1:4], known[:, None], out=velocity, where=known[:, None] > NOTHING)
    np.divide(sums[:, 5], sure, out=sd, where=sure > NOTHING)
    return velocity, sd


def _weighted(frame: FrameField) -> np.ndarray:
    """(V, 6) what a voxel adds: 1 and its velocity where that is known, 1 and its deviation where that is."""
    sure = frame.known & np.isfinite(frame.velocity_sd)
    deviation = np.where(sure, frame.velocity_sd, 0)
    velocity = np.where(frame.known[:, None], frame.velocity, 0)
    return np.column_stack([frame.known, velocity, sure, deviation])


def _between(voxels: FlameVoxels, values: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(N, K) of values (V, K) at places (N, 3) in voxels, linear; 0 where no voxel stands."""
    grid = np.zeros(voxels.resolution)
    columns = []
    for column in values.T:
        grid[tuple(voxels.index.T)] = column
        columns.append(map_coordinates(grid, place.T, order=1, mode="constant", prefilter=False))
    return np.stack(columns, -1)
