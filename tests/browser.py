"""A headless Chromium that a script drives through its debugging pipe; nothing listens, and no package is needed."""

from __future__ import annotations

import base64
import itertools
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from gof.core.errors import GofError, MissingDependencyError
from gof.host.processes import python_command

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
# Software drawing where there is no GPU; nothing is asked of the network by the browser itself.
OPTIONS = (
    "--headless=new --no-sandbox --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --disable-extensions --mute-audio --hide-scrollbars --use-gl=angle --use-angle=swiftshader "
    "--enable-unsafe-swiftshader --remote-debugging-pipe"
).split()
# It reads its commands from file 3 and answers on file 4.
ON_FILES_3_AND_4 = """
import fcntl, os, sys
high = [fcntl.fcntl(int(number), fcntl.F_DUPFD, 10) for number in sys.argv[1:3]]
os.dup2(high[0], 3), os.dup2(high[1], 4)
os.execv(sys.argv[3], sys.argv[3:])
"""


def chromium() -> str | None:
    """Path of a Chromium or Chrome on this machine, None where there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page of a fresh Chromium. Use as a context; the browser and its profile are gone afterwards.

    Attributes:
        errors: what the page's console and its exceptions said, in order.
        requests: addresses that the page asked for, data: and blob: left out.
    Raises:
        MissingDependencyError: no Chromium is installed.
    """

    def __init__(self, width: int = 1400, height: int = 900, scale: float = 1.0, mobile: bool = False):
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._size = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": mobile}
        self._numbers, self._buffer, self._answers = itertools.count(1), b"", {}

    def __enter__(self) -> Browser:
        program = chromium()
        if program is None:
            raise MissingDependencyError(f"no browser: none of {', '.join(NAMES)} is installed")
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()
        command = [program, *OPTIONS, f"--user-data-dir={self._profile.name}", "about:blank"]
        begun = python_command("-c", ON_FILES_3_AND_4, str(theirs_in), str(theirs_out), *command)
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(begun, pass_fds=(theirs_in, theirs_out), **quiet)
        os.close(theirs_in), os.close(theirs_out)
        target = self._ask("Target.createTarget", {"url": "about:blank"})["targetId"]
        self._session = self._ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.ask(f"{domain}.enable")
        self.resize(**self._size)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._ask("Browser.close", {})
        except (GofError, OSError):
            pass
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to), os.close(self._from)
        self._profile.cleanup()

    def resize(self, width: int, height: int, deviceScaleFactor: float = 1.0, mobile: bool = False) -> None:
        """Size of the page in CSS pixels; `mobile`: touch, and a phone's reading of the viewport."""
        size = {"width": width, "height": height, "deviceScaleFactor": deviceScaleFactor, "mobile": mobile}
        self.ask("Emulation.setDeviceMetricsOverride", size)
        self.ask("Emulation.setTouchEmulationEnabled", {"enabled": mobile})

    def open(self, address: str) -> None:
        """Load a page and wait until it has loaded."""
        self._loaded = False
        self.ask("Page.navigate", {"url": address})
        self._until(lambda: self._loaded, f"{address} to load")

    def run(self, expression: str, seconds: float = 60) -> Any:
        """Value of a JavaScript expression in the page; a promise is waited for.

        Raises:
            GofError: it threw.
        """
        asked = {"expression": expression, "awaitPromise": True, "returnByValue": True, "userGesture": True}
        answer = self.ask("Runtime.evaluate", asked, seconds)
        if "exceptionDetails" in answer:
            thrown = answer["exceptionDetails"]
            raise GofError(f"{expression[:80]}: {thrown.get('exception', {}).get('description', thrown['text'])}")
        return answer["result"].get("value")

    def key(self, key: str) -> None:
        """Press a key, as KeyboardEvent.key names it."""
        what = {"key": key, "code": key, **({"text": key} if len(key) == 1 else {})}
        codes = {"Tab": 9, "Enter": 13, "Escape": 27, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}
        what["windowsVirtualKeyCode"] = codes.get(key, ord(key.upper()[0]))
        if key == "Enter":
            what["text"] = "\r"
        self.ask("Input.dispatchKeyEvent", {"type": "keyDown", **what})
        self.ask("Input.dispatchKeyEvent", {"type": "keyUp", **what})

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """kind: mousePressed, mouseMoved, mouseReleased or mouseWheel; CSS pixels."""
        self.ask("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **more})

    def touch(self, kind: str, points: list[tuple[float, float]]) -> None:
        """kind: touchStart, touchMove or touchEnd; CSS pixels of every finger."""
        self.ask("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})

    def screenshot(self) -> bytes:
        """PNG of the page as it is shown."""
        return base64.b64decode(self.ask("Page.captureScreenshot", {"format": "png"})["data"])

    def ask(self, method: str, parameters: dict[str, Any] | None = None, seconds: float = 60) -> dict[str, Any]:
        """One command of the DevTools protocol to the page. Raises GofError: it is refused, or does not come."""
        return self._ask(method, parameters or {}, self._session, seconds)

    def _ask(self, method: str, parameters: dict, session: str | None = None, seconds: float = 60) -> dict[str, Any]:
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters} | ({"sessionId": session} if session else {})
        os.write(self._to, json.dumps(message).encode() + b"\0")
        self._until(lambda: number in self._answers, method, seconds)
        answer = self._answers.pop(number)
        if "error" in answer:
            raise GofError(f"{method}: {answer['error'].get('message')}")
        return answer["result"]

    def _until(self, done, what: str, seconds: float = 60) -> None:
        last = time.monotonic() + seconds
        while not done():
            ready, _, _ = select.select([self._from], [], [], max(0, last - time.monotonic()))
            data = os.read(self._from, 1 << 20) if ready else b""
            if not data:
                raise GofError(f"the browser did not answer: {what}")
            *messages, self._buffer = (self._buffer + data).split(b"\0")
            for message in messages:
                self._take(json.loads(message))

    def _take(self, message: dict[str, Any]) -> None:
        if "id" in message:
            self._answers[message["id"]] = message
            return
        event, said = message["method"], message.get("params", {})
        if event == "Page.loadEventFired":
            self._loaded = True
        elif event == "Runtime.exceptionThrown":
            self.errors.append(str(said["exceptionDetails"].get("exception", {}).get("description", said)))
        elif event == "Runtime.consoleAPICalled" and said["type"] in ("error", "warning", "assert"):
            self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in said["args"]))
        elif event == "Log.entryAdded" and said["entry"]["level"] in ("error", "warning"):
            self.errors.append(said["entry"]["text"])
        elif event == "Network.requestWillBeSent" and not said["request"]["url"].startswith(("data:", "blob:")):
            self.requests.append(said["request"]["url"])


def page_address(path: Path, fragment: str = "") -> str:
    """file:// address of a page, with what stands behind its #."""
    return path.resolve().as_uri() + (f"#{fragment}" if fragment else "")
