"""The report on a synthetic flame: complete, self-contained, decodable, and honest about bad scores."""

import base64
import hashlib
import io
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gof.commands.report import main
from gof.core.costs import StageLog
from gof.core.errors import DataFormatError
from gof.core.files import digest
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.scores import Agreement, AroundScore, EveFigures, Scores
from gof.look.report import Preview, answers, build_report
from gof.look.score_table import OWN, ScoreTable
from gof.reconstruct.captions import Caption, Captions
from tests.browser import Browser, chromium, page_address
from tests.evaluate.synthetic_flame import flame_dataset

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A folder as the demo leaves it: dataset, reconstruct/result.npz with stage pictures, scores, costs, preview."""
    out = tmp_path_factory.mktemp("demo")
    truth = flame_dataset(out / "dataset")
    (out / "reconstruct/stages").mkdir(parents=True)
    truth.save(out / "reconstruct/result.npz")
    Image.fromarray(np.full((30, 40, 3), 90, np.uint8)).save(out / "reconstruct/stages/1_masks.png")
    Captions((Caption("1_masks.png", "Motion <masks> & flow"),)).write(out / "reconstruct/stages")
    StageLog(out / "dataset/costs.json").record("render", 61.5, 800)
    StageLog(out / "reconstruct/costs.json").record("flow_field", 8, 1200)
    StageLog(out / "reconstruct/costs.json").record("optimize", 122, 1500)
    Image.fromarray(np.full((64, 36, 3), 60, np.uint8)).save(out / "blender.png")
    Preview("blender.png", 1, 4).write(out / "preview.json")
    evaluate(out / "reconstruct/result.npz", Dataset.open(out / "dataset")).write(out / "scores.json")
    assert main([str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def page(out):
    return (out / "report.html").read_text()


def test_page_needs_no_network_and_no_other_file(page):
    assert not re.search(r"https?:|//[\w-]+\.|<script src|<link|@import|<iframe", page)
    references = re.findall(r"""(?:src|srcset|href)=["']?([^"'\s>]{1,30})""", page) + re.findall(
        r"url\(([^)]{1,30})", page
    )
    assert references and all(r.startswith(("data:image/", "#")) for r in references), "# is a place in the page"
    assert "default-src 'none'" in page  # and the browser is told to enforce it
    [script] = re.findall(r"<script>(.*?)</script>", page, re.S)
    assert f"script-src 'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'" in page


def test_all_images_decode_and_the_animation_has_every_frame(out, page):
    images = [
        Image.open(io.BytesIO(base64.b64decode(data))) for data in re.findall(r"data:image/\w+;base64,([^\"]+)\"", page)
    ]
    for image in images:
        image.load()
    # animation, still, legend, truth and reconstruction of 2 cameras, preview pair, one stage picture,
    # and of each camera picture, plate, the fire's own light, difference
    assert len(images) == 3 + 4 + 2 + 1 + 2 * 4
    animated = [i for i in images if getattr(i, "n_frames", 1) > 1]
    assert len(animated) == 1 and animated[0].n_frames == len(Dataset.open(out / "dataset").times_s)
    assert (out / "pictures/animation.webp").stat().st_size > 1000 and (out / "pictures/animation.png").exists()


def test_scores_trivial_baselines_costs_and_origin_are_on_the_page(out, page):
    scores = json.loads((out / "scores.json").read_text())
    for value in (
        f"{scores['dve']['l2']:.3f}",
        f"{scores['trivial_baselines']['constant']['cos_sim']:.3f}",
        f"{scores['psnr_flame']:.2f}",
        f"{scores['psnr_flame_plate']:.2f}",
        "2 min 2 s",
        "61.5 s",
        "1,500 MB",
        "Motion &lt;masks&gt; &amp; flow",
        "drjit",
        "held out",
    ):
        assert value in page, value
    assert "flow field" in page and "flow_field" not in page
    assert str(out) not in page  # nothing of this machine's folders
    assert re.search(r'<span class="soft">\d{4}-\d\d-\d\d, gof report \d+\.\d+', page), "the page says what it is"


