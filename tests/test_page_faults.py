"""The operator's page in a real browser, over a real server whose rig a test sets: what a technician must not meet."""

from __future__ import annotations

import asyncio
import json
import re
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import opened
from playwright.sync_api import Browser, Page, expect
from running_system import CONFIG, wait_until
from served import TOKEN, Site, SmallRig, served

from fringedic.errors import OperatorError
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
        self.file = ShownRigFile(CONFIG / "tiny.yaml")
        self.reset()

    def reset(self) -> None:
        rig = {"kind": "rig", "title": "rig", "operated": True, "machine": True, "measures": True, "running": []}
        self.state = {
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
        }
        self.commands.clear()
        self.delay_s, self.refusal = 0.0, ""
        self.put_maps()

    def show(self, **topics: Any) -> None:
        """Change topics of the state; `rig` is changed in part."""
        self.state = self.state | topics | {"rig": self.state["rig"] | topics.get("rig", {})}

    def put_hole(self) -> None:
        """Leave out the middle column of the maps of all steps."""
        self.put_maps(hole=2)

    async def check(self, text: str) -> dict[str, Any]:
        return self.file.check(text)

    def busy(self) -> str:
        return ""

    async def do(self, command: Any) -> str:
        await asyncio.sleep(self.delay_s)
        if self.refusal:
            raise OperatorError(self.refusal)
        self.commands.append(command)
        return "started"

    def folders(self) -> dict[str, Path]:
        return {f"test {each['name']}": self.folder for each in self.state["tests"]}


@pytest.fixture(scope="module")
def site(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    del browser  # nothing is started where there is none
    with served(tmp_path_factory.mktemp("page"), ShownRig) as running:
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


@pytest.mark.operate
@pytest.mark.parametrize("state", BUTTONS)
def test_hundred_of_hundred_presses_arrive(page: Page, site: Site, rig: ShownRig, state: str) -> None:
    selectors = prepare(page, rig, state)
    durations = [0.03 + 0.97 * (37 * number % 100) / 99 for number in range(100)]
    with messages(site):
        assert {each: arrived(page, rig, each, durations) for each in selectors} == dict.fromkeys(selectors, 100)


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


def test_an_action_is_answered_in_time_and_a_double_click_is_one(page: Page, rig: ShownRig) -> None:
    rig.delay_s = 3.0
    view(page, "run")
    expect(page.locator("#run")).to_be_enabled()
    page.evaluate(ANSWER_TIME)
    page.dblclick("#run")
    expect(page.locator("#message")).to_contain_text("Sent")
    assert page.evaluate("window.answeredMs") < 300
    expect(page.locator("#message")).to_contain_text("started")
    assert len(rig.commands) == 1
    rig.delay_s, rig.refusal = 0.0, "a procedure is starting: wait"
    expect(page.locator("#run")).not_to_have_attribute("aria-busy", "true")
    page.click("#run")
    expect(page.locator("#message")).to_contain_text("a procedure is starting")
    rig.show(procedure=procedure("run", RUNNING))
    expect(page.locator("#message")).to_be_hidden()


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
    view(page, "run")
    href = page.locator("#tests a").first.get_attribute("href")
    assert href is not None
    assert page.request.get(page.url.partition("/#")[0] + href).text() == "the report"
    expect(page.locator("#tests")).to_contain_text("six-2")


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


# maps


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
    expect(page.locator("canvas.camera")).to_have_attribute("data-stamp", re.compile("[0-9]"))
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


def picture() -> bytes:
    """Return a grey image of the camera, as the operator node does."""
    jpeg = cv2.imencode(".jpg", np.full((120, 160), 128, np.uint8))[1].tobytes()
    return struct.pack("<IId", 160, 120, 1.0) + jpeg
