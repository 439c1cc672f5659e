"""Parts of the tests of the operator's page in real browsers."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from playwright.sync_api import Browser, ConsoleMessage, Page, ViewportSize
from running_system import without_ros
from websockets.sync.client import ClientConnection, connect

NARROW: ViewportSize = {"width": 320, "height": 700}
WIDE: ViewportSize = {"width": 1280, "height": 900}
LARGE: ViewportSize = {"width": 3840, "height": 2160}
_CONTRASTS = Path(__file__).with_name("contrasts.js").read_text()
_KEYS = {"Tab": "\ue004", "Enter": "\ue007", "Space": " ", "Home": "\ue011"}  # of the protocol WebDriver
_KEYS |= {"ArrowLeft": "\ue012", "ArrowUp": "\ue013", "ArrowRight": "\ue014", "ArrowDown": "\ue015"}
_MODIFIERS = {"Shift": "\ue008", "Control": "\ue009"}


def page_address(output: Iterable[str]) -> str:
    """Return the address that a command prints."""
    return next(line.split()[-1] for line in output if line.startswith("page: "))


@contextmanager
def viewing_page(recording: Path, port: int) -> Iterator[str]:
    """Run `fringedic view` where ROS cannot be imported, and yield the address that it prints."""
    words = ["view", str(recording), "--port", str(port)]
    command = [sys.executable, "-c", "from fringedic.command.main import main; main()", *words]
    environment = {**os.environ, "PYTHONPATH": without_ros(), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        try:
            yield page_address(process.stdout)
        finally:
            process.terminate()


@contextmanager
def opened(browser: Browser, url: str) -> Iterator[Page]:
    """Open a page in a session of its own; an error of a script, or against the policy, fails the test."""
    errors: list[str] = []
    context = browser.new_context(viewport=WIDE)
    page = context.new_page()
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if _is_error(message) else None)
    page.goto(url)
    yield page
    context.close()
    assert not errors


def _is_error(message: ConsoleMessage) -> bool:
    """Return whether a message is an error; requests that a server refuses or does not answer are none."""
    return message.type == "error" and not message.text.startswith(("WebSocket connection to", "Failed to load"))


def low_contrasts(page: Page) -> list[str]:
    """Return the texts whose contrast is below 4.5 : 1 (WCAG 2.2, level AA)."""
    found: list[str] = page.evaluate(_CONTRASTS)
    return found


class Driver(Protocol):
    """A page in a browser: its scripts, its mouse and its keyboard, and nothing that a person does not have."""

    def run(self, script: str, *values: Any) -> Any:
        """Return what a function of JavaScript returns for values."""

    def move(self, x: float, y: float) -> None:
        """Move the mouse to a place of the window [px]."""

    def press(self, duration_s: float) -> None:
        """Press the button of the mouse, and release it after a time."""

    def key(self, name: str) -> None:
        """Press a key, such as Tab or Shift+ArrowLeft."""

    def write(self, text: str) -> None:
        """Type a text."""

    def pages(self) -> int:
        """Return the number of open pages."""

    def come_back(self) -> None:
        """Come back to this page after another one was opened."""


class ChromiumPage:
    """A page that Playwright drives."""

    def __init__(self, page: Page) -> None:
        self._page = page

    def run(self, script: str, *values: Any) -> Any:
        return self._page.evaluate(_called(script, values))

    def move(self, x: float, y: float) -> None:
        self._page.mouse.move(x, y)

    def press(self, duration_s: float) -> None:
        self._page.mouse.down()
        self._page.wait_for_timeout(1e3 * duration_s)
        self._page.mouse.up()

    def key(self, name: str) -> None:
        self._page.keyboard.press(name)

    def write(self, text: str) -> None:
        self._page.keyboard.type(text)

    def pages(self) -> int:
        return len(self._page.context.pages)

    def come_back(self) -> None:
        self._page.bring_to_front()


class FirefoxPage:
    """A page of Firefox, driven by the protocol WebDriver BiDi.

    Playwright 1.65 needs a command of this protocol that Firefox ESR does not have (``setMediaFeaturesOverride``). The
    window never has the focus of the screen, so that no field has an event when one leaves it.
    """

    def __init__(self, connection: ClientConnection, size: ViewportSize, url: str) -> None:
        self._connection, self._sent = connection, 0
        self.errors: list[str] = []
        self._send("session.new", capabilities={})
        self._context = self._send("browsingContext.getTree")["contexts"][0]["context"]
        self._send("session.subscribe", events=["log.entryAdded"])
        self._send("browsingContext.setViewport", context=self._context, viewport=size)
        self._send("browsingContext.navigate", context=self._context, url=url, wait="complete")

    def run(self, script: str, *values: Any) -> Any:
        expression = f"Promise.resolve({_called(script, values)}).then((found) => JSON.stringify(found ?? null))"
        target = {"context": self._context}
        found = self._send("script.evaluate", expression=expression, target=target, awaitPromise=True)
        assert found["type"] == "success", found
        return json.loads(found["result"]["value"])

    def move(self, x: float, y: float) -> None:
        self._act("pointer", {"type": "pointerMove", "x": round(x), "y": round(y)})

    def press(self, duration_s: float) -> None:
        wait = {"type": "pause", "duration": round(1e3 * duration_s)}
        self._act("pointer", {"type": "pointerDown", "button": 0}, wait, {"type": "pointerUp", "button": 0})

    def key(self, name: str) -> None:
        *modifiers, last = name.split("+")
        keys = [*(_MODIFIERS[each] for each in modifiers), _KEYS.get(last, last)]
        down = [{"type": "keyDown", "value": each} for each in keys]
        self._act("key", *down, *({"type": "keyUp", "value": each} for each in reversed(keys)))

    def write(self, text: str) -> None:
        for each in text:
            self.key(each)

    def pages(self) -> int:
        return len(self._send("browsingContext.getTree")["contexts"])

    def come_back(self) -> None:
        self._send("browsingContext.activate", context=self._context)

    def _act(self, kind: str, *actions: dict[str, Any]) -> None:
        source = {"type": kind, "id": kind, "actions": list(actions)}
        self._send("input.performActions", context=self._context, actions=[source])

    def _send(self, method: str, **parameters: Any) -> Any:
        self._sent += 1
        self._connection.send(json.dumps({"id": self._sent, "method": method, "params": parameters}))
        while (answer := json.loads(self._connection.recv(120))).get("id") != self._sent:
            entry = answer.get("params", {})
            is_error = answer.get("method") == "log.entryAdded" and entry["level"] == "error"
            if is_error and entry["type"] == "javascript" and entry["source"].get("context") == self._context:
                self.errors.append(entry["text"])  # not those of a report, which is another page
        assert answer["type"] == "success", answer
        return answer["result"]


def _called(script: str, values: Iterable[Any]) -> str:
    return f"({script})({', '.join(json.dumps(each) for each in values)})"


@contextmanager
def chromium_page(browser: Browser, size: ViewportSize, url: str) -> Iterator[Driver]:
    """Open a page in chromium."""
    with opened(browser, url) as page:
        page.set_viewport_size(size)
        yield ChromiumPage(page)


@contextmanager
def firefox_page(executable: str, size: ViewportSize, url: str) -> Iterator[Driver]:
    """Open a page in Firefox; an error of a script fails the test."""
    with tempfile.TemporaryDirectory(prefix="fringedic-firefox-") as profile:
        command = [executable, "--headless", "--profile", profile, "--remote-debugging-port", "0"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
            try:
                assert process.stderr is not None
                found = (re.search(r"WebDriver BiDi listening on (ws://\S+)", line) for line in process.stderr)
                address = next(each[1] for each in found if each)
                with connect(f"{address}/session", max_size=None) as connection:
                    page = FirefoxPage(connection, size, url)
                    yield page
                    assert not page.errors
            finally:
                process.terminate()
                process.communicate()