def test_the_answer_stands_above_the_film(page):
    first = page.partition('class="hero"')[0]
    assert re.findall(r"<div class=\"(?:good|bad)\">([^<]*)<b>", first)[:2] == [
        "motion error (DVE L2)",
        "speed over true speed (DVE)",
    ]
    assert "time it took<b>2 min 10 s</b>" in first, "122 s and 8 s"
    assert "<li>" not in first and "no grids/flame.zarr" in page, "warnings stand below the scores"


def test_no_folder_of_this_machine_stands_on_the_page(out, tmp_path):
    data = json.loads((out / "dataset/dataset.json").read_text())
    shutil.copytree(out / "dataset", tmp_path / "dataset")
    named = data | {
        "provenance": {"source": "/home/ada l/fires/cam_0.mp4", "rate": "m/s or 1/2", "disk": r"C:\Users\ada l\x.mp4"}
    }
    (tmp_path / "dataset/dataset.json").write_text(json.dumps(named))
    scores = replace(Scores.read(out / "scores.json"), warnings=("'/srv/ada/a.npz' is odd; see docs/scores.md",))
    page = build_report(
        tmp_path, Dataset.open(tmp_path / "dataset"), out / "reconstruct/result.npz", scores
    ).read_text()
    text = re.sub(r"data:image/[^\"\s]+", "", page)
    assert "ada" not in re.findall(r"\w+", text)
    for kept in (
        "<td>cam_0.mp4</td>",
        "<td>x.mp4</td>",
        "<td>m/s or 1/2</td>",
        "a.npz&#39; is odd; see docs/scores.md",
    ):
        assert kept in text, kept


def test_report_is_replaced_whole(out):
    before = (out / "report.html").read_text()
    assert main([str(out), "--camera", "0"]) == 0
    after = (out / "report.html").read_text()
    assert after != before and "cam_0, all" in after and not list(out.glob("**/*.partial*"))


def test_without_truth_masks_scores_and_extras(tmp_path):
    truth = flame_dataset(tmp_path / "real", frames=5, velocity=False, masks=False)
    result = truth.save(tmp_path / "result.npz")
    dataset = Dataset.open(tmp_path / "real")
    page = build_report(tmp_path, dataset, result, evaluate(result, dataset)).read_text()
    assert "n/a" in page and "velocity, truth" not in page and "velocity, reconstruction" in page
    assert "What it cost" not in page and "In Blender" not in page and "no true velocity" in page


def test_frames_in_which_nothing_lives(tmp_path):
    g = flame_dataset(tmp_path / "data", frames=5)
    short = TransientGaussians(
        **{n: getattr(g, n) for n in g.__dataclass_fields__}
        | {"t_sigma": np.full(len(g), 1e-4), "t_mu": np.full(len(g), 0.01)}
    )
    result = short.save(tmp_path / "result.npz")
    dataset = Dataset.open(tmp_path / "data")
    scores = evaluate(result, dataset)
    assert scores.dve.frames_scored == 1
    assert build_report(tmp_path, dataset, result, scores).exists()


def test_missing_pieces_are_named(out, tmp_path):
    with pytest.raises(DataFormatError, match=r"scores\.json"):
        main([str(tmp_path)])
    dataset = Dataset.open(out / "dataset")
    with pytest.raises(DataFormatError, match="preview"):
        build_report(
            tmp_path,
            dataset,
            out / "reconstruct/result.npz",
            Scores.read(out / "scores.json"),
            preview=Preview("none.png", 0, 0),
        )


