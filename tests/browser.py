"""Parts of the tests of the operator's page in a real browser."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, ConsoleMessage, Page, ViewportSize

NARROW: ViewportSize = {"width": 320, "height": 700}
WIDE: ViewportSize = {"width": 1280, "height": 900}
_CONTRASTS = Path(__file__).with_name("contrasts.js").read_text()


def page_address(output: Iterable[str]) -> str:
    """Return the address that a command prints."""
    return next(line.split()[-1] for line in output if line.startswith("page: "))


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
