"""`gof convert` on every input kind it can write."""

import json

import numpy as np
import pytest

from gof.commands.convert import main
from gof.core.errors import DataFormatError, GofError
from gof.core.trajectory import Trajectory
from gof.dataset import Dataset
from gof.io.importers import ImportOptions, read_result
from gof.io.importers.sidecar import with_sidecar
from tests.conftest import random_gaussians
from tests.io.motions import moved_camera, similarity, trained

lookalikes = pytest.importorskip("tests.io.lookalikes", reason="PyTorch writes the look-alikes")


def test_a_foreign_checkpoint_to_every_format(tmp_path, capsys):
    path, _ = lookalikes.authors(tmp_path / "model")
    original = read_result(path).gaussians
    for name, extra in (
        ("a.npz", []),
        ("a.ply", []),
        ("a.ftgs.ply", ["--clip", "0", "0.08", "--frame-time", "0.01"]),
    ):
        assert main([str(path), str(tmp_path / name), "--json", str(tmp_path / "j.json"), *extra]) == 0
        back = read_result(tmp_path / name, ImportOptions(frame_time_s=0.01)).gaussians
        d = original.dynamic
        for t in (0.0, 0.04):
            np.testing.assert_allclose(back.at(t)[0][d], original.at(t)[0][d], atol=1e-5)
            np.testing.assert_allclose(back.at(t)[1], original.at(t)[1], atol=1e-4)
        assert json.loads((tmp_path / "j.json").read_text())["method"] == "authors"
    assert "note:" in capsys.readouterr().out
    with pytest.raises(DataFormatError, match="exists already"):
        main([str(path), str(tmp_path / "a.npz")])
    with pytest.raises(DataFormatError, match="suffix"):
        main([str(path), str(tmp_path / "a.xyz")])


def test_trajectories_stay_trajectories(tmp_path):
    Trajectory(np.arange(3) * 0.1, np.zeros((3, 2, 3)), np.ones((3, 2)), np.ones((2, 3)), np.ones((2, 4))).save(
        tmp_path / "t.npz"
    )
    assert main([str(tmp_path / "t.npz"), str(tmp_path / "u.npz")]) == 0
    assert read_result(tmp_path / "u.npz").method == "trajectory"
    with pytest.raises(DataFormatError, match="closed form"):
        main([str(tmp_path / "t.npz"), str(tmp_path / "u.ply")])


def test_clip_of_an_ftgs_ply(tmp_path, gaussians):
    gaussians.save(tmp_path / "g.npz")  # some are always on
    with pytest.raises(DataFormatError, match="--clip"):
        main([str(tmp_path / "g.npz"), str(tmp_path / "g.ftgs.ply")])


def test_convert_moves_a_result_into_a_datasets_world(tmp_path, tiny_dataset, capsys):
    """A method that trained in a world of its own, 2.5 times as large, turned and moved, with its cameras beside it."""
    g, T = random_gaussians(30), similarity()
    trained(g, T).save(tmp_path / "theirs.npz")
    ours = {c.name: c.world_to_camera for c in Dataset.open(tiny_dataset).cameras}
    theirs = {name: np.linalg.inv(moved_camera(T, np.linalg.inv(pose))).tolist() for name, pose in ours.items()}
    (tmp_path / "cameras.json").write_text(json.dumps(theirs))
    files = [str(tmp_path / "theirs.npz"), str(tmp_path / "ours.npz")]
    assert main([*files, "--align", str(tmp_path / "cameras.json"), "--dataset", str(tiny_dataset)]) == 0
    back = read_result(tmp_path / "ours.npz").gaussians
    for name in ("position", "velocity", "scale", "opacity", "t_mu"):
        np.testing.assert_allclose(getattr(back, name), getattr(g, name), atol=2e-5)
    assert "moved by the similarity of" in capsys.readouterr().out
    for half in (["--align", str(tmp_path / "cameras.json")], ["--dataset", str(tiny_dataset)]):
        with pytest.raises(GofError, match="go together"):
            main([files[0], str(tmp_path / "x.npz"), *half])


def test_plates_that_stay_behind_are_named(tmp_path, capsys):
    """Beside another folder's file, `gof evaluate` would take the dataset's plates without a word."""
    result = tmp_path / "mine" / "result.npz"
    result.parent.mkdir()
    random_gaussians(5).save(result)
    main([str(result), str(tmp_path / "a.npz")])
    assert "own plates" not in capsys.readouterr().out
    (result.parent / "plates").mkdir()
    main([str(result), str(tmp_path / "b.npz")])
    shown = "".join(capsys.readouterr().out.split())  # lines break anywhere in a path
    assert f"itsownplatesstayin{result.parent / 'plates'}" in shown and str(tmp_path / "plates") in shown
    main([str(result), str(result.parent / "c.npz")])
    assert "own plates" not in capsys.readouterr().out


@pytest.mark.parametrize("name", ["a.npz", "a.4dgs", "a.ply"])
def test_a_flame_alone_stays_one(tmp_path, name):
    """Another method's is drawn over the plates, as its author said, in whatever file it is kept."""
    path, _ = lookalikes.authors(tmp_path / "model")
    out = tmp_path / name
    assert main([str(path), str(out), "--flame-only"]) == 0
    options, _ = with_sidecar(out, ImportOptions())
    assert options.flame_only and read_result(out, options).flame_only
    assert main([str(path), str(out), "--overwrite"]) == 0, "and no longer where it is not said"
    assert not with_sidecar(out, ImportOptions())[0].flame_only
