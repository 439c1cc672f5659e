"""`fringedic operate` in a real browser: a technician sets up and runs the tiny virtual rig by clicks alone."""

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

import numpy as np
import pytest
import yaml
from browser import NARROW, low_contrasts, opened, page_address
from playwright.sync_api import Browser, Page, expect
from running_system import CONFIG, free_port

import fringedic
from fringedic.frames.region import Region

pytestmark = [pytest.mark.browser, pytest.mark.operate]
WAIT_MS = 90_000  # for a procedure on a busy computer
FIVE_STEPS = "{experiment: five, ramp: {to_mm: 0.6, steps: 5, speed_mm_per_s: 5}}"
VIEWS = {
    "setup": "#item-axes",
    "live": "canvas.camera",
    "run": "#run",
    "maps": "canvas.map",
    "curves": "#curve-x",
    "space": "#space",
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
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if parent == self.process.pid and any(word.endswith(b"/operator") for word in words):
                return int(entry.name)
        raise AssertionError("the server of the page does not run")


@contextmanager
def operating(folder: Path, *words: str) -> Iterator[Operated]:
    """Run `fringedic operate` for a copy of the tiny rig."""
    rig = folder / "tiny.yaml"
    if not rig.exists():
        shutil.copyfile(CONFIG / "tiny.yaml", rig)
    code = "from fringedic_bringup.command.main import main; main()"
    command = [sys.executable, "-c", code, "operate", str(rig), "--port", str(free_port()), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "COLUMNS": "300"}) as process:
        assert process.stdout is not None
        url = page_address(process.stdout)
        try:
            yield Operated(process, url, folder)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(90)


@pytest.fixture(scope="module")
def operated(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operated]:
    del browser  # nothing is started where there is none
    with operating(tmp_path_factory.mktemp("operated")) as running:
        yield running


@pytest.fixture
def page(browser: Browser, operated: Operated) -> Iterator[Page]:
    """Return the page of the driver; the one of the test before has handed over."""
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
    kept = yaml.safe_load((operated.folder / "setup.yaml").read_text())
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
    region = Region.load(operated.folder / "region.yaml")
    mask = region.mask()
    assert mask.shape == (120, 160)
    assert [polygon.hole for polygon in region.polygons] == [False, True]
    expected = Region.rectangle((20, 15), (140, 105)).mask_for((120, 160))
    assert np.count_nonzero(expected & ~mask) == pytest.approx(20 * 20 / 2, abs=60), "the hole"
    assert np.count_nonzero(mask & ~expected) < 0.03 * expected.sum(), "a screen pixel is a tenth of a pixel"
    assert fringedic.load_rig_file(operated.folder / "tiny.yaml").region_file == "region.yaml"
    assert list(operated.folder.glob("tiny.before-*.yaml"))


def click_at(page: Page, column: float, row: float) -> None:
    """Click a pixel of the camera image."""
    box = page.locator("canvas.camera").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + (column + 0.5) / 160 * box["width"], box["y"] + (row + 0.5) / 120 * box["height"])


def start_programme(page: Page, text: str) -> None:
    view(page, "run")
    expect(page.locator("#run")).to_be_enabled(timeout=WAIT_MS)
    page.click("summary:has-text('Another programme')")
    page.fill("#programme", text)
    page.click("#run")


def finished(page: Page) -> str:
    """Wait for the result of a programme and return it."""
    expect(page.locator("#words")).to_be_visible(timeout=WAIT_MS)
    return page.locator("#words").inner_text()


def test_programme_pauses_continues_and_leaves_a_recording_although_the_server_is_killed(
    page: Page, operated: Operated
) -> None:
    start_programme(page, FIVE_STEPS)
    page.click("#pause")
    expect(page.locator("#resume")).to_be_visible()
    expect(page.locator("#summary")).to_contain_text("is paused", timeout=WAIT_MS)
    page.click("#resume")
    expect(page.locator("tr.now")).to_contain_text("capture", timeout=WAIT_MS)
    os.kill(operated.page_process(), signal.SIGKILL)
    expect(page.locator("#message")).to_contain_text("The measurement goes on without it")
    expect(page.locator("#message")).to_be_hidden(timeout=WAIT_MS)
    assert finished(page).startswith("5 steps in five-")
    [folder] = (operated.folder / "recordings").glob("five-*")
    with fringedic.open_experiment(folder / "bag") as run:
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


def test_stop_ends_a_run_with_its_results(page: Page) -> None:
    start_programme(page, "{experiment: stopped, steps: [{}, {}, {hold_s: 600}]}")
    expect(page.locator("#steps td.good")).to_have_count(2, timeout=WAIT_MS)
    page.click("#hold")
    expect(page.locator("#message")).to_contain_text("hold requested at")
    page.click("#stop")
    words = finished(page)
    assert "2 steps in stopped-" in words
    assert "stopped by the operator" in words


def test_steps_are_measured_by_hand(page: Page) -> None:
    view(page, "run")
    expect(page.locator("#by-hand")).to_be_enabled(timeout=WAIT_MS)
    page.click("#by-hand")
    expect(page.locator("#activity")).to_contain_text("ready to measure", timeout=WAIT_MS)
    for step in (0, 1):
        expect(page.locator("#measure")).to_be_enabled(timeout=WAIT_MS)
        page.click("#measure")
        expect(page.locator("#hand")).to_have_text(f"step {step} is measured", timeout=WAIT_MS)
    page.click("#stop")
    assert finished(page).startswith("dataset and report in by_hand-")


def test_wrong_requests_are_answered_by_a_sentence_and_the_next_one_works(page: Page, operated: Operated) -> None:
    start_programme(page, "{ramp: {steps: 1}}")
    expect(page.locator("#error")).to_contain_text("programme: ramp", timeout=WAIT_MS)
    rig = operated.folder / "tiny.yaml"
    before = rig.read_text()
    rig.write_text("camera: {source: nonsense}")
    expect(page.locator("#start .bad")).to_contain_text("camera", timeout=WAIT_MS)
    rig.write_text(before)
    expect(page.locator("#start .bad")).to_have_count(0, timeout=WAIT_MS)


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
    code = "from fringedic_bringup.command.main import main; main()"
    command = [sys.executable, "-c", code, "operate", str(operated.folder / "tiny.yaml"), "--port", port]
    refused = subprocess.run(command, capture_output=True, text=True, check=False, timeout=90)
    assert refused.returncode == 1
    assert re.search(rf"127.0.0.1 port {port}: the page cannot be served .* another --port", refused.stderr)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_view_fits_a_phone_and_has_enough_contrast(page: Page, scheme: str) -> None:
    page.set_viewport_size(NARROW)
    page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
    for name in VIEWS:
        view(page, name)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 320, name
        assert low_contrasts(page) == [], name
