"""What no importer takes: unknown, dangerous, damaged, or asked for with options that mean nothing there."""

import pickle

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gof.core.errors import DataFormatError, GofError  # noqa: E402
from gof.io.importers import ImportOptions, Source, detect, read_result  # noqa: E402
from tests.io import lookalikes  # noqa: E402


@pytest.mark.parametrize("option", ["world", "code_date", "time_unit_s", "time_zero_s", "world_by"])
def test_options_that_would_be_ignored_are_an_error(tmp_path, gaussians, option):
    """A path that does not exist included; and the numbers that are no times."""
    gaussians.save(tmp_path / "a.npz")
    given = {"world": tmp_path / "nothing", "code_date": "2024-01-01", "time_unit_s": 2.0, "time_zero_s": 1.0}
    options = ImportOptions(**{option: given.get(option, "gsplat")})
    flag = {"code_date": '"code_date" of RESULT.gof.json'}.get(
        option, "--" + option.removesuffix("_s").replace("_", "-")
    )
    with pytest.raises(DataFormatError, match=flag):
        read_result(tmp_path / "a.npz", options)
    path, _ = lookalikes.authors(tmp_path / "model")
    if not option.startswith("time"):
        with pytest.raises(DataFormatError, match="would change nothing"):
            read_result(path, options)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(GofError, match="--time-unit"):
            ImportOptions(time_unit_s=wrong)
    with pytest.raises(GofError, match="--time-zero"):
        ImportOptions(time_zero_s=np.nan)
    with pytest.raises(GofError, match="code_date 'yesterday'"):
        ImportOptions(code_date="yesterday")


def test_tensors_that_are_no_plain_arrays_are_named(tmp_path):
    """Sparse, meta, quantised, nested, complex, of no rows; keys that are no text; archives that are packed."""
    import zipfile

    path, _ = lookalikes.authors(tmp_path / "model")
    state, iteration = torch.load(path, weights_only=False)
    odd = {
        "sparse": state[1].detach().to_sparse(),
        "meta": torch.zeros(30, 3, device="meta"),
        "quantised": torch.quantize_per_tensor(state[1].detach(), 0.1, 0, torch.qint8),
        "complex": state[1].detach().to(torch.complex64),
        "conjugated": state[1].detach().to(torch.complex64).conj(),
        "empty": torch.zeros(0, 3),
        "bool": torch.zeros(30, 3, dtype=torch.bool).to_sparse(),
    }
    for name, tensor in odd.items():
        torch.save(((*state[:1], tensor, *state[2:]), iteration), path)
        with pytest.raises(DataFormatError, match="chkpnt7000.pth"):
            read_result(path)
            pytest.fail(name)
    torch.save({1: torch.zeros(3), (2, 3): 4}, tmp_path / "keys.pth")
    with pytest.raises(DataFormatError, match="no layout gof knows"):
        read_result(tmp_path / "keys.pth")
    torch.save(torch.zeros(30_000_000), tmp_path / "big.pth")
    with zipfile.ZipFile(tmp_path / "big.pth") as big, zipfile.ZipFile(tmp_path / "p.pth", "w", 8) as packed:
        for name in big.namelist():
            packed.writestr(name, big.read(name))
    with pytest.raises(DataFormatError, match="unpacks to"):
        read_result(tmp_path / "p.pth")


