"""Memory of the operator's page and of its server while they stream.

``python benchmarks/operator_streaming.py [MINUTES [RIG]]`` shows the live view of a rig (``plate`` by default) in
chromium for so many minutes (30 by default). It prints the time from opening the page to its first image, and every
minute the resident memory of the server, the memory of the page's JavaScript after a collection, and the images shown.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path

from operator_page import WARM_UP_S, cpu_s, memory_mb, operating
from playwright.sync_api import Browser, CDPSession, Page, sync_playwright

COUNT = """() => {
  const canvas = document.querySelector("canvas.camera");
  window.shown = 0;
  new MutationObserver(() => { window.shown += 1; }).observe(canvas, { attributeFilter: ["data-stamp"] });
}"""


def page_memory_mb(tools: CDPSession) -> float:
    """Return the memory of the page's JavaScript after a collection [MB]."""
    tools.send("HeapProfiler.collectGarbage")
    metrics = tools.send("Performance.getMetrics")["metrics"]
    return 1e-6 * next(float(each["value"]) for each in metrics if each["name"] == "JSHeapUsedSize")


def first_image_s(browser: Browser, url: str) -> float:
    """Return the time from opening the printed address in a new browser until an image of the camera is shown [s]."""
    page = browser.new_context().new_page()
    began = time.monotonic()
    page.goto(f"{url}#live")
    page.wait_for_selector("canvas.camera[data-stamp]", timeout=90_000)
    passed = time.monotonic() - began
    page.context.close()
    return passed


def stream(page: Page, pid: int, minutes: int) -> None:
    """Print the memory of server and page every minute."""
    tools = page.context.new_cdp_session(page)
    tools.send("Performance.enable")
    print("minute  server MB  page MB  images/s  server % of a core", flush=True)
    shown, used, seen = 0, cpu_s(pid), time.monotonic()
    for minute in range(minutes + 1):
        now, count, cpu = time.monotonic(), int(page.evaluate("() => window.shown")), cpu_s(pid)
        span = max(now - seen, 1e-3)
        print(
            f"{minute:6d}  {memory_mb(pid):9.1f}  {page_memory_mb(tools):7.2f}  {(count - shown) / span:8.1f}  "
            f"{100 * (cpu - used) / span:8.1f}",
            flush=True,
        )
        shown, used, seen = count, cpu, now
        time.sleep(60)


def main(minutes: str = "30", rig: str = "plate") -> None:
    """Print all figures."""
    chromium = shutil.which("chromium")
    with (
        tempfile.TemporaryDirectory() as name,
        operating(rig, Path(name)) as (url, pid),
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        page.goto(url)
        page.click("nav a[href='#live']")
        page.wait_for_selector("canvas.camera[data-stamp]", timeout=90_000)
        times = ", ".join(f"{first_image_s(browser, url):.2f}" for _ in range(5))
        print(f"first image [s]: {times}", flush=True)
        page.evaluate(COUNT)
        time.sleep(WARM_UP_S)
        stream(page, pid, int(minutes))
        browser.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
