"""A result in the browser, in 3D with a time slider; also one that is still being optimised."""

from __future__ import annotations

import socket
import time
from pathlib import Path

import numpy as np

from gof.core.errors import GofError
from gof.core.gaussians import MovingGaussians, TransientGaussians
from gof.core.harmonics import plain_color
from gof.core.rotations import quaternions_wxyz, rotation_matrices
from gof.dataset import Dataset
from gof.host import extras
from gof.io.importers import read_result
from gof.look import legend
from gof.look import switches as controls
from gof.look.own_pages import only_own_pages
from gof.look.player.opened import middle_of, newest, time_span

INVISIBLE = 1 / 255  # opacity below which a Gaussian changes no 8-bit picture
LINE_PX, TAIL, HEAD = 1.6, 0.4, 1.0  # of a velocity line: width, and brightness at its ends (viser's do not fade)
SAMPLED = 5  # instants of a result whose motion is no closed form, at which the largest speed is looked for
RADIANCE, SPEED, DOUBT = controls.COLOURS
EMBER = (217, 95, 2)  # of sliders and buttons
FILLED = 0.9  # of the window's height, by the near side of a round flame, when it opens
NEARER_THAN_CAMERAS = 0.85  # of their distance from the flame: where one stands at most
CAMERA_SIZE = 0.07  # of that distance: how large cameras are drawn
STEP_S = 0.03  # pause between two looks at the slider and at the file


def splats(gaussians: TransientGaussians, time_s: float) -> dict[str, np.ndarray]:
    """What is visible at a time.

    Returns:
        centers (N, 3) m, covariances (N, 3, 3) m², rgbs (N, 3) in [0, 1], opacities (N, 1), velocities (N, 3) m/s,
        doubts (N,) m/s: standard deviation of a component of the velocity, inf where nobody says; and rows (N,): which
        of `gaussians` they are.
    """
    position, opacity = gaussians.at(time_s)
    seen = opacity >= INVISIBLE
    axes = rotation_matrices(gaussians.rotation[seen]) * gaussians.scale[seen, None, :]
    return {
        "centers": position[seen],
        "covariances": (axes @ axes.transpose(0, 2, 1)).astype(np.float32),
        "rgbs": np.clip(plain_color(gaussians.color[seen]), 0, 1),
        "opacities": opacity[seen, None],
        "velocities": gaussians[seen].moving_gas,
        "doubts": np.where(gaussians.dynamic[seen], gaussians.velocity_sd[seen], np.inf),
        "rows": np.flatnonzero(seen),
    }


def mapped(values: np.ndarray, largest: float) -> np.ndarray:
    """(N, 3) colours in [0, 1], dark violet for 0 to yellow for `largest` and above; grey for inf: nobody says."""
    share = np.clip(values / max(largest, 1e-12), 0, 1)
    colours = controls.scheme()[np.uint8(255 * share)].astype(np.float32) / 255
    colours[np.isinf(values)] = legend.NOBODY_SAYS
    return colours


def scale_html(largest: float, note: str) -> str:
    """The legend of the page of `gof share`: its colours, its numbers, its words."""
    colours = ", ".join(f"rgb({r},{g},{b})" for r, g, b in controls.scheme()[::16])
    ticks = "".join(f"<span>{tick}</span>" for tick in legend.ticks(largest))
    return (
        f'<div style="padding: 0.4em 0.8em; font-size: 12px"><div style="height: 10px; border-radius: 5px; '
        f'background: linear-gradient(90deg, {colours})"></div>'
        f'<div style="display: flex; justify-content: space-between; margin-top: 3px">{ticks}</div>'
        f'<p style="margin: 4px 0 0">{note}</p></div>'
    )


