"""How bright a fire of grids burns: line integrals of boxes of light whose length is known."""

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.fire import FireDescription
from gof_benchmark.solvers import radiance
from gof_benchmark.solvers.grids import FireFrame, write_fire


def write_box(path, lengths, red=3.0):
    """A box of light, two cells of 4 cm along X and three along Y, that in frame k is `lengths[k]` as bright."""
    index_to_world = np.diag([0.04, 0.04, 0.04, 1.0])

    def frame(k):
        light = np.zeros((8, 8, 8, 3))
        light[3:5, 2:5, 4] = [red * lengths[k], 100.0, 100.0]  # the other colours do not count
        return FireFrame(velocity=np.zeros((8, 8, 8, 3)), emission=light)

    times = tuple(0.01 * k for k in range(len(lengths)))
    return write_fire(path, FireDescription("box", "closed form", times, "a box"), index_to_world, frame)


def test_the_brightest_line_of_sight_becomes_ten(tmp_path):
    fire = write_box(tmp_path / "fire", lengths=(1.0, 2.0, 0.5))
    assert radiance.brightest_column(fire) == pytest.approx(3 * 0.04 * 6.0, rel=1e-6)
    assert radiance.suggested_radiance(fire) == pytest.approx(10 / 0.72, rel=1e-6)


def test_the_command_prints_it_and_names_a_dark_fire(tmp_path, capsys):
    write_box(tmp_path / "lit", lengths=(1.0,), red=2.5)
    assert radiance.main([str(tmp_path / "lit")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'lit'}: radiance 33.3\n"
    write_box(tmp_path / "dark", lengths=(0.0, 0.0))
    assert radiance.main([str(tmp_path / "dark")]) == 1
    assert "dark" in (error := capsys.readouterr().err) and "no light in any frame" in error
    with pytest.raises(DataFormatError):
        radiance.suggested_radiance(write_box(tmp_path / "black", lengths=(0.0,)))
