"""`fringedic view` in a real browser: colours, values and uncertainties of a recording equal those of its dataset."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
import xarray as xr
from browser import NARROW, low_contrasts, opened, viewing_page
from playwright.sync_api import Browser, Page, Route, expect
from running_system import RecordedExperiment, free_port, wait_until

import fringedic
from fringedic.evaluation import extensometer
from fringedic.figures.palettes import palette

pytestmark = pytest.mark.browser
TWO_REFERENCES = """async () => {
  const { chart } = await import("/page/chart.js");
  const drawn = chart([[0, 0, 0, 0], [1, 1, 0, 0], [2, 0, 0, 2], [3, 1, 0, 2]], { x: "step", y: "strain" });
  return [...drawn.querySelectorAll("polyline")].map((each) => each.getAttribute("points").split(" ").length);
}"""
VIEWS = {"maps": "canvas.map[aria-label]", "curves": "circle.dot", "space": "#space"}  # and a part of each


@pytest.fixture(scope="module")
def dataset(recorded: RecordedExperiment) -> Iterator[xr.Dataset]:
    with fringedic.open_experiment(recorded.report.folder / "bag") as opened:
        yield opened


@pytest.fixture(scope="module")
def url(recorded: RecordedExperiment) -> Iterator[str]:
    with viewing_page(recorded.report.folder / "bag", free_port()) as address:
        yield address


@pytest.fixture
def page(browser: Browser, url: str) -> Iterator[Page]:
    """Return the page of the recording; an error in the browser's console fails the test."""
    with opened(browser, url) as page:
        expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("step"))
        yield page


def choose(page: Page, dataset: xr.Dataset, step: int, name: str) -> None:
    """Choose a map and wait until it is drawn."""
    page.select_option("#quantity", name)
    page.select_option("#step", str(step))
    label = re.compile(re.escape(f"{dataset[name].long_name}, step {step};"))
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", label)


def pixel(page: Page, column: int, row: int) -> list[int]:
    """Return red, green, blue and opacity of a pixel of the map."""
    script = "([x, y]) => [...document.querySelector('canvas.map').getContext('2d').getImageData(x, y, 1, 1).data]"
    found: list[int] = page.evaluate(script, [column, row])
    return found


def point_at(page: Page, dataset: xr.Dataset, column: int, row: int) -> str:
    """Move the pointer to a point of the result and return the text under the map."""
    box: Any = page.locator("canvas.map").bounding_box()
    x = box["x"] + (column + 0.5) / dataset.sizes["column"] * box["width"]
    y = box["y"] + (row + 0.5) / dataset.sizes["row"] * box["height"]
    page.mouse.move(x, y)
    return page.locator("#readout").inner_text()


def click_at(page: Page, dataset: xr.Dataset, *places: tuple[int, int]) -> None:
    """Click points of the result, each (column, row), one after the other."""
    for column, row in places:
        point_at(page, dataset, column, row)
        page.mouse.down()
        page.mouse.up()


