"""What a file holds after a write that failed."""

import json

import pytest

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, write_json
from gof.io.convert import convert
from gof.io.importers import read_result
from tests.conftest import random_gaussians


def test_atomic_write_keeps_the_old_file_on_failure(tmp_path):
    write_json(tmp_path / "a.json", {"x": 1})
    with pytest.raises(RuntimeError), atomic_path(tmp_path / "a.json") as temporary:
        temporary.write_text("half")
        raise RuntimeError
    with pytest.raises(ValueError):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": 1}
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("name", ["a.splat", "a.txt", "a.NPZ", "a.usdz"])
def test_a_suffix_that_no_format_has_names_all_that_there_are(tmp_path, name):
    random_gaussians(5).save(tmp_path / "g.npz")
    with pytest.raises(DataFormatError, match=f"{name}: no format ends in") as caught:
        convert(read_result(tmp_path / "g.npz"), tmp_path / name)
    for suffix in ".npz .ply .4dgs .tsog .dgs .usda .usdc .glb .spz .sog".split():
        assert f"{suffix}," in str(caught.value)


def test_a_folder_of_ours_without_gaussians_is_called_by_its_name(tmp_path):
    (tmp_path / "settings.json").write_text("{}")
    with pytest.raises(DataFormatError, match="has not finished: run the same 'gof reconstruct' again"):
        read_result(tmp_path)
    (tmp_path / "dataset.json").write_text("{}")
    with pytest.raises(DataFormatError, match="is a dataset, and no result"):
        read_result(tmp_path)
