"""Faults of camera, display and machine in the running system, each over its real protocol.

The fake camera does not see the patterns; therefore steps are recorded and not measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from faulty_rig import FRAMES, MM, Rig, recorded
from running_system import ScpiServer, wait_until

from camera_node.testing import FakeCamera
from fringe_projector_node.testing import VirtualDisplay, WindowManager
from fringedic.configuration.rig_file import load_rig_file
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph

pytestmark = [pytest.mark.hardware, pytest.mark.slow]

RIG_FILE = Path(__file__).parent / "rigs" / "devices.yaml"
MACHINE = {
    "protocol": "scpi",
    "timeout_s": 1.0,
    "force": {"query": "MEAS:FORC?", "unit": "kN"},
    "position": {"query": "MEAS:POS?", "unit": "um"},
    "status": {"query": "STAT?", "idle": ["IDLE"], "moving": ["RUN"], "hold": ["HOLD"]},
    "move": {"commands": ["SPEED {speed:.4f}", "GOTO {position:.4f}"], "speed_unit": "mm/min"},
    "hold": ["STOP"],
    "limits": {"lowest_mm": 0.0, "highest_mm": 1.0, "fastest_mm_per_s": 5.0},
}


class Bench(NamedTuple):
    """A running rig and its devices."""

    rig: Rig
    camera: FakeCamera
    display: VirtualDisplay
    machine: ScpiServer


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("devices")
    (folder / "screen").mkdir()
    content = yaml.safe_load(RIG_FILE.read_text())
    content["camera"]["settle_ms"] = 160.0  # eight frames take longer than the machine's time-out
    (folder / RIG_FILE.name).write_text(yaml.safe_dump(content))
    with (
        FakeCamera() as camera,
        VirtualDisplay(folder / "screen", 640, 480) as display,
        ScpiServer() as machine,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("DISPLAY", display.name)
        resource = f"TCPIP::127.0.0.1::{machine.port}::SOCKET"
        (folder / "machine.yaml").write_text(yaml.safe_dump({**MACHINE, "resource": resource}))
        rig_file = load_rig_file(folder / RIG_FILE.name)
        graph = rig_graph(rig_file, folder / RIG_FILE.name, folder, experiment="faults")
        with (
            RunningGraph(graph, folder / "logs") as running,
            RigClient(graph.namespace, name="tension") as client,
        ):
            client.wait_until_ready(graph.names)
            client.move(0.3 * MM, 5 * MM)
            rig = Rig(running, client, folder, measured=False)
            rig.works()
            yield Bench(rig, camera, display, machine)


def fails_and_continues(bench: Bench, words: str, fault: Callable[[], object], repair: Callable[[], object]) -> None:
    """Check that a fault during a stack is named, the machine stops, and the next step is recorded completely."""
    rig = bench.rig
    with rig.creeping():
        rig.fails(words, at_frame=4, then=fault)
    repair()
    wait_until(rig.works_again, "the next step")
    step = rig.works().step
    wait_until(lambda: recorded(rig.folder / "bag", step) == FRAMES, "its frames to be on the disk")


def test_camera_that_is_unplugged(bench: Bench) -> None:
    fails_and_continues(bench, ".*frame [4-9].*camera", bench.camera.pull, bench.camera.plug_in)


def test_window_that_is_closed(bench: Bench) -> None:
    def close() -> None:
        with WindowManager() as manager:
            manager.close(manager.windows()[-1])

    fails_and_continues(bench, ".*the projector's window was closed", close, lambda: None)


def test_display_at_another_resolution(bench: Bench) -> None:
    fails_and_continues(
        bench,
        ".*the displays changed from 640x480 to 320x240 px",
        lambda: bench.display.change_resolution(320, 240),
        lambda: bench.display.change_resolution(640, 480),
    )


def test_machine_that_is_silent(bench: Bench) -> None:
    """The machine is requested to hold; whether it does is known when it answers again."""
    rig = bench.rig
    try:
        rig.fails("the load frame reports the mode UNKNOWN", at_frame=4, then=lambda: bench.machine.send("SILENT"))
    finally:
        bench.machine.send("SPEAK")
    rig.wait_for_hold("answers of the machine")
    wait_until(rig.works_again, "the next step")
