"""Every view of the operator's page with the virtual rig of 1280x960 px: phone, desk and 4K screen, light and dark.

``--pictures docs/pictures`` renews the pictures of the documentation.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import pytest
from browser import NARROW, WIDE, low_contrasts
from operated import VIEWS, WAIT_MS, driving, finished, live_frame, operating, start_programme, view
from playwright.sync_api import Browser, Page, ViewportSize, expect

pytestmark = [pytest.mark.browser, pytest.mark.operate]
SIZES: dict[str, ViewportSize] = {"phone": NARROW, "desk": WIDE, "4k": {"width": 3840, "height": 2160}}
PROGRAMME = "{experiment: tension, ramp: {to_mm: 0.6, steps: 4, speed_mm_per_s: 5}}"
GAUGE = ((0.5, 0.2), (0.5, 0.8))  # of width and height of the map
Picture = Callable[[str], None]


@pytest.fixture(scope="module")
def page(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with (
        operating(tmp_path_factory.mktemp("pictures"), rig_name="plate") as operated,
        driving(browser, operated) as page,
    ):
        yield page


@pytest.fixture
def picture(page: Page, request: pytest.FixtureRequest) -> Picture:
    """Return the function that keeps a picture of the page where one asks for pictures."""
    folder: Path | None = request.config.getoption("--pictures")

    def keep(name: str) -> None:
        if folder is not None:
            page.evaluate("() => scrollTo(0, 0)")
            page.screenshot(path=folder / f"{name}.png")

    return keep


def test_item_of_the_check_list_shows_the_live_image(page: Page, picture: Picture) -> None:
    view(page, "setup")
    page.click("#item-camera_focus >> text=Open")
    live_frame(page)
    expect(page.locator("#focus")).to_contain_text("%", timeout=WAIT_MS)
    picture("operator_setup")


def test_live_view_shows_image_and_figures(page: Page, picture: Picture) -> None:
    view(page, "live")
    live_frame(page)
    expect(page.locator("#figures dt").first).to_be_visible(timeout=WAIT_MS)
    expect(page.locator("#live-state")).to_have_text("The projector shows: white.")
    picture("operator_live")


def test_programme_shows_its_steps_and_the_remaining_time(page: Page, picture: Picture) -> None:
    start_programme(page, PROGRAMME)
    expect(page.locator("#steps td.good")).to_have_count(2, timeout=WAIT_MS)
    expect(page.locator("#activity")).to_have_text(re.compile("about .* left"), timeout=WAIT_MS)
    expect(page.locator("tr.now")).to_contain_text("frame", timeout=WAIT_MS)
    picture("operator_run")
    assert finished(page).startswith("4 steps in tension-")
    targets = page.locator("#steps tr td:nth-child(2)").all_inner_texts()
    assert targets == ["0", "0.2", "0.4", "0.6"], "of this programme, not of that of the rig file"


def test_map_shows_value_and_strain_with_their_uncertainty(page: Page, picture: Picture) -> None:
    view(page, "maps")
    page.select_option("#quantity", "v")
    page.select_option("#tool", "gauge")
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("step 3"), timeout=WAIT_MS)
    box = page.locator("canvas.map").bounding_box()
    assert box is not None
    for across, down in GAUGE:
        page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])
    expect(page.locator("#strain")).to_have_text(re.compile(r"Step 3: \S+ ± \S+ µstrain"))
    expect(page.locator("#readout")).to_have_text(re.compile(r"v = \S+ ± \S+ µm at"))
    picture("operator_maps")
    view(page, "curves")
    page.select_option("#curve-x", "strain")
    expect(page.locator("circle.dot")).to_have_count(4)
    picture("operator_curves")
    view(page, "space")
    expect(page.locator("main p[role=status]")).to_contain_text("points", timeout=WAIT_MS)
    page.fill("#magnified", "20")
    page.press("#magnified", "Tab")
    picture("operator_space")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_view_fits_and_has_enough_contrast(
    page: Page, tmp_path: Path, size: str, scheme: Literal["light", "dark"]
) -> None:
    page.set_viewport_size(SIZES[size])
    page.emulate_media(color_scheme=scheme)
    for name in VIEWS:
        view(page, name)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= SIZES[size]["width"], name
        assert low_contrasts(page) == [], name
        page.screenshot(path=tmp_path / f"{name}.png")