class Viewer:
    """A viser server with one result.

    Args:
        path: a result of any known method, or the folder of a reconstruction, finished or not.
        dataset: shows its cameras with their pictures, and knows the frame times.
        host, port: where to listen.
    Raises:
        MissingDependencyError: viser is not installed.   DataFormatError, GofError: see `newest`, `read_result`.
    """

    def __init__(self, path: Path, dataset: Dataset | None = None, host: str = "127.0.0.1", port: int = 8080):
        viser = extras.load("viser", "view", "gof view")
        _require_address(host, port)
        self.path = path
        self.dataset = dataset
        self.result = self._read()
        first, last = time_span(self.result, self.dataset)
        step = self.dataset.frame_time_s if self.dataset else max(last - first, 1e-3) / 100

        class LocalServer(viser.ViserServer):
            """One that cannot be published: any page could ask for a public tunnel to it."""

            def request_share_url(self, verbose: bool = True) -> None:
                return None

        with only_own_pages(host):
            self.server = LocalServer(host=host, port=port, label="Gaussians on Fire", verbose=False)
        gui, scene = self.server.gui, self.server.scene
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, brand_color=EMBER)
        scene.set_background_image(np.full((1, 1, 3), 12, np.uint8))  # fire is light: it shows on black
        scene.set_up_direction("+z")
        self.first_s, self.length_s = first, last - first
        if self.dataset is not None:
            names = [camera.name for camera in self.dataset.cameras]
            self.camera = gui.add_button_group(controls.CAMERA, names)
            self.camera.on_click(lambda event: self._look_from(event.client, event.target.value))
        self.color = gui.add_dropdown(controls.COLOUR, controls.COLOURS)
        self.lines = gui.add_checkbox(controls.LINES, False)
        self.size = gui.add_slider(f"{controls.SIZE}, %", *controls.SIZE_PERCENT, 100)
        self.reset = gui.add_button(controls.RESET)
        self.reset.on_click(lambda event: self._look_from(event.client, None))
        self.time = gui.add_slider(f"{controls.TIME}, ms", 0.0, max(1e3 * (last - first), 1e-3), 1e3 * step / 4, 0.0)
        self.play = gui.add_checkbox(controls.PLAY, True)
        self.speed = gui.add_dropdown(controls.SPEED, tuple(controls.SPEEDS), initial_value=controls.FIRST_SPEED)
        self.loop = gui.add_checkbox(controls.LOOP, True)
        self.scale = gui.add_html("", visible=False)
        self.text = gui.add_markdown("")
        self._offer()
        self._frustums = {}
        self._take_keys()
        self._stand()
        self._show_cameras()
        self._shown = None

    def run(self) -> None:
        """Follow the slider and the file until interrupted."""
        before = time.perf_counter()
        while True:
            now = time.perf_counter()
            if self.play.value and self.length_s > 0:
                self.advance(now - before)
            before = now
            self.refresh()
            self.show(self.first_s + self.time.value / 1e3)
            time.sleep(STEP_S)

    def advance(self, seconds: float) -> None:
        """Play on by so many seconds of the clock; at the end from the start again, or stop there.

        Who plays on from the end begins at the start.
        """
        now = self.time.value / 1e3
        played = (now if now < self.length_s else 0.0) + seconds / controls.SPEEDS[self.speed.value]
        if self.loop.value:
            played %= self.length_s
        elif played >= self.length_s:
            played, self.play.value = self.length_s, False
        self.time.value = 1e3 * played

    def refresh(self) -> None:
        """Read the file again if there is a newer one."""
        try:
            if self._stamp != _stamp(newest(self.path)):
                self.result = self._read()
                self._offer()
        except (GofError, OSError):
            pass  # it is being replaced at this moment; the next look finds it

    def show(self, time_s: float) -> None:
        """Draw the state at `time_s`, unless it is on the screen already."""
        state = (time_s, self.lines.value, self.color.value, self.size.value, self._stamp)
        if state == self._shown:
            return
        self._shown = state
        seen = splats(self.result.state_at(time_s), time_s)
        velocity, doubt, rows = seen.pop("velocities"), seen.pop("doubts"), seen.pop("rows")
        speed = np.linalg.norm(velocity, axis=-1)
        if self.color.value == SPEED:
            seen["rgbs"] = mapped(speed, self.speed_max)
        elif self.color.value == DOUBT:
            seen["rgbs"] = mapped(doubt, self.doubt_max)
        seen["covariances"] = seen["covariances"] * np.float32((self.size.value / 100) ** 2)
        scene = self.server.scene
        scene.add_gaussian_splats("/flame", **seen)
        moving = np.flatnonzero(velocity.any(-1) & legend.has_line(len(self.result))[rows])
        heads = seen["centers"][moving]
        ends = np.stack([heads - legend.line_s(self.length_s) * velocity[moving], heads], 1)
        paint = 255 * mapped(speed[moving], self.speed_max)[:, None] * np.array([[TAIL], [HEAD]])
        # On the screen: viser's own default is a centimetre of the world, which would cover a candle.
        width = {"thickness": LINE_PX, "thickness_units": "screen"}
        scene.add_line_segments("/velocity", ends, np.uint8(paint), visible=self.lines.value, **width)
        self._show_scale()
        mean = np.average(speed, weights=seen["opacities"][:, 0]) if len(speed) else 0.0
        self.text.content = (
            f"**{self._file.name}** · {1e3 * (time_s - self.first_s):.1f} ms · {len(velocity):,} of "
            f"{len(self.result):,} Gaussians visible · mean speed {mean:.2f} m/s{_how_sure(doubt)}"
        )

    def _offer(self) -> None:
        """The scales of the result that was read, and the colours and lines that it has something for."""
        result = self.result
        closed = isinstance(result, TransientGaussians)
        times = np.linspace(self.first_s, self.first_s + self.length_s, 1 if closed else SAMPLED)
        states = [result.state_at(float(time_s)) for time_s in times]
        self.speed_max, self.doubt_max = legend.speed_scale(states), legend.doubt_scale(states)
        largest = {RADIANCE: 1.0, SPEED: self.speed_max, DOUBT: self.doubt_max}
        offered = tuple(colour for colour in controls.COLOURS if largest[colour] > 0)
        if offered != tuple(self.color.options):
            self.color.options = offered
        self.lines.visible = self.speed_max > 0

    def _show_scale(self) -> None:
        """The legend of whatever is coloured by a velocity; the page of `gof share` shows the same one."""
        if self.color.value == DOUBT:
            self.scale.content = scale_html(self.doubt_max, legend.DOUBT_NOTE)
        else:
            way = f" {legend.line_note(legend.line_s(self.length_s))}" if self.lines.value else ""
            self.scale.content = scale_html(self.speed_max, legend.SPEED_NOTE + way)
        self.scale.visible = self.color.value != RADIANCE or self.lines.value

    def _take_keys(self) -> None:
        """The player's keys, as commands of viser."""

        def next_color() -> None:
            at = self.color.options.index(self.color.value)
            self.color.value = self.color.options[(at + 1) % len(self.color.options)]

        def flip(box) -> None:
            box.value = not box.value

        add = self.server.gui.add_command
        add(controls.PLAY, hotkey="space").on_trigger(lambda event: flip(self.play))
        add(controls.COLOUR, hotkey="C").on_trigger(lambda event: next_color())
        add(controls.LINES, hotkey="V").on_trigger(lambda event: self.speed_max > 0 and flip(self.lines))
        add(controls.RESET, hotkey="0").on_trigger(lambda event: self._look_from(event.client, None))
        for number, camera in enumerate(self.dataset.cameras[:9] if self.dataset else (), 1):
            add(f"{controls.CAMERA} {camera.name}", hotkey=str(number)).on_trigger(
                lambda event, name=camera.name: self._look_from(event.client, name)
            )

    def _stand(self) -> None:
        """Look at the flame from where the middle camera stands, so near that it fills most of the window.

        Nearer than the cameras: their own pictures would hide it.
        """
        time_s = self.first_s + self.length_s / 2
        middle, size = middle_of(self.result.state_at(time_s), time_s)
        start = self.server.initial_camera
        away = np.array([0.0, -1.0, 0.12])
        farthest = np.inf
        if self.dataset is not None:
            away = self.dataset.cameras[len(self.dataset.cameras) // 2].position - middle
            farthest = NEARER_THAN_CAMERAS * self._camera_distance(middle)
        distance = min(size + size / (FILLED * np.tan(start.fov / 2)), farthest)
        start.look_at, start.position = middle, middle + distance * away / np.linalg.norm(away)

    def _camera_distance(self, middle: np.ndarray) -> float:
        """m, of the nearest camera from a point."""
        return min(float(np.linalg.norm(camera.position - middle)) for camera in self.dataset.cameras)

    def _show_cameras(self) -> None:
        if self.dataset is None:
            return
        time_s = self.first_s + self.length_s / 2
        size = CAMERA_SIZE * self._camera_distance(middle_of(self.result.state_at(time_s), time_s)[0])
        for number, camera in enumerate(self.dataset.cameras):
            pose = np.linalg.inv(camera.world_to_camera)
            fov = 2 * np.arctan(camera.height / 2 / camera.K[1, 1])
            middle = self.dataset.times_s.size // 2
            self._frustums[camera.name] = frustum = self.server.scene.add_camera_frustum(
                f"/cameras/{camera.name}",
                float(fov),
                camera.width / camera.height,
                scale=size,
                color=(110, 110, 110),
                image=np.uint8(255 * self.dataset.image(number, middle)),
                wxyz=quaternions_wxyz(pose[:3, :3]),
                position=pose[:3, 3],
            )

            @frustum.on_click
            def _(event, name=camera.name):
                self._look_from(event.client, name)

    def _look_from(self, client, name: str | None) -> None:
        """Stand where a camera stands, without its picture, which would hide the flame; None: where it opened."""
        for other, frustum in self._frustums.items():
            frustum.visible = other != name
        with client.atomic():
            if name is None:
                start = self.server.initial_camera
                client.camera.position, client.camera.look_at = start.position, start.look_at
                client.camera.up_direction, client.camera.fov = (0.0, 0.0, 1.0), start.fov
            else:
                frustum = self._frustums[name]
                client.camera.wxyz, client.camera.position = frustum.wxyz, frustum.position
                client.camera.fov = frustum.fov

    def _read(self) -> MovingGaussians:
        self._file = newest(self.path)
        self._stamp = _stamp(self._file)
        gaussians = read_result(self._file).gaussians
        return gaussians if self.dataset is None else gaussians.measured_from(self.dataset.datum)


def _how_sure(doubt: np.ndarray) -> str:
    """The usual doubt in words; nothing where nobody says."""
    said = doubt[np.isfinite(doubt) & (doubt > 0)]
    return f" ± {np.median(said):.2f} in each component" if len(said) else ""


def _require_address(host: str, port: int) -> None:
    """viser itself would wait for ever for a server that cannot come up."""
    try:
        socket.getaddrinfo(host, None)
    except OSError as e:
        raise GofError(f"--host {host}: no address of this machine ({e})") from e
    if not 0 <= port < 65536:
        raise GofError(f"--port {port}: must be 0 to 65535 (0: any that is free)")


def _stamp(path: Path) -> tuple[Path, float]:
    return path, path.stat().st_mtime
