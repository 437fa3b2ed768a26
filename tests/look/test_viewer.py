"""The browser view: what it draws against closed forms, what it opens, and a real server."""

import json
import re
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.io.importers import ImportOptions
from gof.look.legend import has_line
from gof.look.player.opened import open_result
from gof.look.player.page import assemble, share_page
from gof.look.switches import COLOURS
from gof.look.viewer import DOUBT, SPEED, Viewer, mapped, newest, splats, time_span
from tests.conftest import random_gaussians


def test_splats_are_the_gaussians_of_that_time():
    g = random_gaussians(200)
    seen = splats(g, 0.4)
    position, opacity = g.at(0.4)
    visible = opacity >= 1 / 255
    assert 0 < visible.sum() < 200
    np.testing.assert_array_equal(seen["centers"], position[visible])
    np.testing.assert_array_equal(seen["opacities"][:, 0], opacity[visible])
    variance = np.linalg.eigvalsh(seen["covariances"].astype(np.float64))
    np.testing.assert_allclose(variance, np.sort(g.scale[visible] ** 2, axis=-1), rtol=1e-4)


def test_colours_from_spherical_harmonics_are_their_mean():
    g = random_gaussians(5)
    flat = splats(g, 0.0)["rgbs"]
    coefficients = np.zeros((5, 4, 3), np.float32)
    coefficients[:, 0] = (g.color - 0.5) * np.sqrt(4 * np.pi)
    values = {name: getattr(g, name) for name in g.__dataclass_fields__} | {"color": coefficients}
    np.testing.assert_allclose(splats(TransientGaussians(**values), 0.0)["rgbs"], flat, atol=1e-6)


def test_colour_maps_run_from_violet_to_yellow():
    violet, green, yellow, none = mapped(np.array([0, 0.5, 1.7, np.inf]), 1.0)
    np.testing.assert_allclose(violet, [0.267, 0.005, 0.329], atol=0.01)  # the ends and the middle of viridis
    np.testing.assert_allclose(green, [0.128, 0.567, 0.551], atol=0.01)
    np.testing.assert_allclose(yellow, [0.993, 0.906, 0.144], atol=0.01)
    np.testing.assert_allclose(none, 0.32, atol=1e-6)  # grey: nobody says
    assert np.isfinite(mapped(np.zeros(3), 0.0)).all()


def test_a_running_reconstruction_shows_its_latest_snapshot(tmp_path):
    assert newest(tmp_path / "any.ply") == tmp_path / "any.ply"
    (tmp_path / "settings.json").write_text("{}")
    with pytest.raises(GofError, match="250 steps"):
        newest(tmp_path)
    random_gaussians(5).save(tmp_path / "snapshot.npz", source="test")
    assert newest(tmp_path).name == "snapshot.npz"
    random_gaussians(5).save(tmp_path / "result.npz", source="test")
    assert newest(tmp_path).name == "result.npz"


