"""The report on a synthetic flame: complete, self-contained, decodable, and honest about bad scores."""

import base64
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
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.scores import Scores
from gof.look.report import Preview, build_report, verdicts
from gof.reconstruct.captions import Caption, Captions
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
    assert not re.search(r"https?:|//[\w-]+\.|<script|<link|@import|<iframe", page)
    references = re.findall(r"""(?:src|srcset|href)=["']?([^"'\s>]{1,30})""", page) + re.findall(
        r"url\(([^)]{1,30})", page
    )
    assert references and all(r.startswith(("data:image/", "#")) for r in references), "# is a place in the page"
    assert "default-src 'none'" in page  # and the browser is told to enforce it


def test_all_images_decode_and_the_animation_has_every_frame(out, page):
    images = [
        Image.open(io.BytesIO(base64.b64decode(data))) for data in re.findall(r"data:image/\w+;base64,([^\"]+)\"", page)
    ]
    for image in images:
        image.load()
    # animation, still, legend, truth/reconstruction/difference of 2 cameras, preview pair, one stage picture,
    # and of each camera picture, plate, light above it, difference
    assert len(images) == 3 + 6 + 2 + 1 + 2 * 4
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
    assert str(out) not in page  # nothing of this machine's folders


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


def test_verdicts_say_when_a_score_is_bad(out):
    found = Scores.read(out / "scores.json")
    others = {"zero": (1.0, 0.0), "random": (1.4, 0.0), "constant": (0.5, 0.9), "height_mean": (0.4, 0.9)}
    trivial_baselines = {
        name: replace(found.trivial_baselines[name], l2=a, cos_sim=b) for name, (a, b) in others.items()
    }

    def sentences(l2, cos_sim, psnr):
        dve = replace(found.dve, l2=l2, cos_sim=cos_sim, speed_ratio=l2)
        return verdicts(
            replace(found, dve=dve, trivial_baselines=trivial_baselines, psnr_flame=psnr, psnr_flame_plate=20.0)
        )

    good, bad, mixed = sentences(0.3, 0.95, 25), sentences(1.5, -0.2, 18), sentences(0.45, 0.8, 25)
    assert [v.good for v in good[:4]] == [True] * 4
    assert "Better than standing still" in good[0].sentence and "5.0 dB above" in good[-1].sentence
    assert [v.good for v in bad] == [False] * 6
    assert "Not better than standing still" in bad[0].sentence and "2.0 dB below" in bad[-1].sentence
    assert not mixed[2].good and "Closer in size, not in direction" in mixed[2].sentence
    assert verdicts(replace(found, dve=None, trivial_baselines={}, psnr_flame=None)) == []


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
    assert f"held-out frames ({camera['width']}x{camera['height']} px)" in text
    no_length = real | {"provenance": {"scale": "unknown: the unit is the distance between first and last camera"}}
    (tmp_path / "dataset/dataset.json").write_text(json.dumps(no_length))
    assert main([str(tmp_path)]) == 0
    assert "the unit of length is not known" in (tmp_path / "report.html").read_text()