def scores_of(found, l2, cos_sim, speed, psnr):
    """Scores whose baselines are known: constant 0.5 / 0.9, height mean 0.4 / 0.9, plate 20 dB, 2D 22 dB."""
    others = {"zero": (1.0, 0.0), "random": (1.4, 0.0), "constant": (0.5, 0.9), "height_mean": (0.4, 0.9)}
    others["true_centre"] = (0.1, 0.99)  # knows the truth: not there to be beaten
    base = found.trivial_baselines["constant"]
    return replace(
        found,
        dve=replace(found.dve, l2=l2, cos_sim=cos_sim, speed_ratio=speed, eve=None),
        trivial_baselines={name: replace(base, l2=a, cos_sim=b) for name, (a, b) in others.items()},
        psnr_flame=psnr,
        psnr_flame_plate=20.0,
        psnr_flame_between=22.0,
        gaussians=1234,
        dynamic_gaussians=1234,
    )


def test_answers_say_whether_a_score_is_good(out):
    found = Scores.read(out / "scores.json")
    good = answers(scores_of(found, 0.3, 0.95, 0.9, 25), 130.0)
    assert [(a.name, a.figure, a.good) for a in good] == [
        ("motion error (DVE L2)", "0.300", True),
        ("speed over true speed (DVE)", "0.90", True),
        ("flame PSNR, held-out pictures", "25.0 dB", True),
        ("time it took", "2 min 10 s", None),
    ]
    assert good[0].lines == ("best trivial baseline 0.400: beaten",), "of those that do not know the truth"
    assert good[2].lines == ("2D baseline 22.0 dB: beaten",) and good[3].lines == ("for 1,234 Gaussians",)
    bad = answers(scores_of(found, 0.45, 0.95, 1.3, 21), None)
    assert [a.good for a in bad] == [False, False, False, None] and bad[-1].figure == "1,234"
    assert bad[0].lines == ("best trivial baseline 0.400: not beaten",) and "too fast" in bad[1].lines[0]
    assert bad[2].lines == ("2D baseline 22.0 dB: not beaten",)
    filmed = replace(scores_of(found, 1, 0, 1, 21), dve=None, trivial_baselines={}, psnr_flame_between=None)
    assert [(a.name, a.good) for a in answers(filmed, 50.0)] == [
        ("flame PSNR, held-out pictures", True),
        ("time it took", None),
        ("Gaussians", None),
    ]
    assert answers(filmed, 50.0)[0].lines == ("background alone 20.0 dB: beaten",)


def test_the_motion_is_judged_where_the_fire_is_and_pictures_from_other_sides(out):
    found = scores_of(Scores.read(out / "scores.json"), 0.3, 0.95, 0.9, 25)
    two = {name: Agreement(l2, 0.9) for name, l2 in (("constant", 0.5), ("mean_field", 0.2), ("true_centre", 0.1))}
    eve = EveFigures(
        l2=0.35,
        cos_sim=0.9,
        l2_sd=None,
        cos_sim_sd=None,
        fluctuation=Agreement(1.0, 0.0),
        empty=0.0,
        speed_ratio=0.7,
        l2_axis=None,
        undefined="",
        frames=(),
        baselines=two,
    )
    around = tuple(
        AroundScore(camera=f"a{angle}", angle_deg=angle, pictures=2, psnr_flame=psnr)
        for angle, psnr in ((0.0, 40.0), (10.0, 30.0), (55.0, 20.0), (144.0, 26.0))
    )
    both = replace(found, dve=replace(found.dve, eve=eve), around=around)
    motion, speed, pictures, _ = answers(both, 1.0)
    assert (motion.name, motion.figure, motion.good) == ("motion error (EVE L2)", "0.350", False)
    assert motion.lines == ("best trivial baseline 0.200: not beaten", "by DVE 0.300 against 0.400: beaten")
    assert (speed.figure, speed.good, speed.lines[1]) == ("0.70", False, "by DVE 0.90")
    assert pictures.lines[-1] == "from other sides (55° to 144°) 23.0 dB", "the mean of 20 and 26"
    table = ScoreTable.of(both)
    cells = {row.name: dict(zip(table.headings, row.cells, strict=True)) for row in table.rows}
    place = cells["mean true velocity of each place"]
    assert place["EVE L2\N{NO-BREAK SPACE}↓"] == ("0.200", True) and place["DVE L2\N{NO-BREAK SPACE}↓"] == ("", False)


