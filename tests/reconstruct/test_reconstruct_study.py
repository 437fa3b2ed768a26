"""`gof study ablations` and `gof study reconstruct` on a small flame, as a user runs them."""

import json

import pytest

from gof.commands.cli import main
from gof.commands.reconstruct import ReconstructConfig
from gof.reconstruct.presets import Effort
from gof_benchmark.studies import reconstruction
from gof_benchmark.studies.ablations import LEFT_OUT
from tests.look.printed import marks, texts
from tests.reconstruct.rising_flame import write_flame

SMALL = ["--gaussians", "600", "--max-size", "96"]


def test_every_ablation_has_a_name_in_the_table():
    from typing import get_args, get_type_hints

    assert set(get_args(get_type_hints(ReconstructConfig)["ablation"])) == set(LEFT_OUT.values())


@pytest.mark.slow
@pytest.mark.parametrize("method", ["gof", "paper"])
def test_ablations_study(tmp_path, capsys, method):
    folder = write_flame(tmp_path / "flame")
    command = ["study", "ablations", str(folder), "--out", str(tmp_path / "out"), "--steps", "60", *SMALL]
    command += ["--method", method]
    assert main(command) == 0
    rows = {row["name"]: row for row in json.loads((tmp_path / "out" / "ablations.json").read_text())}
    other = "paper" if method == "gof" else "gof"
    assert list(rows) == [*(f"{method}-{part}" for part in LEFT_OUT.values()), f"{other}-none"]
    assert rows[f"{method}-rand-flow"]["cos_sim"] < rows[f"{method}-none"]["cos_sim"] - 0.3
    text = (tmp_path / "out" / "ablations.md").read_text()
    assert all(name in text for name in LEFT_OUT)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("out/*/result.npz")}
    assert len(before) == 6 and main(command) == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}, "finished reconstructions are kept"


@pytest.mark.slow
def test_settings_study(tmp_path, monkeypatch):
    monkeypatch.setattr(reconstruction, "FACTORS", (0.5, 1))
    monkeypatch.setattr(reconstruction, "PRESETS", {"preview": Effort(20, 400, 24, 96)})
    monkeypatch.setattr("gof.reconstruct.presets.PRESETS", {"preview": Effort(20, 400, 24, 96)})
    folder = write_flame(tmp_path / "flame")
    command = ["study", "reconstruct", str(folder), "--out", str(tmp_path / "out"), "--steps", "60", *SMALL]
    assert main([*command, "--vary", "presets", "steps", "gaussians", "max-size"]) == 0
    rows = json.loads((tmp_path / "out" / "reconstruct.json").read_text())
    assert [row["group"] for row in rows] == [
        "presets",
        *(g for g in ("steps", "gaussians", "max-size") for _ in range(2)),
    ]
    few, many = (row["psnr_flame"] for row in rows if row["group"] == "steps")
    assert few < many
    for name in ("l2", "cos_sim", "psnr_flame"):
        svg = (tmp_path / "out" / f"{name}.svg").read_text()
        assert sum(map(len, marks(svg).values())) == len(rows)
        legend = {"presets", "number of steps", "number of Gaussians", "longer side of the pictures, px"}
        assert {"seconds of the reconstruction"} | legend <= set(texts(svg))


@pytest.mark.slow
def test_settings_study_of_choices_and_seeds(tmp_path, monkeypatch):
    """What several seeds say of a choice is the mean and the spread of what their own runs score."""
    of_plates = {"no flow prior": {}, "the paper's method": {"scene": "plates"}}  # nothing still to see in stereo
    choices = {name: reconstruction.CHOICES[name] | more for name, more in of_plates.items()}
    monkeypatch.setattr(reconstruction, "CHOICES", choices)
    folder, out = write_flame(tmp_path / "flame"), tmp_path / "out"
    command = ["study", "reconstruct", str(folder), "--out", str(out), "--steps", "60", *SMALL]
    assert main([*command, "--vary", "choices", "--seeds", "2"]) == 0
    rows = {row["name"]: row for row in json.loads((out / "reconstruct.json").read_text())}
    assert list(rows) == list(choices)
    runs = [json.loads((out / name / "study.json").read_text())["row"] for name in ("no-flow-prior", "no-flow-prior_1")]
    first, second = (run["l2"] for run in runs)
    assert first != second and rows["no flow prior"]["l2"] == pytest.approx((first + second) / 2)
    assert rows["no flow prior"]["l2_sd"] == pytest.approx(abs(first - second) / 2**0.5)
    settings = [
        json.loads((out / name / "settings.json").read_text()) for name in ("no-flow-prior", "the-papers-method")
    ]
    assert [made["flow_prior"] for made in settings] == [False, True] and settings[1]["method"] == "paper"
    assert set(rows) <= set(texts((out / "l2.svg").read_text()))
