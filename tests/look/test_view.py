"""`gof view`: what it serves and to whom, and its page in a real browser while the result changes."""

import base64
import io
import json
import os
import re
import socket
import threading
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.image import psnr
from gof.io.importers import ImportOptions
from gof.look.images import VIRIDIS, ramp
from gof.look.player.live import Live, serve
from gof.look.player.opened import newest, open_result
from gof.look.player.page import share_page
from gof.look.player.quantise import Packed, PackedColumn, unpack
from gof.render import render
from tests.browser import Browser, chromium
from tests.conftest import look_at, random_gaussians


class Served:
    """A view on a port of its own, in a thread."""

    def __init__(self, path, dataset=None):
        self.live = Live(path, dataset)
        self.server = serve(self.live)
        self.port = self.server.server_address[1]
        self.thread = threading.Thread(target=self.server.serve_forever, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.server.shutdown()
        self.server.server_close()

    def get(self, place="/", **headers) -> tuple[int, str]:
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{place}", headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=20) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as e:
            return e.code, ""


def content(page: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="share">(.*?)</script>', page, re.S)[1])


def gaussians_in(result: dict) -> TransientGaussians:
    """Gaussians of the JSON, as the page reads them."""
    header = result["header"]
    columns = [PackedColumn(**{k: v for k, v in one.items() if k != "steps"}) for one in header["columns"]]
    return unpack(Packed(header["count"], columns, base64.b64decode(result["data"]), header["emissive"]))


def write_rising(path, speed=1.5):
    """500 Gaussians that rise, sampled in time, as the page of importers writes them; their start (500, 3) m."""
    time_s = np.linspace(0, 0.4, 41)
    start = np.random.default_rng(0).normal([0, 0, 0.5], 0.1, (500, 3))
    np.savez(
        path,
        schema="gof-trajectory/1",
        time_s=time_s,
        position=np.stack([start + [0, 0, speed * t] for t in time_s]),
        opacity=np.full((41, 500), 0.3),
        scale=np.full((500, 3), 0.02),
        rotation=np.tile([1.0, 0, 0, 0], (500, 1)),
    )
    return start


def test_colour_maps_run_from_violet_to_yellow():
    violet, green, yellow = ramp(VIRIDIS)[[0, 128, 255]] / 255
    np.testing.assert_allclose(violet, [0.267, 0.005, 0.329], atol=0.01)  # the ends and the middle of viridis
    np.testing.assert_allclose(green, [0.128, 0.567, 0.551], atol=0.01)
    np.testing.assert_allclose(yellow, [0.993, 0.906, 0.144], atol=0.01)


def test_a_running_reconstruction_shows_its_latest_snapshot(tmp_path):
    assert newest(tmp_path / "any.ply") == tmp_path / "any.ply"
    (tmp_path / "settings.json").write_text("{}")
    with pytest.raises(GofError, match="250 steps"):
        newest(tmp_path)
    random_gaussians(5).save(tmp_path / "snapshot.npz", source="test")
    assert newest(tmp_path).name == "snapshot.npz"
    random_gaussians(5).save(tmp_path / "result.npz", source="test")
    assert newest(tmp_path).name == "result.npz"


def test_a_real_server_has_the_page_and_then_what_is_newer(tmp_path):
    (tmp_path / "settings.json").write_text("{}")
    g = random_gaussians(50)
    g.save(tmp_path / "snapshot.npz", source="test")
    with Served(tmp_path) as view:
        status, page = view.get()
        first = content(page)
        assert status == 200 and "snapshot.npz: 50 transient Gaussians" in first["subtitle"]
        np.testing.assert_allclose(gaussians_in(first["results"][0]).position, g.position, atol=1e-3)
        have = urllib.parse.quote(first["stamp"])
        assert view.get(f"/news?have={have}") == (204, ""), "nothing newer"
        newer = replace(random_gaussians(20, seed=1), velocity_sd=np.full(20, 0.25))
        newer.save(tmp_path / "result.npz", source="test")
        status, news = view.get(f"/news?have={have}")
        news = json.loads(news)
        assert status == 200 and "result.npz: 20 transient" in news["subtitle"]
        assert (first["uncertainty_max"], news["uncertainty_max"]) == (0, 0.25)
        np.testing.assert_allclose(gaussians_in(news["results"][0]).position, newer.position, atol=1e-3)
        assert view.get(f"/news?have={urllib.parse.quote(news['stamp'])}") == (204, "")
        kept = (tmp_path / "result.npz").read_bytes()
        (tmp_path / "result.npz").write_bytes(kept[:200])  # as while it is copied
        assert view.get(f"/news?have={urllib.parse.quote(news['stamp'])}") == (204, "")
        assert content(view.get()[1])["subtitle"] == news["subtitle"]
        for place in ("/nothing", "/instant", "/instant?time=nan", "/instant?time=1&time=", "/../settings.json"):
            assert view.get(place)[0] in (200, 404) and "{}" not in view.get(place)[1]


def test_colours_and_lines_mean_what_they_mean_on_the_page_of_gof_share(tmp_path):
    """Half of the opacity moves with 3 m/s, half with 1, and one that hides does not say how sure it is."""
    velocity = np.zeros((100, 3))
    velocity[:, 2] = np.where(np.arange(100) < 50, 3, 1)
    uncertainty = np.where(np.arange(100) < 90, 0.4, np.inf)
    g = replace(random_gaussians(100), dynamic=np.ones(100, bool), opacity=np.full(100, 0.5), velocity=velocity)
    g = replace(g, velocity_sd=uncertainty, t_mu=np.linspace(0, 0.35, 100))
    g.save(tmp_path / "g.npz")
    shared = content(
        share_page([open_result(tmp_path / "g.npz", ImportOptions())], tmp_path / "page.html").path.read_text()
    )
    viewed = content(Live(tmp_path / "g.npz").page())
    for page in (shared, viewed):
        assert page["speed_ticks"] == ["0", "0.75", "1.5", "2.2", "3+ m/s"]
        assert page["uncertainty_ticks"] == ["0", "0.1", "0.2", "0.3", "0.4+ m/s"]
        assert page["notes"]["line"] == "A line is the way of 10 ms.", "3 % of 350 ms, rounded"
    same = set(shared) - {"facts", "subtitle", "file", "results"}
    assert {key: viewed[key] for key in same} == {key: shared[key] for key in same}
    assert viewed["results"] == shared["results"]


def test_a_shared_page_has_nothing_that_asks(tmp_path):
    random_gaussians(5).save(tmp_path / "g.npz")
    page = share_page([open_result(tmp_path / "g.npz", ImportOptions())], tmp_path / "page.html").path.read_text()
    assert "fetch(" not in page and "connect-src" not in page
    assert "fetch(" in Live(tmp_path / "g.npz").page()


def test_positions_over_time_are_served_instant_by_instant(tmp_path):
    """500 Gaussians at 1.5 m/s."""
    start = write_rising(tmp_path / "mine.npz")
    with Served(tmp_path / "mine.npz") as view:
        first = content(view.get()[1])
        assert first["sampled"] and first["speed_max"] in (1.5, 1.6), "rounded up, from differences of float32 places"
        assert first["uncertainty_max"] == 0
        for time_s in (0.0, 0.2, 0.123):
            there = gaussians_in(json.loads(view.get(f"/instant?time={time_s}")[1])["results"][0])
            np.testing.assert_allclose(there.position, start + [0, 0, 1.5 * time_s], atol=1e-4)
            np.testing.assert_allclose(there.velocity[:, 2], 1.5, atol=1e-3)
        beyond = gaussians_in(json.loads(view.get("/instant?time=9")[1])["results"][0])
        np.testing.assert_allclose(beyond.position, start + [0, 0, 0.6], atol=1e-4, err_msg="the last that is known")


def test_a_port_that_is_taken_is_named(tmp_path):
    random_gaussians(5).save(tmp_path / "g.npz")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(GofError, match=f"--port {port}: .*in use"):
            serve(Live(tmp_path / "g.npz"), port)


@pytest.mark.parametrize("sent", [b"garbage\r\n\r\n", b"\x16\x03\x01\x02\x00\x01", b"GET / HTTP/9.9\r\n\r\n", b""])
def test_garbage_closes_its_connection_and_prints_no_traceback(tmp_path, capfd, sent):
    random_gaussians(5).save(tmp_path / "result.npz")
    with Served(tmp_path / "result.npz") as view:
        with socket.create_connection(("127.0.0.1", view.port), timeout=20) as client:
            client.sendall(sent)
            client.shutdown(socket.SHUT_WR)
            assert b'id="share"' not in client.makefile("rb").read()
        assert view.get()[0] == 200
    assert "Traceback" not in "".join(capfd.readouterr())


# ---------------------------------------------------------------- in a browser

in_a_browser = pytest.mark.skipif(chromium() is None, reason="no Chromium here: the page of `gof view` is not drawn")
WIDTH, HEIGHT = 90, 120


@pytest.fixture(scope="module")
def browser():
    with Browser(WIDTH, HEIGHT) as opened:
        yield opened


def picture(browser) -> np.ndarray:
    data = base64.b64decode(browser.run("player.picture()").split(",")[1])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")) / 255


def camera_of(browser):
    """The camera through which the page looks."""
    view, lens = browser.run("state.view"), browser.run("lensIn(state.view.camera, innerWidth, innerHeight)")
    camera = look_at("page", (0, -3, 1), (0, 0, 1), WIDTH, HEIGHT)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = view["axes"], -np.array(view["axes"]) @ view["eye"]
    K = [[lens["focal"][0], 0, lens["centre"][0]], [0, lens["focal"][1], lens["centre"][1]], [0, 0, 1]]
    return replace(camera, K=K, world_to_camera=pose)


@in_a_browser
@pytest.mark.long
def test_the_page_follows_a_reconstruction_and_the_view_stays(browser, tmp_path):
    (tmp_path / "settings.json").write_text("{}")
    first = replace(random_gaussians(60), dynamic=np.ones(60, bool), color=np.full((60, 3), 0.6))
    later = replace(random_gaussians(90, seed=3), dynamic=np.ones(90, bool), velocity_sd=np.full(90, 0.25))
    first.save(tmp_path / "snapshot.npz", source="test")
    with Served(tmp_path) as view:
        browser.resize(WIDTH, HEIGHT)
        browser.open(f"http://127.0.0.1:{view.port}/#bare=1&t=100")
        time_s = browser.run("state.time + share.first_s")
        browser.run("state.view = orbited(state.view, 0.3, 0.1), state.lines = false, change()")
        camera, stood = camera_of(browser), browser.run("state.view")
        assert psnr(picture(browser), np.clip(render(first, camera, time_s)["color"], 0, 1)) > 45
        assert browser.run("offered().length") == 2, "colour and speed: it does not say how sure it is"
        later.save(tmp_path / "snapshot.npz", source="test")
        os.utime(tmp_path / "snapshot.npz", ns=(1, 1))  # a clock that stands is no newer time, but another one
        found = browser.run(
            "(async () => { for (let i = 0; i < 200 && clouds[0].count !== 90; i++) await pause(100); "
            "return clouds[0].count; })()"
        )
        assert found == 90
        assert browser.run("state.view") == stood and browser.run("state.time") == pytest.approx(0.1)
        assert psnr(picture(browser), np.clip(render(later, camera, time_s)["color"], 0, 1)) > 45
        assert "snapshot.npz: 90 transient" in browser.run("byId('subtitle').textContent")
        labels = browser.run("[...document.querySelectorAll('#colours span')].map((e) => e.textContent)")
        assert labels == ["Colour", "Speed", "Uncertainty"]
    said = browser.run(
        "(async () => { for (let i = 0; i < 100 && !byId('said').textContent; i++) await pause(100); "
        "return byId('said').textContent; })()"
    )
    assert "gof view has ended" in said and picture(browser).mean() > 0, "what was there stays"
    assert all("ERR_CONNECTION" in error or "Failed to fetch" in error for error in browser.errors), browser.errors
    assert {re.sub(r":\d+|\?.*|#.*", "", address) for address in browser.requests} == {
        "http://127.0.0.1/",
        "http://127.0.0.1/news",
    }


@in_a_browser
@pytest.mark.long
def test_the_page_shows_each_instant_of_a_sampled_result(browser, tmp_path):
    from gof.io.importers import read_result

    write_rising(tmp_path / "mine.npz")
    known = read_result(tmp_path / "mine.npz", ImportOptions()).gaussians
    with Served(tmp_path / "mine.npz") as view:
        browser.resize(WIDTH, HEIGHT)
        browser.errors.clear()
        browser.open(f"http://127.0.0.1:{view.port}/#bare=1&t=0")
        camera, pictures = camera_of(browser), []
        for time_s in (0.0, 0.2, 0.37):
            browser.run(f"state.time = {time_s}, change()")
            pictures.append(picture(browser))
            expected = np.clip(render(known.state_at(time_s), camera, time_s)["color"], 0, 1)
            assert psnr(pictures[-1], expected) > 45
        assert psnr(pictures[0], pictures[1]) < 25, "it rises"
        assert browser.errors == []


@in_a_browser
@pytest.mark.long
def test_nothing_is_offered_that_a_result_does_not_have(browser, tmp_path, tiny_dataset):
    replace(random_gaussians(50), dynamic=np.zeros(50, bool)).save(tmp_path / "still.npz")
    with Served(tmp_path / "still.npz", Dataset.open(tiny_dataset)) as view:
        browser.open("about:blank")
        browser.errors.clear()
        browser.open(f"http://127.0.0.1:{view.port}/#t=0")
        assert browser.run("offered()") == [0] and browser.run("byId('lines-row').hidden")
        assert browser.run("byId('presets').hidden") and not browser.run("byId('embed')"), (
            "no address but this machine's"
        )
        assert browser.run("share.cameras.map((c) => c.name)") == [c.name for c in Dataset.open(tiny_dataset).cameras]
        assert browser.run("state.playing") is False and browser.errors == []
