"""The figures that the authors publish: their definitions written out a second time, in torch and by hand."""

from dataclasses import fields

import numpy as np
import pytest

from gof.commands.evaluate import beaten_trivial_baselines, published_table
from gof.commands.evaluate import main as evaluate_command
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.leaks import MadeFrom
from gof.evaluate import Scores
from gof.evaluate.authors_figures import (
    PublishedFigures,
    PublishedFrame,
    drawn_disparity,
    mean_figures,
    moving,
    published_figures,
    rmse_disparity,
)
from gof.evaluate.leaderboard import EvaluatedResult, best_rows, rows_of, to_csv, to_markdown
from gof.evaluate.scores import Origin, TrivialScore, VelocityScore
from gof.look.boards import leaderboard_html
from tests.conftest import look_at
from tests.reconstruct.rising_flame import column, write_flame


def shifted(first, second):
    """An optical flow that says: the upper half moves by a pixel, the lower by less than half of one."""
    flow = np.zeros((*first.shape, 2), np.float32)
    flow[: len(first) // 2, :, 0] = 1.0
    flow[len(first) // 2 :, :, 1] = 0.49
    return flow


def by_torch(image, truth, mask):
    """PSNR and SSIM as 3DGS' own utilities define them, on pixels of a hard mask."""
    torch = pytest.importorskip("torch")
    a, b = (torch.tensor(p.transpose(2, 0, 1), dtype=torch.float64) for p in (image, truth))
    chosen = torch.tensor(mask).unsqueeze(0).expand(3, -1, -1)
    psnr = 20 * torch.log10(1 / torch.sqrt(((a - b) ** 2)[chosen].mean()))
    x = torch.arange(11, dtype=torch.float64) - 5
    line = torch.exp(-(x**2) / (2 * 1.5**2))
    window = (line[:, None] * line[None] / line.sum() ** 2).expand(3, 1, 11, 11)

    def blur(p):
        return torch.nn.functional.conv2d(p[None], window, padding=5, groups=3)[0]

    ma, mb = blur(a), blur(b)
    va, vb, c = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    ssim = (2 * ma * mb + 1e-4) * (2 * c + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    return float(psnr), float(ssim[chosen].mean())


def test_pictures_are_compared_where_their_code_compares_them():
    rng = np.random.default_rng(0)
    truth, image = rng.random((2, 40, 30, 3))
    board = np.zeros((40, 30), bool)
    board[5:12, 8:20] = True
    flame = np.zeros((40, 30), bool)
    flame[:20] = True
    got = published_figures(PublishedFrame(image, truth, truth, board, np.zeros((40, 30)), None), shifted, None)
    expected = by_torch(image, truth, flame & ~board)
    assert (got.psnr_flame, got.ssim_flame) == pytest.approx(expected, rel=1e-9)
    assert (got.psnr_no_sync, got.ssim_no_sync) == pytest.approx(by_torch(image, truth, ~board), rel=1e-9)
    assert got.psnr_flame != pytest.approx(by_torch(image, truth, flame)[0], rel=1e-6), "the board would show"
    assert got.lpips is None and got.rmse_depth_flame is None


def test_what_moves_is_told_by_the_flow_of_a_frame():
    pytest.importorskip("cv2")
    from gof.reconstruct.optical_flow import dis

    rng = np.random.default_rng(1)
    import cv2

    pattern = cv2.GaussianBlur(rng.random((120, 90, 3)).astype(np.float32), (0, 0), 2)
    pattern = (pattern - pattern.min()) / np.ptp(pattern)
    after = pattern.copy()
    after[20:70, 20:70] = pattern[23:73, 20:70]  # that part rises by 3 px
    moves = moving(pattern, after, dis)
    assert moves[35:60, 30:60].mean() > 0.9 and moves[85:, :].mean() < 0.05


def test_depth_is_fitted_over_the_whole_picture_and_scored_on_the_flame():
    rng = np.random.default_rng(2)
    expected = rng.uniform(10, 50, (60, 50))
    flame = np.zeros((60, 50), bool)
    flame[10:50, 10:40] = True
    target = expected / expected.max()
    assert rmse_disparity(3 * target + 0.2, expected, flame) == pytest.approx(0, abs=1e-9), "any scale and offset"
    # By hand: half the picture at 0, half at 1 is drawn; the truth is 0.25 and 1, but 0.5 on the flame.
    drawn = np.zeros((60, 50))
    drawn[:, 25:] = 2.0
    drawn[:, :25] = 1.0
    true = np.where(drawn > 1.5, 1.0, 0.25)
    true[25:35, 30:40] = 0.5  # 10 x 10; 9 px of an ellipse leave its middle
    small = np.zeros((60, 50), bool)
    small[25:35, 30:40] = True
    right = 25 * 60 - 100
    mean_right = (right * 1.0 + 100 * 0.5) / (right + 100)  # least squares of two levels: their means
    assert rmse_disparity(drawn, true, small) == pytest.approx(mean_right - 0.5, rel=1e-9)
    assert rmse_disparity(drawn, true, small[::-1] & False) is None, "no flame"
    assert rmse_disparity(drawn, true, small & (np.arange(50) < 34)) is None, "nothing is left of a thin flame"


def test_inverse_depth_is_blended_as_in_their_renderer():
    """Two wide Gaussians one behind the other: sum of w / z by the blending rule, worked out by hand."""
    camera = look_at("a", (0, -4, 0), (0, 0, 0), width=21, height=21, focal_px=50.0)
    g = TransientGaussians(
        position=np.array([[0.0, -2, 0], [0, 1, 0]]),
        velocity=np.zeros((2, 3)),
        t_mu=np.zeros(2),
        t_sigma=np.full(2, np.inf),
        scale=np.full((2, 3), 0.5),
        rotation=np.tile([1.0, 0, 0, 0], (2, 1)),
        opacity=np.array([0.6, 0.9]),
        color=np.ones((2, 3)),
        dynamic=np.ones(2, bool),
    )
    disparity = drawn_disparity(g, camera, 0.0)
    assert disparity[10, 10] == pytest.approx(0.6 / 2 + 0.4 * 0.9 / 5, rel=2e-3)


def test_means_leave_out_what_is_undefined():
    a = PublishedFigures(psnr_flame=30.0, ssim_flame=0.9)
    b = PublishedFigures(psnr_flame=20.0)
    assert mean_figures([a, b]) == PublishedFigures(psnr_flame=25.0, ssim_flame=0.9)
    assert mean_figures([]) == PublishedFigures()


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """A perfect result through the command line, with maps of inverse depth of the right shape."""
    pytest.importorskip("cv2")
    root = tmp_path_factory.mktemp("published")
    dataset = Dataset.open(write_flame(root / "data", frames=6))
    column(dataset.times_s).save(root / "result.npz")
    MadeFrom.of(["result.npz"], dataset.train_frames, ["flow_prior"]).write(root)
    for camera in dataset.cameras:
        (root / "disparity" / camera.name).mkdir(parents=True)
        for k in dataset.test_frames:
            np.save(root / "disparity" / camera.name / f"{k:06d}.npy", np.random.default_rng(k).random((96, 48)))
    arguments = [str(root / "result.npz"), "--dataset", str(root / "data"), "--out", str(root / "scores")]
    evaluate_command([*arguments, "--published", str(root)])
    return root


def test_the_command_writes_and_prints_them(scored):
    scores = Scores.read(scored / "scores" / "scores.json")
    figures = scores.published
    assert figures.psnr_flame > 40 and figures.ssim_flame > 0.99 and figures.psnr_no_sync > 40
    assert 0 < figures.rmse_depth_flame < 1 and figures.lpips is None
    assert scores.flow_prior is True
    columns = [list(c.cells) for c in published_table(scores).columns]
    assert columns[0][0] == "PSNR flame (dB)" and columns[2] == ["30.64", "0.907", "0.086", "0.025", "38.03", "0.979"]
    assert not published_table(Scores(gaussians=1, dynamic_gaussians=1, import_=Origin("memory"))).row_count


def with_trivial_baselines(l2, cos_sim, **trivial_baselines) -> Scores:
    """Scores of which only these figures matter."""
    undefined = {f.name: None for f in fields(VelocityScore)}
    return Scores(
        gaussians=1,
        dynamic_gaussians=1,
        import_=Origin("memory"),
        dve=VelocityScore(**undefined | {"l2": l2, "cos_sim": cos_sim}),
        trivial_baselines={
            name: TrivialScore(**{f.name: None for f in fields(TrivialScore)} | {"l2": a, "cos_sim": b})
            for name, (a, b) in trivial_baselines.items()
        },
    )


def test_every_score_says_which_trivial_baselines_it_beats():
    trivial_baselines = {
        "zero": (1.0, None),
        "constant": (0.56, 0.9),
        "height_mean": (0.48, 0.8),
        "true_centre": (0.1, 0.99),
    }
    assert beaten_trivial_baselines(with_trivial_baselines(0.5, 0.85, **trivial_baselines)) == [
        "L2 beats zero, constant; not height_mean",
        "CosSim beats height_mean; not constant",
    ]
    assert beaten_trivial_baselines(with_trivial_baselines(2.0, None, **trivial_baselines)) == [
        "L2 beats no trivial baseline; not zero, constant, height_mean"
    ]
    assert beaten_trivial_baselines(with_trivial_baselines(0.2, 0.95, constant=(0.5, 0.9))) == [
        "L2 beats constant",
        "CosSim beats constant",
    ]
    assert not beaten_trivial_baselines(Scores(gaussians=1, dynamic_gaussians=1, import_=Origin("memory")))


def test_the_command_prints_what_is_beaten(scored, capsys):
    evaluate_command([str(scored / "result.npz"), "--dataset", str(scored / "data"), "--no-images"])
    printed = " ".join(capsys.readouterr().out.split())
    assert "L2 beats zero, random" in printed and "learned flow prior: used" in printed
    scores = Scores.read(scored / "scores" / "scores.json")
    assert f"{scores.dve.fluctuation.l2:.3f}" in printed, "fluctuation's L2 stands beside its CosSim"


def result(name: str, psnr: float | None, prior: bool | None = None) -> EvaluatedResult:
    published = None if psnr is None else PublishedFigures(psnr_flame=psnr, psnr_no_sync=20.0)
    return EvaluatedResult(
        scored,
        name,
        Scores(gaussians=9, dynamic_gaussians=9, import_=Origin("gof"), flow_prior=prior, published=published),
        1.0,
    )


def test_the_leaderboard_shows_theirs_and_lets_them_not_compete():
    rows = rows_of([result("a", 21.0, True), result("b", 25.0, False), result("c", 22.0)])
    names = [row.name for row in rows]
    assert names == ["a", "b", "c", "Gaussians on Fire, published, other footage"]
    theirs = rows[3]
    assert theirs.published_psnr_flame == 30.64 and theirs.published_ssim_no_sync == 0.979
    assert theirs.l2 is None and theirs.gaussians is None and "not comparable" in theirs.method
    assert best_rows(rows)["published_psnr_flame"] == 1, "30.64 dB of other footage is no rank here"
    text = to_markdown(rows)
    assert (
        "| **25.00** |" in text and "*Gaussians on Fire, published, other footage*" in text and "**30.64**" not in text
    )
    assert [row.flow_prior for row in rows] == ["yes", "no", None, None] and "learned flow prior" in text
    header, *lines = to_csv(rows).splitlines()
    assert header.split(",")[3] == "other_footage" and ",0,1," in lines[3]
    page = leaderboard_html(rows, [], "t")
    assert "what its\nauthors published" in page and 'class="grey"><td data-value="Gaussians on Fire' in page
    alone = rows_of([result("a", None)])
    assert len(alone) == 1, "without these figures nothing of theirs is shown"
    assert "authors published" not in leaderboard_html(alone, [], "t")
