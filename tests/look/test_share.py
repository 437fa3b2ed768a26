"""What the page carries: quantised Gaussians, the true velocity, pictures within a budget; and the command."""

import json
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.core.errors import DataFormatError, GofError
from gof.core.fields import VelocityField, VelocitySequence
from gof.core.gaussians import TransientGaussians
from gof.core.trajectory import Trajectory
from gof.dataset import Dataset
from gof.dataset.pack import pack as pack_dataset
from gof.dataset.pack import unpack as unpack_dataset
from gof.io.importers import ImportOptions
from gof.look.images import frames_within
from gof.look.player import legend
from gof.look.player.opened import Opened, dataset_beside, middle_of, newest, open_result
from gof.look.player.page import front_camera, share_page
from gof.look.player.quantise import measure, pack, unpack
from tests.conftest import arc, random_gaussians, write_dataset


def content_of(path) -> dict:
    """What a page carries, as its own script reads it."""
    html = path.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="share">(.*?)</script>', html, re.S)[1])


def small_dataset(folder, fields=None):
    cameras, times = arc(3), [0.0, 0.1, 0.2]
    rng = np.random.default_rng(1)
    images, statics = rng.random((3, 3, 64, 36, 3)), rng.random((3, 64, 36, 3))
    return Dataset.open(write_dataset(folder, cameras, images, statics, times, fields, test_frames=(1,)))


# ---------------------------------------------------------------- quantisation


def test_the_gas_comes_back_beside_the_light():
    g = random_gaussians(200)
    assert unpack(pack(g)).gas_velocity is None
    gas = np.random.default_rng(5).normal(size=(200, 3))
    back = unpack(pack(replace(g, gas_velocity=gas)))
    still = ~g.dynamic
    assert np.abs(back.gas_velocity - gas)[~still].max() <= 0.51 * np.ptp(gas, axis=0).max() / (2**16 - 2)
    assert (back.gas_velocity[still] == 0).all() and np.abs(back.velocity - gas)[~still].max() > 1


def test_every_value_comes_back_within_half_a_step():
    """Steps by hand: a range over 2^16 - 1 or 2^8 - 1 parts, of logarithms over 254; quaternions as 10 bits a part."""
    g = random_gaussians(500)
    h = unpack(pack(g))
    for name, levels in {"position": 2**16 - 2, "t_mu": 2**16 - 2, "color": 2**8 - 2}.items():
        own, back = getattr(g, name).reshape(500, -1), getattr(h, name).reshape(500, -1)
        step = np.ptp(own, axis=0) / levels
        assert (np.abs(own - back) <= 0.51 * step + 1e-6).all(), name
    moving = np.where(g.dynamic[:, None], g.velocity, 0)
    assert np.abs(h.velocity - moving).max() <= 0.51 * np.ptp(moving, axis=0).max() / (2**16 - 2)
    for name in ("scale", "opacity"):
        own, back = np.log(getattr(g, name)), np.log(getattr(h, name))
        assert np.abs(own - back).max() <= 0.51 * np.ptp(own) / 254, name
    life = np.where(g.dynamic, g.t_sigma, np.inf)
    assert (np.isinf(h.t_sigma) == np.isinf(life)).all()
    finite = np.isfinite(life)
    assert np.abs(np.log(h.t_sigma[finite] / life[finite])).max() <= 0.51 * np.ptp(np.log(life[finite])) / 254
    angle = 2 * np.arccos(np.clip(np.abs((g.rotation.astype(np.float64) * h.rotation).sum(-1)), 0, 1))
    assert angle.max() < 2 * 3 * np.sqrt(2) / 1023 / 2 * 1.1


def test_a_gaussian_takes_27_bytes_and_6_more_for_the_truth():
    g = random_gaussians(100)
    assert len(pack(g).data) == 2700
    assert len(pack(g, np.ones((100, 3))).data) == 3300


def test_what_stands_still_stays_exactly_where_it_is():
    g = random_gaussians(300)
    h = unpack(pack(g))
    still = ~g.dynamic
    assert still.any() and (h.velocity[still] == 0).all() and np.isinf(h.t_sigma[still]).all()


