"""`fringedic operate` in a real browser: a technician sets up and runs the tiny virtual rig by clicks alone."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest
import yaml
from browser import opened
from operated import (
    WAIT_MS,
    Operated,
    click_at,
    driving,
    finished,
    live_frame,
    operating,
    start_programme,
    take_wheel,
    view,
)
from playwright.sync_api import Browser, Page, expect
from rclpy.serialization import deserialize_message
from running_system import free_port
from viewer import LAYOUT, Viewer, drawn, viewing

import fringedic
from fringedic.datasets.attributes import recorded_metadata
from fringedic.frames.region import Region
from fringedic_ros.serialized import message_type
from fringedic_ros.testing import node_pids

pytestmark = [pytest.mark.browser, pytest.mark.operate]
FIVE_STEPS = "{experiment: five, ramp: {to_mm: 0.6, steps: 5, speed_mm_per_s: 5}}"
PANELS: dict[str, set[str]] = {}  # fields of each topic of the layout; the tiny rig has no extensometer
for _topic, _field in drawn(json.loads(LAYOUT.read_text())):
    if "/extensometer/" not in _topic:
        PANELS.setdefault(_topic, set()).update([_field] if _field else [])


@pytest.fixture(scope="module")
def operated(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operated]:
    del browser  # nothing is started where there is none
    with operating(tmp_path_factory.mktemp("operated")) as running:
        yield running


@pytest.fixture
def page(browser: Browser, operated: Operated) -> Iterator[Page]:
    """Return the page of the driver."""
    with driving(browser, operated) as page:
        yield page


def test_live_image_moves_and_shows_its_figures(page: Page) -> None:
    view(page, "live")
    first = live_frame(page)
    expect(page.locator("canvas.camera")).not_to_have_attribute("data-stamp", first, timeout=WAIT_MS)
    expect(page.locator("#focus")).to_contain_text("%", timeout=WAIT_MS)
    page.select_option("#pattern", "fringes")
    expect(page.locator("#figures dt", has_text="fringes")).to_be_visible(timeout=WAIT_MS)


def test_adjusted_items_are_done_with_date_and_figures(page: Page, operated: Operated) -> None:
    view(page, "setup")
    for item in ("axes", "camera_focus", "projector_focus"):
        page.click(f"#item-{item} >> text=Open")
        page.click(f"#item-{item} >> text=Show the pattern")
        expect(page.locator("#focus")).to_contain_text("%", timeout=WAIT_MS)
        page.click(f"#item-{item} >> text=It is adjusted")
        expect(page.locator(f"#item-{item}")).to_have_class(re.compile("good"))
    kept = yaml.safe_load((operated.folder / "tiny_setup.yaml").read_text())
    assert set(kept) == {"axes", "camera_focus", "projector_focus"}
    assert "% of the best" in kept["camera_focus"]["words"][0]


def test_region_is_drawn_by_clicks_and_used(page: Page, operated: Operated) -> None:
    view(page, "setup")
    page.click("#item-region >> text=Open")
    live_frame(page)
    page.click("#rectangle")
    click_at(page, 20, 15)
    click_at(page, 140, 105)
    page.click("#hole")
    for place in ((70, 50), (90, 50), (90, 70), (20, 110)):
        click_at(page, *place)
    page.click("#undo")
    page.click("#save-region")
    expect(page.locator("#words")).to_contain_text("the rig file uses it", timeout=WAIT_MS)
    region = Region.load(operated.folder / "tiny_region.yaml")
    mask = region.mask()
    assert mask.shape == (120, 160)
    assert [polygon.hole for polygon in region.polygons] == [False, True]
    expected = Region.rectangle((20, 15), (140, 105)).mask_for((120, 160))
    assert np.count_nonzero(expected & ~mask) == pytest.approx(20 * 20 / 2, abs=60), "the hole"
    assert np.count_nonzero(mask & ~expected) < 0.03 * expected.sum(), "a screen pixel is a tenth of a pixel"
    assert fringedic.load_rig_file(operated.folder / "tiny.yaml").region_file == str(
        operated.folder / "tiny_region.yaml"
    )
    assert list(operated.folder.glob("tiny.before-*.yaml"))


def test_programme_pauses_continues_and_leaves_a_recording_although_the_server_is_killed(
    page: Page, operated: Operated
) -> None:
    view(page, "run")
    page.fill("#test-specimen", "plate 7")
    page.fill("#test-width-mm-", "25,5")
    start_programme(page, FIVE_STEPS)
    page.click("#pause")
    expect(page.locator("#resume")).to_be_visible()
    expect(page.locator("#summary")).to_contain_text("is paused", timeout=WAIT_MS)
    page.click("#resume")
    expect(page.locator("tr.now")).to_contain_text("capture", timeout=WAIT_MS)
    os.kill(operated.page_process(), signal.SIGKILL)
    expect(page.locator("#message")).to_contain_text("The measurement goes on without it")
    expect(page.locator("#message")).to_be_hidden(timeout=WAIT_MS)
    assert finished(page).startswith("5 steps in plate-7-")
    expect(page.locator("#title")).to_have_text("rig – plate 7")
    [folder] = (operated.folder / "recordings").glob("plate-7-*")
    with fringedic.open_experiment(folder / "bag") as run:
        specimen = recorded_metadata(run).specimen
        assert (specimen.name, specimen.entries) == ("plate 7", {"width [mm]": 25.5})
        assert run.step.values.tolist() == [0, 1, 2, 3, 4]
        assert not any(run.error.values)
        again = fringedic.process_bag(folder / "bag", output=operated.folder / "again.nc")
        with fringedic.open_experiment(again) as desk:
            for name in ("phase", "u", "e_22", "sigma_w"):
                assert np.array_equal(run[name].values, desk[name].values, equal_nan=True), name
        view(page, "maps")
        page.select_option("#quantity", "v")
        expect(page.locator("canvas.map")).to_have_attribute(
            "aria-label", re.compile("displacement along y, step [0-4];")
        )
        box = page.locator("canvas.map").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.3 * box["height"])  # the middle is the hole
        text = page.locator("#readout").inner_text()
        found = re.fullmatch(r"v = (\S+) ± (\S+) µm at column (\d+), row (\d+)", text)
        assert found is not None, text
        step = int(page.locator("#step").input_value())  # the server may have been away during the last ones
        at = run.sel(step=step, column=int(found[3]), row=int(found[4]))
        assert float(found[1]) == pytest.approx(1e6 * float(at.v), abs=0.6 * 10.0 ** -len(found[1].partition(".")[2]))
    report = page.request.get(page.url.partition("#")[0] + "files/run/report.html")
    assert report.ok
    assert report.headers["content-security-policy"].startswith("sandbox")
    page.check("#over")
    expect(page.locator("canvas.below")).to_be_visible()
    view(page, "tests")
    row = page.locator(f"tr[data-key='{folder.name}']")
    expect(row).to_contain_text("5 steps measured")
    row.locator("a.open").click()
    expect(page.locator("#opened")).to_contain_text("Earlier test: plate 7")
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("step 4"))


def test_programme_without_its_driver_pauses_and_another_browser_stops_it(
    page: Page, browser: Browser, operated: Operated
) -> None:
    with opened(browser, operated.url) as lost:
        page.click("text=Hand over")
        lost.click("text=Ask for the wheel")
        expect(lost.locator("#wheel")).to_contain_text("You drive", timeout=WAIT_MS)
        steps = ", ".join(["{hold_s: 3}"] * 100)
        start_programme(lost, f"{{experiment: stopped, on_operator_lost: hold, steps: [{steps}]}}")
        expect(lost.locator("#steps td.good").first).to_be_visible(timeout=WAIT_MS)
        view(lost, "setup")
        lost.click("#item-calibrate >> text=Open")
        expect(lost.locator("#item-calibrate .start")).to_be_disabled()
        refused = lost.request.post(f"{origin(lost)}/do/start", data={"procedure": "calibrate"}, headers=own(lost))
        assert "run is running: wait until it has ended, or stop it" in refused.text()
    view(page, "run")
    expect(page.locator("#summary")).to_contain_text("is paused", timeout=WAIT_MS)
    expect(page.locator("#procedure")).to_contain_text("the page of the driver is closed")
    page.click("#hold")
    expect(page.locator("#message")).to_contain_text("hold requested at")
    page.click("text=Ask for the wheel")
    expect(page.locator("#wheel")).to_contain_text("You drive")
    page.click("#stop")
    words = finished(page)
    assert re.search(r"\d+ steps in stopped-", words)
    assert "stopped by the operator" in words


def origin(page: Page) -> str:
    return page.url.partition("#")[0].rstrip("/")


def own(page: Page) -> dict[str, str]:
    """Return the header of a request of the page itself."""
    return {"Origin": origin(page)}


def test_programme_goes_on_without_its_driver_and_four_others_see_it(
    page: Page, browser: Browser, operated: Operated
) -> None:
    """By default a programme does not need the page of its driver: after longer than a lost one is waited for."""
    with ExitStack() as others:
        lookers = [others.enter_context(opened(browser, operated.url)) for _ in range(4)]
        for each in lookers:
            view(each, "run")
        start_programme(page, "{experiment: alone, steps: [{}, {hold_s: 20}, {}]}")
        expect(page.locator("tr.now")).to_contain_text("capture", timeout=WAIT_MS)
        page.click("#hold")
        expect(page.locator("#message")).to_contain_text("hold requested at")
        expect(page.locator("#message")).to_contain_text("the programme does not go on by itself")
        expect(page.locator("#summary")).to_contain_text("is paused", timeout=WAIT_MS)
        page.click("#resume")
        page.goto("about:blank")
        for each in lookers:
            assert finished(each).startswith("3 steps in alone-")
            expect(each.locator("#procedure")).not_to_contain_text("the page of the driver is closed")
    page.goto(operated.url)
    expect(page.locator("nav a").first).to_be_visible()
    take_wheel(page)


def test_full_disk_is_told_and_the_next_programme_works(page: Page, operated: Operated) -> None:
    """A limit of the file size replaces a full disk; only the number of the error differs."""
    start_programme(page, f"{{experiment: full, steps: [{', '.join(['{}'] * 30)}]}}")
    expect(page.locator("tr.now")).to_be_visible(timeout=WAIT_MS)
    expect(page.locator("#steps td.good").first).to_be_visible(timeout=WAIT_MS)
    [folder] = (operated.folder / "recordings").glob("full-*")
    limit = (folder / "bag" / "bag_0.mcap").stat().st_size + 50_000
    resource.prlimit(node_pids(folder)["recorder"], resource.RLIMIT_FSIZE, (limit, limit))
    expect(page.locator("#steps td.bad").first).to_contain_text("the disk is full", timeout=WAIT_MS)
    expect(page.locator("#facts")).to_contain_text("the disk is full")
    page.click("#stop")
    assert "the disk is full" in finished(page)
    with fringedic.open_experiment(folder / "bag") as run:
        assert not run.error.values[0], "what was measured before is kept"
    start_programme(page, "{experiment: space, steps: [{}, {}]}")
    expect(page.locator("#words")).to_contain_text("2 steps in space-", timeout=WAIT_MS)


def test_steps_are_measured_by_hand_on_a_page_that_joins_and_foxglove_shows_them(
    page: Page, browser: Browser, operated: Operated
) -> None:
    with (
        foxglove() as viewer,
        operating(operated.folder, "--attach") as joined,
        driving(browser, joined) as attached,
    ):
        viewer.watch(*(topic for topic in PANELS if topic.startswith("/rig/live_view/")))
        shown = dict[str, Any]()
        collect(viewer, shown, 2)
        view(page, "run")
        expect(page.locator("#by-hand")).to_be_enabled(timeout=WAIT_MS)
        page.click("#by-hand")
        viewer.watch(*(topic for topic in PANELS if not topic.startswith("/rig/live_view/")))
        expect(page.locator("#activity")).to_contain_text("ready to measure", timeout=WAIT_MS)
        for step, place in enumerate((page, attached)):
            view(place, "run")
            expect(place.locator("#measure")).to_be_enabled(timeout=WAIT_MS)
            place.click("#measure")
            expect(place.locator("#hand")).to_have_text(f"step {step} is measured", timeout=WAIT_MS)
        live_frame(attached)
        expect(attached.locator("#hold")).to_be_enabled()
        collect(viewer, shown, len(PANELS))
        for topic, fields in PANELS.items():
            assert_drawn(shown[topic], fields)
        page.click("#stop")
        assert finished(page).startswith("dataset and report in by_hand-")


@contextmanager
def foxglove() -> Iterator[Viewer]:
    """Run `fringedic view --foxglove` for the running nodes, and connect a viewer."""
    code = "from fringedic.command.main import main; main()"
    command = [sys.executable, "-c", code, "view", "--foxglove", "--port", str(free_port())]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        url = next(line.split()[-1] for line in process.stdout if line.startswith("foxglove: "))
        with viewing(url) as viewer:
            yield viewer
        process.send_signal(signal.SIGINT)
        process.wait(300)


def collect(viewer: Viewer, shown: dict[str, Any], count: int) -> None:
    """Wait until messages of so many topics have arrived, and keep the last of each."""
    while len(shown) < count:
        for topic, data, _ in viewer.received(1):
            shown[topic] = deserialize_message(data, message_type(viewer.topics[topic]["schemaName"]))


def assert_drawn(message: Any, fields: set[str]) -> None:
    """Check that a panel finds what it draws in a message."""
    kind = type(message).__name__
    if kind == "Image":
        assert message.height * message.width > 0
    elif kind == "PointCloud2":
        assert {"x", "y", "z", "w"} <= {field.name for field in message.fields}
    else:
        for field in fields:
            assert isinstance(getattr(message, field), float), f"{kind}.{field}"


def test_a_whole_programme_is_driven_with_the_keyboard_alone(page: Page) -> None:
    key(page, "nav a[href='#run']")
    expect(page.locator("#run")).to_be_enabled(timeout=WAIT_MS)
    focus(page, "#of-file")
    page.keyboard.press("ArrowDown")
    focus(page, "#programme")
    page.keyboard.press("Control+a")
    page.keyboard.type("{experiment: keys, steps: [{}, {}, {hold_s: 600}]}")
    expect(page.locator("#plan summary")).to_have_text("Steps: 3", timeout=WAIT_MS)
    expect(page.locator("#run")).to_be_enabled(timeout=WAIT_MS)  # a press while it is checked is refused
    key(page, "#run")
    key(page, "#pause")
    expect(page.locator("#summary")).to_contain_text("is paused", timeout=WAIT_MS)
    key(page, "#resume")
    expect(page.locator("#steps td.good")).to_have_count(2, timeout=WAIT_MS)
    key(page, "#hold")
    expect(page.locator("#message")).to_contain_text("hold requested at")
    key(page, "#stop")
    assert "2 steps in keys-" in finished(page)
    key(page, "nav a[href='#maps']")
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("step"), timeout=WAIT_MS)
    focus(page, "canvas.map")
    page.keyboard.press("Shift+ArrowLeft")
    expect(page.locator("#readout")).to_contain_text(" at column ")


def focus(page: Page, selector: str) -> None:
    """Press Tab until an element has the focus."""
    expect(page.locator(selector)).to_be_visible()
    script = "(selector) => document.activeElement === document.querySelector(selector)"
    for _ in range(60):
        if page.evaluate(script, selector):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not reach {selector}")


def key(page: Page, selector: str) -> None:
    """Reach an element with Tab, and press Enter."""
    focus(page, selector)
    page.keyboard.press("Enter")


def test_wrong_requests_are_answered_by_a_sentence_and_the_next_one_works(page: Page, operated: Operated) -> None:
    view(page, "run")
    page.check("#own")
    page.fill("#programme", "{ramp: {steps: 1}}")
    expect(page.locator("#problem")).to_contain_text("programme: ramp", timeout=WAIT_MS)
    expect(page.locator("#run")).to_be_disabled()
    page.check("#of-file")
    rig = operated.folder / "tiny.yaml"
    before = rig.read_text()
    rig.write_text("camera: {source: nonsense}")
    expect(page.locator("#file-error")).to_contain_text("camera", timeout=WAIT_MS)
    rig.write_text(before)
    expect(page.locator("#start .bad")).to_have_count(0, timeout=WAIT_MS)
    expect(page.locator("#run")).to_be_enabled(timeout=WAIT_MS)


def test_second_browser_looks_and_asks_for_the_wheel(page: Page, browser: Browser, operated: Operated) -> None:
    with opened(browser, operated.url) as other:
        expect(other.locator("#wheel")).to_contain_text(re.compile(r"browser \d+ \(127.0.0.1\) drives"))
        view(other, "run")
        other.click("text=Ask for the wheel")
        page.click("text=Hand over to browser")
        expect(other.locator("#wheel")).to_contain_text("You drive")
        expect(page.locator("#wheel")).to_contain_text("drives")
        page.click("text=Ask for the wheel")
        other.click("text=Hand over to browser")
        expect(page.locator("#wheel")).to_contain_text("You drive")


def test_a_second_page_at_the_same_port_and_a_second_rig_are_refused(operated: Operated) -> None:
    port = operated.url.rpartition(":")[2].partition("/")[0]
    code = "from fringedic.command.main import main; main()"
    command = [sys.executable, "-c", code, "operate", str(operated.folder / "tiny.yaml"), "--port", port]
    refused = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert refused.returncode == 1
    assert re.search(rf"127.0.0.1 port {port}: the page cannot be served .* another --port", refused.stderr)
