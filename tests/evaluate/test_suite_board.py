"""The board: means, intervals, shared ranks and wins of made-up scores whose order is known; and the page."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gof.core.errors import DataFormatError
from gof.core.records import read_record, write_record
from gof.evaluate.alarms import too_good
from gof.evaluate.eddy_time import EddyTime
from gof.evaluate.leaderboard import EvaluatedResult
from gof.evaluate.method import AboutMethod
from gof.evaluate.scores import Agreement, EveFigures, FrameScore, PictureScore, Scores
from gof.evaluate.suite_board import Figure, ScoredScene, SuiteBoard, board, difference
from gof.evaluate.training_curve import TrainingCurve
from gof.look.boards import marks_of, remark, suite_html, suite_markdown
from gof.on_cpu.launch import LossRecorder

GOLDEN = Scores.read(Path(__file__).parents[1] / "golden/gof-scores.json")
FRAMES = 36
CLIPS = {name: np.random.default_rng(k).normal(0, 0.05, FRAMES) for k, name in enumerate(("a", "b", "c", "d"))}


def result(name: str, l2, train_s=100.0) -> EvaluatedResult:
    """A result with these L2 per frame; the flame's PSNR falls with it."""
    l2 = np.asarray(l2, float)
    frames = tuple(FrameScore(0.01 * k, float(v), float(1 - v / 2), 100, "") for k, v in enumerate(l2))
    pictures = tuple(
        PictureScore(camera=f"cam_{c}", frame=k, flame_share=0.1, psnr_flame=30 - 10 * l2[k] + c, ssim_flame=0.9)
        for k in (4, 12, 20, 28)
        for c in (0, 1)
    )
    eve = EveFigures(
        l2=float(l2.mean()),
        cos_sim=float(1 - l2.mean() / 2),
        l2_sd=0.002,
        cos_sim_sd=0.002,
        fluctuation=Agreement(0.9, 0.3),
        empty=0.0,
        speed_ratio=1.0,
        l2_axis=None,
        undefined="",
        frames=frames,
        baselines={name: Agreement(0.6, 0.8) for name in ("constant", "height_mean", "mean_field")}
        | {"true_centre": Agreement(0.1, 0.99)},
    )
    dve = replace(GOLDEN.dve, frames=frames, l2=float(l2.mean()), eve=eve)
    images = replace(GOLDEN.images, pictures=pictures, count=8)
    return EvaluatedResult(Path(), name, replace(GOLDEN, dve=dve, images=images), train_s)


def scene(name: str, **methods) -> ScoredScene:
    """Methods by name: an offset, or one per run, added to the scene's own frames."""
    runs = {
        method: tuple(result(method, 0.5 + CLIPS[name] + offset) for offset in np.atleast_1d(offsets))
        for method, offsets in methods.items()
    }
    return ScoredScene(name, "test", EddyTime(0.02, False), tuple(0.01 * k for k in range(FRAMES)), runs)


def drawn(here: ScoredScene, **over_plates) -> ScoredScene:
    """A scene whose methods are flames over plates (True), or whole scenes; one word for all runs, or one per run."""
    runs = {
        name: tuple(
            replace(run, scores=replace(run.scores, import_=replace(run.scores.import_, over_plates=said)))
            for run, said in zip(
                here.runs[name], np.resize(over_plates[name], len(here.runs[name])).tolist(), strict=True
            )
        )
        for name in here.runs
    }
    return replace(here, runs=runs)


def curve(losses) -> TrainingCurve:
    steps = range(10, 10 * len(losses) + 1, 10)
    return TrainingCurve(tuple(steps), tuple(0.5 * k for k in steps), tuple(map(float, losses)))


def methods(*names) -> dict[str, AboutMethod]:
    return {name: AboutMethod(name=name, given=("poses",), prior=()) for name in names}


def rows(found: SuiteBoard) -> dict:
    return {row.name: row for row in found.rows}


