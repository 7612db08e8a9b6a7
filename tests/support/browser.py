"""A real browser, driven over Chromium's debugging pipe: pages, pixels, console, requests.

The pipe needs no port and no library: each message is JSON that ends with a zero byte.
"""

from __future__ import annotations

import base64
import io
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from PIL import Image

from softdyn.exceptions import InputError
from tests.support import PATIENCE

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-default-apps", "--disable-extensions", "--no-first-run",
    "--no-default-browser-check",
    "--disable-dev-shm-usage", "--remote-debugging-pipe", "--window-size=640,480",
)  # fmt: skip


# a page that draws at most every N ms, because frames are drawn by the processor
SLOWER = """
const draw = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (call) => setTimeout(() => draw(call), %d);
"""


class NotAnswered(Exception):
    """The page raised an error, or refused."""


class Browser:
    """One Chromium with one page at a time; a context manager.

    Parameters
    ----------
    pause : int
        Time (ms) before each frame of a page.

    Attributes
    ----------
    console, requests : list of str
        Errors that the page reported and addresses that it requested since it was opened.

    Raises
    ------
    InputError
        Chromium is not installed.
    """

    def __init__(self, pause: int = 0) -> None:
        self._pause = pause
        if CHROMIUM is None:
            raise InputError("browser", "Chromium (apt-get install chromium)", "none")
        self._profile = tempfile.TemporaryDirectory(prefix="chromium-")
        read, theirs_out = os.pipe()
        theirs_in, write = os.pipe()
        # Chromium reads commands from descriptor 3 and answers on 4; dash knows single digits only
        command = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}'
        self._process = subprocess.Popen(
            ["bash", "-c", command, "bash", str(CHROMIUM), *FLAGS,
             f"--user-data-dir={self._profile.name}"],
            pass_fds=(theirs_in, theirs_out), stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        os.close(theirs_in)
        os.close(theirs_out)
        self._read, self._write = read, write
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        self._target = ""
        self.console: list[str] = []
        self.requests: list[str] = []

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_error: object) -> None:
        try:
            self._call("Browser.close", {}, session=None)
        except (TimeoutError, OSError):
            self._process.kill()
        self._process.wait(60)
        os.close(self._read)
        os.close(self._write)
        for _ in range(20):  # its child processes may still write there
            try:
                self._profile.cleanup()
                break
            except OSError:
                time.sleep(0.1)

    def open(self, url: str, width: int = 640, height: int = 480) -> None:
        """Load a page anew; return when its first frame is drawn."""
        if self._session is not None:
            self._call("Target.closeTarget", {"targetId": self._target}, session=None)
        self.console.clear()
        self.requests.clear()
        made = self._call("Target.createTarget", {"url": "about:blank"}, session=None)
        self._target = made["targetId"]
        attached = self._call(
            "Target.attachToTarget", {"targetId": self._target, "flatten": True}, session=None
        )
        self._session = attached["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            self._call(f"{domain}.enable", {})
        if self._pause:
            slower = {"source": SLOWER % self._pause}
            self._call("Page.addScriptToEvaluateOnNewDocument", slower)
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", screen)
        self._call("Page.navigate", {"url": url})
        self.until("document.readyState === 'complete'")
        self.settle()

    def settle(self) -> None:
        """Wait until two more frames are drawn."""
        frame = "new Promise(r => requestAnimationFrame(() => requestAnimationFrame(() => r(1))))"
        self.run(frame)

    def run(self, script: str) -> Any:
        """The value of an expression; a promise is awaited."""
        answer = self._call(
            "Runtime.evaluate",
            {"expression": script, "awaitPromise": True, "returnByValue": True},
        )
        if "exceptionDetails" in answer:
            raise NotAnswered(json.dumps(answer["exceptionDetails"])[:2000])
        return answer["result"].get("value")

    def until(self, script: str, timeout: float = PATIENCE) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + timeout
        while not self.run(script):
            if time.monotonic() > end:
                raise TimeoutError(f"{script}; console: {self.console}")
            time.sleep(0.05)

    def press(self, at: Sequence[float], shift: bool = False) -> None:
        """Press the left button at a place of the window (pixels)."""
        self._mouse("mouseMoved", at, shift=shift)
        self.settle()  # the element below the pointer changes in the next frame
        self._mouse("mousePressed", at, button="left", buttons=1, clickCount=1, shift=shift)

    def move(self, to: Sequence[float], shift: bool = False) -> None:
        """Move the mouse without changing its button."""
        self._mouse("mouseMoved", to, buttons=1, shift=shift)

    def lift(self, at: Sequence[float], shift: bool = False) -> None:
        """Release the left button."""
        self._mouse("mouseReleased", at, button="left", clickCount=1, shift=shift)

    def drag(self, start: Sequence[float], end: Sequence[float], shift: bool = False) -> None:
        """Press, move in a few steps, lift."""
        self.press(start, shift)
        for part in (0.1, 0.4, 0.7, 1.0):
            self.move([a + part * (b - a) for a, b in zip(start, end, strict=True)], shift)
            self.settle()
        self.lift(end, shift)

    def key(self, key: str) -> None:
        """Type one key that writes something."""
        for kind in ("keyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", {"type": kind, "key": key, "text": key})

    def _mouse(self, kind: str, at: Sequence[float], shift: bool, **more: Any) -> None:
        place = {"x": float(at[0]), "y": float(at[1]), "modifiers": 8 * shift}
        self._call("Input.dispatchMouseEvent", {"type": kind, **place, **more})

    def pixels(self, selector: str | None = None) -> np.ndarray:
        """The pixels of the page (h, w, 3), or of one canvas of it."""
        self.settle()
        if selector is not None:
            self.run("softdyn.viewer.render()")
            text = self.run("softdyn.viewer.capture_image()").partition(",")[2]
        else:
            text = self._call("Page.captureScreenshot", {"format": "png"})["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB"), int)

    def _call(
        self, method: str, params: dict, session: object = True, timeout: float = PATIENCE
    ) -> Any:
        self._number += 1
        number = self._number
        message = {"id": number, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + timeout
        while True:
            answer = self._next(end)
            if answer.get("id") == number:
                if "error" in answer:
                    raise NotAnswered(answer["error"])
                return answer["result"]
            self._note(answer)

    def _next(self, end: float) -> Any:
        while b"\0" not in self._buffer:
            left = end - time.monotonic()
            if left <= 0 or not select.select([self._read], [], [], left)[0]:
                raise TimeoutError("no answer from the browser")
            part = os.read(self._read, 1 << 20)
            if not part:
                raise OSError("the browser ended")
            self._buffer += part
        text, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(text)

    def _note(self, event: dict) -> None:
        params = event.get("params", {})
        if event["method"] == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif event["method"] == "Network.webSocketCreated":
            self.requests.append(params["url"])
        elif event["method"] == "Runtime.exceptionThrown":
            self.console.append(json.dumps(params["exceptionDetails"]))
        elif event["method"] == "Runtime.consoleAPICalled" and params["type"] in (
            "error",
            "assert",
        ):
            self.console.append(json.dumps(params["args"]))
        elif event["method"] == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.console.append(params["entry"]["text"])


def required() -> pytest.MarkDecorator:
    """Skip without a browser; in CI its absence is a failure."""
    if CHROMIUM is None and os.environ.get("CI"):
        raise RuntimeError("CI needs Chromium: apt-get install chromium")
    reason = "NO CHROMIUM: THE VIEWER IS NOT TESTED (apt-get install chromium)"
    if CHROMIUM is None:
        # printed, because a skip is only one letter in a long row
        warnings.warn(reason, stacklevel=2)
    return pytest.mark.skipif(CHROMIUM is None, reason=reason)
