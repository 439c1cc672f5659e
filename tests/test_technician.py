"""25 tasks of a technician, each done on the page alone: by mouse with slow presses, or with the keyboard.

Fourteen tasks read a finished test (`fringedic view`), eleven set up and run tests (`fringedic operate`). They run on a
phone, a desk and a 4K screen in chromium; those that read also in Firefox.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import pytest
from browser import LARGE, NARROW, WIDE, Driver, FirefoxPage, chromium_page, firefox_page, viewing_page
from hands import Keyboard, Mouse
from operated import Operated, operating
from playwright.sync_api import Browser, ViewportSize
from running_system import RecordedExperiment, free_port, wait_until

pytestmark = pytest.mark.browser
FIREFOX = "firefox-esr"
SIZES: dict[str, ViewportSize] = {"phone": NARROW, "desk": WIDE, "4k": LARGE}
HANDS: dict[str, type[Mouse]] = {"mouse": Mouse, "keyboard": Keyboard}
MAP = "canvas.map"
MEASURED_S = 300.0  # a programme on a busy computer
Task = Callable[[Mouse], None]


def label_of(hands: Mouse, pattern: str) -> None:
    """Wait until the map has a label."""
    hands.wait(
        "(pattern) => new RegExp(pattern).test(document.querySelector('canvas.map')?.getAttribute('aria-label'))",
        pattern,
    )


def opens_page(hands: Mouse, selector: str) -> None:
    """Follow a link that opens a page of its own, whose address is answered."""
    before = hands.driver.pages()
    hands.click(selector)
    address = hands.driver.run("(selector) => document.querySelector(selector).href", selector)
    assert hands.driver.run("async (address) => (await fetch(address)).status", address) == 200
    wait_until(lambda: hands.driver.run("() => true") and hands.driver.pages() == before + 1, "the other page", 30)
    hands.driver.come_back()


# what a technician can do about the wheel; nothing while a request is on its way, or waits for the driver
WHEEL = """() => {
  const ask = document.querySelector("#ask");
  if (!ask) return "drive";
  return ask.matches("[aria-busy], [aria-disabled]") ? null : "ask";
}"""


def takes_the_wheel(hands: Mouse) -> None:
    """Ask for the wheel where another browser had it before; one that has left keeps it for a moment."""
    while hands.wait(WHEEL, what="the wheel of a browser that has left") == "ask":
        hands.click("#ask")


# reading a test


def sees_the_last_map(hands: Mouse) -> None:
    label_of(hands, "displacement along y, step 2;")


def chooses_map_and_step(hands: Mouse) -> None:
    hands.choose("#quantity", "e_22")
    hands.choose("#step", "1")
    label_of(hands, "surface strain along the second tangent, step 1;")


def reads_a_value_with_its_uncertainty(hands: Mouse) -> None:
    hands.choose("#quantity", "v")
    label_of(hands, "displacement along y, step 1;")
    hands.point_at(MAP, -10, 0)
    hands.reads("#readout", r"v = \S+ ± \S+ µm at column \d+, row \d+")
    hands.reads("#position", r"x = \S+ mm, y = \S+ mm")


def sets_the_range_of_the_colours_with_a_decimal_comma(hands: Mouse) -> None:
    hands.write("#low", "-100,5")
    hands.write("#high", "250,5")
    hands.reads(".bar", r"-10[01]\s*µm[\s\S]*25[01]\s*µm")


def plays_the_steps(hands: Mouse) -> None:
    hands.choose("#step", "0")
    label_of(hands, "step 0;")
    hands.click("#play")
    label_of(hands, "step 2;")
    hands.reads("#play", "Play")


def magnifies_the_map(hands: Mouse) -> None:
    scale = (
        "(wanted) => (document.querySelector('.moved').style.transform.match(/scale\\((.*)\\)/)?.[1] ?? '1') === wanted"
    )
    hands.click("#zoom-in")
    hands.wait(scale, "1.5")
    hands.click("#zoom-whole")
    hands.wait(scale, "1")


def sees_isolines_over_the_surface(hands: Mouse) -> None:
    for box in ("#over", "#isolines"):
        hands.click(box)
    hands.sees("canvas.below")
    hands.reads("#isoline-step", r"Isolines every \S+ µm")
    for box in ("#over", "#isolines"):
        hands.click(box)


def draws_a_profile(hands: Mouse) -> None:
    hands.choose("#tool", "profile")
    hands.draw(MAP, (-10, 0), (10, 0))
    hands.reads("#probe", "Profile of v")


def measures_the_strain_between_two_points(hands: Mouse) -> None:
    hands.choose("#tool", "gauge")
    hands.draw(MAP, (-12, -7), (-12, 7))
    hands.reads("#strain", r"Step 2: \S+ ± \S+ µstrain")


def keeps_an_area_with_its_statistics(hands: Mouse) -> None:
    takes_the_wheel(hands)
    hands.choose("#tool", "area")
    hands.draw(MAP, (-16, -8), (-8, -8), (-8, 8))
    name = f"edge {hands.driver.run('() => innerWidth + navigator.vendor')} {type(hands).__name__}"
    hands.write("#mark-name", name)
    hands.click("#keep-mark")
    hands.reads("#marks tr:last-child", rf"{re.escape(name)}\s+area\s+\S+ ± \S+ µm\s+\S+\s+\S+\s+\d+ %")


def writes_a_note_on_a_step(hands: Mouse) -> None:
    text = f"seen by {type(hands).__name__}"
    hands.write("#note", text)
    hands.reads("#message", "kept with the test")
    hands.choose("#step", "1")
    label_of(hands, "step 1;")
    hands.choose("#step", "2")
    hands.wait("(text) => document.querySelector('#note').value === text", text)


def sees_the_force_over_the_strain(hands: Mouse) -> None:
    hands.view("curves")
    hands.choose("#curve-x", "strain")
    hands.choose("#curve-y", "signal force")
    hands.wait("() => document.querySelectorAll('circle.dot').length === 3")


def turns_the_surface(hands: Mouse) -> None:
    hands.view("space")
    if not hands.driver.run("() => Boolean(document.createElement('canvas').getContext('webgl'))"):
        hands.reads("main p[role=status]", "This browser has no WebGL")  # Firefox without a screen
        return
    hands.reads("main p[role=status]", r"\d+ points")
    picture = "() => document.querySelector('#space').toDataURL()"
    before = hands.driver.run(picture)
    hands.write("#magnified", "20")
    hands.wait("(before) => document.querySelector('#space').toDataURL() !== before", before)
    assert hands.driver.run(picture) != before


def reads_report_and_manual(hands: Mouse) -> None:
    hands.view("maps")
    opens_page(hands, "#summary a")
    hands.click("#help")
    hands.reads("#help-text", "Point at the map to read a value")
    opens_page(hands, "#help-text a")
    hands.click("#help")


READING: dict[str, Task] = {
    each.__name__: each
    for each in (
        sees_the_last_map,
        chooses_map_and_step,
        reads_a_value_with_its_uncertainty,
        sets_the_range_of_the_colours_with_a_decimal_comma,
        plays_the_steps,
        magnifies_the_map,
        sees_isolines_over_the_surface,
        draws_a_profile,
        measures_the_strain_between_two_points,
        keeps_an_area_with_its_statistics,
        writes_a_note_on_a_step,
        sees_the_force_over_the_strain,
        turns_the_surface,
        reads_report_and_manual,
    )
}
READERS = [
    ("chromium", "phone", "mouse"),
    ("chromium", "desk", "keyboard"),
    ("firefox", "desk", "mouse"),
    pytest.param(("chromium", "4k", "mouse"), marks=pytest.mark.operate),  # too long for every check
    pytest.param(("firefox", "phone", "mouse"), marks=pytest.mark.operate),
    pytest.param(("firefox", "4k", "mouse"), marks=pytest.mark.operate),
]


@pytest.fixture(scope="module")
def address(recorded: RecordedExperiment, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Serve a copy of the recorded test: marks and notes are kept with it."""
    folder = tmp_path_factory.mktemp("read") / recorded.report.folder.name
    shutil.copytree(recorded.report.folder, folder)
    with viewing_page(folder / "bag", free_port()) as found:
        yield found