def test_a_better_method_is_ahead_and_equals_share():
    """'good' is better than the others everywhere; 'one' and 'two' win here and there."""
    scenes = [
        scene("a", good=-0.1, one=0.010, two=0.000),
        scene("b", good=-0.12, one=0.000, two=0.012),
        scene("c", good=-0.11, one=0.011, two=0.000),
        scene("d", good=-0.09, one=0.000, two=0.010),
    ]
    found = rows(board("t", methods("one", "two", "good"), scenes))
    assert [found[name].figures["eve_l2"].rank for name in ("good", "one", "two")] == [1, 2, 2]
    assert [found[name].figures["eve_l2"].wins for name in ("good", "one", "two")] == [4, 0, 0]
    assert [found[name].figures["psnr_flame"].rank for name in ("good", "one", "two")] == [1, 2, 2]


def test_the_mean_and_its_interval_are_those_of_the_scenes():
    offsets = (0.1, 0.3, 0.2)
    scenes = [scene(name, only=offset) for name, offset in zip("abc", offsets, strict=True)]
    figure = rows(board("t", methods("only"), scenes))["only"].figures["l2"]
    means = [0.5 + CLIPS[name].mean() + offset for name, offset in zip("abc", offsets, strict=True)]
    known = stats.ttest_1samp(means, 0).confidence_interval(0.95)
    assert figure.mean == pytest.approx(np.mean(means))
    assert 2 * figure.half_width == pytest.approx(known.high - known.low)
    assert figure.rank is None, "one method is not ranked"


def test_the_same_frames_are_compared():
    """A small difference in every frame is seen, though both means scatter with the clip; an uneven one is not."""
    here = scene("a", one=0.0, two=0.02)
    wave = 0.02 + 0.2 * np.sin(np.arange(FRAMES))
    uneven = replace(here, runs=here.runs | {"two": (result("two", 0.5 + CLIPS["a"] + wave),)})
    assert difference("l2", "one", "two", here).p_value < 1e-9
    assert difference("l2", "one", "two", uneven).p_value > 0.1
    assert difference("l2", "one", "two", here).mean == pytest.approx(-0.02)


def test_seeds_that_scatter_make_a_difference_doubtful():
    sure = scene("a", one=[0.0, 0.001, -0.001], two=[0.03, 0.031, 0.029])
    unsure = scene("a", one=[0.0, 0.05, -0.05], two=[0.03, 0.08, -0.02])
    assert difference("l2", "one", "two", sure).p_value < 0.01 < difference("l2", "one", "two", unsure).p_value
    figure = rows(board("t", methods("one", "two"), [unsure]))["one"].figures["l2"]
    assert figure.seed_sd == pytest.approx(0.05)


def test_who_is_not_everywhere_competes_with_nobody():
    scenes = [scene("a", full=0.1, part=-0.3), scene("b", full=0.1)]
    found = rows(board("t", methods("full", "part"), scenes))
    assert not found["part"].competes and found["part"].scenes == 1
    assert found["part"].figures["eve_l2"].rank is None and found["part"].figures["l2"].mean < 0.3
    stopped = {"full": AboutMethod(name="full", unfinished="stopped at 3 of 9 steps")}
    assert not rows(board("t", stopped, scenes))["full"].competes
    in_one = board("t", stopped | methods("part"), [scene("a", full=0.1, part=-0.3)]).scenes[0].figures
    assert in_one["full"]["eve_l2"].rank is None and in_one["part"]["eve_l2"].rank is None, "nor in one scene"


