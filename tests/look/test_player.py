"""The page of `gof share` in a real browser: it draws what `gof.render` draws, and does what its controls say."""

import base64
import io
import re
import time
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from PIL import Image

from gof.core.fields import VelocityField
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate.image import psnr
from gof.look.player.opened import Opened
from gof.look.player.page import share_page
from gof.look.player.quantise import pack, unpack
from gof.render import render
from tests.browser import Browser, chromium, page_address
from tests.conftest import arc, random_gaussians, write_dataset

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(chromium() is None, reason="no Chromium here: the page of `gof share` is not drawn"),
]

TIMES_S = (0.0, 0.2, 0.5)
WIDTH, HEIGHT = 90, 160


def flame(seed=0):
    """150 overlapping Gaussians, thin and fat, moving and still, some above white and some below black."""
    g = random_gaussians(150, seed)
    rng = np.random.default_rng(seed)
    return replace(
        g,
        scale=np.exp(rng.uniform(np.log(0.004), np.log(0.15), (150, 3))),
        color=rng.uniform(-0.5, 1.8, (150, 3)),
        velocity=np.where(rng.random((150, 1)) < 0.5, 0.3, 1.0) * g.velocity,
        velocity_sd=np.where(rng.random(150) < 0.5, rng.uniform(0.1, 0.6, 150), np.inf),
        t_mu=rng.uniform(0, 0.5, 150),
        dynamic=rng.random(150) < 0.9,
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A page of two results with a dataset, the Gaussians of the first, and the dataset."""
    folder = tmp_path_factory.mktemp("share")
    cameras = arc(3, width=WIDTH, height=HEIGHT, focal_px=200.0)
    grey = np.full((6, 3, HEIGHT, WIDTH, 3), 0.25)
    grey += np.linspace(0, 0.5, 6)[:, None, None, None, None]  # a frame knows its number by its brightness
    fields = [
        VelocityField.from_array(np.full((4, 4, 4, 3), [0, 0, 2.0]), (-2, -2, -1), 1.0, 0.1 * k) for k in range(6)
    ]
    dataset = Dataset.open(
        write_dataset(folder / "data", cameras, grey, np.full((3, HEIGHT, WIDTH, 3), 0.3), 0.1 * np.arange(6), fields)
    )
    g = replace(flame(), dynamic=np.ones(150, bool))  # no scene of its own: it has the dataset's plates
    results = [Opened("first", "gof", folder / "a.npz", g), Opened("second", "gof", folder / "b.npz", flame(1))]
    made = share_page(results, folder / "share.html", dataset)
    return made.path, g, dataset


@pytest.fixture(scope="module")
def browser(page):
    with Browser(WIDTH, HEIGHT) as opened:
        opened.open(page_address(page[0], "t=0&bare=1"))
        yield opened


def drawn(browser, fragment: str) -> np.ndarray:
    """(H, W, 3) what the canvas shows for an address."""
    browser.run(f"fromHash('#{fragment}')")
    return now(browser)


def now(browser) -> np.ndarray:
    """(H, W, 3) what the canvas shows."""
    data = base64.b64decode(browser.run("player.picture()").split(",")[1])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")) / 255


def clean(browser, page) -> None:
    """Nothing was said on the console, and nothing but the page was asked for."""
    assert browser.errors == []
    assert browser.requests == [page_address(page[0])]


def test_it_draws_what_the_renderer_draws(browser, page):
    _, g, dataset = page
    browser.resize(WIDTH, HEIGHT)
    for camera in dataset.cameras[:2]:
        for time_s in TIMES_S:
            picture = drawn(browser, f"bare=1&show=0&plate=0&cam={camera.name}&t={1e3 * time_s}")
            expected = np.clip(render(g, camera, time_s)["color"], 0, 1)
            assert picture.shape == expected.shape and expected.mean() > 0.02
            assert psnr(picture, expected) > 50, (camera.name, time_s)
            later = np.clip(render(g, camera, time_s + 0.02)["color"], 0, 1)
            assert psnr(picture, later) < 35, "20 ms later is another picture"
    clean(browser, page)


@pytest.mark.parametrize("name", ["createImageBitmap", "ResizeObserver"])
def test_what_a_browser_lacks_is_named(page, name):
    with Browser(WIDTH, HEIGHT) as old:
        old.ask("Page.enable")
        old.ask("Page.addScriptToEvaluateOnNewDocument", {"source": f"delete window.{name}"})
        old.open(page_address(page[0]))
        said = "document.getElementById('failure').textContent"
        for _ in range(100):
            if old.run(said):
                break
            time.sleep(0.1)
        assert old.run(said) == f"This page needs {name}, which this browser does not offer."


def test_it_draws_over_the_plate_of_a_camera_and_over_black_from_elsewhere(browser, page):
    _, g, dataset = page
    browser.resize(WIDTH, HEIGHT)
    camera = dataset.cameras[2]
    plate = background(dataset, 2, None)
    picture = drawn(browser, "bare=1&show=0&cam=cam_2&t=200")
    assert psnr(picture, np.clip(render(g, camera, 0.2, background=plate)["color"], 0, 1)) > 45
    browser.run("state.view = orbited(state.view, 0.2, 0.1), change()")
    eye, rows = browser.run("state.view.eye"), browser.run("state.view.axes")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rows, -np.array(rows) @ eye
    turned = replace(camera, world_to_camera=pose)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(browser.run("player.picture()").split(",")[1]))))[
        ..., :3
    ]
    assert psnr(picture / 255, np.clip(render(g, turned, 0.2)["color"], 0, 1)) > 50
    middle = browser.run("share.centre")
    before = camera.project(np.array([middle]))[1]
    assert turned.project(np.array([middle]))[1] == pytest.approx(before, rel=1e-5), "turned about the flame's middle"
    clean(browser, page)


def test_emissive_gaussians_are_added_to_a_plate_as_light(tmp_path):
    """The same flame twice, as light and as splats; in false colours, which are no light, both are one picture."""
    cameras = arc(3, width=WIDTH, height=HEIGHT, focal_px=200.0)
    wall = np.linspace(0.05, 0.95, WIDTH)[:, None] * [1.0, 0.8, 0.6] * np.ones((HEIGHT, 1, 1))
    frames = np.full((2, 3, HEIGHT, WIDTH, 3), 0.5)
    plates = np.stack([wall] * 3)
    dataset = Dataset.open(write_dataset(tmp_path / "data", cameras, frames, plates, 0.5 * np.arange(2)))
    g = replace(flame(), dynamic=np.ones(150, bool))
    both = [Opened("light", "gof", tmp_path / "a.npz", replace(g, emissive=True))]
    both.append(Opened("splats", "gof", tmp_path / "b.npz", g))
    made = share_page(both, tmp_path / "share.html", dataset)
    plate, camera = background(dataset, 1, None), dataset.cameras[1]
    with Browser(2 * WIDTH, HEIGHT) as opened:
        opened.open(page_address(made.path, "t=0&bare=1"))
        for time_s in TIMES_S:
            shown = drawn(opened, f"bare=1&show=0 1&cam=cam_1&t={1e3 * time_s}")
            pictures = np.split(shown, 2, axis=1)
            light, splats = (
                np.clip(render(one.gaussians, camera, time_s, background=plate)["color"], 0, 1) for one in both
            )
            assert psnr(light, splats) < 25, "they are two pictures"
            assert psnr(pictures[0], light) > 45 and psnr(pictures[1], splats) > 45, time_s
            black = drawn(opened, f"bare=1&show=0 1&plate=0&cam=cam_1&t={1e3 * time_s}")
            np.testing.assert_allclose(black[:, :WIDTH], black[:, WIDTH:], atol=1.5 / 255)
        speeds = drawn(opened, "bare=1&show=0 1&cam=cam_1&t=200&colour=speed")
        np.testing.assert_array_equal(speeds[:, :WIDTH], speeds[:, WIDTH:])
        assert opened.errors == []
    assert unpack(pack(both[0].gaussians)).emissive and not unpack(pack(g)).emissive


def test_a_static_scene_and_reduced_sizes(browser, page):
    _, _, dataset = page
    browser.resize(WIDTH, HEIGHT)
    camera, g = dataset.cameras[1], flame(1)
    whole = drawn(browser, "bare=1&show=1&plate=0&cam=cam_1&t=300")
    assert psnr(whole, np.clip(render(g, camera, 0.3)["color"], 0, 1)) > 50
    small = drawn(browser, "bare=1&show=1&plate=0&cam=cam_1&t=300&size=0.3")
    browser.run("state.size = 1")
    expected = np.clip(render(replace(g, scale=0.3 * g.scale), camera, 0.3)["color"], 0, 1)
    assert psnr(small, expected) > 50 and psnr(small, whole) < 40


def test_colours_are_speeds_uncertainties_and_the_true_ones(browser, page):
    """The renderer draws the same Gaussians in the colours that numpy looks up."""
    _, g, dataset = page
    browser.resize(2 * WIDTH, HEIGHT)
    camera = dataset.cameras[1]
    scheme = np.array(browser.run("share.scheme")).reshape(256, 3) / 255
    back = unpack(pack(g))

    def expected(value, largest):
        place = np.clip(value / largest, 0, 1) * 255
        low = np.floor(np.where(np.isfinite(place), place, 0)).astype(int)
        rgb = scheme[low] + (place - low)[:, None] * (scheme[np.minimum(low + 1, 255)] - scheme[low])
        rgb[~np.isfinite(value)] = 0.32
        return np.clip(render(replace(back, color=rgb), camera, 0.2)["color"], 0, 1)

    speed_max, uncertainty_max = browser.run("share.speed_max"), browser.run("share.uncertainty_max")
    truth = np.array([0, 0, 2.0])  # of the gas, everywhere and always
    error = np.linalg.norm(back.velocity - truth, axis=-1) / np.sqrt(3)
    both = drawn(browser, "bare=1&show=0 recorded&cam=cam_1&t=200&colour=speed")
    assert psnr(both[:, WIDTH:], expected(np.linalg.norm(back.velocity, axis=-1), speed_max)) > 45
    assert psnr(both[:, :WIDTH], expected(np.full(len(g), 2.0), speed_max)) > 45
    both = drawn(browser, "bare=1&show=0 recorded&cam=cam_1&t=200&colour=uncertainty")
    assert psnr(both[:, WIDTH:], expected(back.velocity_sd, uncertainty_max)) > 45
    assert psnr(both[:, :WIDTH], expected(error, uncertainty_max)) > 45
    browser.run("state.colouring = COLOUR")
    clean(browser, page)


def test_recorded_pictures_are_those_of_the_time(browser, page):
    browser.resize(2 * WIDTH, HEIGHT)
    for frame in (0, 3, 5):
        both = drawn(browser, f"bare=1&show=0 recorded&cam=cam_0&t={100 * frame + 20}")
        assert both[:, :WIDTH].mean() == pytest.approx(0.25 + 0.1 * frame, abs=0.01)


def test_gaussians_of_false_colours_are_half_as_bright_below_lines(browser, page):
    browser.resize(WIDTH, HEIGHT)
    asked, lines = "bare=1&show=0&cam=cam_1&t=200&colour=speed", browser.run("share.lines")
    alone = drawn(browser, asked)
    browser.run("share.lines = 0")  # of the Gaussians have one: what lies below the lines is seen alone
    np.testing.assert_allclose(drawn(browser, f"{asked}&lines=1"), alone / 2, atol=1.5 / 255)
    browser.run(f"share.lines = {lines}")
    assert alone.mean() > 0.02 and not np.allclose(drawn(browser, f"{asked}&lines=1"), alone / 2, atol=0.1)


def test_where_no_true_velocity_is_known_the_filmed_picture_stays(tmp_path):
    cameras = arc(3, width=WIDTH, height=HEIGHT, focal_px=200.0)
    frames, plates = np.full((2, 3, HEIGHT, WIDTH, 3), 0.5), np.full((3, HEIGHT, WIDTH, 3), 0.3)
    dataset = Dataset.open(write_dataset(tmp_path / "data", cameras, frames, plates, 0.5 * np.arange(2)))
    made = share_page([Opened("one", "gof", tmp_path / "a.npz", flame())], tmp_path / "share.html", dataset)
    with Browser(2 * WIDTH, HEIGHT) as opened:
        opened.open(page_address(made.path, "t=0&bare=1"))
        for colour in ("speed", "uncertainty"):
            both = drawn(opened, f"bare=1&show=0 recorded&cam=cam_1&t=200&colour={colour}&lines=1")
            np.testing.assert_allclose(both[:, :WIDTH], 0.5, atol=0.01)
            assert np.ptp(both[:, WIDTH:]) > 0.3, "the flame's colours"
            assert opened.run("byId('captions').firstChild.firstChild.textContent") == "Filmed, Camera 2"


def test_lines_end_where_gaussians_are_and_point_back_along_their_way(browser, page):
    """One Gaussian's line, drawn alone: its bright pixels lie between x - v s and x."""
    _, g, dataset = page
    browser.resize(WIDTH, HEIGHT)
    camera, time_s, span = dataset.cameras[1], 0.2, browser.run("share.line_s = 0.1")
    without = drawn(browser, "bare=1&show=0&plate=0&cam=cam_1&t=200&lines=0")
    with_lines = drawn(browser, "bare=1&show=0&plate=0&cam=cam_1&t=200&lines=1")
    changed = np.argwhere(np.abs(with_lines - without).max(-1) > 0.15)[:, ::-1] + 0.5
    assert len(changed) > 50
    position, opacity = g.at(time_s)
    seen = (opacity > 1 / 255) & (np.abs(time_s - g.t_mu) < 2 * g.t_sigma)
    head, _ = camera.project(position[seen])
    tail, _ = camera.project(position[seen] - span * g.velocity[seen])
    along = np.clip(
        ((changed[:, None] - tail) * (head - tail)).sum(-1) / np.maximum(((head - tail) ** 2).sum(-1), 1e-9), 0, 1
    )
    near = np.linalg.norm(changed[:, None] - (tail + along[..., None] * (head - tail)), axis=-1).min(-1)
    assert np.percentile(near, 95) < 2.0, "px from a way"
    browser.run("state.lines = false")


def test_it_unpacks_what_python_packs(browser, page):
    _, g, _ = page
    back = unpack(pack(g))
    for name, values in {
        "x0": back.position,
        "v": back.velocity,
        "scale": back.scale,
        "opacity": back.opacity,
        "rotation": back.rotation,
        "rgb": back.color,
        "t_mu": back.t_mu,
    }.items():
        np.testing.assert_allclose(browser.run(f"[...clouds[0].columns.{name}]"), values.ravel(), rtol=1e-5, atol=1e-5)


def test_who_is_seen_comes_from_the_farthest_to_the_nearest(browser, page):
    _, g, dataset = page
    camera = dataset.cameras[0]
    eye, forward = camera.position.tolist(), camera.world_to_camera[2, :3].tolist()
    order = browser.run(
        f"sorted({{shown: [0], time: 0.2, eye: {eye}, forward: {forward}}}).then((a) => [...a.orders[0]])"
    )
    position, opacity = unpack(pack(g)).at(0.2)
    depth = camera.to_camera(position)[:, 2]
    visible = np.flatnonzero((opacity >= 1 / 255) & (depth > 0.01))
    assert set(visible) ^ set(order) <= set(np.flatnonzero(np.abs(opacity - 1 / 255) < 1e-6))
    assert (np.diff(depth[order]) < np.ptp(depth) / 65535 + 1e-6).all()


def test_recorded_pictures_are_enlarged_at_most_twice(browser, page):
    """Both panes show 180 x 320 px of 90 x 160, in the middle of 700 px; a result alone fills the height."""
    browser.resize(900, 700)
    grey = drawn(browser, "bare=1&show=0 recorded&cam=cam_0&t=0")
    rows, columns = np.nonzero(np.abs(grey - 0.25).max(-1) < 0.01)  # the recorded frame; its plate is 0.3
    assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == (320, 180) and (rows.min() + rows.max() + 1) / 2 == 350
    assert grey[:, : columns.min()].max() == 0, "on black"
    plate = np.abs(grey - 0.3).max(-1) < 0.01
    assert np.ptp(np.nonzero(plate[:, 451:])[0]) + 1 == 320, "the results beside it are as large"
    alone = drawn(browser, "bare=1&show=0&cam=cam_0&t=0")
    assert np.ptp(np.nonzero(np.abs(alone - 0.3).max(-1) < 0.01)[0]) + 1 == 700


# ---------------------------------------------------------------- one result: what strangers see first


@pytest.fixture(scope="module")
def single(page):
    """The page of the first result alone, which does not say how sure it is."""
    path, g, dataset = page
    one = Opened("one", "gof", path.parent / "c.npz", replace(g, velocity_sd=np.full(150, np.inf)))
    return share_page([one], path.parent / "one.html", dataset).path


def opened_anew(browser, path, fragment="", width=1200, height=700, mobile=False):
    """A browser with the page as a stranger sees it, from its first picture on."""
    browser.resize(width, height, 1.0, mobile)
    browser.open("about:blank")
    browser.open(page_address(path, fragment))
    browser.run("(async () => { while (!byId('captions').children.length) await animationFrame() })()")
    return browser


def degrees_from_home(browser) -> float:
    """Angle between the view as it is drawn and the camera's own."""
    drawn, home = browser.run("[swayed(state.view).axes[2], homeView().axes[2]]")
    return float(np.degrees(np.arccos(min(1, np.dot(drawn, home)))))


def far_enough(browser, degrees=2.0) -> float:
    """Wait until the view has swayed so far; the angle."""
    for _ in range(100):
        if (angle := degrees_from_home(browser)) > degrees:
            return angle
        time.sleep(0.05)
    raise AssertionError("it does not sway")


def test_the_view_sways_until_a_key_and_then_goes_home(browser, single):
    opened_anew(browser, single)
    angles = [degrees_from_home(browser) for _ in range(30) if time.sleep(0.1) is None]
    assert 3 < max(angles) < 5.01 and min(np.abs(np.diff(angles))) < 1, "5 degrees to a side, gently"
    far_enough(browser)
    browser.run("state.playing = false")
    first = now(browser)
    time.sleep(0.5)
    assert psnr(now(browser), first) < 45, "it is drawn so, at one time of the clip"
    eye, pivot = browser.run("[swayed(state.view).eye, state.view.pivot]")
    home = browser.run("homeView().eye")
    assert np.linalg.norm(np.subtract(eye, pivot)) == pytest.approx(np.linalg.norm(np.subtract(home, pivot)))
    assert eye[2] == pytest.approx(home[2]), "about the vertical"
    browser.key("Shift")
    time.sleep(0.6)
    assert degrees_from_home(browser) < 1e-4 and browser.run("atCamera()")
    still = now(browser)
    time.sleep(0.5)
    assert (now(browser) == still).all()


def test_a_hand_takes_the_view_where_it_is(browser, single):
    opened_anew(browser, single)
    far_enough(browser)
    browser.mouse("mousePressed", 300, 300, button="left", buttons=1, clickCount=1)
    held = degrees_from_home(browser)
    time.sleep(0.3)
    assert held > 1 and degrees_from_home(browser) == pytest.approx(held, abs=1e-9)
    assert not browser.run("atCamera()")
    browser.mouse("mouseReleased", 300, 300, button="left")
    browser.run("chooseCamera(0)")
    assert degrees_from_home(browser) < 1e-4


def test_nothing_sways_behind_a_link_or_where_less_motion_is_asked_for(browser, single):
    for fragment, reduced in [("t=100", False), ("cam=cam_0", False), ("", True)]:
        wish = [{"name": "prefers-reduced-motion", "value": "reduce" if reduced else ""}]
        browser.ask("Emulation.setEmulatedMedia", {"features": wish})
        opened_anew(browser, single, fragment)
        assert browser.run("sway.since") is None
        time.sleep(0.5)
        assert degrees_from_home(browser) < 1e-4
    assert browser.run("state.playing") is False, "nor does it play"
    browser.ask("Emulation.setEmulatedMedia", {"features": []})


HINT = "getComputedStyle(byId('hint')).visibility"


def test_the_hint_goes_by_itself_or_at_the_first_key(browser, single):
    opened_anew(browser, single)
    assert browser.run("byId('hint').textContent") == "Drag to turn: this is not a film"
    assert browser.run(HINT) == "visible"
    seen_ms = browser.run(
        f"(async () => {{ const from = performance.now(); while ({HINT} === 'visible') await animationFrame(); "
        "return performance.now() - from; })()"
    )
    assert 1000 < seen_ms < 6000, "some 3 s, less what opening took and more where drawing is slow"
    opened_anew(browser, single)
    assert browser.run(HINT) == "visible"
    browser.key("Shift")
    assert browser.run("byId('hint').classList.contains('gone')")


def test_three_buttons_set_colours_lines_and_scene(whole, single):
    pressed = "[...presetButtons()].filter((b) => b.ariaPressed === 'true').map((b) => b.textContent)"
    shown = "[COLOURINGS[state.colouring], state.lines, state.plate]"
    whole.run("Object.assign(state, {lines: true, plate: false}), change()")
    assert whole.run(pressed) == []
    for name, what in [
        ("Flame", ["colour", False, True]),
        ("Motion", ["speed", True, True]),
        ("Uncertainty", ["uncertainty", False, True]),
        ("Flame", ["colour", False, True]),
    ]:
        whole.run(f"[...presetButtons()].find((b) => b.textContent === '{name}').click()")
        assert whole.run(shown) == what and whole.run(pressed) == [name]
        switches = "[COLOURINGS[document.querySelector('#colours :checked').value], byId('lines').checked]"
        assert whole.run(switches) == what[:2], "the single switches say the same"
    opened_anew(whole, single, "t=0")
    visible = "[...presetButtons()].filter((b) => b.offsetWidth).map((b) => b.textContent)"
    assert whole.run(visible) == ["Flame", "Motion"], "it does not say how sure it is"


def test_a_phone_begins_with_a_wipe(browser, single, page):
    """Left of the line the recorded frame, right of it the flame over its plate; elsewhere there is no line."""
    _, g, dataset = page
    opened_anew(browser, single, "t=200", 390, 844, True)
    assert browser.run("!byId('wipe').hidden") and browser.run("state.panes.size") == 1
    left, top, width, height = map(
        round, browser.run("lensIn(share.cameras[1], canvas.width, canvas.height, 2).picture")
    )
    assert (width, height) == (180, 320)
    camera = dataset.cameras[1].scaled(width, height)
    expected = np.clip(render(g, camera, 0.2, background=np.full((height, width, 3), 0.3))["color"], 0, 1)
    for asked, at in [(None, 90), ("wipe=25", 45), ("wipe=100", 180), ("wipe=0", 0)]:
        if asked:
            browser.run(f"fromHash('#t=200&{asked}')")
        shown = now(browser)[top : top + height, left : left + width]
        np.testing.assert_allclose(shown[:, 1 : max(1, at - 1)], 0.45, atol=0.01)  # 0.25, and 0.1 a frame
        if at < 180:
            assert psnr(shown[:, at + 1 :], expected[:, at + 1 :]) > 38
    browser.run("fromHash('#t=200'), change()")
    captions = browser.run("[...byId('captions').children].map((p) => p.innerText)")
    assert captions == ["Filmed, Camera 2\nframe 3 of 6", "Reconstructed"]
    browser.touch("touchStart", [(300, 200)])
    browser.touch("touchMove", [(340, 200)])
    browser.touch("touchEnd", [])
    turned = now(browser)
    assert browser.run("byId('wipe').hidden") and browser.run("byId('captions').children.length") == 1
    assert np.abs(turned[top : top + height, left : left + width // 4] - 0.45).mean() > 0.1, "no filmed picture there"
    browser.key("0")
    now(browser)
    assert not browser.run("byId('wipe').hidden"), "home again"
    clean_errors(browser)


def test_the_line_is_a_slider_for_hands_and_keys(browser, single):
    opened_anew(browser, single, "t=200", 390, 844, True)
    nodes = browser.ask("Accessibility.getFullAXTree")["nodes"]
    (slider,) = [n for n in nodes if "reconstructed" in n.get("name", {}).get("value", "")]
    assert slider["role"]["value"] == "slider" and slider["value"]["value"] == 50
    browser.run("byId('wipe').focus()")
    for key, percent in [
        ("ArrowRight", 52),
        ("ArrowLeft", 50),
        ("ArrowUp", 52),
        ("Home", 0),
        ("PageUp", 10),
        ("End", 100),
    ]:
        browser.key(key)
        assert browser.run("byId('wipe').ariaValueNow") == str(percent), key
        assert round(100 * browser.run("state.wipe")) == percent and browser.run("atCamera()"), "the view stays"
    browser.run("fromHash('#t=200'), change()")
    now(browser)
    x, y = browser.run(
        "(({x, y, width, height}) => [x + width / 2, y + height / 2])(byId('wipe').getBoundingClientRect())"
    )
    browser.touch("touchStart", [(x, y)])
    browser.touch("touchMove", [(x + 45, y)])  # a quarter of 180 px
    browser.touch("touchEnd", [])
    assert browser.run("state.wipe") == pytest.approx(0.75, abs=0.01) and browser.run("atCamera()")
    assert "wipe=75" in browser.run("player.toHash()")


def test_on_a_phone_the_line_sways_and_not_the_view(browser, single):
    opened_anew(browser, single, "", 390, 844, True)
    places = [browser.run("shownWipe()") for _ in range(30) if time.sleep(0.1) is None]
    assert 0.55 < max(places) <= 0.6 and degrees_from_home(browser) < 1e-4
    browser.key("Shift")
    time.sleep(0.6)
    assert browser.run("[shownWipe(), atCamera()]") == [0.5, True]


def test_a_wide_page_offers_the_wipe_beside_two_panes(browser, single):
    opened_anew(browser, single, "t=200")
    chip = "[...document.querySelectorAll('#panes label')].find((e) => e.textContent === '{}').firstChild"
    checked = "[...document.querySelectorAll('#panes :checked')].map((e) => e.nextSibling.textContent)"
    captions = "byId('captions').children.length"
    assert browser.run(checked) == ["Filmed", "Reconstructed"] and browser.run("byId('wipe').hidden")
    browser.run(chip.format("Wipe") + ".click()")
    now(browser)
    assert browser.run(checked) == ["Reconstructed", "Wipe"] and not browser.run("byId('wipe').hidden")
    browser.run("state.view = orbited(state.view, 0.3, 0), change()")
    now(browser)
    assert browser.run(checked) == ["Reconstructed"] and browser.run(captions) == 1
    browser.run(chip.format("Wipe") + ".click()")
    assert browser.run("atCamera()") and browser.run(checked) == ["Reconstructed", "Wipe"]
    browser.run(chip.format("Filmed") + ".click()")
    now(browser)
    assert browser.run(checked) == ["Filmed", "Reconstructed"] and browser.run("byId('wipe').hidden")
    assert browser.run(captions) == 2


def test_the_snippet_shows_this_file_in_another_page(browser, single):
    """It names the file and no folder; beside the file, a browser loads the page from it."""
    opened_anew(browser, single, "t=0")
    browser.run("navigator.clipboard.writeText = async (text) => { window.taken = text }")
    browser.run("byId('embed').click()")
    snippet = browser.run("taken")
    assert snippet.startswith('<iframe src="one.html" title="') and str(single.parent) not in snippet
    assert "HTML copied" in browser.run("byId('said').textContent")
    browser.run("document.title = 'a \"b\" <c>'")
    assert unescape(re.search('title="([^"]*)"', browser.run("embedding()"))[1]) == 'a "b" <c>'
    outer = single.parent / "outer.html"
    outer.write_text(f"<!doctype html><title>outer</title>{snippet}", encoding="utf-8")
    browser.open(outer.resolve().as_uri())
    inner = browser.ask("Page.getFrameTree")["frameTree"]["childFrames"]
    assert [frame["frame"]["url"] for frame in inner] == [page_address(single)]


# ---------------------------------------------------------------- hands


@pytest.fixture
def whole(browser, page):
    """The page with its controls, at a desktop's size, standing still."""
    browser.resize(1200, 700)
    browser.open("about:blank")
    browser.open(page_address(page[0], "t=100&show=0"))
    return browser


def test_play_goes_at_the_chosen_speed_and_loops(whole):
    """100 ms of the clock are 100 ms / slow of the clip, which lasts 500 ms."""
    for slow, begin, loop, end in [
        (10, 0.0, True, 0.01),
        (100, 0.2, True, 0.201),
        (1, 0.45, True, 0.05),
        (1, 0.45, False, 0.5),
    ]:
        asked = f"{{playing: true, slow: {slow}, time: {begin}, loop: {str(loop).lower()}}}"
        time_s, playing = whole.run(f"Object.assign(state, {asked}), advance(100), [state.time, state.playing]")
        assert time_s == pytest.approx(end, abs=1e-9)
        assert playing == loop, "without the loop it stops at the end"
    whole.run("Object.assign(state, {playing: false, slow: 10, time: 0.1, loop: true}); document.activeElement.blur()")
    whole.key(" ")
    assert whole.run("state.playing") and whole.run("byId('play').getAttribute('aria-label')") == "Pause"
    times = [0.1]
    for _ in range(100):
        times.append(whole.run("new Promise((r) => setTimeout(() => r(state.time), 100))"))
        if len(set(times)) > 3:
            break
    whole.key(" ")
    assert len(set(times)) > 3 and not whole.run("state.playing")
    stopped = whole.run("state.time")
    assert whole.run("new Promise((r) => setTimeout(() => r(state.time), 300))") == stopped
    clean_errors(whole)


def clean_errors(browser) -> None:
    assert browser.errors == []


def test_keys_choose_cameras_colours_lines_and_frames(whole):
    whole.run("document.activeElement.blur()")
    for key, expression, value in [
        ("3", "state.camera", 2),
        ("c", "COLOURINGS[state.colouring]", "speed"),
        ("c", "COLOURINGS[state.colouring]", "uncertainty"),
        ("c", "COLOURINGS[state.colouring]", "colour"),
        ("v", "state.lines", True),
        ("b", "state.plate", False),
        (".", "state.time", pytest.approx(0.2)),
        (",", "state.time", pytest.approx(0.1)),
        (",", "state.time", pytest.approx(0.0)),
    ]:
        whole.key(key)
        assert whole.run(expression) == value, key
    whole.run("byId('canvas').focus()")
    whole.key("ArrowLeft")
    assert not whole.run("atCamera()")
    whole.key("0")
    assert whole.run("atCamera()")
    clean_errors(whole)


def test_mouse_turns_moves_and_zooms(whole):
    start = whole.run("state.view")
    middle = np.array(start["pivot"])

    def drag(button, **more):
        whole.mouse("mousePressed", 300, 300, button=button, buttons={"left": 1, "right": 2}[button], clickCount=1)
        for k in range(1, 4):
            whole.mouse("mouseMoved", 300 + 20 * k, 300 + 5 * k, button=button, buttons={"left": 1, "right": 2}[button])
        whole.mouse("mouseReleased", 360, 315, button=button)
        return whole.run("state.view")

    turned = drag("left")
    distance = [np.linalg.norm(np.array(view["eye"]) - middle) for view in (start, turned)]
    assert distance[1] == pytest.approx(distance[0], rel=1e-6) and turned["pivot"] == start["pivot"]
    angle = np.arccos(np.dot(start["axes"][2], turned["axes"][2]))
    assert 0.3 < angle < 0.7
    words = whole.run("byId('captions').textContent")
    away = whole.run("awayFromCameras()")
    filmed = whole.run("share.cameras.slice(0, share.given).map((_, i) => homeView(i).axes[2])")
    expected = np.degrees(np.arccos(max(np.array(filmed) @ np.array(turned["axes"][2]))))
    assert away == pytest.approx(expected, abs=1e-6)
    assert ("its shape is a guess" in words) == (away >= 20)
    np.testing.assert_allclose(np.array(turned["axes"]) @ np.array(turned["axes"]).T, np.eye(3), atol=1e-9)
    moved = drag("right")
    np.testing.assert_allclose(np.subtract(moved["eye"], turned["eye"]), np.subtract(moved["pivot"], turned["pivot"]))
    assert np.linalg.norm(np.subtract(moved["eye"], turned["eye"])) > 0.05
    whole.mouse("mouseWheel", 300, 300, deltaX=0, deltaY=-200)
    whole.run("new Promise((r) => setTimeout(r, 100))")
    near = whole.run("reach(state.view)")
    assert near == pytest.approx(np.exp(-0.3) * np.linalg.norm(np.subtract(moved["eye"], moved["pivot"])), rel=0.02)
    clean_errors(whole)


def test_fingers_turn_and_pinch(whole):
    whole.resize(390, 844, 2, True)
    x, y = 190, 300
    whole.touch("touchStart", [(x, y)])
    whole.touch("touchMove", [(x + 60, y)])
    whole.touch("touchEnd", [])
    assert not whole.run("atCamera()")
    before = whole.run("reach(state.view)")
    whole.touch("touchStart", [(x - 40, y), (x + 40, y)])
    whole.touch("touchMove", [(x - 80, y), (x + 80, y)])
    whole.touch("touchEnd", [])
    assert whole.run("reach(state.view)") == pytest.approx(before / 2, rel=0.05)
    overflow = whole.run("document.documentElement.scrollWidth - innerWidth")
    assert overflow <= 0, "nothing hangs over a phone's edge"
    sizes = whole.run(
        "[...document.querySelectorAll('#transport button, #transport select')].map((e) => e.offsetHeight)"
    )
    assert min(sizes) >= 40, "fingers find every control"
    clean_errors(whole)


def test_a_link_brings_back_view_time_and_what_is_shown(whole, page):
    whole.run(
        "state.view = orbited(state.view, 0.4, 0.2), state.time = 0.3, state.colouring = SPEED, state.lines = true, "
        "state.size = 0.5, state.slow = 50, state.panes = new Set([1, RECORDED])"
    )
    first, link = now(whole), whole.run("player.toHash()")
    assert re.fullmatch(r"[\w=&.+-]+", link), "a link that survives being mailed"
    whole.open("about:blank")
    whole.open(page_address(page[0], link))
    first_words, second_words = (re.split("[=&_]", text) for text in (link, whole.run("player.toHash()")))
    assert len(first_words) == len(second_words) > 20
    for one, other in zip(first_words, second_words, strict=True):
        assert one == other or float(one) == pytest.approx(float(other), abs=2e-4)
    assert psnr(now(whole), first) > 45
    assert not whole.run("state.playing")
    whole.run("copyLink()")
    assert whole.run("location.hash.slice(1)") == whole.run("player.toHash()")
    nonsense = "t=nan&cam=nowhere&view=1_2&colour=pink&size=9&slow=3&show=7"
    whole.run(f"fromHash('#{nonsense}')")
    assert whole.run("player.picture()").startswith("data:image/png")
    clean_errors(whole)


def test_everything_that_can_be_reached_has_a_name(whole):
    """As a screen reader is told: every control has a role and a name; the slider says its time in words."""
    nodes = whole.ask("Accessibility.getFullAXTree")["nodes"]
    controls = {"button", "slider", "checkbox", "radio", "combobox", "application", "DisclosureTriangle"}
    found = [n for n in nodes if not n["ignored"] and n["role"]["value"] in controls]
    names = {(n["role"]["value"], n.get("name", {}).get("value", "")) for n in found}
    assert all(name for _, name in names)
    for role, name in [("slider", "Time"), ("button", "Play"), ("button", "Loop"), ("combobox", "Speed")]:
        assert (role, name) in names
    assert {("radio", "Camera 1"), ("checkbox", "Filmed"), ("button", "Motion"), ("button", "Copy link")} <= names
    assert ("DisclosureTriangle", "More") in names and ("checkbox", "Velocity lines") not in names, "folded"
    assert whole.run("document.querySelector('#cameras span').title") == "cam_0", (
        "the file's name, where it is looked for"
    )
    whole.run("document.querySelectorAll('details').forEach((e) => (e.open = true))")
    words = whole.run("document.body.innerText")
    assert {"Colour", "Filmed", "Splat size"} <= set(words.splitlines())
    assert not re.search("Radiance|Truth|Recorded|Size of Gaussians|cam_", words)
    assert "milliseconds frame 2 of 6" in whole.run("byId('time').getAttribute('aria-valuetext')")
    reached = []
    whole.run("document.activeElement.blur()")
    for _ in range(40):
        whole.key("Tab")
        reached.append(
            whole.run("document.activeElement.id || document.activeElement.value || document.activeElement.tagName")
        )
    assert {
        "flame",
        "motion",
        "uncertainty",
        "embed",
        "canvas",
        "lines",
        "plate",
        "size",
        "copy",
        "save",
        "time",
        "play",
        "slow",
        "loop",
    } <= set(reached)


def test_a_lost_device_comes_back(whole):
    before = now(whole)
    whole.run(
        """(async () => { const lose = drawer.gl.getExtension('WEBGL_lose_context'); lose.loseContext();
        const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
        await wait(200); lose.restoreContext(); await wait(800); })()"""
    )
    assert psnr(now(whole), before) > 60
