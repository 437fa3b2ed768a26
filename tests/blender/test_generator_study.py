"""`gof study generate` at toy size, as a user runs it: what it measures, and that finished runs are kept."""

import json

import pytest

from gof.commands.cli import main
from gof_benchmark.scenes import load_scene


@pytest.mark.slow
@pytest.mark.blender
def test_generator_study(tmp_path):
    spec = load_scene("demo", "toy").to_dict()
    spec["render"]["percentage"] = 10
    (tmp_path / "toy.json").write_text(json.dumps(spec))
    out = tmp_path / "out"
    command = ["study", "generate", "--scene", str(tmp_path / "toy.json"), "--out", str(out)]
    command += ["--resolutions", "12", "16", "24", "--samples", "1", "16", "--frames", "2"]
    assert main(command) == 0

    figures = json.loads((out / "study.json").read_text())
    *_, finest = figures["resolution"]
    assert [row["resolution"] for row in figures["resolution"]] == [12, 16, 24]
    truth = (finest["error"], finest["error_mean"], finest["speed_ratio"])
    assert truth == pytest.approx((0, 0, 1), abs=1e-6)
    assert all(row["error"] > 0 and row["cpu_s"] > 0 and row["peak_mb"] > 50 for row in figures["resolution"][:-1])

    reference, denoised, traced = figures["samples"]
    assert (reference["samples"], reference["denoise"], reference["error"]) == (16, False, 0)
    assert (denoised["denoise"], traced["denoise"]) == (True, False) and traced["error"] > 0

    half, single = ([r for r in figures["storage"] if r["dtype"] == dtype] for dtype in ("float16", "float32"))
    assert all(h["mb"] < s["mb"] for h, s in zip(half, single, strict=True))
    assert all(r["max_error_m_s"] == 0 for r in single) and all(r["max_error_m_s"] > 0 for r in half)

    page = (out / "study.md").read_text()
    for part in ("resolution", "samples", "storage"):
        assert f"## {part}" in page and (out / f"{part}.svg").read_text().startswith("<svg")

    before = {path: path.stat().st_mtime_ns for path in out.rglob("study-cost.json")}
    assert len(before) == 3 + 3 and main(command) == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}, "finished runs are kept"
