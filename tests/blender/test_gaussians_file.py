"""The add-on's result reader against the library's writer, and against broken files."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.datum import Datum
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof_blender.core.errors import DataFormatError, GofError
from gof_blender.pure.io.cloud import CloudTiming, count, load
from tests.plys import read_ply, write_ply

N = 40


def gaussians(color_shape=(3,)) -> TransientGaussians:
    rng = np.random.default_rng(3)
    t_sigma = rng.uniform(0.01, 0.2, N)
    t_sigma[::7] = np.inf
    return TransientGaussians(
        position=rng.normal(size=(N, 3)),
        velocity=rng.normal(size=(N, 3)),
        t_mu=rng.uniform(0, 1, N),
        t_sigma=t_sigma,
        scale=rng.uniform(1e-3, 0.1, (N, 3)),
        rotation=rng.normal(size=(N, 4)),
        opacity=rng.uniform(0, 1, N),
        color=rng.uniform(0, 1, (N, *color_shape)),
        dynamic=rng.uniform(size=N) > 0.3,
    )


@pytest.mark.parametrize("suffix", [".npz", ".ply"])
@pytest.mark.parametrize("color_shape", [(3,), (4, 3)])
def test_reads_what_the_library_writes(tmp_path, suffix, color_shape):
    wanted = gaussians(color_shape)
    cloud = load(wanted.save(tmp_path / f"result{suffix}"))
    assert len(cloud) == N
    for name in ("position", "velocity", "t_mu", "t_sigma", "dynamic"):
        assert np.array_equal(getattr(cloud, name), getattr(wanted, name)), name
    for name in ("scale", "rotation", "opacity"):
        assert np.allclose(getattr(cloud, name), getattr(wanted, name), rtol=2e-6, atol=1e-7), name
    color = wanted.color if wanted.color.ndim == 2 else 0.5 + C0 * wanted.color[:, 0]
    assert np.allclose(cloud.color, color, atol=1e-6)


@pytest.mark.parametrize("suffix", [".npz", ".ply"])
def test_reads_how_sure_the_velocity_is(tmp_path, suffix):
    silent = gaussians()
    assert not load(silent.save(tmp_path / f"silent{suffix}")).says_uncertainty
    uncertainty = np.linspace(0, 2, N).astype(np.float32)
    uncertainty[5] = np.inf
    cloud = load(replace(silent, velocity_sd=uncertainty).save(tmp_path / f"unsure{suffix}"))
    assert cloud.says_uncertainty and np.array_equal(cloud.velocity_sd, uncertainty)


@pytest.mark.parametrize("suffix", [".npz", ".ply"])
def test_reads_the_velocity_of_the_gas(tmp_path, suffix):
    together = gaussians()
    cloud = load(together.save(tmp_path / f"one{suffix}"))
    assert cloud.gas_velocity is None and np.array_equal(cloud.moving_gas, together.moving_gas)
    gas = np.random.default_rng(2).normal(size=(N, 3)).astype(np.float32)
    apart = replace(together, gas_velocity=gas)
    cloud = load(apart.save(tmp_path / f"two{suffix}"))
    assert np.array_equal(cloud.gas_velocity, gas) and np.array_equal(cloud.velocity, together.velocity)
    assert np.array_equal(cloud.moving_gas, apart.moving_gas)


@pytest.mark.parametrize("suffix", [".npz", ".ply"])
def test_reads_the_datum_that_places_and_times_count_from(tmp_path, suffix):
    datum = Datum((498_000.0, 5_213_000.5, 431.0), 1_732_300_000.25)
    cloud = load(replace(gaussians(), datum=datum).save(tmp_path / f"far{suffix}"))
    assert cloud.datum.numbers().tolist() == datum.numbers().tolist()
    np.testing.assert_allclose(cloud.position, gaussians().position, atol=1e-6)
    assert load(gaussians().save(tmp_path / f"near{suffix}")).datum is None


def test_a_broken_datum_is_named(tmp_path):
    path = replace(gaussians(), datum=Datum((5e5, 0.0, 0.0))).save(tmp_path / "a.npz")
    content = dict(np.load(path))
    for wrong in ([1.0, 2.0], [1.0, 2.0, np.nan, 0.0], ["a", "b", "c", "d"]):
        np.savez(tmp_path / "b.npz", **content | {"datum": np.array(wrong)})
        with pytest.raises(DataFormatError, match=r"b\.npz.*datum"):
            load(tmp_path / "b.npz")


def test_a_capture_far_from_zero_is_measured_from_the_datum(tmp_path):
    """Blender knows float32 alone: its cameras stand where the library's do."""
    from gof.core.description import DatasetDescription
    from gof.dataset import Dataset
    from tests.moved_dataset import moved_copy
    from tests.reconstruct.rising_flame import write_flame

    folder = moved_copy(
        write_flame(tmp_path / "near", frames=6, late={1: 0.01}), tmp_path / "far", Datum((5e5, 5e6, 100), 1.7e9)
    )
    dataset = Dataset.open(folder)
    there = DatasetDescription.read(folder).measured_from(dataset.datum)
    np.testing.assert_allclose(there.time_s, dataset.times_s, atol=1e-9)
    np.testing.assert_allclose(there.cameras[1].time_s, dataset.camera_times_s(1), atol=1e-9)
    for entry, camera in zip(there.cameras, dataset.cameras, strict=True):
        np.testing.assert_allclose(entry.world_to_camera, camera.world_to_camera, atol=1e-8)