def test_the_table_holds_the_result_above_its_baselines_and_marks_what_is_better(out):
    table = ScoreTable.of(scores_of(Scores.read(out / "scores.json"), 0.45, 0.8, 1.0, 25))
    assert [heading.split("\N{NO-BREAK SPACE}")[1] for heading in table.headings] == list("↓↑↑↑↑↑")
    assert table.rows[0].name == OWN and [row.own for row in table.rows] == [True] + [False] * (len(table.rows) - 1)
    cells = {row.name: row.cells for row in table.rows}
    assert [cell.text for cell in cells[OWN][:3]] == ["0.450", "0.800", "25.00"]
    assert cells["one constant vector"][:2] == [("0.500", False), ("0.900", True)]
    assert cells["mean true velocity of each height"][:2] == [("0.400", True), ("0.900", True)]
    assert cells["two frames around"][0].text == "" and cells["two frames around"][2] == ("22.00", False)
    assert cells["standing still"][:2] == [("1.000", False), ("0.000", False)] and table.is_beaten
    assert not ScoreTable.of(replace(Scores.read(out / "scores.json"), dve=None, images=None)).rows


def test_the_latex_table_is_whole(out):
    """Every row has as many cells as there are columns, units are in the header, and no character is left bare."""
    table = ScoreTable.of(scores_of(Scores.read(out / "scores.json"), 0.45, 0.8, 1.0, 25))
    comment, *lines = table.latex("a_fire\nof 50 %").splitlines()
    assert comment.startswith("% a_fire of 50 %") and len(lines) == len(table.rows) + 6
    columns = re.fullmatch(r"\\begin\{tabular\}\{(l(r+))\}", lines[0])[1]
    rows = [line for line in lines if line.endswith(r" \\")]
    assert lines[-1] == r"\end{tabular}" and lines.count(r"\hline") == 3 and len(rows) == len(table.rows) + 1
    assert {row.count(" & ") + 1 for row in rows} == {len(columns)}
    assert r"DVE $L_2$ $\downarrow$ & DVE CosSim $\uparrow$ & PSNR flame (dB) $\uparrow$" in rows[0]
    assert rows[1].startswith("this reconstruction & 0.450 & 0.800 & 25.00 &")
    assert "\n".join(rows).isascii() and not re.search(r"(?<!\\)[%#]", "\n".join(rows))


# ---------------------------------------------------------------- in a browser

in_a_browser = pytest.mark.skipif(chromium() is None, reason="no Chromium here: the report is not drawn")


@in_a_browser
def test_button_and_line_work_and_the_ground_is_black_on_a_screen_and_white_on_paper(out):
    with Browser() as browser:
        browser.open(page_address(out / "report.html"))
        ground = "getComputedStyle(document.body).backgroundColor"
        assert browser.run(ground) == "rgb(0, 0, 0)"
        chart = "getComputedStyle(document.querySelector('.chart text')).fill"
        assert browser.run(chart) == "rgb(236, 231, 224)", "letters of charts are light"
        clip = "getComputedStyle(document.querySelectorAll('.wipe img')[1]).clipPath"
        assert browser.run(clip) == "inset(0px 0px 0px 50%)"
        browser.run("document.querySelector('.wipe input').focus()")
        for _ in range(3):
            browser.key("ArrowRight")
        assert browser.run(clip) == "inset(0px 0px 0px 53%)"
        browser._ask("Browser.grantPermissions", {"permissions": ["clipboardReadWrite", "clipboardSanitizedWrite"]})
        browser.run("document.getElementById('copy').click()")
        assert (
            browser.run("new Promise(r => setTimeout(() => r(document.getElementById('copy').textContent), 500))")
            == "Copied"
        )
        copied = browser.run("navigator.clipboard.readText()")
        table = ScoreTable.of(Scores.read(out / "scores.json"))
        assert copied.partition("\n")[2] == table.latex("").partition("\n")[2] and copied.startswith("% dataset, gof ")
        browser.ask("Emulation.setEmulatedMedia", {"media": "print"})
        assert browser.run(ground) == "rgb(255, 255, 255)" and browser.run(chart) == "rgb(28, 28, 30)"
        assert browser.run("getComputedStyle(document.getElementById('copy')).display") == "none"
        assert browser.errors == [] and browser.requests == [page_address(out / "report.html")]


