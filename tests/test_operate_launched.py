"""`fringedic operate --attach` and a rig that `ros2 launch` has started."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from launch_stand_in import launched, running
from operated import WAIT_MS, driving, live_frame, operating, view
from playwright.sync_api import Browser, expect

pytestmark = [pytest.mark.browser, pytest.mark.operate]


def test_page_waits_for_a_rig_and_joins_the_one_that_is_launched(
    browser: Browser, domain: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes = launched(monkeypatch, rig="tiny", folder=str(tmp_path / "run"))
    with operating(tmp_path, "--attach") as joined, driving(browser, joined) as page:
        view(page, "run")
        expect(page.locator("#elsewhere")).to_contain_text("No node of this rig runs: start it")
        expect(page.locator("#run")).to_be_disabled()
        with running(nodes, tmp_path, domain):
            expect(page.locator("#elsewhere")).to_contain_text("started elsewhere", timeout=WAIT_MS)
            for step in range(2):
                expect(page.locator("#measure")).to_be_enabled(timeout=WAIT_MS)
                page.click("#measure")
                expect(page.locator("#hand")).to_have_text(f"step {step} is measured", timeout=WAIT_MS)
            live_frame(page)
            page.click("#hold")
            expect(page.locator("#message")).to_contain_text("hold requested at")
            view(page, "maps")
            page.select_option("#quantity", "w")
            expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("step 1;"), timeout=WAIT_MS)
            view(page, "log")
            expect(page.locator("#nodes tr:has-text('ok')")).to_have_count(len(nodes), timeout=WAIT_MS)
        view(page, "run")
        expect(page.locator("#elsewhere")).to_contain_text("No node of this rig runs", timeout=WAIT_MS)