@pytest.mark.parametrize("case", ["one", "equal", "opaque", "faint", "far", "long"])
def test_odd_sets_are_packed(case):
    g = random_gaussians(1 if case == "one" else 40)
    odd = {
        "equal": {"position": np.ones((40, 3)), "scale": np.full((40, 3), 0.1), "opacity": np.full(40, 0.5)},
        "opaque": {"opacity": np.ones(40)},
        "faint": {"opacity": np.r_[0.0, np.full(39, 0.7)]},
        "far": {"position": g.position + 1000},
        "long": {"scale": np.r_[np.full((39, 3), 1e-6), np.full((1, 3), 1e3)]},
    }.get(case, {})
    g = replace(g, **odd)
    h = unpack(pack(g))
    np.testing.assert_allclose(h.position, g.position, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(h.scale, g.scale, rtol=0.05)
    np.testing.assert_allclose(h.opacity, g.opacity, atol=0.02)
    assert (h.opacity <= 1).all()


def test_the_error_of_a_known_shift_is_found():
    """0.1 m sideways, 3 m from a camera of 80 px: 80 * 0.1 / 3 px. An unchanged set has none."""
    g = random_gaussians(30)
    g = replace(g, position=np.tile([0.0, 0.0, 1.0], (30, 1)), velocity=np.zeros((30, 3)), dynamic=np.zeros(30, bool))
    camera = arc(1)[0]
    same = measure(g, g, [camera], [0.5])
    assert same.psnr_db == np.inf and same.moved_px == 0 and same.velocity_m_s == 0
    moved = measure(g, replace(g, position=g.position + np.float32([0.1, 0, 0])), [camera], [0.5])
    assert moved.moved_px == pytest.approx(80 * 0.1 / 3, rel=1e-5) and moved.psnr_db < 40


# ---------------------------------------------------------------- truth, cameras, pictures


def test_the_true_velocity_is_that_of_the_place_and_time(tmp_path):
    """A field that is linear in place and time: (x, 2 z, 10 t) m/s."""
    axis = -1 + (np.arange(20) + 0.5) / 10
    x, _, z = np.meshgrid(axis, axis, axis, indexing="ij")
    fields = [
        VelocityField.from_array(np.stack([x, 2 * z, np.full_like(x, 10 * t)], -1), [-1, -1, -1], 0.1, t)
        for t in (0.0, 0.1, 0.2)
    ]
    truth = VelocitySequence.create(tmp_path / "velocity.zarr", fields)
    g = random_gaussians(200)
    inside = np.random.default_rng(3).uniform(-0.9, 0.9, (200, 3))
    g = replace(g, position=inside, t_mu=np.linspace(-0.05, 0.25, 200))
    expected = np.stack([inside[:, 0], 2 * inside[:, 2], 10 * np.clip(g.t_mu, 0, 0.2)], -1)
    np.testing.assert_allclose(truth.sample(g.position, g.t_mu)[0], expected, atol=1e-4)
    far = replace(g, position=inside + 5)
    assert (truth.sample(far.position, far.t_mu)[0] == 0).all()


def test_the_camera_before_a_flame_sees_all_of_it():
    g = random_gaussians(300)
    middle, reach = middle_of(g, 0.5)
    camera = front_camera(middle, reach)
    pixels, depth = camera.project(g.position)
    assert (depth > 0).all()
    inside = (pixels > 0).all(-1) & (pixels < [camera.width, camera.height]).all(-1)
    assert inside.mean() > 0.9
    low, high = np.percentile(pixels[:, 1], [2, 98])
    assert 0.4 * camera.height < high - low < 0.9 * camera.height, "and not as a speck"


def test_pictures_keep_to_their_budget(tmp_path):
    dataset = small_dataset(tmp_path)
    views = [(dataset, 0), (dataset, 2)]
    frames, said = frames_within(views, 200_000)
    assert [len(camera) for camera in frames] == [3, 3] and "36 x 64 px" in said
    whole = sum(len(text) for camera in frames for text in camera)
    fewer, said = frames_within(views, whole // 3)
    taken = [text for camera in fewer for text in camera or [] if text]
    assert taken and sum(map(len, taken)) < whole // 3 and "every" in said
    assert frames_within(views, 0) == ([None, None], "no recorded pictures")


# ---------------------------------------------------------------- the page


def test_a_page_holds_everything_and_asks_for_nothing(tmp_path):
    dataset = small_dataset(tmp_path / "data")
    g = replace(random_gaussians(60), velocity_sd=np.full(60, 0.3), dynamic=np.ones(60, bool))
    made = share_page([Opened("ours </script>", "gof", tmp_path / "r.npz", g)], tmp_path / "page.html", dataset)
    html = made.path.read_text(encoding="utf-8")
    for outside in ("http://", "https://", "//cdn", "@import", "url(", 'src="', "fetch(", "XMLHttpRequest", "import("):
        assert outside not in html, outside
    assert "default-src 'none'" in html and html.count("</script>") == 2, "a name cannot end the script"
    assert str(tmp_path) not in html
    content = content_of(made.path)
    assert [c["name"] for c in content["cameras"]] == ["cam_0", "cam_1", "cam_2"] and content["start"] == 1
    assert all(c["plate"] and len(c["frames"]) == 3 for c in content["cameras"])
    assert content["frame_s"] == [0, 0.1, 0.2] and content["held_out"] == [1]
    assert content["uncertainty_max"] == pytest.approx(0.3)
    assert made.bytes == made.path.stat().st_size and made.agreement[0].psnr_db > 40


def test_makers_and_licence_stand_below_the_title(tmp_path):
    """Of the card in a packed dataset, else of what a dataset's provenance says; and of none nothing is made up."""
    dataset = small_dataset(tmp_path / "data")
    one = Opened("a", "gof", tmp_path / "r.npz", random_gaussians(20))

    def credit_of(dataset) -> str:
        return content_of(share_page([one], tmp_path / "page.html", dataset).path)["credit"]

    assert credit_of(dataset) == ""
    archive = pack_dataset(dataset, tmp_path / "packed", "CC-BY-4.0", ("A. Smith | Sons", "B. <Jones>"))
    unpacked = Dataset.open(unpack_dataset(archive, tmp_path / "unpacked"))
    assert credit_of(unpacked) == "Made by A. Smith | Sons, B. <Jones>. Licence: CC-BY-4.0."
    described = dataset.path / "dataset.json"
    said = json.loads(described.read_text())
    said["provenance"] = {"authors": ["A", "B"], "licence": "CC0-1.0", "data_set": "x/y", "generator": "1"}
    described.write_text(json.dumps(said))
    assert credit_of(Dataset.open(dataset.path)) == "Made by A, B. Licence: CC0-1.0. Data set: x/y."


def test_a_link_to_the_page_has_a_title_and_a_description(tmp_path):
    one = Opened("a", "gof", tmp_path / "r.npz", random_gaussians(20))
    html = share_page([one], tmp_path / "page.html", title='My "flame" & <more>').path.read_text(encoding="utf-8")
    found = dict(re.findall(r'<meta property="og:(\w+)" content="([^"]*)">', html))
    assert set(found) == {"title", "description"} and "turn" in found["description"]
    assert unescape(found["title"]) == 'My "flame" & <more>'


def test_scales_reach_from_0_to_what_is_fast(tmp_path):
    """Half of the opacity moves with 3 m/s, half with 1: the 98th percentile is 3."""
    g = replace(random_gaussians(100), dynamic=np.ones(100, bool), opacity=np.full(100, 0.5))
    velocity = np.zeros((100, 3))
    velocity[:, 2] = np.where(np.arange(100) < 50, 3, 1)
    page = share_page([Opened("a", "gof", tmp_path / "r.npz", replace(g, velocity=velocity))], tmp_path / "page.html")
    content = content_of(page.path)
    assert content["speed_max"] == 3 and content["uncertainty_max"] == 0
    assert content["frame_s"] == [] and content["cameras"][0]["name"] == "front"
    static = replace(g, dynamic=np.zeros(100, bool))
    page = share_page([Opened("a", "gof", tmp_path / "r.npz", static)], tmp_path / "page.html")
    assert content_of(page.path)["speed_max"] == 0 and content_of(page.path)["length_s"] == 0


def test_cameras_for_novel_views_come_last_with_their_pictures(tmp_path):
    """A method never saw what they recorded, so theirs is the picture to compare with."""
    folder = small_dataset(tmp_path / "data").path
    description = json.loads((folder / "dataset.json").read_text())
    description["cameras"][0]["role"] = "eval"
    (folder / "dataset.json").write_text(json.dumps(description))
    one = Opened("a", "gof", tmp_path / "r.npz", random_gaussians(20))
    content = content_of(share_page([one], tmp_path / "page.html", Dataset.open(folder)).path)
    assert [c["name"] for c in content["cameras"]] == ["cam_1", "cam_2", "cam_0"]
    assert len(content["cameras"][2]["frames"]) == 3
    assert all(c["plate"] is None for c in content["cameras"]), "this result has a static scene of its own"


def test_results_need_names_of_their_own(tmp_path):
    two = [Opened("same", "gof", tmp_path / "r.npz", random_gaussians(5))] * 2
    with pytest.raises(GofError, match="NAME="):
        share_page(two, tmp_path / "page.html")


# ---------------------------------------------------------------- what a user names


def test_a_demo_s_folder_is_enough(tmp_path, capsys):
    small_dataset(tmp_path / "dataset")
    folder = tmp_path / "reconstruct"
    folder.mkdir()
    (folder / "settings.json").write_text("{}")
    random_gaussians(50).save(folder / "result.npz", "test")
    assert newest(tmp_path) == folder / "result.npz"
    assert dataset_beside(tmp_path) == dataset_beside(folder) == tmp_path / "dataset"
    assert gof(["share", str(tmp_path), "--json", str(tmp_path / "made.json")]) == 0
    assert "50 Gaussians" in capsys.readouterr().out
    figures = json.loads((tmp_path / "made.json").read_text())
    assert figures["bytes"] == (tmp_path / "share.html").stat().st_size
    assert figures["results"][0]["gaussians"] == 50 and figures["results"][0]["moved_px"] < 0.1


def test_several_results_by_name(tmp_path):
    for name in ("a", "b"):
        random_gaussians(20, seed=ord(name)).save(tmp_path / f"{name}.npz", "test")
    both = [str(tmp_path / "a.npz"), str(tmp_path / "b.npz")]
    assert gof(["share", *both, "--out", str(tmp_path / "x.html")]) == 0
    assert [r["name"] for r in content_of(tmp_path / "x.html")["results"]] == ["a", "b"]
    assert gof(["share", *(f"{name}={path}" for name, path in zip(("ours", "theirs"), both, strict=True))]) == 0
    assert [r["name"] for r in content_of(tmp_path / "share.html")["results"]] == ["ours", "theirs"]


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["{0}/a.npz", "--names", "x", "y"], "put a name before each result"),
        (["{0}/a.npz", "--pictures", "-1"], "--pictures"),
        (["{0}/none.npz"], "no such file"),
        (["{0}/a.npz", "--dataset", "{0}"], "dataset.json"),
    ],
)
def test_wrong_use_is_named(tmp_path, capsys, argv, says):
    random_gaussians(5).save(tmp_path / "a.npz", "test")
    assert gof(["share", *(word.format(tmp_path) for word in argv)]) == 1
    assert says in capsys.readouterr().err
    assert not (tmp_path / "share.html").exists()