def test_reads_big_endian_doubles(tmp_path):
    wanted = gaussians()
    vertex, _ = read_ply(wanted.save(tmp_path / "a.ply"))
    wide = vertex.astype([(n, "u1" if n == "is_dynamic" else "f8") for n in vertex.dtype.names])
    assert np.array_equal(load(write_ply(tmp_path / "b.ply", wide, order=">")).position, wanted.position)


def npz(tmp_path, **changes):
    """A result.npz with fields replaced, or left out when None."""
    file = gaussians().save(tmp_path / "result.npz")
    with np.load(file) as data:
        fields = {k: data[k] for k in data.files} | changes
    np.savez(file, **{k: v for k, v in fields.items() if v is not None})
    return file


def with_value(shape, value, fill=0.5):
    array = np.full(shape, fill, np.float32)
    array[2] = value
    return array


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"schema": None}, "schema is 'none'"),
        ({"schema": "gof-trajectory/1"}, "gof-trajectory/1"),
        ({"v_sd": with_value(N, -0.1)}, r"'velocity_sd' must be >= 0 .*rows \[2\]"),
        ({"v": None}, r"\['v'\] are missing"),
        ({"rgb": None}, "rgb or sh"),
        ({"x0": with_value((N, 3), np.nan)}, r"'position' .*NaN or Inf .*rows: \[2\]"),
        ({"v": with_value((N, 3), np.inf)}, "'velocity' .*NaN or Inf"),
        ({"t_sigma_s": with_value(N, np.nan)}, "'t_sigma' .*NaN or Inf"),
        ({"t_sigma_s": with_value(N, 0)}, "'t_sigma' must be > 0"),
        ({"scale": with_value((N, 3), -1)}, "'scale' must be > 0"),
        ({"alpha": with_value(N, 1.5)}, "'opacity' must be in"),
        ({"rotation": with_value((N, 4), 0)}, "quaternion"),
        ({"t_mu_s": np.zeros(3)}, r"'t_mu' has shape \(3,\)"),
        ({"x0": np.zeros((0, 3))}, "for 0 Gaussians"),
        ({"x0": np.array(1.0)}, "'position' has shape"),
        ({"scale": np.full((N, 3), "big")}, "'scale' does not hold numbers"),
        ({"x0": np.full((N, 3), 1e300)}, "'position' .*NaN or Inf"),
        ({"rgb": None, "sh": np.zeros((N, 3))}, "'sh' has shape"),
    ],
)
def test_broken_npz(tmp_path, changes, message):
    with pytest.raises(GofError, match=f"result.npz: .*{message}"):
        load(npz(tmp_path, **changes))


def test_pickles_are_refused(tmp_path):
    with pytest.raises(DataFormatError, match="not a readable npz"):
        load(npz(tmp_path, x0=np.array([{}], object)))