def page_of(kind: str, browser: Browser, size: ViewportSize, url: str) -> AbstractContextManager[Driver]:
    """Open a page in a browser; skip where Firefox is not installed."""
    if kind == "chromium":
        return chromium_page(browser, size, url)
    executable = shutil.which(FIREFOX)
    if executable is None:
        pytest.skip("Firefox is not installed: sudo apt-get install firefox-esr")
    return firefox_page(executable, size, url)


@pytest.fixture(scope="module", params=READERS, ids="-".join)
def reader(request: pytest.FixtureRequest, browser: Browser, address: str) -> Iterator[Mouse]:
    kind, size, hands = request.param
    with page_of(kind, browser, SIZES[size], address) as driver:
        yield HANDS[hands](driver)


@pytest.mark.parametrize("task", READING)
def test_a_technician_reads_a_test(reader: Mouse, task: str) -> None:
    if task == writes_a_note_on_a_step.__name__ and isinstance(reader.driver, FirefoxPage):
        pytest.skip("a note is kept when its field is left, which Firefox without a screen does not report")
    READING[task](reader)


# setting up and running tests; each continues what the one before has left


def sees_who_drives(hands: Mouse) -> None:
    hands.reads("#wheel", "drive")
    takes_the_wheel(hands)
    hands.reads("#wheel", "You drive")


