"""`fringedic operate` with the tiny virtual rig, and what a technician does on its page."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from browser import opened, page_address
from playwright.sync_api import Browser, Page, expect
from running_system import CONFIG, free_port

from fringedic_ros.testing import descendant_pid

WAIT_MS = 240_000  # for a procedure on a busy computer
VIEWS = {
    "tests": ".tests",
    "setup": "#item-axes",
    "live": "#pattern",
    "run": "#run",
    "maps": "canvas.map",
    "curves": "#curve-x",
    "space": "#space",
    "compare": "#test-0",
    "log": "#nodes",
}


@dataclass
class Operated:
    """A running command with its page."""

    process: subprocess.Popen[str]
    url: str
    folder: Path

    def page_process(self) -> int:
        """Return the process of the page's server."""
        return descendant_pid(self.process.pid, "operator")


@contextmanager
def operating(folder: Path, *words: str, rig_name: str = "tiny") -> Iterator[Operated]:
    """Run `fringedic operate` for a copy of a virtual rig, or for the rig file that is there."""
    rig = folder / f"{rig_name}.yaml"
    if not rig.exists():
        shutil.copyfile(CONFIG / rig.name, rig)
    code = "from fringedic.command.main import main; main()"
    command = [sys.executable, "-c", code, "operate", str(rig), "--port", str(free_port()), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "COLUMNS": "300"}) as process:
        assert process.stdout is not None
        url = page_address(process.stdout)
        try:
            yield Operated(process, url, folder)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(300)


@contextmanager
def driving(browser: Browser, operated: Operated) -> Iterator[Page]:
    """Open the page as the driver; the one before has handed over, and so does this one."""
    with opened(browser, operated.url) as page:
        page.set_default_timeout(WAIT_MS)
        expect(page.locator("nav a").first).to_be_visible()
        take_wheel(page)
        yield page
        page.click("text=Hand over")
        expect(page.locator("#wheel")).to_contain_text("Ask for the wheel")


def take_wheel(page: Page) -> None:
    if page.locator("#wheel >> text=You drive").count() == 0:
        page.click("text=Ask for the wheel")
    expect(page.locator("#wheel")).to_contain_text("You drive")


def view(page: Page, name: str) -> None:
    page.click(f"nav a[href='#{name}']")
    expect(page.locator(VIEWS[name])).to_be_visible()


def live_frame(page: Page) -> str:
    """Wait for a camera image and return its stamp."""
    expect(page.locator("canvas.camera")).to_have_attribute("data-stamp", re.compile("[0-9]"), timeout=WAIT_MS)
    return page.locator("canvas.camera").get_attribute("data-stamp") or ""


def click_at(page: Page, column: float, row: float) -> None:
    """Click a pixel of the camera image."""
    box = page.locator("canvas.camera").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + (column + 0.5) / 160 * box["width"], box["y"] + (row + 0.5) / 120 * box["height"])


def start_programme(page: Page, text: str) -> None:
    view(page, "run")
    page.check("#own")
    page.fill("#programme", text)
    page.click("#run")


def finished(page: Page) -> str:
    """Wait for the result of a programme and return it."""
    expect(page.locator("#words")).to_be_visible(timeout=WAIT_MS)
    return page.locator("#words").inner_text()
