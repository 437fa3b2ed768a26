"""Profiles beside a measured fire: a copy of a database and a flow written here, whose mean and rms are known."""

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.fields import VelocityField, VelocitySequence
from gof.core.fire import Hearth
from gof_benchmark.fires import how_real
from gof_benchmark.fires.measured import NIST, SANDIA, WATERLOO, SimulatedFlow, compare, read_database
from tests.solvers.conftest import write_small_fire

HEADER = "z (cm),r (cm),u-bar (m/s),u-rms (m/s),v-bar (m/s),v-rms (m/s),T-bar (K),T-rms (K)\n"  # as MaCFP writes it
MOUTH = np.array([0.1, -0.05, 0.04])
HEIGHTS_CM, RADII_CM = (6, 12, 20), (-4, 0, 4, 8, 12)


def mean(height_m, radius_m):
    """m/s, linear in height and in radius, which trilinear interpolation keeps but for the circle."""
    return 1.0 + 5.0 * height_m - 2.0 * radius_m


RMS = 0.3  # of the whole column moving as sqrt(2) 0.3 sin


def write_copy(folder, factor=1.0, heights=HEIGHTS_CM):
    """The database's files with figures of our own: the flow's mean and rms, times a factor."""
    (folder / WATERLOO).mkdir(parents=True)
    for z in heights:
        rows = (
            f"{z},{r},{factor * mean(z / 100, abs(r) / 100):.6f},{factor * RMS:.6f},0.1,0.2,1000,300\n"
            for r in RADII_CM
        )
        (folder / WATERLOO / f"Mean_and_rms_values_z{z}cm.csv").write_text(HEADER + "".join(rows))
    (folder / WATERLOO / "Mean_and_rms_values_r0cm.csv").write_text(HEADER + "2,0,9,9,9,9,9,9\n")  # said elsewhere
    return folder


def read_only(copy):
    (fire,) = read_database(copy)
    return fire


@pytest.fixture(scope="module")
def flow(tmp_path_factory) -> SimulatedFlow:
    cell, shape = 0.01, (40, 40, 32)
    matrix = np.diag([cell, cell, cell, 1.0])
    matrix[:3, 3] = MOUTH - [0.2, 0.2, 0.04]
    x, y, z = (cell * (np.arange(n) + 0.5) + matrix[i, 3] - MOUTH[i] for i, n in enumerate(shape))
    radius = np.hypot(x[:, None, None], y[None, :, None])
    still = np.broadcast_to(mean(z, radius), shape)
    fields = []
    for k in range(20):
        velocity = np.zeros((*shape, 3), np.float32)
        velocity[..., 2] = still + np.sqrt(2) * RMS * np.sin(2 * np.pi * k / 20)
        velocity[..., 0] = 7.0  # sideways: not asked for
        fields.append(VelocityField(velocity, matrix, 0.01 * k))
    path = tmp_path_factory.mktemp("flow") / "velocity.zarr"
    return SimulatedFlow(VelocitySequence.create(path, fields), MOUTH)


def test_a_flow_is_equal_to_its_own_mean_and_rms(tmp_path, flow):
    found = compare(flow, read_only(write_copy(tmp_path)))
    assert found.points == len(HEIGHTS_CM) * len(RADII_CM) and found.over_s == pytest.approx(0.19)
    assert found.mean_ratio == pytest.approx(1, abs=0.01) and found.mean_error < 0.01
    assert found.rms_ratio == pytest.approx(1, abs=0.01) and found.rms_error < 0.01


def test_a_faster_measured_fire_is_told(tmp_path, flow):
    """Twice as fast in all: half the ratio, and an error of half of what was measured."""
    found = compare(flow, read_only(write_copy(tmp_path, factor=2.0)))
    assert found.mean_ratio == pytest.approx(0.5, abs=0.01) and found.mean_error == pytest.approx(0.5, abs=0.01)
    assert found.rms_ratio == pytest.approx(0.5, abs=0.01) and found.rms_error == pytest.approx(0.5, abs=0.01)


def test_a_wobble_of_the_axis_counts_as_fluctuation(tmp_path):
    """Steady at every place, but faster on one side: the ring's mean is the same and its rms is not nothing."""
    matrix = np.diag([0.01, 0.01, 0.01, 1.0])
    matrix[:3, 3] = -0.2, -0.2, 0.0
    velocity = np.zeros((40, 40, 32, 3), np.float32)
    velocity[..., 2] = 1 + (0.01 * (np.arange(40) + 0.5) - 0.2)[:, None, None]
    fields = [VelocityField(velocity, matrix, t) for t in (0.0, 0.1)]
    flow = SimulatedFlow(VelocitySequence.create(tmp_path / "velocity.zarr", fields), np.zeros(3))
    (tmp_path / "Mean_and_rms_values_z6cm.csv").write_text(HEADER + f"6,8,1,{0.08 / np.sqrt(2)},0,0,0,0\n")
    found = compare(flow, read_only(tmp_path))
    assert found.mean_error < 1e-6 and found.rms_ratio == pytest.approx(1, abs=1e-4)