@pytest.mark.parametrize("name", ["v", "w", "e_22"])
def test_colour_and_hover_text_are_those_of_the_dataset(page: Page, dataset: xr.Dataset, name: str) -> None:
    choose(page, dataset, 2, name)
    factor, low, high = 1e-6, -100.0, 500.0
    page.fill("#low", str(low))
    page.fill("#high", str(high))
    page.press("#high", "Tab")
    values = dataset[name].sel(step=2).values.astype(np.float64) / factor
    sigmas = dataset[f"sigma_{name}"].sel(step=2).values.astype(np.float64) / factor
    smoothing = dataset.get(f"resolution_{name}")
    colours = palette("viridis")
    measured = np.argwhere(np.isfinite(values) & np.isfinite(sigmas))
    for row, column in measured[:: len(measured) // 4].tolist():
        value, sigma = values[row, column], sigmas[row, column]
        index = int(np.clip((value - low) / (high - low) * 256, 0, 255))
        assert pixel(page, column, row) == [*colours[index], 255]
        digits = max(1 - int(np.floor(np.log10(sigma))), 0)
        unit = "µstrain" if name == "e_22" else "µm"
        place = f"at column {dataset.column.values[column]}, row {dataset.row.values[row]}"
        errors = ""
        if smoothing is not None:
            most = float(smoothing.sel(step=2).values[row, column]) / factor
            errors = f" noise, up to {float(f'{most:.2g}'):g} µstrain smoothing,"
        expected = f"{name} = {value:.{digits}f} ± {sigma:.{digits}f} {unit}{errors} {place}"
        assert point_at(page, dataset, column, row) == expected
    corner = values[0, 0]
    assert np.isnan(corner)
    assert pixel(page, 0, 0)[3] == 0
    assert "not measured" in point_at(page, dataset, 0, 0)


def test_profile_and_extensometer_follow_clicks(page: Page, dataset: xr.Dataset) -> None:
    choose(page, dataset, 2, "v")
    page.select_option("#tool", "gauge")
    click_at(page, dataset, (20, 8), (20, 22))
    expect(page.locator("#strain")).to_contain_text("Step 2")
    strain = page.locator("#strain").inner_text()
    first, second = ((int(dataset.column[20]), int(dataset.row[row])) for row in (8, 22))
    expected = extensometer(dataset, first, second, subset=9).sel(step=2)
    assert strain.startswith(
        f"Step 2: {1e6 * float(expected.strain):.0f} ± {1e6 * float(expected.sigma_strain):.0f} µstrain"
    )
    page.click("text=Curves")
    page.select_option("#curve-x", "strain")
    expect(page.locator("circle.dot")).to_have_count(dataset.sizes["step"])
    page.click("summary")
    last = [float(text) for text in page.locator("tr:last-child td").all_inner_texts()]
    assert last == pytest.approx([1e6 * float(expected.strain), float(dataset.force.sel(step=2)), 0], rel=1e-5)
    assert page.locator("th:last-child").inner_text() == "relative to step"
    assert len(page.locator("polyline.curve").get_attribute("points").split()) == dataset.sizes["step"]
    assert page.evaluate(TWO_REFERENCES) == [2, 2], "the curve is interrupted where the reference changes"
    page.click("text=Maps")
    expect(page.locator("#strain")).to_have_text(strain)
    page.select_option("#tool", "profile")
    click_at(page, dataset, (10, 15), (30, 15))
    expect(page.locator("#probe h2")).to_have_text("Profile of v")
    curve = page.locator("#probe polyline").get_attribute("points")
    assert curve is not None
    assert len(curve.split()) == int(dataset.column[30] - dataset.column[10]) + 1


class Held:
    """The first request of a page that fits a pattern; its response waits until it is released."""

    def __init__(self, page: Page, pattern: str) -> None:
        self._page = page
        self._first: Route | None = None
        page.route(pattern, self._hold)

    def _hold(self, route: Route) -> None:
        if self._first is None:
            self._first = route
        else:
            route.continue_()

    def wait(self) -> None:
        """Wait until there is a request."""
        wait_until(lambda: self._page.evaluate("true") and self._first, "a request")

    def release(self) -> None:
        """Let the server answer, and return when the page has used the answer."""
        assert self._first is not None
        with self._page.expect_event("requestfinished"):
            self._first.continue_()
        self._page.wait_for_timeout(200)


def test_an_answer_about_earlier_points_that_comes_late_is_not_shown(page: Page, dataset: xr.Dataset) -> None:
    choose(page, dataset, 2, "v")
    held = Held(page, "**/gauge?*")
    page.select_option("#tool", "gauge")
    click_at(page, dataset, (20, 8), (20, 22))
    held.wait()
    page.select_option("#tool", "profile")
    click_at(page, dataset, (10, 15), (30, 15))
    expect(page.locator("#probe h2")).to_have_text("Profile of v")
    held.release()
    expect(page.locator("#probe h2")).to_have_text("Profile of v")


def test_a_cloud_of_an_earlier_choice_that_comes_late_is_not_drawn(page: Page) -> None:
    drawn = "() => document.querySelector('#space').toDataURL()"
    page.click("text=3D")
    words = page.locator("main p[role=status]")
    expect(words).to_contain_text("coloured by w of step")
    page.select_option("#space-quantity", "v")
    expect(words).to_contain_text("coloured by v of step")
    expected = page.evaluate(drawn)
    held = Held(page, "**/cloud/*/w")
    page.select_option("#space-quantity", "w")
    held.wait()
    with page.expect_response("**/cloud/*/v"):
        page.select_option("#space-quantity", "v")
    held.release()
    expect(words).to_contain_text("coloured by v of step")
    assert page.evaluate(drawn) == expected


def test_a_view_that_was_left_before_it_came_is_not_shown(page: Page) -> None:
    held = Held(page, "**/page/curves.js")
    page.click("text=Curves")
    held.wait()
    page.click("text=3D")
    expect(page.locator("#space")).to_be_visible()
    held.release()
    expect(page.locator("#space")).to_be_visible()
    expect(page.locator("#curve-x")).to_have_count(0)


def test_cloud_is_drawn_and_turns(page: Page) -> None:
    page.click("text=3D")
    expect(page.locator("main p[role=status]")).to_contain_text("points")
    script = "() => document.querySelector('#space').toDataURL()"
    before = page.evaluate(script)
    page.focus("#space")
    page.keyboard.press("ArrowRight")
    wait_until(lambda: page.evaluate(script) != before, "another picture")


def test_curve_of_force_and_position_shows_every_step(page: Page, dataset: xr.Dataset) -> None:
    page.click("text=Curves")
    expect(page.locator("circle.dot")).to_have_count(dataset.sizes["step"])
    page.click("summary")
    cells = page.locator("td").all_inner_texts()
    expected = [
        f"{float(value):.6g}" for pair in zip(1e3 * dataset.position, dataset.force, strict=True) for value in pair
    ]
    assert [float(cell) for cell in cells] == pytest.approx([float(text) for text in expected])
    page.select_option("#curve-y", label="temperature_grip [K] (thermocouple)")
    expect(page.locator("circle.dot")).to_have_count(dataset.sizes["step"])
    expect(page.locator("tr:last-child td:last-child")).to_have_text("295")


def test_map_is_read_with_the_keyboard_alone(page: Page, dataset: xr.Dataset) -> None:
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("() => document.activeElement.className") == "map":
            break
    page.keyboard.press("ArrowRight")
    middle = dataset.sizes["column"] // 2 + 1, dataset.sizes["row"] // 2
    column, row = int(dataset.column[middle[0]]), int(dataset.row[middle[1]])
    assert page.locator("#readout").inner_text().endswith(f"at column {column}, row {row}")


def test_page_that_was_left_open_says_that_the_address_is_another_one(
    browser: Browser, recorded: RecordedExperiment
) -> None:
    port = free_port()
    with ExitStack() as yesterday:
        address = yesterday.enter_context(viewing_page(recorded.report.folder / "bag", port))
        with opened(browser, address) as page:
            expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("step"))
            yesterday.close()
            expect(page.locator("#message")).to_contain_text("has lost its server")
            with viewing_page(recorded.report.folder / "bag", port):
                expect(page.locator("#message")).to_contain_text("open the address that fringedic has printed")


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_view_fits_a_phone_and_has_enough_contrast(page: Page, view: str, scheme: Any) -> None:
    page.set_viewport_size(NARROW)
    page.emulate_media(color_scheme=scheme)
    page.goto(page.url.partition("#")[0] + f"#{view}")
    page.wait_for_selector(VIEWS[view])
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 320
    assert low_contrasts(page) == []


