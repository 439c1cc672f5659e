"""The whole check list of the set-up and the first test of a rig, by clicks on the page alone."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
import yaml
from operated import WAIT_MS, Operated, click_at, driving, finished, live_frame, operating, start_programme, view
from playwright.sync_api import Browser, Page, expect

import fringedic

pytestmark = [pytest.mark.browser, pytest.mark.operate]
MEASURED_MS = 300_000  # a calibration on a busy computer
ADJUSTED = ("axes", "camera_focus", "projector_focus")


@pytest.fixture(scope="module")
def operated(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operated]:
    del browser  # nothing is started where there is none
    with operating(tmp_path_factory.mktemp("set_up")) as running:
        yield running


@pytest.fixture
def page(browser: Browser, operated: Operated) -> Iterator[Page]:
    with driving(browser, operated) as page:
        yield page


def open_item(page: Page, item: str) -> None:
    page.click(f"#item-{item} >> text=Open")


def is_done(page: Page, item: str) -> None:
    """Wait until an item is done."""
    expect(page.locator(f"#item-{item}")).to_have_class(re.compile("good"), timeout=MEASURED_MS)


def measure(page: Page, item: str, **options: str) -> None:
    """Measure an item with options that a technician enters."""
    open_item(page, item)
    for name, value in options.items():
        page.fill(f"#{name}", value)
    page.click(f"#item-{item} .start")
    use_result(page, item)


def use_result(page: Page, item: str) -> None:
    """Wait until an item is measured, and use its result in the rig file where it has one; it is done then."""
    expect(page.locator(f"#item-{item}")).to_have_class(re.compile("good|care"), timeout=MEASURED_MS)
    if page.locator(f"#item-{item} .use-result").count():
        page.click(f"#item-{item} .use-result")
        expect(page.locator("#message")).to_contain_text("the rig file is changed", timeout=WAIT_MS)
    is_done(page, item)


def measure_without_the_browser(page: Page, item: str, operated: Operated) -> None:
    """Start an item, leave the page while it is measured, and come back."""
    open_item(page, item)
    page.click(f"#item-{item} .start")
    expect(page.locator("#activity")).to_be_visible(timeout=WAIT_MS)
    page.goto("about:blank")
    page.goto(operated.url)
    view(page, "setup")
    use_result(page, item)


def adjust(page: Page, item: str) -> None:
    """Adjust an item with the live view."""
    open_item(page, item)
    page.click(f"#item-{item} >> text=Show the pattern")
    expect(page.locator("#focus")).to_contain_text("%", timeout=WAIT_MS)
    page.click(f"#item-{item} >> text=It is adjusted")
    is_done(page, item)


def draw_region(page: Page) -> None:
    open_item(page, "region")
    live_frame(page)
    page.click("#rectangle")
    click_at(page, 20, 15)
    click_at(page, 140, 105)
    page.click("#save-region")
    is_done(page, "region")


def test_rig_is_set_up_and_measures_its_first_test_by_clicks_alone(page: Page, operated: Operated) -> None:
    view(page, "setup")
    for item in ADJUSTED:
        adjust(page, item)
    for item in ("timing", "response"):
        measure(page, item)
    measure_without_the_browser(page, "calibrate", operated)
    measure(page, "check")
    draw_region(page)
    measure(page, "noise", steps="5")
    measure(page, "advise", wanted_noise_px="0.05", pixel_size_mm="0.4")
    kept = yaml.safe_load((operated.folder / "tiny_setup.yaml").read_text())
    assert len(kept) == page.locator("ol.list > li").count()
    assert page.locator("ol.list > li.care").count() == 0, "nothing is out of date in this order"
    assert "5 steps at rest" in kept["noise"]["words"][0]
    assert any(" mm" in line for line in kept["advise"]["words"])
    rig = fringedic.load_rig_file(operated.folder / "tiny.yaml")
    assert rig.region_file == str(operated.folder / "tiny_region.yaml")
    assert rig.noise_floor_file is not None
    start_programme(page, "{experiment: first, ramp: {to_mm: 0.6, steps: 5, speed_mm_per_s: 5}}")
    assert finished(page).startswith("5 steps in first-")
    [folder] = (operated.folder / "recordings").glob("first-*")
    with fringedic.open_experiment(folder / "bag") as run:
        assert run.step.values.tolist() == [0, 1, 2, 3, 4]
        assert not any(run.error.values)
        assert {"e_22", "sigma_e_22"} <= set(run)
    assert page.request.get(page.url.partition("#")[0] + "files/run/report.html").ok
