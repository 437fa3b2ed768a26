"""Fires small enough for tests, and OpenFOAM when it is there."""

from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import MissingDependencyError
from gof.core.fire import FireDescription, Hearth
from gof_benchmark.solvers.grids import FireFrame, FireGrids, FireHistory, write_fire
from gof_benchmark.solvers.openfoam.foam_fire import FoamBurner, FoamFire
from gof_benchmark.solvers.openfoam.run import Installation, find_installation


def toy_fire(**changes) -> FoamFire:
    """A pool fire of some thousand cells."""
    settings = {
        "name": "toy",
        "burners": (FoamBurner(20.0, 0.2),),
        "core_low_m": (-0.2, -0.2, 0.0),
        "core_high_m": (0.2, 0.2, 0.5),
        "domain_low_m": (-0.5, -0.5, 0.0),
        "domain_high_m": (0.5, 0.5, 1.0),
        "cell_m": (0.05, 0.05, 0.05),
        "coarse": 1.0,
        "warm_up_s": 0.1,
        "settle_s": 0.05,
        "frames": 4,
    }
    return FoamFire(**settings | changes)


@pytest.fixture
def foam() -> Installation:
    """OpenFOAM, or the test is skipped and says so."""
    try:
        return find_installation()
    except MissingDependencyError as e:
        pytest.skip(f"OpenFOAM is not installed: {e}")


def write_small_fire(path: Path, heat_kw=30.0, velocity=None, frames=3, shape=(6, 6, 8), **described) -> FireGrids:
    """A fire of constant fields on cubes of 5 cm about the axis, its floor at 0."""
    index_to_world = np.diag([0.05, 0.05, 0.05, 1.0])
    index_to_world[:2, 3] = -0.05 * shape[0] / 2
    z = 0.05 * (np.arange(shape[2]) + 0.5)

    def frame(k: int) -> FireFrame:
        light = np.zeros((*shape, 3))
        light[1:5, 1:5, :6] = [1.0, 0.5, 0.1]
        v = np.zeros((*shape, 3))
        v[..., 2] = 6.8 * np.sqrt(z) if velocity is None else velocity(z, k)
        return FireFrame(
            velocity=v,
            emission=light,
            temperature=np.full(shape, 300.0),
            heat_release=np.full(shape, heat_kw * 1e3 / (0.05**3 * np.prod(shape))),
            fuel=np.zeros(shape),
        )

    times = np.arange(-1.0, 0.3, 0.004)
    rise = np.sin(2 * np.pi * 3.2 * times)[:, None] + 0.1 * times[:, None]
    history = FireHistory(
        tuple(times.tolist()), (heat_kw,) * len(times), ((0.0, 0.0, 0.1),), tuple(map(tuple, rise.tolist()))
    )
    settings = {
        "name": "small",
        "solver": "test",
        "time_s": tuple(0.01 * k for k in range(frames)),
        "emission_law": "none",
        "hearths": (Hearth(heat_kw, 0.2, (0.0, 0.0, 0.0), 0.02),),
    }
    return write_fire(path, FireDescription(**settings | described), index_to_world, frame, history)