def test_a_step_is_previewed_with_other_settings_and_exported(page: Page) -> None:
    """The help leads to the manual of the same server."""
    page.click("#views a[data-key=evaluate]")
    expect(page.locator("#window + span")).to_have_text(re.compile(r"was \d+"), timeout=30_000)
    page.fill("#window", "4,5,6")
    page.click("#preview")
    expect(page.locator("#message")).to_contain_text("no valid value")
    page.fill("#window", "48")
    page.click("#preview")
    expect(page.locator("#previewed td").first).to_be_visible(timeout=240_000)  # a nice process waits for all others
    for picture in page.locator("#previewed img").all():
        expect(picture).to_have_js_property("complete", True)
        assert picture.evaluate("each => each.naturalWidth") > 100
    page.select_option("#format", "csv")
    page.select_option("#exported-step", "1")
    with page.expect_download(timeout=60_000) as download:
        page.click("#download")
    assert download.value.suggested_filename == "run_csv.zip"
    page.click("#help")
    expect(page.locator("#help-text")).to_contain_text("named evaluation")
    with page.expect_popup() as opened_page:
        page.click("#help-text a")
    expect(opened_page.value.locator("#evaluate")).to_have_text("Evaluate")
    assert not low_contrasts(page)
    page.set_viewport_size(NARROW)
    assert page.evaluate("document.documentElement.scrollWidth") <= NARROW["width"]
