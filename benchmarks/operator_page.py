"""Cost of the operator's page: processor time, memory, delays, and its effect on the frames of a step.

``python benchmarks/operator_page.py RIG [MINUTES]`` runs `fringedic operate` for a rig (``plate`` by default) with one
and five clients, and at the end streams for so many minutes (1 by default) with one client.
"""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from urllib.parse import urlparse

from websockets.sync.client import connect

from fringedic.recording.frames import frame_losses
from fringedic.recording.reader import BagReader
from fringedic_bringup.launch.environment import node_environment, private_domain
from fringedic_ros.testing import descendant_pid

WARM_UP_S, SPAN_S = 5.0, 20.0
WHEEL_S = 11.0  # after which the wheel of the browsers before is free
TICKS = os.sysconf("SC_CLK_TCK")
PROGRAMME = "{experiment: measured, ramp: {to_mm: 0.3, steps: 4, speed_mm_per_s: 5}}"
PORT = 8177


class Browser:
    """A client that receives everything, and fetches the map and the sigma of each step as the page does."""

    def __init__(self, url: str) -> None:
        place = urlparse(url)
        assert place.port is not None
        self._host = f"{place.hostname}:{place.port}"
        connection = http.client.HTTPConnection(self._host)
        connection.request("GET", f"/?{place.query}")
        self._cookie = connection.getresponse().headers["set-cookie"].partition(";")[0]
        self.images, self.first_image_s, self.maps = 0, float("nan"), dict[int, float]()
        self.words = ""
        self._started = time.monotonic()
        self._socket = connect(
            f"ws://{self._host}/stream",
            additional_headers={"Cookie": self._cookie},
            origin=f"http://{self._host}",  # type: ignore[arg-type]
            compression=None,
            max_size=None,
        )
        threading.Thread(target=self._receive, daemon=True).start()

    def post(self, name: str, **content: object) -> None:
        """Give a command."""
        headers = {"Cookie": self._cookie, "Origin": f"http://{self._host}", "Content-Type": "application/json"}
        connection = http.client.HTTPConnection(self._host)
        connection.request("POST", f"/do/{name}", json.dumps(content), headers)
        answer = connection.getresponse()
        assert answer.status == 200, answer.read()

    def close(self) -> None:
        """Leave."""
        self._socket.close()

    def _receive(self) -> None:
        for message in self._socket:
            if isinstance(message, bytes):
                self.images += 1
                if self.images == 1:
                    self.first_image_s = time.monotonic() - self._started
                continue
            found = json.loads(message)
            if found["topic"] == "steps":
                for step in found["data"]:
                    if step["mapped"] and step["step"] not in self.maps:
                        for name in ("v", "sigma_v"):
                            self._get(f"/maps/{step['step']}/{name}")
                        self.maps[step["step"]] = time.time()
            elif found["topic"] == "procedure" and found["data"] and found["data"]["procedure"] == "run":
                self.words = found["data"]["folder"] if found["data"]["state"] in (5, 6) else ""

    def _get(self, path: str) -> None:
        connection = http.client.HTTPConnection(self._host)
        connection.request("GET", path, headers={"Cookie": self._cookie})
        connection.getresponse().read()


@contextmanager
def operating(rig: str, folder: Path) -> Iterator[tuple[str, int]]:
    """Run the command in a folder; yield address and process of the page."""
    code = "from fringedic.command.main import main; main()"
    words = [sys.executable, "-c", code, "operate", rig, "--port", str(PORT)]
    with private_domain() as domain:
        environment = {**node_environment(domain), "COLUMNS": "300", "PYTHONUNBUFFERED": "1"}
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=folder, env=environment) as process:
            assert process.stdout is not None
            url = next(line for line in process.stdout if line.startswith("page: ")).split()[-1]
            try:
                yield url, descendant_pid(process.pid, "operator")
            finally:
                process.send_signal(signal.SIGINT)
                process.wait(90)


def cpu_s(pid: int) -> float:
    """Return the processor time of a process [s]."""
    parts = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(parts[11]) + int(parts[12])) / TICKS


def memory_mb(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure_live(url: str, pid: int, clients: int, span_s: float = SPAN_S) -> None:
    """Print processor time and images while the live view runs."""
    with ExitStack() as stack:
        browsers = [Browser(url) for _ in range(clients)]
        for browser in browsers:
            stack.callback(browser.close)
        time.sleep(WARM_UP_S)
        before, images, memory = cpu_s(pid), sum(each.images for each in browsers), memory_mb(pid)
        time.sleep(span_s)
        used = (cpu_s(pid) - before) / span_s
        rate = (sum(each.images for each in browsers) - images) / span_s / max(clients, 1)
        first = f"first image after {browsers[0].first_image_s:.2f} s, " if browsers else ""
        print(
            f"live, {clients} clients, {span_s:.0f} s: {100 * used:.1f} % of a core, {first}{rate:.1f} images/s each, "
            f"memory {memory:.0f} -> {memory_mb(pid):.0f} MB",
            flush=True,
        )


def measure_run(url: str, pid: int, clients: int, folder: Path) -> None:
    """Print processor time and the delay of the maps during a programme."""
    time.sleep(WHEEL_S)
    browsers = [Browser(url) for _ in range(clients)]
    time.sleep(1.0)
    browsers[0].post("wheel", action="ask")
    browsers[0].post("start", procedure="run", text=PROGRAMME)
    while not browsers[0].maps:
        time.sleep(0.05)
    before, started = cpu_s(pid), time.monotonic()
    while len(browsers[0].maps) < 4:
        time.sleep(0.05)
    used = (cpu_s(pid) - before) / (time.monotonic() - started)
    while not browsers[0].words:
        time.sleep(0.2)
    run = folder / "recordings" / browsers[0].words
    clouds = cloud_times(run / "bag")
    delays = [f"{browsers[0].maps[step] - clouds[step]:.2f}" for step in sorted(clouds)]
    lost = sum(sum(each) for each in frame_losses(BagReader(run / "bag")).values())
    print(
        f"run, {clients} clients: {100 * used:.1f} % of a core, cloud to map in the client [s]: {', '.join(delays)}, "
        f"{lost} frames lost",
        flush=True,
    )
    for browser in browsers:
        browser.close()


def cloud_times(bag: Path) -> dict[int, float]:
    """Return when the recorder received the displacement of each step [s]."""
    reader = BagReader(bag)
    names = reader.find("coupling/displacement")
    times = [stamp for _, _, stamp in reader.messages(names.values())]
    return {step: 1e-9 * stamp for step, stamp in enumerate(times)}


def main(rig: str = "plate", minutes: str = "1") -> None:
    """Print all figures."""
    with tempfile.TemporaryDirectory() as name, operating(rig, Path(name)) as (url, pid):
        time.sleep(WARM_UP_S)
        for clients in (0, 1, 5):
            measure_live(url, pid, clients)
        for clients in (1, 5):
            measure_run(url, pid, clients, Path(name))
        measure_live(url, pid, 1, 60 * float(minutes))


if __name__ == "__main__":
    main(*sys.argv[1:])