def test_a_mean_over_fewer_scenes_says_so_on_the_page():
    scenes = [
        scene("a", full=0.1, other=0.2, part=-0.3),
        scene("b", full=0.1, other=0.2),
        scene("c", full=0, other=0.1),
    ]
    found = board("t", methods("full", "other", "part"), scenes)
    page, table = suite_html(found, {}), suite_markdown(found)
    assert page.count("<small>in 1 of 3 scenes</small>") == 1
    assert re.search(r"^\| \*part\* .*\(in 1 of 3 scenes\) \| poses \| nothing \|", table, re.MULTILINE)
    assert "| full | poses | nothing |" in table
    assert rows(found)["part"].figures["eve_l2"].wins is None
    assert [rows(found)[name].figures["eve_l2"].rank for name in ("full", "other")] == [1, 2], "as without the third"
    assert found.scenes[0].figures["part"]["eve_l2"].rank == 1, "in its own scene it competes"
    assert "is ranked here" not in page


def test_where_nobody_is_everywhere_trivial_baselines_stay_and_it_is_said():
    found = board("t", methods("one", "two"), [scene("a", one=0.0), scene("b", two=0.1)])
    assert not any(row.competes for row in found.rows) and "so none is ranked here" in suite_html(found, {})
    zero = rows(found)["trivial: zero"]
    assert zero.scenes == 2 and zero.what.endswith("on the Gaussians of one, then two")
    page = suite_html(found, {})
    assert [alone.trivial_baselines_on for alone in found.scenes] == ["one", "two"]
    for alone in found.scenes:
        assert alone.trivial_baselines["trivial: zero"]["l2"].mean == pytest.approx(1, abs=1e-6)
        assert alone.trivial_baselines["trivial: zero"]["l2"].rank is None
    assert page.count('<tr class="grey"><td>trivial: zero</td>') == 2, "in each scene's table"


def test_trivial_baselines_are_of_a_flame_alone_if_there_is_one():
    """The room that a whole scene brings along does not move: a trivial baseline on it says nothing of flames."""
    room = replace(GOLDEN.trivial_baselines["constant"], l2_frame_mean=0.95)
    scenes = []
    for name in "ab":
        here = drawn(scene(name, whole=0.3, flame=0.1), whole=False, flame=True)
        (whole,) = here.runs["whole"]
        whole = replace(
            whole, scores=replace(whole.scores, trivial_baselines=GOLDEN.trivial_baselines | {"constant": room})
        )
        scenes.append(replace(here, runs=here.runs | {"whole": (whole,)}))
    found = rows(board("t", methods("whole", "flame"), scenes))["trivial: constant"]
    assert found.what.endswith("on the Gaussians of flame")
    assert found.figures["l2"].mean == GOLDEN.trivial_baselines["constant"].l2_frame_mean != 0.95
    alone = rows(board("t", methods("whole"), [replace(s, runs={"whole": s.runs["whole"]}) for s in scenes]))
    assert alone["trivial: constant"].figures["l2"].mean == pytest.approx(0.95)


def test_trivial_baselines_are_always_there():
    found = rows(board("t", methods("one"), [scene("a", one=0.0), scene("b", one=0.1)]))
    assert [name for name in found if name.startswith("trivial: ")] == [
        "trivial: zero",
        "trivial: constant",
        "trivial: height_mean",
        "trivial: true_centre",
        "trivial: fire-free background",
    ]
    assert not any(found[name].competes for name in found if name.startswith("trivial: "))
    assert found["trivial: zero"].figures["l2"].mean == pytest.approx(1, abs=1e-6)
    assert found["trivial: height_mean"].figures["fluctuation_l2"].mean == 1
    assert found["trivial: zero"].figures["vorticity_l2"].mean == 1
    assert found["trivial: constant"].figures["divergence_l2"].mean == pytest.approx(0.03)  # as in the golden file
    assert found["trivial: fire-free background"].figures["psnr_flame"].mean == pytest.approx(GOLDEN.psnr_flame_plate)


def test_frames_that_one_has_not_are_left_out_of_the_pair():
    here = scene("a", one=0.0, two=0.1)
    short = here.runs["one"][0]
    dve = replace(short.scores.dve, frames=short.scores.dve.frames[:20])
    cut = replace(here, runs=here.runs | {"one": (replace(short, scores=replace(short.scores, dve=dve)),)})
    assert difference("l2", "one", "two", cut).mean == pytest.approx(-0.1)


