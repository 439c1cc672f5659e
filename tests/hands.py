"""A technician's hands on the page: slow presses of the mouse, or the keyboard alone."""

from __future__ import annotations

import re
import time
from typing import Any

from browser import Driver

SLOW_S = 0.25  # of a press
SHOWN_S = 60.0  # until the page shows what a task waits for, on a busy computer
MOST_TABS = 200
_PACES = {"canvas.map": (10, "Shift+", ""), "canvas.camera": (4, "", "Shift+")}  # of the arrow keys, far and near
# the place of a part of an element in the window (of a text, on its first line), null while it cannot be reached there
_PLACE = """async (selector, across, down) => {
  const element = document.querySelector(selector);
  if (!element?.getClientRects().length || element.disabled || element.getAttribute("aria-disabled")) return null;
  element.scrollIntoView({ block: "center", inline: "center" });
  await new Promise(requestAnimationFrame);
  const [box] = element.getClientRects();
  if (!box) return null; // replaced meanwhile
  const place = [box.left + across * box.width, box.top + down * box.height];
  const top = document.elementFromPoint(...place);
  return element.contains(top) ? place : null;
}"""
_TEXT = "(selector) => document.querySelector(selector)?.innerText ?? null"
_VALUE = "(selector) => document.querySelector(selector)?.value ?? null"
_CHOOSE = """(selector, value) => {
  const list = document.querySelector(selector);
  if (!list || ![...list.options].some((each) => each.value === value)) return false;
  list.value = value;
  for (const name of ["input", "change"]) list.dispatchEvent(new Event(name, { bubbles: true }));
  return true;
}"""
_IS_FOCUSED = """(selector) => document.activeElement === document.querySelector(selector)"""
_GROUP = """(selector) => {
  const element = document.querySelector(selector);
  const chosen = element.type === "radio" && document.querySelector(`input[name=${element.name}]:checked`);
  return chosen && chosen !== element ? `#${chosen.id}` : null;
}"""
_KIND = """(selector) => document.querySelector(selector).type"""
_SIZE = """(selector) => [document.querySelector(selector).width, document.querySelector(selector).height]"""


class Mouse:
    """Hands with a mouse, whose presses take `SLOW_S`."""

    def __init__(self, driver: Driver) -> None:
        self.driver = driver

    def wait(self, script: str, *values: Any, what: str = "", timeout_s: float = SHOWN_S) -> Any:
        """Return the first value of a script that is not false."""
        end = time.monotonic() + timeout_s
        while not (found := self.driver.run(script, *values)):
            assert time.monotonic() < end, f"{what or script} {values}: not within {timeout_s:g} s"
            time.sleep(0.05)
        return found

    def reads(self, selector: str, pattern: str, timeout_s: float = SHOWN_S) -> str:
        """Wait until the text of an element contains a pattern, and return the text."""
        end, text = time.monotonic() + timeout_s, None
        while text is None or not re.search(pattern, text):
            assert time.monotonic() < end, f"{selector} reads {text!r}, not {pattern!r}, after {timeout_s:g} s"
            time.sleep(0.05)
            text = self.driver.run(_TEXT, selector)
        return str(text)

    def sees(self, selector: str, timeout_s: float = SHOWN_S) -> None:
        """Wait until an element is visible."""
        self.wait(
            "(selector) => document.querySelector(selector)?.getClientRects().length > 0",
            selector,
            timeout_s=timeout_s,
        )

    def view(self, name: str) -> None:
        """Choose a view."""
        self.click(f"nav a[href='#{name}']")
        self.sees(f"nav a[href='#{name}'][aria-current=page]")

    def click(self, selector: str, timeout_s: float = SHOWN_S) -> None:
        """Press a button, a link or a box, as soon as it is offered."""
        self._press_at(selector, 0.5, 0.5, timeout_s)

    def write(self, selector: str, text: str) -> None:
        """Replace the text of a field, and leave the field."""
        self.click(selector)
        self._type(text)

    def choose(self, selector: str, value: str) -> None:
        """Choose from a list; its opened list belongs to the system, not to the page."""
        self.wait(_CHOOSE, selector, value)

    def draw(self, selector: str, *places: tuple[int, int]) -> None:
        """Click points of a map, each as its distance (columns, rows) from the middle."""
        width, height = self.wait(_SIZE, selector)
        for column, row in places:
            self._press_at(selector, 0.5 + (column + 0.5) / width, 0.5 + (row + 0.5) / height, SHOWN_S)

    def point_at(self, selector: str, column: int, row: int) -> None:
        """Point at a place of a map, its distance (columns, rows) from the middle."""
        width, height = self.wait(_SIZE, selector)
        self.driver.move(*self.wait(_PLACE, selector, 0.5 + (column + 0.5) / width, 0.5 + (row + 0.5) / height))

    def _press_at(self, selector: str, across: float, down: float, timeout_s: float) -> None:
        place: list[float] = []
        while (found := self.wait(_PLACE, selector, across, down, timeout_s=timeout_s)) != place:
            place = found  # what the pointer left may have changed the page
            self.driver.move(*place)
        self.driver.press(SLOW_S)

    def _type(self, text: str) -> None:
        self.driver.key("Control+a")
        self.driver.write(text)
        if self.driver.run("() => document.activeElement.tagName") == "INPUT":
            self.driver.key("Enter")  # Firefox without a screen has no event of a field that is left
        self.driver.key("Tab")


