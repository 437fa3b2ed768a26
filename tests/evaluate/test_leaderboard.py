"""Tables, fronts, stream plots and the page."""

import csv
import io
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.commands.evaluate import main as evaluate_main
from gof.commands.leaderboard import SHOWN, _table, main
from gof.core.costs import Costs, StageCost
from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.core.records import read_record, write_record
from gof.evaluate.leaderboard import Leaderboard, best_rows, collect, pareto, rows_of, to_csv, to_markdown, used_columns
from gof.host.terminal import console
from gof.look.boards import max_projection, volume, x_slice
from tests.evaluate.synthetic_flame import flame_dataset

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two evaluated results, the truth and one at half speed, and one whose file is gone."""
    folder = tmp_path_factory.mktemp("board")
    truth = flame_dataset(folder / "data")
    for name, factor in (("exact", 1.0), ("slow", 0.5), ("gone", 0.8)):
        (folder / name).mkdir()
        fields = {n: getattr(truth, n) for n in truth.__dataclass_fields__} | {"velocity": factor * truth.velocity}
        TransientGaussians(**fields).save(folder / name / "result.npz")
        assert (
            evaluate_main(
                [
                    str(folder / name / "result.npz"),
                    "--dataset",
                    str(folder / "data"),
                    "--out",
                    str(folder / name),
                    "--no-images",
                ]
            )
            == 0
        )
    (folder / "exact/method.json").write_text(json.dumps({"name": "Exact | <b>method</b>", "train_seconds": 100}))
    write_record(folder / "slow/costs.json", Costs((StageCost("a", 4.5, 0.0), StageCost("b", 5.5, 0.0))))
    (folder / "gone/result.npz").unlink()
    return folder


def test_rows(results):
    rows = rows_of(collect([results / n for n in ("exact", "slow", "gone")]))
    exact, slow, gone = rows[:3]
    assert exact.name.startswith("Exact") and (exact.train_s, slow.train_s, gone.train_s) == (100, 10, None)
    assert exact.l2 < 0.02 < slow.l2 and slow.speed_ratio == pytest.approx(0.5, abs=0.02) and exact.evaluate_s > 0
    assert len(rows) == 3, "no trivial baseline of one of them stands for all"
    for name, row in zip(("exact", "slow", "gone"), rows, strict=True):
        scores = json.loads((results / name / "scores.json").read_text())
        own = [
            trivial_baseline for kind, trivial_baseline in scores["trivial_baselines"].items() if kind != "true_centre"
        ]
        assert row.baseline_l2 == min(trivial_baseline["l2"] for trivial_baseline in own)
        assert row.baseline_cos == max(trivial_baseline["cos_sim"] for trivial_baseline in own)
    alone = rows_of(collect([results / "exact"]))
    assert [r.name for r in alone[1:]] == [
        f"trivial: {n}" for n in ("zero", "random", "shuffled", "constant", "height_mean", "true_centre")
    ]
    best = best_rows(rows)
    assert best["l2"] == 0 and best["train_s"] == 1 and "speed_ratio" not in best and "gaussians" not in best
    with pytest.raises(DataFormatError, match="gof evaluate"):
        collect([results / "data"])


def test_seconds_are_found_beside_the_result_that_was_scored(results, tmp_path):
    (tmp_path / "trained").mkdir()
    shutil.copy(results / "exact/result.npz", tmp_path / "trained")
    write_record(tmp_path / "trained/costs.json", Costs((StageCost("optimise", 7.5, 0.0),)))
    words = [
        f"{tmp_path}/trained/result.npz",
        "--dataset",
        f"{results}/data",
        "--out",
        f"{tmp_path}/board",
        "--no-images",
    ]
    assert evaluate_main(words) == 0
    (board,) = collect([tmp_path / "board"])
    assert board.train_s == 7.5 and board.memory_mb is None, "0: not measured"


def test_numbers_stay_whole_in_a_narrow_window(results, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    results = collect([results / n for n in ("exact", "slow")])
    rows = rows_of([replace(result, name=f"{result.name} of a long name") for result in results])
    console().print(_table("Leaderboard", rows))
    printed = capsys.readouterr().out
    assert "…" not in printed and max(map(len, printed.splitlines())) <= 80
    numbers = [word for line in printed.splitlines() if " slow" in line for word in line.split() if word[0].isdigit()]
    assert numbers == [rows[1].text(key) for key in used_columns(rows) if key in SHOWN]


def test_a_scores_file_stands_for_its_folder(results, tmp_path, capsys):
    (one,) = collect([results / "exact/scores.json"])
    assert one.folder == results / "exact"
    assert main([str(results / "exact/scores.json"), "--out", str(tmp_path / "board")]) == 0
    assert (tmp_path / "board/leaderboard.html").is_file()
    with pytest.raises(DataFormatError, match=r"none: no scores.json; run .* --out \S*none'"):
        collect([tmp_path / "none/scores.json"])
    with pytest.raises(DataFormatError, match="result.npz: a file; name the folder"):
        collect([results / "exact/result.npz"])


def test_tables(results):
    rows = rows_of(collect([results / n for n in ("exact", "slow")]))
    table = list(csv.DictReader(io.StringIO(to_csv(rows))))
    assert float(table[1]["l2"]) == rows[1].l2 and table[0]["psnr"] == ""
    lines = to_markdown(rows).splitlines()
    assert (
        lines[2].startswith("| Exact \\| ")
        and f"**{rows[0].l2:.3f}**" in lines[2]
        and len(lines) == 4
        and "PSNR" not in lines[0]
    )


def test_a_training_that_was_stopped_says_so_and_competes_with_nobody(results, tmp_path):
    folder = tmp_path / "stopped"
    folder.mkdir()
    (folder / "scores.json").write_text((results / "exact/scores.json").read_text())
    about = {"name": "Theirs", "made_by": "CPU re-run", "train_seconds": 1.0, "given": ["plates", "starting points"]}
    (folder / "method.json").write_text(json.dumps(about | {"unfinished": "stopped at 300 of 7000 steps"}))
    rows = rows_of(collect([results / "slow", folder, results / "gone"]))
    assert rows[1].name == "Theirs (CPU re-run, stopped at 300 of 7000 steps)" and not rows[1].competes
    assert rows[1].l2 < rows[0].l2 and best_rows(rows)["l2"] != 1, "the best score of all wins nothing"
    assert rows[1].notes[0] == "given: plates, starting points"
    line = to_markdown(rows).splitlines()[3]
    assert line.startswith("| *Theirs ") and "300 of 7000" in line and "**" not in line
    (folder / "method.json").write_text(json.dumps(about))
    rows = rows_of(collect([results / "slow", folder, results / "gone"]))
    assert rows[1].name == "Theirs (CPU re-run)" and rows[1].competes and best_rows(rows)["l2"] == 1


def test_pareto_front():
    points = [(1, 5), (2, 4), (3, 6), (2, 9), (0.5, 1), (4, 6)]  # (seconds, score)
    assert pareto(points, +1) == [4, 0, 3] and pareto(points, -1) == [4]
    assert pareto([(1, 1), (1, 2)], +1) == [1] and pareto([], 1) == []


def test_projection_shows_the_densest_cell_of_each_column():
    density, velocity = np.zeros((4, 5, 3)), np.zeros((4, 5, 3, 3))
    density[1, 2, 0], density[1, 4, 0] = 2, 5
    velocity[1, 2, 0], velocity[1, 4, 0] = [9, 9, 9], [1, 2, 3]
    d, v = max_projection(density, velocity)
    assert d.shape == (4, 3) and d[1, 0] == 5 and v[1, 0].tolist() == [1, 3]
    d, v, i = x_slice(density, velocity)
    assert i == 1 and d[4, 0] == 5 and v[4, 0].tolist() == [2, 3]


def test_volume_keeps_mean_velocity_and_ignores_floaters():
    n = 4000
    rng = np.random.default_rng(0)
    position = rng.normal(0, 0.1, (n, 3))
    position[0] = [50, 0, 0]
    g = TransientGaussians(
        position=position,
        velocity=np.tile([0.1, 0.2, 3.0], (n, 1)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.full((n, 3), 0.01),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.5),
        color=np.zeros((n, 3)),
        dynamic=np.ones(n, bool),
    )
    v = volume(g, 0.0)
    assert v.cell < 0.02 and max(v.density.shape) <= 80
    dense = v.density > 0.1 * v.density.max()
    np.testing.assert_allclose(v.velocity[dense], np.tile([0.1, 0.2, 3.0], (dense.sum(), 1)), rtol=1e-6)
    centre = (v.centres() * v.density[..., None]).sum((0, 1, 2)) / v.density.sum()
    np.testing.assert_allclose(centre, 0, atol=0.02)


def test_page(results, capsys):
    out = results / "out"
    arguments = [str(results / n) for n in ("exact", "slow", "gone")]
    assert main([*arguments, "--dataset", str(results / "data"), "--out", str(out), "--title", "A <board>"]) == 0
    assert "no stream plot of gone" in " ".join(capsys.readouterr().out.split())
    page = (out / "leaderboard.html").read_text()
    assert "A &lt;board&gt;" in page and "Exact | &lt;b&gt;method" in page
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="(?!data:)', page)  # nothing is loaded from elsewhere
    assert page.count('<svg class="chart"') == 8 + 2, "streams of two results, and scores of pictures"
    assert len(page) < 1e6, "no library is in it"
    side_by_side = 'alt="(truth|Exact[^"]*|slow|enlarged part|error[^"]*|true velocity|velocity)"'
    assert len(re.findall(side_by_side, page)) == 3 * (1 + 2 + 1 + 1), "of truth, exact and slow; of gone nothing"
    assert "held out. Each result is drawn as it was scored" in page
    assert read_record(Leaderboard, out / "leaderboard.json").rows == tuple(rows_of(collect([*map(Path, arguments)])))
    assert (out / "leaderboard.csv").is_file() and (out / "leaderboard.md").is_file()


def test_a_run_of_a_submission_has_its_name(results, tmp_path):
    run = tmp_path / "submission/fire"
    shutil.copytree(results / "slow", run)
    (run / "method.json").unlink(missing_ok=True)
    (tmp_path / "submission/method.json").write_text('{"name": "Theirs"}')
    assert [result.name for result in collect([run])] == ["Theirs"]


@pytest.mark.skipif(not shutil.which("chromium"), reason="chromium is not installed")
def test_page_in_a_browser(results, tmp_path):
    """Sorting works and nothing complains, in a real browser: a probe in the page writes what it saw into the title."""
    main([str(results / "exact"), str(results / "slow"), "--dataset", str(results / "data"), "--out", str(tmp_path)])
    page = (tmp_path / "leaderboard.html").read_text()
    watch = """<script>
    window.faults = [];
    window.onerror = m => { faults.push(m); };
    console.error = m => { faults.push(m); };
    </script>"""
    probe = """<script>
    const rows = () => [...document.querySelectorAll("#scores tbody tr")].slice(0, 2);
    const names = () => rows().map(r => r.cells[0].textContent);
    const button = [...document.querySelectorAll("#scores th button")].find(b => b.textContent === "DVE L2");
    button.click(); const up = names(); button.click(); const down = names();
    const charts = () => [...document.querySelectorAll("svg.chart")].filter((svg) => svg.getBBox().width > 50).length;
    setTimeout(() => { document.title = JSON.stringify({up, down, faults, charts: charts()}); }, 500);
    </script>"""
    (tmp_path / "probe.html").write_text(page.replace("<head>", "<head>" + watch).replace("</body>", probe + "</body>"))
    done = subprocess.run(
        [
            "chromium",
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            f"--user-data-dir={tmp_path}/profile",
            "--virtual-time-budget=5000",
            "--dump-dom",
            f"file://{tmp_path}/probe.html",
        ],
        capture_output=True,
        text=True,
        timeout=120,
    )
    seen = json.loads(re.search(r"<title>(.*?)</title>", done.stdout, re.S)[1])
    assert seen["faults"] == [] and seen["charts"] >= 2
    assert seen["up"][0].startswith("Exact") and "slow" in seen["down"]


@pytest.mark.parametrize("change", [{"order": 1}, {"opacity": "base"}])
def test_a_score_of_another_quadrature_or_weight_competes_with_nobody(results, tmp_path, change):
    """Python's `evaluate` may be told both; the same result then has another L2."""
    scores = json.loads((results / "exact/scores.json").read_text())
    scores["dve"] |= change
    (tmp_path / "own").mkdir()
    (tmp_path / "own/scores.json").write_text(json.dumps(scores))
    rows = rows_of(collect([results / "slow", tmp_path / "own", results / "gone"]))
    assert not rows[1].competes and "does not compete" in rows[1].notes[0] and rows[0].competes
    assert best_rows(rows)["l2"] != 1
