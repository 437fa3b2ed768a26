"""The rows of finished scores, beside what the files say."""

import json

import pytest

from gof.evaluate.scores import AroundScore
from gof.sample import unpack_sample
from gof_benchmark.evidence import few_cameras, run_scores


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


def test_views_beside_one_camera_or_two_count_where_they_stand():
    """Neither a view near a given camera, nor one from behind, nor the one from above is a side."""
    places = {"around_010": (10, 30), "around_040": (40, 20), "around_060": (60, 18), "around_095": (95, 15)}
    places |= {"around_180": (180, 25), "around_top": (88, 5)}
    views = [AroundScore(camera=n, angle_deg=angle, pictures=1, psnr_flame=psnr) for n, (angle, psnr) in places.items()]
    at_45, at_90, at_135 = few_cameras.at_sides(views)
    assert (at_45, at_90) == (19, 15) and at_135 != at_135
    assert few_cameras.choose_cameras(3)["two cameras"] == [0, 1]
    assert list(few_cameras.choose_cameras(2)) == ["all cameras"]