@pytest.mark.parametrize(("spread", "text"), [(0.01, "0.01"), (8.74e-5, "0.000087"), (0.0, "0"), (12.34, "12")])
def test_a_seeds_spread_has_no_exponent(spread, text):
    """The means above it have none; "8.7e-05" is read as 8.7 by whoever is in a hurry."""
    assert remark(Figure(0.5, seed_sd=spread), scenes=1) == f"seeds ± {text}"


def test_page_and_tables(tmp_path):
    scenes = [scene(name, one=[0.0, 0.01, 0.02], two=0.1) for name in "abc"]
    found = board("A <b>title</b>", methods("one", "two"), scenes)
    write_record(tmp_path / "board.json", found)
    assert read_record(SuiteBoard, tmp_path / "board.json") == found
    page = suite_html(found, {})
    assert "A &lt;b&gt;title&lt;/b&gt;" in page and "3 of 3 wins" in page and "seeds ±" in page
    assert "given: poses" in page and "knew before: nothing" in page and page.count("<h3>") == 3
    assert not re.search(r'(src|href)="(?!data:)', page), "nothing is fetched"
    assert "| **0.5" in suite_markdown(found) and "*trivial: zero*" in suite_markdown(found)


def test_the_page_says_how_a_method_is_drawn_and_where_it_is_absent():
    """A flame over plates beside whole scenes; one method in one scene of two, one whose runs were not drawn alike."""
    scenes = [
        drawn(scene("a", flame=0.0, whole=0.1, mixed=[0.1, 0.2]), flame=True, whole=False, mixed=[True, False]),
        drawn(scene("b", flame=0.0, mixed=0.1), flame=True, mixed=True),
    ]
    found = board("t", methods("flame", "whole", "mixed"), scenes)
    assert {name: row.over_plates for name, row in rows(found).items()} == {
        **dict.fromkeys(rows(found)),
        "flame": True,
        "whole": False,
    }
    page = suite_html(found, {})
    assert page.count("a flame alone, drawn over") == 1 and page.count("drawn as a whole scene") == 1
    assert re.findall(r"<td[^>]*>(\w+)<small>(in 1 of 2 scenes)</small>", page) == [("whole", "in 1 of 2 scenes")]
    assert "*whole* (in 1 of 2 scenes)" in suite_markdown(found)


def test_frames_that_are_independent_are_called_so():
    """Not "a clip of 350 000 000 eddies"."""
    found = board(
        "t", methods("one"), [replace(scene("a", one=0.1), eddy_time=EddyTime(0.0, False)), scene("b", one=0.1)]
    )
    page = suite_html(found, {})
    assert page.count("which count as independent") == 1 and page.count("of them long") == 1
    assert "eddy time 20 ms, so the clip is 17.5 of them long" in page  # 0.35 s


def test_a_training_that_stopped_falling_is_told_from_one_that_had_not():
    steady = curve([*np.geomspace(1, 0.1, 60), *[0.1] * 40])
    falling = curve(np.geomspace(1, 0.1, 100))
    assert steady.last_fall == pytest.approx(0, abs=1e-9)
    assert falling.last_fall == pytest.approx(1 - 0.1 ** (20 / 99))  # an exponential falls by one factor each fifth
    assert np.isnan(curve([1, 0.5]).last_fall)
    thinned = falling.thinned(40)
    assert len(thinned.step) == 40 and thinned.step[-1] == 1000 and thinned.loss[-1] == pytest.approx(0.1, rel=0.05)