def test_it_opens_nearer_than_the_cameras_with_the_flame_in_sight(tmp_path, tiny_dataset):
    """Beside a camera, its own picture would hide the flame; without a dataset the flame still fills the window."""
    pytest.importorskip("viser")
    g = replace(random_gaussians(300), dynamic=np.ones(300, bool), velocity=np.zeros((300, 3)))
    g.save(tmp_path / "g.npz")
    dataset = Dataset.open(tiny_dataset)
    for known in (dataset, None):
        viewer = Viewer(tmp_path / "g.npz", known, port=0)
        try:
            start = viewer.server.initial_camera
            eye, target = np.array(start.position), np.array(start.look_at)
            away = eye - target
            np.testing.assert_allclose(target, [0, 0, 1], atol=0.2)
            nearest = min(np.linalg.norm(c.position - target) for c in dataset.cameras)
            if known:
                assert np.linalg.norm(away) < 0.9 * nearest
                ray = known.cameras[len(known.cameras) // 2].position - target
                assert away @ ray > 0.999 * np.linalg.norm(away) * np.linalg.norm(ray), "seen as that camera sees it"
            depth = (eye - g.position) @ away / np.linalg.norm(away)
            height = np.abs(g.position[:, 2] - target[2]) / depth / np.tan(start.fov / 2)
            assert (depth > 0).all() and 0.4 < np.percentile(height, 98) < 1, "of half the window's height"
        finally:
            viewer.server.stop()


def test_a_real_server_shows_times_and_new_snapshots(tmp_path):
    pytest.importorskip("viser")
    (tmp_path / "settings.json").write_text("{}")
    g = random_gaussians(50)
    g.save(tmp_path / "snapshot.npz", source="test")
    viewer = Viewer(tmp_path, port=8490)
    try:
        first, last = time_span(g, None)
        viewer.show(first)
        assert "snapshot.npz" in viewer.text.content and "0.0 ms" in viewer.text.content
        viewer.show(last)
        assert f"{1e3 * (last - first):.1f} ms" in viewer.text.content
        page = urllib.request.urlopen(f"http://127.0.0.1:{viewer.server.get_port()}", timeout=20).read()
        assert b"<html" in page.lower()
        assert "±" not in viewer.text.content, "nobody says how sure these velocities are"
        replace(random_gaussians(20), velocity_sd=np.full(20, 0.25)).save(tmp_path / "result.npz", source="test")
        viewer.refresh()
        viewer.color.value = DOUBT
        viewer.show(last)
        assert "± 0.25" in viewer.text.content
        assert "result.npz" in viewer.text.content and "of 20" in viewer.text.content
    finally:
        viewer.server.stop()


def test_it_has_the_players_controls_in_its_order(tmp_path, tiny_dataset):
    """As the page of `gof share` shows them, read from the page that is written."""
    pytest.importorskip("viser")
    random_gaussians(50).save(tmp_path / "g.npz")
    page = assemble({}, "flame")
    viewer = Viewer(tmp_path / "g.npz", Dataset.open(tiny_dataset), port=0)
    try:
        shown = [viewer.camera, viewer.color, viewer.lines, viewer.size, viewer.reset, viewer.time, viewer.speed]
        places = [page.index(f">{h.label.split(',')[0]}") for h in shown[:-2]]
        assert places == sorted(places) and [h.order for h in shown] == sorted(h.order for h in shown)
        assert viewer.camera.options == tuple(c.name for c in viewer.dataset.cameras)
        offered = re.findall(r'<option value="(\d+)"[^>]*>([^<]+)</option>', page)
        assert [label for _, label in offered] == list(viewer.speed.options)
        assert viewer.speed.options[-1] == "1/100" and dict(map(reversed, offered))["1/100"] == "100"
    finally:
        viewer.server.stop()


def test_colours_and_lines_mean_what_they_mean_on_the_page_of_gof_share(tmp_path):
    """Half of the opacity moves with 3 m/s, half with 1, and one that hides nobody says how sure it is."""
    pytest.importorskip("viser")
    velocity = np.zeros((100, 3))
    velocity[:, 2] = np.where(np.arange(100) < 50, 3, 1)
    doubt = np.where(np.arange(100) < 90, 0.4, np.inf)
    g = replace(random_gaussians(100), dynamic=np.ones(100, bool), opacity=np.full(100, 0.5), velocity=velocity)
    g = replace(g, velocity_sd=doubt, t_mu=np.linspace(0, 0.35, 100))
    g.save(tmp_path / "g.npz")
    viewer = Viewer(tmp_path / "g.npz", port=0)
    page = share_page([open_result(tmp_path / "g.npz", ImportOptions())], tmp_path / "page.html").path.read_text()
    content = json.loads(re.search(r'<script type="application/json" id="share">(.*?)</script>', page, re.S)[1])
    try:
        viewer.show(viewer.first_s)
        assert not viewer.scale.visible and list(viewer.color.options) == content["colours"] == list(COLOURS)
        viewer.color.value = SPEED
        for time_s in (viewer.first_s, viewer.first_s + viewer.length_s):  # one scale for the whole clip
            viewer.show(time_s)
            assert re.findall(r"<span>(.*?)</span>", viewer.scale.content) == ["0", "0.75", "1.5", "2.2", "3+ m/s"]
            assert viewer.scale.visible and content["notes"]["speed"] in viewer.scale.content
        assert content["speed_ticks"] == ["0", "0.75", "1.5", "2.2", "3+ m/s"]
        viewer.lines.value = True
        viewer.show(viewer.first_s)
        assert "A line is the way of 10 ms." == content["notes"]["line"], "3 % of 350 ms, rounded"
        assert "A line is the way of 10 ms." in viewer.scale.content
        viewer.color.value = DOUBT
        viewer.show(viewer.first_s)
        assert re.findall(r"<span>(.*?)</span>", viewer.scale.content) == content["doubt_ticks"]
        assert content["doubt_ticks"] == ["0", "0.1", "0.2", "0.3", "0.4+ m/s"]
        assert content["notes"]["doubt"] in viewer.scale.content
    finally:
        viewer.server.stop()


def test_nothing_is_offered_that_a_result_does_not_have(tmp_path):
    pytest.importorskip("viser")
    still = replace(random_gaussians(50), dynamic=np.zeros(50, bool))
    still.save(tmp_path / "g.npz")
    viewer = Viewer(tmp_path / "g.npz", port=0)
    try:
        assert tuple(viewer.color.options) == ("Radiance",) and not viewer.lines.visible
        viewer.show(0.0)
    finally:
        viewer.server.stop()


def test_positions_over_time_have_a_scale_and_lines_too(tmp_path):
    """500 Gaussians at 1.5 m/s, as the page of importers writes them."""
    pytest.importorskip("viser")
    time_s = np.linspace(0, 0.4, 41)
    start = np.random.default_rng(0).normal([0, 0, 0.5], 0.1, (500, 3))
    np.savez(
        tmp_path / "mine.npz",
        schema="gof-trajectory/1",
        time_s=time_s,
        position=np.stack([start + [0, 0, 1.5 * t] for t in time_s]),
        opacity=np.full((41, 500), 0.3),
        scale=np.full((500, 3), 0.02),
        rotation=np.tile([1.0, 0, 0, 0], (500, 1)),
    )
    viewer = Viewer(tmp_path / "mine.npz", port=0)
    try:
        assert tuple(viewer.color.options) == ("Radiance", "Speed")
        assert viewer.speed_max in (1.5, 1.6), "rounded up, from differences of float32 places"
        viewer.lines.value, viewer.color.value = True, SPEED
        viewer.show(0.2)
        assert f"{viewer.speed_max}+ m/s" in viewer.scale.content and "mean speed 1.50 m/s" in viewer.text.content
    finally:
        viewer.server.stop()


def test_the_same_gaussians_have_lines_at_all_times():
    """Not more than 9000 of many, spread over all of them; all of few."""
    assert has_line(8000).all()
    some = has_line(60_000)
    assert some.sum() == pytest.approx(9000, rel=0.01)
    assert np.add.reduceat(some, np.arange(0, 60_000, 600)).min() > 80


def test_playing_slows_down_loops_and_ends(tmp_path):
    pytest.importorskip("viser")
    random_gaussians(50).save(tmp_path / "g.npz")
    viewer = Viewer(tmp_path / "g.npz", port=0)
    try:
        length_ms = 1e3 * viewer.length_s
        viewer.speed.value, viewer.time.value = "1/100", 0.0
        viewer.advance(50 * viewer.length_s)
        np.testing.assert_allclose(viewer.time.value, length_ms / 2)
        viewer.advance(75 * viewer.length_s)
        np.testing.assert_allclose(viewer.time.value, length_ms / 4)
        viewer.loop.value = False
        viewer.advance(1e3 * viewer.length_s)
        assert viewer.time.value == length_ms and not viewer.play.value
        viewer.play.value = True
        viewer.advance(25 * viewer.length_s)
        np.testing.assert_allclose(viewer.time.value, length_ms / 4)
        assert viewer.play.value, "from the end it plays from the start"
    finally:
        viewer.server.stop()


@pytest.mark.long
@pytest.mark.parametrize("sent", [b"garbage", "a text", b"\xc1" * 10, b"\x81\xa4type\xa3abc", b"", b"\x93" * 9000])
def test_garbage_closes_its_connection_and_prints_no_traceback(tmp_path, capfd, caplog, sent):
    viser = pytest.importorskip("viser")
    websockets = pytest.importorskip("websockets")
    from websockets.sync.client import connect

    random_gaussians(5).save(tmp_path / "result.npz")
    viewer = Viewer(tmp_path / "result.npz", port=0)
    port, kind = viewer.server.get_port(), websockets.Subprotocol(f"viser-v{viser.__version__}")
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[kind]) as client:
        client.send(sent)
        with pytest.raises(websockets.ConnectionClosed):
            while True:
                client.recv(timeout=20)
    assert urllib.request.urlopen(f"http://127.0.0.1:{port}/").status == 200
    viewer.server.stop()
    assert "Traceback" not in caplog.text + capfd.readouterr().err and "a connection was closed" in caplog.text
