"""The rows of finished scores, beside what the files say."""

import json

import pytest

from gof.sample import unpack_sample
from gof_benchmark.evidence import run_scores


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample")
    unpack_sample(folder / "sample")
    return folder / "sample/submission/fire"


def test_two_runs_are_one_row_of_their_mean(folder, tmp_path, capsys):
    scores = json.loads((folder / "scores.json").read_text())
    l2 = scores["dve"]["l2"]
    scores["dve"]["l2"] = l2 + 0.2
    (tmp_path / "scores.json").write_text(json.dumps(scores))
    run_scores.main([f"two={folder},{tmp_path}"])
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("| two |"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1] == f"{l2 + 0.1:.3f} ± 0.141"  # two values 0.2 apart: 0.2 / sqrt 2
    assert cells[2] == f"{scores['dve']['cos_sim']:.3f}"


def test_views_count_for_the_nearest_angle(folder):
    (_, [scores]) = run_scores.read_runs(f"one={folder}")
    found = run_scores.by_angle([scores], "psnr_flame", 1)
    assert found == ["-"] * len(run_scores.ANGLES) if not scores.around else len(found) == len(run_scores.ANGLES)