def test_curves_are_on_the_page(tmp_path):
    here = replace(scene("a", one=0.1, two=0.2), curves={"one": curve(np.geomspace(2, 0.5, 100))})
    found = board("t", methods("one", "two"), [here, scene("b", one=0.1, two=0.2)])
    write_record(tmp_path / "board.json", found)
    assert read_record(SuiteBoard, tmp_path / "board.json") == found
    page = suite_html(found, {})
    assert page.count("Had the trainings converged?") == 1
    assert "<td>1000</td><td>500</td>" in page
    chart = page[page.index("<svg") : page.index("</svg>")]
    words = re.findall(r'<text[^>]* y="([\d.]+)"[^>]*>([^<]*)</text>', chart)
    assert {"one", "Training loss", "CPU seconds", "100"} <= {word for _, word in words}
    line = re.findall(r"[ML] [\d.]+ ([\d.]+)", re.search(r'd="([^"]*)"[^>]*stroke: var\(--c2410c', chart)[1])
    place = {float(word): float(y) for y, word in words if re.fullmatch(r"1|0\.\d", word)}
    one, less = max(place), min(place)
    assert 0 < less < one == 1
    fall = (float(line[-1]) - float(line[0])) / (place[less] - place[one]) * np.log(less)
    assert np.exp(fall) == pytest.approx(0.25, rel=0.05), "0.5 over 2, the last of it a mean over a few steps"


@pytest.mark.parametrize(
    "text, named",
    [
        ("step,loss\n10,1\n", "columns step, cpu_seconds, loss"),
        ("step,cpu_seconds,loss\n", "holds no point"),
        ("step,cpu_seconds,loss\n10,1,nan\n", "above zero"),
        ("step,cpu_seconds,loss\n10,1,1\n10,2,1\n", "must rise"),
        ("step,cpu_seconds,loss\n10,1,x\n", "columns step"),
        (f"step,cpu_seconds,loss\n1{'0' * 400},1,1\n", "from 1e-30 to 1e30"),
    ],
)
def test_a_curve_that_is_none_is_refused(tmp_path, text, named):
    (tmp_path / "curve.csv").write_text(text)
    with pytest.raises(DataFormatError, match=named):
        TrainingCurve.read(tmp_path / "curve.csv")


def test_a_curve_that_gof_baseline_wrote_is_read(tmp_path):
    written = LossRecorder(tmp_path / "curve.csv")
    for loss in np.linspace(1, 0.5, 30):
        written.add(loss)
    assert TrainingCurve.read(tmp_path / "curve.csv").step == (10, 20, 30)


def test_a_shared_rank_says_how_far_it_reaches():
    figures = {name: Figure(mean, rank=1, last_rank=2, wins=1) for name, mean in (("a", 0.3), ("b", 0.5))}
    figures["c"] = Figure(0.9, rank=3, last_rank=3, wins=0)
    assert [remark(figures[name], 1) for name in "abc"] == ["rank 1 to 2", "rank 1 to 2", "rank 3"]
    assert marks_of(figures, "l2") == {"a": "best", "b": "first"}, "the mean decides who is bold, not who is shaded"
    assert marks_of({"a": figures["a"]}, "l2") == {"a": "first"}, "one alone is best of nobody"


@pytest.mark.parametrize("wild", [1e7, 1e200, 1e308])
def test_figures_beyond_sense_spoil_nobody_elses_row(wild, tmp_path):
    """The mean of squares of 1e200 is no number, and a board with one could not be written."""
    alone = board("t", methods("a", "b"), [scene("a", a=0, b=0.2)])
    found = board("t", methods("a", "b", "wild"), [scene("a", a=0, b=0.2, wild=wild)])
    write_record(tmp_path / "board.json", found)
    assert rows(found)["a"] == rows(alone)["a"] and rows(found)["b"] == rows(alone)["b"]
    assert not rows(found)["wild"].competes and "no flame is so far off" in rows(found)["wild"].refused[0]


@pytest.mark.parametrize("row", ["1,1,1e308", "1,1,5e-324", "1,1e300,1", f"{10**400},1,1", "1,1,nan", "1,inf,1"])
def test_numbers_that_no_training_has_are_refused(tmp_path, row):
    path = tmp_path / "curve.csv"
    path.write_text(f"step,cpu_seconds,loss\n{row}\n")
    with pytest.raises(DataFormatError, match=r"curve\.csv: all numbers must be above zero, from 1e-30 to 1e30"):
        TrainingCurve.read(path)


