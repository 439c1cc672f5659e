"""The operator's page in a real browser, over a real server whose rig a test sets: what a technician must not meet."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import struct
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import NARROW, WIDE, opened
from playwright.sync_api import Browser, Page, expect
from running_system import CONFIG, wait_until
from served import TOKEN, Site, SmallRig, served, write_test

from fringedic.configuration.programme_check import parse_programme
from fringedic.configuration.test_series import Series
from fringedic.errors import OperatorError
from fringedic.patterns.pattern import PatternKind
from fringedic.report.page_server.languages import ENGLISH, catalogues
from fringedic.report.page_server.maps import described
from fringedic.report.page_server.marks import KeepMarks, Marks, load_marks
from fringedic.report.page_server.recorded import RecordedRig
from fringedic.rig_setup.check_list import CheckList
from fringedic.rig_setup.live_figures import Figures
from fringedic.rig_setup.live_sentences import TITLES, live_entries, next_sentence
from operator_node import rig_file
from operator_node.rig_file import ShownRigFile

pytestmark = pytest.mark.browser
PERIOD_S = 0.02  # 50 messages per second
RUNNING, PAUSED, DONE, FAILED = 1, 3, 5, 6
SHOWN_MS = 30_000  # on a busy computer


def procedure(name: str = "", state: int = 0, **fields: Any) -> dict[str, Any]:
    """Return the state of a procedure, as the operator node publishes it."""
    known: dict[str, Any] = {"procedure": name, "state": state, "title": name or "nothing", "activity": "", "step": -1}
    known |= {"steps": 0, "frame": 0, "frames": 0, "question": "", "pattern": "", "settings": "", "remaining_s": None}
    return known | {"folder": "", "notes": [], "words": [], "error": "", "reports": []} | fields


class ShownRig(SmallRig):
    """A rig whose state a test sets; programmes are checked for a real rig file."""

    def __post_init__(self) -> None:
        super().__post_init__()
        shutil.copyfile(CONFIG / "tiny.yaml", self.folder / "tiny.yaml")
        self.file = ShownRigFile(self.folder / "tiny.yaml")
        recordings = self.folder / "recordings"
        for number, stretch in ((7, 1e-3), (8, 2e-3)):
            answers: dict[str, str | float] = {
                "specimen": f"plate {number}",
                "operator": "M. Weber",
                "width [mm]": 20.0 + number,
            }
            write_test(recordings, f"plate-{number}", answers, stretch=stretch)
        self.reset()

    def bare(self) -> dict[str, Any]:
        """Return the state without optional parts."""
        rig = {"kind": "rig", "title": "rig", "operated": True, "machine": True, "measures": True, "running": []}
        return {
            "rig": rig | self.file.shown(),
            "procedure": procedure(),
            "live": procedure("live", RUNNING, pattern="white", activity="live"),
            "setup": [],
            "steps": [],
            "step": None,
            "signals": [],
            "quantities": [],
            "load": {"mode": "hold"},
            "recorder": None,
            "nodes": [],
            "log": [],
            "hand": "",
            "figures": None,
            "tests": [],
            "marks": {"marks": [], "notes": {}},
            "series": self.file.series(),
            "rigs": [],
            "alarms": [],
        }

    def reset(self) -> None:
        self.state = self.bare()
        self.commands.clear()
        self.delay_s, self.check_s, self.refusal = 0.0, 0.0, ""
        self.put_maps()

    def show(self, _before: dict[str, Any] | None = None, **topics: Any) -> None:
        """Change topics of the state, or of another one, at once; `rig` is changed in part."""
        before = self.state if _before is None else _before
        self.state = before | topics | {"rig": before["rig"] | topics.get("rig", {})}

    def put_hole(self) -> None:
        """Leave out the middle column of the maps of all steps."""
        self.put_maps(hole=2)

    async def check(self, text: str) -> dict[str, Any]:
        await asyncio.sleep(self.check_s)
        return self.file.check(text)

    def busy(self) -> str:
        return ""

    async def do(self, command: Any) -> str:
        await asyncio.sleep(self.delay_s)
        if self.refusal:
            raise OperatorError(self.refusal)
        self.commands.append(command)
        if isinstance(command, KeepMarks) and command.test:
            return await self.opened(command.test).do(command.model_copy(update={"test": ""}))
        return "started"

    def opened(self, test: str) -> RecordedRig:
        return self.file.opened(test)

    def show_tests(self) -> None:
        """Show the tests in the folder of the rig file, when their datasets have been read."""

        def tests() -> list[dict[str, Any]]:
            self.file.shown()
            return self.file.shown_tests()

        wait_until(lambda: [each["verdict"] for each in tests()] == ["3 steps measured"] * 2, "the datasets")
        self.show(tests=tests(), rigs=self.file.rigs())

    def folders(self) -> dict[str, Path]:
        return {f"test {each['name']}": self.folder for each in self.state["tests"]}


@pytest.fixture(scope="module")
def site(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    del browser  # nothing is started where there is none
    with pytest.MonkeyPatch.context() as patch, served(tmp_path_factory.mktemp("page"), ShownRig) as running:
        patch.setattr(rig_file, "LOOK_S", 0.0)
        yield running


@pytest.fixture(scope="module")
def driver(browser: Browser, site: Site) -> Iterator[Page]:
    with opened(browser, f"{site.origin}/?token={TOKEN}") as page:
        page.set_default_timeout(SHOWN_MS)
        yield page


@pytest.fixture
def rig(site: Site) -> ShownRig:
    assert isinstance(site.rig, ShownRig)
    site.rig.reset()
    return site.rig


@pytest.fixture
def page(driver: Page, site: Site, rig: ShownRig) -> Page:
    """Return the one page of all tests, as after its opening."""
    del rig  # is reset before
    driver.goto("about:blank")
    driver.goto(f"{site.origin}/")
    expect(driver.locator("#wheel")).to_contain_text("You drive")
    return driver


def view(page: Page, name: str) -> None:
    page.click(f"nav a[href='#{name}']")


@contextmanager
def messages(site: Site) -> Iterator[None]:
    """Publish 50 messages per second, of all topics in turn, each with other figures than the one before."""
    ended = threading.Event()

    def publish() -> None:
        number = 0
        while not ended.wait(PERIOD_S):
            number += 1
            rig = site.rig
            assert isinstance(rig, ShownRig)
            topics = ("procedure", "signals", "rig", "setup", "nodes", "step", "load", "wheel", "live", "tests")
            topic = topics[number % len(topics)]
            data = rig.state.get(topic)
            if topic == "procedure" and data["state"] == RUNNING:
                data = data | {
                    "activity": f"capture {number}",
                    "frame": number % 12,
                    "notes": [str(number)] * (number % 5),
                }
            elif topic == "signals":
                data = [{"name": "force", "value": number, "factor": 1, "unit": "N", "source": "load_frame"}]
            elif topic == "rig":
                data = data | {"calibration": [f"calibration {number}"]}
            elif topic == "setup":
                data = [each | {"next": f"message {number}"} for each in data]
            if data is not None:
                site.server.publish(topic, lambda topic=topic, data=data: json.dumps({"topic": topic, "data": data}))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


ITEM = {"title": "Timing", "done": 1, "words": ["delay 80 ms"], "picture": "", "report": ""}
TIMING = ITEM | {"item": "timing", "state": 4, "next": "Use it."}
AXES = ITEM | {"item": "axes", "state": 0, "next": "Aim."}
BUTTONS: dict[str, tuple[str, dict[str, Any], list[str]]] = {  # view, state of the rig, buttons
    "idle": ("run", {}, ["#run", "#by-hand"]),
    "a programme runs": (
        "run",
        {"procedure": procedure("run", RUNNING, step=1, steps=5)},
        ["#pause", "#stop", "#hold"],
    ),
    "paused": ("run", {"procedure": procedure("run", PAUSED, step=1, steps=5)}, ["#resume", "#stop"]),
    "by hand": ("run", {"procedure": procedure("by_hand", RUNNING, step=0, steps=1)}, ["#measure", "#stop"]),
    "ended early": (
        "run",
        {"procedure": procedure("run", FAILED, words=["ended early"], folder="five-1", settings="camera: {}")},
        ["#go-on", "#use"],
    ),
    "a question": (
        "maps",
        {"procedure": procedure("calibrate", RUNNING, question="Lay the grid", step=0, steps=8)},
        ["#confirm", "#refuse"],
    ),
    "set up": (
        "setup",
        {"setup": [AXES, TIMING]},
        ["#item-axes .start", "#item-axes .done", "#item-timing .use-result"],
    ),
    "live": ("live", {}, ["#live-start", "#live-stop"]),
}


def press(page: Page, selector: str, duration_s: float) -> None:
    """Press and release the mouse over the middle of a button, as a hand does: nothing waits for the button."""
    page.locator(selector).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    time.sleep(duration_s)
    page.mouse.up()


def press_key(page: Page, selector: str, duration_s: float) -> None:
    """Press and release the space bar on a button that has the focus."""
    page.focus(selector)
    page.keyboard.down("Space")
    time.sleep(duration_s)
    page.keyboard.up("Space")


def arrived(
    page: Page,
    rig: ShownRig,
    selector: str,
    durations: list[float],
    how: Callable[[Page, str, float], None] = press,
) -> int:
    """Press a button for these times [s], and return the number of commands that have arrived."""
    rig.commands.clear()
    for number, duration_s in enumerate(durations, start=1):
        expect(page.locator(selector)).not_to_have_attribute("aria-busy", "true")
        how(page, selector, duration_s)
        end = time.monotonic() + 2
        while len(rig.commands) < number and time.monotonic() < end:
            page.wait_for_timeout(5)
    return len(rig.commands)


def prepare(page: Page, rig: ShownRig, state: str) -> list[str]:
    """Show a state of the rig in its view, and return its buttons."""
    name, topics, selectors = BUTTONS[state]
    rig.show(**topics)
    view(page, name)
    if name == "setup":
        page.click("#item-axes >> text=Open")
    for selector in selectors:
        expect(page.locator(selector)).to_be_enabled()
    return selectors


@pytest.mark.parametrize("state", BUTTONS)
def test_every_press_arrives_whatever_messages_come(page: Page, site: Site, rig: ShownRig, state: str) -> None:
    """Panels were inserted anew with every message: a press of 250 ms arrived in none of 20 cases."""
    selectors = prepare(page, rig, state)
    with messages(site):
        assert {each: arrived(page, rig, each, [0.03, 0.25]) for each in selectors} == dict.fromkeys(selectors, 2)
        assert {each: arrived(page, rig, each, [0.25], press_key) for each in selectors} == dict.fromkeys(selectors, 1)


NOTE_ANSWERS = """() => {
  let pressed = NaN;
  window.answers = [];
  addEventListener("click", () => { pressed = performance.now(); }, true);
  new MutationObserver(() => {
    if (!Number.isFinite(pressed) || !document.getElementById("message").textContent) return;
    answers.push(1e-3 * (performance.now() - pressed));
    pressed = NaN;
  }).observe(document.getElementById("message"), { childList: true, characterData: true, subtree: true });
}"""  # the time from each press to the sentence that answers it [s]


@pytest.mark.operate
@pytest.mark.parametrize("state", BUTTONS)
def test_hundred_of_hundred_presses_arrive(
    page: Page, site: Site, rig: ShownRig, state: str, record_property: Callable[[str, object], None]
) -> None:
    """``--junitxml FILE -o junit_family=xunit1`` keeps the times between presses and the sentences that answer them."""
    selectors = prepare(page, rig, state)
    durations = [0.03 + 0.97 * (37 * number % 100) / 99 for number in range(100)]
    page.evaluate(NOTE_ANSWERS)
    with messages(site):
        assert {each: arrived(page, rig, each, durations) for each in selectors} == dict.fromkeys(selectors, 100)
    answers = sorted(page.evaluate("answers"))
    record_property("answered after [s]: median, longest", (answers[len(answers) // 2], answers[-1]))


# a programme


def test_what_is_shown_and_checked_is_what_runs(page: Page, rig: ShownRig) -> None:
    """A text in a closed fold was started instead of the programme of the rig file."""
    view(page, "run")
    page.check("#own")
    page.fill("#programme", "{experiment: hidden, steps: [{}]}")
    expect(page.locator("#plan summary")).to_have_text("Steps: 1")
    page.check("#of-file")
    expect(page.locator("#programme")).to_have_count(0)
    expect(page.locator("#plan summary")).to_have_text("Steps: 3")
    page.click("#plan summary")
    expect(page.locator("#plan tr:last-child td:nth-child(2)")).to_have_text("0.6")
    page.click("#run")
    expect(page.locator("#message")).to_contain_text("started")
    assert [each.text for each in rig.commands] == [""]
    page.check("#own")
    expect(page.locator("#programme")).to_have_value("{experiment: hidden, steps: [{}]}")
    expect(page.locator("#run")).not_to_have_attribute("aria-busy", "true")  # the press before has been answered
    page.click("#run")
    wait_until(lambda: len(rig.commands) == 2, "the command")
    assert rig.commands[-1].text == "{experiment: hidden, steps: [{}]}"
    page.fill("#programme", "{steps: [{position_mm: 50}]}")
    expect(page.locator("#run")).to_be_disabled()
    expect(page.locator("#problem")).to_contain_text("moves the crosshead to 50 mm, outside 0 to")
    page.fill("#programme", "")
    expect(page.locator("#problem")).to_contain_text("Write a programme")
    page.click("#run", force=True)
    expect(page.locator("#message")).to_contain_text("Write a programme")
    assert len(rig.commands) == 2
    page.check("#of-file")


def test_targets_of_the_previous_run_are_not_those_of_the_next(page: Page, rig: ShownRig) -> None:
    report = {"step": 0, "signals": {"position": 1e-3, "force": 5.0}, "valid_fraction": 1.0, "error": ""}
    previous = [{"position_mm": 7.5, "speed_mm_per_s": 1, "hold_s": 0, "mode": "fringes", "until": False}]
    rig.show(procedure=procedure("run", DONE, words=["done"], reports=[report]), rig={"running": previous})
    view(page, "run")
    expect(page.locator("#steps")).to_contain_text("7.5")
    expect(page.locator("#plan")).not_to_contain_text("7.5")


ANSWER_TIME = """() => {
    let pressed;
    addEventListener("click", () => { pressed ??= performance.now(); }, true);
    const answer = () => { window.answeredMs ??= performance.now() - pressed; };
    new MutationObserver(answer).observe(document.getElementById("message"), { childList: true });
}"""


def test_an_action_is_answered_before_the_server_answers_and_a_double_click_is_one(page: Page, rig: ShownRig) -> None:
    rig.delay_s = 3.0
    view(page, "run")
    expect(page.locator("#run")).to_be_enabled()
    page.evaluate(ANSWER_TIME)
    page.dblclick("#run")
    expect(page.locator("#message")).to_contain_text("Sent")
    assert page.evaluate("window.answeredMs") < 500 * rig.delay_s
    expect(page.locator("#message")).to_contain_text("started")
    assert len(rig.commands) == 1
    rig.delay_s, rig.refusal = 0.0, "a procedure is starting: wait"
    expect(page.locator("#run")).not_to_have_attribute("aria-busy", "true")
    page.click("#run")
    expect(page.locator("#message")).to_contain_text("a procedure is starting")
    rig.show(procedure=procedure("run", RUNNING))
    expect(page.locator("#message")).to_be_hidden()


def test_a_double_click_on_a_button_that_another_one_replaces_is_one(page: Page, browser: Browser, site: Site) -> None:
    """The second press of a double click on "Ask for the wheel" handed the wheel over again."""
    with opened(browser, f"{site.origin}/?token={TOKEN}") as other:
        other.set_default_timeout(SHOWN_MS)
        expect(other.locator("#ask")).to_be_visible()  # connected: whoever connects later would drive
        page.click("#give")
        expect(other.locator("#wheel")).to_contain_text("Nobody drives")
        click_in_place(other, "#ask", 1)
        expect(other.locator("#wheel")).to_contain_text("You drive")
        click_in_place(other, "#give", 2)
        click_in_place(other, "nav a[href='#log']", 1)
        expect(other.locator("#nodes")).to_be_visible()
        expect(other.locator("#wheel")).to_contain_text("You drive")
        click_in_place(other, "#give", 1)
        expect(other.locator("#wheel")).to_contain_text("Nobody drives")
    page.click("#ask")
    expect(page.locator("#wheel")).to_contain_text("You drive")


def click_in_place(page: Page, selector: str, count: int) -> None:
    """Press and release the mouse over a button, as the first or second press of a double click."""
    box = page.locator(selector).bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down(click_count=count)
    page.mouse.up(click_count=count)


# numbers


@pytest.mark.parametrize(
    ("typed", "expected"),
    [("4,98", 4.98), ("4.98", 4.98), ("0,500", 0.5), ("-3", None), ("1,234", None), ("1.234,5", None), ("4 98", None)],
)
def test_a_number_means_what_was_typed(page: Page, rig: ShownRig, typed: str, expected: float | None) -> None:
    """4,98 became 498."""
    check = ITEM | {"item": "check", "state": 0, "next": "Measure."}
    rig.show(setup=[check])
    view(page, "setup")
    page.click("#item-check >> text=Open")
    page.fill("#distance_mm", typed)
    page.click("#item-check .start")
    if expected is None:
        expect(page.locator("#distance_mm")).to_have_attribute(
            "title", re.compile("two meanings|several|space|outside")
        )
        assert not rig.commands
    else:
        expect(page.locator("#message")).to_contain_text("started")
        assert rig.commands[0].options["distance_mm"] == expected


@pytest.mark.parametrize(
    ("typed", "expected"),
    [("0; -10,5; 10", "0,-10.5,10"), ("0,-10,-5", "0,-10,-5"), ("0, 10, 5", "0,10,5"), ("0,5", None), ("0,-7,5", None)],
)
def test_a_list_of_numbers_means_what_was_typed(page: Page, rig: ShownRig, typed: str, expected: str | None) -> None:
    """0,5 became 0 and 5."""
    rig.show(setup=[ITEM | {"item": "calibrate", "state": 0, "next": "Measure."}])
    view(page, "setup")
    page.click("#item-calibrate >> text=Open")
    page.fill("#angles_deg", typed)
    page.click("#item-calibrate .start")
    if expected is None:
        expect(page.locator("#angles_deg")).to_have_attribute("title", re.compile("decimal comma, or several"))
        assert not rig.commands
    else:
        expect(page.locator("#message")).to_contain_text("started")
        assert rig.commands[0].options["angles_deg"] == expected


# what is in use, results, state


def test_a_result_that_is_not_in_use_can_still_be_used_after_the_next_procedure(page: Page, rig: ShownRig) -> None:
    rig.show(setup=[TIMING], procedure=procedure("noise", DONE, words=["noise 0.01 px"]))
    view(page, "setup")
    expect(page.locator("#item-timing")).to_contain_text("not in use")
    page.click("#item-timing .use-result")
    expect(page.locator("#message")).to_contain_text("started")
    assert (rig.commands[0].procedure, rig.commands[0].pattern) == ("use", "timing")


def test_tests_and_their_reports_are_listed(page: Page, rig: ShownRig) -> None:
    (rig.folder / "report.html").write_text("the report")
    rig.show(tests=[{"name": "five-1", "when": 1.0, "report": True}, {"name": "six-2", "when": 0.0, "report": False}])
    view(page, "tests")
    href = page.locator(".tests a", has_text="report").get_attribute("href")
    assert href is not None
    assert page.request.get(page.url.partition("/#")[0] + href).text() == "the report"
    expect(page.locator(".tests")).to_contain_text("six-2")


def test_the_state_that_is_shown_is_true(page: Page, rig: ShownRig) -> None:
    rig.show(rig={"machine": False, "load_frame": True}, load=None)
    expect(page.locator("#no-hold")).to_be_visible()
    view(page, "run")
    expect(page.locator("#facts")).to_contain_text("not connected")
    starting = procedure("by_hand", RUNNING, activity="starting 9 nodes")
    recorder = {"state": "recording", "images": 3, "missing_images": 0, "free_gb": 60.0, "error": ""}
    rig.show(procedure=starting, recorder=recorder | {"minutes_left": 4444770})
    expect(page.locator("#measure")).to_be_disabled()
    expect(page.locator("#measure")).to_have_attribute("title", re.compile("not ready yet: starting 9 nodes"))
    expect(page.locator("#facts")).to_contain_text("60 GB free, for more than 60 days")
    report = {"step": 0, "signals": {}, "valid_fraction": 1.0, "error": ""}
    rig.show(procedure=procedure("run", 2, activity="writing dataset", reports=[report]))
    expect(page.locator("#resume")).to_have_attribute("title", "No step follows: the results are being written.")
    view(page, "live")
    expect(page.locator("#live-state")).to_have_text("run runs and shows its own patterns.")


def test_the_question_is_seen_in_every_view(page: Page, rig: ShownRig) -> None:
    rig.show(procedure=procedure("calibrate", RUNNING, question="Turn the plane to +10.00 degree"))
    for name in ("setup", "live", "run", "maps", "curves", "space", "log"):
        view(page, name)
        expect(page.locator("#question")).to_contain_text("Turn the plane")


@pytest.mark.usefixtures("page")
def test_a_looker_reads_why_a_button_has_no_effect(browser: Browser, site: Site, rig: ShownRig) -> None:
    with opened(browser, f"{site.origin}/?token={TOKEN}") as other:
        other.set_default_timeout(SHOWN_MS)
        view(other, "run")
        expect(other.locator("#run")).to_be_disabled()
        other.click("#run", force=True)
        expect(other.locator("#message")).to_contain_text("drives: ask for the wheel first")
        other.click("#ask")
        expect(other.locator("#ask")).to_be_disabled()
        seen = {"drives": False, "driver": None, "driver_present": False, "asking": None, "asked": True}
        site.server.publish("wheel", lambda: json.dumps({"topic": "wheel", "data": seen}))
        expect(other.locator("#ask")).to_be_enabled()
    assert not rig.commands


def test_the_keyboard_goes_on_at_the_item_that_was_opened(page: Page, rig: ShownRig) -> None:
    rig.show(setup=[AXES, TIMING])
    view(page, "setup")
    page.focus("#item-timing >> text=Open")
    page.keyboard.press("Enter")
    expect(page.locator("#item-timing h3")).to_be_focused()
    page.keyboard.press("Tab")
    expect(page.locator("#item-timing .use-result")).to_be_focused()


def test_a_hold_that_nothing_would_receive_is_not_sent(page: Page, rig: ShownRig) -> None:
    """The button waited ten seconds for a service that no node has."""
    rig.show(rig={"machine": False, "load_frame": True})
    expect(page.locator("#hold")).to_have_attribute("aria-disabled", "true")
    page.click("#hold", force=True)
    expect(page.locator("#message")).to_contain_text("stop the machine at its own controls")
    assert not rig.commands
    rig.show(procedure=procedure("run", RUNNING))
    expect(page.locator("#hold")).not_to_have_attribute("aria-disabled", "true")
    page.click("#hold")
    wait_until(lambda: rig.commands, "the command, which waits for the service of a node that starts")


def test_what_is_typed_arrives_whatever_messages_come(page: Page, site: Site, rig: ShownRig) -> None:
    """A field that lies in a row was moved with every message, and lost the focus."""
    rig.show(setup=[ITEM | {"item": "timing", "state": 0, "next": "Measure."}])
    for name, field, text in (("setup", "#exposure_ms", "12.345"), ("run", "#test-specimen", "plate 7, left")):
        view(page, name)
        if name == "setup":
            page.click("#item-timing >> text=Open")
        page.fill(field, "")
        with messages(site):
            page.click(field)
            page.keyboard.type(text, delay=30)
            expect(page.locator(field)).to_be_focused()
        expect(page.locator(field)).to_have_value(text)


# tests


def test_an_earlier_test_is_found_opened_and_left(page: Page, rig: ShownRig) -> None:
    rig.show_tests()
    rig.show(**map_state(0))
    view(page, "tests")
    expect(page.locator("img.small")).to_have_count(2)
    assert page.locator("img.small").first.evaluate("each => each.decode().then(() => each.naturalWidth)") == 20
    expect(page.locator("#rigs")).to_contain_text("tiny.yaml, tests: 2")
    page.fill("#search", "weber 28")
    expect(page.locator("a.open")).to_have_text(["plate-8"])
    page.click("a.open")
    expect(page.locator("#opened")).to_contain_text("Earlier test: plate 8, plate-8")
    page.select_option("#quantity", "u")
    expect(page.locator("#step option")).to_have_count(3)
    click = page.locator("canvas.map")
    expect(click).to_have_attribute("aria-label", re.compile("displacement along x, step 2"))
    click.hover(position={"x": 1, "y": 1})
    expect(page.locator("#position")).to_have_text("x = 0 mm, y = 0 mm")
    view(page, "curves")
    expect(page.locator("circle.dot")).to_have_count(3)
    page.goto(page.url.partition("#")[0] + "#maps&test=plate-7")
    expect(page.locator("#opened")).to_contain_text("plate-7")
    page.click("#close-test")
    expect(page.locator("#opened")).to_be_hidden()
    expect(page.locator("#step option")).to_have_count(1)


def test_two_tests_are_compared(page: Page, rig: ShownRig) -> None:
    rig.show_tests()
    view(page, "tests")
    page.fill("#search", "")
    for name in ("plate-7", "plate-8"):
        page.click(f"tr[data-key={name}] >> text=Compare")
    expect(page.locator("#compare-tests")).to_have_text("Compare (chosen: 2)")
    page.click("#compare-tests")
    expect(page.locator("polyline.curve")).to_have_count(2)
    expect(page.locator("#entries tr", has_text="width [mm]")).to_have_text("width [mm]2728")
    page.select_option("#compare-quantity", "u")
    texts = page.locator("p.readout")
    maps = page.locator("canvas.map")
    expect(maps.nth(1)).to_have_attribute("aria-label", re.compile("u of plate-8, step 2"))
    maps.nth(0).hover()
    expect(texts.nth(1)).to_contain_text("± 0.10 µm at column")
    values = [float(each.split()[0]) for each in texts.all_inner_texts()]
    assert values[1] == pytest.approx(2 * values[0], rel=1e-3), "the same point, with twice the strain"
    for choice in ("#test-0", "#test-1"):
        page.select_option(choice, "")
    expect(page.locator("canvas.map[aria-label]")).to_have_count(0)


def test_a_test_and_a_series_begin_with_the_answers_of_the_form(page: Page, rig: ShownRig) -> None:
    rig.show_tests()
    view(page, "run")
    page.click("#as-last")
    expect(page.locator("#test-operator")).to_have_value("M. Weber")
    page.fill("#test-width-mm-", "wide")
    page.click("#run")
    page.wait_for_timeout(100)
    assert not rig.commands
    page.fill("#test-width-mm-", "24,8")
    page.fill("#test-specimen", "plate 9")
    page.click("#run")
    wait_until(lambda: rig.commands, "the command")
    answers = {"specimen": "plate 9", "operator": "M. Weber", "width [mm]": 24.8}
    assert rig.commands[-1].options == {"test": answers}
    page.click("#series-fold summary")
    page.fill("#series-names", "plate 8\n\nplate 10\n")
    page.click("#plan-series")
    wait_until(lambda: len(rig.commands) == 2, "the series")
    series = Series(**rig.commands[-1].model_dump())
    assert (series.specimens, series.answers) == (["plate 8", "plate 10"], answers)
    rig.file.plan_series(series)
    rig.show(series=rig.file.series())
    view(page, "tests")
    expect(page.locator("#series li").first).to_contain_text("not tested")  # the test of plate 8 is an earlier one
    (rig.folder / "recordings" / "plate-8" / "report.html").touch()
    rig.show_tests()
    expect(page.locator("#series li").first).to_contain_text("plate-8: 3 steps measured")
    for number, field in enumerate(("specimen", "Probe"), start=3):
        rig.show(rig={"specimen_field": field})
        expect(page.locator("#series li button").nth(1)).not_to_have_attribute("aria-busy", "true")
        page.locator("#series li button").nth(1).click()
        wait_until(lambda count=number: len(rig.commands) == count, "the test")
        assert rig.commands[-1].options == {"test": answers | {field: "plate 10"}}
    rig.file.plan_series(Series())


def test_form_and_text_are_one_programme(page: Page) -> None:
    view(page, "run")
    page.check("#own")
    page.fill("#programme", "{experiment: pull, ramp: {to_mm: 0.4, steps: 3}, on_operator_lost: hold}")
    field = page.locator("#form [data-key=to_mm]")
    expect(field).to_have_value("0.4")
    field.fill("0,6")
    field.press("Tab")
    expect(page.locator("#form [data-key=steps]").first).to_be_focused()
    expect(page.locator("#programme")).to_have_value(re.compile("to_mm: 0.6"))
    page.click("#form .add-cycle")
    expect(page.locator("#form fieldset")).to_have_count(4)
    page.fill("#form [data-key=times]", "2")
    position = page.locator("#form [data-key=position_mm]").first
    position.fill("5")
    position.press("Tab")
    expect(page.locator("#problem")).to_contain_text("to 5 mm, outside 0 to")
    position.fill("0.5")
    position.press("Tab")
    expect(page.locator("#programme")).to_have_value(re.compile("position_mm: 0.5"))
    expect(page.locator("#plan summary")).to_have_text("Steps: 7")
    written = parse_programme(page.locator("#programme").input_value())
    assert written == parse_programme(
        "{experiment: pull, on_operator_lost: hold, steps: [{ramp: {to_mm: 0.6, steps: 3}}, {cycle: {times: 2, steps: "
        "[{position_mm: 0.5}, {position_mm: 0}]}}]}"
    )
    page.fill("#programme", "ramp: [")
    expect(page.locator("#form")).to_contain_text("when the text can be read")
    expect(page.locator("#run")).to_be_disabled()
    page.fill("#programme", "{steps: [{hold_s: 5, mode: none}, {}]}")
    expect(page.locator("#form legend")).to_have_text(["Hold", "Step"])
    expect(page.locator("#form [data-key=every_s]").last).to_be_hidden()
    page.select_option("#form [data-key=mode]", "moving")
    expect(page.locator("#form [data-key=every_s]").last).to_be_visible()
    page.fill("#programme", "continuous: {to_mm: 0.4, speed_mm_per_s: 0.02}")
    expect(page.locator("#form legend")).to_have_text(["Measured move"])
    page.locator("#form .add-step").click()
    expect(page.locator("#form legend")).to_have_text(["Measured move", "Step"])
    written = parse_programme(page.locator("#programme").input_value())
    assert [step.mode for step in written.load_steps()] == ["fringes", "moving", "fringes"]
    expect(page.locator("#plan td:first-child")).to_have_text(["0", "1, …", "…"])
    page.check("#of-file")


def test_a_text_that_is_being_written_is_not_undone_by_the_form(page: Page, rig: ShownRig) -> None:
    """A press in the form wrote the text before anew, or was lost when the form of the text took its place."""
    view(page, "run")
    page.check("#own")
    page.fill("#programme", "{experiment: pull, steps: [{position_mm: 0.1}]}")
    expect(page.locator("#form [data-key=position_mm]")).to_have_value("0.1")
    rig.check_s = 1.5
    page.fill("#programme", "{experiment: pull, steps: [{position_mm: 0.2}]}")
    press(page, "#form .add-hold", 2.0)  # the text is read meanwhile
    expect(page.locator("#message")).to_have_text("The programme is being checked.")
    expect(page.locator("#form [data-key=position_mm]")).to_have_value("0.2")
    assert page.locator("#programme").input_value() == "{experiment: pull, steps: [{position_mm: 0.2}]}"
    rig.check_s = 0.0
    press(page, "#form .add-hold", 0.1)
    expect(page.locator("#form legend")).to_have_text(["Step", "Hold"])
    expect(page.locator("#programme")).to_have_value(re.compile(r"position_mm: 0.2\n- hold_s"))
    page.check("#of-file")


def test_the_table_of_the_steps_stays_open_while_its_programme_is_checked(page: Page, rig: ShownRig) -> None:
    """It vanished and came back closed, and everything below it moved, with each change of the rig file."""
    view(page, "run")
    page.check("#of-file")
    page.click("#plan summary")
    expect(page.locator("#plan table")).to_be_visible()
    page.evaluate(NOTE_PLACES)
    rig.show(rig={"changed": 1.0})
    wait_until(lambda: page.evaluate("window.places.length") > 1, "the check and its result", 30)
    expect(page.locator("#plan table")).to_be_visible()
    places = page.evaluate("window.places")
    assert max(places) - min(places) < LINES_PX


LINES_PX = 60  # of the sentence above the table, which is another one during the check
NOTE_PLACES = """() => {
  window.places = [];
  const note = () => places.push(document.querySelector("#run").getBoundingClientRect().y);
  const all = { childList: true, subtree: true, characterData: true, attributes: true };
  new MutationObserver(note).observe(document.querySelector("#start"), all);
}"""  # of the button that starts, after each change of its panel


def test_limits_that_request_a_hold_are_set(page: Page, rig: ShownRig) -> None:
    force = {"name": "force", "value": 1.0, "factor": 1, "unit": "N", "source": ""}
    rig.show(rig={"load_frame": True}, signals=[force])
    view(page, "run")
    page.fill("#alarm-above", "450,5")
    page.click("#set-alarm")
    wait_until(lambda: rig.commands, "the command")
    alarm = {"signal": "force", "below": None, "above": 450.5}
    assert rig.commands[-1].model_dump() == {"alarms": [alarm]}
    rig.show(alarms=[alarm | {"reached": "force 451 N reached its limit 450.5; a hold was requested"}])
    expect(page.locator("#alarms")).to_contain_text("a hold was requested")
    view(page, "maps")
    expect(page.locator("#reached")).to_contain_text("force 451 N reached its limit 450.5")
    view(page, "run")
    rig.show(alarms=[alarm | {"reached": ""}])
    expect(page.locator("#alarms li")).to_contain_text("in force")
    rig.show(signals=[force | {"value": None}])
    expect(page.locator("#alarms li")).to_contain_text("not checked: the signal has no value now")


# maps


def test_marks_and_notes_are_kept_with_their_test(page: Page, rig: ShownRig) -> None:
    rig.show_tests()
    page.goto(page.url.partition("#")[0] + "#maps&test=plate-7")
    expect(page.locator("#opened")).to_be_visible()
    page.select_option("#quantity", "u")
    page.select_option("#step", "1")
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("along x, step 1"))
    page.select_option("#tool", "area")
    box = page.locator("canvas.map").bounding_box()
    assert box is not None
    places = ((0.1, 0.1), (0.6, 0.1), (0.6, 0.8))
    corners = [(box["x"] + across * box["width"], box["y"] + down * box["height"]) for across, down in places]
    for corner in corners[:-1]:
        page.mouse.click(*corner)
    page.mouse.dblclick(*corners[-1])
    page.fill("#mark-name", "left")
    page.click("#keep-mark")
    row = page.locator("#marks tr[data-key=left]")
    expect(row).to_contain_text("area")
    expect(row.locator("td").nth(5)).to_have_text("100 %")
    row.get_by_text("Curve").click()
    expect(page.locator("#marks circle.dot")).to_have_count(3)
    page.fill("#note", "a crack begins")
    page.press("#note", "Tab")
    expect(page.locator("#message")).to_contain_text("kept with the test")
    page.select_option("#step", "2")
    expect(page.locator("#note")).to_have_value("")
    page.reload()
    page.select_option("#step", "1")
    expect(page.locator("#note")).to_have_value("a crack begins")
    expect(page.locator("text.name")).to_have_text("left")
    kept = load_marks(rig.folder / "recordings" / "plate-7")
    assert [(each.name, each.kind, len(each.points)) for each in kept.marks] == [("left", "area", 3)]
    Marks().save(rig.folder / "recordings" / "plate-7")


def test_a_note_stays_that_of_its_step_and_its_test(page: Page, rig: ShownRig) -> None:
    rig.show_tests()
    rig.show(**map_state(0))
    view(page, "maps")
    expect(page.locator("#marks h3")).to_have_text("Note on step 0")
    page.locator("#note").press_sequentially("a crack")
    rig.show(**map_state(0, 1))
    expect(page.locator("#step")).to_have_value("1")
    page.locator("#note").press_sequentially(" begins")
    expect(page.locator("#marks h3")).to_have_text("Note on step 0")
    page.press("#note", "Tab")
    wait_until(lambda: rig.commands, "the command")
    assert rig.commands[-1].notes == {0: "a crack begins"}
    expect(page.locator("#marks h3")).to_have_text("Note on step 1")
    page.goto(page.url.partition("#")[0] + "#maps&test=plate-7")
    expect(page.locator("#opened")).to_be_visible()
    rig.delay_s = 0.5
    page.fill("#note", "of plate 7")
    page.click("#close-test")
    expect(page.locator("#message")).to_contain_text("kept with the test")
    expect(page.locator("#note")).to_have_value("")
    Marks().save(rig.folder / "recordings" / "plate-7")


SHOWN_LABELS = """() => {
    const map = document.querySelector("canvas.map");
    window.labels = [];
    const keep = () => { if (window.labels.at(-1) !== map.ariaLabel) window.labels.push(map.ariaLabel); };
    new MutationObserver(keep).observe(map, { attributeFilter: ["aria-label"] });
}"""


def test_a_map_is_magnified_over_the_image_with_isolines(page: Page, rig: ShownRig) -> None:
    rig.show_tests()
    page.goto(page.url.partition("#")[0] + "#maps&test=plate-7")
    page.select_option("#quantity", "u")
    page.check("#isolines")
    page.check("#over")
    expect(page.locator("canvas.below")).to_be_visible()
    expect(page.locator("path.isoline")).to_have_attribute("d", re.compile("^M"))
    expect(page.locator("#isoline-step")).to_contain_text("Isolines every")
    frame = page.locator(".picture.zoomed").bounding_box()
    assert frame is not None
    place = frame["x"] + 0.52 * frame["width"], frame["y"] + 0.54 * frame["height"]
    page.mouse.move(*place)
    before = page.locator("#readout").inner_text()
    page.mouse.wheel(0, -700)
    expect(page.locator(".moved")).to_have_attribute("style", re.compile(r"scale\(4"))
    page.mouse.move(0, 0)
    page.mouse.move(*place)
    assert page.locator("#readout").inner_text() == before, "the place under the pointer stays"
    page.mouse.down()
    page.mouse.move(place[0] + 200, place[1], steps=4)
    page.mouse.up()
    page.mouse.move(*place)
    assert page.locator("#readout").inner_text() != before, "the map was moved"
    page.click("#zoom-whole")
    page.evaluate(SHOWN_LABELS)
    page.click("#play")
    wait_until(lambda: len(page.evaluate("window.labels")) >= 3, "the last step")
    assert [label.partition(";")[0][-1] for label in page.evaluate("window.labels")] == ["0", "1", "2"]
    expect(page.locator("#play")).to_have_text("Play")
    page.uncheck("#isolines")
    page.uncheck("#over")


def map_state(*steps: int) -> dict[str, Any]:
    """Return the topics of steps with the maps of `SmallRig`."""
    named = [{"name": name, "meaning": name, "unit": "µm", "factor": 1e-6, "level": 2} for name in ("u", "w")]
    sigma = {"u": "sigma_u", "w": None}
    found = [each | {"sigma": sigma[str(each["name"])], "resolution": None} for each in named]
    return {"quantities": found, "steps": [{"step": step, "mapped": 2, "error": ""} for step in steps]}


def click_map(page: Page, *places: tuple[float, float]) -> None:
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("step"))
    box = page.locator("canvas.map").bounding_box()
    assert box is not None
    for column, row in places:
        page.mouse.click(box["x"] + (column + 0.5) / 5 * box["width"], box["y"] + (row + 0.5) / 4 * box["height"])


def test_the_step_stays_and_the_extensometer_is_that_of_the_step(page: Page, rig: ShownRig) -> None:
    rig.show(**map_state(0, 1))
    view(page, "maps")
    page.select_option("#quantity", "u")
    page.select_option("#step", "0")
    page.select_option("#tool", "gauge")
    click_map(page, (0, 0), (4, 0))
    expect(page.locator("#strain")).to_contain_text("Step 0: 0 ±")
    page.select_option("#step", "1")
    expect(page.locator("#strain")).to_contain_text("Step 1: 1")
    page.select_option("#step", "0")
    rig.show(steps=[*rig.state["steps"], {"step": 2, "mapped": 0, "error": ""}])
    view(page, "curves")
    view(page, "maps")
    expect(page.locator("#step")).to_have_value("0")
    view(page, "space")
    page.select_option("#space-step", "0")
    rig.show(steps=rig.state["steps"][:2])
    page.wait_for_timeout(500)
    expect(page.locator("#space-step")).to_have_value("0")


def test_what_is_not_measured_is_no_zero_and_a_profile_has_a_gap(page: Page, rig: ShownRig) -> None:
    """1e6 * null is 0."""
    rig.put_hole()
    rig.show(**map_state(0, 1), signals=[{"name": "force", "value": None, "factor": 1, "unit": "N", "source": ""}])
    view(page, "maps")
    page.select_option("#quantity", "u")
    page.select_option("#step", "1")
    page.select_option("#tool", "gauge")
    click_map(page, (2, 1), (4, 1))
    expect(page.locator("#strain")).to_contain_text("Step 1: not measured")
    page.select_option("#tool", "profile")
    click_map(page, (0, 1), (4, 1))
    expect(page.locator("#probe polyline")).to_have_count(2)
    view(page, "run")
    expect(page.locator("#facts")).to_contain_text("force – N")


def test_zero_is_the_middle_of_two_colours_and_the_bar_is_in_view(page: Page, rig: ShownRig) -> None:
    rig.show(**map_state(0, 1))
    page.set_viewport_size({"width": 1400, "height": 900})
    view(page, "maps")
    page.select_option("#quantity", "u")
    page.select_option("#step", "1")
    page.select_option("#palette", "RdBu_r")
    expect(page.locator("#low")).to_have_value("-40")
    expect(page.locator("#high")).to_have_value("40")
    box = page.locator(".bar").bounding_box()
    assert box is not None
    assert box["y"] + box["height"] < 900
    page.select_option("#palette", "viridis")
    page.select_option("#step", "0")  # all values are 0, their standard deviation is 0.1 µm
    expect(page.locator("#low")).to_have_value("-0.5")
    view(page, "space")
    expect(page.locator("#space-bar")).to_contain_text("µm")
    expect(page.locator(".axes text").first).to_have_text("x: 0 to 4 mm")


# region


def corners(page: Page) -> int:
    return page.locator("circle.corner").count()


def click_image(page: Page, *places: tuple[float, float], count: int = 1) -> None:
    box = page.locator("canvas.camera").bounding_box()
    assert box is not None
    for column, row in places:
        x, y = box["x"] + (column + 0.5) / 160 * box["width"], box["y"] + (row + 0.5) / 120 * box["height"]
        page.mouse.click(x, y, click_count=count)


def test_region_is_edited_and_kept(page: Page, site: Site, rig: ShownRig) -> None:
    square = [[20, 20], [80, 20], [80, 80], [20, 80]]
    region = ITEM | {"item": "region", "state": 1, "next": "Nothing to do."}
    rig.show(setup=[region], rig={"region": [{"points": square, "hole": False}]})
    view(page, "setup")
    page.click("#item-region >> text=Open")
    site.server.publish("image", picture)
    expect(page.locator("canvas.camera")).to_have_attribute("data-stamp", "1")
    assert corners(page) == 4, "the region in force is edited"
    box = page.locator("canvas.camera").bounding_box()
    assert box is not None

    def at(column: float, row: float) -> tuple[float, float]:
        return box["x"] + (column + 0.5) / 160 * box["width"], box["y"] + (row + 0.5) / 120 * box["height"]

    page.mouse.move(*at(80, 80))
    page.mouse.down()
    page.mouse.move(*at(100, 100), steps=4)
    page.mouse.up()
    click_image(page, (20, 20))
    page.click("#remove-corner")
    page.click("#hole")
    click_image(page, (70, 50), (80, 60))
    click_image(page, (75, 65), count=2)
    expect(page.locator("polygon.hole")).to_have_count(1)
    page.click("#polygon")
    click_image(page, (120, 20), (150, 50), (150, 20))
    click_image(page, (120, 50), count=2)
    expect(page.locator("#message")).to_contain_text("crosses itself")
    page.click("#undo")
    view(page, "run")
    view(page, "setup")
    site.server.publish("image", picture)
    expect(page.locator("canvas.camera")).to_have_attribute("data-stamp", re.compile("[0-9]"))
    page.click("#save-region")
    expect(page.locator("#message")).to_contain_text("started")
    saved = json.loads(rig.commands[0].text)["polygons"]
    assert [(len(each["points"]), each["hole"]) for each in saved] == [(3, False), (3, True), (3, False)]
    assert saved[0]["points"][1] == pytest.approx([100, 100], abs=0.5)


def test_region_is_drawn_on_an_image_in_white_light(page: Page, site: Site, rig: ShownRig) -> None:
    rig.show(setup=[ITEM | {"item": "region", "state": 0, "next": "Draw."}])
    view(page, "setup")
    page.click("#item-region >> text=Open")
    site.server.publish("image", picture)
    expect(page.locator("canvas.camera")).to_have_attribute("data-stamp", "1")
    view(page, "run")
    rig.show(live=procedure("live", RUNNING, pattern="fringes", activity="live"))
    view(page, "live")
    expect(page.locator("#live-state")).to_contain_text("fringes")
    view(page, "setup")
    wait_until(lambda: rig.commands, "white light")
    assert (rig.commands[-1].procedure, rig.commands[-1].pattern) == ("live", "white")
    site.server.publish("image", lambda: picture(2.0))
    expect(page.locator(".region p")).to_contain_text("the last image in white light")
    expect(page.locator("canvas.camera")).to_have_attribute("data-stamp", "1")
    rig.show(live=procedure("live", RUNNING, pattern="white"))
    expect(page.locator("#region-white")).to_have_count(0)
    site.server.publish("image", lambda: picture(3.0))
    expect(page.locator("canvas.camera")).to_have_attribute("data-stamp", "3")


def picture(stamp: float = 1.0) -> bytes:
    """Return a grey image of the camera, as the operator node does."""
    jpeg = cv2.imencode(".jpg", np.full((120, 160), 128, np.uint8))[1].tobytes()
    return struct.pack("<IId", 160, 120, stamp) + jpeg


# languages

TEXTS = """() => {
  const texts = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) texts.push([walker.currentNode.parentElement, walker.currentNode.data]);
  for (const name of ["title", "placeholder", "aria-label", "alt"])
    for (const element of document.querySelectorAll(`[${name}]`)) texts.push([element, element.getAttribute(name)]);
  const apart = "[lang=en], script, noscript, #language";
  return texts.filter(([element]) => !element.closest(apart)).map(([, text]) => text);
}"""
CUT = """() => [...document.querySelectorAll("button, h1, h2, h3, legend")]
  .filter((each) => each.scrollWidth > each.clientWidth + 1).map((each) => each.textContent)"""
TRANSLATED_VIEWS = ("tests", "setup", "live", "run", "maps", "curves", "space", "evaluate", "compare", "log")
SHORTEST = 3  # letters of the sentences that are looked for


def full_state(rig: ShownRig) -> None:
    """Show a state in which most sentences of the page appear."""
    rig.show_tests()
    items = [
        ITEM | {"item": each.item.value, "state": 0, "title": TITLES[each.item], "next": next_sentence(each)}
        for each in CheckList().items()
    ]
    black = Figures((0, 0, 9, 9), 0.5, 120.0, 0.1, 0.0, np.ones(256, int), 9.5, 12.5, 1.25, 255.0)
    entries = [[each.name, each.value, each.advice, each.good] for each in live_entries(black, PatternKind.FRINGES)]
    force = {"name": "force", "value": 450.5, "factor": 1, "unit": "N", "source": "load_frame"}
    recorder = {
        "state": "recording",
        "images": 5,
        "missing_images": 0,
        "free_gb": 12.5,
        "minutes_left": 600,
        "error": "",
    }
    limit = {"signal": "force", "below": None, "above": 500.5, "reached": ""}
    running = procedure("run", RUNNING, title="Programme", step=1, steps=5, activity="moving", frame=2, frames=12)
    rig.show(
        **map_state(0, 1) | {"quantities": [described(name) for name in ("u", "w")]},
        setup=items,
        figures={"focus": 0.5, "entries": entries, "histogram": [1, 2, 3]},
        signals=[force],
        alarms=[limit],
        procedure=running | {"remaining_s": 4000},
        load={"mode": "hold"},
        recorder=recorder,
        nodes=[{"name": "camera", "level": "silent", "message": "no diagnostics", "values": {"rate_hz": "9.5"}}],
        rig={"load_frame": True},
        rigs=rig.file.rigs(),
        series={"specimens": ["plate 9"], "answers": {"width [mm]": 20.5}, "text": "", "problem": ""},
    )


def left_in_english(texts: list[str], language: str) -> list[str]:
    """Return the texts that are a sentence of the catalogue, and no translation of another one."""

    def pattern(sentence: str) -> re.Pattern[str]:
        return re.compile(".+".join(map(re.escape, re.split(r"\{\w+\}", sentence))))

    def telling(sentences: Iterable[str]) -> list[re.Pattern[str]]:
        return [pattern(each) for each in sentences if len(re.sub(r"\{\w*\}|\W", "", each)) >= SHORTEST]

    catalogue = catalogues()[language]
    english = telling(each for each, other in catalogue.items() if each != other)
    others = telling(catalogue.values())
    shown = {text.strip() for text in texts}
    found = {text for text in shown if any(each.fullmatch(text) for each in english)}
    return sorted(text for text in found if not any(each.fullmatch(text) for each in others))


@pytest.mark.parametrize("language", sorted(set(catalogues()) - {ENGLISH}))
def test_the_page_in_another_language(browser: Browser, site: Site, rig: ShownRig, language: str) -> None:
    """Every sentence is translated, numbers have a decimal comma, and the longer words fit narrow windows."""
    full_state(rig)
    running = rig.state["procedure"]
    context = browser.new_context(viewport=WIDE, locale=language)
    other, errors = context.new_page(), list[str]()
    other.on("pageerror", lambda error: errors.append(str(error)))
    other.goto(f"{site.origin}/?token={TOKEN}")
    expect(other.locator("html")).to_have_attribute("lang", language)
    for name in TRANSLATED_VIEWS:
        other.goto(f"{site.origin}/#{name}")
        expect(other.locator(f"#views a[data-key={name}][aria-current]")).to_be_visible()
        if name == "setup":
            other.click("#item-timing button[data-key=open]")
        if name in ("maps", "space"):
            expect(other.locator("main .bar span").first).not_to_be_empty()
        for shown in (rig.state["procedure"], procedure()) if name == "run" else (rig.state["procedure"],):
            rig.show(procedure=shown)
            is_running = name == "run" and shown["state"] == RUNNING
            expect(other.locator("#activity")).to_be_visible(visible=is_running)
            if name == "run" and not is_running:
                other.check("#own")
                expect(other.locator("#form fieldset").first).to_be_visible()
            other.click("#help")
            for width in (700, NARROW["width"]):
                other.set_viewport_size({"width": width, "height": 900})
                assert other.evaluate("() => document.documentElement.scrollWidth") <= width, (name, width)
                assert other.evaluate(CUT) == [], (name, width)
            texts = other.evaluate(TEXTS)
            assert left_in_english(texts, language) == [], name
            assert not [each for each in texts if "undefined" in each or "[object" in each], name
            other.click("#help")
        rig.show(procedure=running)
    other.goto(f"{site.origin}/#setup")
    for typed, problem in (("1,234", ""), ("1.234", "1,234")):  # the separator of thousands of the language
        other.fill("#exposure_ms", typed)
        assert problem in (other.get_attribute("#exposure_ms", "title") or ""), typed
        assert other.evaluate("() => document.querySelector('#exposure_ms').checkValidity()") == (not problem)
    other.goto(f"{site.origin}/#run")
    expect(other.locator("#facts")).to_contain_text("450,5 N")
    other.select_option("#language", "en")
    expect(other.locator("html")).to_have_attribute("lang", "en")
    other.reload()
    expect(other.locator("#hold")).to_have_text("Request hold")
    expect(other.locator("#facts")).to_contain_text("450.5 N")
    context.close()
    assert errors == []


def test_the_buttons_of_a_run_stay_while_its_programme_is_checked(page: Page, rig: ShownRig) -> None:
    """The table of the steps took the place of their row, and a press that had begun was lost."""
    view(page, "run")
    expect(page.locator("#plan")).to_be_visible()
    page.evaluate("() => { document.querySelector('#by-hand').isFirst = true; }")
    page.click("#own")
    page.fill("#programme", "")
    expect(page.locator("#problem")).to_contain_text("Write a programme")
    expect(page.locator("#plan")).to_have_count(0)
    page.click("#of-file")
    expect(page.locator("#plan")).to_be_visible()
    assert page.evaluate("() => document.querySelector('#by-hand').isFirst"), "the button is another one"
    assert not rig.commands


# every view, while its optional parts come and go

NOTE_ELEMENTS = """() => {
  const found = new Map(), fields = "main :is(input, select, textarea)";
  const all = `main :is(button, a, summary), header button, #question button, ${fields}`;
  for (const element of document.querySelectorAll(all)) {
    const keys = [], own = element.id || element.dataset.key || "";
    for (let at = element; at; at = at.parentElement) keys.unshift(at.id || at.dataset.key || "");
    const words = element.getAttribute("aria-label") ?? element.labels?.[0]?.textContent ?? element.textContent;
    const name = `${keys.filter(Boolean).join("/")} ${element.localName}${own ? "" : ` ${words}`}`;
    let number = 1;
    while (found.has(`${name} ${number}`)) number++;
    found.set(`${name} ${number}`, element);
  }
  const before = window.elementsBefore ?? new Map(), both = [...found.keys()].filter((name) => before.has(name));
  window.elementsBefore = found;
  return [both.length, both.filter((name) => before.get(name) !== found.get(name))];
}"""  # how many buttons, links and fields were there before, and the names of those that are other elements now
VISITED = "async () => (await import('/page/stream.js')).latest('visited')"
ENTERED: dict[str, Callable[[Page], None]] = {
    "setup": lambda page: page.click("#item-timing >> text=Open"),
    "run": lambda page: page.check("#of-file"),
}


def passing_states(rig: ShownRig) -> Iterator[dict[str, Any]]:
    """Yield states of a rig of which each has other optional parts than the one before."""
    rig.show_tests()
    tests = {"tests": rig.state["tests"], "rigs": rig.state["rigs"]}
    rig.show(tests=[], rigs=[])
    maps = map_state(0, 1)
    region = ITEM | {"item": "region", "state": 0, "next": "Draw."}
    force = {"name": "force", "value": 1.0, "factor": 1, "unit": "N", "source": ""}
    limit = {"signal": "force", "below": None, "above": 450.5, "reached": ""}
    position = {"signal": "position", "below": 0.0, "above": None, "reached": ""}
    mark = {"name": "left", "kind": "point", "points": [[1, 1]]}
    series = {"answers": {"operator": "M. Weber"}, "text": "", "planned": 0}
    runs = procedure("run", RUNNING, step=1, steps=5)
    node = {"name": "camera", "level": "ok", "message": "", "values": {}}
    listed = {"setup": [AXES, TIMING]}
    yield listed
    yield listed | {"rig": {"file_error": "camera: unknown"}, "hand": "step 0 is measured"}
    yield listed | {"rig": {"load_frame": True}, "signals": [force], "steps": maps["steps"]}
    yield listed | tests | {"rig": {"load_frame": True}, "signals": [force], "alarms": [limit]} | maps
    yield listed | tests | {"alarms": [position, limit | {"reached": "force 451 N"}], "signals": [force]} | maps
    yield {"setup": [region, AXES, TIMING | {"report": "/files/a", "picture": "/files/b"}]} | tests | maps
    yield {"setup": [TIMING | {"state": 1, "words": []}, region]} | maps | {"marks": {"marks": [mark], "notes": {}}}
    marks = {"marks": [mark | {"name": "right"}, mark], "notes": {"0": "dark"}}
    yield listed | maps | {"marks": marks, "series": series | {"specimens": ["plate 9"]}}
    longer = series | {"specimens": ["plate 7", "plate 9"], "problem": "?"}
    yield listed | maps | tests | {"marks": marks, "series": longer}
    yield listed | tests | {"procedure": runs, "figures": {"focus": 0.5, "entries": [], "histogram": [1, 2]}}
    yield listed | tests | {"procedure": runs | {"question": "Lay the grid", "notes": ["dark"], "error": "no light"}}
    yield listed | {"procedure": runs | {"state": PAUSED, "title": "Programme"}, "nodes": [node]}
    yield listed | {"procedure": procedure("by_hand", RUNNING, step=0, steps=1, notes=["dark"]), "nodes": [node]}
    ended = procedure("run", FAILED, words=["ended early"], folder="five-1", notes=["dark"])
    yield listed | {"procedure": ended, "rig": {"load_frame": True}, "hand": "step 1 is measured"}
    yield listed | {"procedure": ended | {"settings": "camera: {}", "notes": [], "error": "no light"}}
    yield listed | {"procedure": procedure("timing", DONE, words=["delay 80 ms"], settings="camera: {}")}
    yield listed | {"procedure": procedure("timing", FAILED, error="no light"), "rig": {"operated": False}}
    yield listed | {"live": procedure("live", RUNNING, pattern="fringes", activity="live")}
    yield listed


@pytest.mark.parametrize("name", TRANSLATED_VIEWS)
def test_buttons_links_and_fields_stay_the_same_elements(page: Page, rig: ShownRig, name: str) -> None:
    """An element that is made anew loses the press that has begun on it, the focus, and what is being typed."""
    shown: list[int] = []
    others: dict[int, list[str]] = {}
    page.evaluate("() => { window.elementsBefore = undefined; }")
    for number, topics in enumerate(passing_states(rig)):
        rig.show(rig.bare(), **topics, visited=number)
        wait_until(lambda number=number: page.evaluate(VISITED) == number, "the state")
        if number == 0:
            view(page, name)
            expect(page.locator("main > *").first).to_be_visible()
            if name in ENTERED:
                ENTERED[name](page)
            page.wait_for_timeout(500)  # what a view reads when it is opened
        count, changed = page.evaluate(NOTE_ELEMENTS)
        shown.append(count)
        if changed:
            others[number] = changed
    assert others == {}
    assert min(shown[1:]) > 0, "nothing was compared"
