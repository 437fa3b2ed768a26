"""Flames side by side are told apart, and one flame is never cut in two."""

from dataclasses import replace

import numpy as np
import pytest

from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.several_flames import several_flames
from tests.reconstruct.plumes import box_of_voxels, field_of

FRAMES = 3


def burning(*flames, resolution=(40, 16, 30)):
    """Flames on one box of voxels: (middle x in m, light, speed in m/s) of each; what shines rises and spreads."""
    voxels = box_of_voxels(resolution, 0.02)
    x, y, z = voxels.center.T
    emission, momentum = np.zeros((FRAMES, len(x))), np.zeros((FRAMES, len(x), 3))
    for middle, light, speed in flames:
        for f in range(FRAMES):
            glow = light * np.exp(-((x - middle - 0.004 * f * z) ** 2 + y**2) / 0.003 - (z - 0.25) ** 2 / 0.03)
            emission[f] += glow
            momentum[f] += glow[:, None] * (speed * np.stack([0.3 * (x - middle), 0.3 * y, 0.5 + z], -1))
    return field_of(voxels, momentum / np.maximum(emission, 1e-12)[..., None], emission)


def test_two_flames_are_two_and_the_nearer_one_owns_a_voxel():
    field = burning((-0.2, 1.0, 1.0), (0.2, 0.4, 2.0))
    flame = several_flames(field)
    x = field.voxels.center[:, 0]
    assert set(flame) == {0, 1}
    assert len(set(flame[x < -0.1])) == 1 and len(set(flame[x > 0.1])) == 1 and flame[x.argmin()] != flame[x.argmax()]


def test_three_flames_are_three():
    assert set(several_flames(burning((-0.28, 1, 1), (0, 0.8, 1), (0.28, 0.9, 1)))) == {0, 1, 2}


@pytest.mark.parametrize(
    "flames",
    [
        [(0.0, 1.0, 1.0)],
        [(-0.03, 1.0, 1.0), (0.03, 1.0, 2.0)],  # their light flows into one
        [(-0.25, 1.0, 1.0), (0.25, 0.05, 1.0)],  # a spark beside a flame
    ],
)
def test_one_flame_stays_one(flames):
    assert (several_flames(burning(*flames)) == 0).all()


def test_a_hollow_flame_is_one():
    """A pool burns at its rim: seen from above it is a ring."""
    field = burning((0.0, 1.0, 1.0), resolution=(30, 30, 30))
    x, y, z = field.voxels.center.T
    ring = np.exp(-((np.hypot(x, y) - 0.15) ** 2) / 0.001 - (z - 0.25) ** 2 / 0.03)
    hollow = replace(field, frames=tuple(replace(frame, emission=ring) for frame in field.frames))
    assert (several_flames(hollow) == 0).all()


def test_nothing_that_shines_or_moves_is_one_flame():
    field = burning((0.0, 1.0, 1.0))
    for name in ("emission", "velocity"):
        dead = replace(field, frames=tuple(replace(f, **{name: 0 * getattr(f, name)}) for f in field.frames))
        assert (several_flames(dead) == 0).all()


def test_a_flame_is_corrected_as_if_it_burnt_alone_but_for_its_pace():
    """What its neighbour does, twice as fast and half as bright, changes nothing but its pace, all over the flame."""
    prior = FlowPrior.load()
    own, other = (-0.2, 1.0, 1.0), (0.2, 0.5, 2.0)
    together, alone = prior.correct(burning(own, other)), prior.correct(burning(own))
    core = np.hypot(together.voxels.center[:, 0] + 0.2, together.voxels.center[:, 1]) < 0.06
    paces = []
    for found, expected in zip(together.frames, alone.frames, strict=True):
        speed, found_speed = (np.linalg.norm(frame.velocity[core], axis=-1).mean() for frame in (expected, found))
        paces.append(found_speed / speed)
        assert np.abs(found.velocity[core] / paces[-1] - expected.velocity[core]).mean() < 0.03 * speed
        np.testing.assert_allclose(found.velocity_sd[core] / paces[-1], expected.velocity_sd[core], rtol=0.2)
    np.testing.assert_allclose(paces, paces[0], rtol=0.02)
    assert 1 < paces[0] < 2  # as the two say together, and the other one is faster