def test_a_row_that_is_better_than_the_truth_allows_has_an_alarm():
    """L2 near 0, or below that of the true velocity at each centre of its own Gaussians."""
    honest, near_zero = result("honest", np.full(FRAMES, 0.4)), result("truth", np.full(FRAMES, 0.01))
    bound = replace(GOLDEN.trivial_baselines["constant"], l2=0.3, meaning="the truth at each centre")
    low = result("low", np.full(FRAMES, 0.2))
    runs = {
        name: (
            replace(
                one, scores=replace(one.scores, trivial_baselines=GOLDEN.trivial_baselines | {"true_centre": bound})
            ),
        )
        for name, one in (("honest", honest), ("truth", near_zero), ("low", low))
    }
    here = ScoredScene("a", "test", EddyTime(0.02, False), tuple(0.01 * k for k in range(FRAMES)), runs)
    found = board("t", methods(*runs), [here])
    assert rows(found)["honest"].alarm == ""
    assert "is it the truth itself?" in rows(found)["truth"].alarm
    assert "0.2000 is below 0.3000" in rows(found)["low"].alarm
    for page in (suite_html(found, {}), suite_markdown(found)):
        assert "is it the truth itself?" in page and "below 0.3000" in page


def test_the_page_says_whose_velocity_was_scored():
    honest = result("", np.full(FRAMES, 0.4))
    gas = replace(GOLDEN, trivial_baselines=GOLDEN.trivial_baselines | {"light": GOLDEN.trivial_baselines["constant"]})
    light = replace(GOLDEN, trivial_baselines={k: c for k, c in GOLDEN.trivial_baselines.items() if k != "light"})
    runs = {
        name: (replace(honest, name=name, scores=replace(honest.scores, trivial_baselines=scores.trivial_baselines)),)
        for name, scores in (("says gas", gas), ("moves", light))
    }
    here = ScoredScene("a", "test", EddyTime(0.02, False), tuple(0.01 * k for k in range(FRAMES)), runs)
    page = suite_html(board("t", methods(*runs), [here]), {})
    assert (
        page.split("<b>says gas</b>")[1]
        .split("</li>")[0]
        .count("scored velocity: that of the gas, as the result states it")
        == 1
    )
    assert (
        page.split("<b>moves</b>")[1]
        .split("</li>")[0]
        .count("scored velocity: that of the light, as its Gaussians move")
        == 1
    )


def test_dve_is_shown_with_its_interval_and_ranks_nobody():
    """EVE and DVE say opposite things: the ranks are EVE's."""
    better, worse = result("better", np.full(FRAMES, 0.3)), result("worse", np.full(FRAMES, 0.4))
    fooled = tuple(replace(frame, l2=0.1) for frame in worse.scores.dve.frames)
    worse = replace(worse, scores=replace(worse.scores, dve=replace(worse.scores.dve, frames=fooled)))
    runs = {"better": (better,), "worse": (worse,)}
    here = ScoredScene("a", "test", EddyTime(0.02, False), tuple(0.01 * k for k in range(FRAMES)), runs)
    found = rows(board("t", methods(*runs), [here]))
    assert [found[name].figures["eve_l2"].rank for name in runs] == [1, 2]
    assert [found[name].figures["l2"].mean for name in runs] == pytest.approx([0.3, 0.1])
    assert all(found[name].figures[key].rank is None for name in runs for key in ("l2", "cos_sim"))


def test_an_alarm_where_eve_beats_the_truth_at_the_centres():
    honest = result("one", np.full(FRAMES, 0.4))
    dve = replace(honest.scores.dve, eve=replace(honest.scores.dve.eve, l2=0.09))
    assert "EVE L2 0.0900 is below 0.1000" in too_good(replace(honest.scores, dve=dve))
    assert too_good(honest.scores) == ""