def test_what_cannot_be_read_is_named_as_a_user_knows_it(tmp_path):
    torch.save((Bomb(), 3), tmp_path / "x.pth")
    with pytest.raises(DataFormatError) as said:
        read_result(tmp_path / "x.pth")
    assert "holds exec besides" in str(said.value) and "option" not in str(said.value) and "\x1b" not in str(said.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataFormatError, match="SpacetimeGaussians"):
        read_result(tmp_path / "empty")
    torch.save({"linear.0.weight": torch.zeros(2), "gaussian_warp.weight": torch.zeros(3)}, tmp_path / "deform.pth")
    np.savez(tmp_path / "params.npz", means3D=np.zeros((4, 5, 3)), unnorm_rotations=np.zeros((4, 5, 4)))
    np.savez(tmp_path / "t.npz", time_s=np.arange(4), position=np.zeros((4, 5, 3)))
    (tmp_path / "wu").mkdir()
    torch.save({}, tmp_path / "wu/deformation.pth")
    for name, reason in (
        ("deform.pth", "Deformable-3DGS"),
        ("params.npz", "Dynamic3DGaussians"),
        ("t.npz", "schema"),
        ("wu", "Wu"),
    ):
        with pytest.raises(DataFormatError, match=reason):
            read_result(tmp_path / name)


def test_methods_without_velocities_are_explained(tmp_path):
    lookalikes.wu(tmp_path / "chkpnt_fine_14000.pth")
    torch.save((torch.nn.Linear(2, 2).state_dict(), torch.nn.Linear(2, 3).state_dict()), tmp_path / "deform.pth")
    (tmp_path / "grid4d/deform").mkdir(parents=True)
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(np.random.default_rng(0), 4).items()}
    lookalikes.splat_ply(tmp_path / "static.ply", raw)
    for name, reason in (
        ("chkpnt_fine_14000.pth", "Wu"),
        ("deform.pth", "Grid4D"),
        ("grid4d", "Grid4D"),
        ("static.ply", "neither time nor velocity"),
    ):
        with pytest.raises(DataFormatError, match=reason):
            read_result(tmp_path / name)


class Bomb:
    def __reduce__(self):
        return (exec, ("import pathlib; pathlib.Path('exploded').touch()",))


@pytest.mark.parametrize("kind", ["zip", "legacy", "plain", "npz"])
def test_no_pickle_is_executed(tmp_path, kind, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / ("x.npz" if kind == "npz" else "x.pth")
    if kind == "plain":
        path.write_bytes(pickle.dumps(((1, Bomb()), 2)))
    elif kind == "npz":
        np.savez(path, schema=np.array("gof-linear/1"), x0=np.array([Bomb()], object))
    else:
        torch.save((Bomb(), 3), path, _use_new_zipfile_serialization=kind == "zip")
    with pytest.raises(DataFormatError, match=r"x\.(pth|npz)"):
        read_result(path)
    assert not (tmp_path / "exploded").exists()


def test_wrong_layouts_are_named(tmp_path):
    cases = {
        "shape": lambda s: (*s[:1], torch.zeros(30, 4), *s[2:]),
        "nan": lambda s: (*s[:1], s[1] * np.nan, *s[2:]),
        "type": lambda s: (*s[:2], [1, 2], *s[3:]),
    }
    for name, change in cases.items():
        path, _ = lookalikes.authors(tmp_path / name)
        state, iteration = torch.load(path, weights_only=False)
        torch.save((change(state), iteration), path)
        with pytest.raises(DataFormatError, match=r"'(xyz|velocity)'"):
            read_result(path)
    torch.save({"a": torch.zeros(3)}, tmp_path / "other.pth")
    with pytest.raises(DataFormatError, match="no layout gof knows"):
        read_result(tmp_path / "other.pth")
    (tmp_path / "cut.pth").write_bytes(path.read_bytes()[:500])
    with pytest.raises(DataFormatError, match="readable PyTorch"):
        read_result(tmp_path / "cut.pth")
    with pytest.raises(DataFormatError, match="no such"):
        read_result(tmp_path / "nothing.pth")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataFormatError, match="no format"):
        read_result(tmp_path / "empty")


def test_own_files(tmp_path, gaussians):
    for name in ("a.npz", "a.ply"):
        gaussians.save(tmp_path / name)
        assert detect(Source(tmp_path / name)) == "gof"
        np.testing.assert_allclose(read_result(tmp_path / name).gaussians.velocity, gaussians.velocity)