def test_what_has_no_closed_form_is_refused(tmp_path):
    g = random_gaussians(4)
    frames = np.linspace(0, 1, 3)
    path = Trajectory(
        time_s=frames,
        position=np.repeat(g.position[None], 3, 0),
        opacity=np.repeat(g.opacity[None], 3, 0),
        scale=g.scale,
        rotation=g.rotation,
        color=g.color,
        dynamic=g.dynamic,
    ).save(tmp_path / "t.npz")
    with pytest.raises(DataFormatError, match="sampled in time"):
        open_result(path, ImportOptions())
    nothing = TransientGaussians(**{name: values[:0] for name, values in g.arrays().items()})
    nothing.save(tmp_path / "n.npz", "test")
    with pytest.raises(DataFormatError, match="no Gaussian"):
        open_result(tmp_path / "n.npz", ImportOptions())


def test_numbers_of_the_legend_are_short_and_never_powers_of_ten():
    assert legend.ticks(4.2) == ["0", "1.1", "2.1", "3.2", "4.2+ m/s"]
    assert legend.ticks(4e-5) == ["0", "0.00001", "0.00002", "0.00003", "0.00004+ m/s"]
    assert legend.ticks(1.2e6)[-1] == "1200000+ m/s"
    assert legend.line_note(0.011) == "A line is the way of 11 ms."