def test_the_energy_of_all_components_is_compared_where_it_was_measured(tmp_path):
    """Sandia's: up by 0.3 and outwards by 0.4 at random signs, 0.125 m2/s2; a swirl that is steady has none."""
    matrix = np.diag([0.05, 0.05, 0.05, 1.0])
    matrix[:3, 3] = -1.0, -1.0, 0.0
    x, y = (c.astype(float) for c in np.meshgrid(*[0.05 * (np.arange(40) + 0.5) - 1] * 2, indexing="ij"))
    radius = np.hypot(x, y)
    fields = []
    for k in range(4):
        velocity = np.zeros((40, 40, 24, 3), np.float32)
        velocity[..., 0] = ((-1) ** (k // 2) * 0.4 * x / radius - y)[..., None]
        velocity[..., 1] = ((-1) ** (k // 2) * 0.4 * y / radius + x)[..., None]
        velocity[..., 2] = 2 + (-1) ** k * 0.3
        fields.append(VelocityField(velocity, matrix, 0.1 * k))
    flow = SimulatedFlow(VelocitySequence.create(tmp_path / "velocity.zarr", fields), np.zeros(3))
    (tmp_path / SANDIA).mkdir(parents=True)
    for height in ("p3", "p9"):
        file = tmp_path / SANDIA / f"Sandia_CH4_1m_Test24_{height}.csv"
        file.write_text("x (m),U mean (m/s),W mean (m/s),TKE (m2/s2)\n-0.5,0.1,2,0.125\n0.3,0.1,2,0.125\n")
    (tmp_path / SANDIA / "Sandia_CH4_1m_Test14_p5.csv").write_text("x (m),U mean (m/s),W mean (m/s)\n0.2,0,4\n")
    without, fire = read_database(tmp_path)
    assert (fire.name, fire.heat_kw, fire.diameter_m) == ("Sandia, CH4, Test24", 2070, 1.0)
    np.testing.assert_allclose(fire.height_m, [0.301, 0.301, 0.903, 0.903])
    found = compare(flow, fire)
    assert found.points == 4 and found.mean_error < 1e-3 and np.isnan(found.within)
    assert found.rms_ratio == pytest.approx(1, abs=0.01) and found.rms_error < 0.01
    found = compare(flow, without)
    assert found.mean_ratio == pytest.approx(0.5, abs=1e-3) and np.isnan([found.rms_ratio, found.rms_error]).all()
    file.write_text("x (m),U mean (m/s),W mean (m/s),TKE (m2/s2)\n0.3,0.1,2,-0.1\n")
    with pytest.raises(DataFormatError, match="p9.csv: has a negative kinetic energy"):
        read_database(tmp_path)


def test_the_axis_is_held_beside_the_stated_uncertainty(tmp_path, flow):
    """NIST's: 6 cm is right, 12 cm within what is stated, 20 cm is not."""
    (tmp_path / NIST).mkdir(parents=True)
    rows = "".join(f"{z},0,{mean(z / 100, 0) + off},0.2\n" for z, off in ((6, 0.0), (12, 0.15), (20, -0.3)))
    (tmp_path / NIST / "Propane_50_kW_37_cm_U_r=0_Sung_2024.csv").write_text("z,r,U,Uc_U\ncm,cm,m/s,m/s\n" + rows)
    heat = "Time,HRR,MLR\ns,kW,kg/s\n0,50.1,0.001\n600,50.1,0.001\n"
    (tmp_path / NIST / "Propane_37_cm_50_kW_HRR_Sung_2024.csv").write_text(heat)
    fire = read_only(tmp_path)
    assert (fire.name, fire.diameter_m, fire.heat_kw) == ("NIST, Propane, 50 kW", 0.37, 50.1)
    found = compare(flow, fire)
    assert found.points == 3 and found.within == pytest.approx(2 / 3) and np.isnan(found.rms_ratio)


def test_points_outside_the_domain_are_left_out(tmp_path, flow):
    found = compare(flow, read_only(write_copy(tmp_path / "some", heights=(20, 30))))
    assert found.points == len(RADII_CM)
    with pytest.raises(DataFormatError, match=r"velocity.zarr: none of the points of 'Waterloo"):
        compare(flow, read_only(write_copy(tmp_path / "none", heights=(30, 40))))


def test_what_is_no_copy_of_the_database_is_named(tmp_path):
    with pytest.raises(DataFormatError, match="holds neither .*MaCFP/macfp-db"):
        read_database(tmp_path)
    file = tmp_path / "Mean_and_rms_values_z6cm.csv"
    file.write_text(HEADER.replace("u-rms", "w-rms") + "6,0,1,1,1,1,1,1\n")
    with pytest.raises(DataFormatError, match=r"z6cm.csv: has no column 'u-rms \(m/s\)'"):
        read_database(tmp_path)
    file.write_text(HEADER + "6,0,1,\n")
    with pytest.raises(DataFormatError, match="z6cm.csv: cannot be read as a table of numbers"):
        read_database(tmp_path)
    file.write_text(HEADER + "6,0,1,nan,1,1,1,1\n")
    with pytest.raises(DataFormatError, match="one that is not finite"):
        read_database(tmp_path)


def test_the_command_prints_fires_of_the_same_size_only(tmp_path, capsys):
    copy = write_copy(tmp_path / "copy", heights=(6, 12, 18))
    write_small_fire(tmp_path / "small", shape=(12, 12, 8))  # a burner of 0.2 m
    assert how_real.main([str(tmp_path / "small"), "--measured", str(copy)]) == 0
    assert (
        "None of these fires is one of these, in still air: 'Waterloo, methanol' (0.305 m, 21.3 kW"
        in capsys.readouterr().out
    )
    write_small_fire(
        tmp_path / "same", shape=(12, 12, 8), hearths=(Hearth(21.0, 0.3, (0.0, 0.0, 0.0), 0.02),), name="same"
    )
    assert how_real.main([str(tmp_path / "same"), "--measured", str(copy)]) == 0
    out = capsys.readouterr().out
    head, row = (next(line for line in out.splitlines() if word in line) for word in ("mean speed /", "| Waterloo"))
    cells = dict(zip(head.split("|"), row.split("|"), strict=True))
    assert cells[" points "].strip() == str(3 * len(RADII_CM)) and float(cells[" rms / measured "]) == 0
    assert how_real.main([str(tmp_path / "same"), "--measured", str(tmp_path)]) == 1