class Keyboard(Mouse):
    """Hands with the keyboard alone."""

    def __init__(self, driver: Driver) -> None:
        super().__init__(driver)
        self._at = (0, 0)  # of the pointer on the map of a view

    def view(self, name: str) -> None:
        if not self.driver.run("(name) => location.hash.slice(1).split('&')[0] === name", name):
            self._at = (0, 0)
        super().view(name)

    def click(self, selector: str, timeout_s: float = SHOWN_S) -> None:
        self.wait(_PLACE, selector, 0.5, 0.5, timeout_s=timeout_s)
        chosen = self.driver.run(_GROUP, selector)
        if chosen:  # Tab reaches the chosen one of a group, the arrow keys choose
            self._reach(chosen)
            self.driver.key("ArrowDown")
            return
        self._reach(selector)
        is_box = self.driver.run(_KIND, selector) in ("checkbox", "radio")
        self.driver.key("Space" if is_box else "Enter")

    def write(self, selector: str, text: str) -> None:
        self._reach(selector)
        self._type(text)

    def choose(self, selector: str, value: str) -> None:
        self.wait("(selector) => document.querySelector(selector)?.options.length", selector)
        self._reach(selector)
        self.driver.key("Home")
        for _ in range(self.driver.run("(selector) => document.querySelector(selector).length", selector)):
            if self.driver.run(_VALUE, selector) == value:
                return
            self.driver.key("ArrowDown")
        raise AssertionError(f"{selector} has no entry {value}, or no key chooses it")

    def draw(self, selector: str, *places: tuple[int, int]) -> None:
        for column, row in places:
            self.point_at(selector, column, row)
            self.driver.key("Enter")

    def point_at(self, selector: str, column: int, row: int) -> None:
        self._reach(selector)
        ways, self._at = (column - self._at[0], row - self._at[1]), (column, row)
        for way, keys in zip(ways, (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown")), strict=True):
            pace, far, near = _PACES[selector]
            count, rest = divmod(abs(way), pace)
            for modifier in [far] * count + [near] * rest:
                self.driver.key(modifier + keys[way > 0])

    def _reach(self, selector: str) -> None:
        """Press Tab until an element has the focus."""
        for _ in range(MOST_TABS):
            if self.driver.run(_IS_FOCUSED, selector):
                return
            self.driver.key("Tab")
        raise AssertionError(f"Tab does not reach {selector}")