@pytest.mark.parametrize("keep", [0, 3, 40, 300, -1])
@pytest.mark.parametrize("suffix", [".npz", ".ply"])
def test_truncated(tmp_path, suffix, keep):
    file = gaussians().save(tmp_path / f"result{suffix}")
    file.write_bytes(file.read_bytes()[:keep])
    with pytest.raises(DataFormatError, match=f"result{suffix}"):
        load(file)


@pytest.mark.parametrize(
    "old, new, message",
    [
        (b"ply\n", b"plx\n", "not a PLY"),
        (b"binary_little_endian", b"ascii", "truncated|line"),
        (b"binary_little_endian", b"binary_middle_endian", "line 2: 'format binary_middle_endian 1.0' is no line"),
        (b"element vertex", b"element face", "'vertex' element"),
        (b"element vertex 40", b"element vertex 99999999", "truncated"),
        (b"element vertex 40", b"element vertex 0", "0 points"),
        (b"element vertex 40", b"element vertex -3", "line 7: 'element vertex -3' is no line"),
        (b"property float vx", b"property float ux", r"\['vx'\] are missing"),
        (b"property float vx", b"property float vy", "a second property 'vy'"),
        (b"property float vx", b"property list uchar int vx", "continues beyond the end of the file"),
    ],
)
def test_broken_ply(tmp_path, old, new, message):
    file = gaussians().save(tmp_path / "result.ply")
    data = file.read_bytes()
    assert old in data
    file.write_bytes(data.replace(old, new, 1))
    with pytest.raises(DataFormatError, match=message):
        load(file)


def test_absurd_raw_values_in_ply(tmp_path):
    file = gaussians().save(tmp_path / "result.ply")
    vertex, comments = read_ply(file)
    vertex["opacity"][:2] = [-1e30, 1e30]
    write_ply(file, vertex, comments=comments)
    assert load(file).opacity[:2].tolist() == pytest.approx([0.0, 1.0], abs=1e-30)
    vertex["scale_1"][5] = 1e4
    write_ply(file, vertex, comments=comments)
    with pytest.raises(DataFormatError, match=r"'scale' must be a natural logarithm.*rows \[5\]"):
        load(file)


def test_wrong_name(tmp_path):
    with pytest.raises(DataFormatError, match="unknown suffix"):
        load(tmp_path / "result.pth")
    with pytest.raises(DataFormatError, match="no such file"):
        load(tmp_path / "result.npz")


def plain_ply(path, cloud):
    """A 3DGS PLY as trainers write it, without time."""
    vertex, _ = read_ply(cloud.save(path))
    names = [n for n in vertex.dtype.names if n not in ("t_mu", "t_sigma", "vx", "vy", "vz", "is_dynamic")]
    return write_ply(path, vertex[names].astype([(n, "f4") for n in names]))


def test_ftgs_ply_against_the_library(tmp_path):
    from gof.core.ftgs import save
    from gof.io.importers import ImportOptions, read_result

    file = save(gaussians(), tmp_path / "a.ftgs.ply", start_s=0.0, end_s=1.5, frames=37)
    wanted = read_result(file, ImportOptions(time_unit_s=1.5)).gaussians
    for clock in (CloudTiming(fps=24), CloudTiming(fps=30, clip_s=1.5)):  # 36 steps at 24 per second are 1.5 s
        cloud = load(file, clock)
        for name in ("position", "velocity", "t_mu", "t_sigma", "scale", "rotation", "opacity"):
            assert np.allclose(getattr(cloud, name), getattr(wanted, name), rtol=1e-5, atol=1e-6), name
        assert np.array_equal(cloud.dynamic, wanted.dynamic)


def test_ftgs_ply_without_seconds(tmp_path):
    from gof.core.ftgs import save

    file = save(gaussians(), tmp_path / "a.ftgs.ply", start_s=0.0, end_s=1.5)
    lines = file.read_bytes().split(b"\n")
    file.write_bytes(b"\n".join(line for line in lines if not line.startswith(b"comment gof_clip_s")))
    with pytest.raises(DataFormatError, match=r"set Clip \("):
        load(file)
    file.write_bytes(file.read_bytes().replace(b"time_units normalized", b"time_units fortnights", 1))
    with pytest.raises(DataFormatError, match="fortnights; expected 1, normalized"):
        load(file, CloudTiming(clip_s=1.0))


