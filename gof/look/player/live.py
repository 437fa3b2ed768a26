"""`gof view`: the player's page, served to this machine alone, which follows a reconstruction that still runs.

The page requests newer results here, and an instant's Gaussians of a result that is sampled in time.
A browser lets every page on the web ask addresses of the machine it runs on. It says so in `Origin`; and a page whose
own name was bent to this machine (DNS rebinding) still sends that name as `Host`. Neither gets an answer.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from email.message import Message
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.look.player.opened import Opened, measured_alike, newest, open_moving
from gof.look.player.page import PageSetting, assemble, packed_result, scales, subtitle, title_of
from gof.look.player.quantise import pack

HOST = "127.0.0.1"
SAMPLED = 5  # instants of a result that is sampled in time, at which the largest speed is looked for
PICTURES_MB = 2.0  # of the recorded pictures on the page


class Live:
    """A result as the page shows it, read again whenever its file is a newer one.

    Args:
        path: a result of any known method, or the folder of a reconstruction, finished or not.
        dataset: its cameras, plates, recorded frames and, where it is known, the true velocity.
    Raises:
        DataFormatError, GofError: see `newest`, `open_moving`.
    """

    def __init__(self, path: Path, dataset: Dataset | None = None):
        self._path, self._dataset = path, dataset
        self._one_at_a_time = threading.Lock()
        self._read()
        self.setting = PageSetting.of([self._opened], dataset)
        first = Opened(self._opened.name, self._opened.method, self._opened.path, self._state(self.setting.first_s))
        self._fixed, _ = self.setting.content(first, PICTURES_MB, lambda done, count: None)

    def page(self) -> str:
        """Return the page with the newest result in it."""
        with self._one_at_a_time:
            self._refresh()
            title = title_of([self._opened], self._dataset)
            return assemble(self._fixed | self._shown() | {"live": True, "file": self._opened.name}, title)

    def news(self, have: str) -> dict[str, Any] | None:
        """Return the differences from a page that has the result of stamp `have`; None where there are none."""
        with self._one_at_a_time:
            self._refresh()
            return None if have == self._stamp else self._shown()

    def instant(self, time_s: float) -> dict[str, Any]:
        """Return the Gaussians of one time, s after the clip's first."""
        with self._one_at_a_time:
            state = self._state(self.setting.first_s + time_s)
            return {"results": [packed_result(self._opened.name, pack(state, self.setting.truth_at(state)))]}

    def _refresh(self) -> None:
        try:
            if self._stamp != _stamp(newest(self._path)):
                self._read()
        except (GofError, OSError):
            pass  # it is being replaced at this moment; the next look finds it

    def _read(self) -> None:
        stamp = _stamp(newest(self._path))
        (self._opened,) = measured_alike([open_moving(self._path)], self._dataset)
        self._stamp = stamp

    @property
    def _sampled(self) -> bool:
        return not isinstance(self._opened.gaussians, TransientGaussians)

    def _state(self, time_s: float) -> TransientGaussians:
        """Return the result itself, where its motion is a closed form; else its Gaussians at a time that it knows."""
        gaussians = self._opened.gaussians
        if isinstance(gaussians, TransientGaussians):
            return gaussians
        return gaussians.state_at(float(np.clip(time_s, *gaussians.covered_s)))

    def _shown(self) -> dict[str, Any]:
        """Return all that changes with the result."""
        setting, opened = self.setting, self._opened
        times = setting.first_s + setting.length_s * np.linspace(0, 1, SAMPLED if self._sampled else 1)
        states = [self._state(time_s) for time_s in times]
        truths = [setting.truth_at(state) for state in states]
        return {
            "results": [packed_result(opened.name, pack(states[0], truths[0]))],
            "sampled": self._sampled,
            "instant": 0.0,
            "stamp": self._stamp,
            "subtitle": f"{opened.path.name}: {subtitle([opened], setting)}",
            "facts": [(opened.name, f"{len(opened.gaussians):,} Gaussians, read as {opened.method}")],
            **scales(states, truths),
        }


def serve(live: Live, port: int = 0) -> ThreadingHTTPServer:
    """Return a server on 127.0.0.1 with `live`'s page at /; its `serve_forever` answers.

    Args:
        port: 0 = any that is free.
    Raises:
        GofError: the port is taken.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if not is_own_page(self.headers):
                return self._answer(HTTPStatus.FORBIDDEN, b"not a page of this server\n", "text/plain")
            asked = urlsplit(self.path)
            parameters = {key: values[0] for key, values in parse_qs(asked.query).items()}
            if asked.path == "/":
                return self._answer(HTTPStatus.OK, live.page().encode(), "text/html; charset=utf-8")
            if asked.path == "/news":
                news = live.news(parameters.get("have", ""))
                return self._answer_json(news) if news else self._answer(HTTPStatus.NO_CONTENT)
            if asked.path == "/instant" and (time_s := _number(parameters.get("time", ""))) is not None:
                return self._answer_json(live.instant(time_s))
            return self._answer(HTTPStatus.NOT_FOUND, b"there is / alone\n", "text/plain")

        def _answer_json(self, content: Any) -> None:
            self._answer(HTTPStatus.OK, json.dumps(content, allow_nan=False).encode(), "application/json")

        def _answer(self, status: HTTPStatus, body: bytes = b"", kind: str = "text/plain") -> None:
            self.send_response(status)
            for name, value in {
                "Content-Type": kind,
                "Content-Length": str(len(body)),
                "Cache-Control": "no-store",
                "Cross-Origin-Resource-Policy": "same-origin",
                "X-Content-Type-Options": "nosniff",
            }.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args: Any) -> None:
            """Say nothing: one line for every look of a page is of no use."""

    try:
        return _Server((HOST, port), Handler)
    except OSError as e:
        raise GofError(f"--port {port}: {e.strerror}; without it any free port is taken") from e


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = False  # another program's port is not shared

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a page that was closed while it was answered."""


def is_own_page(headers: Mapping[str, str] | Message) -> bool:
    """Return whether a request is one of a page of ours, under any port that leads here, or of no browser."""
    try:
        asked = urlsplit(f"//{headers.get('Host', '')}")
        origin = headers.get("Origin")
        return asked.hostname in ("localhost", HOST) and origin in (None, f"http://{asked.netloc}")
    except ValueError:  # no address at all
        return False


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if np.isfinite(number) else None


def _stamp(path: Path) -> str:
    return f"{path.name} {path.stat().st_mtime_ns}"