def adjusts_the_focus(hands: Mouse) -> None:
    hands.view("setup")
    hands.click("#item-camera_focus [data-key=open]")
    hands.click("#item-camera_focus .start")
    hands.reads("#focus", "%")
    hands.click("#item-camera_focus .done")
    hands.sees("#item-camera_focus.good")


def draws_the_measured_region(hands: Mouse) -> None:
    hands.view("setup")
    hands.click("#item-region [data-key=open]")
    hands.wait("() => document.querySelector('canvas.camera')?.dataset.stamp")
    hands.click("#rectangle")
    hands.draw("canvas.camera", (-60, -45), (60, 45))
    hands.click("#save-region")
    hands.sees("#item-region.good")


def corrects_a_programme_beyond_the_limits(hands: Mouse) -> None:
    hands.view("run")
    hands.write("#test-specimen", "plate 7")
    hands.write("#test-operator", "M. Weber")
    hands.write("#test-width-mm-", "25,5")
    hands.click("#own")
    hands.write("#form-experiment", "technician")
    hands.write("#form [data-key=to_mm]", "50")
    hands.reads("#problem", "25 mm, outside 0 to 1 mm")
    hands.write("#form [data-key=to_mm]", "0,6")
    hands.write("#form [data-key=steps]", "5")
    hands.write("#form [data-key=speed_mm_per_s]", "5")
    hands.reads("#plan summary", "Steps: 5")


def starts_and_pauses(hands: Mouse) -> None:
    hands.click("#run")
    hands.click("#pause", MEASURED_S)
    hands.reads("#summary", "is paused", MEASURED_S)


def limits_the_force(hands: Mouse) -> None:
    hands.wait("() => document.querySelector('#alarm-signal')?.options.length")
    hands.choose("#alarm-signal", "position")
    hands.write("#alarm-above", "9,5")
    hands.click("#set-alarm")
    hands.reads("#alarms li", "position at or above 9.5 mm")