def test_plain_splats_are_a_still(tmp_path):
    wanted = gaussians()
    cloud = load(plain_ply(tmp_path / "still.ply", wanted))
    assert np.array_equal(cloud.position, wanted.position) and not cloud.dynamic.any()
    assert (cloud.velocity == 0).all() and np.isinf(cloud.t_sigma).all() and cloud.begin is None


@pytest.mark.parametrize("as_folder", [True, False])
def test_sequence_of_plys(tmp_path, as_folder):
    """Numbers 3, 5, 10 at 10 per second: rows move straight from file to file, each seen until the next."""
    states, files = {}, []
    rng = np.random.default_rng(0)
    for number in (10, 3, 5):
        states[number] = gaussians()
        states[number].position[:] = rng.normal(size=(N, 3))
        files.append(plain_ply(tmp_path / f"out_v2_{number}.ply", states[number]))
    cloud = load(tmp_path if as_folder else files, CloudTiming(fps=10))
    assert len(cloud) == 3 * N == count(tmp_path)
    assert np.allclose(cloud.begin[::N], [0.3, 0.5, 1.0]) and np.allclose(cloud.end[::N], [0.5, 1.0, 1.5])
    first = slice(0, N)
    halfway = cloud.position[first] + 0.1 * cloud.velocity[first]
    assert np.allclose(halfway, (states[3].position + states[5].position) / 2, atol=1e-6)
    assert np.array_equal(cloud.position[N : 2 * N], states[5].position)
    assert (cloud.end[:N] == cloud.begin[N : 2 * N]).all()  # never two at once, never none


def test_sequence_whose_gaussians_change(tmp_path):
    plain_ply(tmp_path / "1.ply", gaussians())
    plain_ply(tmp_path / "2.ply", gaussians()[:9])
    cloud = load(tmp_path)
    assert len(cloud) == N + 9 and (cloud.velocity == 0).all()


def test_broken_sequences(tmp_path):
    with pytest.raises(DataFormatError, match="no numbered"):
        load(tmp_path)
    plain_ply(tmp_path / "1.ply", gaussians())
    plain_ply(tmp_path / "01.ply", gaussians())
    with pytest.raises(DataFormatError, match=r"has the number 1, and so has"):
        load(tmp_path)
    (tmp_path / "01.ply").rename(tmp_path / "cloud.ply")
    with pytest.raises(DataFormatError, match=r"cloud\.ply: its name has no frame number"):
        load(tmp_path)
    plain_ply(tmp_path / "cloud.ply", gaussians()).rename(tmp_path / "2.ply")
    (tmp_path / "2.ply").write_bytes((tmp_path / "2.ply").read_bytes()[:-5])
    with pytest.raises(DataFormatError, match=r"2\.ply: .*truncated"):
        load(tmp_path)


@pytest.mark.parametrize("suffix", [".npz", ".ply"])
def test_count_and_every_third(tmp_path, suffix):
    wanted = gaussians()
    file = wanted.save(tmp_path / f"result{suffix}")
    assert count(file) == N
    cloud = load(file, step=3)
    assert np.array_equal(cloud.position, wanted.position[::3]) and np.array_equal(cloud.dynamic, wanted.dynamic[::3])


def test_count_of_a_file_that_is_no_result(tmp_path):
    (tmp_path / "result.npz").write_bytes(b"nothing")
    assert count(tmp_path / "result.npz") == 0
    np.savez(tmp_path / "result.npz", other=np.zeros(3))
    assert count(tmp_path / "result.npz") == 0


def test_a_mesh_is_no_reconstruction(tmp_path):
    mesh = write_ply(tmp_path / "mesh.ply", np.zeros(4, [(n, "f4") for n in "xyz"]))
    with pytest.raises(DataFormatError, match="points or a mesh, without Gaussians' sizes"):
        load(mesh)