OUTSIDE = """[...document.querySelectorAll("main *")].filter((e) => e.getBoundingClientRect().right > 391
    && !e.closest(".scroll, .around, .removal, .wipe, svg")).map((e) => e.outerHTML.slice(0, 80))"""


@in_a_browser
def test_nothing_runs_out_of_a_phone(out):
    with Browser(390, 844, mobile=True) as browser:
        browser.open(page_address(out / "report.html"))
        assert browser.run("document.documentElement.scrollWidth") == 390 and browser.run(OUTSIDE) == []
        browser.run("document.querySelector('.what').style.width = '500px'")
        assert len(browser.run(OUTSIDE)) > 0, "the check can fail"
        pair = browser.run("[...document.querySelectorAll('.pair img')].map((e) => [e.width, e.height])")
        assert pair[0] == pair[1], "truth and cloud have one size"


def test_scores_of_an_older_version_are_refused_with_the_remedy(out, tmp_path):
    content = json.loads((out / "scores.json").read_text())
    del content["schema"], content["version"]  # as before they were a record
    (tmp_path / "scores.json").write_text(json.dumps(content))
    with pytest.raises(
        DataFormatError, match=r"scores\.json: not schema 'gof-scores' version 1; to write it: gof evaluate"
    ):
        main([str(tmp_path)])


def test_a_filmed_fire_is_not_called_a_simulation(out, tmp_path):
    """Nobody measured how a real fire moves: the page must not claim it, and says at what size its pictures scored."""
    data = json.loads((out / "dataset/dataset.json").read_text())
    shutil.copytree(out / "dataset", tmp_path / "dataset")
    real = data | {"velocity": None, "spec": None}
    (tmp_path / "dataset/dataset.json").write_text(json.dumps(real))
    shutil.copytree(out / "reconstruct", tmp_path / "reconstruct")
    scores = evaluate(tmp_path / "reconstruct/result.npz", Dataset.open(tmp_path / "dataset"))
    camera = data["cameras"][0]
    assert scores.dve is None and scores.images.sizes_px == ((camera["width"], camera["height"]),)
    scores.write(tmp_path / "scores.json")
    assert main([str(tmp_path)]) == 0
    text = re.sub(r"data:image/[^\"\s]+", "", (tmp_path / "report.html").read_text())
    assert "simulation" not in text and "truth" not in text and "true frame" not in text
    assert "The fire was filmed" in text and "<div>filmed</div>" in text and "in m/s" in text
    assert f"of {camera['width']}x{camera['height']} px against what was filmed" in text
    no_length = real | {"provenance": {"scale": "unknown: the unit is the distance between first and last camera"}}
    (tmp_path / "dataset/dataset.json").write_text(json.dumps(no_length))
    assert main([str(tmp_path)]) == 0
    assert "the unit of length is not known" in (tmp_path / "report.html").read_text()


def test_a_preview_of_another_result_is_left_out(out, tmp_path, capsys):
    shutil.copytree(out, tmp_path / "demo")
    folder, words = tmp_path / "demo", "imported as an animated point cloud"
    TransientGaussians.load(folder / "reconstruct/result.npz").save(folder / "reconstruct/result.ply")
    same = [digest(folder / "reconstruct" / name) for name in ("result.npz", "result.ply")]
    for result, shown in ((same[0], True), (same[1], True), ("0" * 16, False)):
        Preview("blender.png", 1, 4, result).write(folder / "preview.json")
        assert main([str(folder)]) == 0
        assert (words in (folder / "report.html").read_text()) is shown
        assert ("blender.png is of another result" in capsys.readouterr().out) is not shown