def requests_a_hold(hands: Mouse) -> None:
    hands.click("#resume")
    hands.reads("tr.now", "frame", MEASURED_S)
    hands.click("#hold", MEASURED_S)
    hands.reads("#message", "hold requested at")
    # on a busy computer the pause and the hold may come as late as in the last step, which no step follows
    is_last = re.search(r"step 4 |has ended", hands.reads("#summary", r"\S"))
    hands.reads("#summary", "is paused|has failed" + ("|has ended" if is_last else ""), MEASURED_S)
    if hands.driver.run("() => Boolean(document.querySelector('#resume'))"):
        hands.click("#resume")
    hands.reads("#words", r"\S", MEASURED_S)
    if hands.driver.run("() => Boolean(document.querySelector('#go-on'))"):
        hands.click("#go-on")
        hands.wait("() => !document.querySelector('#words')")
    hands.reads("#words", "steps in plate-7", MEASURED_S)  # since it went on; all of them are in the list of tests


def finds_and_opens_the_test(hands: Mouse) -> None:
    hands.view("tests")
    hands.write("#search", "weber plate")
    hands.reads(".tests tr[data-key^=plate-7]", "5 steps measured")
    hands.click(".tests tr[data-key^=plate-7] a.open")
    hands.reads("#opened", "Earlier test: plate 7")
    label_of(hands, "step 4;")
    hands.click("#close-test")


def measures_the_next_specimen_of_a_series(hands: Mouse) -> None:
    hands.view("run")
    hands.click("#series-fold summary")
    hands.write("#series-names", "plate 8")
    hands.click("#plan-series")
    hands.view("tests")
    hands.write("#search", "")
    hands.click("#series li[data-key='plate 8'] [data-key=test]")
    hands.view("run")
    hands.reads("#words", "5 steps in plate-8", MEASURED_S)
    hands.view("tests")
    hands.reads("#series li[data-key='plate 8']", "plate-8.*5 steps measured")


def compares_two_tests(hands: Mouse) -> None:
    for name in ("plate-7", "plate-8"):
        hands.click(f".tests tr[data-key^={name}] [data-key=compare]")
    hands.click("#compare-tests")
    hands.reads("#entries", r"specimen\s+plate [78]\s+plate [78]")
    hands.wait("() => document.querySelectorAll('canvas.map[aria-label]').length === 2")


def measures_a_step_by_hand(hands: Mouse) -> None:
    hands.view("run")
    hands.click("#by-hand")
    hands.click("#measure", MEASURED_S)
    hands.reads("#hand", "step 0 is measured", MEASURED_S)
    hands.click("#stop")
    hands.reads("#words", "dataset and report in plate-7-", MEASURED_S)


DRIVING: dict[str, Task] = {
    each.__name__: each
    for each in (
        sees_who_drives,
        adjusts_the_focus,
        draws_the_measured_region,
        corrects_a_programme_beyond_the_limits,
        starts_and_pauses,
        limits_the_force,
        requests_a_hold,
        finds_and_opens_the_test,
        measures_the_next_specimen_of_a_series,
        compares_two_tests,
        measures_a_step_by_hand,
    )
}
DRIVERS = [("chromium", "desk", "mouse"), ("chromium", "phone", "keyboard"), ("chromium", "4k", "mouse")]


@pytest.fixture(scope="module")
def operated(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operated]:
    del browser  # nothing is started where there is none
    with operating(tmp_path_factory.mktemp("technician")) as running:
        yield running


@pytest.fixture(scope="module", params=DRIVERS, ids="-".join)
def technician(request: pytest.FixtureRequest, browser: Browser, operated: Operated) -> Iterator[Mouse]:
    kind, size, hands = request.param
    with page_of(kind, browser, SIZES[size], operated.url) as driver:
        found = HANDS[hands](driver)
        yield found
        found.click("#give")


@pytest.mark.operate
@pytest.mark.parametrize("task", DRIVING)
def test_a_technician_runs_a_test(technician: Mouse, task: str) -> None:
    DRIVING[task](technician)


def test_there_are_25_tasks() -> None:
    assert len(READING) + len(DRIVING) == 25
